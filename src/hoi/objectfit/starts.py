"""Where the pose search starts: rotations, and translations that fit the mask's box."""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.ndimage import binary_dilation
from torch import Tensor

from hoi.geometry import project, uniform_rotations, upright_rotations
from hoi.objectfit.config import ObjectFitConfig
from hoi.rendering import SilhouetteTarget

_ALIGNMENT_STEPS = 5  # of a fixed point that contracts about tenfold a step


def start_rotations(config: ObjectFitConfig, generator: torch.Generator) -> Tensor:
    """(num_starts, 3, 3) camera-from-object rotations of the configured distribution."""
    if config.init == "so3":
        return uniform_rotations(config.num_starts, generator)
    return upright_rotations(
        config.num_starts,
        generator,
        pitch_deg=config.pitch_deg,
        roll_deg=config.roll_deg,
        yaw_deg=config.yaw_deg,
    )


def visible_box(target: SilhouetteTarget) -> np.ndarray:
    """(4,) x0, y0, x1, y1 of the mask in pixels of the target's grid; it must not be empty."""
    threshold = min(0.5, float(target.mask.max()) / 2)
    rows, columns = np.nonzero(target.mask > threshold)
    return np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], float)


def cut_fraction(target: SilhouetteTarget) -> float:
    """Share of the mask's outline that borders on the unknown, in [0, 1]."""
    inside = target.mask > 0.5
    rim = np.asarray(binary_dilation(inside), bool) & ~inside
    return float((rim & (target.keep == 0)).sum() / max(int(rim.sum()), 1))


def start_boxes(
    config: ObjectFitConfig, target: SilhouetteTarget, generator: torch.Generator
) -> Tensor:
    """(num_starts, 4) boxes that the starts should fill, in pixels of the target's grid.

    The visible box bounds an occluded object from below, so with part of the outline cut the boxes
    grow by a random share and move by up to half of what they grew.
    """
    x0, y0, x1, y1 = visible_box(target).tolist()
    diagonal = math.hypot(x1 - x0, y1 - y0)
    cut = min(1.0, config.cut_gain * cut_fraction(target))
    uniform = torch.rand(config.num_starts, 3, generator=generator)
    growth = 1 + cut * config.occluded_growth * uniform[:, :1]
    shift = (uniform[:, 1:] - 0.5) * (growth - 1) * diagonal
    centre = torch.tensor([(x0 + x1) / 2, (y0 + y1) / 2]) + shift
    half = torch.tensor([(x1 - x0) / 2, (y1 - y0) / 2]) * growth
    return torch.cat((centre - half, centre + half), dim=1)


def support_vertices(vertices: np.ndarray, directions: int = 96) -> np.ndarray:
    """Sorted indices of the outermost vertices (V, 3) along evenly spread directions.

    Their box in any view is the mesh's to about a percent, at a tenth of the points.
    """
    i = np.arange(directions) + 0.5
    height = 1 - 2 * i / directions
    turn = i * math.pi * (1 + math.sqrt(5))
    radius = np.sqrt(1 - height**2)
    spiral = np.stack([radius * np.cos(turn), height, radius * np.sin(turn)], axis=1)
    return np.unique(np.argmax(vertices @ spiral.T, axis=0))


def align_to_boxes(
    points: Tensor, rotations: Tensor, boxes: Tensor, intrinsics: np.ndarray
) -> Tensor:
    """Translations at which rotated points fill their boxes: equal centre and diagonal.

    Args:
        points: (S, 3) metres, object frame. rotations: (B, 3, 3). boxes: (B, 4) pixels.
        intrinsics: (3, 3) of the grid the boxes live in.

    Returns:
        (B, 3) metres, camera frame; the object stands wholly before the camera.
    """
    rotated = points @ rotations.transpose(1, 2)
    focal = torch.tensor([intrinsics[0][0], intrinsics[1][1]], dtype=points.dtype)
    principal = torch.tensor([intrinsics[0][2], intrinsics[1][2]], dtype=points.dtype)
    centre = (boxes[:, :2] + boxes[:, 2:]) / 2
    diagonal = (boxes[:, 2:] - boxes[:, :2]).norm(dim=1)
    extent = (rotated.amax(1) - rotated.amin(1))[:, :2].norm(dim=1)
    nearest = 1.05 * points.norm(dim=1).max()
    depth = (focal.mean() * extent / diagonal).clamp(min=nearest)
    ray = (centre - principal) / focal
    for _ in range(_ALIGNMENT_STEPS):
        translation = torch.cat((ray * depth[:, None], depth[:, None]), dim=1)
        xy = project(rotated + translation[:, None], intrinsics)
        low, high = xy.amin(1), xy.amax(1)
        ray = ray + (centre - (low + high) / 2) / focal
        depth = (depth * ((high - low).norm(dim=1) / diagonal).clamp(0.3, 3)).clamp(min=nearest)
    return torch.cat((ray * depth[:, None], depth[:, None]), dim=1)
