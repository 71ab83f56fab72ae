"""Nearest poses by a k-d tree over joint rotations [paper 3.2]."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from hoi.actions.config import ActionsConfig
from hoi.actions.database import PoseDatabase
from hoi.body.skeleton import JOINT, NUM_JOINTS


class Match(NamedTuple):
    """One pose of the database and how far it is."""

    row: int
    distance: float


def pose_features(body_pose: np.ndarray, config: ActionsConfig) -> np.ndarray:
    """What the Euclidean distance is taken over: (N, 69) axis-angle, radians -> (N, D).

    Global orientation is not part of a body pose, so a turned person has the same features.
    """
    poses = np.asarray(body_pose, dtype=np.float64).reshape(-1, NUM_JOINTS - 1, 3)
    vectors = poses[:, [JOINT[name] - 1 for name in config.joints]]
    if config.metric == "axis_angle":
        return vectors.reshape(len(poses), -1)
    return Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(len(poses), -1)


class PoseIndex:
    """The poses of one object category, searchable.

    Args:
        database: labelled poses.
        category: only poses of this object are searched.
        config: metric and joints.

    Raises:
        KeyError: the database has no pose for the category.
    """

    def __init__(self, database: PoseDatabase, category: str, config: ActionsConfig):
        self.rows = database.rows_of(category)
        if not len(self.rows):
            raise KeyError(category)
        self._config = config
        self._actions = database.actions[self.rows]
        self._features = pose_features(database.body_pose[self.rows], config)
        self._tree = cKDTree(self._features)
        self._tree_of = {
            action: (members, cKDTree(self._features[members]))
            for action in sorted(set(self._actions.tolist()))
            for members in [np.flatnonzero(self._actions == action)]
        }

    def nearest(self, body_pose: np.ndarray) -> Match:
        """The single most similar pose (69,); the first of equally near ones."""
        return self._query(self._tree, np.arange(len(self.rows)), self._feature(body_pose))

    def nearest_per_action(self, body_pose: np.ndarray) -> dict[str, Match]:
        """The most similar pose of each action, nearest action first."""
        feature = self._feature(body_pose)
        matches = {
            action: self._query(tree, members, feature)
            for action, (members, tree) in self._tree_of.items()
        }
        return dict(sorted(matches.items(), key=lambda item: (item[1].distance, item[1].row)))

    def _feature(self, body_pose: np.ndarray) -> np.ndarray:
        return pose_features(np.asarray(body_pose).reshape(1, -1), self._config)[0]

    def _query(self, tree: cKDTree, members: np.ndarray, feature: np.ndarray) -> Match:
        distance, index = tree.query(feature)
        return Match(int(self.rows[members[index]]), float(distance))
