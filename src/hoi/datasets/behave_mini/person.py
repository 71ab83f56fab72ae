"""A person of given shape who can be posed: kinematics in numpy, skin by the body model.

World frame of a scene: y up, the floor is y = 0, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch

from hoi.body import BodyModel, part_vertices
from hoi.body.skeleton import JOINT, PARENTS

SIDES = ("left", "right")


class Pose(NamedTuple):
    """Where the pelvis joint is (3,), and all rotations (24, 3) axis-angle, the root's first."""

    root: np.ndarray
    rotations: np.ndarray


def rotation_matrices(axis_angle: np.ndarray) -> np.ndarray:
    """Rodrigues' formula, (..., 3) radians to (..., 3, 3)."""
    angle = np.sqrt((axis_angle**2).sum(-1, keepdims=True) + 1e-18)
    x, y, z = np.moveaxis(axis_angle / angle, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*x.shape, 3, 3)
    sin, cos = np.sin(angle)[..., None], np.cos(angle)[..., None]
    return np.eye(3) + sin * cross + (1 - cos) * (cross @ cross)


def forward_kinematics(
    rest: np.ndarray, root: np.ndarray, rotations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """World rotations (B, 24, 3, 3) and positions (B, 24, 3) of the joints.

    Args:
        rest: (24, 3) joints of the unposed body; root: (B, 3); rotations: (B, 24, 3).
    """
    local = rotation_matrices(rotations)
    turned, placed = np.empty_like(local), np.empty(rotations.shape)
    turned[:, 0], placed[:, 0] = local[:, 0], root
    for joint in range(1, len(PARENTS)):
        parent = PARENTS[joint]
        turned[:, joint] = turned[:, parent] @ local[:, joint]
        placed[:, joint] = placed[:, parent] + turned[:, parent] @ (rest[joint] - rest[parent])
    return turned, placed


@dataclass(frozen=True, eq=False)
class Person:
    """One body shape. `betas` (K,)."""

    model: BodyModel
    betas: np.ndarray

    @cached_property
    def rest_vertices(self) -> np.ndarray:
        """(V, 3) the unposed body, metres."""
        return self._forward(np.zeros(3), np.zeros((24, 3)))[0]

    @cached_property
    def rest_joints(self) -> np.ndarray:
        """(24, 3) joints of the unposed body."""
        return self._forward(np.zeros(3), np.zeros((24, 3)))[1]

    @cached_property
    def parts(self) -> dict[str, np.ndarray]:
        """Vertex indices by region name."""
        return part_vertices(self.model)

    @property
    def faces(self) -> np.ndarray:
        return self.model.faces

    @cached_property
    def height(self) -> float:
        return float(np.ptp(self.rest_vertices[:, 1]))

    def skin(self, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (V, 3) and joints (24, 3) in world coordinates, float64."""
        return self._forward(pose.root - self.rest_joints[0], pose.rotations)

    def keypoints(self, pose: Pose) -> np.ndarray:
        """(21, 3) the points of `hoi.body.keypoints.KEYPOINTS` in world coordinates."""
        transl = pose.root - self.rest_joints[0]
        with torch.no_grad():
            points = self.model.keypoints(*self._parameters(transl, pose.rotations))
        return points[0].numpy().astype(np.float64)

    def _forward(self, transl: np.ndarray, rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with torch.no_grad():
            posed = self.model(*self._parameters(transl, rotations))
        vertices, joints = (part[0].numpy().astype(np.float64) for part in posed)
        return vertices, joints

    def _parameters(self, transl: np.ndarray, rotations: np.ndarray) -> list[torch.Tensor]:
        """global_orient, body_pose, betas and transl as batches of one."""
        values = (rotations[0], rotations[1:], self.betas, transl)
        return [torch.as_tensor(np.asarray(v, np.float32).reshape(1, -1)) for v in values]

    # ------------------------------------------------------------------ points used as handles

    def palm(self, side: str) -> np.ndarray:
        """(3,) middle of the palm's skin, relative to the wrist joint of the unposed body."""
        return self._palms[side]

    @cached_property
    def _palms(self) -> dict[str, np.ndarray]:
        palms = {}
        for side in SIDES:
            wrist, knuckle = (self.rest_joints[JOINT[f"{side}_{n}"]] for n in ("wrist", "hand"))
            hand = self.rest_vertices[self.parts[f"{side}_hand"]]
            # in T-pose palms face down; the thumb points forward and would pull the mean
            middle = wrist + 0.9 * (knuckle - wrist)
            near = np.abs(hand[:, 0] - middle[0]) < 0.035
            near &= np.abs(hand[:, 2] - middle[2]) < 0.03
            low = hand[near]
            middle[1] = low[:, 1].min() + 0.003 if len(low) else middle[1] - 0.015
            palms[side] = middle - wrist
        return palms

    def sole(self, side: str) -> tuple[np.ndarray, np.ndarray]:
        """Heel relative to the ankle joint and ball relative to the foot joint, each (3,)."""
        foot = self.rest_vertices[self.parts[f"{side}_foot"]]
        floor, back, front = foot[:, 1].min(), foot[:, 2].min(), foot[:, 2].max()
        ankle, ball = (self.rest_joints[JOINT[f"{side}_{n}"]] for n in ("ankle", "foot"))
        heel_point = np.array([ankle[0], floor, back + 0.03])
        ball_point = np.array([ball[0], floor, front - 0.06])
        return heel_point - ankle, ball_point - ball
