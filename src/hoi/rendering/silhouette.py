"""Silhouettes of posed meshes: loss with gradient, score, and image."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from hoi.geometry.camera import NEAR, project
from hoi.rendering import kernels
from hoi.rendering.clipping import clip_near
from hoi.rendering.target import SilhouetteTarget
from hoi.rendering.topology import MeshTopology


def silhouette_loss(
    xy: Tensor,
    topology: MeshTopology,
    target: SilhouetteTarget,
    mask_weight: float = 1.0,
    edge_weight: float = 0.0,
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

    Returns:
        loss (B,) float32 with gradient to `xy`; soft intersection over union
        ``sum keep min(S, M) / sum keep max(S, M)`` (B,), no gradient.

    Raises:
        ValueError: `xy` has not the shape (B, V, 2).
    """
    _check(xy, topology)
    return _SilhouetteLoss.apply(xy, topology, target, mask_weight, edge_weight)


def silhouette_iou(xy: Tensor, topology: MeshTopology, target: SilhouetteTarget) -> Tensor:
    """Intersection over union (B,) of hard silhouettes with the mask where `keep` says so.

    About half the cost of the loss, for ranking many poses. `xy` as in :func:`silhouette_loss`.
    """
    _check(xy, topology)
    points = _as_numpy(xy)
    intersection = np.empty(len(points), np.float32)
    area = np.empty(len(points), np.float32)
    kernels.overlap(points, _mesh(topology), target.prefix, intersection, area)
    return torch.from_numpy(_iou(intersection, area, target)).to(xy.device)


def render_silhouette(
    xy: Tensor, topology: MeshTopology, height: int, width: int, antialias: bool = True
) -> Tensor:
    """Silhouette images (B, H, W) in [0, 1]; differentiable unless `antialias` is off.

    Without anti-aliasing a pixel is one where a face covers its centre. `xy` as in
    :func:`silhouette_loss`.
    """
    _check(xy, topology)
    points = xy if antialias else xy.detach()
    return _SilhouetteImage.apply(points, topology, height, width, antialias)


def pose_silhouette_loss(
    vertices: Tensor,
    linear: Tensor,
    shift: Tensor,
    intrinsics: np.ndarray,
    topology: MeshTopology,
    target: SilhouetteTarget,
    mask_weight: float = 1.0,
    edge_weight: float = 0.0,
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
        topology, target, mask_weight, edge_weight: as in :func:`silhouette_loss`.

    Returns:
        loss (B,) float32 with gradient to `linear` and `shift`; soft IoU (B,), no gradient.

    Raises:
        ValueError: a shape does not fit.
    """
    _check_pose(vertices, linear, shift, topology)
    crossing = _crossing_near(vertices, linear, shift)
    whole = [i for i in range(len(linear)) if i not in crossing] if crossing else slice(None)
    loss, iou = _PoseLoss.apply(
        linear[whole], shift[whole], vertices, intrinsics, topology, target, mask_weight,
        edge_weight,
    )  # fmt: skip
    if not crossing:
        return loss, iou
    order = torch.tensor([*whole, *crossing]).argsort()
    cut = [
        silhouette_loss(*_clipped(i, vertices, linear, shift, intrinsics, topology), target,
                        mask_weight, edge_weight)
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
) -> Tensor:
    """:func:`silhouette_iou` (B,) of one mesh at B placements; see pose_silhouette_loss."""
    _check_pose(vertices, linear, shift, topology)
    intersection = np.empty(len(linear), np.float32)
    area = np.empty(len(linear), np.float32)
    kernels.pose_overlap(
        _as_numpy(vertices), _as_numpy(linear), _as_numpy(shift), _camera(intrinsics),
        np.float32(NEAR), _mesh(topology), target.prefix, intersection, area,
    )  # fmt: skip
    iou = torch.from_numpy(_iou(intersection, area, target)).to(linear.device)
    for i in _crossing_near(vertices, linear, shift):
        cut = _clipped(i, vertices, linear.detach(), shift.detach(), intrinsics, topology)
        iou[i] = silhouette_iou(*cut, target)[0]
    return iou


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


class _SilhouetteLoss(torch.autograd.Function):
    @staticmethod
    def forward(ctx, xy, topology, target, mask_weight, edge_weight):
        points = _as_numpy(xy)
        loss = np.empty(len(points), np.float32)
        intersection = np.empty(len(points), np.float32)
        area = np.empty(len(points), np.float32)
        grad = np.zeros_like(points)
        weights = kernels.Weights(np.float32(mask_weight), np.float32(edge_weight))
        kernels.loss_and_gradient(
            points, _mesh(topology), _target(target), weights, loss, intersection, area, grad
        )
        ctx.grad = torch.from_numpy(grad).to(xy)
        iou = torch.from_numpy(_iou(intersection, area, target)).to(xy.device)
        ctx.mark_non_differentiable(iou)
        return torch.from_numpy(loss).to(xy), iou

    @staticmethod
    def backward(ctx, *grads):
        return (ctx.grad * grads[0][:, None, None], None, None, None, None)


class _PoseLoss(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx, linear, shift, vertices, intrinsics, topology, target, mask_weight, edge_weight
    ):
        loss = np.empty(len(linear), np.float32)
        intersection = np.empty(len(linear), np.float32)
        area = np.empty(len(linear), np.float32)
        linear_grad = np.empty((len(linear), 3, 3), np.float32)
        shift_grad = np.empty((len(linear), 3), np.float32)
        weights = kernels.Weights(np.float32(mask_weight), np.float32(edge_weight))
        kernels.pose_loss_and_gradient(
            _as_numpy(vertices), _as_numpy(linear), _as_numpy(shift), _camera(intrinsics),
            np.float32(NEAR), _mesh(topology), _target(target), weights,
            loss, intersection, area, linear_grad, shift_grad,
        )  # fmt: skip
        ctx.linear_grad = torch.from_numpy(linear_grad).to(linear)
        ctx.shift_grad = torch.from_numpy(shift_grad).to(shift)
        iou = torch.from_numpy(_iou(intersection, area, target)).to(linear.device)
        ctx.mark_non_differentiable(iou)
        return torch.from_numpy(loss).to(linear), iou

    @staticmethod
    def backward(ctx, *grads):
        to_linear = ctx.linear_grad * grads[0][:, None, None]
        to_shift = ctx.shift_grad * grads[0][:, None]
        return (to_linear, to_shift, None, None, None, None, None, None)


class _SilhouetteImage(torch.autograd.Function):
    @staticmethod
    def forward(ctx, xy, topology, height, width, antialias):
        points = _as_numpy(xy)
        image = np.empty((len(points), height, width), np.float32)
        kernels.render_images(points, _mesh(topology), bool(antialias), image)
        ctx.points, ctx.topology = points, topology
        return torch.from_numpy(image).to(xy)

    @staticmethod
    def backward(ctx, *grads):
        grad = np.zeros_like(ctx.points)
        kernels.image_gradient(ctx.points, _mesh(ctx.topology), _as_numpy(grads[0]), grad)
        return (torch.from_numpy(grad).to(grads[0]), None, None, None, None)


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


def _camera(intrinsics: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(intrinsics, np.float32)


def _as_numpy(values: Tensor) -> np.ndarray:
    return values.detach().to("cpu", torch.float32).contiguous().numpy()


def _mesh(topology: MeshTopology) -> kernels.Mesh:
    return kernels.Mesh(topology.faces, topology.edges, topology.edge_faces)


def _target(target: SilhouetteTarget) -> kernels.Target:
    return kernels.Target(target.pixels, target.prefix, np.float32(target.base_loss))


def _iou(intersection: np.ndarray, area: np.ndarray, target: SilhouetteTarget) -> np.ndarray:
    union = np.float32(target.area) + area - intersection
    return np.clip(intersection / np.maximum(union, np.float32(1e-6)), 0, 1)
