"""What every stage decided about a frame, as titles, facts and small tables of plain text.

Nothing here knows HTML; the templates escape and lay out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TypeVar

from hoi.artifacts import (
    Action,
    Artifact,
    BodyFit,
    Detection,
    Evaluation,
    Extents,
    Interaction,
    Joint,
    ObjectFit,
    Prior,
)
from hoi.report.config import ReportConfig

DASH = "–"
T = TypeVar("T", bound=Artifact)


@dataclass(frozen=True)
class Grid:
    """A small table: rows of plain text, one of them possibly marked as chosen."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    marked: int | None = None


@dataclass(frozen=True)
class Outcome:
    """One stage of one frame in words.

    Attributes:
        stage: the package's name.
        title: for people.
        status: ``ok``, the artifact's status, or ``not run``.
        headline: the decision in a few words, or why there is none.
        facts: label and value.
        grids: tables.
        curves: name and values of quantities over the iterations of an optimisation.
        methods: the methods that share this outcome.
    """

    stage: str
    title: str
    status: str
    headline: str
    facts: tuple[tuple[str, str], ...] = ()
    grids: tuple[Grid, ...] = ()
    curves: tuple[tuple[str, tuple[float, ...]], ...] = ()
    methods: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        return self.status == "ok"


def number(value: float | None, digits: int = 2) -> str:
    """Fixed-point text, powers of ten where that would show only zeros, a dash for nothing."""
    if value is None or not math.isfinite(value):
        return DASH
    if value != 0 and (abs(value) < 0.5 * 10**-digits or abs(value) >= 1e6):
        return f"{value:.{max(digits - 1, 1)}e}"
    return f"{value:.{digits}f}"


def words(*parts: str) -> str:
    """The non-empty parts, joined by a comma; a dash when all are empty."""
    return ", ".join(part for part in parts if part) or DASH


def describe_detection(detection: Detection | None, config: ReportConfig) -> Outcome:
    """Boxes, scores, where masks and keypoints come from, and every candidate's verdict."""

    def tell(found: Detection) -> Outcome:
        keypoints = found.keypoints
        sure = 0 if keypoints is None else int((keypoints[:, 2] > config.keypoint_confidence).sum())
        total = 0 if keypoints is None else len(keypoints)
        facts = (
            ("Person", words(f"score {number(found.person_score)}", found.person_mask_source)),
            (
                "Object",
                words(found.object_label, f"score {number(found.object_score)}"),
            ),
            ("Object mask", words(found.object_mask_source, _area(found.object_mask))),
            ("Keypoints", words(f"{sure} of {total} confident", found.keypoints_source)),
            ("3D landmarks", words(found.landmarks_source)),
        )
        shown = found.candidates[: config.max_candidates]
        rows = tuple(
            (
                candidate.label,
                number(candidate.score),
                " ".join(f"{v:.0f}" for v in candidate.box),
                candidate.verdict.replace("_", " "),
            )
            for candidate in shown
        )
        more = len(found.candidates) - len(shown)
        caption = "Candidates" + (f" (best {len(shown)}, {more} more)" if more else "")
        grids = (
            (Grid(caption, ("Class", "Score", "Box x0 y0 x1 y1", "Verdict"), rows),) if rows else ()
        )
        return Outcome("detect", "Detection", "ok", "Person and object found", facts, grids)

    return _outcome("detect", "Detection", detection, tell, always=True)


def describe_body(body: BodyFit | None) -> Outcome:
    """Energies and reprojection error of the body fit."""

    def tell(fit: BodyFit) -> Outcome:
        rows = tuple((name, number(value, 3)) for name, value in fit.energy.items())
        grids = (Grid("Energies at the end", ("Term", "Value"), rows),) if rows else ()
        facts = (
            ("Reprojection error", f"{number(fit.reprojection_error_px, 1)} px"),
            ("Started from", words(fit.initialisation)),
            ("Body model", words(fit.body_model[:24])),
        )
        headline = f"{number(fit.reprojection_error_px, 1)} px reprojection error"
        return Outcome("smplify", "Body fit", "ok", headline, facts, grids)

    return _outcome("smplify", "Body fit", body, tell)


def describe_objects(objects: ObjectFit | None, config: ReportConfig) -> Outcome:
    """The kept exemplars with IoU and the reason for their rank."""

    def tell(fit: ObjectFit) -> Outcome:
        names, ious = fit.exemplars or [], fit.ious
        assert ious is not None
        rows = tuple(
            (
                str(rank + 1),
                name,
                number(float(ious[rank]), 3),
                number(None if fit.losses is None else float(fit.losses[rank])),
                fit.reasons[rank] if rank < len(fit.reasons) else DASH,
            )
            for rank, name in enumerate(names[: config.max_exemplars])
        )
        grid = Grid("Kept hypotheses", ("Rank", "Exemplar", "IoU", "Loss", "Why"), rows)
        facts = (("Searched", f"{fit.searched} exemplar and start pairs"),)
        headline = f"{names[0]}, IoU {number(float(ious[0]))}" if names else "no exemplar"
        return Outcome("objectfit", "Object fit", "ok", headline, facts, (grid,))

    return _outcome("objectfit", "Object fit", objects, tell)


def describe_action(action: Action | None) -> Outcome:
    """The retrieved action, its distance and what came next."""

    def tell(found: Action) -> Outcome:
        rows = tuple(
            (neighbour.action, neighbour.pose_id, number(neighbour.distance, 3))
            for neighbour in found.runners_up
        )
        grids = (Grid("Runners-up", ("Action", "Pose", "Distance"), rows),) if rows else ()
        facts = (
            ("Nearest pose says", words(found.action or "")),
            ("Distance", number(found.distance, 3)),
            ("Without retrieval", words(found.default_action)),
        )
        headline = f"{found.action}, distance {number(found.distance, 3)}"
        return Outcome("actions", "Action", "ok", headline, facts, grids)

    return _outcome("actions", "Action", action, tell)


def describe_prior(prior: Prior | None) -> Outcome:
    """Size and contacts with where each was said."""

    def tell(found: Prior) -> Outcome:
        likely = found.hypotheses or [said for said in (found.retrieved,) if said is not None]
        several = len(likely) > 1
        grids = [
            _contacts(f"Contacts, {said.probability:.0%}" if several else "Contacts", said)
            for said in likely
        ]
        if found.default is not None and found.default.action not in {s.action for s in likely}:
            grids.append(_contacts("Without retrieval", found.default))
        unmapped = found.retrieved.unmapped if found.retrieved is not None else []
        facts = [
            ("Size", f"{number(found.size_m)} m, {found.size_axis}"),
            ("Size from", words(found.size_source)),
        ]
        if found.retrieved is not None:
            floor = "stands on the floor" if found.retrieved.stands_on_floor else "may leave it"
            facts += [("Object", floor), ("Answer from", words(found.retrieved.source))]
            facts += _beyond_the_paper(found.retrieved)
        if found.extents is not None:
            facts.append(("Usual range", _ranges(found.extents)))
        if unmapped:
            facts.append(("Not mapped", "; ".join(unmapped)))
        count = len(found.retrieved.contacts) if found.retrieved is not None else 0
        headline = f"{number(found.size_m)} m; {count} contact{'s' if count != 1 else ''}"
        return Outcome("priors", "Prior", "ok", headline, tuple(facts), tuple(grids))

    return _outcome("priors", "Prior", prior, tell)


def _beyond_the_paper(said: Interaction) -> list[tuple[str, str]]:
    facts = []
    if said.arrangement is not None and said.arrangement.relation:
        turned = f", turned {said.arrangement.facing}" if said.arrangement.facing else ""
        facts.append(("Seen from the person", said.arrangement.relation + turned))
    if said.alternatives:
        ways = (f"{each.name} ({each.probability:.0%})" for each in said.alternatives)
        facts.append(("Other ways", ", ".join(ways)))
    if said.no_contact > 0:
        facts.append(("No contact", f"{said.no_contact:.0%}"))
    return facts


def _ranges(extents: Extents) -> str:
    known = (("height", extents.height), ("width", extents.width), ("depth", extents.depth))
    ranges = (f"{name} {number(each.low)}–{number(each.high)} m" for name, each in known if each)
    return ", ".join(ranges)


def describe_joint(joint: Joint | None) -> Outcome:
    """Loss terms before and after, all hypotheses and the rule that chose one."""

    def tell(found: Joint) -> Outcome:
        changes = tuple(
            (term, number(values[0], 4), number(values[-1], 4))
            for term, values in found.loss_curve.items()
            if values
        )
        grids = []
        if changes:
            grids.append(Grid("Terms of the chosen one", ("Term", "Before", "After"), changes))
        acted = len(found.hypothesis_actions) == len(found.hypothesis_exemplars)
        if found.hypothesis_exemplars:
            rows = tuple(
                (
                    str(index + 1),
                    name,
                    *(found.hypothesis_actions[index : index + 1] if acted else ()),
                    *(
                        number(values[index] if index < len(values) else None, 4)
                        for values in found.hypothesis_terms.values()
                    ),
                )
                for index, name in enumerate(found.hypothesis_exemplars)
            )
            header = ("No.", "Exemplar", *(("Action",) if acted else ()), *found.hypothesis_terms)
            grids.append(Grid("Hypotheses at the end", header, rows, found.selected))
        facts = (
            ("Chosen", words(found.exemplar, found.selection_rule)),
            ("Action used", words(found.action)),
            ("Object size factor", number(found.object_scale, 3)),
            ("Body size factor", number(found.human_scale, 3)),
        )
        curves = tuple((name, tuple(values)) for name, values in found.loss_curve.items())
        return Outcome(
            "joint",
            "Joint optimisation",
            "ok",
            ", ".join(filter(None, (found.action, found.exemplar))) or "placed",
            facts,
            tuple(grids),
            curves,
        )

    return _outcome("joint", "Joint optimisation", joint, tell)


def describe_evaluation(evaluation: Evaluation | None) -> Outcome:
    """Errors in cm under the named protocol."""

    def tell(found: Evaluation) -> Outcome:
        facts = (
            ("Body", f"{number(found.human_cm, 1)} cm"),
            ("Object", f"{number(found.object_cm, 1)} cm"),
            ("Protocol", words(found.protocol)),
            ("True action", words(found.true_action)),
            ("Used action", words(found.used_action)),
        )
        headline = f"body {number(found.human_cm, 1)} cm, object {number(found.object_cm, 1)} cm"
        return Outcome("evaluate", "Evaluation", "ok", headline, facts)

    return _outcome("evaluate", "Evaluation", evaluation, tell)


def share(outcomes: Iterable[tuple[str, Outcome]]) -> tuple[Outcome, ...]:
    """Merge equal outcomes of several methods; each result names the methods it holds for."""
    merged: dict[Outcome, list[str]] = {}
    for method, outcome in outcomes:
        merged.setdefault(outcome, []).append(method)
    return tuple(replace(outcome, methods=tuple(methods)) for outcome, methods in merged.items())


def _outcome(
    stage: str,
    title: str,
    artifact: T | None,
    tell: Callable[[T], Outcome],
    always: bool = False,
) -> Outcome:
    """What `tell` says of a result that is ok; else the status (`always`: facts as well)."""
    if artifact is None:
        return Outcome(stage, title, "not run", "This stage did not run for this frame")
    if artifact.ok:
        return tell(artifact)
    where = artifact.failed_stage or stage
    reason = artifact.detail or artifact.status.replace("_", " ")
    if where != stage:
        return Outcome(stage, title, artifact.status, f"Skipped: {where} stopped. {reason}")
    if not always:
        return Outcome(stage, title, artifact.status, reason)
    return replace(tell(artifact), status=artifact.status, headline=reason)


def _area(mask) -> str:
    return "" if mask is None else f"{int(mask.sum()):,} px".replace(",", " ")


def _contacts(caption: str, said: Interaction) -> Grid:
    rows = tuple(
        (
            contact.object_part.replace("_", " "),
            contact.body_part.replace("_", " ") + (f" ({contact.side})" if contact.side else ""),
            number(contact.probability),
            contact.source or said.source or DASH,
        )
        for contact in said.contacts
    )
    return Grid(
        f"{caption}: {said.action}", ("Object part", "Body part", "Probability", "From"), rows
    )
