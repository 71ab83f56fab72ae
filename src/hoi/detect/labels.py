"""Names: the detector's classes, and which of them stand for an object category."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from hoi.errors import AssetError

PERSON = "person"
#: Stands for a detector's class where the user drew the object's mask or box.
OWN = "drawn by the user"
#: The source of a box that the user drew.
USER = "user"
_DATA = Path(__file__).parent.parent / "data" / "detect"
LABEL_TABLE = _DATA / "category_labels.csv"
SIZE_TABLE = _DATA / "category_sizes.csv"
#: The 80 classes of COCO in the order of detectors trained on it.
COCO80: tuple[str, ...] = tuple((_DATA / "coco80.txt").read_text().splitlines())
#: The 23 Open Images classes of the second detector; a class that COCO has goes by COCO's name.
OIDV4: tuple[str, ...] = tuple((_DATA / "oidv4.txt").read_text().splitlines())
#: Every class that one of the detectors knows.
KNOWN: tuple[str, ...] = tuple(dict.fromkeys((*COCO80, *OIDV4)))
#: Parts of a dressed person: no objects, unless one of them is asked for.
WORN = ("footwear", "boot", "high heels", "tie")
#: Categories for which any object but a person may be taken: nobody named it.
AUTO = "auto"
ANY_CATEGORY = ("", AUTO)


def label_weights(
    category: str, overrides: Mapping[str, tuple[str, ...]], secondary_weight: float
) -> dict[str, float]:
    """Detector label -> factor on its score, for one object category.

    The first labels of a category have factor 1, look-alikes that detectors confuse with it
    `secondary_weight`. A category that is itself a detector class stands for itself; ``auto``
    admits every class but person. Empty: the detector has no class for this category.
    """
    if category in ANY_CATEGORY:
        return {label: 1.0 for label in KNOWN if label != PERSON and label not in WORN}
    if category in overrides:
        best, *others = overrides[category]
        return {label: secondary_weight for label in others} | {best: 1.0}
    rows = _table().get(category)
    if rows is not None:
        return {label: 1.0 if role == "primary" else secondary_weight for label, role in rows}
    return {category: 1.0} if category in KNOWN and category != PERSON else {}


@cache
def _table() -> dict[str, list[tuple[str, str]]]:
    table: dict[str, list[tuple[str, str]]] = {}
    with LABEL_TABLE.open(newline="") as stream:
        for row in csv.DictReader(stream):
            if row["label"] not in KNOWN or row["role"] not in ("primary", "secondary"):
                raise AssetError(f"{LABEL_TABLE}: unknown label or role in {row}")
            table.setdefault(row["category"], []).append((row["label"], row["role"]))
    return table
