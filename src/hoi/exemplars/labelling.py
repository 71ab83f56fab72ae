"""Geometric part labels for meshes that come without: chairs, stools and tables.

Rules on the canonical frame (y up, front +z): the seat is the strongest level, central patch that
faces up; what is above it is back or arms, what is below is base. They were checked by eye on the
curated furniture; a curated model may state its seat level instead (`seat`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

WHOLE = "whole"
_CHAIR = ("chair_seat", "chair_back", "chair_base", "chair_arm")
_SEAT, _BACK, _BASE, _ARM = range(4)
_HAIR = 0.003  # metres


class _Surface(NamedTuple):
    """Face centres (F, 3) with the floor at y = 0, unit normals (F, 3), areas (F,)."""

    centres: np.ndarray
    normals: np.ndarray
    areas: np.ndarray


def label_faces(
    category: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    seat: tuple[float, float] | None = None,
    arms: bool | None = None,
) -> tuple[tuple[str, ...], np.ndarray]:
    """Part names and (F,) part index by the rule of a category; others get one part ``whole``.

    Args:
        category: chair, stool, table have rules.
        seat: height of the lower and upper side of the seat (or table top) above the floor, in
            metres, when the rule should not look for it.
        arms: whether the chair has arms; None lets the rule decide.
    """
    surface = _surface(vertices, faces)
    if category == "chair":
        parts = _label_chair(surface, seat, arms)
        return _used(_CHAIR, parts)
    if category == "stool":
        low, high = seat or _seat_levels(surface, 0.55, 1.01)
        y = surface.centres[:, 1]
        parts = np.where(y > low, np.where(y > high + 0.035, _BACK, _SEAT), _BASE)
        return _used(_CHAIR, parts)
    if category == "table":
        low = seat[0] if seat else _slab_bottom(surface) - _HAIR
        parts = np.where(surface.centres[:, 1] > low, 0, 1)
        return _used(("tabletop", "table_base"), parts)
    return (WHOLE,), np.zeros(len(faces), np.int64)


def _surface(vertices: np.ndarray, faces: np.ndarray) -> _Surface:
    triangles = vertices.astype(np.float64)[faces]
    triangles[..., 1] -= vertices[:, 1].min()
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    doubled = np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(doubled, 1e-12)[:, None]
    return _Surface(triangles.mean(axis=1), normals, doubled / 2)


def _used(names: tuple[str, ...], parts: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    present = np.unique(parts)
    return tuple(names[i] for i in present), np.searchsorted(present, parts)


def _central(surface: _Surface, across: float, along: float) -> np.ndarray:
    """Faces within these shares of the half width and half depth from the middle."""
    plan = surface.centres[:, [0, 2]]
    low, high = plan.min(axis=0), plan.max(axis=0)
    return (np.abs(plan - (low + high) / 2) < (high - low) / 2 * (across, along)).all(axis=1)


def _seat_levels(surface: _Surface, low: float, high: float) -> tuple[float, float]:
    """Lower and upper side of the seat, sought between two shares of the total height."""
    y, total = surface.centres[:, 1], surface.centres[:, 1].max()
    up = _central(surface, 0.72, 0.84) & (surface.normals[:, 1] > 0.75)
    bins = np.linspace(0, 1.02, 121)
    area, _ = np.histogram(y[up] / total, bins, weights=surface.areas[up])
    middle = (bins[1:] + bins[:-1]) / 2
    score = np.convolve(area, [0.25, 0.5, 1, 1, 1, 0.5, 0.25], "same")
    score[(middle < low) | (middle > high)] = 0
    level = middle[score.argmax()] * total
    patch = up & (np.abs(y - level) < 0.05 * total)
    top = _quantile(y[patch], surface.areas[patch], 0.9) if patch.any() else level
    under = _central(surface, 0.6, 0.6) & (surface.normals[:, 1] < -0.6)
    under &= (y < top - 0.004) & (y > top - 0.20)
    enough = surface.areas[under].sum() > 0.002 * surface.areas.sum()
    bottom = _quantile(y[under], surface.areas[under], 0.15) if enough else top - 0.06
    # A hair lower, so that the underside itself belongs to the seat.
    return float(np.clip(bottom, top - 0.16, top - 0.02)) - _HAIR, float(top)


def _label_chair(
    surface: _Surface, seat: tuple[float, float] | None, arms: bool | None
) -> np.ndarray:
    centres, areas = surface.centres, surface.areas
    low, high = seat or _seat_levels(surface, 0.22, 0.72)
    y, total = centres[:, 1], centres[:, 1].max()
    parts = np.where(y > low, _SEAT, _BASE)
    above = y > high + 0.035
    parts[above] = _BACK
    upper = y > high + 0.6 * (total - high)
    if arms is False or not upper.any():
        return parts
    # Arms stand at the flanks of the seat, in front of the plane of the back.
    x = centres[:, 0] - (centres[:, 0].min() + centres[:, 0].max()) / 2
    slab = (y > low) & ~above
    half_width = _quantile(np.abs(x[slab]), areas[slab], 0.97)
    back_front = _quantile(centres[upper, 2], areas[upper], 0.95)
    flank = above & (np.abs(x) > 0.72 * half_width) & (centres[:, 2] > back_front + 0.05)
    flank &= y < high + 0.62 * (total - high)
    left, right = areas[flank & (x < 0)].sum(), areas[flank & (x > 0)].sum()
    if arms or min(left, right) > 0.004 * areas.sum():
        parts[flank] = _ARM
    return parts


def _slab_bottom(surface: _Surface) -> float:
    """Height of the lower side of a table top."""
    y, total = surface.centres[:, 1], surface.centres[:, 1].max()
    up, down = surface.normals[:, 1] > 0.8, surface.normals[:, 1] < -0.8
    bins = np.linspace(0, total * 1.001, 101)
    area, _ = np.histogram(y[up], bins, weights=surface.areas[up])
    middle = (bins[1:] + bins[:-1]) / 2
    score = np.convolve(area, [1, 1, 1], "same") * (middle > 0.6 * total)
    top = middle[score.argmax()] + 0.015 * total
    under = down & (y < top - 0.008) & (y > top - 0.14)
    if surface.areas[under].sum() < 0.02 * surface.areas.sum():
        return float(top - 0.05)
    return float(_quantile(y[under], surface.areas[under], 0.5))


def _quantile(values: np.ndarray, weights: np.ndarray, q: float) -> float:
    """Weighted quantile."""
    order = np.argsort(values)
    share = np.cumsum(weights[order]) / weights.sum()
    return float(values[order][min(np.searchsorted(share, q), len(values) - 1)])
