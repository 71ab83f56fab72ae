"""The registry of loss terms: each binds one function of `losses` to the frame and the variables.

A method is the dictionary `terms` of its configuration, name -> weight; `total` is the whole
objective. Every term is a function (problem, placement) -> (K,).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property

import torch
from torch import Tensor

from hoi.geometry import project, rotation_6d_to_matrix
from hoi.joint import losses
from hoi.joint.config import TermName
from hoi.joint.correspondence import cheapest_alternatives, nearest
from hoi.joint.phosa import PhosaPart, order_violations
from hoi.joint.problem import Problem
from hoi.rendering import silhouette_loss

NUM_VARIABLES = 11


class Placement:
    """The variables of K hypotheses, and what the terms derive from them (each computed once).

    Args:
        variables: (K, 11) rotation (6D), translation (m), log scale, log human scale. The object
            stands at ``scale * (X R^T + t)``, the body at ``human_scale * V``.
    """

    def __init__(self, problem: Problem, variables: Tensor):
        self.problem = problem
        self.rotations = rotation_6d_to_matrix(variables[:, :6])
        self.translations = variables[:, 6:9]
        self.scale = variables[:, 9].exp()
        human = variables[:, 10]
        self.human_scale = human.exp() if problem.human_scale_free else torch.ones_like(human)

    def unscaled(self, points: Tensor) -> Tensor:
        """(K, N, 3) library points in the camera frame before scaling about its centre."""
        return points @ self.rotations.transpose(1, 2) + self.translations[:, None]

    def placed(self, points: Tensor) -> Tensor:
        return self.scale[:, None, None] * self.unscaled(points)

    @cached_property
    def unscaled_vertices(self) -> Tensor:
        return self.unscaled(self.problem.object.vertices)

    @cached_property
    def vertices(self) -> Tensor:
        return self.scale[:, None, None] * self.unscaled_vertices

    @cached_property
    def part_points(self) -> Tensor:
        return self.placed(self.problem.object.part_points)

    @cached_property
    def part_normals(self) -> Tensor:
        return self.problem.object.part_normals @ self.rotations.transpose(1, 2)

    @cached_property
    def silhouette(self) -> tuple[Tensor, Tensor]:
        """Pixel errors (K,) at the weights' resolution, and IoU (K,). Does not see the scale."""
        problem = self.problem
        pixels = project(self.unscaled_vertices, problem.intrinsics)
        order, errors, ious = [], [], []
        for topology, members, count in problem.object.groups:
            error, iou = silhouette_loss(
                pixels[members, :count], topology, problem.target, 1.0, problem.edge_weight
            )
            order.append(members)
            errors.append(error)
            ious.append(iou)
        back = torch.cat(order).argsort()
        return torch.cat(errors)[back] * problem.pixel_weight, torch.cat(ious)[back]

    @cached_property
    def matches(self) -> Matches:
        return _matches(self.problem, self)


class Matches:
    """Corresponding points (K, R, 3), their normals, and weights (K, R); see `losses.contact`."""

    def __init__(self, object_points, object_normals, body_points, body_normals, weights):
        self.object_points, self.object_normals = object_points, object_normals
        self.body_points, self.body_normals = body_points, body_normals
        self.weights = weights


def _matches(problem: Problem, placement: Placement) -> Matches:
    """Correspondences of all contact pairs, with the indicator and the choice of alternatives."""
    table, body = problem.contacts, problem.body
    points, normals = placement.part_points, placement.part_normals
    restrict = problem.only_opposing and problem.opposing_first
    found_object, found_body = nearest(
        table, points, normals, problem.object.part_present, body.points, body.normals,
        placement.human_scale, restrict,
    )  # fmt: skip
    hypotheses = torch.arange(len(points))[:, None]
    there = found_body >= 0
    found_object, found_body = found_object.clamp(min=0), found_body.clamp(min=0)
    object_points, object_normals = (
        points[hypotheses, found_object],
        normals[hypotheses, found_object],
    )
    body_points = placement.human_scale[:, None, None] * body.points[found_body]
    body_normals = body.normals[found_body].expand_as(object_normals)
    with torch.no_grad():
        if problem.only_opposing:
            there = there & losses.opposing(object_normals, body_normals)
        weights = there * torch.from_numpy(table.row_weights).to(points)
        if (table.alternatives >= 0).any():
            squared = weights * (object_points - body_points).square().sum(-1)
            rows = torch.from_numpy(table.row_pair)
            costs = torch.zeros(len(points), table.num_pairs).to(points)
            costs.index_add_(1, rows, squared)
            weights = weights * cheapest_alternatives(costs, table.alternatives)[:, rows]
    return Matches(object_points, object_normals, body_points, body_normals, weights)


# ------------------------------------------------------------------------------ the terms


def _zero(placement: Placement) -> Tensor:
    return torch.zeros_like(placement.scale)


def contact(problem: Problem, placement: Placement) -> Tensor:
    if not problem.contacts.num_rows:
        return _zero(placement)
    matches = placement.matches
    return losses.contact(matches.object_points, matches.body_points, matches.weights)


def normal(problem: Problem, placement: Placement) -> Tensor:
    if not problem.contacts.num_rows:
        return _zero(placement)
    matches = placement.matches
    return losses.normal(matches.object_normals, matches.body_normals, matches.weights)


def penetration(problem: Problem, placement: Placement) -> Tensor:
    points = placement.placed(problem.object.surface_points)
    assert problem.body.field is not None
    mean = losses.penetration(points, problem.body.field, placement.human_scale)
    return mean * problem.penetration_points


def object_scale(problem: Problem, placement: Placement) -> Tensor:
    if problem.size_range is not None:
        return losses.object_size_range(placement.scale, problem.object.sizes, *problem.size_range)
    return losses.object_scale(placement.scale, problem.object.extent, problem.size)


def human_scale(problem: Problem, placement: Placement) -> Tensor:
    return losses.human_scale(placement.human_scale)


def reprojection(problem: Problem, placement: Placement) -> Tensor:
    return placement.silhouette[0]


def ground(problem: Problem, placement: Placement) -> Tensor:
    return losses.ground(
        placement.vertices, problem.body.soles, placement.human_scale, problem.up,
        problem.stands_on_floor, problem.feet_on_floor,
    )  # fmt: skip


def phosa_silhouette(problem: Problem, placement: Placement) -> Tensor:
    kept = float(problem.target.keep.sum()) * problem.pixel_weight
    return losses.phosa_silhouette(placement.silhouette[0], max(kept, 1.0))


def phosa_coarse(problem: Problem, placement: Placement) -> Tensor:
    assert problem.phosa is not None
    points = placement.placed(problem.object.surface_points)
    every = torch.ones(points.shape[:2], dtype=torch.bool)
    return _centroids(problem, placement, problem.phosa.whole, points, every)


def phosa_parts(problem: Problem, placement: Placement) -> Tensor:
    assert problem.phosa is not None
    total = _zero(placement)
    for part in problem.phosa.parts:
        rows = problem.object.part_slices.get(part.object_part)
        if rows is not None:
            points = placement.part_points[:, rows]
            present = problem.object.part_present[:, rows]
            total = total + _centroids(problem, placement, part, points, present)
    return total


def _centroids(
    problem: Problem, placement: Placement, part: PhosaPart, points: Tensor, present: Tensor
) -> Tensor:
    """Centroid distance of one pair where the gate lets it act and the exemplar has the part."""
    scene, human = problem.phosa, placement.human_scale
    assert scene is not None
    with torch.no_grad():
        pixels, depth = project(points, scene.intrinsics), points[..., 2]
        active = losses.interacting(
            torch.cat([pixels.amin(1), pixels.amax(1)], -1),
            part.box.expand(len(points), 4).to(points),
            torch.stack([depth.amin(1), depth.amax(1)], -1),
            part.depth.to(points) * human[:, None],
            scene.expansion,
            scene.depth_gap,
        )
        active = active & present.any(1)
    body_centroid = part.centroid.to(points) * human[:, None]
    return losses.centroid_distance(points.mean(1), body_centroid, active)


def phosa_object_scale(problem: Problem, placement: Placement) -> Tensor:
    return losses.phosa_object_scale(placement.scale, problem.object.extent, problem.size)


def phosa_ordinal_depth(problem: Problem, placement: Placement) -> Tensor:
    assert problem.phosa is not None
    scene = problem.phosa.ordinal
    faces = [exemplar.faces for exemplar in problem.object.exemplars]
    behind, hypothesis = order_violations(placement.vertices, faces, placement.human_scale, scene)
    pixels = losses.ordinal_depth(behind, scene.clamp)
    # two ordered pairs: object before person, person before object
    return _zero(placement).index_add(0, hypothesis, pixels) * scene.pixel_weight / 2


TERMS: dict[TermName, Callable[[Problem, Placement], Tensor]] = {
    "contact": contact,
    "normal": normal,
    "penetration": penetration,
    "object_scale": object_scale,
    "human_scale": human_scale,
    "reprojection": reprojection,
    "ground": ground,
    "phosa_silhouette": phosa_silhouette,
    "phosa_coarse": phosa_coarse,
    "phosa_parts": phosa_parts,
    "phosa_object_scale": phosa_object_scale,
    "phosa_human_scale": human_scale,
    "phosa_ordinal_depth": phosa_ordinal_depth,
}

#: Terms that the scale cannot change: the depth grid need not compute them.
SCALE_BLIND = frozenset({"reprojection", "phosa_silhouette"})


def weighted_terms(problem: Problem, terms: Mapping[TermName, float], variables: Tensor) -> Tensor:
    """(T, K) every term times its weight, in the order of `terms`. Their sum is the objective."""
    placement = Placement(problem, variables)
    return torch.stack([weight * TERMS[name](problem, placement) for name, weight in terms.items()])
