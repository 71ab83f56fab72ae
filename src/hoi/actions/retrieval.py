"""Nearest poses by a k-d tree over joint rotations [paper 3.2]."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree  # type: ignore[attr-defined]
from scipy.spatial.transform import Rotation

from hoi.actions.config import ActionsConfig
from hoi.actions.database import PoseDatabase
from hoi.body.skeleton import JOINT, NUM_JOINTS


class Match(NamedTuple):
    """One pose of the database and how far it is."""

    row: int
    distance: float


def pose_features(
    body_pose: np.ndarray, config: ActionsConfig, pelvis_up: np.ndarray | None = None
) -> np.ndarray:
    """What the Euclidean distance is taken over.

    Args:
        body_pose: (N, 69) axis-angle, radians.
        config: metric, joints and weight of the tilt.
        pelvis_up: (N, 3) upward direction in the pelvis frame, or None to leave the tilt out.

    Returns:
        (N, D). Which way a person faces is not in it.
    """
    rotations = _rotation_features(body_pose, config)
    if pelvis_up is None or config.tilt_weight == 0:
        return rotations
    return np.concatenate((rotations, config.tilt_weight * np.asarray(pelvis_up)), axis=1)


def pelvis_up_in_camera(global_orient: np.ndarray) -> np.ndarray:
    """Upward direction in the pelvis frame (3,) of a body in the camera frame.

    Takes the image's up for up, as nothing better is known of a single photo.
    """
    up_in_camera = np.array([0.0, -1.0, 0.0])
    return Rotation.from_rotvec(np.asarray(global_orient, np.float64)).inv().apply(up_in_camera)


def probabilities(distances: np.ndarray, temperature: float) -> np.ndarray:
    """(A,) probability of each action from the distance (A,) of its nearest pose.

    Softmax of ``-distance / temperature``: an action as near as another is as likely.
    """
    weights = np.exp(-(distances - distances.min()) / temperature)
    return weights / weights.sum()


def _rotation_features(body_pose: np.ndarray, config: ActionsConfig) -> np.ndarray:
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
        ups = database.pelvis_up
        self._has_tilt = ups is not None
        self._features = pose_features(
            database.body_pose[self.rows], config, None if ups is None else ups[self.rows]
        )
        self._tree = cKDTree(self._features)
        self._tree_of = {
            action: (members, cKDTree(self._features[members]))
            for action in sorted(set(self._actions.tolist()))
            for members in [np.flatnonzero(self._actions == action)]
        }

    def nearest(self, body_pose: np.ndarray, pelvis_up: np.ndarray) -> Match:
        """The single most similar pose.

        Args:
            body_pose: (69,) radians.
            pelvis_up: (3,) upward direction in the pelvis frame.
        """
        feature = self._feature(body_pose, pelvis_up)
        return self._query(self._tree, np.arange(len(self.rows)), feature)

    def nearest_per_action(self, body_pose: np.ndarray, pelvis_up: np.ndarray) -> dict[str, Match]:
        """The most similar pose of each action, nearest action first."""
        feature = self._feature(body_pose, pelvis_up)
        matches = {
            action: self._query(tree, members, feature)
            for action, (members, tree) in self._tree_of.items()
        }
        return dict(sorted(matches.items(), key=lambda item: (item[1].distance, item[1].row)))

    def _feature(self, body_pose: np.ndarray, pelvis_up: np.ndarray) -> np.ndarray:
        pose = np.asarray(body_pose).reshape(1, -1)
        up = np.asarray(pelvis_up).reshape(1, 3) if self._has_tilt else None
        return pose_features(pose, self._config, up)[0]

    def _query(self, tree: cKDTree, members: np.ndarray, feature: np.ndarray) -> Match:
        distance, index = tree.query(feature)
        return Match(int(self.rows[members[index]]), float(distance))
