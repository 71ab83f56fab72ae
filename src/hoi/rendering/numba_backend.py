"""The silhouette algorithm on the CPU: torch's door to the Numba kernels."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from hoi.geometry.camera import NEAR
from hoi.rendering import kernels
from hoi.rendering.target import SilhouetteTarget
from hoi.rendering.topology import MeshTopology


def loss(
    xy: Tensor,
    topology: MeshTopology,
    target: SilhouetteTarget,
    mask_weight: float,
    edge_weight: float,
) -> tuple[Tensor, Tensor]:
    """See :func:`hoi.rendering.silhouette_loss`."""
    return _SilhouetteLoss.apply(xy, topology, target, mask_weight, edge_weight)


def overlap(xy: Tensor, topology: MeshTopology, target: SilhouetteTarget) -> Tensor:
    """See :func:`hoi.rendering.silhouette_iou`."""
    points = _as_numpy(xy)
    intersection = np.empty(len(points), np.float32)
    area = np.empty(len(points), np.float32)
    kernels.overlap(points, _mesh(topology), target.prefix, intersection, area)
    return torch.from_numpy(_iou(intersection, area, target)).to(xy.device)


def image(
    xy: Tensor, topology: MeshTopology, height: int, width: int, antialias: bool = True
) -> Tensor:
    """See :func:`hoi.rendering.render_silhouette`."""
    return _SilhouetteImage.apply(xy, topology, height, width, antialias)


def pose_loss(
    vertices: Tensor,
    linear: Tensor,
    shift: Tensor,
    intrinsics: np.ndarray,
    topology: MeshTopology,
    target: SilhouetteTarget,
    mask_weight: float,
    edge_weight: float,
) -> tuple[Tensor, Tensor]:
    """See :func:`hoi.rendering.pose_silhouette_loss`; meshes before the near plane only."""
    return _PoseLoss.apply(
        linear, shift, vertices, intrinsics, topology, target, mask_weight, edge_weight
    )


def pose_overlap(
    vertices: Tensor,
    linear: Tensor,
    shift: Tensor,
    intrinsics: np.ndarray,
    topology: MeshTopology,
    target: SilhouetteTarget,
) -> Tensor:
    """See :func:`hoi.rendering.pose_silhouette_iou`; meshes before the near plane only."""
    intersection = np.empty(len(linear), np.float32)
    area = np.empty(len(linear), np.float32)
    kernels.pose_overlap(
        _as_numpy(vertices), _as_numpy(linear), _as_numpy(shift), _camera(intrinsics),
        np.float32(NEAR), _mesh(topology), target.prefix, intersection, area,
    )  # fmt: skip
    return torch.from_numpy(_iou(intersection, area, target)).to(linear.device)


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
