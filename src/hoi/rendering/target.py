"""The mask that a silhouette is compared with."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt


class SilhouetteTarget:
    """A mask, which of its pixels count, and the tables that make comparing with it cheap.

    Attributes:
        mask: (H, W) float32 in [0, 1]; zero where `keep` is zero.
        keep: (H, W) float32 weights; zero where nothing is known (an occluder, outside the photo).
        edge_distance: (H, W) float32, square root of the distance in pixels to the visible outline
            of the mask; zero where nothing is known. Where an occluder cuts the mask there is no
            outline.
        pixels: (H, W, 3) float32, the three above side by side.
        prefix: (H, W + 1, 3) float32 sums along each row of keep * (1 - 2 mask), keep * mask, keep.
        base_loss: the mask loss of an empty silhouette, sum of keep * mask^2.
        area: sum of keep * mask.
    """

    def __init__(self, mask: np.ndarray, keep: np.ndarray | None = None):
        """Raises ValueError when mask and keep are not two equal 2-D shapes or not finite."""
        mask = np.asarray(mask, dtype=np.float32)
        keep = np.ones_like(mask) if keep is None else np.asarray(keep, dtype=np.float32)
        if mask.ndim != 2 or mask.shape != keep.shape:
            raise ValueError(f"mask {mask.shape} and keep {keep.shape} must be one (H, W)")
        if not (np.isfinite(mask).all() and np.isfinite(keep).all() and (keep >= 0).all()):
            raise ValueError("mask and keep must be finite, keep not negative")
        self.keep = np.ascontiguousarray(keep)
        self.mask = np.ascontiguousarray(np.where(keep > 0, np.clip(mask, 0, 1), 0), np.float32)
        self.edge_distance = _edge_distance(self.mask > 0.5, self.keep == 0)
        self.pixels = np.stack([self.mask, self.keep, self.edge_distance], axis=-1)
        sums = np.stack(
            [self.keep * (1 - 2 * self.mask), self.keep * self.mask, self.keep], axis=-1
        )
        height, width = mask.shape
        self.prefix = np.zeros((height, width + 1, 3), np.float32)
        np.cumsum(sums, axis=1, dtype=np.float32, out=self.prefix[:, 1:])
        self.base_loss = float((self.keep * self.mask.astype(np.float64) ** 2).sum())
        self.area = float((self.keep.astype(np.float64) * self.mask).sum())

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.mask.shape


def _edge_distance(inside: np.ndarray, unknown: np.ndarray) -> np.ndarray:
    background = ~inside & ~unknown
    if not inside.any() or not background.any():
        return np.zeros(inside.shape, np.float32)
    from_background = np.asarray(distance_transform_edt(~background)) - 0.5
    from_inside = np.asarray(distance_transform_edt(~inside)) - 0.5
    distance = np.where(inside, from_background, from_inside)
    return np.sqrt(np.where(unknown, 0, distance)).astype(np.float32)
