"""Keypoints with their exact derivatives, for second-order fitting.

Automatic differentiation of a kinematic chain costs a hundred small operations per output; the
derivative is known in closed form: a joint turns every point below it about the joint's centre.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from hoi.body.keypoints import KEYPOINTS, SURFACE_KEYPOINTS
from hoi.body.model import BodyModel, posed_transforms
from hoi.body.skeleton import JOINT, NUM_JOINTS, PARENTS
from hoi.geometry import axis_angle_to_matrix

#: Columns of the derivative: root rotation, 23 joint rotations, then betas; see `Posed.derivative`.
NUM_ROTATION_PARAMETERS = 3 * NUM_JOINTS
_NEGLIGIBLE_WEIGHT = 1e-3


class Posed(NamedTuple):
    """Keypoints (B, 21, 3) without translation, and their derivative (B, 21, 3, 72 + K).

    Column 0..2 of the derivative: a small rotation of the whole body, as a vector in world axes,
    applied after the current root rotation. Columns 3..71: the axis-angle body pose. Then betas.
    """

    keypoints: Tensor
    derivative: Tensor
    up: Tensor  # (B, 3) the root's y axis in the world


class KeypointKinematics:
    """Skinned keypoints of a body model as a function of root rotation, body pose and betas.

    The blend of a surface keypoint over several joints is exact; the pose blend shapes of real
    SMPL (a millimetre or two on the head and the feet) are left out.
    """

    def __init__(self, model: BodyModel):
        """Gather, from `model`, one rigid point per (keypoint, joint) pair and how they blend."""
        skin = model._skin("keypoint")
        dtype = model._joint_template.dtype
        self.num_betas = model.num_betas
        self._rest = model._joint_template
        self._rest_dirs = model._joint_dirs.view(NUM_JOINTS, 3, -1)
        vertex_dirs = skin.shapedirs.view(len(skin.template), 3, -1)

        owners, templates, dirs, blend = [], [], [], []
        for row, name in enumerate(KEYPOINTS):
            if name in JOINT:
                joint = JOINT[name]
                owners.append(joint)
                templates.append(self._rest[joint])
                dirs.append(self._rest_dirs[joint])
                blend.append((row, 1.0))
                continue
            shares = model._keypoint_rows[SURFACE_KEYPOINTS.index(name)][:, None] * skin.weights
            total = shares.sum(0)
            total = torch.where(total > _NEGLIGIBLE_WEIGHT, total, torch.zeros_like(total))
            for joint in torch.nonzero(total)[:, 0].tolist():
                share = shares[:, joint] / total[joint]
                owners.append(joint)
                templates.append(share @ skin.template)
                dirs.append(torch.einsum("v,vck->ck", share, vertex_dirs))
                blend.append((row, float(total[joint] / total.sum())))
        self._owners = owners
        self._points = torch.stack(templates)
        self._point_dirs = torch.stack(dirs)
        self._blend = torch.zeros(len(KEYPOINTS), len(owners), dtype=dtype)
        for column, (row, amount) in enumerate(blend):
            self._blend[row, column] = amount
        below = torch.tensor(_is_ancestor(), dtype=dtype)  # (joint, ancestor or itself)
        #: share of each keypoint that every joint carries: (21, points, 24)
        self._carried = self._blend[:, :, None] * below[owners][None]

    def __call__(self, root: Tensor, body_pose: Tensor, betas: Tensor) -> Posed:
        """Root rotation (B, 3, 3), body pose (B, 69) radians, betas (B, K)."""
        batch = len(root)
        axis_angle = body_pose.view(batch, NUM_JOINTS - 1, 3)
        local = torch.cat([root[:, None], axis_angle_to_matrix(axis_angle)], dim=1)
        rest = self._rest + torch.einsum("jck,bk->bjc", self._rest_dirs, betas)
        world = posed_transforms(local, rest)
        rotation, joints = world[..., :3], world[..., 3]

        arms = self._points + torch.einsum("mck,bk->bmc", self._point_dirs, betas)
        arms = arms - rest[:, self._owners]
        points = (rotation[:, self._owners] @ arms[..., None])[..., 0] + joints[:, self._owners]
        keypoints = self._blend @ points

        axes = self._world_axes(rotation, axis_angle)
        # lever arm of keypoint k about joint i: sum of its carried points minus the joint
        lever = torch.einsum("kmi,bmc->bkic", self._carried, points)
        lever = lever - self._carried.sum(1)[None, :, :, None] * joints[:, None]
        turned = torch.linalg.cross(
            axes.transpose(-1, -2)[:, None], lever[:, :, :, None, :], dim=-1
        )  # (B, 21, 24, 3 columns, 3)
        by_rotation = turned.flatten(2, 3).transpose(-1, -2)
        derivative = torch.cat([by_rotation, self._shape_derivative(rotation)], dim=-1)
        return Posed(keypoints, derivative, root[..., 1])

    def _world_axes(self, rotation: Tensor, axis_angle: Tensor) -> Tensor:
        """(B, 24, 3, 3): world rotation vector per unit of each rotation parameter."""
        parents = rotation[:, list(PARENTS[1:])]
        identity = torch.eye(3, dtype=rotation.dtype).expand(len(rotation), 1, 3, 3)
        return torch.cat([identity, parents @ left_jacobian(axis_angle)], dim=1)

    def _shape_derivative(self, rotation: Tensor) -> Tensor:
        """(B, 21, 3, K): how keypoints move with the betas."""
        bone_dirs = self._rest_dirs[1:] - self._rest_dirs[list(PARENTS[1:])]
        moved = rotation[:, list(PARENTS[1:])] @ bone_dirs  # (B, 23, 3, K)
        root = self._rest_dirs[:1].expand(len(rotation), 1, 3, -1)
        along_chain = torch.cat([root, moved], dim=1)
        own = rotation[:, self._owners] @ (self._point_dirs - self._rest_dirs[self._owners])
        chain = torch.einsum("ki,bicn->bkcn", self._carried.sum(1), along_chain)
        return chain + torch.einsum("km,bmcn->bkcn", self._blend, own)


def left_jacobian(axis_angle: Tensor) -> Tensor:
    """(..., 3, 3) J with exp(v + dv) = exp(J dv) exp(v) to first order."""
    squared = axis_angle.square().sum(-1)[..., None, None]
    small = squared < 1e-6
    safe = torch.where(small, torch.ones_like(squared), squared)
    angle = safe.sqrt()
    first = torch.where(small, 0.5 - squared / 24, (1 - angle.cos()) / safe)
    second = torch.where(small, 1 / 6 - squared / 120, (angle - angle.sin()) / (safe * angle))
    x, y, z = axis_angle.unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1)
    skew = skew.view(*axis_angle.shape[:-1], 3, 3)
    identity = torch.eye(3, dtype=axis_angle.dtype, device=axis_angle.device)
    return identity + first * skew + second * (skew @ skew)


def _is_ancestor() -> list[list[float]]:
    """Row j marks joint j and all its ancestors: the joints whose rotation moves j's points."""
    rows = []
    for joint in range(NUM_JOINTS):
        row = [0.0] * NUM_JOINTS
        while joint >= 0:
            row[joint] = 1.0
            joint = PARENTS[joint]
        rows.append(row)
    return rows
