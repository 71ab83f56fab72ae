"""Which way of cutting out the object agrees best with labelled masks, box given or found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from hoi.artifacts import Detection, Frame
from hoi.detect.agreement import ALL, mask_iou
from hoi.detect.backends import Box, ObjectSegmenter, PersonPose
from hoi.detect.boxes import mask_box, pixel_window
from hoi.detect.choice import chosen_object
from hoi.detect.config import DetectConfig
from hoi.detect.grabcut import plain_grabcut

#: Where the box comes from: the detectors chose it, or it is the labelled mask's own.
FOUND, TRUE = "found box", "true box"


def mask_methods(config: DetectConfig) -> dict[str, ObjectSegmenter]:
    """The ways to compare: the box, the box without the person, colour, the network.

    ``plain_grabcut`` knows only the box; ``grabcut`` is ours, which knows the person.
    """
    from hoi.detect.segmenter import object_segmenter_of

    colour = object_segmenter_of(config.model_copy(update={"object_masks": "grabcut"}))
    raw = config.segmenter.model_copy(update={"refine": False})
    network = config.model_copy(update={"object_masks": "segmenter", "segmenter": raw})
    settled = config.model_copy(update={"object_masks": "segmenter"})
    return {
        "whole_box": _box,
        "box_minus_person": _box_minus_person,
        "plain_grabcut": plain_grabcut,
        "grabcut": colour,
        "network": object_segmenter_of(network),
        "network_grabcut": object_segmenter_of(settled),
    }


def compare_masks(
    frame: Frame,
    found: Detection,
    pose: PersonPose,
    methods: Mapping[str, ObjectSegmenter],
    seed: int,
) -> list[dict[str, object]]:
    """One row per method and box: ``photo``, ``category``, ``box``, ``method``, ``iou``.

    ``stage`` is the mask that was found: from the detector's box, and again from the mask's own.

    Args:
        frame: with its labelled object mask.
        found: what the stage said of it; a failed one is compared with the true box only.
        pose: of the frame's person.
        methods: see :func:`mask_methods`.
        seed: for methods that draw random numbers.
    """
    truth, image = frame.given_object_mask, frame.image
    assert truth is not None and image is not None
    boxes: dict[str, Box] = {TRUE: mask_box(truth)}
    chosen = _chosen_box(found)
    if chosen is not None:
        boxes[FOUND] = chosen
    masks = [
        (kind, name, segment(image, box, pose, seed)[0])
        for kind, box in boxes.items()
        for name, segment in methods.items()
    ]
    if found.object_mask is not None:
        masks.append((FOUND, "stage", found.object_mask))
    return [
        {
            "photo": frame.frame_id,
            "category": frame.category,
            "box": kind,
            "method": name,
            "iou": mask_iou(mask, truth),
        }
        for kind, name, mask in masks
    ]


def _chosen_box(found: Detection) -> Box | None:
    """The box that the detectors drew; ``object_box`` has become that of the mask."""
    chosen = chosen_object(found.candidates)
    if chosen is None:
        return None
    x0, y0, x1, y1 = (float(side) for side in chosen.box)
    return x0, y0, x1, y1


def mask_rows(rows: Iterable[dict[str, object]]) -> pd.DataFrame:
    """The rows as a table, with its columns even where there are none."""
    return pd.DataFrame(rows, columns=["photo", "category", "box", "method", "iou"])


def mask_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean IoU: a row per category (and ``all``) and kind of box, a column per method; ``n``.

    Args:
        rows: of :func:`mask_rows`.
    """
    table = pd.concat([rows, rows.assign(category=ALL)], ignore_index=True)
    groups = table.groupby(["category", "box"], sort=False)
    counts = pd.DataFrame({"n": groups["photo"].nunique()})
    means = table.pivot_table(
        index=["category", "box"], columns="method", values="iou", aggfunc="mean", sort=False
    )
    return counts.join(means).reset_index()


def _box(image: np.ndarray, box: Box, pose: PersonPose, seed: int) -> tuple[np.ndarray, str]:
    mask = np.zeros(image.shape[:2], bool)
    mask[pixel_window(box, *image.shape[:2])] = True
    return mask, "box"


def _box_minus_person(
    image: np.ndarray, box: Box, pose: PersonPose, seed: int
) -> tuple[np.ndarray, str]:
    mask, _ = _box(image, box, pose, seed)
    return mask & (pose.probability <= 0.5), "box_minus_person"
