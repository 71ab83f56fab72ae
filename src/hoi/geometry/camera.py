"""The pinhole camera. OpenCV axes: x right, y down, z forward; pixel (c, r) covers [c, c+1)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hoi.settings import CameraModel

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


def model_intrinsics(
    intrinsics: np.ndarray, height: int, width: int, model: CameraModel
) -> np.ndarray:
    """(3, 3) intrinsics of the believed camera, pixels.

    ``photo``: `intrinsics` as they are. ``longest_side``: PHOSA's, whatever the photo was taken
    with: the focal length is the longest side and the principal point the middle of the square
    that the photo fills from its top left corner.
    """
    if model == "photo":
        return np.asarray(intrinsics, np.float64)
    side = float(max(height, width))
    return np.array([[side, 0, side / 2], [0, side, side / 2], [0, 0, 1]])


def shift_between_cameras(
    points: np.ndarray, seen_by: np.ndarray, shown_to: np.ndarray
) -> np.ndarray:
    """(3,) metres by which `points` must move to look to one camera as they looked to another.

    Least squares over ``(u - cx)(z + t_z) = f (x + t_x)``, which is linear in the shift; exact only
    for a distant thing, because perspective differs.

    Args:
        points: (N, 3) metres, camera frame. seen_by, shown_to: (3, 3) intrinsics, pixels.
    """
    pixels = project(np.asarray(points, np.float64), seen_by)
    rows, values = [], []
    for axis in range(2):
        focal, centre = shown_to[axis][axis], shown_to[axis][2]
        row = np.zeros((len(points), 3))
        row[:, axis], row[:, 2] = focal, -(pixels[:, axis] - centre)
        rows.append(row)
        values.append((pixels[:, axis] - centre) * points[:, 2] - focal * points[:, axis])
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]


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
    return np.stack((x, y), axis=-1)
