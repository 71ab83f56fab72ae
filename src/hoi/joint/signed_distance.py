"""The signed distance field of a body, sampled on a grid once per frame [3.4]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

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
    lower, upper = vertices.min(0) - margin, vertices.max(0) + margin
    axes = [np.linspace(lower[i], upper[i], cells) for i in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    scene, points = _ray_scene(vertices, faces), _tensor(nodes, np.float32)
    values = scene.compute_signed_distance(points, nthreads=1).numpy()
    return SignedDistanceGrid(
        torch.from_numpy(values.copy()),
        torch.from_numpy(lower.astype(np.float32)),
        torch.from_numpy(upper.astype(np.float32)),
    )


def surface_distance(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unsigned distance (N,) in metres of points (N, 3) to a mesh that need not be closed."""
    scene = _ray_scene(vertices, faces)
    return scene.compute_distance(_tensor(points, np.float32), nthreads=1).numpy()


def _ray_scene(vertices: np.ndarray, faces: np.ndarray) -> Any:
    import open3d

    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(_tensor(vertices, np.float32), _tensor(faces, np.uint32))
    return scene


def _tensor(values: np.ndarray, dtype: type) -> Any:
    import open3d

    return open3d.core.Tensor.from_numpy(np.ascontiguousarray(values, dtype))
