"""A folder of photos: orientation and focal length from EXIF, the object by name, own masks.

Beside ``desk.jpg`` there may be ``desk.yaml`` (the keys of
:class:`hoi.datasets.photos_config.PhotoNotes`: the object, its box, which person, the camera),
``desk.person_mask.png`` and ``desk.object_mask.png``; ``objects.yaml`` says the same of the whole
folder, one line per photo: its object's category, or a mapping of those keys.
"""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import ExifTags, Image, ImageOps
from pydantic import ValidationError

from hoi.artifacts import Frame, Hints
from hoi.datasets.photos_config import PhotoNotes, PhotosConfig
from hoi.datasets.pictures import open_image, read_mask
from hoi.errors import ConfigError, FrameFailure

HEIF_SUFFIXES = (".heic", ".heif")
SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", *HEIF_SUFFIXES)
OBJECTS_FILE = "objects.yaml"
_MASKS = (".person_mask", ".object_mask")
_FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
_PLAUSIBLE = (0.3, 15.0)  # focal length over the longer side; outside, EXIF is not believed
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0}  # EXIF: inch, centimetre, millimetre


@dataclass(frozen=True, order=True)
class PhotoRef:
    """One photo of a folder: `file` is its name there, `category` the object's noun."""

    frame_id: str
    file: str
    category: str
    notes: PhotoNotes = field(default=PhotoNotes(), compare=False)


def list_photos(config: PhotosConfig) -> list[PhotoRef]:
    """The photos of the folder, sorted by name. No photo is opened.

    Raises ConfigError: the folder is absent or empty, or a file that names objects is wrong.
    """
    folder = Path(config.folder).expanduser()
    if not folder.is_dir():
        raise ConfigError(f"photos.folder: {folder} is no folder")
    files = sorted(
        path.name
        for path in folder.iterdir()
        if path.suffix.lower() in SUFFIXES
        and not path.stem.endswith(_MASKS)
        and not path.name.startswith(".")
    )
    if not files:
        raise ConfigError(f"photos.folder: {folder} holds no {', '.join(SUFFIXES)} file")
    listed = _folder_notes(folder)
    ids = _frame_ids(files)
    refs = []
    for file in files:
        notes = _notes(config, folder, Path(file).stem, listed)
        category = (notes.object or config.default_object).strip().lower()
        refs.append(PhotoRef(ids[file], file, category, notes))
    return refs


def photo_files(folder: Path | str, ref: PhotoRef) -> list[Path]:
    """The existing files that :func:`read_photo` depends on, sorted."""
    image = Path(folder).expanduser() / ref.file
    stem = image.with_suffix("")
    found = [image, *(Path(f"{stem}{end}") for end in (".yaml", *(m + ".png" for m in _MASKS)))]
    return sorted(path for path in found if path.is_file())


def read_photo(config: PhotosConfig, ref: PhotoRef) -> Frame:
    """One photo with its camera. `intrinsics_source` says where the focal length comes from.

    Raises FrameFailure: image_missing, image_unreadable, heic_not_supported, mask_unreadable,
    mask_size_mismatch, person_mask_empty, object_mask_empty.
    """
    folder = Path(config.folder).expanduser()
    path = folder / ref.file
    picture = _opened(path)
    try:
        exif = _focal_tags(picture)
        upright = ImageOps.exif_transpose(picture)
        image = _as_rgb(upright)
    except (OSError, ValueError, SyntaxError, KeyError, TypeError) as error:
        raise FrameFailure("image_unreadable", f"{path.name}: {error}") from error
    width, height = image.size
    focal, source = _focal(ref.notes, exif, width, height, config.default_field_of_view_deg)
    shrink = min(1.0, config.max_side / max(width, height))
    size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
    if size != image.size:
        image = image.resize(size, Image.Resampling.LANCZOS)
        source += f"; scaled down from {width}x{height}"
    scale = np.array([size[0] / width, size[1] / height])
    intrinsics = np.array(
        [[focal * scale[0], 0, size[0] / 2], [0, focal * scale[1], size[1] / 2], [0, 0, 1.0]]
    )
    person, thing = (_own_mask(folder, path.stem, end, (width, height), size) for end in _MASKS)
    return Frame(
        frame_id=ref.frame_id,
        dataset="photos",
        category=ref.category,
        object_name=ref.category,
        source=ref.file,
        image=np.asarray(image),
        intrinsics=intrinsics,
        intrinsics_source=source,
        given_person_mask=person,
        given_object_mask=thing,
        hints=_hints(ref.notes, scale),
    )


# ------------------------------------------------------------------------------------- names


def _frame_ids(files: list[str]) -> dict[str, str]:
    """File name -> a name of plain characters, unique in the folder."""
    plain = {f: re.sub(r"[^A-Za-z0-9_.]+", "_", Path(f).stem) or "photo" for f in files}
    counts: dict[str, int] = {}
    for name in plain.values():
        counts[name.lower()] = counts.get(name.lower(), 0) + 1
    return {
        f: name
        if counts[name.lower()] == 1
        else f"{name}_{hashlib.sha256(f.encode()).hexdigest()[:6]}"
        for f, name in plain.items()
    }


def _notes(
    config: PhotosConfig, folder: Path, stem: str, listed: dict[str, PhotoNotes]
) -> PhotoNotes:
    """What is said of one photo: each key by the run's configuration, else by the photo's own
    file, else by the folder's."""
    own = PhotoNotes() if f"{stem}.yaml" == OBJECTS_FILE else _own_notes(folder / f"{stem}.yaml")
    said = config.objects.get(stem, PhotoNotes())
    if isinstance(said, str):
        said = PhotoNotes(object=said)
    merged = {}
    for notes in (listed.get(stem, PhotoNotes()), own, said):
        merged |= notes.model_dump(exclude_none=True)
    return PhotoNotes(**merged)


def _own_notes(path: Path) -> PhotoNotes:
    return _checked_notes(_yaml_mapping(path), str(path))


def _folder_notes(folder: Path) -> dict[str, PhotoNotes]:
    path = folder / OBJECTS_FILE
    notes = {}
    for photo, said in _yaml_mapping(path).items():
        if not isinstance(said, str | dict):
            raise ConfigError(f"{path}: {photo}: {said!r} is no name")
        mapping = {"object": said} if isinstance(said, str) else said
        notes[str(photo)] = _checked_notes(mapping, f"{path}: {photo}")
    return notes


def _checked_notes(values: dict[Any, Any], origin: str) -> PhotoNotes:
    """Raises ConfigError that says where, which key and what it can be."""
    try:
        return PhotoNotes(**{str(key): value for key, value in values.items()})
    except ValidationError as error:
        problem = error.errors()[0]
        key = ".".join(str(part) for part in problem["loc"])
        if problem["type"] == "extra_forbidden":
            known = ", ".join(sorted(PhotoNotes.model_fields))
            raise ConfigError(f"{origin}: unknown key {key}; known: {known}") from None
        message = problem["msg"].removeprefix("Value error, ")
        given = f" (given: {problem['input']!r})" if key else ""
        raise ConfigError(f"{origin}: {key + ': ' if key else ''}{message}{given}") from None


def _hints(notes: PhotoNotes, scale: np.ndarray) -> Hints:
    """The notes on person and object, in pixels of the image after scaling by (2,) `scale`."""

    def scaled(values: tuple[float, ...] | None) -> Any:
        if values is None:
            return None
        return tuple(float(v * scale[i % 2]) for i, v in enumerate(values))

    return Hints(
        person=notes.person,
        person_box=scaled(notes.person_box),
        person_point=scaled(notes.person_point),
        object_box=scaled(notes.box),
        object_point=scaled(notes.point),
        action=(notes.action or "").strip().lower(),
    )


def _yaml_mapping(path: Path) -> dict[Any, Any]:
    """The mapping in a YAML file, {} when there is no file."""
    if not path.is_file():
        return {}
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not readable as YAML: {error}") from error
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: expected `name: value` lines")
    return content


# ------------------------------------------------------------------------------------ camera


def _focal_tags(picture: Image.Image) -> dict[int, Any]:
    """The EXIF tags of the lens, as stored; empty when there are none."""
    return dict(picture.getexif().get_ifd(ExifTags.IFD.Exif))


def _focal(
    notes: PhotoNotes, exif: dict[int, Any], width: int, height: int, default_deg: float
) -> tuple[float, str]:
    """Focal length in pixels of the picture as stored, and where it comes from."""
    longer = max(width, height)
    if notes.focal_px is not None:
        return notes.focal_px, "focal length of the photo's yaml file"
    if notes.field_of_view_deg is not None:
        angle = notes.field_of_view_deg
        return _from_field_of_view(angle, longer), f"{angle:g} degrees, of the photo's yaml file"
    doubt = ""
    for name, value in (
        ("EXIF 35 mm equivalent", _from_film_equivalent(exif, width, height)),
        ("EXIF focal length and sensor resolution", _from_sensor(exif, longer)),
    ):
        if value is None:
            continue
        if _PLAUSIBLE[0] < value / longer < _PLAUSIBLE[1]:
            return value, name
        doubt = f" ({name} gives {value:.0f} px, which is not believable)"
    return (
        _from_field_of_view(default_deg, longer),
        f"assumed field of view of {default_deg:g} degrees{doubt}",
    )


def _from_field_of_view(degrees: float, longer: int) -> float:
    return longer / 2 / math.tan(math.radians(degrees) / 2)


def _from_film_equivalent(exif: dict[int, Any], width: int, height: int) -> float | None:
    """CIPA DC-008: equal diagonal angle on 36 x 24 mm film."""
    millimetres = _number(exif.get(ExifTags.Base.FocalLengthIn35mmFilm))
    return millimetres and millimetres / _FILM_DIAGONAL_MM * math.hypot(width, height)


def _from_sensor(exif: dict[int, Any], longer: int) -> float | None:
    millimetres = _number(exif.get(ExifTags.Base.FocalLength))
    per_unit = _number(exif.get(ExifTags.Base.FocalPlaneXResolution))
    unit = _MM_PER_UNIT.get(exif.get(ExifTags.Base.FocalPlaneResolutionUnit, 2))
    taken = _number(exif.get(ExifTags.Base.ExifImageWidth))
    taken_height = _number(exif.get(ExifTags.Base.ExifImageHeight)) or 0.0
    if not (millimetres and per_unit and unit):
        return None
    # the picture may have been resized since it was taken
    shrink = longer / max(taken, taken_height) if taken else 1.0
    return millimetres * per_unit / unit * shrink


def _number(value: Any) -> float | None:
    """A positive finite number, or None."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) and number > 0 else None


# ------------------------------------------------------------------------------------ pixels


def _opened(path: Path) -> Image.Image:
    """The photo as stored; HEIC, as phones write it, through the optional pillow-heif."""
    if path.suffix.lower() in HEIF_SUFFIXES:
        try:
            import pillow_heif  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise FrameFailure(
                "heic_not_supported",
                f"{path.name}: reading HEIC needs one more package, `pip install pillow-heif`; "
                "or save the photo as JPEG",
            ) from error
        pillow_heif.register_heif_opener()
    return open_image(path)


def _as_rgb(picture: Image.Image) -> Image.Image:
    """8-bit RGB; transparency becomes white, 16-bit grey is scaled."""
    if picture.mode.startswith("I;16"):
        grey = (np.asarray(picture).astype(np.uint16) >> 8).astype(np.uint8)
        return Image.fromarray(grey).convert("RGB")
    if picture.mode in ("RGBA", "LA", "PA") or "transparency" in picture.info:
        layer = picture.convert("RGBA")
        white = Image.new("RGBA", layer.size, (255, 255, 255, 255))
        return Image.alpha_composite(white, layer).convert("RGB")
    return picture.convert("RGB")


def _own_mask(
    folder: Path, stem: str, ending: str, stored: tuple[int, int], size: tuple[int, int]
) -> np.ndarray | None:
    """The mask a user laid beside the photo, at the photo's stored or scaled size; or None."""
    path = folder / f"{stem}{ending}.png"
    if not path.is_file():
        return None
    drawn = open_image(path).size
    if drawn not in (stored, size):
        raise FrameFailure(
            "mask_size_mismatch",
            f"{path.name} is {drawn[0]}x{drawn[1]}, the photo {stored[0]}x{stored[1]}",
        )
    mask = read_mask(path, drawn[::-1])
    if drawn != size:
        grey = Image.fromarray(mask.astype(np.uint8) * 255).resize(size, Image.Resampling.BOX)
        mask = np.asarray(grey) > 127
    if not mask.any():
        raise FrameFailure(f"{ending[1:]}_empty", f"{path.name} marks no pixel")
    return mask
