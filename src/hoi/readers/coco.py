"""COCO's json: annotation files and lists of results, run-length masks and polygons.

Format: github.com/cocodataset/cocoapi. A results list is ``[{image_id, category_id, score,
segmentation | keypoints}, ...]``, an annotation file ``{images, annotations, categories}``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hoi.detect.labels import COCO80
from hoi.errors import AssetError
from hoi.readers.files import entry, listed, number, numbers, read_json
from hoi.readers.paths import FrameNames

_MAX_SIDE = 20_000
_UNUSED_IDS = {12, 26, 29, 30, 45, 66, 68, 69, 71, 83}  # of 1..90: removed from the 2014 list
_CATEGORY_NAMES = dict(zip([i for i in range(1, 91) if i not in _UNUSED_IDS], COCO80, strict=True))


class Found(NamedTuple):
    """The entries of one image, the names of categories, and the image's size as listed."""

    entries: list[dict[str, Any]]
    categories: Mapping[int, str]
    size: tuple[int, int] | None  # width, height
    are_results: bool


def entries_of(path: Path, annotations: Path | None, names: FrameNames, alone: bool) -> Found:
    """What a file says of one frame's image.

    Args:
        path: results list or annotation file.
        annotations: annotation file that a results list refers to, or None.
        names: the image is the one whose file name, without folder and suffix, or whose number is
            that of the frame.
        alone: the file is this frame's own: whatever the image is called there, it is the one.
    """
    content = read_json(path)
    listing = read_json(annotations) if annotations is not None else content
    images, categories = {}, dict(_CATEGORY_NAMES)
    if isinstance(listing, dict):
        source = annotations or path
        images = _images(listing, source)
        if "categories" in listing:
            categories = _categories(listing["categories"], source)
    are_results = isinstance(content, list)
    rows = content if are_results else entry(content, "annotations", path)
    rows = listed(rows, "annotations", path)
    for row in rows:
        entry(row, "image_id", path)
    wanted = {key for key, (name, _) in images.items() if Path(name).stem == names.stem}
    wanted |= {names.file, names.stem, names.frame_id}
    if names.stem.isdigit() and not images:
        wanted.add(int(names.stem))
    chosen = [row for row in rows if _hashable(row["image_id"], path) in wanted]
    if not chosen and alone and len({row["image_id"] for row in rows}) == 1:
        chosen = rows
    size = next((images[key][1] for key in wanted if key in images), None)
    return Found(chosen, categories, size, are_results)


def category_of(row: dict[str, Any], categories: Mapping[int, str], path: Path) -> str:
    """The class name of an entry, as COCO spells it."""
    value = entry(row, "category_id", path)
    if not isinstance(value, int) or value not in categories:
        raise AssetError(f"{path}: key 'category_id' is {value!r}, which no category has")
    return categories[value]


def mask_of(segmentation: Any, size: tuple[int, int] | None, path: Path) -> np.ndarray:
    """(H, W) bool of a run-length mask or of polygons.

    Args:
        segmentation: ``{size: [h, w], counts: text or numbers}`` or a list of x, y lists.
        size: width, height of the image, which polygons need.
    Raises:
        AssetError: naming the file and what is wrong with the mask.
    """
    if isinstance(segmentation, list):
        if size is None:
            raise AssetError(
                f"{path}: key 'segmentation' holds polygons, which need the image's 'width' and "
                "'height' in an annotation file; or write run-length masks"
            )
        return _polygons(segmentation, size, path)
    shape = listed(entry(segmentation, "size", path), "size", path)
    if len(shape) != 2 or not all(isinstance(n, int) and 0 < n <= _MAX_SIDE for n in shape):
        raise AssetError(f"{path}: key 'size' of a mask is {shape!r}, expected height and width")
    counts = entry(segmentation, "counts", path)
    if isinstance(counts, str | bytes):
        runs = _decoded_counts(counts, path)
    else:
        runs = numbers(listed(counts, "counts", path), "counts", path).astype(np.int64)
    height, width = shape
    if (runs < 0).any() or runs.sum() != height * width:
        raise AssetError(
            f"{path}: key 'counts' of a mask covers {runs.sum()} pixels, "
            f"its size {height} x {width} has {height * width}"
        )
    values = np.arange(len(runs)) % 2 == 1  # the first run is background
    return np.repeat(values, runs).reshape(width, height).T


def _decoded_counts(text: str | bytes, path: Path) -> np.ndarray:
    """Run lengths of COCO's compressed text: numbers of 5 bits a character, deltas from the third.

    The characters of all numbers are worked on at once.
    """
    try:
        raw = text.encode("ascii") if isinstance(text, str) else text
    except UnicodeEncodeError:
        raise AssetError(f"{path}: key 'counts' of a mask is no run-length text") from None
    codes = np.frombuffer(raw, np.uint8).astype(np.int64) - 48
    if not len(codes) or codes.min() < 0 or codes.max() > 63 or codes[-1] & 0x20:
        raise AssetError(f"{path}: key 'counts' of a mask is no run-length text")
    last = (codes & 0x20) == 0
    number_of = np.concatenate([[0], np.cumsum(last)[:-1]])
    starts = np.concatenate([[0], np.flatnonzero(last)[:-1] + 1])
    place = np.arange(len(codes)) - starts[number_of]
    if place.max() > 6:
        raise AssetError(f"{path}: key 'counts' of a mask holds a number that is too long")
    values = np.zeros(int(last.sum()), np.int64)
    np.add.at(values, number_of, (codes & 0x1F) << (5 * place))
    negative = (codes[last] & 0x10) != 0
    values -= np.where(negative, np.int64(1) << (5 * (place[last] + 1)), 0)
    runs = values.copy()
    runs[1::2] = np.cumsum(values[1::2])
    runs[2::2] = np.cumsum(values[2::2])
    return runs


def _polygons(polygons: list[Any], size: tuple[int, int], path: Path) -> np.ndarray:
    from PIL import Image, ImageDraw

    canvas = Image.new("1", size)
    draw = ImageDraw.Draw(canvas)
    for polygon in polygons:
        corners = numbers(polygon, "segmentation", path)
        if corners.ndim != 1 or len(corners) < 6 or len(corners) % 2:
            raise AssetError(
                f"{path}: key 'segmentation' holds a polygon of {corners.size} numbers"
            )
        draw.polygon([tuple(c) for c in corners.reshape(-1, 2).tolist()], fill=1)
    return np.asarray(canvas)


def _images(listing: dict[str, Any], path: Path) -> dict[Any, tuple[str, tuple[int, int] | None]]:
    """Image id -> file name, and width and height where they are listed."""
    images = {}
    for image in listed(entry(listing, "images", path), "images", path):
        name = entry(image, "file_name", path)
        if not isinstance(name, str):
            raise AssetError(f"{path}: key 'file_name' is {name!r}, expected a text")
        size = None
        if "width" in image and "height" in image:
            size = (
                round(number(image["width"], "width", path)),
                round(number(image["height"], "height", path)),
            )
            if not all(0 < n <= _MAX_SIDE for n in size):
                raise AssetError(f"{path}: keys 'width', 'height' of {name!r} are {size}")
        images[_hashable(entry(image, "id", path), path)] = (name, size)
    return images


def _categories(value: Any, path: Path) -> dict[int, str]:
    names = {}
    for category in listed(value, "categories", path):
        name, key = entry(category, "name", path), entry(category, "id", path)
        if not isinstance(name, str) or not isinstance(key, int):
            raise AssetError(f"{path}: key 'categories' holds {category!r}")
        names[key] = name.lower().replace("_", " ")
    return names


def _hashable(value: Any, path: Path) -> Any:
    if not isinstance(value, int | str):
        raise AssetError(f"{path}: an image id is {value!r}, expected a number or a text")
    return value
