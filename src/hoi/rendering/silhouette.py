"""Silhouettes of posed meshes: loss with gradient, score, and image.

Three back ends compute the same: ``numba`` (kernels, the default on the CPU), ``torch`` (standard
operations, the default on any other device) and ``reference`` (slow and obvious, in float64).
"""

from __future__ import annotations

from types import ModuleType
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from hoi.geometry.camera import NEAR, project
from hoi.rendering import numba_backend, reference, torch_backend
from hoi.rendering.clipping import clip_near
from hoi.rendering.target import SilhouetteTarget
from hoi.rendering.topology import MeshTopology

Backend = Literal["numba", "torch", "reference"]
_BACKENDS: dict[str, ModuleType] = {
    "numba": numba_backend, "torch": torch_backend, "reference": reference,
}  # fmt: skip


def silhouette_loss(
    xy: Tensor,
    topology: MeshTopology,
    target: SilhouetteTarget,
    mask_weight: float = 1.0,
    edge_weight: float = 0.0,
    backend: Backend | None = None,
) -> tuple[Tensor, Tensor]:
    """Compare B projected meshes with one mask; differentiable in every vertex.

    ``mask_weight * sum_p keep (S - M)^2 + edge_weight * sum_q keep D_q`` where S is the
    anti-aliased silhouette, q runs over the pixel pairs that its outline separates and D_q is the
    target's `edge_distance` where the outline passes between them (rendered outline to mask
    outline, one way, as PHOSA's edge term). The gradient of D_q moves the outline; it does not
    count that a longer outline has more pairs.

    Args:
        xy: (B, V, 2) image coordinates in pixels of the target's grid. A face with a corner that
            is not finite, or more than a million pixels away, is left out.
        topology: faces and edges of the mesh, V vertices.
        target: the mask and the pixels that count.
        mask_weight: per pixel.
        edge_weight: per pixel of outline and square root of pixel of distance.
        backend: who computes; none: numba for tensors on the CPU, torch for others.

    Returns:
        loss (B,) float32 with gradient to `xy`; soft intersection over union
        ``sum keep min(S, M) / sum keep max(S, M)`` (B,), no gradient.

    Raises:
        ValueError: `xy` has not the shape (B, V, 2).
    """
    _check(xy, topology)
    return _chosen(backend, xy).loss(xy, topology, target, mask_weight, edge_weight)


def silhouette_iou(
    xy: Tensor,
    topology: MeshTopology,
    target: SilhouetteTarget,
    backend: Backend | None = None,
) -> Tensor:
    """Intersection over union (B,) of hard silhouettes with the mask where `keep` says so.

    About half the cost of the loss, for ranking many poses. `xy` and `backend` as in
    :func:`silhouette_loss`.
    """
    _check(xy, topology)
    return _chosen(backend, xy).overlap(xy, topology, target)


def render_silhouette(
    xy: Tensor,
    topology: MeshTopology,
    height: int,
    width: int,
    antialias: bool = True,
    backend: Backend | None = None,
) -> Tensor:
    """Silhouette images (B, H, W) in [0, 1]; differentiable unless `antialias` is off.

    Without anti-aliasing a pixel is one where a face covers its centre. `xy` and `backend` as in
    :func:`silhouette_loss`.
    """
    _check(xy, topology)
    points = xy if antialias else xy.detach()
    return _chosen(backend, xy).image(points, topology, height, width, antialias)


def pose_silhouette_loss(
    vertices: Tensor,
    linear: Tensor,
    shift: Tensor,
    intrinsics: np.ndarray,
    topology: MeshTopology,
    target: SilhouetteTarget,
    mask_weight: float = 1.0,
    edge_weight: float = 0.0,
    backend: Backend | None = None,
) -> tuple[Tensor, Tensor]:
    """:func:`silhouette_loss` of one mesh at B placements, differentiable in the placements.

    The same as projecting ``vertices @ linear.T + shift`` with :func:`hoi.geometry.project` first,
    in a third of the time: neither the projected vertices nor their gradients are stored. A mesh
    that crosses the near plane is cut there (see :func:`hoi.rendering.clip_near`), one at a time.

    Args:
        vertices: (V, 3) metres, object frame; no gradient reaches them.
        linear: (B, 3, 3) any linear map, as a rule rotation times size.
        shift: (B, 3) metres, camera frame.
        intrinsics: (3, 3) K of the target's grid, pixels.
        topology, target, mask_weight, edge_weight, backend: as in :func:`silhouette_loss`.

    Returns:
        loss (B,) float32 with gradient to `linear` and `shift`; soft IoU (B,), no gradient.

    Raises:
        ValueError: a shape does not fit.
    """
    _check_pose(vertices, linear, shift, topology)
    crossing = _crossing_near(vertices, linear, shift)
    whole = [i for i in range(len(linear)) if i not in crossing]
    turns, moves = (linear[whole], shift[whole]) if crossing else (linear, shift)
    chosen = _chosen(backend, linear)
    if chosen is numba_backend:
        loss, iou = numba_backend.pose_loss(
            vertices, turns, moves, intrinsics, topology, target, mask_weight,
            edge_weight,
        )  # fmt: skip
    else:
        xy = _projected(vertices, turns, moves, intrinsics)
        loss, iou = chosen.loss(xy, topology, target, mask_weight, edge_weight)
    if not crossing:
        return loss, iou
    order = torch.tensor([*whole, *crossing], device=loss.device).argsort()
    cut = [
        chosen.loss(
            *_clipped(i, vertices, linear, shift, intrinsics, topology), target, mask_weight,
            edge_weight,
        )
        for i in crossing
    ]  # fmt: skip
    losses = torch.cat([loss, *(one for one, _ in cut)])
    return losses[order], torch.cat([iou, *(one for _, one in cut)])[order]


def pose_silhouette_iou(
    vertices: Tensor,
    linear: Tensor,
    shift: Tensor,
    intrinsics: np.ndarray,
    topology: MeshTopology,
    target: SilhouetteTarget,
    backend: Backend | None = None,
) -> Tensor:
    """:func:`silhouette_iou` (B,) of one mesh at B placements; see pose_silhouette_loss."""
    _check_pose(vertices, linear, shift, topology)
    chosen = _chosen(backend, linear)
    with torch.no_grad():
        if chosen is numba_backend:
            iou = numba_backend.pose_overlap(vertices, linear, shift, intrinsics, topology, target)
        else:
            xy = _projected(vertices, linear, shift, intrinsics)
            iou = chosen.overlap(xy, topology, target)
        for i in _crossing_near(vertices, linear, shift):
            cut = _clipped(i, vertices, linear, shift, intrinsics, topology)
            iou[i] = chosen.overlap(*cut, target)[0]
    return iou


def _chosen(backend: Backend | None, like: Tensor) -> ModuleType:
    name = backend or ("numba" if like.device.type == "cpu" else "torch")
    if name not in _BACKENDS:
        raise ValueError(f"no silhouette back end {name!r}; there are: {', '.join(_BACKENDS)}")
    return _BACKENDS[name]


def _projected(vertices: Tensor, linear: Tensor, shift: Tensor, intrinsics: np.ndarray) -> Tensor:
    return project(vertices @ linear.transpose(1, 2) + shift[:, None], intrinsics)


def _crossing_near(vertices: Tensor, linear: Tensor, shift: Tensor) -> list[int]:
    """Placements that have vertices nearer than the near plane."""
    with torch.no_grad():
        reach = vertices.norm(dim=1).max() if len(vertices) else vertices.new_zeros(())
        doubtful = shift[:, 2] - reach * linear[:, 2].norm(dim=1) < NEAR
        if not bool(doubtful.any()):
            return []
        places = torch.nonzero(doubtful)[:, 0]
        depth = linear[places, 2] @ vertices.T + shift[places, 2:]
        return places[(depth < NEAR).any(1)].tolist()


def _clipped(
    index: int,
    vertices: Tensor,
    linear: Tensor,
    shift: Tensor,
    intrinsics: np.ndarray,
    topology: MeshTopology,
) -> tuple[Tensor, MeshTopology]:
    """Image coordinates (1, V', 2) and topology of one placement's part before the near plane."""
    placed = vertices @ linear[index].T + shift[index]
    points, faces = clip_near(placed, topology.faces, NEAR)
    return project(points, intrinsics)[None], MeshTopology.from_faces(faces, len(points))


def _check(xy: Tensor, topology: MeshTopology) -> None:
    if xy.ndim != 3 or xy.shape[1:] != (topology.num_vertices, 2):
        raise ValueError(
            f"xy has shape {tuple(xy.shape)}, expected (B, {topology.num_vertices}, 2)"
        )


def _check_pose(vertices: Tensor, linear: Tensor, shift: Tensor, topology: MeshTopology) -> None:
    count = len(linear)
    shapes = (tuple(vertices.shape), tuple(linear.shape), tuple(shift.shape))
    if shapes != ((topology.num_vertices, 3), (count, 3, 3), (count, 3)):
        raise ValueError(
            f"vertices, linear, shift have shapes {shapes}, expected "
            f"({topology.num_vertices}, 3), (B, 3, 3), (B, 3)"
        )
