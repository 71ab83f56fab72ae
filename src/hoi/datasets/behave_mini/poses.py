"""Hand-authored starting poses of the staged actions.

They belong to this data set alone: the pose database of the action stage is authored elsewhere,
and jitter and reaching move each frame's pose further away from any of these. Axis-angle radians
on SMPL's joints; ``both_`` sets the left joint and mirrors it (x kept, y and z negated).
"""

from __future__ import annotations

import numpy as np

from hoi.body.skeleton import JOINT

_MIRROR = np.array([1.0, -1.0, -1.0])


def authored(**joints: tuple[float, float, float]) -> np.ndarray:
    """(24, 3) rotations from joint names; ``root`` is the pelvis."""
    rotations = np.zeros((24, 3))
    for name, value in joints.items():
        if name.startswith("both_"):
            rotations[JOINT[f"left_{name[5:]}"]] = value
            rotations[JOINT[f"right_{name[5:]}"]] = np.array(value) * _MIRROR
        else:
            rotations[0 if name == "root" else JOINT[name]] = value
    return rotations


_HANGING = dict(both_shoulder=(0.1, -0.12, -1.2), both_elbow=(0.0, -0.32, 0.0))
_SEATED = dict(both_hip=(-1.45, 0.12, 0.12), both_knee=(1.42, 0.0, 0.0))
_REACHING = dict(both_shoulder=(0.0, -0.85, -0.95), both_elbow=(0.0, -0.55, 0.0))

STAND = (
    authored(**_HANGING),
    authored(spine1=(0.06, 0.12, 0.0), neck=(0.12, 0.15, 0.0), **_HANGING),
    authored(
        left_hip=(-0.12, 0.0, 0.05),
        right_hip=(0.08, 0.0, -0.05),
        spine2=(0.0, -0.1, 0.03),
        **_HANGING,
    ),
)
LEAN = (
    authored(root=(0.3, 0, 0), both_hip=(-0.42, 0, 0.06), both_knee=(0.22, 0, 0),
             spine1=(0.18, 0, 0), head=(-0.2, 0, 0), **_REACHING),
    authored(root=(0.18, 0, 0), both_hip=(-0.22, 0, 0.08), spine2=(0.2, 0, 0), **_REACHING),
)  # fmt: skip
STOOP = (
    authored(root=(0.7, 0, 0), both_hip=(-1.25, 0.05, 0.18), both_knee=(0.85, 0, 0),
             both_ankle=(-0.3, 0, 0), spine2=(0.22, 0, 0), head=(-0.35, 0, 0), **_REACHING),
    authored(root=(0.5, 0, 0), both_hip=(-1.3, 0.1, 0.25), both_knee=(1.3, 0, 0),
             both_ankle=(-0.45, 0, 0), spine1=(0.15, 0, 0), head=(-0.25, 0, 0), **_REACHING),
)  # fmt: skip
SQUAT = (
    authored(root=(0.45, 0, 0), both_hip=(-1.85, 0.15, 0.35), both_knee=(1.95, 0, 0),
             both_ankle=(-0.5, 0, 0), spine2=(0.15, 0, 0), head=(-0.2, 0, 0), **_REACHING),
)  # fmt: skip
LIFT = (
    authored(root=(0.22, 0, 0), both_hip=(-0.5, 0.05, 0.1), both_knee=(0.45, 0, 0),
             both_ankle=(-0.15, 0, 0), head=(0.12, 0, 0), **_REACHING),
    authored(spine1=(-0.06, 0, 0), both_hip=(-0.12, 0, 0.08), both_knee=(0.2, 0, 0), **_REACHING),
    authored(left_hip=(-0.35, 0, 0.06), left_knee=(0.3, 0, 0), right_hip=(0.18, 0, -0.06),
             right_knee=(0.12, 0, 0), spine2=(0.08, 0.06, 0), **_REACHING),
)  # fmt: skip
RAISE = (
    authored(spine1=(-0.08, 0, 0), both_shoulder=(0, -0.75, -0.25), both_elbow=(0, -1.1, 0)),
    authored(spine2=(-0.06, 0, 0), both_hip=(-0.05, 0, 0.1), both_shoulder=(0, -0.4, 0.5),
             both_elbow=(0, -0.9, 0), head=(-0.2, 0, 0)),
)  # fmt: skip
SIT = (
    authored(both_shoulder=(0.0, -0.4, -1.05), both_elbow=(0.0, -0.9, 0.0), **_SEATED),
    authored(spine1=(0.16, 0, 0), spine2=(0.1, 0.08, 0), head=(-0.08, 0.2, 0),
             both_shoulder=(0.0, -0.6, -0.95), both_elbow=(0.0, -1.0, 0.0), **_SEATED),
    authored(root=(-0.12, 0, 0), both_shoulder=(0.1, -0.2, -1.15), both_elbow=(0.0, -0.7, 0.0),
             **_SEATED),
    authored(spine2=(0.05, -0.2, 0.0), neck=(0.05, -0.3, 0), left_hip=(-1.4, 0.25, 0.3),
             right_hip=(-1.5, -0.05, -0.05), both_knee=(1.3, 0, 0),
             both_shoulder=(0.0, -0.45, -1.1), both_elbow=(0.0, -0.8, 0.0)),
)  # fmt: skip
RISE = (
    authored(root=(0.55, 0, 0), both_hip=(-1.55, 0.1, 0.15), both_knee=(1.35, 0, 0),
             both_ankle=(-0.35, 0, 0), spine1=(0.15, 0, 0), head=(-0.3, 0, 0),
             both_shoulder=(0.0, -0.6, -0.95), both_elbow=(0.0, -0.6, 0.0)),
    authored(root=(0.75, 0, 0), both_hip=(-1.6, 0.12, 0.18), both_knee=(1.2, 0, 0),
             both_ankle=(-0.3, 0, 0), head=(-0.45, 0, 0),
             both_shoulder=(0.0, -0.95, -0.7), both_elbow=(0.0, -0.35, 0.0)),
)  # fmt: skip
PUSH = (
    authored(root=(0.3, 0, 0), left_hip=(-0.65, 0, 0.05), left_knee=(0.5, 0, 0),
             right_hip=(0.1, 0, -0.05), right_knee=(0.25, 0, 0), right_ankle=(0.25, 0, 0),
             both_shoulder=(0, -1.2, -0.5), both_elbow=(0, -0.4, 0)),
    authored(root=(0.42, 0, 0), right_hip=(-0.75, 0, -0.05), right_knee=(0.55, 0, 0),
             left_hip=(-0.1, 0, 0.05), left_knee=(0.3, 0, 0), left_ankle=(0.2, 0, 0),
             both_shoulder=(0, -1.25, -0.55), both_elbow=(0, -0.3, 0)),
)  # fmt: skip
WALK = (
    authored(left_hip=(-0.4, 0, 0.04), left_knee=(0.2, 0, 0), right_hip=(0.3, 0, -0.04),
             right_knee=(0.3, 0, 0), right_ankle=(0.2, 0, 0), **_HANGING),
    authored(right_hip=(-0.35, 0, -0.04), right_knee=(0.15, 0, 0), left_hip=(0.25, 0, 0.04),
             left_knee=(0.35, 0, 0), left_ankle=(0.2, 0, 0), **_HANGING),
)  # fmt: skip
HUG = (
    authored(both_shoulder=(0, -1.05, -0.75), both_elbow=(0, -1.45, 0), head=(0.1, 0, 0)),
    authored(spine1=(-0.05, 0, 0), both_shoulder=(0.1, -0.95, -0.9), both_elbow=(0, -1.55, 0)),
)
WORN = (
    authored(both_shoulder=(0.15, -0.2, -1.15), both_elbow=(0, -1.7, -0.2)),
    authored(spine1=(0.08, 0, 0), **_HANGING),
    authored(
        left_hip=(-0.3, 0, 0.04), left_knee=(0.2, 0, 0), right_hip=(0.2, 0, -0.04),
        right_knee=(0.2, 0, 0), **_HANGING,
    ),
)  # fmt: skip


def pick(rng: np.random.Generator, poses: tuple[np.ndarray, ...], jitter: float) -> np.ndarray:
    """One of the poses with every joint jittered, half the time mirrored. (24, 3)."""
    from hoi.body.skeleton import MIRROR

    rotations = poses[rng.integers(len(poses))] + rng.normal(0.0, jitter, (24, 3))
    rotations[[JOINT["left_hand"], JOINT["right_hand"]]] = 0.0
    if rng.random() < 0.5:
        rotations = rotations[list(MIRROR)] * _MIRROR
    rotations[JOINT["head"], :2] += rng.normal(0.0, 0.12, 2)
    return rotations


def curl_fingers(rotations: np.ndarray, side: str, angle: float) -> None:
    """Bend the fingers of one hand towards its palm, in place."""
    rotations[JOINT[f"{side}_hand"], 2] = -angle if side == "left" else angle
