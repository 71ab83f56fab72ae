"""The folder of one run over a few photos: the photos, what was said of them, the settings.

The workflow works inside it and the checkout stays untouched, except for what is built once for
everybody (exemplars, detector files, the memory of results).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from hoi.config import RunConfig, load_config, read_config
from hoi.datasets.photos import SUFFIXES, list_photos, photo_files
from hoi.datasets.photos_config import AUTO, PhotoNotes, PhotosConfig
from hoi.errors import ConfigError
from hoi.exemplars.categories import known_categories
from hoi.exemplars.vocabulary import exemplar_category
from hoi.own_objects.description import own_objects, with_own_categories

_PHOTOS = "photos"
_MESHES = (".obj", ".glb", ".gltf", ".ply", ".off", ".stl")


@dataclass(frozen=True)
class Request:
    """What the user asked for.

    Attributes:
        photos: files or folders.
        notes: of all photos (object, action) or of the only one (person, boxes, camera).
        object_mask, person_mask: pictures beside the only photo.
        mesh: the object's own mesh; `notes.object` says what it is.
        body_model: SMPL or SMPL-H file; None takes the configured one.
        seed: of the run.
    """

    photos: Sequence[Path]
    notes: PhotoNotes = field(default_factory=PhotoNotes)
    object_mask: Path | None = None
    person_mask: Path | None = None
    mesh: Path | None = None
    body_model: Path | None = None


@dataclass(frozen=True)
class PhotoRun:
    """A prepared run: where, with which settings, and what it needs of the checkout."""

    folder: Path
    config_file: Path
    config: RunConfig
    names: dict[str, Path]  # frame id -> the user's photo
    shared_targets: tuple[str, ...]  # to be made in the checkout first


def prepare(root: Path, folder: Path, request: Request) -> PhotoRun:
    """Write the run's folder anew, for the workflow of the checkout `root`.

    Raises ConfigError: a file is not there, or notes that belong to one photo came with several.
    """
    files = photo_list(request.photos)
    _check(request, files)
    photos = folder / _PHOTOS
    shutil.rmtree(photos, ignore_errors=True)
    photos.mkdir(parents=True)
    sources: dict[str, Path] = {}
    notes: dict[str, dict[str, Any]] = {}
    for file in files:
        stem = _free(file.stem, {Path(name).stem for name in sources})
        name = stem + file.suffix.lower()
        sources[name] = file
        own = _notes_beside(file).model_dump(exclude_none=True)
        notes[stem] = own | request.notes.model_dump(exclude_none=True)
        for beside in photo_files(file.parent, _reference(file)):
            if beside.suffix != ".yaml":  # what it says is in the notes
                shutil.copyfile(beside, photos / (stem + beside.name[len(file.stem) :].lower()))
        for ending, mask in (("object", request.object_mask), ("person", request.person_mask)):
            if mask is not None:
                _copy_mask(mask, photos / f"{stem}.{ending}_mask.png")
    settings = _settings(root, folder, request, notes)
    config_file = folder / "config.yaml"
    config_file.write_text(yaml.safe_dump(settings, sort_keys=False, allow_unicode=True))
    config = read_config(_merged(_values(root), settings), str(config_file))
    shared = _link(root, folder, config, own_exemplars=request.mesh is not None)
    refs = list_photos(PhotosConfig(**settings["photos"]))
    return PhotoRun(
        folder,
        config_file,
        config,
        {ref.frame_id: sources[ref.file] for ref in refs},
        shared + _exemplars(root, config, [ref.category for ref in refs], request),
    )


def photo_list(paths: Sequence[Path]) -> list[Path]:
    """The photos among files and in folders, in the order given. Raises ConfigError."""
    found: list[Path] = []
    for path in paths:
        path = path.expanduser()
        if path.is_dir():
            refs = list_photos(PhotosConfig(folder=str(path)))
            found += [path / ref.file for ref in refs]
        elif not path.is_file():
            raise ConfigError(f"{path}: there is no such photo or folder")
        elif path.suffix.lower() not in SUFFIXES:
            raise ConfigError(f"{path}: expected a photo ({', '.join(SUFFIXES)})")
        else:
            found.append(path)
    return list(dict.fromkeys(path.resolve() for path in found))


def _check(request: Request, files: Sequence[Path]) -> None:
    of_one = [
        name
        for name, value in (
            ("--mask", request.object_mask),
            ("--person-mask", request.person_mask),
            ("--box", request.notes.box),
            ("--point", request.notes.point),
            ("--person", request.notes.person),
            ("--person-box", request.notes.person_box),
        )
        if value is not None
    ]
    if of_one and len(files) != 1:
        raise ConfigError(
            f"{', '.join(of_one)}: meant for one photo, but there are {len(files)}; for several, "
            "say it in a file beside each photo (docs/photos.md)"
        )
    for option, path in (
        ("--mask", request.object_mask),
        ("--person-mask", request.person_mask),
        ("--mesh", request.mesh),
        ("--smpl", request.body_model),
    ):
        if path is not None and not path.expanduser().is_file():
            raise ConfigError(f"{option}: there is no file {path}")
    if request.mesh is not None:
        if request.mesh.suffix.lower() not in _MESHES:
            raise ConfigError(f"--mesh: expected one of {', '.join(_MESHES)}: {request.mesh}")
        if not request.notes.object:
            raise ConfigError("--mesh: say what it is, too, e.g. --object chair")


def _notes_beside(file: Path) -> PhotoNotes:
    """What files beside a photo say of it."""
    return _reference(file).notes


def _reference(file: Path):
    refs = list_photos(PhotosConfig(folder=str(file.parent)))
    return next(ref for ref in refs if ref.file == file.name)


def _free(stem: str, taken: set[str]) -> str:
    name, number = stem, 2
    while name in taken:
        name, number = f"{stem}_{number}", number + 1
    return name


def _copy_mask(source: Path, target: Path) -> None:
    """A mask as the reader wants it: a grey PNG. Raises ConfigError for what is no picture."""
    from PIL import Image

    try:
        with Image.open(source.expanduser()) as picture:
            opaque = picture.convert("RGBA").getchannel("A")
            transparent = opaque.getextrema()[0] == 0  # cut out, as editors save it
            (opaque if transparent else picture.convert("L")).save(target)
    except (OSError, ValueError, SyntaxError) as error:
        raise ConfigError(f"{source}: not a readable picture: {error}") from error


def _settings(
    root: Path, folder: Path, request: Request, notes: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    """What differs from the checkout's own configuration."""
    base = load_config(root / "config" / "config.yaml")
    photos = {"folder": str(folder / _PHOTOS), "objects": notes}
    settings: dict[str, Any] = {
        "photos": _plain(photos),
        "memo": str((root / base.memo).absolute()),
        # a page for every photo
        "report": {"max_frames": max(base.report.max_frames, len(notes))},
    }
    if request.body_model is not None:
        settings["assets"] = {"body_model": str(request.body_model.expanduser().resolve())}
    if request.mesh is not None:
        category = exemplar_category(request.notes.object or "", known_categories(base.exemplars))
        meshes = folder / "meshes"
        shutil.rmtree(meshes, ignore_errors=True)
        (meshes / category).mkdir(parents=True)
        mesh = request.mesh.expanduser()
        shutil.copyfile(mesh, meshes / category / mesh.name)
        settings["exemplars"] = {"sources": ["folder"], "folder": str(meshes)}
    return settings


def _exemplars(
    root: Path, config: RunConfig, named: Sequence[str], request: Request
) -> tuple[str, ...]:
    """The exemplar files that the checkout has to have; none where the run builds its own."""
    if request.mesh is not None:
        return ()
    own = own_objects(root / config.assets.own_objects)
    known = with_own_categories(known_categories(config.exemplars), own)
    wanted = {exemplar_category(name, known) for name in named}
    names = known if AUTO in wanted else sorted(wanted & set(known))
    return tuple(f"resources/exemplars/{name}.npz" for name in names)


def _link(root: Path, folder: Path, config: RunConfig, own_exemplars: bool) -> tuple[str, ...]:
    """Show the run the checkout's files; returns those that must be made there first."""
    exemplars = config.exemplars
    named = (config.assets.own_objects, exemplars.folder, exemplars.partnet, exemplars.shapenet)
    relative = [Path(name) for name in named if name and not Path(name).expanduser().is_absolute()]
    for path in (Path("src"), Path("config"), *relative):
        if (root / path).exists() and ".." not in path.parts:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            _symlink(root / path, folder / path)
    resources = folder / "resources"
    if resources.is_symlink():
        resources.unlink()
    shared = ["resources/kernels.ready", "resources/models/all.ready"]
    if not own_exemplars:
        shutil.rmtree(resources, ignore_errors=True)
        _symlink(root / "resources", resources)
    else:
        resources.mkdir(exist_ok=True)
        for name in ("models", "kernels.ready"):
            _symlink(root / "resources" / name, resources / name)
    return tuple(shared)


def _symlink(source: Path, target: Path) -> None:
    if target.is_symlink():
        target.unlink()
    target.symlink_to(os.path.abspath(source))


def _values(root: Path) -> dict[str, Any]:
    return yaml.safe_load((root / "config" / "config.yaml").read_text(encoding="utf-8"))


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """As Snakemake merges configuration files: mappings key by key, all else replaced."""
    result = dict(base)
    for key, value in changes.items():
        old = result.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        result[key] = _merged(old, value) if both else value  # type: ignore[arg-type]
    return result


def _plain(value: Any) -> Any:
    """Tuples as lists, for YAML."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, list | tuple) else value
