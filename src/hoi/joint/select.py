"""Who hides whom: at which depth a hypothesis starts and which one is kept in the end.

Sees the image and the priors, never the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from hoi.joint.inputs import Inputs
from hoi.rendering import crop_mask, depth_map, intrinsics_for

_NEGLIGIBLE = 1e-3  # hypotheses this much less likely than the best have no say


def occlusion_order_violation(
    object_vertices: list[np.ndarray],
    object_faces: list[np.ndarray],
    body_vertices: list[np.ndarray],
    body_faces: np.ndarray,
    inputs: Inputs,
    resolution: int,
    tolerance: float,
) -> np.ndarray:
    """Share of each hypothesis' object pixels where the model contradicts who hides whom.

    A pixel contradicts when the mask shows the object but the model's body is nearer by more than
    `tolerance` metres, or shows the person but the model's object is.

    Args:
        object_vertices, object_faces, body_vertices: one array per hypothesis, camera frame.
        inputs: camera, masks and region of the frame; resolution: pixels of the region's side.

    Returns:
        (K,) in 0..1; 1 for an object that cannot be seen in the region.
    """
    return order_violation_by_depth(
        object_vertices, object_faces, body_vertices, body_faces, inputs, resolution, tolerance,
        np.ones(1),
    )[0]  # fmt: skip


def order_violation_by_depth(
    object_vertices: list[np.ndarray],
    object_faces: list[np.ndarray],
    body_vertices: list[np.ndarray],
    body_faces: np.ndarray,
    inputs: Inputs,
    resolution: int,
    tolerance: float,
    factors: np.ndarray,
) -> np.ndarray:
    """The same, (S, K), for objects scaled about the camera centre by each of `factors` (S,).

    Such a scaling moves no pixel and multiplies all depths, so one depth map serves all.
    """
    crop = intrinsics_for(inputs.roi, inputs.intrinsics, resolution)
    thing = crop_mask(inputs.object_mask, inputs.roi, resolution) > 0.5
    person = crop_mask(inputs.person_mask, inputs.roi, resolution) > 0.5
    violations = []
    for vertices, faces, body in zip(object_vertices, object_faces, body_vertices, strict=True):
        of_object = depth_map(vertices, faces, crop, resolution, resolution)
        of_body = depth_map(body, body_faces, crop, resolution, resolution)
        visible = np.isfinite(of_object)
        both = visible & np.isfinite(of_body)
        gaps = factors[:, None] * of_object[both] - of_body[both]  # > 0: object behind
        hidden, hiding = (thing & ~person)[both], person[both]
        wrong = (hidden & (gaps > tolerance)) | (hiding & (gaps < -tolerance))
        seen = max(int(visible.sum()), 1)
        violations.append(wrong.sum(1) / seen if visible.any() else np.ones(len(factors)))
    return np.stack(violations, 1)


def surprisal(probability: float) -> float:
    """-log p: what it costs to believe in an action that the pose makes unlikely."""
    return -math.log(min(max(probability, 1e-6), 1.0))


def rule_text(
    order_weight: float,
    action_weight: float = 0.0,
    consensus: float = 0.0,
    arrangement_weight: float = 0.0,
    untouched_cost: float = 0.0,
) -> str:
    """The selection rule in one line, for the artifact and the report."""
    rule = "total loss"
    if order_weight:
        rule += f" + {order_weight:g} x occlusion-order violation"
    if action_weight:
        rule += f" - {action_weight:g} x log p(action)"
    if arrangement_weight:
        rule += f" + {arrangement_weight:g} x misplacement"
    if untouched_cost:
        rule += f" + {untouched_cost:g} where nothing touches"
    if consensus:
        likely = f"exp(-score / {consensus:g}), score = {rule}"
        return f"least expected distance to the others, weighted by {likely}"
    return f"lowest {rule}"


def scores(
    total: np.ndarray,
    violation: np.ndarray,
    order_weight: float,
    surprise: np.ndarray | float = 0.0,
    action_weight: float = 0.0,
) -> np.ndarray:
    """(K,) ``total + order_weight * violation + action_weight * surprise``.

    Infinite where the total is not finite; ValueError when it is finite nowhere.
    """
    penalty = order_weight * violation + action_weight * np.broadcast_to(surprise, total.shape)
    score = np.where(np.isfinite(total), total + penalty, np.inf)
    if not np.isfinite(score).any():
        raise ValueError("no hypothesis has a finite loss")
    return score


def choose(score: np.ndarray, points: Sequence[np.ndarray], consensus: float) -> int:
    """Index of the chosen hypothesis; ties go to the better rank.

    With `consensus` 0 the lowest score wins. Else the scores are read as ``-consensus log p``, and
    the hypothesis with the least expected distance to what may be true instead is taken (minimum
    Bayes risk): of many that explain the picture about equally well, one in their middle.

    Args:
        score: (K,), lower is better. points: (N, 3) on each placed object, metres.
    """
    if consensus <= 0:
        return int(score.argmin())
    share = np.exp(-(score - score.min()) / consensus)
    (likely,) = np.nonzero(share >= _NEGLIGIBLE * share.max())
    distances = mean_distances([points[int(k)] for k in likely])
    return int(likely[(distances @ share[likely]).argmin()])


def mean_distances(points: Sequence[np.ndarray]) -> np.ndarray:
    """(K, K) sums of both mean distances from one point set (N, 3) to the nearest of another.

    Every second point is asked: half the time, and the points are a random sample anyway.
    """
    trees = [KDTree(own) for own in points]
    one_way = np.array([[tree.query(own[::2])[0].mean() for tree in trees] for own in points])
    return one_way + one_way.T
