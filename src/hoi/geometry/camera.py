"""The pinhole camera. OpenCV axes: x right, y down, z forward; pixel (c, r) covers [c, c+1)."""

from __future__ import annotations

from typing import Any

NEAR = 1e-2  # metres; points nearer than this (or behind the camera) project as if they were here


def project(points, intrinsics):
    """Project camera-frame points to image coordinates.

    Args:
        points: (..., 3) metres, torch tensor or numpy array.
        intrinsics: (3, 3) ``K`` in pixels, same library or anything indexable.

    Returns:
        (..., 2) pixels. Depth is clamped to NEAR, so the result is always finite.
    """
    depth = _clamp_below(points[..., 2], NEAR)
    x = points[..., 0] / depth * float(intrinsics[0][0]) + float(intrinsics[0][2])
    y = points[..., 1] / depth * float(intrinsics[1][1]) + float(intrinsics[1][2])
    return _stack(x, y)


def scale_about_camera(rotation, translation, scale: float, new_scale: float):
    """Resize a placed object so that its silhouette stays the same.

    Scaling ``X @ R.T + t`` about the camera centre multiplies size and translation alike; no
    projected point moves (PHOSA's parameterisation; a silhouette cannot tell size from depth).

    Returns:
        rotation, translation of the object at `new_scale`, when it stood at `scale`.
    """
    return rotation, translation * (new_scale / scale)


def _clamp_below(value: Any, minimum: float) -> Any:
    return value.clamp(min=minimum) if hasattr(value, "clamp") else value.clip(min=minimum)


def _stack(x: Any, y: Any) -> Any:
    if hasattr(x, "clamp"):
        import torch

        return torch.stack((x, y), dim=-1)
    import numpy as np

    return np.stack((x, y), axis=-1)
