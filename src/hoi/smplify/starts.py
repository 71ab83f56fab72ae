"""Where the fit starts: 3D landmarks, database poses facing several ways, flipped limbs."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from hoi.body.keypoints import KEYPOINT
from hoi.body.skeleton import JOINT
from hoi.geometry import axis_angle_to_matrix, matrix_to_axis_angle
from hoi.smplify.energy import Bodies
from hoi.smplify.limbs import LIMBS, depth_flips, limb_rotations, pose_from_points

_MIN_DEPTH = 0.5  # metres
_BONES = tuple(
    (KEYPOINT[a], KEYPOINT[b])
    for limb in LIMBS.values()
    for a, b in ((limb.start, limb.middle), (limb.middle, limb.end))
)


def scale_landmarks(landmarks: Tensor, rest: Tensor) -> Tensor:
    """Landmarks (21, 3) centred between the hips and resized to the average body's limbs.

    Detectors' landmarks tell pose and not stature, and size cannot be seen in one image anyway.
    """
    hips = landmarks[[KEYPOINT["left_hip"], KEYPOINT["right_hip"]]].mean(0)
    first, second = [a for a, _ in _BONES], [b for _, b in _BONES]
    have = (landmarks[first] - landmarks[second]).norm(dim=-1).sum()
    want = (rest[first] - rest[second]).norm(dim=-1).sum()
    return (landmarks - hips) * (want / have.clamp(min=1e-3))


def landmark_start(landmarks: Tensor, rest: Tensor, num_betas: int) -> Bodies:
    """One body (B = 1) whose limbs point along the landmarks; translation still zero."""
    root, body_pose = pose_from_points(landmarks[None], rest)
    return Bodies(
        root, body_pose, torch.zeros(1, num_betas).to(landmarks), torch.zeros(1, 3).to(landmarks)
    )


def database_starts(poses: Tensor, yaws: int, num_betas: int) -> Bodies:
    """Every pose (N, 69) upright in the image, facing each of `yaws` directions: B = N * yaws."""
    angles = torch.arange(yaws, dtype=poses.dtype) * (2 * math.pi / yaws)
    about_y = torch.stack([torch.zeros(yaws), angles, torch.zeros(yaws)], dim=-1).to(poses)
    facing = torch.diag(torch.tensor([1.0, -1.0, -1.0])).to(poses) @ axis_angle_to_matrix(about_y)
    count = len(poses) * yaws
    return Bodies(
        facing.repeat(len(poses), 1, 1),
        poses.repeat_interleave(yaws, 0),
        torch.zeros(count, num_betas).to(poses),
        torch.zeros(count, 3).to(poses),
    )


def solve_translation(
    points: Tensor, keypoints: Tensor, confidence: Tensor, intrinsics: Tensor
) -> Tensor:
    """Translations (B, 3) that put points over their image keypoints under weak perspective.

    Depth from the ratio of the spreads in space and image, then the offset of the centres.

    Args:
        points: (B, 21, 3) metres. keypoints: (21, 2) pixels. confidence: (21,).
    """
    share = confidence / confidence.sum()
    focal = torch.stack([intrinsics[0, 0], intrinsics[1, 1]])
    rays = (keypoints - intrinsics[:2, 2]) / focal
    ray_centre = share @ rays
    centre = torch.einsum("k,bkc->bc", share, points)
    image_spread = (share @ (rays - ray_centre).square().sum(-1)).sqrt().clamp(min=1e-6)
    across = (points - centre[:, None])[..., :2].square().sum(-1)
    depth = ((across @ share).sqrt() / image_spread).clamp(min=_MIN_DEPTH)
    wanted = torch.cat([ray_centre * depth[:, None], depth[:, None]], dim=-1)
    return wanted - centre


def flipped_starts(body: Bodies, points: Tensor, rest: Tensor) -> tuple[list[str], Bodies]:
    """Variants of one body (B = 1) with the bones of one limb mirrored in depth.

    Args:
        body: the body. points: (21, 3) its keypoints in the camera frame. rest: (21, 3).
    """
    names, variants = depth_flips(points)
    count = len(names)
    flipped = Bodies(*(field.expand(count, *field.shape[1:]).clone() for field in body))
    rotations = flipped.body_pose.view(count, 23, 3)
    chest = _chest_rotation(body)
    for limb_name, limb in LIMBS.items():
        rows = [i for i, name in enumerate(names) if name.startswith(limb_name)]
        side = limb.start.split("_")[0]
        parent = body.root[0]
        if "shoulder" in limb.start:
            parent = chest @ axis_angle_to_matrix(_joint(body, f"{side}_collar"))
        first, second = limb_rotations(limb, variants[rows], rest, parent.expand(len(rows), 3, 3))
        rotations[rows, JOINT[limb.start] - 1] = matrix_to_axis_angle(first)
        rotations[rows, JOINT[limb.middle] - 1] = matrix_to_axis_angle(second)
    return names, flipped


def _chest_rotation(body: Bodies) -> Tensor:
    rotation = body.root[0]
    for name in ("spine1", "spine2", "spine3"):
        rotation = rotation @ axis_angle_to_matrix(_joint(body, name))
    return rotation


def _joint(body: Bodies, name: str) -> Tensor:
    return body.body_pose.view(-1, 23, 3)[0, JOINT[name] - 1]
