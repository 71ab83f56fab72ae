"""Linear blend skinning for SMPL-format bodies, in torch, batch first and differentiable.

Source: Loper et al., SMPL (2015), Eqs. 2-10. With shape blend shapes B_S, pose blend shapes B_P,
joint regressor J and skinning weights W, a vertex is

    sum_j W_j G_j(theta, J) (v_template + B_S(betas) + B_P(theta))

The joints depend on the vertices only through ``J (v_template + B_S)``, which is linear in the
betas, so joints alone cost neither skinning nor vertices and are exact.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from hoi.body.files import BodyFile, read_body_file
from hoi.body.keypoints import KEYPOINTS, SURFACE_KEYPOINTS
from hoi.body.skeleton import JOINT, JOINT_NAMES, NUM_JOINTS, PARENTS, levels
from hoi.geometry import axis_angle_to_matrix

_LEVELS = levels()
_BY_LEVEL = [joint for level in _LEVELS for joint in level]
_LEVEL_SIZES = [len(level) for level in _LEVELS]
_FROM_BY_LEVEL = np.argsort(_BY_LEVEL)


class BodyOutput(NamedTuple):
    """What a posed body is: vertices (B, V, 3) and joints (B, 24, 3), metres."""

    vertices: Tensor
    joints: Tensor


class _Skin(NamedTuple):
    """Everything skinning needs to know of a set of points of the body."""

    template: Tensor  # (P, 3)
    shapedirs: Tensor  # (P * 3, K)
    posedirs: Tensor | None  # (207, P * 3)
    weights: Tensor  # (P, 24)


class BodyModel(torch.nn.Module):
    """A parametric body of 24 joints.

    Parameters of every call: `global_orient` (B, 3) and `body_pose` (B, 69) axis-angle radians,
    `betas` (B, K) unit variance, `transl` (B, 3) metres. The rotation of the root turns about the
    pelvis joint, then `transl` is added, as in SMPL.
    """

    joint_names: tuple[str, ...] = JOINT_NAMES
    parents: tuple[int, ...] = PARENTS

    _joint_template: Tensor
    _joint_dirs: Tensor
    _keypoint_rows: Tensor

    def __init__(self, data: BodyFile, num_betas: int = 10, dtype: torch.dtype = torch.float32):
        super().__init__()
        self.faces: np.ndarray = data.faces
        self.num_vertices = len(data.v_template)
        self.num_betas = min(num_betas, data.shapedirs.shape[-1])
        self.identity = _identity(data)
        #: (V, 3) float64 template and (V, 24) weights as numpy, for geometry done once.
        self.v_template: np.ndarray = data.v_template
        self.weights: np.ndarray = data.weights
        self.template_joints: np.ndarray = data.joint_regressor @ data.v_template

        def buffer(name: str, values: np.ndarray | None) -> None:
            tensor = None if values is None else torch.as_tensor(values, dtype=dtype)
            self.register_buffer(name, tensor, persistent=False)

        shapedirs = data.shapedirs[..., : self.num_betas]
        joint_dirs = np.einsum("jv,vck->jck", data.joint_regressor, shapedirs)
        buffer("_joint_template", self.template_joints)
        buffer("_joint_dirs", joint_dirs.reshape(NUM_JOINTS * 3, -1))
        on_skin = np.flatnonzero(data.keypoint_regressor.any(0))
        buffer("_keypoint_rows", data.keypoint_regressor[:, on_skin])
        for name, points in (("all", slice(None)), ("keypoint", on_skin)):
            dirs = data.posedirs[points]
            buffer(f"_{name}_template", data.v_template[points])
            buffer(f"_{name}_shapedirs", shapedirs[points].reshape(-1, self.num_betas))
            buffer(
                f"_{name}_posedirs",
                dirs.reshape(-1, dirs.shape[-1]).T if np.any(data.posedirs) else None,
            )
            buffer(f"_{name}_weights", data.weights[points])

    @classmethod
    def load(
        cls, path: Path | str, num_betas: int = 10, dtype: torch.dtype = torch.float32
    ) -> Self:
        """Load an SMPL-format ``.npz`` or an SMPL ``.pkl``; raises AssetError."""
        return cls(read_body_file(path), num_betas=num_betas, dtype=dtype)

    def forward(
        self, global_orient: Tensor, body_pose: Tensor, betas: Tensor, transl: Tensor | None = None
    ) -> BodyOutput:
        """Vertices (B, V, 3) and joints (B, 24, 3), metres."""
        pose = _Pose(self, global_orient, body_pose, betas)
        vertices = pose.skin(self._skin("all"))
        return BodyOutput(_shift(vertices, transl), _shift(pose.joints, transl))

    def joints(
        self, global_orient: Tensor, body_pose: Tensor, betas: Tensor, transl: Tensor | None = None
    ) -> Tensor:
        """Joints (B, 24, 3) alone: equal to those of forward, at a fraction of the cost."""
        return _shift(_Pose(self, global_orient, body_pose, betas).joints, transl)

    def keypoints(
        self, global_orient: Tensor, body_pose: Tensor, betas: Tensor, transl: Tensor | None = None
    ) -> Tensor:
        """The (B, 21, 3) points in the order of :data:`hoi.body.keypoints.KEYPOINTS`.

        Only the few skin vertices that make nose, eyes, ears, toes and heels are skinned.
        """
        pose = _Pose(self, global_orient, body_pose, betas)
        on_skin = self._keypoint_rows @ pose.skin(self._skin("keypoint"))
        points = torch.cat([pose.joints, on_skin], dim=1)[:, _KEYPOINT_SOURCE]
        return _shift(points, transl)

    def _skin(self, points: str) -> _Skin:
        return _Skin(
            *(getattr(self, f"_{points}_{field}") for field in _Skin._fields)  # type: ignore[arg-type]
        )


#: Column of [24 joints, 9 surface points] that is each keypoint.
_KEYPOINT_SOURCE = [
    JOINT[name] if name in JOINT else NUM_JOINTS + SURFACE_KEYPOINTS.index(name)
    for name in KEYPOINTS
]


class _Pose:
    """One batch of posed skeletons: rotations, posed joints, and skinning of points onto them."""

    def __init__(self, model: BodyModel, global_orient: Tensor, body_pose: Tensor, betas: Tensor):
        batch = len(global_orient)
        if body_pose.shape != (batch, 69) or global_orient.shape != (batch, 3):
            raise ValueError(
                f"global_orient {tuple(global_orient.shape)} and body_pose "
                f"{tuple(body_pose.shape)} should be (B, 3) and (B, 69)"
            )
        if betas.shape != (batch, model.num_betas):
            raise ValueError(f"betas {tuple(betas.shape)} should be ({batch}, {model.num_betas})")
        self.betas = betas
        axis_angle = torch.cat([global_orient, body_pose], dim=1).view(batch, NUM_JOINTS, 3)
        self.local = axis_angle_to_matrix(axis_angle)
        self.rest = model._joint_template + (betas @ model._joint_dirs.T).view(-1, NUM_JOINTS, 3)
        self.world = posed_transforms(self.local, self.rest)

    @property
    def joints(self) -> Tensor:
        return self.world[..., 3]

    def skin(self, points: _Skin) -> Tensor:
        """Posed points (B, P, 3)."""
        batch, count = len(self.betas), len(points.template)
        shaped = points.template + (self.betas @ points.shapedirs.T).view(batch, count, 3)
        if points.posedirs is not None:
            identity = torch.eye(3, dtype=shaped.dtype, device=shaped.device)
            feature = (self.local[:, 1:] - identity).reshape(batch, -1)
            shaped = shaped + (feature @ points.posedirs).view(batch, count, 3)
        rotation = self.world[..., :3]
        offset = self.joints - (rotation @ self.rest[..., None])[..., 0]
        relative = torch.cat([rotation, offset[..., None]], dim=-1).view(batch, NUM_JOINTS, 12)
        blended = (points.weights @ relative).view(batch, count, 3, 4)
        return (blended[..., :3] @ shaped[..., None])[..., 0] + blended[..., 3]


def posed_transforms(local: Tensor, rest: Tensor) -> Tensor:
    """Forward kinematics: world transforms [R | t] of every joint.

    All joints of one depth of the tree move in one product, which is 9 products and not 24.

    Args:
        local: (B, 24, 3, 3) rotations relative to the parent.
        rest: (B, 24, 3) joints of the unposed body, metres.
    Returns:
        (B, 24, 3, 4); the last column is the posed joint.
    """
    parents = list(PARENTS)
    offset = torch.cat([rest[:, :1], rest[:, 1:] - rest[:, parents[1:]]], dim=1)
    step = torch.cat([local, offset[..., None]], dim=-1)[:, _BY_LEVEL]
    steps = step.split(_LEVEL_SIZES, dim=1)
    done = [steps[0]]
    for depth in range(1, len(_LEVELS)):
        above = _LEVELS[depth - 1]
        parent = done[-1][:, [above.index(PARENTS[joint]) for joint in _LEVELS[depth]]]
        moved = parent[..., :3] @ steps[depth]
        shift = torch.nn.functional.pad(parent[..., 3:], (3, 0))
        done.append(moved + shift)
    return torch.cat(done, dim=1)[:, _FROM_BY_LEVEL]


def _shift(points: Tensor, transl: Tensor | None) -> Tensor:
    return points if transl is None else points + transl[:, None]


def _identity(data: BodyFile) -> str:
    """Equal for files of one topology and template; says when vertices may be matched by index."""
    digest = hashlib.sha256()
    digest.update(np.ascontiguousarray(data.v_template, dtype="<f4").tobytes())
    digest.update(np.ascontiguousarray(data.faces, dtype="<i8").tobytes())
    return f"smpl24-{len(data.v_template)}v-{digest.hexdigest()[:16]}"
