"""The camera: BEHAVE's Kinect 1 on a tripod."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoi.datasets.behave import KINECT1
from hoi.datasets.behave_mini.config import BehaveMiniConfig


@dataclass(frozen=True, eq=False)
class Camera:
    """`rotation` (3, 3) and `position` (3,) take world points to the camera: (p - position) R^T."""

    rotation: np.ndarray
    position: np.ndarray
    intrinsics: np.ndarray
    width: int
    height: int

    def to_camera(self, points: np.ndarray) -> np.ndarray:
        """World points (..., 3) in OpenCV camera axes."""
        return (points - self.position) @ self.rotation.T

    def project(self, points: np.ndarray) -> np.ndarray:
        """World points (..., 3) to pixels (..., 2)."""
        seen = self.to_camera(points) @ self.intrinsics.T
        return seen[..., :2] / seen[..., 2:]

    def rays(self, step: int = 1, first_row: int = 0, rows: int | None = None) -> np.ndarray:
        """(rows, W, 6) float32 world rays through the centres of every `step`-th pixel block.

        Their directions have unit depth, so hit distances are depths along the optical axis.
        """
        rows = self.height // step if rows is None else rows
        u = (np.arange(self.width // step) + 0.5) * step
        v = (np.arange(first_row, first_row + rows) + 0.5) * step
        k = self.intrinsics
        direction = np.empty((rows, len(u), 3))
        direction[..., 0] = ((u - k[0, 2]) / k[0, 0])[None]
        direction[..., 1] = ((v - k[1, 2]) / k[1, 1])[:, None]
        direction[..., 2] = 1.0
        rays = np.empty((rows, len(u), 6), np.float32)
        rays[..., :3] = self.position
        rays[..., 3:] = direction @ self.rotation
        return rays


def kinect_intrinsics(width: int) -> np.ndarray:
    """K of BEHAVE's Kinect 1, scaled to an image of this width."""
    fx, fy, cx, cy, full_width, _ = KINECT1
    s = width / full_width
    return np.array([[fx * s, 0, cx * s], [0, fy * s, cy * s], [0, 0, 1.0]])


def place_camera(
    rng: np.random.Generator, vertices: np.ndarray, config: BehaveMiniConfig
) -> Camera | None:
    """A camera somewhere around these points; None when they do not all fit into its picture."""
    c = config.camera
    bearing = rng.uniform(0, 2 * np.pi)
    distance, height = rng.uniform(*c.distance_m), rng.uniform(*c.height_m)
    pitch, roll = np.deg2rad(rng.uniform(*c.pitch_deg)), np.deg2rad(rng.normal(0, c.roll_sd_deg))
    pan = rng.uniform(-c.pan_m, c.pan_m)
    middle = (vertices.min(0) + vertices.max(0)) / 2
    level = np.array([-np.sin(bearing), 0.0, -np.cos(bearing)])
    forward = np.cos(pitch) * level - np.sin(pitch) * np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cosine, sine = np.cos(roll), np.sin(roll)
    right, down = cosine * right + sine * down, cosine * down - sine * right
    rotation = np.stack([right, down, forward])
    position = np.array([middle[0], 0.0, middle[2]]) - level * distance
    position[1] = height
    position = position + rotation[0] * pan * np.array([1.0, 0.0, 1.0])
    width = config.image_width
    camera = Camera(rotation, position, kinect_intrinsics(width), width, config.image_height)
    if camera.to_camera(vertices)[:, 2].min() < 0.5:
        return None
    pixels, edge = camera.project(vertices), width / 200
    inside = (pixels > edge).all() and (pixels < [width - edge, config.image_height - edge]).all()
    return camera if inside else None
