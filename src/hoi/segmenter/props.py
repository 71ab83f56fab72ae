"""What stands in a training scene: meshes with materials that can be moved about."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from hoi.datasets.behave_mini import textures
from hoi.datasets.behave_mini.materials import Material, Scene, Surface
from hoi.exemplars.library import Exemplar
from hoi.segmenter.meshes import TexturedMesh
from hoi.segmenter.photos import free_photos

_FLAT = 0.0  # texture points of a mapped layer lie in one plane, which the renderer reads as u, v


@dataclass(frozen=True, eq=False)
class Layer:
    """Faces that share a way of being textured.

    Args:
        source: (N,) which vertex of the prop each point is.
        faces: (F, 3) into these points.
        points: (N, 3) where they lie in the texture's space.
        materials: (F,) index into the scene's materials.
    """

    source: np.ndarray
    faces: np.ndarray
    points: np.ndarray
    materials: np.ndarray


@dataclass(eq=False)
class Prop:
    """A movable thing; `vertices` (V, 3) in world metres."""

    name: str
    vertices: np.ndarray
    layers: list[Layer]

    @property
    def size(self) -> np.ndarray:
        return np.ptp(self.vertices, axis=0)

    @property
    def middle(self) -> np.ndarray:
        return (self.vertices.min(0) + self.vertices.max(0)) / 2

    def turn(self, rotation: np.ndarray) -> None:
        self.vertices = self.vertices @ rotation.T

    def move(self, offset) -> None:
        self.vertices = self.vertices + np.asarray(offset, float)

    def stand(self) -> None:
        """Put its lowest point on the floor."""
        self.vertices = self.vertices - [0.0, self.vertices[:, 1].min(), 0.0]

    def surfaces(self, kind: str) -> list[Surface]:
        return [
            Surface(kind, self.vertices[layer.source], layer.faces, layer.points, layer.materials)
            for layer in self.layers
        ]


class TextureBank:
    """Procedural textures drawn once; making one takes as long as rendering half a picture."""

    _MAKERS: tuple[Callable, ...] = (
        textures.wood, textures.wood, textures.cloth, textures.cloth, textures.striped,
        textures.plaster, textures.carpet, textures.tiles, textures.denim, textures.wallpaper,
        textures.painting, textures.books, textures.planks, textures.bricks,
    )  # fmt: skip

    def __init__(self, seed: int, count: int):
        rng = np.random.default_rng([seed, 1])
        self.pictures = [self._MAKERS[i % len(self._MAKERS)](rng) for i in range(count)]
        self.photos = [squared(photo) for photo in free_photos()]
        self.pictures += self.photos

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """One of them, in a colour of its own."""
        picture = self.pictures[int(rng.integers(len(self.pictures)))]
        if rng.random() < 0.6:
            shifted = cv2.cvtColor(picture, cv2.COLOR_RGB2HSV)
            shifted[..., 0] = (shifted[..., 0].astype(int) + int(rng.integers(180))) % 180
            picture = cv2.cvtColor(shifted, cv2.COLOR_HSV2RGB)
        return picture


class Looks:
    """The materials of one scene; `repainted` is the share of meshes that get new ones.

    Real rooms are not as colourful as chance: often the object, the furniture and the wall share
    their tones. A scene with a palette draws most of its colours near a few tones, which is where
    colour alone cannot tell an object from what is behind it.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        scene: Scene,
        bank: TextureBank,
        alike: float,
        repainted: float,
    ):
        self.scene, self.bank, self.repainted = scene, bank, repainted
        count = int(rng.integers(1, 4)) if rng.random() < alike else 0
        self.tones = [colour(rng) for _ in range(count)]

    def colour(self, rng: np.random.Generator) -> np.ndarray:
        """A linear reflectance (3,)."""
        if self.tones and rng.random() < 0.8:
            tone = self.tones[int(rng.integers(len(self.tones)))]
            return np.clip(tone * rng.uniform(0.6, 1.6) + rng.normal(0, 0.015, 3), 0.004, 1)
        return colour(rng)

    def texture(self, rng: np.random.Generator) -> int:
        """A texture of the bank, tinted where the scene has a palette; its number."""
        picture = self.bank.draw(rng)
        if self.tones and rng.random() < 0.8:
            grey = picture.astype(np.float32).mean(2, keepdims=True) / max(picture.mean(), 1.0)
            tone = 255 * self.colour(rng) ** (1 / 2.2)
            picture = np.clip(grey * tone, 0, 255).astype(np.uint8)
        return self.scene.texture(picture)

    def material(self, rng: np.random.Generator, textured: float) -> int:
        """A made-up material: plain, or with a texture projected onto it."""
        gloss = float(rng.choice([0.0, 0.0, 0.15, 0.4, 0.7]))
        shine = rng.uniform(12, 70)
        if rng.random() >= textured:
            tone = tuple(self.colour(rng))
            return self.scene.material(Material(tone, gloss=gloss, shine=shine))
        tint = (1.0, 1.0, 1.0) if rng.random() < 0.6 else tuple(0.4 + 0.6 * self.colour(rng))
        picture = self.texture(rng)
        folds = rng.uniform(0.1, 0.5) if rng.random() < 0.25 else 0.0
        tile = rng.uniform(0.1, 1.0)
        made = Material(tint, picture, tile, gloss=gloss, shine=shine, folds=folds)
        return self.scene.material(made)


def colour(rng: np.random.Generator) -> np.ndarray:
    """A linear reflectance: nearly grey about half of the time."""
    if rng.random() < 0.45:
        tone = np.clip(rng.uniform(0.08, 0.97) + rng.normal(0, 0.03, 3), 0.02, 1)
    else:
        tone = np.array(colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.2, 1), rng.uniform(0.1, 1)))
    return tone**2.2


def prop_of_exemplar(rng: np.random.Generator, looks: Looks, exemplar: Exemplar) -> Prop:
    """A generated object: one material a part, sometimes one for all."""
    one = looks.material(rng, 0.55) if rng.random() < 0.3 else None
    parts = [one if one is not None else looks.material(rng, 0.5) for _ in exemplar.part_names]
    vertices = exemplar.vertices.astype(np.float64)
    layer = Layer(
        np.arange(len(vertices)), exemplar.faces, vertices, np.array(parts)[exemplar.face_parts]
    )
    return Prop(exemplar.name, vertices, [layer])


def prop_of_mesh(rng: np.random.Generator, looks: Looks, mesh: TexturedMesh) -> Prop:
    """A mesh as it is, repainted, or partly covered in other textures; people as they are."""
    repaint = rng.random()
    vertices = mesh.vertices.astype(np.float64)
    if mesh.person:
        vertices = vertices * rng.uniform(0.93, 1.06)
    elif rng.random() < 0.5:
        vertices = vertices * rng.uniform(0.85, 1.15, 3)
    used = np.unique(mesh.face_materials)
    pictures: dict[int, int] = {}
    numbers = np.full(len(mesh.colours), -1)
    projected = np.zeros(len(mesh.colours), bool)
    for index in used:
        texture = int(mesh.texture_of[index])
        some = looks.repainted / 2 <= repaint < looks.repainted and rng.random() < 0.6
        if not mesh.person and (repaint < looks.repainted / 2 or some):
            projected[index] = True
            numbers[index] = looks.material(rng, 0.0 if repaint < looks.repainted / 6 else 0.75)
            continue
        gloss = float(mesh.glosses[index]) * 0.6
        if not mesh.person and rng.random() < 0.2:
            gloss = rng.uniform(0, 0.7)
        tone = mesh.colours[index] if texture < 0 else np.clip(mesh.colours[index] + 0.3, 0, 1)
        if looks.tones and texture < 0 and not mesh.person:
            tone = looks.colour(rng)
        if texture >= 0 and texture not in pictures:
            pictures[texture] = looks.scene.texture(squared(mesh.textures[texture]))
        picture = pictures.get(texture, -1)
        numbers[index] = looks.scene.material(Material(tuple(tone), picture, 1.0, gloss, 30.0))
    flat = ~mesh.mapped | projected[mesh.face_materials]
    layers = []
    if flat.any():
        faces = mesh.faces[flat]
        source, where = np.unique(faces, return_inverse=True)
        layers.append(
            Layer(source, where.reshape(-1, 3), vertices[source],
                  numbers[mesh.face_materials[flat]])
        )  # fmt: skip
    if not flat.all():
        layers.append(_mapped_layer(mesh, ~flat, numbers))
    return Prop(mesh.title, vertices, layers)


def _mapped_layer(mesh: TexturedMesh, chosen: np.ndarray, numbers: np.ndarray) -> Layer:
    """Corners with equal vertex and equal texture coordinates stay one point: smooth shading."""
    corners = mesh.faces[chosen].reshape(-1).astype(np.int64)
    uv = mesh.uv[chosen].reshape(-1, 2)
    grid = np.round((uv - np.floor(uv)) * 4095).astype(np.int64)
    keys = (corners << 24) | (grid[:, 0] << 12) | grid[:, 1]
    _, first, where = np.unique(keys, return_index=True, return_inverse=True)
    points = np.column_stack([uv[first], np.full(len(first), _FLAT)])
    return Layer(corners[first], where.reshape(-1, 3), points, numbers[mesh.face_materials[chosen]])


def squared(picture: np.ndarray) -> np.ndarray:
    """A picture in the size that the renderer wants."""
    return cv2.resize(picture, (textures.SIZE, textures.SIZE), interpolation=cv2.INTER_LINEAR)
