"""Build the exemplar library of a category: candidates -> 20 representatives -> one file.

python -m hoi.exemplars.build chair stool --out results/exemplars
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hoi.errors import AssetError, ConfigError
from hoi.exemplars.categories import known_categories
from hoi.exemplars.config import ExemplarsConfig
from hoi.exemplars.library import Exemplar, library_path, load_library_file, save_library


def candidates(config: ExemplarsConfig, category: str) -> list[Exemplar]:
    """All candidates of a category from the configured `sources`.

    A source that does not know the category gives none. Raises ConfigError when no source has
    any, AssetError for a mesh that cannot be used.
    """
    pool = _listed_sources(config, category)
    if not pool:
        raise _no_candidates(config, category)
    return pool


def select(pool: Sequence[Exemplar], config: ExemplarsConfig) -> list[Exemplar]:
    """The representatives of a pool of candidates [paper 3.5].

    Raises AssetError when a candidate is not closed, unless the configuration asks for meshes
    that need not be: the sign of its distances would be noise.
    """
    from hoi.exemplars.selection import representatives

    features = _pool_distances(pool, config)
    chosen = representatives(features, config.k, config.seed, config.kmeans_restarts)
    return [pool[i] for i in chosen]


def build_library(
    config: ExemplarsConfig,
    out_dir: Path | str,
    category: str,
    cache: Path | None = None,
    workers: int = 1,
    own: Sequence[Path] = (),
) -> Path:
    """Write ``<out_dir>/<category>.npz``; the same config and shapes give the same bytes.

    `cache` and `workers` are for folders of shapes, see :mod:`hoi.exemplars.shapes`. The prepared
    meshes `own` are kept whatever is chosen beside them; a category that no source knows consists
    of them alone.
    """
    path = library_path(out_dir, category)
    chosen = [mesh for file in own for mesh in load_library_file(file)]
    if chosen and category not in known_categories(config):
        pass
    elif config.partnet or config.shapenet:
        chosen += _select_with_shapes(config, category, cache, workers)
    else:
        chosen += select(candidates(config, category), config)
    save_library(chosen, path)
    return path


def _select_with_shapes(
    config: ExemplarsConfig, category: str, cache: Path | None, workers: int
) -> list[Exemplar]:
    """The same selection over listed sources and folders of shapes; chosen shapes are re-meshed.

    A chosen shape that cannot be re-meshed is left out, and the rest is selected again.
    """
    from hoi.exemplars import shapes
    from hoi.exemplars.selection import representatives

    pool = _listed_sources(config, category)
    cache = cache or shapes.DEFAULT_CACHE
    refs = shapes.list_shapes(config, category, cache)
    found = shapes.read_shapes(refs, config, category, cache, workers)
    if not pool and not found:
        raise _no_candidates(config, category)
    features = [_pool_distances(pool, config)] if pool else []
    yaws: dict[str, float] = {}
    for source in ("partnet", "shapenet"):
        of_source = [shape for shape in found if shape.ref.source == source]
        if of_source:
            yaws[source] = shapes.yaw_of(config, of_source)
            features.append(shapes.features(of_source, yaws[source]))
    usable, table = list(range(len(pool) + len(found))), np.concatenate(features)
    ready: dict[int, Exemplar] = dict(enumerate(pool))
    while usable:
        rows = table if len(usable) == len(table) else table[usable]
        chosen = [
            usable[i] for i in representatives(rows, config.k, config.seed, config.kmeans_restarts)
        ]
        failed = False
        for i in chosen:
            if i in ready:
                continue
            ref = found[i - len(pool)].ref
            try:
                ready[i] = shapes.load_shape(config, ref, category, yaws[ref.source])
            except AssetError as error:
                print(f"left out: {error}", file=sys.stderr)
                usable.remove(i)
                failed = True
        if not failed:
            return [ready[i] for i in chosen]
    raise AssetError(f"none of the {len(found)} {category} shapes could be re-meshed")


def _listed_sources(config: ExemplarsConfig, category: str) -> list[Exemplar]:
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
    return pool


def _pool_distances(pool: Sequence[Exemplar], config: ExemplarsConfig) -> np.ndarray:
    """(N, grid^3) signed distances of meshes."""
    from hoi.exemplars.remesh import is_closed
    from hoi.exemplars.selection import signed_distances, soup_signed_distances

    closed = [is_closed(e.vertices, e.faces) for e in pool]
    if config.remesh == "watertight" and not all(closed):
        torn = [e.name for e, whole in zip(pool, closed, strict=True) if not whole]
        raise AssetError(f"these meshes are not watertight: {', '.join(torn)}")
    return np.stack(
        [
            (signed_distances if whole else soup_signed_distances)(e.vertices, e.faces, config.grid)
            for e, whole in zip(pool, closed, strict=True)
        ]
    )


def _no_candidates(config: ExemplarsConfig, category: str) -> ConfigError:
    asked = [*config.sources]
    asked += [f"exemplars.{k} = {v}" for k in ("partnet", "shapenet") if (v := getattr(config, k))]
    return ConfigError(
        f"no object of category {category!r} in the sources {', '.join(asked) or '(none)'}; "
        f"put meshes into <folder>/{category}/ and name the folder in exemplars.folder"
    )


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
    parser.add_argument("--partnet", help="folder of PartNet v0 or PartNet-Mobility shapes")
    parser.add_argument("--shapenet", help="folder of ShapeNetCore")
    parser.add_argument("--only-folders", action="store_true", help="no embedded candidates")
    parser.add_argument("--workers", type=int, default=1, help="processes that read shapes")
    parser.add_argument("--sheet", action="store_true", help="also draw <category>.png")
    options = parser.parse_args(arguments)
    sources = () if options.only_folders else ExemplarsConfig().sources
    config = ExemplarsConfig(
        sources=(*sources, "folder") if options.folder else sources,
        folder=options.folder or "",
        partnet=options.partnet or "",
        shapenet=options.shapenet or "",
    )
    for category in options.categories:
        path = build_library(config, options.out, category, workers=options.workers)
        print(path)
        if options.sheet:
            from hoi.exemplars.contact_sheet import contact_sheet

            contact_sheet(load_library_file(path), path.with_suffix(".png"))


if __name__ == "__main__":
    main()
