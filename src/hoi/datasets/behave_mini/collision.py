"""Ray casting against triangle meshes (open3d, loaded on first use, one thread)."""

from __future__ import annotations

from typing import Any

import numpy as np


class Solid:
    """A closed mesh that knows how deep points lie in it."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        import open3d

        o3d: Any = open3d  # its stubs know no tensors made of arrays
        self._core = o3d.core
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
            o3d.core.Tensor(np.ascontiguousarray(faces, np.uint32)),
        )

    def depth(self, points: np.ndarray) -> np.ndarray:
        """(N,) metres below the surface, negative outside."""
        query = self._core.Tensor(np.ascontiguousarray(points, np.float32))
        return -self._scene.compute_signed_distance(query, nthreads=1, nsamples=3).numpy()
