"""A folder of photos: orientation and focal length from EXIF, the object by name, own masks.

Beside ``desk.jpg`` there may be ``desk.yaml`` (`object`, `field_of_view_deg` or `focal_px`),
``desk.person_mask.png`` and ``desk.object_mask.png``; ``objects.yaml`` names the objects of the
whole folder (photo: category).
"""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import ExifTags, Image, ImageOps

from hoi.artifacts import Frame
from hoi.datasets.behave import open_image, read_mask
from hoi.datasets.photos_config import PhotosConfig
from hoi.errors import ConfigError, FrameFailure

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
OBJECTS_FILE = "objects.yaml"
_MASKS = (".person_mask", ".object_mask")
_SIDECAR_KEYS = {"object", "field_of_view_deg", "focal_px"}
_FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
_PLAUSIBLE = (0.3, 15.0)  # focal length over the longer side; outside, EXIF is not believed
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0}  # EXIF: inch, centimetre, millimetre


@dataclass(frozen=True, order=True)
class PhotoRef:
    """One photo of a folder: `file` is its name there, `category` the object's noun."""

    frame_id: str
    file: str
    category: str


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
    named = _folder_objects(folder)
    ids = _frame_ids(files)
    return [PhotoRef(ids[f], f, _category(config, folder, Path(f).stem, named)) for f in files]


def photo_files(folder: Path | str, ref: PhotoRef) -> list[Path]:
    """The existing files that :func:`read_photo` depends on, sorted."""
    image = Path(folder).expanduser() / ref.file
    stem = image.with_suffix("")
    found = [image, *(Path(f"{stem}{end}") for end in (".yaml", *(m + ".png" for m in _MASKS)))]
    return sorted(path for path in found if path.is_file())


def read_photo(config: PhotosConfig, ref: PhotoRef) -> Frame:
    """One photo with its camera. `intrinsics_source` says where the focal length comes from.

    Raises FrameFailure: image_missing, image_unreadable, mask_unreadable, mask_size_mismatch,
    person_mask_empty, object_mask_empty.
    """
    folder = Path(config.folder).expanduser()
    path = folder / ref.file
    picture = open_image(path)
    try:
        exif = _focal_tags(picture)
        upright = ImageOps.exif_transpose(picture)
        image = _as_rgb(upright)
    except (OSError, ValueError, SyntaxError, KeyError, TypeError) as error:
        raise FrameFailure("image_unreadable", f"{path.name}: {error}") from error
    width, height = image.size
    sidecar = _sidecar(folder, path.stem)
    focal, source = _focal(sidecar, exif, width, height, config.default_field_of_view_deg)
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


def _category(config: PhotosConfig, folder: Path, stem: str, named: dict[str, str]) -> str:
    """The object's noun: from the run's configuration, the photo's file, the folder's, or none."""
    if stem in config.objects:
        return config.objects[stem].strip().lower()
    own = _sidecar(folder, stem).get("object")
    return str(own or named.get(stem) or config.default_object).strip().lower()


def _folder_objects(folder: Path) -> dict[str, str]:
    content = _yaml_mapping(folder / OBJECTS_FILE)
    for photo, category in content.items():
        if not isinstance(category, str):
            raise ConfigError(f"{folder / OBJECTS_FILE}: {photo}: {category!r} is no name")
    return {str(photo): category for photo, category in content.items()}


def _sidecar(folder: Path, stem: str) -> dict[str, Any]:
    path = folder / f"{stem}.yaml"
    if path.name == OBJECTS_FILE:
        return {}
    content = _yaml_mapping(path)
    unknown = set(map(str, content)) - _SIDECAR_KEYS
    if unknown:
        raise ConfigError(
            f"{path}: unknown key {', '.join(sorted(unknown))}; "
            f"known: {', '.join(sorted(_SIDECAR_KEYS))}"
        )
    for key in ("field_of_view_deg", "focal_px"):
        value = content.get(key)
        if value is not None and not (isinstance(value, int | float) and value > 0):
            raise ConfigError(f"{path}: {key}: {value!r} is no positive number")
    if content.get("field_of_view_deg", 1) >= 170:
        raise ConfigError(f"{path}: field_of_view_deg: expected less than 170")
    return content


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
    sidecar: dict[str, Any], exif: dict[int, Any], width: int, height: int, default_deg: float
) -> tuple[float, str]:
    """Focal length in pixels of the picture as stored, and where it comes from."""
    longer = max(width, height)
    if "focal_px" in sidecar:
        return float(sidecar["focal_px"]), "focal length of the photo's yaml file"
    if "field_of_view_deg" in sidecar:
        angle = float(sidecar["field_of_view_deg"])
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
