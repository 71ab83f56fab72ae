"""Masks of other systems: a picture each of person and object, or a segmenter's instances."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from hoi.errors import AssetError
from hoi.readers.coco import category_of, entries_of, mask_of
from hoi.readers.config import MaskFiles
from hoi.readers.files import number
from hoi.readers.paths import FrameNames, fill, is_per_frame

_THRESHOLD = 127
_MOST_INSTANCES = 40


class Instances(NamedTuple):
    """What a segmenter saw, surest first: labels as COCO spells them, scores, masks (N, H, W)."""

    labels: list[str]
    scores: list[float]
    masks: np.ndarray


def read_pair(files: MaskFiles, names: FrameNames, root: Path) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) bool masks of person and object, of their pictures' own size; raises AssetError."""
    person, thing = (_picture(fill(p, names, root)) for p in (files.person, files.object))
    return person, thing


def read_instances(
    files: MaskFiles, names: FrameNames, root: Path, size: tuple[int, int]
) -> Instances:
    """The instances of one frame, of the size that the file gives them; raises AssetError.

    `size` is the width and height of the picture as stored, for polygons in files without it. An
    annotation without a score counts as sure.
    """
    path = fill(files.path, names, root)
    annotations = fill(files.annotations, names, root) if files.annotations else None
    found = entries_of(path, annotations, names, is_per_frame(files.path))
    rows = []
    for row in found.entries:
        if not row.get("segmentation"):
            continue
        score = number(row.get("score", 1.0), "score", path)
        rows.append((min(max(score, 0.0), 1.0), category_of(row, found.categories, path), row))
    rows = sorted(rows, key=lambda row: -row[0])[:_MOST_INSTANCES]
    if not rows:
        raise AssetError(f"{path}: no instance with a 'segmentation' for image {names.file!r}")
    masks = [mask_of(row["segmentation"], found.size or size, path) for _, _, row in rows]
    if len({mask.shape for mask in masks}) > 1:
        raise AssetError(f"{path}: the masks of {names.file!r} differ in size")
    return Instances([label for _, label, _ in rows], [s for s, _, _ in rows], np.stack(masks))


def fitted(masks: np.ndarray, stored: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    """Masks (N, H, W) of the stored picture or of the image, at the size of the image.

    Args:
        stored, size: width, height of the picture as stored and of the image made of it.
    Raises:
        ValueError: they have neither size.
    """
    drawn = (masks.shape[2], masks.shape[1])
    if drawn == size:
        return masks
    if drawn != stored:
        raise ValueError(f"the masks are {drawn[0]}x{drawn[1]}, the photo {stored[0]}x{stored[1]}")
    scaled = [
        np.asarray(Image.fromarray(mask.astype(np.uint8) * 255).resize(size, Image.Resampling.BOX))
        for mask in masks
    ]
    return np.stack(scaled) > _THRESHOLD


def _picture(path: Path) -> np.ndarray:
    if not path.is_file():
        raise AssetError(f"{path}: no such file")
    try:
        with Image.open(path) as picture:
            return np.asarray(picture.convert("L")) > _THRESHOLD
    except (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError) as error:
        raise AssetError(f"{path}: not a readable picture: {error}") from error
