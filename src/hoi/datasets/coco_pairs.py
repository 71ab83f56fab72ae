"""Hand-picked pairs of a person and an object on photos of COCO, to measure detectors on.

COCO's own outlines are the labels; what is ours is which person uses which object. The table
``data/detect/coco_pairs.csv`` names both by their annotation ids, the category as a user would
say it, and the split: ``dev`` was looked at while the recipe and the rule of choice were made,
``test`` (photos of val2017, which the detectors never saw) was not.

A folder with all of COCO or with any part of it will do::

    annotations/instances_val2017.json, instances_train2017.json
    annotations/person_keypoints_val2017.json, ...           (optional)
    val2017/000000000139.jpg, train2017/...
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from hoi.artifacts import Frame
from hoi.body.keypoints import FROM_COCO17, convert_keypoints
from hoi.datasets.labelled import whole_photo
from hoi.errors import ConfigError, FrameFailure

PAIRS = Path(__file__).parents[1] / "data" / "detect" / "coco_pairs.csv"
Split = Literal["dev", "test"]


@dataclass(frozen=True)
class CocoPair:
    """One row of the table; `person` and `object` are COCO's annotation ids."""

    image: int
    subset: str  # train2017 or val2017
    person: int
    object: int
    category: str
    split: str


def coco_pairs(split: Split, table: Path = PAIRS) -> list[CocoPair]:
    """The pairs of a split."""
    with table.open(newline="", encoding="utf-8") as stream:
        rows = [
            CocoPair(
                int(row["image"]),
                row["subset"],
                int(row["person"]),
                int(row["object"]),
                row["category"],
                row["split"],
            )
            for row in csv.DictReader(stream)
        ]
    return [pair for pair in rows if pair.split == split]


def read_coco_pairs(folder: Path | str, split: Split, table: Path = PAIRS) -> Iterator[Frame]:
    """Frames of the pairs whose photo is in the folder, one in memory at a time.

    Their given masks are COCO's polygons, their keypoints COCO's where the folder has them.

    Raises ConfigError where the folder has none of the photos, or where annotations are missing,
    unreadable, or not of the kind that the table names.
    """
    folder = Path(folder).expanduser()
    pairs = [pair for pair in coco_pairs(split, table) if _photo(folder, pair).is_file()]
    if not pairs:
        raise ConfigError(
            f"{folder} has none of the photos of {table.name} ({split}); it needs COCO's layout, "
            "annotations/instances_val2017.json and val2017/000000000139.jpg"
        )
    for subset in sorted({pair.subset for pair in pairs}):
        mine = [pair for pair in pairs if pair.subset == subset]
        wanted = {number for pair in mine for number in (pair.person, pair.object)}
        path = folder / "annotations" / f"instances_{subset}.json"
        outlines = _annotations(path, wanted)
        optional = folder / "annotations" / f"person_keypoints_{subset}.json"
        joints = _annotations(optional, wanted) if optional.is_file() else {}
        for pair in mine:
            try:
                yield _frame(folder, pair, outlines, joints)
            except (FrameFailure, ConfigError, KeyError, TypeError, ValueError) as error:
                raise ConfigError(f"{path}, photo {pair.image}: {error}") from error


def _photo(folder: Path, pair: CocoPair) -> Path:
    return folder / pair.subset / f"{pair.image:012d}.jpg"


def _annotations(path: Path, wanted: set[int]) -> dict[int, dict[str, Any]]:
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))["annotations"]
        return {row["id"]: row for row in rows if row["id"] in wanted}
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: there is no such file") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: no annotations of COCO: {error}") from error


def _frame(
    folder: Path,
    pair: CocoPair,
    outlines: dict[int, dict[str, Any]],
    joints: dict[int, dict[str, Any]],
) -> Frame:
    missing = [number for number in (pair.person, pair.object) if number not in outlines]
    if missing:
        raise ConfigError(f"there is no annotation {missing[0]}")
    frame = whole_photo(_photo(folder, pair), pair.category)
    assert frame.image is not None
    size = frame.image.shape[:2]
    told: dict[str, Any] = {
        "dataset": "coco",
        "given_person_mask": _mask(outlines[pair.person], size),
        "given_object_mask": _mask(outlines[pair.object], size),
    }
    keypoints = np.asarray(joints.get(pair.person, {}).get("keypoints", []), float).reshape(-1, 3)
    if len(keypoints) and (keypoints[:, 2] > 0).any():
        told["given_keypoints"] = convert_keypoints(keypoints, FROM_COCO17)
    return frame.model_copy(update=told)


def _mask(annotation: dict[str, Any], size: tuple[int, int]) -> np.ndarray:
    """(H, W) bool inside of the polygons."""
    mask = np.zeros(size, np.uint8)
    if not isinstance(annotation["segmentation"], list):
        raise ConfigError(f"annotation {annotation['id']} is a crowd, without polygons")
    for outline in annotation["segmentation"]:
        corners = np.asarray(outline, float).reshape(-1, 2) - 0.5  # OpenCV counts from the middle
        cv2.fillPoly(mask, [np.round(corners * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    if not mask.any():
        raise ConfigError(f"annotation {annotation['id']} marks no pixel")
    return mask > 0
