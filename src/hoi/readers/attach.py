"""Lay what other systems found into a frame, beside what its data set gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import ExifTags, Image

from hoi.artifacts import Frame, Instance
from hoi.errors import AssetError, FrameFailure
from hoi.readers.bodies import read_bodies
from hoi.readers.config import MaskFiles, OtherSystems
from hoi.readers.contacts import read_contacts
from hoi.readers.keypoints import read_people
from hoi.readers.masks import fitted, read_instances, read_pair
from hoi.readers.paths import FrameNames

_TURNED = (5, 6, 7, 8)  # EXIF orientations that swap width and height


def attach(
    frame: Frame,
    settings: OtherSystems,
    names: FrameNames,
    root: Path | str,
    stored: tuple[int, int] | None = None,
) -> Frame:
    """The frame with the results of other systems in place of the data set's own.

    Args:
        frame: a frame that is ok.
        settings: which files.
        names: what the files may call the frame.
        root: folder that relative paths start in.
        stored: width, height of the picture as stored, when the frame's image is scaled; other
            systems saw that one.
    Raises:
        FrameFailure: ``masks_unreadable``, ``mask_size_mismatch``, ``keypoints_unreadable``,
            ``bodies_unreadable`` or ``contacts_unreadable``, with file and key.
    """
    if frame.image is None:
        return frame
    root = Path(root)
    size = (frame.image.shape[1], frame.image.shape[0])
    stored = stored or size
    found: dict[str, Any] = {}
    kind = "masks"
    try:
        if settings.masks is not None:
            found |= _masks(settings.masks, names, root, stored, size)
        if settings.keypoints is not None:
            kind = "keypoints"
            people = read_people(settings.keypoints, names, root)
            scale = np.array([size[0] / stored[0], size[1] / stored[1], 1.0])
            found |= {"given_people": people * scale, "given_keypoints": None}
        if settings.bodies is not None:
            kind = "bodies"
            bodies = read_bodies(settings.bodies, names, root)
            found |= {"given_poses": bodies.poses, "given_betas": bodies.betas}
        if settings.contacts is not None:
            kind = "contacts"
            found |= {"given_contacts": read_contacts(settings.contacts, names, root)}
    except AssetError as error:
        raise FrameFailure(f"{kind}_unreadable", str(error)) from error
    sources = {
        name: getattr(settings, name).format
        for name in ("masks", "keypoints", "bodies", "contacts")
        if getattr(settings, name) is not None
    }
    # not model_copy: the values are checked
    values: dict[str, Any] = dict(frame)
    values.update(found, given_by=sources)
    return Frame(**values)


def _masks(
    files: MaskFiles,
    names: FrameNames,
    root: Path,
    stored: tuple[int, int],
    size: tuple[int, int],
) -> dict[str, Any]:
    try:
        if files.format == "png":
            pair = read_pair(files, names, root)
            person, thing = (fitted(mask[None], stored, size)[0] for mask in pair)
            return {"given_person_mask": person, "given_object_mask": thing}
        seen = read_instances(files, names, root, stored)
        masks = fitted(seen.masks, stored, size)
    except ValueError as error:
        raise FrameFailure("mask_size_mismatch", f"{names.file}: {error}") from error
    return {
        "given_person_mask": None,
        "given_object_mask": None,
        "given_instances": [
            Instance(label=label, score=score)
            for label, score in zip(seen.labels, seen.scores, strict=True)
        ],
        "given_instance_masks": masks,
    }


def upright_size(photo: Path) -> tuple[int, int]:
    """Width and height of a photo file as it is shown: the pixels that other systems saw.

    Raises FrameFailure ``image_unreadable``.
    """
    try:
        with Image.open(photo) as picture:
            turned = picture.getexif().get(ExifTags.Base.Orientation) in _TURNED
            width, height = picture.size
            return (height, width) if turned else (width, height)
    except (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError) as error:
        raise FrameFailure("image_unreadable", f"{photo.name}: {error}") from error
