"""Which way a mesh stands: its file's convention, unless the shape clearly says otherwise.

Canonical frame: y up, front +z. Axes are written as in the file: ``y``, ``-z``, ...
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree  # type: ignore[attr-defined]

from hoi.errors import ConfigError

AXES = ("x", "-x", "y", "-y", "z", "-z")
_Z_UP_SUFFIXES = (".stl", ".ply", ".off")  # from CAD and scanners; glTF and OBJ are y-up
_FOOT = 0.02  # share of the height that counts as touching the floor
_CLEARLY = 0.5  # share of its footprint that a mesh must stand on more surely to be turned over
_MIRROR = 0.02  # of the diagonal: mean distance at which halves are mirror images
_TOP = 0.85  # share of the height above which a back or a handle is looked for


class Orientation(NamedTuple):
    """The file's axes that point up and to the front, and how that was decided."""

    up: str
    front: str
    reason: str


def axis_vector(axis: str) -> np.ndarray:
    """(3,) unit vector of an axis name; raises ConfigError for another word."""
    if axis not in AXES:
        raise ConfigError(f"{axis!r} is no axis: use one of {', '.join(AXES)}")
    vector = np.zeros(3)
    vector["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return vector


def canonical_from_file(up: str, front: str) -> np.ndarray:
    """(3, 3) rotation that takes the file's frame to the canonical one.

    Raises ConfigError when `up` and `front` lie on one axis.
    """
    y, z = axis_vector(up), axis_vector(front)
    if abs(y @ z) > 0.5:
        raise ConfigError(f"up {up} and front {front} lie on one axis; name two different ones")
    return np.stack([np.cross(y, z), y, z])


def default_front(up: str) -> str:
    """The front that goes with an up axis in the usual tools: glTF's +z, Blender's -y."""
    return {"y": "z", "-y": "z", "z": "-y", "-z": "y"}.get(up, "z")


def guess_orientation(
    points: np.ndarray, suffix: str, up: str | None = None, front: str | None = None
) -> Orientation:
    """How the mesh of a file stands.

    Args:
        points: (N, 3) points spread evenly over the surface, in the file's frame.
        suffix: of the file, which tells the convention.
        up, front: what the user said already.
    """
    reasons = []
    if up is None:
        up, reason = _guess_up(points, suffix)
        reasons.append(reason)
    if front is None:
        front, reason = _guess_front(points, up)
        reasons.append(reason)
    canonical_from_file(up, front)
    return Orientation(up, front, "; ".join(reasons) or "as you said")


def surface_points(vertices: np.ndarray, faces: np.ndarray, count: int = 3000) -> np.ndarray:
    """(count, 3) points drawn uniformly by area, the same on every call."""
    generator = np.random.default_rng(0)
    corners = np.asarray(vertices, np.float64)[faces]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(doubled, axis=1)
    chosen = corners[generator.choice(len(area), size=count, p=area / area.sum())]
    u, v = generator.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return chosen[:, 0] + u * (chosen[:, 1] - chosen[:, 0]) + v * (chosen[:, 2] - chosen[:, 0])


def _guess_up(points: np.ndarray, suffix: str) -> tuple[str, str]:
    usual = "z" if suffix.lower() in _Z_UP_SUFFIXES else "y"
    other = "y" if usual == "z" else "z"
    if _footing(points, other) > _footing(points, usual) + _CLEARLY:
        return other, f"up is {other}: it stands much surer on that axis than on {usual}"
    return usual, f"up is {usual}, as usual in {suffix.lower()} files"


def _footing(points: np.ndarray, up: str) -> float:
    """Share of the footprint's box that is spanned by what touches the floor; 0: it would tip."""
    turned = points @ canonical_from_file(up, default_front(up)).T
    height = turned[:, 1] - turned[:, 1].min()
    plan = turned[:, [0, 2]]
    feet = plan[height < _FOOT * height.max()]
    try:
        hull = ConvexHull(feet)
    except (QhullError, ValueError):
        return 0.0
    centre = plan.mean(axis=0)
    if (hull.equations[:, :2] @ centre + hull.equations[:, 2] > 0).any():
        return 0.0
    return float(hull.volume / np.prod(np.ptp(plan, axis=0)))  # a 2D hull's volume is its area


def _guess_front(points: np.ndarray, up: str) -> tuple[str, str]:
    """People and things are mirrored left to right, so the front lies in the mirror plane."""
    usual = default_front(up)
    turned = points @ canonical_from_file(up, usual).T
    across, along = _mirror_error(turned, 0), _mirror_error(turned, 2)
    if across <= _MIRROR or along > 0.5 * min(across, 2 * _MIRROR):
        return usual, f"front is {usual}, as usual"
    # left and right are mirrored along the file's other level axis; high backs are at the back
    sideways = canonical_from_file(up, usual).T @ np.array([1.0, 0, 0])
    axis = "xyz"[int(np.abs(sideways).argmax())]
    forward = points @ axis_vector(axis)
    height = turned[:, 1] - turned[:, 1].min()
    top = forward[height > _TOP * height.max()]
    middle = (forward.min() + forward.max()) / 2
    front = f"-{axis}" if top.mean() > middle else axis
    return front, f"front is {front}: its halves mirror each other about that axis"


def _mirror_error(points: np.ndarray, axis: int) -> float:
    """Mean distance between a shape and its mirror image, as a share of its diagonal."""
    low, high = points.min(axis=0), points.max(axis=0)
    mirrored = points.copy()
    mirrored[:, axis] = (low + high)[axis] - mirrored[:, axis]
    distance, _ = cKDTree(points).query(mirrored)
    # an even sample of a perfectly mirrored shape is not mirrored itself
    spacing = np.median(cKDTree(points).query(points, k=2)[0][:, 1])
    return float(max(distance.mean() - spacing, 0.0) / np.linalg.norm(high - low))
