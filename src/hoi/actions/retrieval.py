"""Nearest poses by a k-d tree over joint rotations [paper 3.2]."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from hoi.actions.config import ActionsConfig
from hoi.actions.database import PoseDatabase
from hoi.body.skeleton import JOINT, NUM_JOINTS, PARENTS

_BONES = {
    # joint whose rotation moves the bone -> direction of the bone at rest (T-pose)
    "left_hip": (0, -1, 0), "right_hip": (0, -1, 0),
    "left_knee": (0, -1, 0), "right_knee": (0, -1, 0),
    "spine3": (0, 1, 0), "left_collar": (1, 0, 0), "right_collar": (-1, 0, 0),
    "left_shoulder": (1, 0, 0), "right_shoulder": (-1, 0, 0),
    "left_elbow": (1, 0, 0), "right_elbow": (-1, 0, 0),
}  # fmt: skip


class Match(NamedTuple):
    """One pose of the database and how far it is."""

    row: int
    distance: float


def pose_features(body_pose: np.ndarray, config: ActionsConfig) -> np.ndarray:
    """What the Euclidean distance is taken over: (N, 69) axis-angle, radians -> (N, D).

    Global orientation is not part of a body pose, so a turned person has the same features.
    """
    poses = np.asarray(body_pose, dtype=np.float64).reshape(-1, NUM_JOINTS - 1, 3)
    joints = [JOINT[name] for name in config.joints]
    if config.metric == "axis_angle":
        return poses[:, [joint - 1 for joint in joints]].reshape(len(poses), -1)
    if config.metric == "rotation_matrix":
        vectors = poses[:, [joint - 1 for joint in joints]].reshape(-1, 3)
        return Rotation.from_rotvec(vectors).as_matrix().reshape(len(poses), -1)
    return _bone_directions(poses, joints)


def _bone_directions(poses: np.ndarray, joints: list[int]) -> np.ndarray:
    local = Rotation.from_rotvec(poses.reshape(-1, 3)).as_matrix()
    local = local.reshape(len(poses), NUM_JOINTS - 1, 3, 3)
    pelvis_from_joint = [np.broadcast_to(np.eye(3), (len(poses), 3, 3))]
    for joint in range(1, NUM_JOINTS):
        pelvis_from_joint.append(pelvis_from_joint[PARENTS[joint]] @ local[:, joint - 1])
    directions = [
        pelvis_from_joint[JOINT[name]] @ np.array(bone, dtype=np.float64)
        for name, bone in _BONES.items()
        if JOINT[name] in joints
    ]
    return np.concatenate(directions, axis=1)


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
