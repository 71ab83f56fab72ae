"""Collect evaluations into the tidy result tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import cast

import numpy as np
import pandas as pd

from hoi.artifacts import Evaluation

COLUMNS = (
    "dataset", "protocol", "masks", "category", "action", "method", "n", "n_failed",
    "human_mean_cm", "human_std_cm", "human_median_cm",
    "object_mean_cm", "object_std_cm", "object_median_cm",
    "object_failure_rate", "seconds_per_frame",
)  # fmt: skip
CONTACT_COLUMNS = (
    "dataset", "masks", "category", "action", "method", "threshold_cm", "correspondence",
    "n_precision", "precision_mean", "n_recall", "recall_mean",
)  # fmt: skip
#: Frames that the protocol itself leaves out: no failures, so they are in no count.
LEFT_OUT = ("object_hidden", "visibility_unknown")
# the paper's order of rows; actions it does not know follow alphabetically
ACTION_ORDER = (
    "hand", "lift", "liftreal", "move", "sit", "sitstand", "type", "back", "hug", "ground", "mix",
)  # fmt: skip


def evaluation_frame(
    evaluations: Iterable[Evaluation], frames: dict[str, dict], seconds: dict[str, float]
) -> pd.DataFrame:
    """One row per frame.

    Args:
        evaluations: of one method.
        frames: frame id -> dataset, category, object_name, action, method: known also for frames
            that failed, so that no failure is lost.
        seconds: frame id -> seconds of all stages together.
    """
    rows = [
        {
            **frames[evaluation.frame_id],
            "frame_id": evaluation.frame_id,
            "status": evaluation.status,
            "failed_stage": evaluation.failed_stage,
            "detail": evaluation.detail,
            "used_action": evaluation.used_action,
            "protocol": evaluation.protocol,
            "human_cm": evaluation.human_cm,
            "object_cm": evaluation.object_cm,
            "seconds": seconds.get(evaluation.frame_id, np.nan),
        }
        for evaluation in evaluations
    ]
    return pd.DataFrame(rows)


def under_protocol(evaluations: Iterable[Evaluation], name: str) -> list[Evaluation]:
    """The same frames under one of the further protocols (`EvaluateConfig.also`).

    A frame that failed keeps its status, and a frame to which the protocol does not apply has the
    status ``no_correspondence``.
    """
    return [_under(evaluation, name) for evaluation in evaluations]


def _under(evaluation: Evaluation, name: str) -> Evaluation:
    found = next((m for m in evaluation.others if m.name == name), None)
    if not evaluation.ok:
        return evaluation
    if found is None:
        values = {"human_cm": None, "object_cm": None, "protocol": ""}
        return evaluation.model_copy(update=values | {"status": "no_correspondence"})
    update = {"protocol": found.protocol, "human_cm": found.human_cm, "object_cm": found.object_cm}
    return evaluation.model_copy(update=update)


def summarise(
    frames: pd.DataFrame, category: str, methods: Sequence[str], masks: str, failure_cm: float
) -> pd.DataFrame:
    """The tidy table: one row per action and method, then action ``avg`` per method.

    ``avg`` is the unweighted mean over the actions of every column, standard deviations included,
    as in the paper; its counts are sums. ``n`` counts frames with a result, ``n_failed`` frames
    with a status instead, except for those that the protocol leaves out (`LEFT_OUT`), which are
    not counted; ``object_failure_rate`` is the share of the n beyond `failure_cm`.
    Standard deviations are those of the population.
    """
    rows = []
    frames = frames.loc[~frames["status"].isin(LEFT_OUT)]
    for method in methods:
        of_method = frames.loc[frames["method"] == method]
        per_action = [
            _row(rows_of_action, category, str(action), method, masks, failure_cm)
            for action, rows_of_action in sorted(of_method.groupby("action"), key=_by_rank)
        ]
        rows.extend(per_action)
        if per_action:
            rows.append(_average(per_action))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def summarise_contacts(
    evaluations: Iterable[Evaluation], frames: dict[str, dict], category: str, masks: str
) -> pd.DataFrame:
    """Contact precision and recall: one row per action, method and distance, then ``avg``.

    The means are over the frames where the share is defined (``n_precision``, ``n_recall``);
    ``avg`` is the unweighted mean over actions.

    Args:
        evaluations: of any methods.
        frames: frame id -> dataset and action.
    """
    rows = [
        {
            "dataset": frames[evaluation.frame_id]["dataset"],
            "action": frames[evaluation.frame_id]["action"],
            "method": evaluation.method,
            **score.model_dump(),
        }
        for evaluation in evaluations
        for score in evaluation.contacts
    ]
    if not rows:
        return pd.DataFrame(columns=list(CONTACT_COLUMNS))
    table, summary = pd.DataFrame(rows), []
    for key, part in table.groupby(["method", "threshold_cm"], sort=False):
        method, limit = cast(tuple[str, float], key)
        labels = {"masks": masks, "category": category, "method": method, "threshold_cm": limit}
        per_action = [
            labels | _contact_row(str(action), of)
            for action, of in sorted(part.groupby("action"), key=_by_rank)
        ]
        summary += [*per_action, _average_contacts(per_action)]
    return pd.DataFrame(summary, columns=list(CONTACT_COLUMNS))


def _contact_row(action: str, of: pd.DataFrame) -> dict:
    precision, recall = (pd.Series(of[name], dtype=float) for name in ("precision", "recall"))
    return {
        "dataset": " ".join(sorted(set(of["dataset"]))),
        "action": action,
        "correspondence": " / ".join(sorted(set(of["correspondence"]))),
        "n_precision": precision.count(),
        "precision_mean": precision.mean(),
        "n_recall": recall.count(),
        "recall_mean": recall.mean(),
    }


def _average_contacts(rows: list[dict]) -> dict:
    average = rows[0] | {"action": "avg"}
    for column in ("n_precision", "n_recall"):
        average[column] = sum(row[column] for row in rows)
    for column in ("precision_mean", "recall_mean"):
        values = np.array([row[column] for row in rows], dtype=float)
        average[column] = np.nanmean(values) if np.isfinite(values).any() else np.nan
    return average


def _by_rank(group: tuple) -> tuple[int, str]:
    action = str(group[0])
    known = action in ACTION_ORDER
    return (ACTION_ORDER.index(action) if known else len(ACTION_ORDER), action)


def named_protocols(summary: pd.DataFrame, name: str) -> pd.DataFrame:
    """The summary with `name` in place of the protocol where no frame has a result to name it."""
    empty = summary["protocol"] == ""
    return summary.assign(protocol=summary["protocol"].mask(empty, f"{name}: no result"))


def _row(
    frames: pd.DataFrame, category: str, action: str, method: str, masks: str, failure_cm: float
) -> dict:
    done = frames.loc[frames["status"] == "ok"]
    human, thing = (pd.Series(done[name], dtype=float) for name in ("human_cm", "object_cm"))
    protocols = sorted(set(done["protocol"]) - {""})
    return {
        "dataset": " ".join(sorted(set(frames["dataset"]))),
        "protocol": " / ".join(protocols),
        "masks": masks,
        "category": category,
        "action": action,
        "method": method,
        "n": len(done),
        "n_failed": len(frames) - len(done),
        "human_mean_cm": human.mean(),
        "human_std_cm": human.std(ddof=0),
        "human_median_cm": human.median(),
        "object_mean_cm": thing.mean(),
        "object_std_cm": thing.std(ddof=0),
        "object_median_cm": thing.median(),
        "object_failure_rate": (thing > failure_cm).mean() if len(done) else np.nan,
        "seconds_per_frame": frames["seconds"].astype(float).mean(),
    }


def _average(rows: list[dict]) -> dict:
    average: dict = rows[0] | {"action": "avg"}
    average["protocol"] = next((row["protocol"] for row in rows if row["protocol"]), "")
    for column in ("n", "n_failed"):
        average[column] = sum(row[column] for row in rows)
    for column in COLUMNS[COLUMNS.index("human_mean_cm") :]:
        values = np.array([row[column] for row in rows], dtype=float)
        average[column] = np.nanmean(values) if np.isfinite(values).any() else np.nan
    return average
