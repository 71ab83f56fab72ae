"""sRGB hex codes as numbers, and the two encodings of colour that images and glTF use."""

import numpy as np


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green, blue in 0..255 of a code ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def linear_from_srgb(srgb: np.ndarray) -> np.ndarray:
    """Linear light (0..1) of sRGB values (0..1): glTF stores vertex colours linearly."""
    low = srgb <= 0.04045
    return np.where(low, srgb / 12.92, ((np.maximum(srgb, 0.04045) + 0.055) / 1.055) ** 2.4)


def blend(near: np.ndarray, far: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """``weight * near + (1 - weight) * far`` along the last axis; weight (...,) in 0..1."""
    return weight[..., None] * near + (1.0 - weight[..., None]) * far
