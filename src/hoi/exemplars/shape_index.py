"""Which shapes a PartNet folder has of which category, remembered: reading thousands of
``meta.json`` files takes seconds, and a workflow asks at every start. No heavy imports.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from hoi.digest import json_digest
from hoi.errors import AssetError, ConfigError
from hoi.exemplars.vocabulary import PARTNET_CATEGORY

DEFAULT_CACHE = Path(".cache/hoi/shapes")
"""Where it is remembered when the caller names no folder."""

#: Categories of PartNet-Mobility that PartNet v0 does not have -> our noun.
MOBILITY_CATEGORY = {
    "FoldingChair": "chair",
    "Suitcase": "suitcase",
    "Luggage": "suitcase",
}


def categories_of(noun: str) -> frozenset[str]:
    """The PartNet categories whose shapes may be objects of our `noun`."""
    found = {mobility for mobility, ours in MOBILITY_CATEGORY.items() if ours == noun}
    if noun in PARTNET_CATEGORY:
        found.add(PARTNET_CATEGORY[noun])
    return frozenset(found)


def partnet_nouns(root: Path | str, cache_folder: Path = DEFAULT_CACHE) -> tuple[str, ...]:
    """Our nouns that a PartNet folder may have shapes of; raises ConfigError."""
    have = set(shape_index(root, cache_folder).values())
    nouns = dict.fromkeys((*PARTNET_CATEGORY, *MOBILITY_CATEGORY.values()))
    return tuple(noun for noun in nouns if categories_of(noun) & have)


def second_nouns(nouns: Iterable[str]) -> list[str]:
    """Nouns whose PartNet categories all belong to an earlier noun, too."""
    seen: set[str] = set()
    second = []
    for noun in nouns:
        if categories_of(noun) <= seen:
            second.append(noun)
        seen |= categories_of(noun)
    return second


def shape_index(root: Path | str, cache_folder: Path = DEFAULT_CACHE) -> dict[str, str]:
    """Folder name -> PartNet category of every shape below `root`, sorted by name.

    Shapes whose ``meta.json`` is damaged are reported on standard error and left out. Raises
    ConfigError when there is no such folder, or no shape in it.
    """
    root = Path(root).expanduser()
    if not root.is_dir():
        raise ConfigError(f"exemplars.partnet: there is no folder {root}")
    names = sorted(entry.name for entry in os.scandir(root) if entry.is_dir())
    entry = cache_folder / f"index-{listing_digest(str(root.resolve()), tuple(names))[:16]}.json"
    try:
        known = json.loads(entry.read_text(encoding="utf-8"))
        if isinstance(known, dict) and all(isinstance(v, str) for v in known.values()):
            return known
    except (OSError, ValueError):
        pass
    index = {}
    for name in names:
        if not (root / name / "meta.json").is_file():
            continue
        try:
            index[name] = shape_category(root / name)
        except AssetError as error:
            print(f"left out: {error}", file=sys.stderr)
    if not index:
        raise ConfigError(
            f"exemplars.partnet: {root} holds no shape folders (<id>/meta.json with 'model_cat'); "
            "name PartNet's folder data_v0, or PartNet-Mobility's folder dataset"
        )
    entry.parent.mkdir(parents=True, exist_ok=True)
    partial = entry.with_suffix(f".{os.getpid()}")
    partial.write_text(json.dumps(index), encoding="utf-8")
    partial.replace(entry)
    return index


def shape_category(folder: Path) -> str:
    """PartNet's name of a shape's category, e.g. ``Chair``; raises AssetError."""
    path = folder / "meta.json"
    try:
        category = json.loads(path.read_text(encoding="utf-8"))["model_cat"]
    except KeyError:
        raise AssetError(f"{path}: key 'model_cat' is missing") from None
    except (OSError, ValueError, RecursionError, TypeError) as error:
        raise AssetError(f"{path}: not readable as a JSON object: {error}") from error
    if not isinstance(category, str):
        raise AssetError(f"{path}: key 'model_cat' is {category!r}, expected a name")
    return category


def folder_state(root: str) -> str:
    """Digest of the names in a folder of shapes: it changes when shapes come or go."""
    folder = Path(root).expanduser()
    if not root or not folder.is_dir():
        return ""
    names = tuple(sorted(entry.name for entry in os.scandir(folder)))
    return listing_digest("", names)


@cache
def listing_digest(root: str, names: tuple[str, ...]) -> str:
    """Digest of a folder's path and of the names in it."""
    return json_digest([root, names])
