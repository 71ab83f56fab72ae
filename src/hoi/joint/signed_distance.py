"""The signed distance field of a body, sampled on a grid once per frame [3.4]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample


@dataclass(frozen=True)
class SignedDistanceGrid:
    """f on a regular grid over an axis-aligned box: metres, negative inside the body.

    Args:
        values: (X, Y, Z) at the grid's nodes. lower, upper: (3,) corners of the box, metres.
    """

    values: Tensor
    lower: Tensor
    upper: Tensor

    def __call__(self, points: Tensor) -> Tensor:
        """Trilinear f at points (..., 3); outside the box the value at its nearest border point."""
        unit = 2 * (points - self.lower) / (self.upper - self.lower) - 1
        # grid_sample wants the fastest axis first
        where = unit.flip(-1).reshape(1, 1, 1, -1, 3)
        values = self.values[None, None].to(points)
        found = grid_sample(values, where, padding_mode="border", align_corners=True)
        return found.reshape(points.shape[:-1])


def body_signed_distance(
    vertices: np.ndarray, faces: np.ndarray, cells: int, margin: float
) -> SignedDistanceGrid:
    """Signed distance of a closed mesh on `cells`^3 nodes over its bounding box plus `margin`.

    Args:
        vertices: (V, 3) metres. faces: (F, 3).
    """
    import open3d

    lower, upper = vertices.min(0) - margin, vertices.max(0) + margin
    axes = [np.linspace(lower[i], upper[i], cells) for i in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).astype(np.float32)
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        open3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
        open3d.core.Tensor(np.ascontiguousarray(faces, np.uint32)),
    )
    values = scene.compute_signed_distance(open3d.core.Tensor(nodes), nthreads=1).numpy()
    return SignedDistanceGrid(
        torch.from_numpy(values.reshape(cells, cells, cells).copy()),
        torch.from_numpy(lower.astype(np.float32)),
        torch.from_numpy(upper.astype(np.float32)),
    )
