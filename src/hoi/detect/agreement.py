"""How well the detectors agree with what a data set itself says: one row per category."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np
import pandas as pd

from hoi.artifacts import OK, Detection, Frame
from hoi.detect.boxes import longer_side, mask_box, overlap
from hoi.detect.choice import CHOSEN
from hoi.detect.config import DetectConfig
from hoi.detect.counts import CORRECT_IOU, detection_counts, labelled_box
from hoi.detect.labels import PERSON
from hoi.detect.oks import keypoint_similarity

ALL = "all"


def detection_table(pairs: Iterable[tuple[Frame, Detection]], config: DetectConfig) -> pd.DataFrame:
    """Detection rates and agreement with the given masks and keypoints.

    Args:
        pairs: frames with what the registry detectors said of them, failed ones included.
        config: the settings they were detected with.

    Returns:
        One row per category, and ``all``: ``n`` frames, ``person_found`` (a person's box was
        chosen), ``object_right`` (the stage came through, and its object's box or mask overlaps
        the given one by IoU 0.5: it is this thing, however well it is cut out),
        ``object_box_right`` and ``object_mask_right`` (which of the two), ``failed`` and
        ``failures`` (statuses with their counts), ``person_iou`` and ``object_iou`` (mean IoU of
        the masks over the frames that came through), ``object_box_iou`` (the same of the chosen
        box; specks of the given mask do not stretch its box), ``keypoint_oks`` (mean object
        keypoint similarity), ``keypoint_error_px`` and ``keypoint_error`` (median distance of the
        keypoints that both sides are sure of; the second as a share of the person's longer side),
        and for every threshold of :func:`hoi.detect.counts.detection_counts` the frames with a
        person's box (``person@0.9``), an object's (``object@0.9``) and a right one
        (``right@0.9``).
    """
    agreements = []

    def compared() -> Iterator[tuple[Frame, Detection]]:
        for frame, found in pairs:  # one at a time: together, photos may not fit into memory
            agreements.append(frame_agreement(frame, found, config))
            yield frame, found

    counts = detection_counts(compared(), config)
    rows = pd.DataFrame(agreements)
    tables = [_summary(name, part) for name, part in rows.groupby("category")]
    table = pd.DataFrame([*tables, _summary(ALL, rows)])
    for threshold, part in counts.groupby("threshold", sort=False):
        for ours, theirs in (
            ("person", "person"),
            ("object", "object"),
            ("right", "correct_object"),
        ):
            count = dict(zip(part["category"], part[theirs], strict=True))
            found = [count.get(category, np.nan) for category in table["category"]]
            table[f"{ours}@{threshold}"] = pd.array(found, dtype="Int64")
    return table


def frame_agreement(frame: Frame, found: Detection, config: DetectConfig) -> dict[str, object]:
    """One frame of :func:`detection_table`; NaN where there is nothing to compare.

    ``person`` (chosen), ``box_right`` and ``mask_right`` of the object, ``person_iou``,
    ``object_iou``, ``box_iou``, ``oks``, ``error_px`` and ``error`` of keypoints.
    """
    row: dict[str, object] = {
        "category": frame.category,
        "status": found.status,
        "person": any(c.label == PERSON and c.verdict == CHOSEN for c in found.candidates),
        "box_right": False,
        "mask_right": False,
        "person_iou": np.nan,
        "object_iou": np.nan,
        "box_iou": np.nan,
        "oks": np.nan,
        "error_px": np.nan,
        "error": np.nan,
    }
    if not found.ok:
        return row
    assert found.object_box is not None
    if frame.given_object_mask is not None and found.object_mask is not None:
        given = labelled_box(frame.given_object_mask)
        box = (*(float(side) for side in found.object_box),)
        row["box_iou"] = overlap(box, given)
        row["object_iou"] = mask_iou(found.object_mask, frame.given_object_mask)
        row["box_right"] = row["box_iou"] >= CORRECT_IOU
        row["mask_right"] = row["object_iou"] >= CORRECT_IOU
    if frame.given_person_mask is not None and found.person_mask is not None:
        row["person_iou"] = mask_iou(found.person_mask, frame.given_person_mask)
    if frame.given_keypoints is not None and found.keypoints is not None:
        if frame.given_person_mask is not None:
            area = float(frame.given_person_mask.sum())
            row["oks"] = keypoint_similarity(found.keypoints, frame.given_keypoints, area)
        sure = (
            np.minimum(frame.given_keypoints[:, 2], found.keypoints[:, 2])
            >= config.keypoint_threshold
        )
        if sure.any():
            gaps = np.linalg.norm((frame.given_keypoints - found.keypoints)[sure, :2], axis=1)
            row["error_px"] = float(np.median(gaps))
            if frame.given_person_mask is not None:
                row["error"] = row["error_px"] / longer_side(mask_box(frame.given_person_mask))
    return row


def mask_iou(first: np.ndarray, second: np.ndarray) -> float:
    """Intersection over union of two (H, W) bool masks, 0 for two empty ones."""
    union = (first | second).sum()
    return float((first & second).sum() / union) if union else 0.0


def _summary(category: object, rows: pd.DataFrame) -> dict[str, object]:
    failures = Counter(status for status in rows["status"] if status != OK)
    return {
        "category": category,
        "n": len(rows),
        "person_found": int(np.count_nonzero(rows["person"])),
        "object_right": int(np.count_nonzero(rows["box_right"] | rows["mask_right"])),
        "object_box_right": int(np.count_nonzero(rows["box_right"])),
        "object_mask_right": int(np.count_nonzero(rows["mask_right"])),
        "failed": sum(failures.values()),
        "failures": "; ".join(f"{status} {n}" for status, n in failures.most_common()),
        "person_iou": rows["person_iou"].mean(),
        "object_iou": rows["object_iou"].mean(),
        "object_box_iou": rows["box_iou"].mean(),
        "keypoint_oks": rows["oks"].mean(),
        "keypoint_error_px": rows["error_px"].mean(),
        "keypoint_error": rows["error"].mean(),
    }
