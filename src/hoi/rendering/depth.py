"""Depth maps by z-buffer."""

from __future__ import annotations

import numpy as np

from hoi.geometry.camera import NEAR
from hoi.rendering import kernels


def depth_map(
    vertices: np.ndarray,
    faces: np.ndarray,
    intrinsics: np.ndarray,
    height: int,
    width: int,
    near: float = NEAR,
) -> np.ndarray:
    """Distance along z to the nearest surface at every pixel centre.

    Args:
        vertices: (V, 3) metres, camera frame (OpenCV axes).
        faces: (F, 3) vertex indices; faces crossing the plane z = near are clipped there, faces
            with a vertex that is not finite are left out.
        intrinsics: (3, 3) K in pixels of the wanted map.
        height, width: of the wanted map in pixels.
        near: nearest depth drawn, metres.

    Returns:
        (H, W) float32 metres; infinity where nothing is seen. Faces have no back side.
    """
    vertices = np.ascontiguousarray(vertices, np.float64)
    faces = np.ascontiguousarray(faces, np.int32)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"expected (V, 3) and (F, 3), got {vertices.shape} and {faces.shape}")
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise ValueError(f"faces index beyond the {len(vertices)} vertices")
    depth = np.full((height, width), np.inf, np.float32)
    intrinsics = np.ascontiguousarray(intrinsics, np.float64)
    kernels.z_buffer(vertices, faces, intrinsics, float(near), depth)
    return depth
