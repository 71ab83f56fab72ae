"""Root rotation and limb rotations in closed form from 3D points, by bone directions.

A bone direction fixes two of the three angles of its joint. The third comes from the next bone:
knees and elbows are hinges, so the plane of the bent limb shows where the hinge axis points.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from hoi.body.keypoints import KEYPOINT
from hoi.body.skeleton import JOINT
from hoi.geometry import axis_angle_to_matrix, matrix_to_axis_angle

#: Bend (as sine) at which the plane of a limb and the rest pose's hinge axis count the same.
_STRAIGHT = 0.15


class Limb(NamedTuple):
    """Two bones joined by a hinge: keypoints from near to far, and the joints that turn them."""

    start: str
    middle: str
    end: str
    hinge: tuple[float, float, float]  # axis of positive bending in the rest pose


LIMBS: dict[str, Limb] = {
    "left_arm": Limb("left_shoulder", "left_elbow", "left_wrist", (0.0, -1.0, 0.0)),
    "right_arm": Limb("right_shoulder", "right_elbow", "right_wrist", (0.0, 1.0, 0.0)),
    "left_leg": Limb("left_hip", "left_knee", "left_ankle", (1.0, 0.0, 0.0)),
    "right_leg": Limb("right_hip", "right_knee", "right_ankle", (1.0, 0.0, 0.0)),
}
_SPINE = ("spine1", "spine2", "spine3")


def trunk_rotations(points: Tensor, rest: Tensor) -> tuple[Tensor, Tensor]:
    """World rotations (B, 3, 3) of pelvis and chest from hips and shoulders.

    Args:
        points: (B, 21, 3) posed keypoints. rest: (21, 3) keypoints of the unposed body.
    """
    up = _middle(points, "shoulder") - _middle(points, "hip")
    rest_up = _middle(rest, "shoulder") - _middle(rest, "hip")
    rotations = []
    for joint in ("hip", "shoulder"):
        across = _point(points, f"left_{joint}") - _point(points, f"right_{joint}")
        rest_across = _point(rest, f"left_{joint}") - _point(rest, f"right_{joint}")
        rotations.append(_frame(up, across) @ _frame(rest_up, rest_across).transpose(-1, -2))
    return rotations[0], rotations[1]


def limb_rotations(
    limb: Limb, points: Tensor, rest: Tensor, parent: Tensor
) -> tuple[Tensor, Tensor]:
    """Local rotations (B, 3, 3) of a limb's first joint and of its hinge.

    Args:
        points: (B, 21, 3) posed keypoints. rest: (21, 3) keypoints of the unposed body.
        parent: (B, 3, 3) world rotation of the bone the limb hangs on.
    """
    upper = normalize(_point(points, limb.middle) - _point(points, limb.start), dim=-1)
    lower = normalize(_point(points, limb.end) - _point(points, limb.middle), dim=-1)
    rest_hinge = torch.tensor(limb.hinge, dtype=points.dtype)
    hinge = torch.linalg.cross(upper, lower) + _STRAIGHT * (parent @ rest_hinge)
    rest_upper = _point(rest, limb.middle) - _point(rest, limb.start)
    rest_lower = _point(rest, limb.end) - _point(rest, limb.middle)
    first = _frame(upper, hinge) @ _frame(rest_upper, rest_hinge).transpose(-1, -2)
    second = _frame(lower, hinge) @ _frame(rest_lower, rest_hinge).transpose(-1, -2)
    return parent.transpose(-1, -2) @ first, first.transpose(-1, -2) @ second


def pose_from_points(points: Tensor, rest: Tensor) -> tuple[Tensor, Tensor]:
    """Root rotation (B, 3, 3) and body pose (B, 69) that aim every limb along its points.

    What bones do not show (neck, head, collars, wrists, feet) stays at zero.
    """
    pelvis, chest = trunk_rotations(points, rest)
    rotations = torch.zeros(len(points), 24, 3, dtype=points.dtype)
    bend = matrix_to_axis_angle(pelvis.transpose(-1, -2) @ chest) / len(_SPINE)
    for name in _SPINE:
        rotations[:, JOINT[name]] = bend
    spread = axis_angle_to_matrix(bend)
    top = pelvis @ spread @ spread @ spread
    for limb in LIMBS.values():
        parent = top if "shoulder" in limb.start else pelvis
        first, second = limb_rotations(limb, points, rest, parent)
        rotations[:, JOINT[limb.start]] = matrix_to_axis_angle(first)
        rotations[:, JOINT[limb.middle]] = matrix_to_axis_angle(second)
    return pelvis, rotations[:, 1:].reshape(len(points), 69)


def depth_flips(points: Tensor) -> tuple[list[str], Tensor]:
    """All ways to mirror one or both bones of one limb in depth.

    A bone that leans towards the camera and one that leans away by the same angle look the same:
    the classic ambiguity of one view (Sminchisescu and Triggs, 2003).

    Args:
        points: (21, 3) posed keypoints in the camera frame.
    Returns:
        names and (N, 21, 3) keypoints in which the limb's bones are mirrored about the plane
        across the viewing ray.
    """
    names, variants = [], []
    for name, limb in LIMBS.items():
        start, middle, end = (KEYPOINT[k] for k in (limb.start, limb.middle, limb.end))
        upper, lower = points[middle] - points[start], points[end] - points[middle]
        for which in ("upper", "lower", "both"):
            new_upper = _mirror(upper, points[start]) if which != "lower" else upper
            new_lower = _mirror(lower, points[middle]) if which != "upper" else lower
            flipped = points.clone()
            flipped[middle] = points[start] + new_upper
            flipped[end] = flipped[middle] + new_lower
            names.append(f"{name}_{which}")
            variants.append(flipped)
    return names, torch.stack(variants)


def _mirror(bone: Tensor, origin: Tensor) -> Tensor:
    ray = normalize(origin, dim=-1)
    return bone - 2 * (bone @ ray) * ray


def _point(points: Tensor, name: str) -> Tensor:
    return points[..., KEYPOINT[name], :]


def _middle(points: Tensor, joint: str) -> Tensor:
    return (_point(points, f"left_{joint}") + _point(points, f"right_{joint}")) / 2


def _frame(main: Tensor, side: Tensor) -> Tensor:
    """(..., 3, 3) rotation whose first column is along `main` and second nearest to `side`."""
    first = normalize(main, dim=-1)
    second = normalize(side - (side * first).sum(-1, keepdim=True) * first, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)
