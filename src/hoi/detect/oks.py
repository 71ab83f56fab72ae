"""Object keypoint similarity, COCO's measure of a pose in the image."""

from __future__ import annotations

import numpy as np

from hoi.body.keypoints import KEYPOINTS

#: Spread of human annotators per keypoint, as a share of the root of the person's area: COCO's,
#: and COCO-WholeBody's for the feet.
_SIGMAS = {
    "nose": 0.026, "eye": 0.025, "ear": 0.035, "shoulder": 0.079, "elbow": 0.072, "wrist": 0.062,
    "hip": 0.107, "knee": 0.087, "ankle": 0.089, "toe": 0.068, "heel": 0.066,
}  # fmt: skip
SIGMAS = np.array([_SIGMAS[name.rpartition("_")[2]] for name in KEYPOINTS])


def keypoint_similarity(found: np.ndarray, labelled: np.ndarray, area: float) -> float:
    """Mean over the labelled keypoints of ``exp(-d^2 / (2 area (2 sigma)^2))``: 1 is perfect.

    Args:
        found, labelled: (21, 3) x, y in pixels and confidence; a label with confidence 0 is none.
            How sure `found` is does not count, as in COCO.
        area: of the person in pixels.
    Returns:
        NaN when nothing is labelled.
    """
    known = labelled[:, 2] > 0
    if not known.any() or area <= 0:
        return float("nan")
    squared = ((found[known, :2] - labelled[known, :2]).astype(float) ** 2).sum(1)
    return float(np.exp(-squared / (2 * area * (2 * SIGMAS[known]) ** 2)).mean())
