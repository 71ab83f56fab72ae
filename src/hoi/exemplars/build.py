"""Build the exemplar library of a category: candidates -> 20 representatives -> one file.

python -m hoi.exemplars.build chair stool --out results/exemplars
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hoi.errors import AssetError, ConfigError
from hoi.exemplars.config import ExemplarsConfig
from hoi.exemplars.library import Exemplar, library_path, save_library


def candidates(config: ExemplarsConfig, category: str) -> list[Exemplar]:
    """All candidates of a category from the configured sources.

    A source that does not know the category gives none. Raises ConfigError when no source has
    any, AssetError for a mesh that cannot be used.
    """
    pool: list[Exemplar] = []
    for source in config.sources:
        if source == "procedural":
            pool += _procedural(config, category)
        elif source == "furniture":
            from hoi.exemplars.furniture import load_furniture

            pool += load_furniture("exemplar_pool", category)
        else:
            from hoi.exemplars.own_meshes import load_own_meshes

            pool += load_own_meshes(config, category)
    if not pool:
        raise ConfigError(
            f"no object of category {category!r} in the sources {', '.join(config.sources)}; "
            f"put meshes into <folder>/{category}/ and name the folder in exemplars.folder"
        )
    return pool


def select(pool: Sequence[Exemplar], config: ExemplarsConfig) -> list[Exemplar]:
    """The representatives of a pool of candidates [paper 3.5]; every one watertight.

    Raises AssetError when a candidate is not closed: the sign of its distances would be noise.
    """
    from hoi.exemplars.remesh import is_closed
    from hoi.exemplars.selection import representatives, signed_distances

    open_meshes = [e.name for e in pool if not is_closed(e.vertices, e.faces)]
    if open_meshes:
        raise AssetError(f"these meshes are not watertight: {', '.join(open_meshes)}")
    features = np.stack([signed_distances(e.vertices, e.faces, config.grid) for e in pool])
    chosen = representatives(features, config.k, config.seed, config.kmeans_restarts)
    return [pool[i] for i in chosen]


def build_library(config: ExemplarsConfig, out_dir: Path | str, category: str) -> Path:
    """Write ``<out_dir>/<category>.npz``; the same config gives the same bytes."""
    path = library_path(out_dir, category)
    save_library(select(candidates(config, category), config), path)
    return path


def _procedural(config: ExemplarsConfig, category: str) -> list[Exemplar]:
    from hoi.exemplars.procedural import GENERATORS, generate

    if category not in GENERATORS:
        return []
    seeds = range(config.seed, config.seed + config.procedural_pool)
    return [generate(category, seed, config.vertices) for seed in seeds]


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line: build libraries with the default configuration."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("categories", nargs="+", help="object categories, e.g. chair stool")
    parser.add_argument("--out", type=Path, required=True, help="folder of the library files")
    parser.add_argument("--folder", help="folder of own meshes: <folder>/<category>/*")
    parser.add_argument("--sheet", action="store_true", help="also draw <category>.png")
    options = parser.parse_args(arguments)
    config = ExemplarsConfig()
    if options.folder:
        config = ExemplarsConfig(sources=(*config.sources, "folder"), folder=options.folder)
    for category in options.categories:
        path = build_library(config, options.out, category)
        print(path)
        if options.sheet:
            from hoi.exemplars.contact_sheet import contact_sheet
            from hoi.exemplars.library import load_library_file

            contact_sheet(load_library_file(path), path.with_suffix(".png"))


if __name__ == "__main__":
    main()
