"""How well the database recognises its own poses: each one is looked up among the others.

``python -m hoi.actions.leave_one_out [database.npz]`` prints the table.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import cKDTree  # type: ignore[attr-defined]
from scipy.spatial.distance import cdist

from hoi.actions.config import ActionsConfig
from hoi.actions.database import DEFAULT_DATABASE, PoseDatabase, load_database
from hoi.actions.retrieval import pose_features, probabilities

if TYPE_CHECKING:
    import pandas as pd

DEFAULTS = ActionsConfig()  # type: ignore[call-arg]  # every field has a default


@dataclass(frozen=True)
class LeaveOneOut:
    """Leave-one-out recognition of one object category.

    Attributes:
        accuracy: share of poses whose nearest other pose has the same action, over those that
            leave a pose of their action behind; NaN when none does.
        confusion: counts over the same poses; rows are true actions, columns retrieved ones.
        rows: (N,) rows of the database that were looked up.
        nearest: (N,) row of the nearest other pose of each.
        distances: (N,) distance to the nearest other pose.
    """

    category: str
    accuracy: float
    confusion: pd.DataFrame
    distances: np.ndarray
    rows: np.ndarray
    nearest: np.ndarray


def leave_one_out(
    database: PoseDatabase,
    category: str,
    config: ActionsConfig = DEFAULTS,
    by: str = "pose",
) -> LeaveOneOut:
    """Recognise every pose of a category from the others.

    Args:
        by: ``pose`` leaves out the pose itself; ``base`` leaves out all variants of its base pose,
            which tells how well an action is recognised from poses nobody wrote down.
    """
    import pandas as pd

    rows = database.rows_of(category)
    ups = None if database.pelvis_up is None else database.pelvis_up[rows]
    features = pose_features(database.body_pose[rows], config, ups)
    groups = np.arange(len(rows)) if by == "pose" else _base_numbers(database.pose_ids[rows])
    actions = database.actions[rows]
    nearest = np.empty(len(rows), dtype=np.int64)
    possible = np.empty(len(rows), dtype=bool)
    distances = np.empty(len(rows))
    for group in np.unique(groups):
        left_out, others = np.flatnonzero(groups == group), np.flatnonzero(groups != group)
        if not len(others):
            raise ValueError(f"nothing is left of {category!r} without one {by}")
        distances[left_out], found = cKDTree(features[others]).query(features[left_out])
        nearest[left_out] = others[found]
        possible[left_out] = np.isin(actions[left_out], actions[others])
    retrieved = actions[nearest]
    confusion = pd.crosstab(
        pd.Series(actions[possible], name="action"),
        pd.Series(retrieved[possible], name="retrieved"),
    )
    accuracy = float(np.mean((retrieved == actions)[possible])) if possible.any() else np.nan
    return LeaveOneOut(category, accuracy, confusion, distances, rows, rows[nearest])


def stated_probability(
    database: PoseDatabase, category: str, config: ActionsConfig = DEFAULTS
) -> float:
    """Mean probability that retrieval gives its answers for poses whose base pose is left out.

    Over the poses that leave one of their action behind. It equals the accuracy on the same poses
    where the probabilities are calibrated; NaN when there are no such poses.
    """
    rows = database.rows_of(category)
    ups = None if database.pelvis_up is None else database.pelvis_up[rows]
    features = pose_features(database.body_pose[rows], config, ups)
    bases, labels = _base_numbers(database.pose_ids[rows]), database.actions[rows]
    apart = cdist(features, features)
    apart[bases[:, None] == bases] = np.inf
    to_action = {name: apart[:, labels == name].min(1) for name in dict.fromkeys(labels.tolist())}
    stated = [
        probabilities(
            np.array([nearest[row] for nearest in to_action.values()]), config.temperature
        )
        for row, label in enumerate(labels.tolist())
        if np.isfinite(to_action[label][row])
    ]
    return float(np.mean([shares.max() for shares in stated])) if stated else np.nan


def accuracy_report(
    database: PoseDatabase,
    config: ActionsConfig = DEFAULTS,
    default_action: Callable[[str], str] = lambda category: "",
) -> pd.DataFrame:
    """The table of ``results/actions.csv``: one row per category of at least two actions.

    Args:
        default_action: the action that the "no action" ablation always answers.

    Returns:
        Poses, actions, both leave-one-out accuracies, what retrieval itself says of the second
        (`stated_probability`), the same without the base pose as the paper
        compares poses (rotation vectors of the joints alone), and the share of poses that show the
        default action, which is what never looking at the pose gets right.
    """
    paper = config.model_copy(update={"metric": "axis_angle", "tilt_weight": 0.0})
    table = accuracy_table(database, config)
    paper_accuracy, default_share, defaults, stated = [], [], [], []
    for category in table["category"]:
        labels = database.actions[database.rows_of(category)]
        default = default_action(category)
        defaults.append(default)
        default_share.append(float(np.mean(labels == default)))
        stated.append(stated_probability(database, category, config))
        paper_accuracy.append(leave_one_out(database, category, paper, by="base").accuracy)
    return table.assign(
        stated_probability=stated,
        as_the_paper=paper_accuracy,
        default_action=defaults,
        always_default=default_share,
    )


def confusion_table(
    database: PoseDatabase, categories: Sequence[str], config: ActionsConfig = DEFAULTS
) -> pd.DataFrame:
    """Counts per category, true and retrieved action, without the base pose; zeros left out."""
    import pandas as pd

    tables = []
    for category in categories:
        confusion = leave_one_out(database, category, config, by="base").confusion
        if confusion.empty:
            continue
        stacked = pd.Series(confusion.stack(), name="count")
        counts = pd.Series(stacked[stacked > 0]).reset_index()
        counts.insert(0, "category", category)
        tables.append(counts)
    if not tables:
        return pd.DataFrame(columns=["category", "action", "retrieved", "count"])
    return pd.concat(tables, ignore_index=True)


class Example(NamedTuple):
    """One left-out pose and the poses found for it: rows of the database, nearest first."""

    action: str
    row: int
    found: tuple[int, ...]
    distances: tuple[float, ...]


def examples(
    database: PoseDatabase, category: str, config: ActionsConfig = DEFAULTS, others: int = 2
) -> list[Example]:
    """For every action of a category the pose that is recognised with middling ease.

    `found` holds its nearest pose of another base pose, then the nearest poses of the next
    `others` actions.
    """
    result = leave_one_out(database, category, config, by="base")
    ups = None if database.pelvis_up is None else database.pelvis_up[result.rows]
    features = pose_features(database.body_pose[result.rows], config, ups)
    bases = _base_numbers(database.pose_ids[result.rows])
    labels = database.actions[result.rows]
    chosen = []
    for action in database.actions_of(category):
        members = np.flatnonzero(labels == action)
        order = members[np.argsort(result.distances[members], kind="stable")]
        query = order[len(order) // 2]
        distance = np.linalg.norm(features - features[query], axis=1)
        distance[bases == bases[query]] = np.inf
        best = [
            of_action[distance[of_action].argmin()]
            for name in sorted(set(labels.tolist()))
            for of_action in [np.flatnonzero(labels == name)]
        ]
        best = sorted((b for b in best if np.isfinite(distance[b])), key=lambda b: distance[b])
        best = best[: 1 + others]
        chosen.append(
            Example(
                action,
                int(result.rows[query]),
                tuple(int(result.rows[b]) for b in best),
                tuple(float(distance[b]) for b in best),
            )
        )
    return chosen


def accuracy_table(database: PoseDatabase, config: ActionsConfig = DEFAULTS) -> pd.DataFrame:
    """One row per category: poses, actions and both leave-one-out accuracies."""
    import pandas as pd

    records = []
    for category in database.all_categories():
        actions = database.actions_of(category)
        if len(actions) < 2:
            continue
        records.append(
            {
                "category": category,
                "poses": len(database.rows_of(category)),
                "actions": len(actions),
                "without_the_pose": leave_one_out(database, category, config).accuracy,
                "without_its_base_pose": leave_one_out(
                    database, category, config, by="base"
                ).accuracy,
            }
        )
    return pd.DataFrame.from_records(records)


def _base_numbers(pose_ids: np.ndarray) -> np.ndarray:
    """The same number for all variants of one base pose ("sit_turned_03" -> "sit_turned")."""
    names = [str(name).rsplit("_", 1)[0] for name in pose_ids]
    return np.unique(names, return_inverse=True)[1]


def main() -> None:
    """Print accuracies and the confusion of every category."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("database", nargs="?", type=Path, default=DEFAULT_DATABASE)
    database = load_database(parser.parse_args().database)
    table = accuracy_table(database)
    print(table.to_string(index=False, float_format="%.3f"))
    for category in table["category"]:
        print(f"\n{category}\n{leave_one_out(database, category).confusion.to_string()}")


if __name__ == "__main__":
    main()
