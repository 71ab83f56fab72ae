"""Boxes: x0, y0, x1, y1 in pixels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hoi.detect.backends import Box


def mask_box(mask: np.ndarray) -> Box:
    """The tight box of a non-empty mask."""
    columns, rows = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
    return float(columns[0]), float(rows[0]), float(columns[-1] + 1), float(rows[-1] + 1)


def area(box: Sequence[float]) -> float:
    return max(box[2] - box[0], 0.0) * max(box[3] - box[1], 0.0)


def longer_side(box: Sequence[float]) -> float:
    return max(box[2] - box[0], box[3] - box[1])


def middle(box: Sequence[float]) -> np.ndarray:
    """(2,) x, y of the centre."""
    return np.array([box[0] + box[2], box[1] + box[3]]) / 2


def square(centre: Sequence[float] | np.ndarray, side: float) -> Box:
    """The square box around x, y."""
    x, y, half = float(centre[0]), float(centre[1]), side / 2
    return x - half, y - half, x + half, y + half


def shifted(box: Sequence[float], x: float, y: float) -> Box:
    """The box moved by x, y."""
    return box[0] + x, box[1] + y, box[2] + x, box[3] + y


def shared_area(first: Sequence[float], second: Sequence[float]) -> float:
    low = max(first[0], second[0]), max(first[1], second[1])
    high = min(first[2], second[2]), min(first[3], second[3])
    return area((*low, *high))


def overlap(first: Sequence[float], second: Sequence[float]) -> float:
    """Intersection over union."""
    shared = shared_area(first, second)
    union = area(first) + area(second) - shared
    return shared / union if union > 0 else 0.0


def overlaps(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(N, M) intersections over union of boxes (N, 4) and (M, 4)."""
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    shared = np.prod(np.clip(high - low, 0, None), axis=2)
    own, other = (np.prod(np.clip(b[:, 2:] - b[:, :2], 0, None), axis=1) for b in (first, second))
    union = own[:, None] + other - shared
    return shared / np.where(union > 0, union, 1)


def gap(first: Sequence[float], second: Sequence[float]) -> float:
    """Pixels between two boxes; 0 where they touch or overlap."""
    across = max(first[0] - second[2], second[0] - first[2], 0.0)
    down = max(first[1] - second[3], second[1] - first[3], 0.0)
    return float(np.hypot(across, down))


def grown(box: Sequence[float], margin: float) -> Box:
    """The box with `margin` pixels more on every side."""
    return box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin


def clipped(box: Sequence[float], height: int, width: int) -> Box:
    """The part of the box inside the image."""
    xs, ys = np.clip(box[0::2], 0, width), np.clip(box[1::2], 0, height)
    return float(xs[0]), float(ys[0]), float(xs[1]), float(ys[1])


def pixel_window(box: Sequence[float], height: int, width: int) -> tuple[slice, slice]:
    """Rows and columns of the pixels that the box touches, inside the image."""
    x0, y0, x1, y1 = clipped(box, height, width)
    return slice(int(y0), int(np.ceil(y1))), slice(int(x0), int(np.ceil(x1)))


def weight_inside(weights: np.ndarray, box: Sequence[float]) -> float:
    """How much of an image of weights (H, W) lies in the box."""
    return float(weights[pixel_window(box, *weights.shape)].sum())
