"""How well the database recognises its own poses: each one is looked up among the others.

``python -m hoi.actions.leave_one_out [database.npz]`` prints the table.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree  # type: ignore[attr-defined]

from hoi.actions.config import ActionsConfig
from hoi.actions.database import DEFAULT_DATABASE, PoseDatabase, load_database
from hoi.actions.retrieval import pose_features

if TYPE_CHECKING:
    import pandas as pd

DEFAULTS = ActionsConfig()  # type: ignore[call-arg]  # every field has a default


@dataclass(frozen=True)
class LeaveOneOut:
    """Leave-one-out recognition of one object category.

    Attributes:
        accuracy: share of poses whose nearest other pose has the same action.
        confusion: counts; rows are true actions, columns retrieved ones.
        distances: (N,) distance to the nearest other pose.
    """

    category: str
    accuracy: float
    confusion: pd.DataFrame
    distances: np.ndarray


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
    distances = np.empty(len(rows))
    for group in np.unique(groups):
        left_out, others = np.flatnonzero(groups == group), np.flatnonzero(groups != group)
        if not len(others):
            raise ValueError(f"nothing is left of {category!r} without one {by}")
        distances[left_out], found = cKDTree(features[others]).query(features[left_out])
        nearest[left_out] = others[found]
    retrieved = actions[nearest]
    confusion = pd.crosstab(
        pd.Series(actions, name="action"), pd.Series(retrieved, name="retrieved")
    )
    return LeaveOneOut(category, float(np.mean(retrieved == actions)), confusion, distances)


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
