"""What lies in the frames of a BEHAVE tree, from names and file headers alone.

No picture is decoded and no mesh is read, so thousands of frames take seconds.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from hoi.datasets.behave import read_keypoints
from hoi.datasets.behave_config import BehaveConfig
from hoi.datasets.behave_layout import FrameRef, frame_folder
from hoi.datasets.behave_truth import object_fit, person_fit
from hoi.errors import FrameFailure

#: Oddities of a frame -> what becomes of it.
ODDITIES = {
    "no_image": "has no picture: the frame fails",
    "image_unreadable": "has a picture that cannot be opened: the frame fails",
    "no_person_mask": "has no person mask: given masks end as a failed frame",
    "no_object_mask": "has no object mask: given masks end as a failed frame",
    "mask_size": "has a mask of another size than the picture: the frame fails",
    "mask_unreadable": "has a mask that cannot be opened: the frame fails",
    "no_keypoints": "has no keypoint file: the body cannot be fitted from given keypoints",
    "zero_keypoints": "has all-zero keypoints, OpenPose failed there: the body cannot be fitted",
    "keypoints_unreadable": "has a damaged keypoint file: the frame fails",
    "no_person_fit": "has no person fit: left out, there is no truth",
    "no_object_fit": "has no object fit: left out, there is no truth",
    "person_parameters_only": "has person_fit.pkl without person_fit.ply: needs behave.smplh",
    "no_full_mask": "has no mask of the whole object (obj_rend_full): its visible share is unknown",
}
#: Frames with these are not in the tables at all.
LEFT_OUT = ("no_person_fit", "no_object_fit")


@dataclass(frozen=True)
class FrameSurvey:
    """One frame and what is odd about it."""

    ref: FrameRef
    oddities: tuple[str, ...]

    @property
    def listed(self) -> bool:
        """Whether the tables will have the frame."""
        return not any(name in LEFT_OUT for name in self.oddities)


def survey(root: Path, refs: Iterable[FrameRef], config: BehaveConfig) -> list[FrameSurvey]:
    """Look at every frame."""
    return [FrameSurvey(ref, tuple(_oddities(root, ref, config))) for ref in refs]


def _oddities(root: Path, ref: FrameRef, config: BehaveConfig) -> list[str]:
    folder, camera = frame_folder(root, ref), f"k{config.kinect}"
    names = set(os.listdir(folder))
    found = []
    size = None
    if f"{camera}.color.jpg" in names:
        size = _size(folder / f"{camera}.color.jpg")
        found += [] if size else ["image_unreadable"]
    else:
        found.append("no_image")
    for what, stems in (
        ("no_person_mask", ("person_mask",)),
        ("no_object_mask", ("obj_rend_mask", "obj_mask")),
    ):
        mask = _first(names, camera, stems)
        if mask is None:
            found.append(what)
            continue
        mask_size = _size(folder / mask)
        if mask_size is None:
            found.append("mask_unreadable")
        elif size is not None and mask_size != size:
            found.append("mask_size")
    found += (
        _keypoints(folder / f"{camera}.color.json")
        if f"{camera}.color.json" in names
        else ["no_keypoints"]
    )
    if not config.fits_30fps:  # those are whole sequences, and listing looked into them
        found += _fits(root, ref)
    if _first(names, camera, ("obj_rend_full",)) is None:
        found.append("no_full_mask")
    return list(dict.fromkeys(found))


def _first(names: set[str], camera: str, stems: Iterable[str]) -> str | None:
    for stem in stems:
        for suffix in (".png", ".jpg"):
            if f"{camera}.{stem}{suffix}" in names:
                return f"{camera}.{stem}{suffix}"
    return None


def _size(path: Path) -> tuple[int, int] | None:
    try:
        with Image.open(path) as picture:
            return picture.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None


def _keypoints(path: Path) -> list[str]:
    try:
        keypoints = read_keypoints(path)
    except FrameFailure:
        return ["keypoints_unreadable"]
    return ["zero_keypoints"] if keypoints is not None and not keypoints.any() else []


def _fits(root: Path, ref: FrameRef) -> list[str]:
    person, thing = person_fit(root, ref), object_fit(root, ref)
    found = [] if person else ["no_person_fit"]
    found += [] if thing else ["no_object_fit"]
    if person is not None and person.suffix == ".pkl":
        found.append("person_parameters_only")
    return found
