"""From readable descriptions of poses to SMPL rotations.

Poses are written down as a person would describe them (``data/poses/base_poses.yaml``): how far
the trunk leans, where the thighs point, how far the knees bend, and where the palms are. This
module turns such a description into the rotations of SMPL's joints. The limbs are those of an
average adult; palms are placed by closed-form two-bone inverse kinematics.

Frame: the person's own level frame, origin at the pelvis joint, x to the person's left, y up,
z forward. Angles in the file are degrees, lengths metres. "Outward" means away from the body's
middle, so that one description serves both sides.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from hoi.body.skeleton import JOINT, NUM_JOINTS

_SHOULDER = np.array([0.172, 0.466, 0.007])  # left shoulder of an average adult in T-pose
_SPINE = np.array([[0, 0.112, -0.031], [0, 0.221, -0.023], [0, 0.362, -0.033]])  # spine1..spine3
_UPPER_ARM = 0.244
_FOREARM = 0.308  # elbow to palm
_REACH = 0.985  # of the arm's length; a person rarely locks the elbow
_NEAREST_PALM = 0.177  # metres from the shoulder, with the elbow bent by 145 degrees
_SPINE_SHARE = (0.3, 0.4, 0.3)  # of the trunk's bend, from spine1 to spine3
_FLIP = np.diag([-1.0, 1.0, 1.0])  # left-right mirror
_ELBOW_HANGS = (0.35, -1.0, -0.45)


@dataclass(frozen=True)
class Trunk:
    """Degrees. `tilt` pitches the pelvis forward; the others bend the spine on top of it."""

    tilt: float = 0.0
    lean: float = 0.0  # forward
    side: float = 0.0  # towards the person's left
    twist: float = 0.0  # chest turned to the person's left
    nod: float = 0.0  # head forward
    turn: float = 0.0  # head to the person's left


@dataclass(frozen=True)
class Leg:
    """Degrees, in the level frame: how the thigh points and the knee bends."""

    flex: float = 0.0  # thigh forward from straight down
    abduct: float = 3.0  # outward, before flexion
    splay: float = 0.0  # about the vertical, outward: what a flexed thigh does
    twist: float = 0.0  # about the thigh: a bent shin swings outward
    knee: float = 3.0


@dataclass(frozen=True)
class Arm:
    """Where the palm is (outward, up, forward; metres) and which way the elbow points."""

    palm: tuple[float, float, float] = (0.24, -0.1, 0.03)
    elbow: tuple[float, float, float] = _ELBOW_HANGS


@dataclass(frozen=True)
class Description:
    """One pose in words and numbers."""

    trunk: Trunk = field(default_factory=Trunk)
    left_leg: Leg = field(default_factory=Leg)
    right_leg: Leg = field(default_factory=Leg)
    left_arm: Arm = field(default_factory=Arm)
    right_arm: Arm = field(default_factory=Arm)


def pose_from_description(description: Description) -> np.ndarray:
    """The body pose (69,): axis-angle of SMPL's joints 1 to 23, radians."""
    local = {
        **_trunk_rotations(description.trunk),
        **_leg_rotations(description.left_leg, description.trunk.tilt, "left"),
        **_leg_rotations(description.right_leg, description.trunk.tilt, "right"),
    }
    chest, shoulder = _chest(description.trunk, local)
    local |= _arm_rotations(description.left_arm, chest, shoulder["left"], "left")
    local |= _arm_rotations(description.right_arm, chest, shoulder["right"], "right")
    pose = np.zeros((NUM_JOINTS, 3))
    for name, rotation in local.items():
        pose[JOINT[name]] = Rotation.from_matrix(rotation).as_rotvec()
    return pose[1:].reshape(69)


def _trunk_rotations(trunk: Trunk) -> dict[str, np.ndarray]:
    rotations = {
        f"spine{number}": _turn("yxz", share * trunk.twist, share * trunk.lean, -share * trunk.side)
        for number, share in enumerate(_SPINE_SHARE, 1)
    }
    rotations["neck"] = _turn("yx", 0.5 * trunk.turn, 0.5 * trunk.nod)
    rotations["head"] = rotations["neck"]
    return rotations


def _leg_rotations(leg: Leg, tilt: float, side: str) -> dict[str, np.ndarray]:
    level_from_thigh = _turn("zyxy", leg.abduct, leg.splay, -leg.flex, -leg.twist)
    sole_pitch = leg.knee - leg.flex  # of a foot that stays square to the shin
    rotations = {
        "hip": _turn("x", -tilt) @ level_from_thigh,
        "knee": _turn("x", leg.knee),
        "ankle": _turn("x", float(np.clip(-sole_pitch, -35.0, 35.0))),  # flat on the floor
    }
    if side == "right":
        rotations = {name: _FLIP @ rotation @ _FLIP for name, rotation in rotations.items()}
    return {f"{side}_{name}": rotation for name, rotation in rotations.items()}


def _chest(trunk: Trunk, local: dict[str, np.ndarray]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The chest's rotation and the shoulders' positions, in the level frame."""
    rotation, position = _turn("x", trunk.tilt), np.zeros(3)
    previous = np.zeros(3)
    for number, joint in enumerate(_SPINE, 1):
        position = position + rotation @ (joint - previous)
        rotation = rotation @ local[f"spine{number}"]
        previous = joint
    left = position + rotation @ (_SHOULDER - previous)
    right = position + rotation @ (_FLIP @ _SHOULDER - previous)
    return rotation, {"left": left, "right": right}


def _arm_rotations(
    arm: Arm, chest: np.ndarray, shoulder: np.ndarray, side: str
) -> dict[str, np.ndarray]:
    """Shoulder and elbow that bring the palm to its place, or as near as the arm reaches.

    Worked out for a left arm, which lies along +x at rest and flexes its elbow about -y; a right
    arm is solved in the mirror.
    """
    if side == "right":
        chest, shoulder = _FLIP @ chest @ _FLIP, _FLIP @ shoulder
    reach = np.array(arm.palm) - shoulder
    longest = _REACH * (_UPPER_ARM + _FOREARM)
    distance = float(np.clip(np.linalg.norm(reach), _NEAREST_PALM, longest))
    direction = reach / np.linalg.norm(reach)

    # the elbow lies on a circle about the line shoulder-palm; it goes where it is told to point
    along = (_UPPER_ARM**2 + distance**2 - _FOREARM**2) / (2 * distance)
    off = np.sqrt(max(_UPPER_ARM**2 - along**2, 0.0))
    pole = np.array(arm.elbow, dtype=np.float64)
    pole = pole - direction * (direction @ pole)
    elbow = along * direction + off * pole / np.linalg.norm(pole)
    upper_arm = elbow / _UPPER_ARM
    forearm = (distance * direction - elbow) / _FOREARM
    bend = np.arccos(np.clip(upper_arm @ forearm, -1.0, 1.0))

    hinge = np.cross(upper_arm, forearm)
    hinge /= np.linalg.norm(hinge)
    level_from_arm = np.stack((upper_arm, -hinge, np.cross(upper_arm, -hinge)), axis=1)
    rotations = {
        "shoulder": chest.T @ level_from_arm,
        "elbow": Rotation.from_rotvec([0.0, -bend, 0.0]).as_matrix(),
    }
    if side == "right":
        rotations = {name: _FLIP @ rotation @ _FLIP for name, rotation in rotations.items()}
    return {f"{side}_{name}": rotation for name, rotation in rotations.items()}


def _turn(axes: str, *degrees: float) -> np.ndarray:
    """Rotations about the given axes, multiplied from left to right: (3, 3)."""
    product = Rotation.identity()
    for axis, angle in zip(axes, degrees, strict=True):
        product = product * Rotation.from_euler(axis, angle, degrees=True)
    return product.as_matrix()
