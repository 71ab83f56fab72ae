"""Closed solids from which the procedural objects are built (y up, metres).

Every function returns a `manifold3d.Manifold`, so that any union of them is watertight.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from manifold3d import CrossSection, Manifold, OpType

Point = Sequence[float] | np.ndarray


def box(size: Point, centre: Point = (0, 0, 0), tilt: float = 0.0) -> Manifold:
    """An axis-aligned box; `tilt` (radians) turns it about x, leaning its top towards -z."""
    solid = Manifold.cube([float(s) for s in size], center=True)
    return solid.rotate((-float(np.degrees(tilt)), 0, 0)).translate(_point(centre))


def rod(
    start: Point, end: Point, radius: float, end_radius: float | None = None, sides: int = 8
) -> Manifold:
    """A round bar from `start` to `end`, tapering to `end_radius` when given."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / length
    other = np.array([1.0, 0, 0]) if abs(axis[0]) < 0.9 else np.array([0, 1.0, 0])
    side = np.cross(other, axis)
    side /= np.linalg.norm(side)
    frame = np.column_stack([side, np.cross(axis, side), axis, start])
    low, high = float(radius), float(radius if end_radius is None else end_radius)
    return Manifold.cylinder(length, low, high, sides).transform(frame)


def tube(path: Sequence[Point], radius: float, sides: int = 8, closed: bool = False) -> Manifold:
    """A round bar along a polyline, with balls at its bends."""
    points = [np.asarray(p, float) for p in path]
    if closed:
        points.append(points[0])
    bends = points[:-1] if closed else points[1:-1]
    bars = [rod(a, b, radius, sides=sides) for a, b in itertools.pairwise(points)]
    return union([*bars, *(ball(radius, p, sides) for p in bends)])


def ball(radius: float, centre: Point = (0, 0, 0), sides: int = 16) -> Manifold:
    """A sphere."""
    return Manifold.sphere(float(radius), sides).translate(_point(centre))


def ellipsoid(size: Point, centre: Point = (0, 0, 0), sides: int = 20) -> Manifold:
    """An ellipsoid filling a box of `size`."""
    half = [float(s) / 2 for s in size]
    return Manifold.sphere(1.0, sides).scale(half).translate(_point(centre))


def disc(radius: float, height: float, centre: Point = (0, 0, 0), sides: int = 28) -> Manifold:
    """An upright cylinder about `centre`."""
    solid = Manifold.cylinder(float(height), float(radius), float(radius), sides, True)
    return solid.rotate((-90, 0, 0)).translate(_point(centre))


def lathe(profile: Sequence[tuple[float, float]], sides: int = 28) -> Manifold:
    """A solid of revolution about y; `profile` is a closed polygon of (radius, height)."""
    outline = CrossSection([np.array(profile, np.float64)])
    return outline.revolve(sides).rotate((-90, 0, 0))


def cushion(
    size: Point, centre: Point = (0, 0, 0), radius: float = 0.03, sides: int = 8
) -> Manifold:
    """A box whose edges are rounded with `radius` (at most half the thinnest side)."""
    size = np.asarray(size, float)
    radius = min(float(radius), 0.49 * float(size.min()))
    half = size / 2 - radius
    corners = [half * (sx, sy, sz) for sx in (-1, 1) for sy in (-1, 1) for sz in (-1, 1)]
    return Manifold.batch_hull([ball(radius, c, sides) for c in corners]).translate(_point(centre))


def bent_plate(size: Point, bow: float, centre: Point = (0, 0, 0), tilt: float = 0.0) -> Manifold:
    """A plate whose left and right edges come forward (+z) by `bow` metres."""
    size = np.asarray(size, float)
    flat = Manifold.cube([float(s) for s in size], center=True)
    fine = flat.refine_to_length(float(size[0]) / 8)

    def bend(points: np.ndarray) -> np.ndarray:
        bent = np.array(points)
        bent[:, 2] += bow * (2 * bent[:, 0] / size[0]) ** 2
        return bent

    turned = fine.warp_batch(bend).rotate((-float(np.degrees(tilt)), 0, 0))
    return turned.translate(_point(centre))


def union(solids: Sequence[Manifold]) -> Manifold:
    """One solid covering all of `solids`."""
    return Manifold.batch_boolean(list(solids), OpType.Add)


def _point(p: Point) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in p)
    return x, y, z
