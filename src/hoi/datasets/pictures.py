"""Reading photos and masks, from untrusted files."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from PIL import Image

from hoi.errors import FrameFailure

MASK_THRESHOLD = 127


def read_image(path: Path) -> np.ndarray:
    """(H, W, 3) uint8 RGB; raises FrameFailure image_missing or image_unreadable."""
    return np.asarray(open_image(path).convert("RGB"))


def open_image(path: Path) -> Image.Image:
    """A fully decoded picture; raises FrameFailure image_missing or image_unreadable."""
    if not path.is_file():
        raise FrameFailure("image_missing", f"{path.name} does not exist in {path.parent.name}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(path)
            image.load()  # a truncated file fails here and not later
    except (OSError, ValueError, SyntaxError, EOFError, Warning) as error:
        raise FrameFailure("image_unreadable", f"{path.name}: {error}") from error
    except Image.DecompressionBombError as error:
        raise FrameFailure("image_unreadable", f"{path.name}: {error}") from error
    return image


def read_mask(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """(H, W) bool of a grey mask picture.

    Raises FrameFailure mask_unreadable or mask_size_mismatch.
    """
    try:
        mask = np.asarray(open_image(path).convert("L")) > MASK_THRESHOLD
    except FrameFailure as failure:
        raise FrameFailure("mask_unreadable", failure.detail) from failure
    if mask.shape != tuple(shape):
        have, want = f"{mask.shape[1]}x{mask.shape[0]}", f"{shape[1]}x{shape[0]}"
        raise FrameFailure("mask_size_mismatch", f"{path.name} is {have}, the image {want}")
    return mask
