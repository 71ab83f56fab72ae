"""The camera: BEHAVE's Kinect 1 on a tripod."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoi.datasets.behave_calibration import KINECTS
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

    def rays(self, first_row: int = 0, rows: int | None = None) -> np.ndarray:
        """(rows, W, 6) float32 world rays through the pixel centres of some rows.

        Their directions have unit depth, so hit distances are depths along the optical axis.
        """
        directions = self.directions(first_row, rows)
        rays = np.empty((*directions.shape[:2], 6), np.float32)
        rays[..., :3] = self.position
        rays[..., 3:] = directions
        return rays

    def directions(self, first_row: int = 0, rows: int | None = None) -> np.ndarray:
        """(rows, W, 3) float32 world directions of unit depth through the pixel centres."""
        rows = self.height if rows is None else rows
        k = self.intrinsics
        u = (np.arange(self.width) + 0.5 - k[0, 2]) / k[0, 0]
        v = (np.arange(first_row, first_row + rows) + 0.5 - k[1, 2]) / k[1, 1]
        across = (u[:, None] * self.rotation[0]).astype(np.float32)
        down = (v[:, None] * self.rotation[1] + self.rotation[2]).astype(np.float32)
        return across[None] + down[:, None]


def kinect_intrinsics(width: int) -> np.ndarray:
    """K of BEHAVE's Kinect 1, scaled to an image of this width."""
    fx, fy, cx, cy, full_width, _ = KINECTS[1]
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
