"""Names of object categories and of their parts.

Parts are named as in PartNet, whose label lists are public (`hoi/data/partnet_parts.json`). A
category PartNet lacks has part names of our own.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection
from functools import cache
from pathlib import Path

from hoi.errors import ConfigError

_PARTNET_FILE = Path(__file__).parents[1] / "data" / "partnet_parts.json"

# Our category noun -> the PartNet category whose part names it uses.
PARTNET_CATEGORY = {
    "chair": "Chair",
    "stool": "Chair",
    "couch": "Chair",
    "table": "Table",
    "desk": "Table",
    "backpack": "Bag",
    "suitcase": "Bag",
    "handbag": "Bag",
    "keyboard": "Keyboard",
    "display": "Display",
    "laptop": "Laptop",
    "mug": "Mug",
    "cup": "Mug",
    "bowl": "Bowl",
    "bottle": "Bottle",
    "trashcan": "TrashCan",
    "bed": "Bed",
    "lamp": "Lamp",
    "knife": "Knife",
    "scissors": "Scissors",
    "hat": "Hat",
    "clock": "Clock",
    "vase": "Vase",
    "door": "Door",
    "microwave": "Microwave",
    "refrigerator": "Refrigerator",
    "dishwasher": "Dishwasher",
    "earphone": "Earphone",
    "faucet": "Faucet",
    "cabinet": "StorageFurniture",
}
# Categories PartNet lacks: part names are ours.
OWN_PARTS = {
    "skateboard": ("deck", "truck", "wheel"),
    "surfboard": ("board", "fin"),
    "skis": ("ski", "binding"),
    "ball": ("surface",),
    "bicycle": ("wheel", "frame", "seat", "handlebar", "pedal"),
    "teddy": ("body", "head", "ear", "arm", "leg"),
}
# Other nouns (detector labels, everyday words) -> the category whose exemplars they use.
SYNONYMS = {
    "armchair": "chair",
    "sofa": "couch",
    "dining table": "table",
    "coffee table": "table",
    "desk": "table",
    "office chair": "chair",
    "cup": "mug",
    "football": "ball",
    "surf board": "surfboard",
    "rucksack": "backpack",
    "tv": "display",
    "monitor": "display",
    "screen": "display",
    "trash bin": "trashcan",
    "trashbin": "trashcan",
    "bin": "trashcan",
    "sports ball": "ball",
    "basketball": "ball",
    "bike": "bicycle",
    "teddy bear": "teddy",
    "ski": "skis",
    "wine bottle": "bottle",
}


def canonical_category(noun: str) -> str:
    """The category noun of an object word: ``dining table`` -> ``table``; unknown words stay."""
    word = " ".join(noun.lower().replace("_", " ").split())
    return SYNONYMS.get(word, word)


def exemplar_category(noun: str, known: Collection[str]) -> str:
    """The category a user's word stands for: itself when it is `known`, else its synonym.

    An own object of several words is known with underscores: ``beach ball`` -> ``beach_ball``.
    """
    word = " ".join(noun.lower().split())
    joined = word.replace(" ", "_")
    return next((name for name in (word, joined) if name in known), canonical_category(word))


def partnet_parts(partnet_category: str) -> dict[str, list[str]]:
    """Part names of a PartNet category: ``level1``, ``merged`` and ``fine`` lists.

    Raises ConfigError for an unknown category.
    """
    categories = _partnet()
    if partnet_category not in categories:
        raise ConfigError(f"PartNet has no category {partnet_category!r}")
    return categories[partnet_category]


def part_names(category: str) -> tuple[str, ...]:
    """All part names a mesh of `category` may carry, coarse ones first; empty if unknown."""
    if category in OWN_PARTS:
        return OWN_PARTS[category]
    if category not in PARTNET_CATEGORY:
        return ()
    lists = partnet_parts(PARTNET_CATEGORY[category])
    return tuple(dict.fromkeys([*lists["level1"], *lists["merged"], *lists["fine"]]))


def as_part(name: str) -> str:
    """A group name spelt as a part name: ``Chair Seat.001`` -> ``chair_seat``."""
    words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    return re.sub(r"(_\d+)+$", "", words) or "unnamed"


@cache
def _partnet() -> dict[str, dict[str, list[str]]]:
    return json.loads(_PARTNET_FILE.read_text(encoding="utf-8"))["categories"]
