"""The images of an interaction database: which there are, and what each should show."""

from __future__ import annotations

import csv
import hashlib
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from hoi.actions.queries import parse_query
from hoi.artifacts import Frame
from hoi.datasets.photos import SUFFIXES, PhotoRef, photo_files, read_photo
from hoi.datasets.photos_config import PhotosConfig
from hoi.errors import ConfigError, FrameFailure
from hoi.exemplars.vocabulary import SYNONYMS, exemplar_category
from hoi.interactions.config import InteractionsConfig

MANIFEST = "manifest.csv"
_MASK = re.compile(r".*\.(person|object)_mask")


@dataclass(frozen=True, order=True)
class ImageRef:
    """One image: `file` is its path in the folder, `query` what it was found with."""

    frame_id: str
    file: str
    query: str
    category: str
    action: str


def list_images(config: InteractionsConfig, categories: Collection[str]) -> list[ImageRef]:
    """Every image of the folder, or of its manifest, sorted. No image is opened.

    Args:
        categories: known objects, which tells where a query's object begins.

    Raises ConfigError: no such folder, no image in it, or a query that cannot be read.
    """
    root = Path(config.folder).expanduser()
    if not config.folder or not root.is_dir():
        raise ConfigError(
            f"interactions.folder is {config.folder!r}: name a folder of images, "
            "<folder>/<query>/*.jpg"
        )
    listed = _manifest(root) if (root / MANIFEST).is_file() else _folders(root)
    if not listed:
        raise ConfigError(
            f"interactions.folder: {root} holds no <query>/*{', *'.join(SUFFIXES)} and no "
            f"{MANIFEST}"
        )
    images = []
    for file, text in sorted(set(listed)):
        query = parse_query(text, {*categories, *SYNONYMS})
        category = exemplar_category(query.category.replace("_", " "), categories)
        images.append(ImageRef(_frame_id(file, text), file, text, category, query.action))
    return images


def image_files(config: InteractionsConfig, ref: ImageRef) -> list[Path]:
    """The existing files that :func:`read_image` depends on."""
    folder, photo = _as_photo(config, ref)
    return photo_files(folder, photo)


def read_image(config: InteractionsConfig, ref: ImageRef) -> Frame:
    """One image as a frame; masks and notes may lie beside it as beside photos.

    Raises FrameFailure: too_small, or whatever :func:`hoi.datasets.photos.read_photo` raises.
    """
    folder, photo = _as_photo(config, ref)
    settings = PhotosConfig(
        folder=str(folder), default_field_of_view_deg=config.default_field_of_view_deg
    )
    frame = read_photo(settings, photo)
    assert frame.image is not None
    height, width = frame.image.shape[:2]
    if min(height, width) <= config.min_side_px:
        raise FrameFailure(
            "too_small", f"{width} x {height} pixels; more than {config.min_side_px} are needed"
        )
    return frame.model_copy(
        update={
            "dataset": "interactions",
            "category": ref.category,
            "object_name": ref.category,
            "action": ref.action,
            "source": ref.file,
        }
    )


def _as_photo(config: InteractionsConfig, ref: ImageRef) -> tuple[Path, PhotoRef]:
    path = Path(config.folder).expanduser() / ref.file
    return path.parent, PhotoRef(ref.frame_id, path.name, ref.category)


def _folders(root: Path) -> list[tuple[str, str]]:
    """(file, query) of every image in a subfolder."""
    return [
        (path.relative_to(root).as_posix(), path.parent.name)
        for path in root.glob("*/*")
        if path.suffix.lower() in SUFFIXES
        and not path.name.startswith(".")
        and not _MASK.fullmatch(path.stem)
    ]


def _manifest(root: Path) -> list[tuple[str, str]]:
    """(file, query) of every row; files must lie in the folder."""
    path = root / MANIFEST
    listed = []
    try:
        with open(path, newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream)
            if not {"image", "query"} <= set(reader.fieldnames or ()):
                raise ConfigError(f"{path}: the columns image and query are expected")
            for row in reader:
                file, query = (row["image"] or "").strip(), (row["query"] or "").strip()
                inside = PurePosixPath(file)
                if not file or inside.is_absolute() or ".." in inside.parts:
                    raise ConfigError(
                        f"{path}, line {reader.line_num}: {file!r} is no file of this folder"
                    )
                listed.append((inside.as_posix(), query))
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text: {error}") from error
    return listed


def _frame_id(file: str, query: str) -> str:
    """A name of plain characters that is the image's own."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", Path(file).with_suffix("").as_posix()).strip("_")
    digest = hashlib.sha256(f"{file}\0{query}".encode()).hexdigest()[:8]
    return f"{plain[:60]}_{digest}"
