"""Nearest-neighbour correspondences between object parts and body parts, found without gradient.

The distance to a nearest neighbour has the same derivative as the distance to that fixed point, so
the search runs outside autograd (numba) and the loss gathers the pairs it found: exact gradients
at a fraction of the cost of differentiating a distance matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
import torch
from torch import Tensor

from hoi.joint.contacts import ContactPair


@dataclass(frozen=True)
class PairTable:
    """Contact pairs over two point lists: object points (O) and body points (B).

    Pair p takes object points `object_index[object_start[p]:object_start[p+1]]` and body points
    likewise. It yields one row for each point of the side that looks (`to_body`: the object).
    """

    object_index: np.ndarray
    object_start: np.ndarray
    body_index: np.ndarray
    body_start: np.ndarray
    to_body: np.ndarray  # (P,) bool
    row_pair: np.ndarray  # (R,) pair of every row
    row_weights: np.ndarray  # (R,) weight of the pair / number of its rows
    alternatives: np.ndarray  # (P,) int, -1: always counts

    @property
    def num_rows(self) -> int:
        return len(self.row_pair)

    @property
    def num_pairs(self) -> int:
        return len(self.to_body)


def pair_table(
    pairs: Sequence[ContactPair],
    object_slices: dict[str, np.ndarray],
    body_slices: dict[str, np.ndarray],
) -> PairTable:
    """Lay pairs of part names over point lists; slices give the point indices of each part."""

    def gather(names: tuple[str, ...], slices: dict[str, np.ndarray]) -> np.ndarray:
        return np.concatenate([slices[name] for name in names])

    objects = [gather(pair.object_parts, object_slices) for pair in pairs]
    bodies = [gather(pair.body_parts, body_slices) for pair in pairs]
    rows = [len(o) if p.to_body else len(b) for p, o, b in zip(pairs, objects, bodies, strict=True)]
    empty = [np.zeros(0, np.int64)]
    weights = [pair.weight / count for pair, count in zip(pairs, rows, strict=True)]
    return PairTable(
        object_index=np.concatenate(objects or empty),
        object_start=np.cumsum([0, *map(len, objects)]),
        body_index=np.concatenate(bodies or empty),
        body_start=np.cumsum([0, *map(len, bodies)]),
        to_body=np.array([pair.to_body for pair in pairs], bool),
        row_pair=np.repeat(np.arange(len(pairs)), rows),
        row_weights=np.repeat(np.array(weights, np.float64), rows),
        alternatives=np.array([pair.alternative for pair in pairs], np.int64),
    )


def nearest(
    table: PairTable,
    object_points: Tensor,
    object_normals: Tensor,
    present: Tensor,
    body_points: Tensor,
    body_normals: Tensor,
    human_scale: Tensor,
    only_opposing: bool,
) -> tuple[Tensor, Tensor]:
    """Indices of the nearest pairs.

    Args:
        object_points, object_normals: (K, O, 3) placed object, camera frame, metres.
        present: (K, O) False where hypothesis k lacks the part.
        body_points, body_normals: (B, 3) of the body at scale 1.
        human_scale: (K,) the body of hypothesis k is `human_scale[k] * body_points`.
        only_opposing: look among points with opposing normals alone (cosine < 0).

    Returns:
        object index and body index of every row, (K, R) int64 each, -1 where there is none.
    """
    shape = (len(object_points), table.num_rows)
    objects, bodies = np.empty(shape, np.int64), np.empty(shape, np.int64)
    _nearest(
        _array(object_points),
        _array(object_normals),
        present.numpy(),
        _array(body_points),
        _array(body_normals),
        _array(human_scale),
        table.object_index,
        table.object_start,
        table.body_index,
        table.body_start,
        table.to_body,
        only_opposing,
        objects,
        bodies,
    )
    return torch.from_numpy(objects), torch.from_numpy(bodies)


def nearest_reference(
    table: PairTable,
    object_points: Tensor,
    object_normals: Tensor,
    present: Tensor,
    body_points: Tensor,
    body_normals: Tensor,
    human_scale: Tensor,
    only_opposing: bool,
) -> tuple[Tensor, Tensor]:
    """The same as `nearest` by distance matrices: slow, obvious, for the tests."""
    objects, bodies = [], []
    for p in range(table.num_pairs):
        o = torch.from_numpy(table.object_index[table.object_start[p] : table.object_start[p + 1]])
        b = torch.from_numpy(table.body_index[table.body_start[p] : table.body_start[p + 1]])
        body = human_scale[:, None, None] * body_points[b]
        squared = (object_points[:, o, None] - body[:, None]).square().sum(-1)  # (K, o, b)
        allowed = present[:, o, None].expand(squared.shape)
        if only_opposing:
            cosine = torch.einsum("kod,bd->kob", object_normals[:, o], body_normals[b])
            allowed = allowed & (cosine < 0)
        squared = squared.masked_fill(~allowed, float("inf"))
        if table.to_body[p]:
            best, index = squared.min(2)
            found_object, found_body = o.expand(best.shape), b[index]
        else:
            best, index = squared.min(1)
            found_object, found_body = o[index], b.expand(best.shape)
        none = ~torch.isfinite(best)
        objects.append(found_object.masked_fill(none, -1))
        bodies.append(found_body.masked_fill(none, -1))
    return torch.cat(objects, 1), torch.cat(bodies, 1)


def cheapest_alternatives(pair_costs: Tensor, alternatives: np.ndarray) -> Tensor:
    """(K, P) bool: which pairs count when of each set of alternatives only the cheapest does.

    Ties go to the first. `pair_costs` (K, P) without gradient.
    """
    active = torch.ones_like(pair_costs, dtype=torch.bool)
    for number in np.unique(alternatives[alternatives >= 0]):
        members = torch.from_numpy(np.flatnonzero(alternatives == number))
        winner = members[pair_costs[:, members].argmin(1)]
        active[:, members] = members[None] == winner[:, None]
    return active


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


@numba.njit(cache=True, nogil=True)
def _nearest(
    object_points,
    object_normals,
    present,
    body_points,
    body_normals,
    human_scale,
    object_index,
    object_start,
    body_index,
    body_start,
    to_body,
    only_opposing,
    found_object,
    found_body,
):
    for k in range(object_points.shape[0]):
        points, normals, scale = object_points[k], object_normals[k], human_scale[k]
        row = 0
        for p in range(len(to_body)):
            o0, o1 = object_start[p], object_start[p + 1]
            b0, b1 = body_start[p], body_start[p + 1]
            if to_body[p]:
                for i in range(o0, o1):
                    o = object_index[i]
                    best, chosen = np.inf, -1
                    if present[k, o]:
                        for j in range(b0, b1):
                            b = body_index[j]
                            if only_opposing and _dot(normals[o], body_normals[b]) >= 0:
                                continue
                            squared = _squared(points[o], body_points[b], scale)
                            if squared < best:
                                best, chosen = squared, b
                    found_object[k, row] = o if chosen >= 0 else -1
                    found_body[k, row] = chosen
                    row += 1
            else:
                for j in range(b0, b1):
                    b = body_index[j]
                    best, chosen = np.inf, -1
                    for i in range(o0, o1):
                        o = object_index[i]
                        if not present[k, o]:
                            continue
                        if only_opposing and _dot(normals[o], body_normals[b]) >= 0:
                            continue
                        squared = _squared(points[o], body_points[b], scale)
                        if squared < best:
                            best, chosen = squared, o
                    found_object[k, row] = chosen
                    found_body[k, row] = b if chosen >= 0 else -1
                    row += 1


@numba.njit(inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(inline="always")
def _squared(a, b, scale):
    x, y, z = a[0] - scale * b[0], a[1] - scale * b[1], a[2] - scale * b[2]
    return x * x + y * y + z * z
