"""Labelled photos with what was found in them, the worst first: for looking, not for counting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hoi.artifacts import Detection, Frame
from hoi.detect.choice import chosen_object
from hoi.report.config import ReportConfig
from hoi.report.html import image_url, render, source
from hoi.report.overlay import Panel, labelled_panel


@dataclass(frozen=True, eq=False)
class LabelledPhoto:
    """One photo: its picture, and how the object's mask and box agree with the labels (IoU)."""

    photo: str
    category: str
    panel: Panel
    right: bool
    object_iou: float  # 0 where nothing was found
    box_iou: float
    chosen: str  # the detector's words for why this object


def labelled_photo(
    frame: Frame, found: Detection, agreement: Mapping[str, object], config: ReportConfig
) -> LabelledPhoto:
    """What the page shows of a photo.

    Args:
        agreement: of :func:`hoi.detect.agreement.frame_agreement`.
    """

    def share(key: str) -> float:
        value = agreement[key]
        return float(value) if isinstance(value, float) and np.isfinite(value) else 0.0

    chosen = chosen_object(found.candidates)
    return LabelledPhoto(
        frame.source,
        frame.category,
        labelled_panel(frame, found, config),
        bool(agreement["box_right"] or agreement["mask_right"]),
        share("object_iou"),
        share("box_iou"),
        "" if chosen is None else f"{chosen.label}: {chosen.reason}",
    )


def labelled_page(photos: Sequence[LabelledPhoto], folder: str, config: ReportConfig) -> str:
    """HTML of all photos, the worst mask first.

    Args:
        folder: name of the folder, for the heading.
    """
    ordered = sorted(photos, key=lambda shot: (shot.right, shot.object_iou, shot.photo))
    return render(
        "labelled.html.j2",
        heading=f"{folder}: detection on labelled photos",
        style=source("style.css"),
        right=sum(shot.right for shot in photos),
        cards=[(shot, image_url(shot.panel.image, config)) for shot in ordered],
    )
