"""Inverse kinematics: the pose nearest a given one whose hands, feet and pelvis are where asked.

A problem is a list of tasks, each a residual of the posed skeleton; they are minimised together
with the change of pose by damped least squares (Levenberg 1944) over numeric derivatives, which
cost one batched pass of forward kinematics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from hoi.body.skeleton import JOINT
from hoi.datasets.behave_mini.person import Person, Pose, forward_kinematics

_STEP = 1e-4
_ITERATIONS = 30


class Task(Protocol):
    """A wish about the posed skeleton."""

    def residual(self, turned: np.ndarray, placed: np.ndarray) -> np.ndarray:
        """(B, k) from rotations (B, 24, 3, 3) and positions (B, 24, 3)."""
        ...


@dataclass(frozen=True)
class Reach:
    """A point fixed to a joint should be at `target`; `weight` is a number or one per axis."""

    joint: str
    target: np.ndarray
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    weight: float | tuple[float, float, float] = 10.0

    def residual(self, turned: np.ndarray, placed: np.ndarray) -> np.ndarray:
        j = JOINT[self.joint]
        return (placed[:, j] + turned[:, j] @ self.offset - self.target) * np.asarray(self.weight)


@dataclass(frozen=True)
class Aim:
    """A direction fixed to a joint should point along `target` (unit vectors)."""

    joint: str
    direction: np.ndarray
    target: np.ndarray
    weight: float = 1.0

    def residual(self, turned: np.ndarray, placed: np.ndarray) -> np.ndarray:
        return (turned[:, JOINT[self.joint]] @ self.direction - self.target) * self.weight


@dataclass(frozen=True)
class Balance:
    """Trunk over a ground point: the mean of pelvis, chest and head, horizontally (x, z)."""

    over: np.ndarray
    weight: float = 1.5

    def residual(self, turned: np.ndarray, placed: np.ndarray) -> np.ndarray:
        trunk = placed[:, [JOINT["pelvis"], JOINT["spine3"], JOINT["head"]]].mean(1)
        return (trunk[:, [0, 2]] - self.over) * self.weight


@dataclass(frozen=True)
class Clearance:
    """Forearms and hands stay out of trunk and thighs, which are capsules of these radii."""

    scale: float = 1.0
    weight: float = 12.0

    def residual(self, turned: np.ndarray, placed: np.ndarray) -> np.ndarray:
        terms = []
        for side in ("left", "right"):
            elbow, wrist, hand = (placed[:, JOINT[f"{side}_{n}"]] for n in _ARM)
            for point, thickness in (((elbow + wrist) / 2, 0.04), (wrist, 0.035), (hand, 0.03)):
                for first, second, radius in _CAPSULES:
                    distance = _to_segment(point, placed[:, JOINT[first]], placed[:, JOINT[second]])
                    terms.append(np.maximum(radius * self.scale + thickness - distance, 0.0))
        return np.stack(terms, axis=1) * self.weight


_ARM = ("elbow", "wrist", "hand")
_CAPSULES = (
    ("pelvis", "spine2", 0.125),
    ("spine2", "spine3", 0.125),
    ("spine3", "neck", 0.11),
    ("left_hip", "left_knee", 0.075),
    ("right_hip", "right_knee", 0.075),
)


def _to_segment(point: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(B,) distance of points to segments."""
    along = second - first
    share = ((point - first) * along).sum(-1) / ((along * along).sum(-1) + 1e-12)
    return np.linalg.norm(point - first - np.clip(share, 0, 1)[:, None] * along, axis=-1)


#: how unwillingly each joint leaves the given pose (1 = one unit of residual per radian), x y z
_STIFFNESS = {
    **{f"{s}_{n}": v for s in ("left", "right") for n, v in {
        "hip": (0.3, 0.5, 0.5), "knee": (0.3, 3.0, 3.0), "ankle": (0.3, 0.6, 0.6),
        "collar": (0.9, 0.9, 0.9), "shoulder": (0.25, 0.15, 0.15), "elbow": (2.0, 0.1, 2.0),
        "wrist": (0.5, 0.5, 0.4),
    }.items()},
    "spine1": (0.6, 0.9, 1.0), "spine2": (0.7, 0.9, 1.0), "spine3": (1.0, 1.2, 1.2),
    "neck": (1.0, 1.0, 1.0), "head": (1.0, 1.0, 1.0),
}  # fmt: skip
#: soft bounds of hinges: joint, axis, low, high
_BOUNDS = [
    *[(f"{s}_knee", 0, 0.0, 2.45) for s in ("left", "right")],
    *[(f"{s}_hip", 0, -2.1, 0.45) for s in ("left", "right")],
    *[(f"{s}_ankle", 0, -0.6, 0.6) for s in ("left", "right")],
    ("left_elbow", 1, -2.4, -0.02), ("right_elbow", 1, 0.02, 2.4),
    *[(f"{s}_wrist", a, -0.9, 0.9) for s in ("left", "right") for a in (0, 1, 2)],
]  # fmt: skip
_FREE = [JOINT[name] for name in _STIFFNESS]
_SOFT = np.array(list(_STIFFNESS.values()))
_BOUND_COLUMNS = np.array([6 + 3 * list(_STIFFNESS).index(b[0]) + b[1] for b in _BOUNDS])
_BOUND_LOW, _BOUND_HIGH = np.array([b[2] for b in _BOUNDS]), np.array([b[3] for b in _BOUNDS])


def solve(
    person: Person,
    pose: Pose,
    tasks: Sequence[Task],
    root_stiffness: float = 0.4,
    turn_stiffness: float = 0.8,
) -> Pose:
    """The pose near `pose` that fulfils `tasks` best.

    Args:
        root_stiffness: cost of moving the pelvis, per metre.
        turn_stiffness: cost of turning it, per radian.
    """
    start = np.concatenate([pose.root, pose.rotations[0], pose.rotations[_FREE].ravel()])
    soft = np.concatenate([np.full(3, root_stiffness), np.full(3, turn_stiffness), _SOFT.ravel()])

    def residuals(x: np.ndarray) -> np.ndarray:
        rotations = np.broadcast_to(pose.rotations, (len(x), 24, 3)).copy()
        rotations[:, 0] = x[:, 3:6]
        rotations[:, _FREE] = x[:, 6:].reshape(len(x), -1, 3)
        turned, placed = forward_kinematics(person.rest_joints, x[:, :3], rotations)
        hinge = x[:, _BOUND_COLUMNS]
        beyond = np.maximum(_BOUND_LOW - hinge, 0) + np.maximum(hinge - _BOUND_HIGH, 0)
        terms = [(x - start) * soft, 4.0 * beyond, *(t.residual(turned, placed) for t in tasks)]
        return np.concatenate(terms, axis=1)

    x, damping = start.copy(), 1e-3
    nudges = np.concatenate([np.zeros((1, len(x))), _STEP * np.eye(len(x))])
    value = np.inf
    for _ in range(_ITERATIONS):
        rows = residuals(x + nudges)
        jacobian = (rows[1:] - rows[0]).T / _STEP
        value = float((rows[0] ** 2).sum())
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ rows[0]
        for _ in range(6):
            step = -np.linalg.solve(normal + damping * np.eye(len(x)), gradient)
            moved = float((residuals((x + step)[None])[0] ** 2).sum())
            if moved < value:
                damping = max(damping / 4, 1e-6)
                break
            damping *= 6
        else:
            break
        x = x + step
        if value - moved < 1e-5 * value:
            break
    rotations = pose.rotations.copy()
    rotations[0], rotations[_FREE] = x[3:6], x[6:].reshape(-1, 3)
    return Pose(x[:3], rotations)


def hand_on(
    person: Person,
    side: str,
    point: np.ndarray,
    outward: np.ndarray | None = None,
    aim: float = 0.5,
    weight: float = 12.0,
) -> list[Task]:
    """The palm of one hand lies on a surface point, facing against its outward normal."""
    tasks: list[Task] = [Reach(f"{side}_wrist", point, person.palm(side), weight)]
    if outward is not None:
        facing = -np.asarray(outward) / np.linalg.norm(outward)
        tasks.append(Aim(f"{side}_wrist", np.array([0.0, -1.0, 0.0]), facing, aim))
    return tasks


def foot_on(
    person: Person, side: str, x: float, z: float, floor: float = 0.0, turn_out: float = 0.15
) -> list[Task]:
    """One sole lies flat on the floor with the ankle above (x, z)."""
    heel, ball = person.sole(side)
    sign = 1.0 if side == "left" else -1.0
    toes = np.array([np.sin(sign * turn_out), 0.0, np.cos(turn_out)])
    ankle = np.array([x, floor - heel[1], z])
    return [
        Reach(f"{side}_ankle", ankle, weight=(4.0, 12.0, 4.0)),
        Reach(f"{side}_foot", np.array([0, floor, 0.0]), ball, (0.0, 12.0, 0.0)),
        Aim(f"{side}_ankle", np.array([0.0, 0.0, 1.0]), toes, 0.8),
        Aim(f"{side}_ankle", np.array([0.0, 1.0, 0.0]), np.array([0.0, 1.0, 0.0]), 1.0),
    ]
