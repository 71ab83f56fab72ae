"""The objects of the data set: which mesh a sequence shows, and where hands can hold it."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from hoi.datasets.behave_layout import CATEGORIES, parse_sequence
from hoi.datasets.behave_mini.plan import split_of
from hoi.datasets.behave_mini.seeding import generator
from hoi.errors import AssetError
from hoi.exemplars import Exemplar

_SAMPLES = 4000
_FURNITURE_SPLIT: dict[str, Literal["test", "tuning"]] = {"test": "test", "tune": "tuning"}


class Surface(NamedTuple):
    """Points (N, 3) on a surface and their outward unit normals (N, 3)."""

    points: np.ndarray
    normals: np.ndarray

    def where(self, chosen: np.ndarray) -> Surface:
        return Surface(self.points[chosen], self.normals[chosen])

    def moved(self, rotation: np.ndarray, translation: np.ndarray | float = 0.0) -> Surface:
        return Surface(self.points @ rotation.T + translation, self.normals @ rotation.T)

    def furthest(self, toward, near=None, pull: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Point and normal furthest along `toward`, and across it within reach of `near`.

        Args:
            near: (3,) a place; distance to it across `toward` costs `pull` per metre.
        """
        toward = np.asarray(toward, float)
        score = self.points @ toward
        if near is not None:
            away = self.points - near
            away = away - (away @ toward)[:, None] * toward
            score = score - pull * np.linalg.norm(away, axis=1)
        best = int(np.argmax(score))
        return self.points[best], self.normals[best]


@dataclass(frozen=True, eq=False)
class Thing:
    """One object in its canonical frame (y up, front +z, bounding box centred, metres)."""

    mesh: Exemplar

    @property
    def vertices(self) -> np.ndarray:
        return self.mesh.vertices.astype(np.float64)

    @property
    def faces(self) -> np.ndarray:
        return self.mesh.faces

    @property
    def size(self) -> np.ndarray:
        return self.mesh.size.astype(np.float64)

    @cached_property
    def _sampled(self) -> tuple[Surface, np.ndarray]:
        random = np.random.default_rng(0)
        corners = self.vertices[self.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(cross, axis=1)
        face = random.choice(len(area), size=_SAMPLES, p=area / area.sum())
        u, v = random.random((2, _SAMPLES, 1))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        a, b, c = corners[face].transpose(1, 0, 2)
        return (
            Surface(a + u * (b - a) + v * (c - a), cross[face] / area[face, None]),
            self.mesh.face_parts[face],
        )

    @property
    def surface(self) -> Surface:
        """Points spread evenly over the whole object."""
        return self._sampled[0]

    def part(self, *names: str) -> Surface:
        """The points of the named parts (possibly none)."""
        surface, labels = self._sampled
        wanted = [i for i, name in enumerate(self.mesh.part_names) if name in names]
        return surface.where(np.isin(labels, wanted))

    def has(self, name: str) -> bool:
        return len(self.part(name).points) > 20


def thing_of(seed: int, sequence: str) -> Thing:
    """The object of one sequence. Several meshes may stand for one name."""
    object_name = parse_sequence(sequence)[2]
    pool = object_pool(object_name, split_of(sequence))
    return pool[int(generator(seed, "object", sequence).integers(len(pool)))]


@functools.cache
def object_pool(object_name: str, split: str) -> tuple[Thing, ...]:
    """Meshes that may stand for an object in a split; splits and object names share none."""
    from hoi.exemplars.furniture import furniture_models, load_furniture

    role, role_split = "ground_truth", _FURNITURE_SPLIT[split]
    names = {
        model.name
        for model in furniture_models()
        if (model.role, model.split, model.object_name) == (role, role_split, object_name)
    }
    meshes = load_furniture(role, CATEGORIES[object_name], role_split)
    pool = tuple(Thing(mesh) for mesh in meshes if mesh.name in names)
    if not pool:
        raise AssetError(f"the furniture has no ground-truth mesh for {object_name}, {split}")
    return pool
