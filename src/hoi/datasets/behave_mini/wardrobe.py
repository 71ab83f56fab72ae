"""How the person looks: skin, hair, face and clothes, painted on the unposed body.

Zones are decided per pixel from where its skin lies on the unposed body (T-pose), so their seams
are sharp whatever the mesh resolution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoi.body.keypoints import KEYPOINT
from hoi.body.skeleton import JOINT
from hoi.datasets.behave_mini import textures
from hoi.datasets.behave_mini.materials import Material, Scene
from hoi.datasets.behave_mini.person import Person, Pose


@dataclass(frozen=True, eq=False)
class Wardrobe:
    """Material indices and the lines (metres on the unposed body) that separate them."""

    skin: int
    hair: int
    shirt: int
    trousers: int
    shoes: int
    sole: int
    white: int
    dark: int
    lips: int
    sleeve: float  # |x| where the sleeve ends
    waist: float
    hem: float
    ankle: float
    collar: float
    hair_back: float
    hair_front: float
    head: np.ndarray  # (3,) head joint
    eyes: np.ndarray  # (2, 3)
    nose: np.ndarray
    floor: float

    def materials_at(self, points: np.ndarray) -> np.ndarray:
        """(N,) material of points (N, 3) on the unposed body."""
        x, y, z = points.T
        side = np.abs(x)
        wave = 0.008 * np.sin(60 * x + 20 * z) + 0.006 * np.sin(130 * x - 50 * z)
        trunk = (y > self.waist) & (side < self.sleeve) & (y < self.collar + 0.25 * side)
        low = y <= self.waist
        result = np.full(len(points), self.skin)
        result[trunk] = self.shirt
        result[low & (y > self.hem)] = self.trousers
        result[y < self.ankle] = self.shoes
        result[y < self.floor + 0.006] = self.sole
        on_head = (y > self.head[1] - 0.03) & (side < 0.14)
        behind = z < self.head[2] + 0.005
        line = np.where(behind, self.hair_back, self.hair_front) + wave
        line = np.where(behind & (z > self.head[2] - 0.045), self.hair_back + 0.045, line)
        result[on_head & (y > line)] = self.hair
        long_hair = behind & (side < 0.09) & (y > self.hair_back + wave) & (y > self.collar + 0.02)
        result[long_hair & (z < self.head[2] - 0.04)] = self.hair
        self._paint_face(points, result)
        return result

    def _paint_face(self, points: np.ndarray, result: np.ndarray) -> None:
        x, y, z = points.T
        front = (z > self.head[2] + 0.03) & (y > self.head[1] - 0.06) & (np.abs(x) < 0.08)
        for eye in self.eyes:
            across, above = (x - eye[0]) / 0.014, (y - eye[1]) / 0.0065
            result[front & (across**2 + above**2 < 1)] = self.white
            result[front & (np.hypot(x - eye[0], y - eye[1]) < 0.0062)] = self.dark
            brow = np.abs(y - eye[1] - 0.021 + 6 * (x - eye[0]) ** 2) < 0.0032
            result[front & brow & (np.abs(x - eye[0]) < 0.02)] = self.hair
        mouth_y = self.nose[1] - 0.042
        result[front & ((x / 0.024) ** 2 + ((y - mouth_y) / 0.0075) ** 2 < 1)] = self.lips


def dress(rng: np.random.Generator, person: Person, scene: Scene) -> Wardrobe:
    """Choose clothes for a person and register their materials."""
    joints = person.rest_joints

    def cloth(picture: np.ndarray, tile: float, folds: float) -> int:
        return scene.material(Material((1, 1, 1), scene.texture(picture), tile, folds=folds))

    tone = np.array([0.66, 0.41, 0.29]) ** rng.uniform(0.75, 2.2)
    skin_grain = textures.plaster(rng, np.array([250, 246, 242]))
    skin = scene.material(Material(tuple(tone), scene.texture(skin_grain), 0.3, 0.12, 18, 0.06))
    hair_tone = tuple(np.array([0.30, 0.19, 0.10]) * rng.uniform(0.08, 1.6))
    shirt_picture = rng.choice([0, 0, 0, 1])
    shirt = textures.striped(rng) if shirt_picture else textures.cloth(rng)
    trousers = (
        textures.denim(rng)
        if rng.random() < 0.5
        else textures.cloth(rng, textures.hsv(rng, saturation=(0.0, 0.35), value=(0.08, 0.6)))
    )
    shoes = textures.hsv(rng, saturation=(0.0, 0.35), value=(0.04, 0.8)) / 255
    shoulder, elbow, wrist = (joints[JOINT[f"left_{n}"]] for n in ("shoulder", "elbow", "wrist"))
    sleeve = rng.choice([shoulder[0] + 0.55 * (elbow[0] - shoulder[0]), wrist[0] - 0.015,
                         elbow[0] + 0.05], p=[0.45, 0.45, 0.1])  # fmt: skip
    knee, ankle = joints[JOINT["left_knee"]], joints[JOINT["left_ankle"]]
    points = person.keypoints(Pose(joints[0], np.zeros((24, 3))))
    head, floor = joints[JOINT["head"]], person.rest_vertices[:, 1].min()
    eyes = points[[KEYPOINT["left_eye"], KEYPOINT["right_eye"]]]
    return Wardrobe(
        skin=skin,
        hair=scene.material(Material(hair_tone, scene.texture(textures.wood(
            rng, np.array([200, 200, 200]))), 0.12, 0.25, 12, 0.35)),
        shirt=cloth(shirt, rng.uniform(0.25, 0.6), 0.55),
        trousers=cloth(trousers, rng.uniform(0.2, 0.4), 0.45),
        shoes=scene.material(Material(tuple(shoes**2.2), gloss=0.15)),
        sole=scene.material(Material((0.75, 0.75, 0.72) if rng.random() < 0.5 else (0.04,) * 3)),
        white=scene.material(Material((0.72, 0.70, 0.68), gloss=0.3)),
        dark=scene.material(Material((0.03, 0.02, 0.015), gloss=0.5)),
        lips=scene.material(Material((tone[0] * 0.85, tone[1] * 0.55, tone[2] * 0.55), gloss=0.1)),
        sleeve=float(sleeve),
        waist=float(joints[JOINT["pelvis"]][1] + rng.uniform(-0.02, 0.08)),
        hem=float(ankle[1] + 0.03 if rng.random() < 0.8 else knee[1] + rng.uniform(-0.1, 0.08)),
        ankle=float(ankle[1] + rng.uniform(0.0, 0.05)),
        collar=float(joints[JOINT["neck"]][1] - rng.uniform(-0.01, 0.04)),
        hair_back=float(head[1] + rng.choice([0.0, -0.04, -0.16]) + rng.uniform(-0.01, 0.02)),
        hair_front=float(eyes[:, 1].mean() + rng.uniform(0.045, 0.07)),
        head=head,
        eyes=eyes,
        nose=points[KEYPOINT["nose"]],
        floor=float(floor),
    )  # fmt: skip


def decorate(rng: np.random.Generator, object_name: str, part_names, scene: Scene) -> np.ndarray:
    """Material index for each part of an object, in the manner its name suggests."""
    wooden = scene.material(
        Material((1, 1, 1), scene.texture(textures.wood(rng)), rng.uniform(0.4, 0.9), 0.12, 25)
    )
    grey = rng.uniform(0.015, 0.09)
    black = scene.material(Material((grey,) * 3, gloss=0.2, shine=20))
    metal = scene.material(Material((rng.uniform(0.2, 0.5),) * 3, gloss=0.6, shine=60))
    light = scene.material(Material((rng.uniform(0.6, 0.85),) * 3, gloss=0.15))

    def cloth(value) -> int:
        tone = textures.hsv(rng, saturation=(0.1, 0.85), value=value)
        picture = scene.texture(textures.cloth(rng, tone))
        return scene.material(Material((1, 1, 1), picture, 0.25, folds=0.2))

    def plastic(value) -> int:
        tone = (textures.hsv(rng, saturation=(0.2, 0.9), value=value) / 255) ** 2.2
        return scene.material(Material(tuple(tone), gloss=0.35, shine=35))

    frame = metal if rng.random() < 0.5 else black
    seat = cloth((0.12, 0.3)) if rng.random() < 0.6 else black
    tables = light if rng.random() < 0.35 else wooden
    looks = {
        "chairblack": {"chair_seat": seat, "chair_back": seat, "chair_head": seat, "": frame},
        "chairwood": {
            "chair_seat": cloth((0.3, 0.8)) if rng.random() < 0.35 else wooden,
            "": wooden,
        },
        "stool": {"": wooden if rng.random() < 0.6 else plastic((0.4, 0.95))},
        "tablesmall": {"tabletop": tables, "": tables if rng.random() < 0.6 else metal},
        "tablesquare": {"tabletop": tables, "": tables if rng.random() < 0.6 else black},
        "keyboard": {"key": light if rng.random() < 0.4 else black, "": black},
        "backpack": {"bag_body": cloth((0.2, 0.8)), "": black},
        "suitcase": {"bag_body": plastic((0.2, 0.8)), "": metal, "wheel": black},
    }[object_name]
    if object_name == "keyboard" and rng.random() < 0.4:
        looks = {"key": light, "": metal}
    return np.array([looks.get(name, looks[""]) for name in part_names])
