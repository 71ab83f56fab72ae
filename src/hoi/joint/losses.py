"""The loss terms of Section 3.4 and of PHOSA, one pure function each.

All are batched over K hypotheses and return (K,). Points are in the camera frame in metres.

Parameterisation, shared by all methods: the object stands at ``s (X R^T + t)``, the body at
``s_h V``; both are scaled about the camera centre. Such a scaling moves no projected point, so the
silhouette decides R and t alone, and size together with depth is left to contact, the ground and
the size prior.
"""

from __future__ import annotations

import torch
from torch import Tensor

from hoi.joint.signed_distance import SignedDistanceGrid

# ------------------------------------------------------------------------------ the paper's


def opposing(object_normals: Tensor, body_normals: Tensor) -> Tensor:
    """The indicator 1(n_h, n_o): surfaces can touch when their normals oppose. (..., 3) -> bool."""
    return (object_normals * body_normals).sum(-1) < 0


def contact(object_points: Tensor, body_points: Tensor, weights: Tensor) -> Tensor:
    """L_contact [3.4]: weighted sum of squared distances of corresponding points.

    Args:
        object_points, body_points: (K, R, 3) the two ends of every correspondence.
        weights: (K, R) 1/n of the point's part pair, 0 where the indicator says no contact; so each
            part pair adds its mean.
    """
    return (weights * (object_points - body_points).square().sum(-1)).sum(-1)


def normal(object_normals: Tensor, body_normals: Tensor, weights: Tensor) -> Tensor:
    """L_normal [3.4]: weighted sum of 1 + cosine of the normals; 0 when they oppose exactly.

    Unit normals (K, R, 3), weights (K, R) as for `contact`.
    """
    return (weights * (1 + (object_normals * body_normals).sum(-1))).sum(-1)


def penetration(points: Tensor, field: SignedDistanceGrid, human_scale: Tensor) -> Tensor:
    """L_penetration [3.4]: mean over object points (K, M, 3) of |f| where f < 0, metres.

    `field` belongs to the body at scale 1; the scaled body's field is ``s_h f(x / s_h)``.
    """
    scale = human_scale[:, None]
    depth = torch.relu(-field(points / scale[..., None]))
    return (scale * depth).mean(-1)


def object_scale(scale: Tensor, extent: Tensor, size: float) -> Tensor:
    """L_scale of the object [3.4]: squared difference to the size prior, m^2.

    Args:
        scale: (K,) factor of the exemplar. extent: (K,) its measured extent at scale 1, metres.
        size: the prior's size of that extent, metres.
    """
    return (scale * extent - size).square()


def object_size_range(scale: Tensor, sizes: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Squared metres by which width, height and depth leave their ranges, summed. Not in the paper.

    Args:
        scale: (K,) factor of the exemplar. sizes: (K, 3) its extents at scale 1, metres.
        low, high: (3,) metres; 0 and infinity where nobody said one.
    """
    placed = scale[:, None] * sizes
    return ((low - placed).clamp(min=0).square() + (placed - high).clamp(min=0).square()).sum(-1)


def human_scale(scale: Tensor) -> Tensor:
    """L_scale of the person [3.4]: squared difference to the fitted body's own size (1)."""
    return (scale - 1).square()


def ground(
    object_points: Tensor,
    soles: Tensor,
    human_scale: Tensor,
    up: Tensor,
    object_stands: bool = True,
    feet_stand: bool = True,
) -> Tensor:
    """One floor under object and person: squared height by which their lowest points disobey it.

    Whichever stands shows where the floor is, and the other is on it when it stands, too, or else
    not below it. Not in the paper. `up` is the image's up, which is the room's within a camera's
    roll and pitch.

    Args:
        object_points: (K, V, 3). soles: (S, 3) of the body at scale 1. up: (3,) unit vector.
        object_stands, feet_stand: who is known to stand on the floor.
    """
    gap = (object_points @ up).min(-1).values - human_scale * (soles @ up).min()  # object above
    if not feet_stand:
        gap = gap.clamp(min=0)
    if not object_stands:
        gap = gap.clamp(max=0)
    return gap.square()


# ------------------------------------------------------------------------------ PHOSA's


def phosa_silhouette(pixel_errors: Tensor, kept_pixels: float) -> Tensor:
    """Silhouette error over the number of kept pixels: sum keep (S - M)^2 / sum keep."""
    return pixel_errors / kept_pixels


def centroid_distance(object_centroid: Tensor, body_centroid: Tensor, active: Tensor) -> Tensor:
    """Mean squared difference of two centroids over the three axes, where `active` (K,) is true.

    PHOSA's coarse interaction (whole object, whole person) and its part interaction.
    Centroids (K, 3).
    """
    return active * (object_centroid - body_centroid).square().mean(-1)


def interacting(
    object_box: Tensor,
    body_box: Tensor,
    object_depth: Tensor,
    body_depth: Tensor,
    expansion: float,
    depth_gap: float,
) -> Tensor:
    """PHOSA's gate: grown 2D boxes overlap and depth ranges come nearer than `depth_gap`.

    Args:
        object_box, body_box: (K, 4) x0, y0, x1, y1 pixels.
        object_depth, body_depth: (K, 2) nearest and farthest depth, metres.
        expansion: each box grows by this share of its width and height in all.
    """
    first, second = _grown(object_box, expansion), _grown(body_box, expansion)
    overlap = torch.minimum(first[:, 2:], second[:, 2:]) > torch.maximum(
        first[:, :2], second[:, :2]
    )
    gap = torch.maximum(
        object_depth[:, 0] - body_depth[:, 1], body_depth[:, 0] - object_depth[:, 1]
    )
    return overlap.all(-1) & (gap < depth_gap)


def _grown(box: Tensor, expansion: float) -> Tensor:
    growth = (box[:, 2:] - box[:, :2]) * expansion / 2
    return torch.cat([box[:, :2] - growth, box[:, 2:] + growth], -1)


def phosa_object_scale(scale: Tensor, extent: Tensor, size: float) -> Tensor:
    """PHOSA's (s - s_prior)^2; its scale 1 is an object of 2 m, so s is half the size in metres."""
    return ((scale * extent - size) / 2).square()


def ordinal_depth(behind_by: Tensor, clamp: float) -> Tensor:
    """Ordinal depth of single pixels: log(1 + exp(d)), d the metres by which the order is wrong.

    Jiang et al. (CVPR 2020), as PHOSA uses it: the masks say which surface is in front; `behind_by`
    (N,) is how far the model puts it behind, clamped to 0..`clamp`.
    """
    return torch.nn.functional.softplus(behind_by.clamp(0, clamp))
