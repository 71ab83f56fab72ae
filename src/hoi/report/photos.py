"""The table of a folder of photos: what came out of each, or which stage stopped and why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from hoi.artifacts import BodyFit, Detection, Frame, Joint, ObjectFit
from hoi.datasets.photos_config import AUTO
from hoi.report.doubts import doubts, object_sides
from hoi.report.tables import DASH, LaidOutTable

COLUMNS = (
    "photo", "object", "named_by", "status", "failed_stage", "detail", "doubts", "action",
    "exemplar", "object_size_m", "object_mask", "keypoint_error_px", "intrinsics", "scene",
    "overlay", "seconds",
)  # fmt: skip


def photo_row(
    frame: Frame,
    detection: Detection,
    body: BodyFit,
    fit: ObjectFit,
    joint: Joint,
    files: Mapping[str, str],
    seconds: float,
) -> dict[str, Any]:
    """One photo's row; keys are :data:`COLUMNS`.

    Args:
        frame, detection, body, fit, joint: the photo's artifacts, failed ones included.
        files: paths of its ``scene`` and ``overlay``, where they exist.
        seconds: time of all stages.
    """
    return {
        "photo": frame.source or frame.frame_id,
        "object": frame.category,
        "named_by": _named_by(frame),
        "status": joint.status,
        "failed_stage": joint.failed_stage,
        "detail": joint.detail,
        "doubts": "; ".join(doubts(frame, detection, fit, joint)),
        "action": joint.action,
        "exemplar": joint.exemplar,
        "object_size_m": object_size(joint),
        "object_mask": detection.object_mask_source,
        "keypoint_error_px": body.reprojection_error_px,
        "intrinsics": frame.intrinsics_source,
        "scene": files.get("scene", ""),
        "overlay": files.get("overlay", ""),
        "seconds": round(seconds, 1),
    }


def object_size(joint: Joint) -> str:
    """Width x height x depth of the placed object in metres; empty without one."""
    sides = object_sides(joint)
    return "" if sides is None else " x ".join(f"{side:.2f}" for side in sides)


def is_photos_table(table: pd.DataFrame) -> bool:
    """Whether the columns are those of ``results/photos.csv``."""
    return set(COLUMNS) <= set(table.columns)


def photos_layout(table: pd.DataFrame) -> LaidOutTable:
    """The table for people: a row a photo, the reasons of failures and doubts below."""
    shown = ("object", "status", "action", "object_size_m", "object_mask", "seconds")
    records = [
        {str(key): "" if pd.isna(value) else str(value) for key, value in row.items()}
        for row in table.to_dict("records")
    ]
    rows = tuple((row["photo"], tuple(row[name] or DASH for name in shown)) for row in records)
    came_through = sum(row["status"] == "ok" for row in records)
    return LaidOutTable(
        f"Photos: {came_through} of {len(records)} reconstructed",
        "Size: width x height x depth of the object in metres. Mask: how the object was cut out; "
        "names with `box`: its box had to do.",
        "Photo",
        (("", ("object", "status", "action", "size", "mask", "seconds")),),
        rows,
        None,
        tuple(
            f"{row['photo']}: {told}{row[key]}."
            for row in records
            for key, told in (("detail", ""), ("doubts", "doubtful: "))
            if row[key]
        ),
    )


def _named_by(frame: Frame) -> str:
    if frame.object_name != AUTO:
        return "you"
    return "nobody" if frame.category == AUTO else "detector"
