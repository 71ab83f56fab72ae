"""What the data set itself says: its masks and keypoints, checked before they are used."""

from __future__ import annotations

import numpy as np

from hoi.artifacts import Frame
from hoi.errors import FrameFailure


def given_mask(
    frame: Frame, which: str, mask: np.ndarray | None, minimum_pixels: int
) -> np.ndarray:
    """The mask, once it fits the image and shows something.

    Args:
        frame: the frame, for the size of its image.
        which: ``person`` or ``object``; statuses begin with it.
        mask: (H, W) bool, or None when the data set has none.
        minimum_pixels: fewer are nothing.
    Raises:
        FrameFailure: ``person_mask_empty``, ``object_mask_empty`` or ``mask_size_mismatch``.
    """
    if mask is None:
        raise FrameFailure(
            f"{which}_mask_empty",
            f"the data set gives no {which} mask for this frame; masks: registry detects one",
        )
    assert frame.image is not None
    height, width = frame.image.shape[:2]
    if mask.shape != (height, width):
        raise FrameFailure(
            "mask_size_mismatch",
            f"the {which} mask has {mask.shape[1]} x {mask.shape[0]} pixels, "
            f"the image {width} x {height}",
        )
    pixels = int(mask.sum())
    if pixels < minimum_pixels:
        raise FrameFailure(f"{which}_mask_empty", f"the given {which} mask has {pixels} pixels")
    return mask


def given_keypoints(frame: Frame) -> np.ndarray:
    """(21, 3) keypoints of the data set. Raises FrameFailure ``no_keypoints``."""
    if frame.given_keypoints is None:
        raise FrameFailure(
            "no_keypoints",
            "the data set gives no keypoints for this frame; keypoints: registry detects them",
        )
    return frame.given_keypoints
