"""From many starts to a few poses per exemplar: score, prune, refine in narrowing rounds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hoi.exemplars import Exemplar
from hoi.geometry import matrix_to_rotation_6d, rotation_6d_to_matrix
from hoi.objectfit.config import RefineStep
from hoi.objectfit.starts import align_to_boxes, support_vertices
from hoi.rendering import (
    MeshTopology,
    SilhouetteTarget,
    off_screen,
    pose_silhouette_iou,
    pose_silhouette_loss,
)

_MOST_TOGETHER = 2500  # poses that descend at once


@dataclass(frozen=True, eq=False)
class Shape:
    """What the search needs of an exemplar.

    Attributes:
        vertices: (V, 3) float32 metres, object frame, centred.
        support: (S, 3) the outermost of them.
        radius: metres from the centre to the farthest vertex.
    """

    name: str
    vertices: Tensor
    topology: MeshTopology
    support: Tensor
    radius: float

    @classmethod
    def of(cls, exemplar: Exemplar) -> Shape:
        """Prepare an exemplar once; all frames share the result."""
        vertices = np.ascontiguousarray(exemplar.vertices, np.float32)
        return cls(
            name=exemplar.name,
            vertices=torch.from_numpy(vertices),
            topology=MeshTopology.from_faces(exemplar.faces, len(vertices)),
            support=torch.from_numpy(vertices[support_vertices(vertices)]),
            radius=float(np.linalg.norm(vertices, axis=1).max()),
        )


@dataclass(frozen=True, eq=False)
class View:
    """One grid over the region: its camera and its mask."""

    intrinsics: np.ndarray  # (3, 3)
    target: SilhouetteTarget


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of one exemplar, best first.

    Attributes:
        rotations: (N, 3, 3); translations: (N, 3) metres; ious, losses: (N,).
    """

    shape: Shape
    rotations: Tensor
    translations: Tensor
    ious: Tensor
    losses: Tensor

    def best(self, count: int, distinct_deg: float) -> Poses:
        """The best `count` poses that differ from each other by at least the angle."""
        chosen = distinct(self.rotations, math.radians(distinct_deg), count)
        return Poses(
            self.shape, self.rotations[chosen], self.translations[chosen], self.ious[chosen],
            self.losses[chosen],
        )  # fmt: skip

    def merit(self, count: int) -> float:
        """Mean IoU of the `count` best."""
        return float(self.ious[:count].mean())


def distinct(rotations: Tensor, angle: float, count: int) -> list[int]:
    """Walk down a list of rotations (N, 3, 3), keeping those far from all kept before.

    Args:
        angle: radians. count: stop when so many are kept.
    """
    if angle <= 0:
        return list(range(min(count, len(rotations))))
    flat = rotations.reshape(-1, 9)
    near = (flat @ flat.T - 1) / 2 > math.cos(angle)
    free = torch.ones(len(rotations), dtype=torch.bool)
    kept: list[int] = []
    while len(kept) < count and bool(free.any()):
        index = int(free.to(torch.uint8).argmax())
        kept.append(index)
        free &= ~near[index]
        free[index] = False
    return kept


def score_starts(shape: Shape, rotations: Tensor, boxes: Tensor, view: View) -> Poses:
    """Place the exemplar at each start so that it fills its box, and measure the overlap."""
    translations = align_to_boxes(shape.support, rotations, boxes, view.intrinsics)
    ious = pose_silhouette_iou(
        shape.vertices, rotations, translations, view.intrinsics, shape.topology, view.target
    )
    return _sorted(shape, rotations, translations, ious, torch.zeros_like(ious))


def refine(found: Sequence[Poses], step: RefineStep, view: View) -> list[Poses]:
    """Adam on the silhouette loss of every pose of every exemplar at once [paper 3.5].

    The translation moves as a shift across the image in units of the object's apparent size and as
    the logarithm of its depth, so one learning rate suits near and far, large and small objects.
    Poses share one optimiser because at these sizes the calls cost more than the arithmetic; Adam
    treats every number separately, so no pose feels the others.
    """
    return [poses for group in _groups(found) for poses in _refine_together(group, step, view)]


def _groups(found: Sequence[Poses]) -> list[list[Poses]]:
    """Exemplars in order, in groups of at most _MOST_TOGETHER poses; memory stays bounded."""
    groups: list[list[Poses]] = []
    count = math.inf
    for poses in found:
        count += len(poses.ious)
        if count > _MOST_TOGETHER:
            groups.append([])
            count = len(poses.ious)
        groups[-1].append(poses)
    return groups


def _refine_together(found: Sequence[Poses], step: RefineStep, view: View) -> list[Poses]:
    start = torch.cat([poses.translations for poses in found])
    radius = torch.cat([torch.full((len(p.ious), 1), p.shape.radius) for p in found])
    six = matrix_to_rotation_6d(torch.cat([poses.rotations for poses in found])).requires_grad_()
    move = torch.zeros_like(start).requires_grad_()
    optimiser = torch.optim.Adam([six, move], lr=step.learning_rate)
    for iteration in range(step.iterations):
        if step.decay:
            share = 1 - iteration / step.iterations
            optimiser.param_groups[0]["lr"] = step.learning_rate * share
        optimiser.zero_grad(set_to_none=True)
        rotations, translations = rotation_6d_to_matrix(six), _moved(start, move, radius)
        losses, _ = _losses(found, rotations, translations, step, view)
        losses.sum().backward()
        optimiser.step()
    with torch.no_grad():
        rotations, translations = rotation_6d_to_matrix(six), _moved(start, move, radius)
        losses, ious = _losses(found, rotations, translations, step, view)
    counts = [len(poses.ious) for poses in found]
    parts = zip(*(x.split(counts) for x in (rotations, translations, ious, losses)), strict=True)
    return [_sorted(poses.shape, *part) for poses, part in zip(found, parts, strict=True)]


def narrow(found: Sequence[Poses], step: RefineStep, prune_by: int, view: View) -> list[Poses]:
    """One round: the exemplars and poses that the step admits, refined, best exemplar first."""
    admitted = [
        poses.best(step.poses, step.distinct_deg)
        for poses in rank(found, prune_by)[: step.exemplars]
    ]
    return rank(refine(admitted, step, view), 1)


def rank(found: Sequence[Poses], count: int) -> list[Poses]:
    """Exemplars by the mean IoU of their `count` best poses, ties by name."""
    return sorted(found, key=lambda poses: (-poses.merit(count), poses.shape.name))


def _moved(start: Tensor, move: Tensor, radius: Tensor) -> Tensor:
    ray = (start[:, :2] + radius * move[:, :2]) / start[:, 2:]
    depth = start[:, 2:] * torch.exp(move[:, 2:])
    return torch.cat((ray * depth, depth), dim=1)


def _losses(
    found: Sequence[Poses], rotations: Tensor, translations: Tensor, step: RefineStep, view: View
) -> tuple[Tensor, Tensor]:
    counts = [len(poses.ious) for poses in found]
    results = [
        _loss(poses.shape, r, t, step, view)
        for poses, r, t in zip(
            found, rotations.split(counts), translations.split(counts), strict=True
        )
    ]
    return torch.cat([loss for loss, _ in results]), torch.cat([iou for _, iou in results])


def _loss(
    shape: Shape, rotations: Tensor, translations: Tensor, step: RefineStep, view: View
) -> tuple[Tensor, Tensor]:
    loss, iou = pose_silhouette_loss(
        shape.vertices, rotations, translations, view.intrinsics, shape.topology, view.target, 1.0,
        step.edge_weight,
    )  # fmt: skip
    if step.off_screen_weight > 0:
        placed = shape.vertices @ rotations.transpose(1, 2) + translations[:, None]
        outside = off_screen(placed, view.intrinsics, *view.target.shape)
        loss = loss + step.off_screen_weight * outside
    return loss, iou


def _sorted(
    shape: Shape, rotations: Tensor, translations: Tensor, ious: Tensor, losses: Tensor
) -> Poses:
    order = torch.argsort(ious, descending=True, stable=True)
    return Poses(shape, rotations[order], translations[order], ious[order], losses[order])
