"""Segment again from the mask's own box.

Detectors draw loose boxes, or boxes of the half of a thing that they recognise. The network that
cuts out an object also sees the surroundings of its box, and its mask mostly reaches further than
a box that is too small and less far than one that is too large: the mask's box is the better one
to ask with.
"""

from __future__ import annotations

import cv2
import numpy as np

from hoi.detect.backends import Box, ObjectSegmenter, PersonPose
from hoi.detect.boxes import area, overlap
from hoi.detect.config import ResegmentConfig

_NETWORK = "segmenter"  # how the sources of masks that look beyond their box begin


def segment_again(
    segment: ObjectSegmenter,
    image: np.ndarray,
    box: Box,
    pose: PersonPose,
    seed: int,
    config: ResegmentConfig,
) -> tuple[np.ndarray, str, Box]:
    """The mask, how it was made, and the object's box after all passes.

    Masks that cannot reach beyond their box (colour alone, a box) end it at once and keep the box.
    """
    mask, source = segment(image, box, pose, seed)
    asked = box
    for _ in range(config.passes - 1):
        if not source.startswith(_NETWORK) or not mask.any():
            break
        tight = solid_box(mask, config.smallest_part)
        if not config.least_overlap <= overlap(tight, asked) < config.settled:
            break
        if area(tight) < config.least_area * area(box):
            break
        again, how = segment(image, tight, pose, seed)
        if not how.startswith(_NETWORK) or not again.any():
            break
        mask, source, asked = again, how, tight
    if source.startswith(_NETWORK) and mask.any():
        tight = solid_box(mask, config.smallest_part)
        if area(tight) >= config.least_area * area(box):
            box = tight
    return mask, source, box


def solid_box(mask: np.ndarray, smallest_part: float) -> Box:
    """The box of a non-empty mask, leaving out specks.

    Args:
        mask: (H, W) bool.
        smallest_part: connected parts with a smaller share of the pixels are specks.
    """
    _, _, parts, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    parts = parts[1:]  # the first one is the background
    pixels = parts[:, cv2.CC_STAT_AREA]
    solid = parts[pixels >= min(smallest_part * pixels.sum(), pixels.max())]
    x0, y0 = (int(solid[:, side].min()) for side in (cv2.CC_STAT_LEFT, cv2.CC_STAT_TOP))
    x1 = int((solid[:, cv2.CC_STAT_LEFT] + solid[:, cv2.CC_STAT_WIDTH]).max())
    y1 = int((solid[:, cv2.CC_STAT_TOP] + solid[:, cv2.CC_STAT_HEIGHT]).max())
    return float(x0), float(y0), float(x1), float(y1)
