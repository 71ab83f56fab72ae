"""The index of all frames: one card a frame to sort and filter, and the failures by cause."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hoi.artifacts import Detection, Frame, GroundTruth
from hoi.report.causes import CAUSES, cause_of_error, cause_of_stop
from hoi.report.config import ReportConfig
from hoi.report.doubts import doubts, object_sides
from hoi.report.html import image_url, render, source
from hoi.report.labels import method_label
from hoi.report.outcomes import number
from hoi.report.page import MethodView


@dataclass(frozen=True)
class Problem:
    """Why a frame has no result: the stage that stopped, its status, one sentence."""

    status: str
    stage: str
    detail: str = ""


@dataclass(frozen=True)
class MethodScore:
    """Errors of one method on one frame in cm, the problem that stopped it, the failure's cause."""

    human_cm: float | None = None
    object_cm: float | None = None
    problem: Problem | None = None
    cause: str = ""  # of a failure, see hoi.report.causes


@dataclass(frozen=True, eq=False)
class Card:
    """One frame in the gallery.

    Attributes:
        frame_id, dataset, category, action: as in the frame's artifact.
        href: path of the frame's page relative to the gallery; empty without a page.
        image: (H, W, 3) uint8 RGB, e.g. of `hoi.report.overlay.thumbnail`; None for no picture.
        scores: by method, in the order of the tables.
        note: what came out, for frames without errors.
    """

    frame_id: str
    dataset: str
    category: str
    action: str
    href: str = ""
    image: np.ndarray | None = None
    scores: Mapping[str, MethodScore] = field(default_factory=dict)
    note: str = ""

    @property
    def status(self) -> str:
        """``ok`` when any method came through, else the first problem's status."""
        problems = [score.problem for score in self.scores.values()]
        found = [problem for problem in problems if problem is not None]
        return found[0].status if found and len(found) == len(problems) else "ok"


def card_of(
    frame: Frame,
    detection: Detection | None,
    methods: Sequence[MethodView],
    href: str = "",
    image: np.ndarray | None = None,
    truth: GroundTruth | None = None,
    config: ReportConfig | None = None,
) -> Card:
    """The card of a frame from its artifacts; `truth` tells causes of large errors apart."""
    config = config or ReportConfig()
    upstream = next((a for a in (frame, detection) if a is not None and not a.ok), None)
    scores = {}
    for method in methods:
        found = method.problem()
        if upstream is not None:
            stage = upstream.failed_stage or ("frame" if upstream is frame else "detect")
            found = upstream.status, stage, upstream.detail
        score, joint = method.evaluation, method.joint
        cause = "" if found is None else cause_of_stop(found[1])
        if found is None and score is not None and score.ok and joint is not None and joint.ok:
            cause = cause_of_error(joint, score, truth, config)
        scores[method.name] = MethodScore(
            None if score is None else score.human_cm,
            None if score is None else score.object_cm,
            None if found is None else Problem(*found),
            cause,
        )
    note = _note(frame, detection, methods[-1]) if methods else ""
    return Card(
        frame.frame_id, frame.dataset, frame.category, frame.action, href, image, scores, note
    )


def _note(frame: Frame, detection: Detection | None, method: MethodView) -> str:
    """What came out of a photo: action, size, and what speaks against it."""
    joint = method.joint
    if joint is None or (sides := object_sides(joint)) is None:
        return ""
    size = " × ".join(f"{side:.2f}" for side in sides)
    against = "; ".join(doubts(frame, detection, method.objects, joint))
    doubt = f" · doubtful: {against}" if against else ""
    return f"{joint.action or 'uses it'} · object {size} m{doubt}"


def pick_frames(frames: Sequence[tuple[str, str]], limit: int) -> list[str]:
    """Up to `limit` frames for pages of their own, evenly over groups.

    Args:
        frames: (frame id, group), e.g. the action, in the order of the run.
        limit: most frames, see `ReportConfig.max_frames`.

    Returns frame ids in the order given: the first of each group, then the second of each, ...
    """
    turns: Counter[str] = Counter()
    ranked = []
    for position, (frame_id, group) in enumerate(frames):
        ranked.append((turns[group], position, frame_id))
        turns[group] += 1
    chosen = sorted(sorted(ranked)[:limit], key=lambda entry: entry[1])
    return [frame_id for _, _, frame_id in chosen]


def failures_by_cause(cards: Iterable[Card]) -> list[dict[str, str]]:
    """How often which stage stopped and why, most frequent first.

    Each entry: category, stage, status, methods (``all`` where none came through), count, share
    of the category's frames, and an example frame.
    """
    cards = list(cards)
    totals = Counter(card.category for card in cards)
    causes: dict[tuple[str, str, str, str], list[Card]] = defaultdict(list)
    for card in cards:
        stopped: dict[tuple[str, str], list[str]] = defaultdict(list)
        for method, score in card.scores.items():
            if score.problem is not None:
                stopped[score.problem.stage, score.problem.status].append(method)
        for (stage, status), methods in stopped.items():
            whom = "all" if len(methods) == len(card.scores) else ", ".join(methods)
            causes[card.category, stage, status, whom].append(card)
    ordered = sorted(causes.items(), key=lambda item: (-len(item[1]), item[0]))
    return [
        {
            "category": category,
            "stage": stage,
            "status": status,
            "methods": methods,
            "count": str(len(found)),
            "share": f"{100 * len(found) / totals[category]:.0f} %",
            "example": found[0].frame_id,
            "href": found[0].href,
        }
        for (category, stage, status, methods), found in ordered
    ]


def causes_by_method(cards: Sequence[Card], methods: Sequence[str]) -> dict[str, list]:
    """How many frames failed for which cause, by method, in the order of the pipeline.

    ``rows``: cause, meaning and ``cells`` of method and count; ``totals``: failed frames by method.
    """
    counts = Counter(
        (score.cause, name) for card in cards for name, score in card.scores.items() if score.cause
    )
    rows = [
        {
            "cause": cause,
            "meaning": meaning,
            "cells": [{"method": name, "count": counts[cause, name]} for name in methods],
        }
        for cause, meaning in CAUSES.items()
        if any(counts[cause, name] for name in methods)
    ]
    totals = [sum(counts[cause, name] for cause in CAUSES) for name in methods]
    return {"rows": rows, "totals": totals}


def gallery_page(
    cards: Sequence[Card],
    config: ReportConfig | None = None,
    heading: str = "All frames",
    tables: Sequence[str] = (),
    others: Mapping[str, str] | None = None,
) -> str:
    """The gallery as one HTML string; equal inputs give equal text.

    It fetches nothing. Links to the frames' pages are relative; inside Snakemake's report, where
    no relative link can work, they are shown as plain text. `tables` are HTML fragments, see
    :func:`hoi.report.tables.as_html`; `others` are pages to name beside them, by title.
    """
    config = config or ReportConfig()
    shown = cards[: config.max_cards]
    methods = list(dict.fromkeys(name for card in cards for name in card.scores))
    return render(
        "gallery.html.j2",
        style=source("style.css") + source("gallery.css"),
        script=source("gallery.js"),
        heading=heading,
        tables=tables,
        others=others or {},
        summary=_summary(cards, methods),
        causes=causes_by_method(cards, methods),
        measured=any(score.object_cm is not None for c in cards for score in c.scores.values()),
        cards=[_card(card, methods, config) for card in shown],
        left_out=len(cards) - len(shown),
        total=len(cards),
        methods=methods,
        filters=[
            (name, sorted({getattr(card, name) for card in shown} - {""}))
            for name in ("dataset", "category", "action", "status")
        ],
        failures=failures_by_cause(cards),
        failed=sum(card.status != "ok" for card in cards),
        config=config,
    )


def _summary(cards: Sequence[Card], methods: Sequence[str]) -> list[dict[str, str]]:
    """A few figures at a glance: frames, how many came through, each method's median error."""
    if not cards:
        return []
    through = sum(card.status == "ok" for card in cards)
    tiles = [{"value": f"{through} / {len(cards)}", "label": "frames reconstructed"}]
    for name in [m for m in methods if m in ("phosa", "ours")] or methods[:2]:
        found = [c.scores[name].object_cm for c in cards if name in c.scores]
        errors = [error for error in found if error is not None]
        if errors:
            label = f"cm, median object error, {method_label(name)}"
            tiles.append({"value": f"{np.median(errors):.1f}", "label": label})
    return tiles


def _card(card: Card, methods: list[str], config: ReportConfig) -> dict[str, object]:
    scores = [(name, card.scores.get(name, MethodScore())) for name in methods]
    first = next((s.problem for _, s in scores if s.problem is not None), None)
    return {
        "frame_id": card.frame_id,
        "dataset": card.dataset,
        "category": card.category,
        "action": card.action,
        "href": card.href,
        "status": card.status,
        "detail": "" if first is None or card.status == "ok" else f"{first.stage}: {first.detail}",
        "url": "" if card.image is None else image_url(card.image, config),
        "size": None if card.image is None else (card.image.shape[1], card.image.shape[0]),
        "note": card.note,
        "measured": any(s.object_cm is not None or s.problem is not None for _, s in scores),
        "causes": ";".join(f"{name}={s.cause}" for name, s in scores if s.cause),
        "keys": ["" if s.object_cm is None else f"{s.object_cm:.4f}" for _, s in scores],
        "scores": [
            {
                "name": name,
                "human": number(score.human_cm, 1),
                "object": number(score.object_cm, 1),
                "cause": score.cause,
                "status": "" if score.problem is None else score.problem.status,
            }
            for name, score in scores
        ],
    }
