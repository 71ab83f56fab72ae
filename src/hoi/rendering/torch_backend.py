"""The silhouette algorithm of :mod:`hoi.rendering.kernels` in standard torch operations.

Runs where torch runs, CUDA included, and needs no compiler; on a CPU the kernels are several times
faster. Each step works on all meshes of a piece of the batch at once, in lists instead of loops:
outline edges, their crossings with rows of pixel centres, and the pixel pairs that they separate.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from hoi.rendering.target import SilhouetteTarget
from hoi.rendering.topology import MeshTopology

_FARTHEST_PIXEL = 1e6  # as in the kernels
_MOST_PIXELS = 2**22  # of all images that are worked on at once: bounds the memory


def loss(
    xy: Tensor,
    topology: MeshTopology,
    target: SilhouetteTarget,
    mask_weight: float,
    edge_weight: float,
) -> tuple[Tensor, Tensor]:
    """See :func:`hoi.rendering.silhouette_loss`."""
    return _Loss.apply(xy, topology, target, mask_weight, edge_weight)


def overlap(xy: Tensor, topology: MeshTopology, target: SilhouetteTarget) -> Tensor:
    """See :func:`hoi.rendering.silhouette_iou`."""
    mesh, wanted = _mesh(topology, xy.device), _target(target, xy)
    pieces = []
    for points in _pieces(xy.detach(), *target.shape):
        covered = _hard(points, _outline(points, mesh), *target.shape)
        own = covered * wanted.keep
        pieces.append(_iou((own * wanted.mask).sum((1, 2)), own.sum((1, 2)), target))
    return torch.cat(pieces)


def image(
    xy: Tensor, topology: MeshTopology, height: int, width: int, antialias: bool = True
) -> Tensor:
    """See :func:`hoi.rendering.render_silhouette`."""
    mesh = _mesh(topology, xy.device)
    pieces = []
    for points in _pieces(xy, height, width):
        outline = _outline(points.detach(), mesh)
        hard = _hard(points.detach(), outline, height, width)
        pairs = _pairs(points, outline, hard) if antialias else []
        pieces.append(_blended(hard.to(xy), pairs))
    return torch.cat(pieces)


class _Loss(torch.autograd.Function):
    """Gradients are taken piece by piece in forward, so that no piece's graph outlives it."""

    @staticmethod
    def forward(ctx, xy, topology, target, mask_weight, edge_weight):
        mesh, wanted = _mesh(topology, xy.device), _target(target, xy)
        losses, ious, grads = [], [], []
        for points in _pieces(xy.detach(), *target.shape):
            with torch.set_grad_enabled(ctx.needs_input_grad[0]):
                points.requires_grad_(ctx.needs_input_grad[0])
                value, iou = _compare(points, mesh, wanted, mask_weight, edge_weight, target)
                if ctx.needs_input_grad[0]:
                    grads += torch.autograd.grad(value.sum(), points)
            losses.append(value.detach())
            ious.append(iou)
        ctx.grad = torch.cat(grads) if grads else None
        iou = torch.cat(ious)
        ctx.mark_non_differentiable(iou)
        return torch.cat(losses), iou

    @staticmethod
    def backward(ctx, *grads):
        return (ctx.grad * grads[0][:, None, None], None, None, None, None)


class _Mesh(NamedTuple):
    faces: Tensor  # (F, 3)
    edges: Tensor  # (E, 2)
    edge_faces: Tensor  # (E, 4)


class _Target(NamedTuple):
    mask: Tensor  # (H, W)
    keep: Tensor
    edge_distance: Tensor


class _Outline(NamedTuple):
    batch: Tensor  # (N,) mesh of each outline edge
    ends: Tensor  # (N, 2) its vertices
    net: Tensor  # (N,) its multiplicity


class _Pairs(NamedTuple):
    """Separated pixel pairs along one axis: side by side (0) or above each other (1)."""

    axis: int
    batch: Tensor  # (P,)
    line: Tensor  # (P,) row of the pair, or its column where axis is 1
    first: Tensor  # (P,) place of its first pixel along the line
    inside: Tensor  # (P,) whether that pixel is covered
    position: Tensor  # (P,) where the outermost edge passes, differentiable


def _compare(points, mesh, wanted, mask_weight, edge_weight, target) -> tuple[Tensor, Tensor]:
    outline = _outline(points.detach(), mesh)
    hard = _hard(points.detach(), outline, *target.shape)
    pairs = _pairs(points, outline, hard)
    drawn = _blended(hard.to(points), pairs)
    value = mask_weight * (wanted.keep * (drawn - wanted.mask).square()).sum((1, 2))
    for found in pairs:
        value = value.index_add(0, found.batch, edge_weight * _edge_terms(found, wanted))
    with torch.no_grad():
        shared = (wanted.keep * torch.minimum(drawn, wanted.mask)).sum((1, 2))
        iou = _iou(shared, (wanted.keep * drawn).sum((1, 2)), target)
    return value, iou


def _outline(points: Tensor, mesh: _Mesh) -> _Outline:
    """Edges whose faces, all turned positive on screen, do not cancel."""
    corners = points[:, mesh.faces]
    u, v = corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
    area = u[..., 0] * v[..., 1] - v[..., 0] * u[..., 1]
    usable = corners.abs().amax((2, 3)) < _FARTHEST_PIXEL  # not where anything is NaN
    sign = torch.where(usable, area.sign(), 0).to(torch.int32)
    face0, way0, face1, way1 = mesh.edge_faces.unbind(1)
    net = way0 * sign[:, face0] + way1 * sign[:, face1]
    batch, edge = torch.nonzero(net, as_tuple=True)
    return _Outline(batch, mesh.edges[edge], net[batch, edge])


def _hard(points: Tensor, outline: _Outline, height: int, width: int) -> Tensor:
    """(B, H, W) whether each pixel centre is covered: running sums of crossings along rows."""
    a, b = points[outline.batch, outline.ends[:, 0]], points[outline.batch, outline.ends[:, 1]]
    edge, row = _crossed_lines(a[:, 1], b[:, 1], height)
    a, b, batch = a[edge], b[edge], outline.batch[edge]
    slope = (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    x = (a[:, 0] + (row + 0.5 - a[:, 1]) * slope - 0.5).clamp(0, width)
    step = torch.where(a[:, 1] < b[:, 1], -1, 1) * outline.net[edge]
    change = torch.zeros(len(points) * height * (width + 1), dtype=torch.int32, device=x.device)
    change.index_add_(0, (batch * height + row) * (width + 1) + x.ceil().long(), step.int())
    winding = change.view(len(points), height, width + 1).cumsum(-1, dtype=torch.int32)
    return winding[..., :width] > 0


def _pairs(points: Tensor, outline: _Outline, hard: Tensor) -> list[_Pairs]:
    return [_pairs_along(axis, points, outline, hard) for axis in (0, 1)]


def _pairs_along(axis: int, points: Tensor, outline: _Outline, hard: Tensor) -> _Pairs:
    """Neighbours of unlike coverage on steep (axis 0) or flat edges, with the outermost edge."""
    along, across = (0, 1) if axis == 0 else (1, 0)
    covered = hard if axis == 0 else hard.transpose(1, 2)
    lines, cells = covered.shape[1:]
    fixed = points.detach()
    a, b = fixed[outline.batch, outline.ends[:, 0]], fixed[outline.batch, outline.ends[:, 1]]
    run, rise = (b - a)[:, along].abs(), (b - a)[:, across].abs()
    steep = torch.nonzero(rise >= run if axis == 0 else rise > run)[:, 0]
    edge, line = _crossed_lines(a[steep, across], b[steep, across], lines)
    edge = steep[edge]
    position = _passes(a[edge], b[edge], line, along, across)
    first = torch.floor(position - 0.5).long()
    batch = outline.batch[edge]
    on_grid = (first >= 0) & (first < cells - 1)
    at = first.clamp(0, max(cells - 2, 0))
    inside, beyond = covered[batch, line, at], covered[batch, line, (at + 1).clamp(max=cells - 1)]
    chosen = torch.nonzero(on_grid & (inside != beyond))[:, 0]
    # of all edges between a pair the outermost: the farthest from its covered pixel, else the first
    outward = torch.where(inside, position, -position)[chosen]
    pair = ((batch * lines + line) * cells + first)[chosen]
    best = outward.new_full((covered.numel(),), -torch.inf)
    best.scatter_reduce_(0, pair, outward, "amax")
    chosen, pair = chosen[outward == best[pair]], pair[outward == best[pair]]
    earliest = torch.full((covered.numel(),), len(edge), dtype=torch.long, device=edge.device)
    earliest.scatter_reduce_(0, pair, chosen, "amin")
    chosen = chosen[earliest[pair] == chosen]

    batch, line, ends = batch[chosen], line[chosen], outline.ends[edge[chosen]]
    position = _passes(points[batch, ends[:, 0]], points[batch, ends[:, 1]], line, along, across)
    return _Pairs(axis, batch, line, first[chosen], inside[chosen], position)


def _passes(a: Tensor, b: Tensor, line: Tensor, along: int, across: int) -> Tensor:
    slope = (b[:, along] - a[:, along]) / (b[:, across] - a[:, across])
    return a[:, along] + (line + 0.5 - a[:, across]) * slope


def _crossed_lines(start: Tensor, end: Tensor, lines: int) -> tuple[Tensor, Tensor]:
    """Every (segment, line of pixel centres) that cross, in the order of the segments."""
    first = torch.ceil(torch.minimum(start, end) - 0.5).clamp(0, lines).long()
    after = torch.ceil(torch.maximum(start, end) - 0.5).clamp(0, lines).long()
    count = (after - first).clamp(min=0)
    segment = torch.repeat_interleave(count)
    before = count.cumsum(0) - count
    place = torch.arange(len(segment), device=segment.device)
    return segment, place - before[segment] + first[segment]


def _blended(hard: Tensor, pairs: list[_Pairs]) -> Tensor:
    """The anti-aliased images (B, H, W): each pair's edge blends the pixel that it passes over."""
    height, width = hard.shape[1:]
    drawn = hard.reshape(-1)
    for found in pairs:
        past_border = found.position - (found.first + 1)
        change = torch.where(found.inside, past_border, -past_border)
        cell = found.first + (past_border > 0)
        row, column = (found.line, cell) if found.axis == 0 else (cell, found.line)
        drawn = drawn.index_add(0, (found.batch * height + row) * width + column, change)
    drawn = drawn.reshape(hard.shape)
    return drawn + (drawn.clamp(0, 1) - drawn).detach()  # a clamped pixel keeps its gradient


def _edge_terms(found: _Pairs, wanted: _Target) -> Tensor:
    """keep * distance to the mask's outline where each pair is separated (P,)."""
    keep = wanted.keep if found.axis == 0 else wanted.keep.T
    table = wanted.edge_distance if found.axis == 0 else wanted.edge_distance.T
    distance, beyond = table[found.line, found.first], table[found.line, found.first + 1]
    known = torch.minimum(keep[found.line, found.first], keep[found.line, found.first + 1])
    return known * (distance + (found.position - found.first - 0.5) * (beyond - distance))


def _iou(intersection: Tensor, area: Tensor, target: SilhouetteTarget) -> Tensor:
    return (intersection / (target.area + area - intersection).clamp(min=1e-6)).clamp(0, 1)


def _pieces(xy: Tensor, height: int, width: int) -> Iterator[Tensor]:
    yield from xy.split(max(1, _MOST_PIXELS // max(height * width, 1))) if len(xy) else (xy,)


_TABLES: WeakKeyDictionary[Any, dict[Any, Any]] = WeakKeyDictionary()


def _mesh(topology: MeshTopology, device: torch.device) -> _Mesh:
    """The topology's tables on a device, copied there once."""
    kept = _TABLES.setdefault(topology, {})
    if device not in kept:
        tables = (topology.faces, topology.edges, topology.edge_faces)
        kept[device] = _Mesh(*(torch.from_numpy(table).to(device).long() for table in tables))
    return kept[device]


def _target(target: SilhouetteTarget, like: Tensor) -> _Target:
    """The target's tables on the device and in the type of a tensor, copied there once."""
    kept = _TABLES.setdefault(target, {})
    key = (like.device, like.dtype)
    if key not in kept:
        tables = (target.mask, target.keep, target.edge_distance)
        kept[key] = _Target(*(torch.from_numpy(table).to(like) for table in tables))
    return kept[key]
