"""Photos with labels to measure detectors on: a folder with ``labels.csv``.

Columns: ``photo``, ``category``, ``object_mask``, and where known ``person_mask`` and
``keypoints``. Entries are file names inside the folder; masks are pictures, bright where the thing
is; keypoints a JSON file of 17 (COCO's order) or 25 (OpenPose's BODY_25) rows x, y, v, flat or
nested, also under a key ``keypoints`` or ``body_joints``, 0 as v for what is not labelled.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hoi.artifacts import Frame
from hoi.body.keypoints import FROM_BODY25, FROM_COCO17, convert_keypoints
from hoi.datasets.photos import PhotoRef, read_photo
from hoi.datasets.photos_config import PhotosConfig
from hoi.datasets.pictures import open_image, read_mask
from hoi.errors import ConfigError, FrameFailure

LABELS_FILE = "labels.csv"
_REQUIRED = ("photo", "category", "object_mask")
_OPTIONAL = ("person_mask", "keypoints")
_NO_LIMIT = 100_000  # pixels of the longer side
_ORDERS = {17: FROM_COCO17, 25: FROM_BODY25}


def read_labelled(folder: Path | str) -> Iterator[Frame]:
    """The folder's frames, one in memory at a time, labels as their given masks and keypoints.

    Raises ConfigError where ``labels.csv`` or a file that it names is missing, lies outside the
    folder or cannot be read; the message says which line.
    """
    folder = Path(folder).expanduser()
    path = folder / LABELS_FILE
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream)
            columns = reader.fieldnames or []
            rows = list(reader)
    except FileNotFoundError as error:
        raise ConfigError(
            f"{path}: there is no such file; it needs the columns {', '.join(_REQUIRED)}"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: not readable: {error}") from error
    missing = [name for name in _REQUIRED if name not in columns]
    unknown = [name for name in columns if name not in _REQUIRED + _OPTIONAL]
    if missing or unknown:
        raise ConfigError(
            f"{path}: columns {', '.join(missing or unknown)} are "
            f"{'missing' if missing else 'unknown'}"
        )
    if not rows:
        raise ConfigError(f"{path}: names no photo")
    for number, row in enumerate(rows, start=2):
        try:
            yield _labelled(folder, {key: (value or "").strip() for key, value in row.items()})
        except (FrameFailure, ConfigError) as error:
            raise ConfigError(f"{path}, line {number}: {error}") from error


def _labelled(folder: Path, row: dict[str, str]) -> Frame:
    photo = _inside(folder, row["photo"])
    if not row["category"]:
        raise ConfigError("the category is empty")
    frame = whole_photo(photo, row["category"].lower())
    assert frame.image is not None
    size = frame.image.shape[:2]
    told: dict[str, Any] = {
        "dataset": folder.name,
        "given_object_mask": _mask(folder, row["object_mask"], size),
        "given_person_mask": None,
    }
    if row.get("person_mask"):
        told["given_person_mask"] = _mask(folder, row["person_mask"], size)
    if row.get("keypoints"):
        told["given_keypoints"] = _keypoints(_inside(folder, row["keypoints"]))
    return frame.model_copy(update=told)


def whole_photo(photo: Path, category: str) -> Frame:
    """A photo's frame in full size, so that labels in its pixels fit."""
    settings = PhotosConfig(folder=str(photo.parent), max_side=_NO_LIMIT)
    return read_photo(settings, PhotoRef(photo.stem, photo.name, category))


def _inside(folder: Path, name: str) -> Path:
    path = (folder / name).resolve()
    if not name or not path.is_relative_to(folder.resolve()):
        raise ConfigError(f"{name!r} is no file inside {folder}")
    if not path.is_file():
        raise ConfigError(f"there is no file {name}")
    return path


def _mask(folder: Path, name: str, size: tuple[int, int]) -> np.ndarray:
    path = _inside(folder, name)
    drawn = open_image(path).size
    if drawn != size[::-1]:
        raise ConfigError(f"{name} is {drawn[0]}x{drawn[1]}, the photo {size[1]}x{size[0]} pixels")
    mask = read_mask(path, size)
    if not mask.any():
        raise ConfigError(f"{name} marks no pixel")
    return mask


def _keypoints(path: Path) -> np.ndarray:
    """(21, 3) in the order of :data:`hoi.body.keypoints.KEYPOINTS`."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(content, dict):
            content = content.get("keypoints", content.get("body_joints"))
        table = np.asarray(content, dtype=float).reshape(-1, 3)
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{path.name}: no list of x, y, v: {error}") from error
    if len(table) not in _ORDERS or not np.isfinite(table).all():
        raise ConfigError(f"{path.name}: {len(table)} keypoints; expected 17 or 25")
    return convert_keypoints(table, _ORDERS[len(table)])
