"""The file that describes a user's own object, and the folder that holds all of them.

``<folder>/<category>/object.yaml`` beside its prepared meshes ``<name>.npz``. People may edit it;
the workflow reads it. Importable without any heavy library: planning a run reads it, too.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field, ValidationError, field_validator, model_validator

from hoi.errors import ConfigError
from hoi.priors.mapping import expand_region
from hoi.settings import Settings

DESCRIPTION = "object.yaml"
PICTURE = "picture.png"
SIDES = ("", "left", "right", "both", "either")
_NOUN = re.compile(r"[a-z][a-z_]*[a-z]")
_FILE_NAME = re.compile(r"[A-Za-z0-9_][\w.\-]*")
_HEADER = """\
# Written by `hoi add-object`; edit it as you like. Sizes in metres. What each line means is told
# in docs/own_objects.md. Photos whose object is named {category} use it from the next run on.
"""


class OwnContact(Settings):
    """One pair of parts that touch."""

    object: str = Field(min_length=1, description="a part of the meshes")
    body: str = Field(description="region of the body; limbs without their side, e.g. hand")
    side: Literal["", "left", "right", "both", "either"] = Field(
        default="", description="of a limb; empty: nobody said"
    )
    probability: float = Field(default=1.0, ge=0, le=1)
    source: str = Field(default="given", description="who said so")

    @model_validator(mode="after")
    def _body_exists(self) -> OwnContact:
        if not expand_region(self.body, self.side):
            raise ValueError(f"the body has no region {self.body!r}")
        return self


class OwnAction(Settings):
    """One thing that people do with the object."""

    contacts: tuple[OwnContact, ...] = Field(min_length=1)
    poses: tuple[str, ...] = Field(
        default=(),
        description="whose poses it looks like, each 'action object' of the pose database, e.g. "
        "'move table'; empty: the database has poses of its own for it",
    )
    stands_on_floor: bool = Field(default=False, description="whether the object stands on it")
    feet_on_floor: bool = Field(default=True, description="whether the person's feet do")


class OwnMesh(Settings):
    """Where a prepared mesh comes from and how its file was read."""

    file: str = Field(description="name of the file it was made from")
    sha256: str = Field(default="", description="digest of that file")
    up: str = Field(default="y", description="the file's axis that points up")
    front: str = Field(default="z", description="the file's axis that points to the front")
    unit_metres: float = Field(default=1.0, gt=0, description="length of the file's unit")


class OwnObject(Settings):
    """Everything that the stages must know of an object. The first action is the default one."""

    category: str
    size_m: float | None = Field(
        default=None, gt=0, lt=20, description="None: the size that is known of the category"
    )
    size_axis: Literal["longest", "height"] = "longest"
    size_source: str = "given"
    detector_labels: tuple[str, ...] = Field(
        default=(), description="classes of the box detector that stand for it, best first"
    )
    actions: dict[str, OwnAction] = Field(default={})
    meshes: dict[str, OwnMesh] = Field(min_length=1)

    @field_validator("category")
    @classmethod
    def _noun(cls, category: str) -> str:
        return checked_category(category)

    @field_validator("meshes")
    @classmethod
    def _names(cls, meshes: dict[str, OwnMesh]) -> dict[str, OwnMesh]:
        for name in meshes:
            if not _FILE_NAME.fullmatch(name):
                raise ValueError(f"{name!r} is no plain file name")
        return meshes


def checked_category(category: str) -> str:
    """The noun as the stages use it: ``Beach ball`` -> ``beach_ball``.

    Raises ValueError for anything but plain words.
    """
    word = "_".join(category.lower().split())
    if not _NOUN.fullmatch(word):
        raise ValueError(f"{category!r} is no name of an object: use letters, blanks and _ only")
    return word


def read_description(path: Path | str) -> OwnObject:
    """One object's file; raises ConfigError naming file and key."""
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: there is no such file; `hoi add-object` makes one") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not readable as YAML: {error}") from error
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: expected settings by name")
    try:
        found = OwnObject(**content)
    except (ValidationError, TypeError) as error:
        problems = error.errors() if isinstance(error, ValidationError) else []
        lines = [
            f"  {'.'.join(map(str, p['loc']))}: {p['msg'].removeprefix('Value error, ')}"
            for p in problems
        ]
        raise ConfigError(f"{path}:\n" + ("\n".join(lines) or f"  {error}")) from None
    if found.category != path.parent.name:
        raise ConfigError(
            f"{path}: category is {found.category!r}, yet its folder is {path.parent.name!r}"
        )
    return found


def write_description(described: OwnObject, path: Path | str) -> None:
    """Write an object's file, in one step."""
    path = Path(path)
    content = _spoken(described.model_dump(mode="json"))
    text = _HEADER.format(category=described.category)
    text += yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=96)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


def _spoken(value: Any) -> Any:
    """Plain data without what says nothing: empty entries, and certainty."""
    if isinstance(value, list):
        return [_spoken(item) for item in value]
    if not isinstance(value, dict):
        return value
    silent = ("", None, [], {})
    kept = {k: v for k, v in value.items() if v not in silent and (k, v) != ("probability", 1.0)}
    return {key: _spoken(item) for key, item in kept.items()}


def own_objects(folder: Path | str) -> dict[str, OwnObject]:
    """Category -> object of every subfolder with a description; no folder, no objects."""
    root = Path(folder).expanduser()
    if not folder or not root.is_dir():
        return {}
    paths = sorted(root.glob(f"*/{DESCRIPTION}"))
    return {path.parent.name: read_description(path) for path in paths}


def description_path(folder: Path | str, category: str) -> Path:
    """Where an object's file is, or would be."""
    return Path(folder).expanduser() / category / DESCRIPTION


def mesh_paths(folder: Path | str, described: OwnObject) -> list[Path]:
    """The prepared meshes of an object, in order of their names."""
    root = description_path(folder, described.category).parent
    return [root / f"{name}.npz" for name in sorted(described.meshes)]


def with_own_categories(known: Iterable[str], objects: Mapping[str, OwnObject]) -> tuple[str, ...]:
    """The categories that have exemplars, those of the user's own objects included."""
    return tuple(dict.fromkeys((*known, *objects)))


def detector_labels(
    objects: Mapping[str, OwnObject], categories: Iterable[str]
) -> dict[str, tuple[str, ...]]:
    """Category -> classes of the detector, for those of `categories` that say so."""
    return {
        name: objects[name].detector_labels
        for name in sorted(set(categories) & set(objects))
        if objects[name].detector_labels
    }
