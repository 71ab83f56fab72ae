"""What surfaces look like, and the scene they make up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Material:
    """Reflectance of a surface. A texture multiplies `rgb`.

    Args:
        rgb: linear reflectance 0..1.
        texture: index into the scene's textures, -1 for none.
        tile: metres that one repetition of the texture covers.
        gloss: strength of the highlight; `shine` its sharpness.
        folds: size of bumps, as of creased cloth.
        glow: radiance it gives off (windows, lamps).
    """

    rgb: Sequence[float]
    texture: int = -1
    tile: float = 1.0
    gloss: float = 0.0
    shine: float = 30.0
    folds: float = 0.0
    glow: float = 0.0


@dataclass(eq=False)
class Surface:
    """A mesh of the scene in world coordinates.

    Args:
        kind: person, object, support or room.
        texture_points: (V, 3) metres, where each vertex lies in the texture's space.
        face_materials: (F,) index into the scene's materials.
    """

    kind: str
    vertices: np.ndarray
    faces: np.ndarray
    texture_points: np.ndarray
    face_materials: np.ndarray


@dataclass(eq=False)
class Scene:
    """All surfaces, materials and textures of one picture, and its key light.

    Args:
        light: (3,) position of the key light; `light_radius` its size in metres.
        key, ambient: (3,) linear colour of the key light at 2 m, and of the room's light.
    """

    surfaces: list[Surface] = field(default_factory=list)
    materials: list[Material] = field(default_factory=list)
    textures: list[np.ndarray] = field(default_factory=list)
    light: np.ndarray = field(default_factory=lambda: np.array([0.0, 2.4, 0.0]))
    light_radius: float = 0.25
    key: np.ndarray = field(default_factory=lambda: np.ones(3))
    ambient: np.ndarray = field(default_factory=lambda: np.ones(3))

    def material(self, material: Material) -> int:
        """Register a material; its index."""
        self.materials.append(material)
        return len(self.materials) - 1

    def texture(self, picture: np.ndarray) -> int:
        """Register a texture; its index."""
        self.textures.append(picture)
        return len(self.textures) - 1

    def box(self, kind: str, size, centre, material: int, turn: np.ndarray | None = None) -> None:
        """Add a box with its sides along the axes, then turned about the origin."""
        size, centre = np.asarray(size, float), np.asarray(centre, float)
        local = _BOX_CORNERS * size
        vertices = local + centre
        if turn is not None:
            vertices = vertices @ turn.T
        materials = np.full(len(_BOX_FACES), material)
        self.surfaces.append(Surface(kind, vertices, _BOX_FACES, local + centre, materials))

    def panel(self, kind: str, centre, right, up, material: int, tile=None) -> None:
        """Add a rectangle from its centre and half axes (world); textured from its corner."""
        centre, right, up = (np.asarray(v, float) for v in (centre, right, up))
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
        vertices = centre + corners[:, :1] * right + corners[:, 1:] * up
        half = np.array([np.linalg.norm(right), np.linalg.norm(up)])
        flat = (corners + 1) * (half if tile is None else np.asarray(tile) / 2)
        # seen along its own z, so that box mapping picks x and y
        points = np.column_stack([flat[:, 0], flat[:, 1], np.zeros(4)])
        faces = np.array([[0, 1, 2], [0, 2, 3]])
        self.surfaces.append(Surface(kind, vertices, faces, points, np.full(2, material)))


_BOX_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
