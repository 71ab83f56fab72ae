"""`hoi add-object` without its command line: prepare, ask, draw, accept, write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from hoi.actions.database import PoseDatabase, load_database
from hoi.config import RunConfig
from hoi.errors import ConfigError
from hoi.exemplars.categories import known_categories
from hoi.exemplars.library import Exemplar, save_library
from hoi.own_objects.asking import model_of, said_contacts, said_size
from hoi.own_objects.description import (
    PICTURE,
    OwnAction,
    OwnContact,
    OwnObject,
    checked_category,
    description_path,
    read_description,
    write_description,
)
from hoi.own_objects.knowledge import (
    GIVEN,
    described_actions,
    group_contacts,
    like_category,
    merged_object,
    own_contact,
    parse_contact,
    plain_words,
)
from hoi.own_objects.picture import draw_picture
from hoi.own_objects.prepare import MeshOptions, Prepared, prepare_mesh
from hoi.priors.client import LanguageModel
from hoi.priors.tables import PriorTables, load_tables

Ask = Callable[[str], str]


@dataclass(frozen=True)
class Wishes:
    """What the user says; see the options of ``hoi add-object``."""

    mesh: Path
    category: str
    name: str
    up: str | None = None
    front: str | None = None
    unit: str | None = None
    vertices: int = 1000
    groups: Mapping[str, str] = field(default_factory=dict)
    regions: tuple[str, ...] = ()
    labels: Path | None = None
    size_m: float | None = None
    size_axis: str = "longest"
    contacts: tuple[str, ...] = ()
    poses: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    floor: Mapping[str, bool] = field(default_factory=dict)
    like: str | None = None
    detector_labels: tuple[str, ...] = ()
    asked: tuple[str, ...] = ()  # actions whose contacts the language model says


class Added(NamedTuple):
    """What to tell the user, and whether the object is there now."""

    accepted: bool
    report: str


class _Known(NamedTuple):
    """What the package and earlier calls know already."""

    tables: PriorTables
    database: PoseDatabase
    shipped: bool  # whether the category is one of the package's own
    old: OwnObject | None


def add_object(wishes: Wishes, folder: Path, config: RunConfig, ask: Ask | None = None) -> Added:
    """Prepare a mesh and write ``<folder>/<category>/``: object.yaml, the mesh, a picture.

    Args:
        wishes: mesh, category and whatever was said of them.
        folder: of the user's own objects.
        config: names the pose database and the exemplars that come with the package.
        ask: puts a question to the user and returns the answer; None asks nothing.

    Raises ConfigError or AssetError when something does not fit, and says what to do.
    """
    category = _category(wishes.category)
    path = description_path(folder, category)
    known = _known(category, path, config)
    options = _mesh_options(wishes)
    prepared = prepare_mesh(wishes.mesh, category, wishes.name, options)
    model = model_of(config.priors.llm) if wishes.asked else None
    picture = path.parent / PICTURE
    title = f"{category} (as `hoi add-object` understood it)"
    draw_picture(prepared.exemplar, picture, title, prepared.notes)
    contacts = _contacts(wishes, prepared.exemplar.part_names, known, ask, picture)
    notes = list(prepared.notes)
    for action in map(plain_words, wishes.asked if model else ()):
        assert model is not None
        said = said_contacts(model, category, action, prepared.exemplar.part_names)
        contacts.setdefault(action, []).extend(said.contacts)
        notes += [f"left out of the model's answer for {action}: {text}" for text in said.unmapped]
    prepared = prepared._replace(notes=tuple(notes))
    actions = _actions(wishes, category, contacts, prepared.exemplar.part_names, known)
    described = _described(wishes, category, prepared, actions, known, model)
    if not described.actions and not known.shipped:
        return Added(False, _nothing_known(category, prepared.exemplar, picture))
    if ask is not None:
        print(_summary(described, prepared, picture))
        if ask("Is that right? [Y/n] ").lower() in ("n", "no"):
            return Added(False, _corrections(picture))
    save_library([prepared.exemplar], path.parent / f"{wishes.name}.npz")
    write_description(described, path)
    return Added(True, _summary(described, prepared, picture) + _next_steps(described, path, known))


def _category(word: str) -> str:
    try:
        return checked_category(word)
    except ValueError as error:
        raise ConfigError(f"--category: {error}") from None


def _known(category: str, path: Path, config: RunConfig) -> _Known:
    return _Known(
        load_tables(),
        load_database(config.assets.pose_database),
        category in known_categories(config.exemplars),
        read_description(path) if path.is_file() else None,
    )


def _mesh_options(wishes: Wishes) -> MeshOptions:
    if wishes.size_m is not None and not 0.005 < wishes.size_m < 20:
        raise ConfigError(f"--size {wishes.size_m:g}: expected metres, between 0.005 and 20")
    return MeshOptions(
        up=wishes.up,
        front=wishes.front,
        unit=wishes.unit,
        size_m=wishes.size_m,
        size_axis=wishes.size_axis,
        groups=wishes.groups,
        labels=wishes.labels,
        regions=wishes.regions,
        vertices=wishes.vertices,
    )


def _contacts(
    wishes: Wishes,
    parts: tuple[str, ...],
    known: _Known,
    ask: Ask | None,
    picture: Path,
) -> dict[str, list[OwnContact]]:
    """Contacts by action: what was said, else what is answered now."""
    said = [parse_contact(text) for text in wishes.contacts]
    nothing = not (said or wishes.like or wishes.asked or known.shipped)
    if nothing and known.old is None and ask is not None:
        print(f"{picture} shows the mesh; its parts are {', '.join(parts)}.")
        print("Who touches what? One contact a line, as push:handle:hands; an empty line ends.")
        while text := ask("contact: "):
            try:
                spoken = parse_contact(text)
                own_contact(spoken, parts)
                said.append(spoken)
            except ConfigError as error:
                print(error)
    pairs = [(plain_words(spoken.action), own_contact(spoken, parts)) for spoken in said]
    return group_contacts(pairs)


def _actions(
    wishes: Wishes,
    category: str,
    contacts: Mapping[str, list[OwnContact]],
    parts: tuple[str, ...],
    known: _Known,
) -> dict[str, OwnAction]:
    """Actions that this call adds; said ones come first and replace those of a like category."""
    said = described_actions(
        contacts, category, known.tables, known.database, wishes.poses, wishes.floor
    )
    if wishes.like is None:
        return said
    like = like_category(wishes.like, parts, known.tables)
    return {**said, **{name: entry for name, entry in like.items() if name not in said}}


def _described(
    wishes: Wishes,
    category: str,
    prepared: Prepared,
    actions: dict[str, OwnAction],
    known: _Known,
    model: LanguageModel | None,
) -> OwnObject:
    """The description that will be written."""
    size_m, axis, source = wishes.size_m, wishes.size_axis, GIVEN
    if size_m is None and model is not None:
        size_m, source = said_size(model, category), f"answer of {model.config.model}"
    if size_m is None and category not in known.tables.sizes:
        size_m, axis = round(float(prepared.exemplar.size.max()), 3), "longest"
        source = f"measured on {wishes.mesh.name}"
    new = OwnObject.model_validate(
        {
            "category": category,
            "size_m": size_m,
            "size_axis": axis,
            "size_source": source,
            "detector_labels": _detector_labels(wishes),
            "actions": actions,
            "meshes": {wishes.name: prepared.origin},
        }
    )
    return merged_object(known.old, new, wishes.name, prepared.origin)


def _detector_labels(wishes: Wishes) -> tuple[str, ...]:
    from hoi.detect.labels import KNOWN, PERSON, label_weights

    for label in wishes.detector_labels:
        if label not in KNOWN or label == PERSON:
            raise ConfigError(
                f"--detector-label {label!r} is no class of the detector; its classes are "
                + ", ".join(name for name in KNOWN if name != PERSON)
            )
    if wishes.detector_labels or wishes.like is None:
        return wishes.detector_labels
    return tuple(label_weights(wishes.like, {}, 0.5))


# ------------------------------------------------------------------------------------ words


def _summary(described: OwnObject, prepared: Prepared, picture: Path) -> str:
    exemplar = prepared.exemplar
    extent = " x ".join(f"{side:.2f}" for side in exemplar.size)
    size = "as recorded" if described.size_m is None else f"{described.size_m:g} m"
    lines = [
        f"{described.category}: {exemplar.name}, {extent} m (width x height x depth), "
        f"{len(exemplar.vertices)} vertices, parts {', '.join(exemplar.part_names)}",
        *(f"  {note}" for note in prepared.notes),
        f"  size {size} ({described.size_axis}, {described.size_source})",
    ]
    for action, entry in described.actions.items():
        pairs = ", ".join(
            f"{c.object}/{f'{c.side} ' if c.side else ''}{c.body}" for c in entry.contacts
        )
        floor = "stands on the floor" if entry.stands_on_floor else "off the floor"
        poses = f"; poses of {', '.join(entry.poses)}" if entry.poses else ""
        lines.append(f"  {action}: {pairs}; {floor}{poses}")
    lines.append(f"  picture: {picture}")
    return "\n".join(lines)


def _next_steps(described: OwnObject, path: Path, known: _Known) -> str:
    from hoi.detect.labels import label_weights

    category = described.category
    steps = [
        "",
        f"Written to {path.parent}/. Look at the picture; run the command again with --up, "
        "--front, --part, --region or --size to correct it.",
        f"Then name your photo's object so in objects.yaml (my_photo: {category}) and run "
        "snakemake -j2 results/photos.csv",
    ]
    if known.shipped:
        steps.append(
            f"Your mesh joins the package's exemplars of {category}: results with a {category} "
            "are computed anew."
        )
    elif not label_weights(category, {category: described.detector_labels}
                           if described.detector_labels else {}, 0.5):  # fmt: skip
        steps.append(
            f"The detector has no class for a {category}: draw my_photo.object_mask.png beside "
            "each photo, or name a class that looks like it with --detector-label."
        )
    return "\n".join(steps)


def _nothing_known(category: str, exemplar: Exemplar, picture: Path) -> str:
    part = exemplar.part_names[0]
    return (
        f"{picture} shows the mesh; its parts are {', '.join(exemplar.part_names)}.\n"
        f"One thing is missing: who touches which part of a {category}, and when. Run the command "
        f"again with, for example, --contact push:{part}:hands (several are possible), or with "
        "--like CATEGORY for a known category. Nothing else was written."
    )


def _corrections(picture: Path) -> str:
    return (
        f"Nothing was written but {picture}. Run the command again with --up, --front, --part, "
        "--region, --size or --contact to correct it."
    )
