"""Square crops of a photo, resampled to a grid of a chosen resolution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np


@dataclass(frozen=True)
class Roi:
    """A square region of the image, in pixels; it may reach over the image's border.

    Attributes:
        x0, y0: left and top edge.
        side: length of its side, positive.
    """

    x0: float
    y0: float
    side: float

    def __post_init__(self):
        if not self.side > 0:
            raise ValueError(f"the side of a region must be positive, got {self.side}")

    @classmethod
    def around(cls, box: np.ndarray, margin: float = 0.3) -> Self:
        """Square about the centre of `box` (x0, y0, x1, y1), its longer side grown by `margin`.

        `margin` is a fraction of the longer side and is added on both sides.
        """
        x0, y0, x1, y1 = (float(value) for value in box)
        side = max(x1 - x0, y1 - y0) * (1 + 2 * margin)
        return cls((x0 + x1 - side) / 2, (y0 + y1 - side) / 2, side)

    def as_array(self) -> np.ndarray:
        """(3,) x0, y0, side: how artifacts store a region."""
        return np.array([self.x0, self.y0, self.side])


def intrinsics_for(roi: Roi, intrinsics: np.ndarray, resolution: int) -> np.ndarray:
    """K (3, 3) of the camera whose image is the region resampled to resolution x resolution."""
    scale = resolution / roi.side
    crop = np.array([[scale, 0, -roi.x0 * scale], [0, scale, -roi.y0 * scale], [0, 0, 1.0]])
    return crop @ np.asarray(intrinsics, np.float64)


def crop_mask(mask: np.ndarray, roi: Roi, resolution: int) -> np.ndarray:
    """Area average of a mask (H, W) over each cell of the region's grid, zero off the image.

    Returns:
        (resolution, resolution) float32: the covered fraction of each cell. Cropping an all-ones
        mask therefore says how much of each cell lies on the photo.
    """
    rows = _overlaps(roi.y0, roi.side, resolution, mask.shape[0])
    columns = _overlaps(roi.x0, roi.side, resolution, mask.shape[1])
    used_rows, used_columns = rows.any(0), columns.any(0)
    inside = mask[np.ix_(used_rows, used_columns)].astype(np.float32)
    return rows[:, used_rows] @ inside @ columns[:, used_columns].T


def _overlaps(start: float, side: float, cells: int, pixels: int) -> np.ndarray:
    """(cells, pixels) share of each cell that each pixel fills, along one axis."""
    size = side / cells
    low = start + np.arange(cells)[:, None] * size
    pixel = np.arange(pixels)[None]
    shared = np.minimum(low + size, pixel + 1) - np.maximum(low, pixel)
    return (np.clip(shared, 0, None) / size).astype(np.float32)
