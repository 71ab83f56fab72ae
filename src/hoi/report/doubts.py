"""Why a result may be wrong although every stage came through.

There is no truth to compare a photo's result with; what can be checked is whether the stages agree
with each other and with what is known of such things. docs/photos.md says how far that tells good
results from bad ones.
"""

from __future__ import annotations

import numpy as np

from hoi.artifacts import Detection, Frame, Joint, ObjectFit
from hoi.detect.touching import expectation

_SEEN = 0.5  # confidence of a keypoint that is seen
_FEW_SEEN = 10  # of 21
_POOR_OUTLINE = 0.6  # IoU of the best exemplar's outline with the mask
_SIZE_SLACK = 1.25  # beyond the usual sizes, which are rounded


def doubts(
    frame: Frame, detection: Detection | None, fit: ObjectFit | None, joint: Joint
) -> list[str]:
    """Each doubt in words; none where there is no result, as its status says why.

    Args:
        frame, detection, fit, joint: artifacts of one frame; without those that are None, what
            they would tell is not doubted.
    """
    sides = object_sides(joint)
    if sides is None:
        return []
    found = []
    if detection is not None and detection.object_mask_source.startswith("box"):
        found.append(
            "the object could not be cut out and its box had to do (a mask of your own helps)"
        )
    if fit is not None and fit.ious is not None and fit.ious.max() < _POOR_OUTLINE:
        found.append(
            f"the object's mask looks like no exemplar (IoU of the outlines {fit.ious.max():.2f})"
        )
    if detection is not None and detection.keypoints is not None:
        seen = int((detection.keypoints[:, 2] >= _SEEN).sum())
        if seen < _FEW_SEEN:
            found.append(f"only {seen} of {len(detection.keypoints)} keypoints are seen")
    known = expectation(frame.object_name) or expectation(frame.category)
    longest = float(sides.max())
    if known is not None and not (
        known.shortest_m / _SIZE_SLACK <= longest <= known.longest_m * _SIZE_SLACK
    ):
        found.append(
            f"the object came out {longest:.2f} m long, and such things are "
            f"{known.shortest_m:g} to {known.longest_m:g} m"
        )
    return found


def object_sides(joint: Joint) -> np.ndarray | None:
    """(3,) width, height, depth of the placed object along its own axes in metres, if it is."""
    if joint.object_vertices is None or joint.object_rotation is None:
        return None
    return np.ptp(joint.object_vertices @ joint.object_rotation, axis=0)
