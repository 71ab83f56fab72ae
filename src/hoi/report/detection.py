"""Detection rates as a table to read."""

from __future__ import annotations

from typing import Any

import pandas as pd

from hoi.report.tables import DASH, MINI_NOTE, LaidOutTable

COLUMNS = (
    "dataset", "split", "category", "n", "person_found", "object_right", "object_box_right",
    "object_mask_right", "failed", "failures", "person_iou", "object_iou",
    "object_box_iou", "keypoint_oks", "keypoint_error_px", "keypoint_error",
)  # fmt: skip


def is_detection_table(table: pd.DataFrame) -> bool:
    """Whether the columns are those of ``results/detection.csv``."""
    return set(COLUMNS) <= set(table.columns)


def detection_layout(table: pd.DataFrame) -> LaidOutTable:
    """Rates per category: what was chosen, how it agrees, and boxes at each score threshold."""
    thresholds = [name.partition("@")[2] for name in table.columns if name.startswith("right@")]
    groups = (
        ("", ("n",)),
        ("found, %", ("person", "object", "by box", "by mask")),
        ("mask IoU", ("person", "object")),
        ("box IoU", ("object",)),
        ("keypoints", ("OKS", "px", "%")),
        *((f"{_threshold(t)}, %", ("person", "object", "right")) for t in thresholds),
    )
    records: list[dict[str, Any]] = [
        {str(key): value for key, value in row.items()} for row in table.to_dict("records")
    ]
    rows = tuple((str(row["category"]), _cells(row, thresholds)) for row in records)
    dataset, split = (str(table[key].iloc[0]) for key in ("dataset", "split"))
    caption = (
        "Found: frames in which the detectors choose a person, and the right object: its box or "
        "its mask overlaps that of the data set by IoU 0.5 or more (and which of them does). Over "
        "the frames that came through: mean IoU with the given masks and with the object's box, "
        "which specks of its mask do not stretch; COCO's object keypoint "
        "similarity (OKS), and the median distance to the given keypoints in pixels and as a share "
        "of the person's longer side. Last columns: frames with any box of the person's and of the "
        "object's class, and any right one, at a score; 0.9 and 0.6 are the paper's thresholds, "
        "ours are lower."
    )
    failures = [
        f"{row['category']}: {row['failures']}"
        for row in records
        if row["category"] != "all" and isinstance(row["failures"], str) and row["failures"]
    ]
    notes = (
        *((f"Failures: {', '.join(failures)}.",) if failures else ()),
        *((MINI_NOTE,) if "behave_mini" in dataset else ()),
    )
    return LaidOutTable(
        f"{dataset} ({split}): detection", caption, "Category", groups, rows, len(rows) - 1, notes
    )


def is_masks_table(table: pd.DataFrame) -> bool:
    """Whether the columns are those of ``results/masks.csv``, data set and split or not."""
    return {"category", "box", "n", "plain_grabcut"} <= set(table.columns)


def masks_layout(table: pd.DataFrame, dataset: str) -> LaidOutTable:
    """Mean IoU of each way to cut out the object, per category and kind of box.

    Args:
        table: of :func:`hoi.detect.mask_methods.mask_table`; data set and split are left out.
        dataset: its name, for the title.
    """
    methods = [
        name for name in table.columns if name not in ("dataset", "split", "category", "box", "n")
    ]
    records = table.to_dict("records")
    rows = tuple(
        (
            f"{row['category']}, {row['box']}",
            (str(row["n"]), *(_number(row[name], 3) for name in methods)),
        )
        for row in records
    )
    groups = (
        ("", ("n",)),
        ("mean IoU", tuple(str(name).replace("_", " ") for name in methods)),
    )
    first = next((i for i, row in enumerate(records) if row["category"] == "all"), None)
    caption = (
        "IoU of the object's mask with the labelled one, by the way it is cut out of its box: the "
        "box that the detectors chose, whether it is the right one or not, and the labelled "
        "mask's own. A box that was not found is left out. Plain GrabCut knows the box alone, "
        "GrabCut the person as well; the stage is what the pipeline keeps: network and GrabCut, "
        "again from the mask's own box."
    )
    return LaidOutTable(f"{dataset}: object masks", caption, "Category, box", groups, rows, first)


def _threshold(name: str) -> str:
    return name if name == "ours" else f"≥ {name}"


def _cells(row: dict[str, Any], thresholds: list[str]) -> tuple[str, ...]:
    n = int(row["n"])
    return (
        str(n),
        _rate(row["person_found"], n),
        _rate(row["object_right"], n),
        _rate(row["object_box_right"], n),
        _rate(row["object_mask_right"], n),
        _number(row["person_iou"], 2),
        _number(row["object_iou"], 2),
        _number(row["object_box_iou"], 2),
        _number(row["keypoint_oks"], 2),
        _number(row["keypoint_error_px"], 1),
        _number(100 * row["keypoint_error"], 1),
        *(
            _rate(row[f"{what}@{threshold}"], n)
            for threshold in thresholds
            for what in ("person", "object", "right")
        ),
    )


def _known(value: Any) -> bool:
    return not pd.isna(value)


def _rate(count: Any, n: int) -> str:
    return f"{100 * count / n:.0f}" if _known(count) and n else DASH


def _number(value: Any, digits: int) -> str:
    return f"{value:.{digits}f}" if _known(value) else DASH
