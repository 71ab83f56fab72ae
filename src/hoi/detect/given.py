"""What the data set or another system says: masks and keypoints, checked before they are used."""

from __future__ import annotations

import numpy as np

from hoi.artifacts import Frame
from hoi.detect.boxes import mask_box
from hoi.detect.strong.instances import Instance
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


def given_keypoints(frame: Frame, person_mask: np.ndarray) -> np.ndarray:
    """(21, 3) keypoints that the data set or another system gives.

    Of several people, the one with most of its confidence on the person's mask. Raises
    FrameFailure ``no_keypoints``.
    """
    if frame.given_people is not None:
        return _person_on_mask(frame.given_people, person_mask)
    if frame.given_keypoints is None:
        raise FrameFailure(
            "no_keypoints",
            "the data set gives no keypoints for this frame; keypoints: registry detects them",
        )
    return frame.given_keypoints


def _person_on_mask(people: np.ndarray, mask: np.ndarray) -> np.ndarray:
    if not len(people):
        raise FrameFailure("no_keypoints", "the keypoint file of this frame shows nobody")
    height, width = mask.shape
    column, row = np.floor(people[..., :2]).astype(np.int64).transpose(2, 0, 1)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    on_mask = inside & mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    confidence = people[..., 2].astype(np.float64)
    # where nobody is on the mask, the surest person
    score = (confidence * on_mask).sum(axis=1) + 1e-3 * confidence.sum(axis=1)
    return people[score.argmax()]


def given_instances(frame: Frame) -> list[Instance]:
    """What another system segmented. Raises FrameFailure ``mask_size_mismatch``."""
    assert frame.image is not None
    masks = frame.given_instance_masks
    if masks is None or len(masks) != len(frame.given_instances):
        raise FrameFailure("masks_unreadable", "instances and masks of this frame do not pair up")
    if masks.shape[1:] != frame.image.shape[:2]:
        raise FrameFailure(
            "mask_size_mismatch",
            f"the instances have {masks.shape[2]} x {masks.shape[1]} pixels, "
            f"the image {frame.image.shape[1]} x {frame.image.shape[0]}",
        )
    return [
        Instance(item.label, item.score, mask_box(mask), mask)
        for item, mask in zip(frame.given_instances, masks, strict=True)
        if mask.any()
    ]
