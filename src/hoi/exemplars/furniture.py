"""The curated furniture that ships with the package: real CC0 and CC-BY models, part-labelled.

Every model has one role: ``exemplar_pool`` objects may become exemplars; ``ground_truth`` objects
are the true objects of the embedded data set and never enter an exemplar library, so that no
frame is reconstructed with its own mesh. Credits: ``hoi/data/furniture/ATTRIBUTION.md``.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hoi.errors import AssetError
from hoi.exemplars.library import Exemplar, load_library

FURNITURE_DIR = Path(__file__).parents[1] / "data" / "furniture"
Role = Literal["exemplar_pool", "ground_truth"]
Split = Literal["test", "tuning"]


@dataclass(frozen=True)
class FurnitureModel:
    """One row of ``models.csv``: what a model is for and how it is made.

    Args:
        role, split: split is empty for the exemplar pool.
        category, object_name: our noun, and BEHAVE's name of the object it stands in for.
        name: ``<pack>_<index>``, or ``generated_...`` for procedural ones.
        pack, index: where the model is found; ``procedural`` has no index.
        size: width, height, depth in metres where the catalogue's own is not used.
        seat: lower and upper side of the seat in metres, where the rule should not look for it.
        arms: whether a chair has arms; None lets the rule decide.
        groups: OBJ group name prefix -> part (``*`` for all others).
        parameters: of a procedural model.
        warp: amplitude of its smooth deformation, as a share of its size.
    """

    role: str
    split: str
    category: str
    object_name: str
    name: str
    pack: str
    index: int | None
    size: tuple[float, float, float] | None
    seat: tuple[float, float] | None
    arms: bool | None
    groups: dict[str, str]
    parameters: dict[str, float | str]
    warp: float


def furniture_models(path: Path | None = None) -> list[FurnitureModel]:
    """All rows of the committed table; raises AssetError naming a row that cannot be read."""
    path = path or FURNITURE_DIR / "models.csv"
    try:
        with open(path, newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise AssetError(f"{path} cannot be read: {error}") from error
    models = []
    for number, row in enumerate(rows, start=2):
        try:
            models.append(_model_of(row))
        except (KeyError, ValueError, AttributeError) as error:
            raise AssetError(f"{path}, line {number}: {error}") from error
    return models


def load_furniture(
    role: Role, category: str, split: Split | None = None, directory: Path | None = None
) -> list[Exemplar]:
    """The curated objects of a role and category (and split of the ground truth), in table order.

    A category without such objects gives an empty list. Raises AssetError when a listed mesh is
    absent or damaged.
    """
    directory = directory or FURNITURE_DIR
    wanted = [
        model.name
        for model in furniture_models(directory / "models.csv")
        if model.role == role and model.category == category and split in (None, model.split)
    ]
    if not wanted:
        return []
    stored = {exemplar.name: exemplar for exemplar in load_library(directory, category)}
    missing = [name for name in wanted if name not in stored]
    if missing:
        raise AssetError(f"{directory / category}.npz lacks {', '.join(missing)}")
    return [stored[name] for name in wanted]


def _model_of(row: dict[str, str]) -> FurnitureModel:
    if row["role"] not in ("exemplar_pool", "ground_truth"):
        raise ValueError(f"unknown role {row['role']!r}")
    size = tuple(float(row[k]) for k in ("width", "height", "depth") if row[k])
    seat = tuple(float(row[k]) for k in ("seat_bottom", "seat_top") if row[k])
    if len(size) not in (0, 3) or len(seat) not in (0, 2):
        raise ValueError("give all of width, height, depth (and both seat levels) or none")
    return FurnitureModel(
        role=row["role"],
        split=row["split"],
        category=row["category"],
        object_name=row["object_name"],
        name=row["name"],
        pack=row["pack"],
        index=int(row["index"]) if row["index"] else None,
        size=(size[0], size[1], size[2]) if size else None,
        seat=(seat[0], seat[1]) if seat else None,
        arms={"yes": True, "no": False, "": None}[row["arms"]],
        groups=_pairs(row["groups"]),
        parameters={key: _number(value) for key, value in _pairs(row["parameters"]).items()},
        warp=float(row["warp"] or 0),
    )


def _pairs(text: str) -> dict[str, str]:
    """``a=1 b=two words c=3`` -> dict; a value runs to the next key."""
    pairs: dict[str, str] = {}
    key = ""
    for word in text.split():
        head, equals, tail = word.partition("=")
        if equals:
            key = head
            pairs[key] = tail
        else:
            pairs[key] += f" {word}"
    return pairs


def _number(text: str) -> float | str:
    try:
        return float(text) if "." in text else text
    except ValueError:
        return text
