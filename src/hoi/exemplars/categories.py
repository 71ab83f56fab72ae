"""Which categories have exemplars; importable without any heavy library."""

from __future__ import annotations

from pathlib import Path

from hoi.exemplars.config import ExemplarsConfig

# Categories with a procedural generator (and some with curated furniture).
KNOWN_CATEGORIES = (
    "chair",
    "stool",
    "table",
    "backpack",
    "suitcase",
    "keyboard",
    "display",
    "laptop",
    "mug",
    "bottle",
    "trashcan",
    "skateboard",
    "surfboard",
    "skis",
    "ball",
    "bicycle",
    "teddy",
)


def known_categories(config: ExemplarsConfig) -> tuple[str, ...]:
    """The categories `hoi.exemplars.build.build_library` can build with a configuration.

    With source ``folder`` these include every subfolder of the user's mesh folder, with a folder
    of PartNet or ShapeNet every category it has shapes of.
    """
    shipped = KNOWN_CATEGORIES if "procedural" in config.sources else ()
    if "furniture" in config.sources:
        shipped = tuple(dict.fromkeys((*shipped, "chair", "stool", "table")))
    if config.partnet:
        from hoi.exemplars.shape_index import partnet_nouns

        shipped = tuple(dict.fromkeys((*shipped, *partnet_nouns(config.partnet))))
    if config.shapenet:
        from hoi.exemplars.shapenet_layout import shapenet_nouns

        shipped = tuple(dict.fromkeys((*shipped, *shapenet_nouns(config.shapenet))))
    if "folder" not in config.sources or not Path(config.folder).is_dir():
        return shipped
    own = sorted(entry.name for entry in Path(config.folder).iterdir() if entry.is_dir())
    return tuple(dict.fromkeys((*shipped, *own)))


def doubtful_categories(config: ExemplarsConfig) -> frozenset[str]:
    """Known categories that may turn out to have no shape once all of them are read.

    Nouns that share a PartNet category with another one (stool with chair) and have no other
    source. A photo that names one asks for it; nobody else should.
    """
    if not config.partnet:
        return frozenset()
    from hoi.exemplars.shape_index import partnet_nouns, second_nouns

    sure = known_categories(config.model_copy(update={"partnet": ""}))
    return frozenset(second_nouns(partnet_nouns(config.partnet))) - frozenset(sure)
