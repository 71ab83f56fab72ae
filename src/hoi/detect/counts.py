"""How often the detector fails, per category and threshold, as section 4.2 counts it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pandas as pd

from hoi.artifacts import OK, Detection, Frame
from hoi.detect.backends import Box
from hoi.detect.boxes import overlap
from hoi.detect.config import DetectConfig
from hoi.detect.labels import PERSON, label_weights
from hoi.detect.resegment import solid_box

#: Overlap (IoU) with the box of the data set's own mask from which a box counts as correct.
CORRECT_IOU = 0.5
_SPECK = 0.02  # share of a labelled mask under which a part of it does not stretch its box


def labelled_box(mask: np.ndarray) -> Box:
    """The box that detected ones are compared with: of a labelled non-empty mask, without specks.

    Args:
        mask: (H, W) bool.
    """
    return solid_box(mask, _SPECK)


def detection_counts(
    pairs: Iterable[tuple[Frame, Detection]], config: DetectConfig
) -> pd.DataFrame:
    """Detected people and objects per category at the paper's thresholds and at ours.

    Args:
        pairs: frames with what the registry detectors said of them, failed ones included (their
            candidates count too). Frames whose masks were given are left out: nothing was detected.
        config: the settings they were detected with.

    Returns:
        One row per category (and ``all``) and threshold: ``category``, ``threshold`` (``0.9``,
        ``0.6``, ``ours``), ``n``, ``person``, ``object``, ``correct_object`` (frames in which a box
        of the right class overlaps the data set's own object mask; NaN where it has none), and
        ``object_failure_rate`` (share without a correct object; without any, where there is no
        reference).
    """
    rows = [row for frame, detection in pairs for row in _frame_rows(frame, detection, config)]
    columns = ["category", "threshold", "person", "object", "correct_object"]
    table = pd.DataFrame(rows, columns=columns)
    table["correct_object"] = table["correct_object"].astype(float)
    table = pd.concat([table, table.assign(category="all")], ignore_index=True)
    groups = table.groupby(["category", "threshold"], sort=False)
    counts = groups.agg(
        n=("person", "size"),
        person=("person", "sum"),
        object=("object", "sum"),
        correct_object=("correct_object", lambda column: column.sum(min_count=1)),
    ).reset_index()
    found = counts["correct_object"].fillna(counts["object"])
    counts["object_failure_rate"] = 1 - found / counts["n"]
    return counts


def status_counts(pairs: Iterable[tuple[Frame, Detection]]) -> pd.DataFrame:
    """Frames per ``category`` and ``status`` (column ``n``)."""
    rows = [(frame.category, detection.status) for frame, detection in pairs]
    table = pd.DataFrame(rows, columns=["category", "status"])
    return table.value_counts(["category", "status"], sort=False).rename("n").reset_index()


def _frame_rows(frame: Frame, detection: Detection, config: DetectConfig) -> Iterator[tuple]:
    if detection.status == OK and not detection.candidates:
        return
    weights = label_weights(frame.category, config.labels, config.secondary_weight)
    people = [item.score for item in detection.candidates if item.label == PERSON]
    objects = [
        (item.score * weights[item.label], item.box)
        for item in detection.candidates
        if item.label in weights
    ]
    mask = frame.given_object_mask
    truth = labelled_box(mask) if mask is not None and mask.any() else None
    levels = {f"{value:g}": (value, value) for value in config.reported_thresholds}
    levels["ours"] = (config.person_threshold, config.object_threshold)
    for name, (person_level, object_level) in levels.items():
        boxes = [box for score, box in objects if score >= object_level]
        correct = None
        if truth is not None:
            correct = any(overlap(box, truth) >= CORRECT_IOU for box in boxes)
        person = any(score >= person_level for score in people)
        yield frame.category, name, person, bool(boxes), correct
