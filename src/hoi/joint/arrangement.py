"""Where the object is, seen from the person, and how it is turned, against what the prior says."""

from __future__ import annotations

import numpy as np

from hoi.artifacts import Arrangement
from hoi.body.skeleton import JOINT

UNSAID = 0.5
"""Misplacement by what nobody said: that of an object put anywhere, turned anyhow."""

_UP = np.array([0.0, -1.0, 0.0])


def misplacement(
    arrangement: Arrangement | None, joints: np.ndarray, centres: np.ndarray, fronts: np.ndarray
) -> np.ndarray:
    """(K,) how far each hypothesis is from the arrangement: 0 as said, 1 the very opposite.

    The mean of two angles' ``(1 - cos) / 2``: of the direction from the pelvis to the object, and
    of the object's front. Directions but up and down are compared as seen from above.

    Args:
        joints: (24, 3) of the body, camera frame, whose -y is up.
        centres: (K, 3) of the objects. fronts: (K, 3) directions in which their fronts look.
    """
    hips = joints[JOINT["left_hip"]] - joints[JOINT["right_hip"]]
    shoulders = joints[JOINT["left_shoulder"]] - joints[JOINT["right_shoulder"]]
    front = np.cross(_flat(hips + shoulders), _UP)
    there = centres - joints[JOINT["pelvis"]]
    said = arrangement or Arrangement()
    place = {
        "front": _opposition(_flat(there), front),
        "behind": _opposition(_flat(there), -front),
        "above": _opposition(_unit(there), _UP),
        "below": _opposition(_unit(there), -_UP),
        "beside": np.abs(_flat(there) @ front),
    }
    turn = {
        "same": _opposition(_flat(fronts), front),
        "opposite": _opposition(_flat(fronts), -front),
        "sideways": np.abs(_flat(fronts) @ front),
    }
    unsaid = np.full(len(centres), UNSAID)
    return (place.get(said.relation, unsaid) + turn.get(said.facing, unsaid)) / 2


def _opposition(directions: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    return (1 - directions @ wanted) / 2


def _flat(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors of what is left when up and down are taken out."""
    return _unit(vectors - (vectors @ _UP)[..., None] * _UP)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
