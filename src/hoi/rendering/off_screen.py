"""How far a placed mesh leaves the picture."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from hoi.geometry import project


def off_screen(
    points: Tensor, intrinsics: np.ndarray, height: int, width: int, far: float = 200.0
) -> Tensor:
    """Sum over vertices of how far each lies outside the picture; PHOSA's off-screen term.

    A silhouette that has left the picture has no gradient; this brings it back.

    Args:
        points: (B, V, 3) metres, camera frame.
        intrinsics: (3, 3) K of a grid of height x width pixels.
        far: metres; depths beyond it count as outside too.

    Returns:
        (B,) per vertex the distance beyond the border in half sides of the picture, plus metres
        behind the camera, plus metres beyond `far`; zero exactly when all are inside.
    """
    half = points.new_tensor([width / 2, height / 2])
    beyond = ((project(points, intrinsics) - half).abs() / half - 1).clamp(min=0)
    depth = points[..., 2]
    return beyond.sum((-1, -2)) + ((-depth).clamp(min=0) + (depth - far).clamp(min=0)).sum(-1)
