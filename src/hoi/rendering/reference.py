"""Slow, obvious second implementation of the silhouette, for tests and benchmarks.

:func:`loss`, :func:`overlap` and :func:`image` are the back end ``reference``. Coverage is tested
triangle by triangle, edges come from a dictionary, everything is float64 and the gradient is
autograd's. Loops over faces are meant: this is what the fast back ends are held against.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import torch
from torch import Tensor

from hoi.rendering.target import SilhouetteTarget
from hoi.rendering.topology import MeshTopology

# axis, line of the pair, place of its first pixel, whether that is covered, where the edge passes
Pairs = tuple[int, Tensor, Tensor, Tensor, Tensor]


def covered(xy: np.ndarray, faces: np.ndarray, height: int, width: int, samples: int = 1):
    """Hard coverage of one projected mesh on a grid `samples` times finer than the pixels.

    Args:
        xy: (V, 2) pixels. faces: (F, 3).

    Returns:
        (H * samples, W * samples) bool: whether any face covers each sample.
    """
    image = np.zeros((height * samples, width * samples), bool)
    for corners in np.asarray(xy, np.float64)[faces] * samples:
        if not np.isfinite(corners).all():
            continue
        column0, row0 = np.clip(np.ceil(corners.min(0) - 0.5), 0, image.shape[::-1]).astype(int)
        column1, row1 = np.clip(np.floor(corners.max(0) - 0.5) + 1, 0, image.shape[::-1]).astype(
            int
        )
        x = np.arange(column0, column1) + 0.5
        y = np.arange(row0, row1)[:, None] + 0.5
        sides = [
            (b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])
            for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
        ]
        if (sides_area := _area(corners)) == 0:
            continue
        inside = np.logical_and.reduce([side * np.sign(sides_area) >= 0 for side in sides])
        image[row0:row1, column0:column1] |= inside
    return image


def coverage(xy: np.ndarray, faces: np.ndarray, height: int, width: int, samples: int = 8):
    """(H, W) float64 fraction of each pixel that one projected mesh covers, by supersampling."""
    fine = covered(xy, faces, height, width, samples)
    return fine.reshape(height, samples, width, samples).mean((1, 3))


def loss(
    xy: Tensor,
    topology: MeshTopology,
    target: SilhouetteTarget,
    mask_weight: float,
    edge_weight: float,
) -> tuple[Tensor, Tensor]:
    """See :func:`hoi.rendering.silhouette_loss`."""
    results = [_loss(one.double(), topology, target, mask_weight, edge_weight) for one in xy]
    losses, ious = (torch.stack(values).to(xy) for values in zip(*results, strict=True))
    return losses, ious


def overlap(xy: Tensor, topology: MeshTopology, target: SilhouetteTarget) -> Tensor:
    """See :func:`hoi.rendering.silhouette_iou`."""
    hard = image(xy.detach(), topology, *target.shape, antialias=False).double()
    return torch.stack([_iou(one, target) for one in hard]).to(xy)


def image(
    xy: Tensor, topology: MeshTopology, height: int, width: int, antialias: bool = True
) -> Tensor:
    """See :func:`hoi.rendering.render_silhouette`."""
    images = []
    for one in xy.double():
        hard = torch.from_numpy(covered(one.detach().numpy(), topology.faces, height, width))
        pairs = _pairs(one, topology.faces, hard) if antialias else []
        images.append(_blended(hard.double(), pairs))
    return torch.stack(images).to(xy)


def _loss(
    xy: Tensor,
    topology: MeshTopology,
    target: SilhouetteTarget,
    mask_weight: float,
    edge_weight: float,
) -> tuple[Tensor, Tensor]:
    mask, keep, distance = (
        torch.from_numpy(table).double()
        for table in (target.mask, target.keep, target.edge_distance)
    )
    hard = torch.from_numpy(covered(xy.detach().numpy(), topology.faces, *target.shape))
    pairs = _pairs(xy, topology.faces, hard)
    drawn = _blended(hard.double(), pairs)
    value = mask_weight * (keep * (drawn - mask).square()).sum()
    for axis, line, first, _, position in pairs:
        known, table = (keep, distance) if axis == 0 else (keep.T, distance.T)
        weight = torch.minimum(known[line, first], known[line, first + 1])
        share = position - first - 0.5
        there = (1 - share) * table[line, first] + share * table[line, first + 1]
        value = value + edge_weight * (weight * there).sum()
    return value, _iou(drawn.detach(), target)


def _iou(drawn: Tensor, target: SilhouetteTarget) -> Tensor:
    mask, keep = torch.from_numpy(target.mask).double(), torch.from_numpy(target.keep).double()
    union = (keep * torch.maximum(drawn, mask)).sum()
    return (keep * torch.minimum(drawn, mask)).sum() / union.clamp(min=1e-6)


def _blended(hard: Tensor, pairs: list[Pairs]) -> Tensor:
    drawn = hard
    for axis, line, first, inside, position in pairs:
        past_border = position - (first + 1)
        change = torch.where(inside, past_border, -past_border)
        cell = torch.where(past_border > 0, first + 1, first)
        rows, columns = (line, cell) if axis == 0 else (cell, line)
        drawn = drawn.index_put((rows, columns), change, accumulate=True)
    return drawn + (drawn.clamp(0, 1) - drawn).detach()  # a clamped pixel keeps its gradient


def _area(corners: np.ndarray) -> float:
    (x0, y0), (x1, y1), (x2, y2) = corners
    return (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)


def _outline(xy: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(E, 2) edges whose faces, all turned positive on screen, do not cancel."""
    net: dict[tuple[int, int], float] = defaultdict(float)
    for face in faces:
        sign = np.sign(_area(xy[face].astype(np.float32)))
        for a, b in zip(face, np.roll(face, -1), strict=True):
            if a != b:
                net[(min(a, b), max(a, b))] += sign if a < b else -sign
    return np.array([edge for edge, count in net.items() if count], np.int64).reshape(-1, 2)


def _pairs(xy: Tensor, faces: np.ndarray, hard: Tensor) -> list[Pairs]:
    edges = torch.from_numpy(_outline(xy.detach().numpy(), faces))
    return [_pairs_along(axis, xy, edges, hard) for axis in (0, 1)]


def _pairs_along(axis: int, xy: Tensor, edges: Tensor, hard: Tensor) -> Pairs:
    """Pixels side by side (axis 0, steep edges) or above each other that an edge separates."""
    along, across = (0, 1) if axis == 0 else (1, 0)
    coverage = hard if axis == 0 else hard.T
    lines, cells = coverage.shape
    a, b = xy[edges[:, 0]], xy[edges[:, 1]]
    span = b - a
    steep = (
        span[:, across].abs() >= span[:, along].abs()
        if axis == 0
        else span[:, across].abs() > span[:, along].abs()
    )
    a, b, span = a[steep], b[steep], span[steep]
    centre = torch.arange(lines, dtype=xy.dtype) + 0.5
    low = torch.minimum(a[:, across], b[:, across])[:, None]
    high = torch.maximum(a[:, across], b[:, across])[:, None]
    edge, line = torch.nonzero((centre >= low) & (centre < high), as_tuple=True)
    slope = span[edge, along] / span[edge, across]
    position = a[edge, along] + (centre[line] - a[edge, across]) * slope
    first = torch.floor(position.detach() - 0.5).long()
    on_grid = (first >= 0) & (first < cells - 1)
    position, line, first = position[on_grid], line[on_grid], first[on_grid]
    inside = coverage[line, first]
    separates = inside != coverage[line, first + 1]
    position, line, first, inside = (
        values[separates] for values in (position, line, first, inside)
    )
    # keep the outermost position of each pair: the largest where its first pixel is covered
    outward = torch.where(inside, position.detach(), -position.detach())
    pair = line * cells + first
    best = torch.full((lines * cells,), -torch.inf, dtype=xy.dtype)
    best = best.scatter_reduce(0, pair, outward, "amax")
    winner = torch.nonzero(outward == best[pair])[:, 0]
    _, first_winner = np.unique(pair[winner].numpy(), return_index=True)
    winner = winner[torch.from_numpy(first_winner)]
    return axis, line[winner], first[winner], inside[winner], position[winner]
