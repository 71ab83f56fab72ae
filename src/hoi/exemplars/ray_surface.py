"""Distances and ray hits on a triangle mesh (open3d's ray casting scene behind plain arrays)."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np


class RaySurface:
    """A triangle soup that answers geometric queries; single-threaded, so always the same.

    Args:
        vertices: (V, 3).
        faces: (F, 3).
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        # Imported here because open3d takes seconds to load and needs libusb.
        self._open3d: Any = importlib.import_module("open3d")
        self._scene = self._open3d.t.geometry.RaycastingScene(nthreads=1)
        corners = np.ascontiguousarray(faces, np.uint32)
        self._scene.add_triangles(self._tensor(vertices), self._open3d.core.Tensor(corners))

    def distances(self, points: np.ndarray) -> np.ndarray:
        """(...,) unsigned distances of (..., 3) points."""
        return self._scene.compute_distance(self._tensor(points), nthreads=1).numpy()

    def signed_distances(self, points: np.ndarray) -> np.ndarray:
        """(...,) distances, negative inside: the majority of three rays' crossing parities."""
        query = self._tensor(points)
        return self._scene.compute_signed_distance(query, nthreads=1, nsamples=3).numpy()

    def closest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The nearest surface points (N, 3) float64 and the faces (N,) they lie on."""
        hits = self._scene.compute_closest_points(self._tensor(points), nthreads=1)
        found, face = hits["points"].numpy(), hits["primitive_ids"].numpy()
        return found.astype(np.float64), face.astype(np.int64)

    def cast(self, rays: np.ndarray) -> dict[str, np.ndarray]:
        """First hits of (..., 6) rays (origin, direction).

        Returns ``t_hit`` (inf: none), ``primitive_ids``, ``primitive_uvs``, ``primitive_normals``.
        """
        hits = self._scene.cast_rays(self._tensor(rays), nthreads=1)
        return {name: tensor.numpy() for name, tensor in hits.items()}

    def _tensor(self, array: np.ndarray) -> Any:
        return self._open3d.core.Tensor(np.ascontiguousarray(array, np.float32))
