"""Compile the stage's kernels once, so that no timed or parallel job pays for it."""

from __future__ import annotations

import numpy as np
import torch

from hoi.joint.contacts import ContactPair
from hoi.joint.correspondence import nearest, pair_table
from hoi.joint.phosa import OrdinalScene, order_violations


def warm_up() -> None:
    """Run each kernel on a few points, with the types that the stage uses."""
    points = torch.tensor([[0.0, 0, 2], [1, 0, 2], [0, 1, 2]])
    normals = torch.tensor([[0.0, 0, 1]]).repeat(3, 1)
    slices = {"part": np.arange(3)}
    pairs = [ContactPair(("part",), ("part",), to_body) for to_body in (True, False)]
    table = pair_table(pairs, slices, slices)
    one, present = torch.ones(1), torch.ones(1, 3, dtype=torch.bool)
    nearest(table, points[None], normals[None], present, points, -normals, one, True)
    scene = OrdinalScene(
        intrinsics=np.array([[4.0, 0, 2], [0, 4.0, 2], [0, 0, 1]]),
        body_depth=torch.ones(4, 4),
        object_front=torch.ones(4, 4, dtype=torch.bool),
        body_front=torch.zeros(4, 4, dtype=torch.bool),
        pixel_weight=1.0,
        clamp=2.0,
    )
    order_violations(points[None], [np.array([[0, 1, 2]])], one, scene)
