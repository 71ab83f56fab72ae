"""Compose a training scene: an object that a person uses, clutter, other people, a place.

Nothing here is physically exact, on purpose: the network should learn what belongs to an object,
not how people usually hold one. World axes: y up, the floor is y = 0, metres.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hoi.body import BodyModel
from hoi.body.skeleton import JOINT
from hoi.datasets.behave_mini import textures
from hoi.datasets.behave_mini.camera import Camera
from hoi.datasets.behave_mini.materials import Material, Scene
from hoi.datasets.behave_mini.person import Person, Pose
from hoi.datasets.behave_mini.room import build_room
from hoi.datasets.behave_mini.wardrobe import Wardrobe, dress
from hoi.detect.backends import Box
from hoi.exemplars.procedural import generate
from hoi.segmenter.config import SceneConfig
from hoi.segmenter.gear import KINDS, SWUNG, generate_gear
from hoi.segmenter.meshes import MeshEntry, MeshStore
from hoi.segmenter.props import Layer, Looks, Prop, TextureBank, prop_of_exemplar, prop_of_mesh

_SEATS = r"chair|stool|bench|sofa|couch|seat"
_TABLES = r"table|desk"
_RIDES = r"bicycle|bike|scooter|skate|motor"
_BAGS = r"bag|case|box|basket|ball|laptop|keyboard|guitar|lamp|vase|monitor|printer|radio"
_GENERATED = {
    "seat": ("chair", "chair", "chair", "stool"),
    "stand": ("table", "table", "trashcan", "display", "suitcase"),
    "ride": (
        "bicycle", "bicycle", "motorcycle", "motorcycle", "skateboard", "skateboard", "surfboard",
        "skis", "board",
    ),
    "swing": SWUNG,
    "hold": (
        "backpack", "backpack", "suitcase", "suitcase", "keyboard", "keyboard", "ball",
        "laptop", "display", "bottle", "mug", "teddy", "skateboard", "trashcan", "chair", "stool",
        "table", "surfboard", "box", "box", "box", "large_ball", "frisbee",
    ),
}  # fmt: skip
_USES = ("seat", "stand", "ride", "swing", "any", "hold")
_SHARES = (0.28, 0.15, 0.15, 0.09, 0.05, 0.28)
_IN_MOTION = ("ride", "swing")
_OUTSIDE = 0.7  # of the pictures of those
_SOFT_SEATS = r"sofa|couch|armchair|ottoman"  # large and of one piece: easy, and many
_FEW = 3  # meshes of a kind; fewer would be shown again and again
_HELD_OUT_SEEDS = 100_000  # generated objects of validation are drawn from here on


@dataclass(frozen=True)
class Instance:
    """One thing in the picture.

    `number` is its value in the map of instances (0: none), `kind` one of main, person, clutter and
    bystander; `detected` are boxes that a detector drew around it, whatever it took it for.
    """

    number: int
    kind: str
    name: str
    detected: tuple[Box, ...] = ()


@dataclass(frozen=True, eq=False)
class Staged:
    """A scene ready to be rendered; `owner[i]` is the instance that surface i belongs to."""

    scene: Scene
    camera: Camera
    wardrobe: Wardrobe | None
    owner: np.ndarray
    instances: list[Instance]


@dataclass(eq=False)
class _Figure:
    """A person in the scene; hands and back (3,) are known of our own body only."""

    prop: Prop
    body: bool
    hands: list[np.ndarray]
    back: np.ndarray | None
    facing: np.ndarray


class Composer:
    """Draws scenes from a set of meshes, poses and shapes.

    Args:
        config: what scenes hold.
        store: textured meshes.
        held_out: use those kept for validation, and bodies and generated objects of their own.
        body_model, pose_database: files of the package.
        seed: of the procedural textures.
    """

    def __init__(
        self,
        config: SceneConfig,
        store: MeshStore,
        held_out: bool,
        body_model: Path,
        pose_database: Path,
        seed: int,
    ):
        self.config, self.store, self.held_out = config, store, held_out
        self.model = BodyModel.load(body_model)
        self.bank = TextureBank(seed + held_out, config.textures)
        entries = store.split(held_out)
        self.people = [e for e in entries if e.person and "lying" not in e.title.lower()]
        self.things = [entry for entry in entries if not entry.person and _usable(entry)]
        with np.load(pose_database, allow_pickle=False) as poses:
            seated = np.array(["sit" in str(name) for name in poses["pose_ids"]])
            rotations, up = poses["body_pose"], poses["pelvis_up"]
        # validation and training share no pose: every eighth is kept
        mine = (np.arange(len(seated)) % 8 == 0) == held_out
        self.poses = {
            True: (rotations[mine & seated], up[mine & seated]),
            False: (rotations[mine & ~seated], up[mine & ~seated]),
        }

    def __call__(self, rng: np.random.Generator) -> Staged:
        """A scene; its main object may turn out to be hidden."""
        scene = Scene()
        looks = Looks(rng, scene, self.bank, self.config.alike_share, self.config.repainted_share)
        use = str(rng.choice(_USES, p=_SHARES))
        main = self._main(rng, looks, use)
        main.turn(_turn_y(rng.uniform(0, 2 * np.pi)))
        main.stand()
        main.move([-main.middle[0], 0, -main.middle[2]])
        figure, wardrobe = None, None
        if rng.random() < self.config.person_share:
            figure, wardrobe = self._person(rng, looks, use, main)
        items: list[tuple[str, Prop]] = [("main", main)]
        if figure is not None:
            items.append(("person", figure.prop))
        clutter = self._clutter(rng, looks, main, items)
        bystanders = self._bystanders(rng, looks, items)
        camera = self._camera(rng, main, items, figure)
        items += [
            item for item in clutter + bystanders if _out_of_the_way(rng, item[1], camera, main)
        ]
        worn = figure is not None and figure.body
        instances = []
        owner: list[int] = []
        for number, (kind, prop) in enumerate(items, start=1):
            shown = prop.surfaces("person" if worn and kind == "person" else "object")
            scene.surfaces += shown
            owner += [number] * len(shown)
            instances.append(Instance(number, kind, prop.name))
        outside = _OUTSIDE if use in _IN_MOTION else self.config.outdoors_share
        if rng.random() < outside:
            self._outdoors(rng, looks, camera, main)
        else:
            around = np.concatenate([prop.vertices[::7] for _, prop in items])
            near = np.linalg.norm(around - main.middle, axis=1) < 3.0
            build_room(rng, rng, scene, camera, around[near] if near.any() else around)
            self._repaint_room(rng, looks, len(owner))
        owner += [0] * (len(scene.surfaces) - len(owner))
        return Staged(scene, camera, wardrobe, np.array(owner), instances)

    # ------------------------------------------------------------------------------ objects

    def _main(self, rng: np.random.Generator, looks: Looks, use: str) -> Prop:
        if use == "swing" or (use in _GENERATED and rng.random() < self.config.generated_share):
            return self._generated(rng, looks, str(rng.choice(_GENERATED[use])))
        patterns = {"seat": _SEATS, "ride": _RIDES}
        if use == "seat" and rng.random() < 0.6:
            patterns["seat"] = rf"^(?!.*({_SOFT_SEATS})).*({_SEATS})"
        if use == "stand" and rng.random() < 0.6:
            patterns["stand"] = _TABLES
        if use == "hold" and rng.random() < 0.4:
            patterns["hold"] = _BAGS
        limits = {"stand": (0.35, 2.4), "hold": (0.07, 0.8)}.get(use, (0.07, 2.6))
        return self._listed(rng, looks, patterns.get(use, ""), limits)

    def _listed(
        self, rng: np.random.Generator, looks: Looks, pattern: str, limits: tuple[float, float]
    ) -> Prop:
        """A mesh whose title and size fit; of any title where hardly one does."""
        low, high = limits
        fitting = [entry for entry in self.things if low < max(entry.size) < high]
        named = [entry for entry in fitting if re.search(pattern, entry.title, re.IGNORECASE)]
        choice = named if len(named) >= _FEW else fitting or self.things
        mesh = self.store.load(choice[int(rng.integers(len(choice)))])
        return prop_of_mesh(rng, looks, mesh)

    def _generated(self, rng: np.random.Generator, looks: Looks, category: str) -> Prop:
        if category == "box":
            return self._carton(rng, looks)
        number = int(rng.integers(_HELD_OUT_SEEDS)) + self.held_out * _HELD_OUT_SEEDS
        large = category == "large_ball"
        if category in KINDS:
            exemplar = generate_gear(category, number)
        else:
            exemplar = generate("ball" if large else category, number)
        prop = prop_of_exemplar(rng, looks, exemplar)
        stretch = rng.uniform(0.85, 1.15, 3)
        if "ball" in category:
            stretch = np.full(3, rng.uniform(0.22, 0.37) / prop.size[0] * 2 if large else 1.0)
        prop.vertices = prop.vertices * stretch
        return prop

    def _carton(self, rng: np.random.Generator, looks: Looks) -> Prop:
        """A box, which may have flaps, tape or a label of another colour."""
        size = rng.uniform(0.12, 0.6) * rng.uniform(0.45, 1.0, 3)
        half = size / 2
        corners = (
            np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) * half
        )
        faces = np.array(
            [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
             [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
        )  # fmt: skip
        body = looks.material(rng, 0.4)
        if rng.random() < 0.5:  # cardboard
            tone = (textures.hsv(rng, (0.05, 0.12), (0.2, 0.55), (0.4, 0.85)) / 255) ** 2.2
            body = looks.scene.material(Material(tuple(tone)))
        numbers = np.full(12, body)
        if rng.random() < 0.6:
            numbers[6:8] = looks.material(rng, 0.3)
        layers = [Layer(np.arange(8), faces, corners, numbers)]
        vertices = corners
        if rng.random() < 0.5:  # a strip of tape or a label, just above a side
            strip, up = rng.uniform(0.05, 0.5), int(rng.choice([0, 1, 2]))
            across = [axis for axis in range(3) if axis != up]
            label = np.zeros((4, 3))
            label[:, across[0]] = np.array([-1, 1, 1, -1]) * half[across[0]] * rng.uniform(0.3, 1)
            label[:, across[1]] = np.array([-1, -1, 1, 1]) * half[across[1]] * strip
            label[:, up] = (half[up] + 0.002) * rng.choice([-1, 1])
            vertices = np.vstack([corners, label])
            paper = looks.material(rng, 0.5)
            layers.append(Layer(np.arange(8, 12), np.array([[0, 1, 2], [0, 2, 3]]), label,
                                np.full(2, paper)))  # fmt: skip
        return Prop("box", vertices, layers)

    def _clutter(self, rng, looks: Looks, main: Prop, items) -> list[tuple[str, Prop]]:
        """Things around the pair, and things that lie on the main object."""
        points = np.concatenate([prop.vertices for _, prop in items])
        middle = (points.min(0) + points.max(0)) / 2
        found = []
        for _ in range(int(rng.integers(*self.config.clutter))):
            prop = self._some_thing(rng, looks, (0.07, 2.4))
            prop.turn(_turn_y(rng.uniform(0, 2 * np.pi)))
            prop.stand()
            reach, angle = 0.3 + 2.7 * rng.random() ** 1.5, rng.uniform(0, 2 * np.pi)
            raised = 0.0 if rng.random() < 0.85 else rng.uniform(0.3, 1.6)
            prop.move([middle[0], 0, middle[2]] - prop.middle * [1, 0, 1])
            prop.move([reach * np.cos(angle), raised, reach * np.sin(angle)])
            found.append(("clutter", prop))
        if rng.random() < 0.3:
            for _ in range(int(rng.integers(1, 4))):
                prop = self._some_thing(rng, looks, (0.07, 0.5))
                prop.turn(_turn_y(rng.uniform(0, 2 * np.pi)))
                prop.stand()
                spot = main.middle + rng.normal(0, 0.22, 3) * main.size
                prop.move([spot[0], main.vertices[:, 1].max(), spot[2]] - prop.middle * [1, 0, 1])
                found.append(("clutter", prop))
        return found

    def _some_thing(self, rng, looks: Looks, limits: tuple[float, float]) -> Prop:
        if rng.random() < 0.2:
            return self._generated(rng, looks, str(rng.choice(_GENERATED["hold"])))
        return self._listed(rng, looks, "", limits)

    # ------------------------------------------------------------------------------- people

    def _person(
        self, rng: np.random.Generator, looks: Looks, use: str, main: Prop
    ) -> tuple[_Figure, Wardrobe | None]:
        """A person who uses the main object, which is moved to the hands where it is held."""
        mounted = use == "ride" and rng.random() < 0.85
        astride = mounted and not _flat(main)
        seated = rng.random() < (0.55 if use == "seat" else 0.8 if astride else 0.0)
        facing = _heading(rng, main) if astride else rng.uniform(0, 2 * np.pi)
        scanned = self.people and rng.random() < self.config.scanned_share
        if scanned:
            figure, wardrobe = self._scanned(rng, looks, seated, facing), None
        else:
            spread = 0.18 if use in _IN_MOTION else 0.07
            figure, wardrobe = self._posed(rng, looks, seated or rng.random() < 0.1, facing, spread)
        figure.prop.stand()
        if mounted:
            _mount(rng, figure, main, seated)
        elif use == "swing":
            _swing(rng, figure, main)
        elif seated:
            level = _seat_level(main)
            lift = level + 0.09 - _pelvis_height(figure) if figure.body else 0.0
            if not figure.body and figure.prop.size[1] < 1.15:
                lift = level
            figure_offset = [rng.normal(0, 0.06), lift + rng.normal(0, 0.02), rng.normal(0, 0.06)]
            _centre_on(figure, main, figure_offset)
        elif use in ("hold", "any") and max(main.size) < 1.3 and rng.random() < 0.75:
            self._put_into_hands(rng, main, figure)
        else:
            _stand_beside(rng, figure, main)
        return figure, wardrobe

    def _scanned(self, rng, looks: Looks, seated: bool, facing: float) -> _Figure:
        sitting = [entry for entry in self.people if "sit" in entry.title.lower()]
        choice = sitting if seated and sitting else self.people
        mesh = self.store.load(choice[int(rng.integers(len(choice)))])
        prop = prop_of_mesh(rng, looks, mesh)
        prop.turn(_turn_y(facing))
        return _Figure(prop, False, [], None, np.array([np.sin(facing), 0, np.cos(facing)]))

    def _posed(
        self, rng, looks: Looks, seated: bool, facing: float, spread: float
    ) -> tuple[_Figure, Wardrobe]:
        """Our own body, dressed, in a pose of the database but for `spread` radians a joint."""
        betas = np.clip(rng.normal(0, 0.9, self.model.num_betas), -2.2, 2.2).astype(np.float32)
        person = Person(self.model, betas)
        rotations, up = self.poses[seated]
        chosen = int(rng.integers(len(rotations)))
        pose = np.zeros((24, 3))
        pose[1:] = rotations[chosen].reshape(23, 3) + rng.normal(0, spread, (23, 3))
        upright = Rotation.align_vectors([[0, 1, 0]], [up[chosen]])[0]
        heading = Rotation.from_rotvec([0, facing, 0]) * upright
        pose[0] = heading.as_rotvec()
        vertices, joints = person.skin(Pose(np.zeros(3), pose))
        drop = np.array([0, vertices[:, 1].min(), 0])
        vertices, joints = vertices - drop, joints - drop
        wardrobe = dress(rng, person, looks.scene)
        faces = person.faces
        layer = Layer(
            np.arange(len(vertices)), faces, person.rest_vertices,
            np.full(len(faces), wardrobe.skin),
        )  # fmt: skip
        front = heading.apply([0, 0, 1])
        chest = joints[JOINT["spine3"]]
        hands = [joints[JOINT[f"{side}_hand"]] for side in ("left", "right")]
        figure = _Figure(Prop("body", vertices, [layer]), True, hands, chest, front)
        return figure, wardrobe

    def _put_into_hands(self, rng: np.random.Generator, main: Prop, figure: _Figure) -> None:
        """Move the object to a hand, between both hands, before the body, or onto the back."""
        if rng.random() < 0.45:
            main.turn(Rotation.random(rng=rng).as_matrix())
        height = figure.prop.size[1]
        draw = rng.random()
        depth = max(main.size[0], main.size[2]) / 2
        if figure.back is not None and draw < 0.2:
            place = figure.back - figure.facing * (0.1 + depth * 0.9) + [0, -0.05, 0]
        elif figure.hands and draw < 0.85:
            left, right = figure.hands
            place = (left + right) / 2 if rng.random() < 0.5 else figure.hands[rng.integers(2)]
            place = place + figure.facing * depth * rng.uniform(0, 0.7) + rng.normal(0, 0.05, 3)
        else:
            ahead = rng.choice([-1, 1], p=[0.2, 0.8]) * (0.14 + depth * rng.uniform(0.5, 1))
            place = figure.prop.middle * [1, 0, 1] + figure.facing * ahead
            place = place + [rng.normal(0, 0.15), height * rng.uniform(0.25, 0.95), 0]
        main.move(place - main.middle)
        below = main.vertices[:, 1].min()
        if below < 0:
            main.move([0, -below, 0])

    def _bystanders(self, rng, looks: Looks, items) -> list[tuple[str, Prop]]:
        found: list[tuple[str, Prop]] = []
        if not self.people:
            return found
        middle = items[0][1].middle
        for _ in range(int(rng.random() < 0.3) + int(rng.random() < 0.15)):
            angle, reach = rng.uniform(0, 2 * np.pi), rng.uniform(1.0, 4.0)
            figure = self._scanned(rng, looks, False, rng.uniform(0, 2 * np.pi))
            figure.prop.stand()
            offset = np.array([reach * np.cos(angle), 0, reach * np.sin(angle)])
            figure.prop.move((middle - figure.prop.middle) * [1, 0, 1] + offset)
            found.append(("bystander", figure.prop))
        return found

    # ------------------------------------------------------------------------ camera, place

    def _camera(
        self, rng: np.random.Generator, main: Prop, items, figure: _Figure | None
    ) -> Camera:
        """Somewhere around the pair, or close to the object; often with the person before it."""
        if rng.random() < 0.35:
            target, extent = main.middle, float(main.size.max())
        else:
            points = np.concatenate([prop.vertices for _, prop in items])
            target = (points.min(0) + points.max(0)) / 2
            extent = float(np.ptp(points, axis=0).max())
        angle = np.deg2rad(rng.uniform(30, 75))
        fill = rng.uniform(0.35, 0.95)
        distance = float(np.clip(extent / fill / 2 / np.tan(angle / 2), 0.6, 8.0))
        level = rng.random() < 0.8
        pitch = np.deg2rad(rng.uniform(-5, 30) if level else rng.uniform(-12, 60))
        bearing = rng.uniform(0, 2 * np.pi)
        if figure is not None and rng.random() < self.config.hiding_share:
            aside = figure.prop.middle - main.middle
            if np.hypot(aside[0], aside[2]) > 0.1:
                bearing = np.arctan2(aside[2], aside[0]) + rng.normal(0, 0.35)
        away = np.array(
            [np.cos(pitch) * np.cos(bearing), np.sin(pitch), np.cos(pitch) * np.sin(bearing)]
        )
        position = target + distance * away
        position[1] = np.clip(position[1], 0.15, 2.25)
        forward = target + rng.normal(0, 0.1, 3) * extent - position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, np.array([0, 1.0, 0]) + rng.normal(0, 0.05, 3))
        right /= np.linalg.norm(right)
        side = self.config.side
        focal = side / 2 / np.tan(angle / 2)
        intrinsics = np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1.0]])
        rotation = np.stack([right, np.cross(forward, right), forward])
        return Camera(rotation, position, intrinsics, side, side)

    def _outdoors(self, rng: np.random.Generator, looks: Looks, camera: Camera, main: Prop) -> None:
        """Open ground under a bright sky, with a backdrop of houses and greenery."""
        scene = looks.scene
        ground = looks.material(rng, 0.85)
        scene.box("room", (60, 0.1, 60), (0, -0.0505, 0), ground)
        for turn in np.arange(4) * np.pi / 2:
            picture = textures.outdoors(rng) if rng.random() < 0.5 else textures.painting(rng)
            if self.bank.photos and rng.random() < 0.5:
                picture = self.bank.photos[int(rng.integers(len(self.bank.photos)))]
            glow = rng.uniform(0.5, 1.0)
            panel = scene.material(Material((0.3,) * 3, scene.texture(picture), 1.0, glow=glow))
            inward = np.array([np.sin(turn), 0, np.cos(turn)])
            across = np.array([np.cos(turn), 0, -np.sin(turn)])
            scene.panel("room", inward * 28 + [0, 9, 0], across * 30, [0, 10, 0], panel, (1.0, 1.0))
        sky = scene.material(Material(tuple(np.array([0.45, 0.6, 0.9])), glow=0.8))
        scene.panel("room", (0, 19, 0), (30, 0, 0), (0, 0, 30), sky)
        for _ in range(int(rng.integers(0, 7))):
            bearing, reach = rng.uniform(0, 2 * np.pi), rng.uniform(6, 20)
            size = rng.uniform([0.5, 0.6, 0.5], [5, 5, 5])
            spot = np.array([reach * np.cos(bearing), size[1] / 2, reach * np.sin(bearing)])
            if np.linalg.norm((spot - camera.position)[[0, 2]]) > 4:
                scene.box("room", size, spot, looks.material(rng, 0.7))
        high = rng.normal(0, 1, 3)
        high[1] = abs(high[1]) + 0.6
        scene.light = main.middle + high / np.linalg.norm(high) * 15
        scene.light_radius = rng.uniform(0.15, 1.2)
        bright = rng.uniform(0.6, 1.6) * 15**2 / 4  # the renderer's lamp falls off from 2 m
        scene.key = np.array([1.0, rng.uniform(0.92, 1.0), rng.uniform(0.8, 1.0)]) * bright
        scene.ambient = np.array([0.9, 0.95, 1.0]) * rng.uniform(0.5, 0.9)

    def _repaint_room(self, rng: np.random.Generator, looks: Looks, first: int) -> None:
        """Give floor or walls other looks than a showroom's, and often less light."""
        rooms = looks.scene.surfaces[first:]
        for chosen, likely in ((range(1), 0.35), (range(2, 10), 0.45)):  # the floor, the walls
            if rng.random() < likely:
                number = looks.material(rng, 0.8)
                for index in chosen:
                    if index < len(rooms):
                        rooms[index].face_materials[:] = number
        if rng.random() < 0.5:
            looks.scene.ambient = looks.scene.ambient * rng.uniform(0.35, 0.9)


def _usable(entry: MeshEntry) -> bool:
    mannequin = "mannequin" in entry.title.lower() or entry.category == "Characters"
    return not mannequin and max(entry.size) > 0.06


def _turn_y(angle: float) -> np.ndarray:
    return Rotation.from_rotvec([0, angle, 0]).as_matrix()


def _seat_level(main: Prop) -> float:
    """Height of a seat: the highest point of its middle that is not its back."""
    low, high = main.vertices.min(0), main.vertices.max(0)
    size, middle = high - low, (low + high) / 2
    near = (np.abs(main.vertices - middle) < 0.3 * size)[:, [0, 2]].all(1)
    near &= main.vertices[:, 1] < low[1] + 0.75 * size[1]
    top = main.vertices[near, 1].max() if near.any() else 0.45
    return float(np.clip(top, 0.25, 0.85))


def _pelvis_height(figure: _Figure) -> float:
    """Of a seated body above its lowest point: about where the thighs are."""
    return float(np.quantile(figure.prop.vertices[:, 1], 0.33))


def _flat(main: Prop) -> bool:
    """Whether one stands on it (a board) rather than sits astride (a bicycle)."""
    return main.size[1] < 0.3 * max(main.size)


def _heading(rng: np.random.Generator, main: Prop) -> float:
    """The angle about y of a thing's longer axis, either way along it."""
    spread = (main.vertices - main.middle)[:, [0, 2]]
    axis = np.linalg.svd(spread, full_matrices=False)[2][0]
    return float(np.arctan2(axis[0], axis[1]) + np.pi * rng.integers(2) + rng.normal(0, 0.1))


def _mount(rng: np.random.Generator, figure: _Figure, main: Prop, seated: bool) -> None:
    """Stand on a board, sit astride what has a saddle, or stand astride it; tilt both, at times."""
    if _flat(main):
        near = np.abs(main.vertices - main.middle)[:, [0, 2]].max(1) < 0.25 * max(main.size)
        lift = main.vertices[near, 1].max() if near.any() else main.size[1]
    else:
        lift = 0.0
        if seated:
            sunk = _pelvis_height(figure) if figure.body else 0.3 * figure.prop.size[1]
            lift = rng.uniform(0.72, 0.9) * main.size[1] - sunk
    _centre_on(figure, main, [rng.normal(0, 0.05), lift, rng.normal(0, 0.05)])
    if rng.random() < 0.4:
        tilt = Rotation.from_rotvec(rng.normal(0, 0.3, 3) * [1, 0, 1]).as_matrix()
        for prop in (main, figure.prop):
            prop.turn(tilt)
        low = min(main.vertices[:, 1].min(), figure.prop.vertices[:, 1].min())
        up = rng.uniform(0, 0.6) if rng.random() < 0.4 else 0.0
        for prop in (main, figure.prop):
            prop.move([0, up - low, 0])


def _swing(rng: np.random.Generator, figure: _Figure, main: Prop) -> None:
    """Put the lower end of a thing with a handle into a hand."""
    length = main.size[1]
    if figure.hands:
        hand = figure.hands[int(rng.integers(len(figure.hands)))]
    else:
        aside = np.cross([0, 1, 0], figure.facing) * rng.choice([-1, 1]) * rng.uniform(0.1, 0.35)
        hand = figure.prop.middle * [1, 0, 1] + figure.facing * rng.uniform(0.1, 0.4) + aside
        hand = hand + [0, figure.prop.size[1] * rng.uniform(0.4, 0.75), 0]
    towards = rng.normal(0, 0.35 if "umbrella" in main.name else 1.0, 3) + [0, 0.7, 0]
    towards = towards + 0.4 * figure.facing
    towards /= np.linalg.norm(towards)
    if hand[1] + length * towards[1] < 0.05:
        towards[1] *= -1
    grip = main.middle - [0, 0.46 * length, 0]
    main.move(-grip)
    main.turn(Rotation.align_vectors([towards], [[0, 1, 0]])[0].as_matrix())
    main.move(hand)


def _centre_on(figure: _Figure, main: Prop, offset) -> None:
    shift = (main.middle - figure.prop.middle) * [1, 0, 1] + np.asarray(offset, float)
    _move(figure, shift)


def _stand_beside(rng: np.random.Generator, figure: _Figure, main: Prop) -> None:
    angle = rng.uniform(0, 2 * np.pi)
    radius = np.abs(main.vertices[:, [0, 2]] - main.middle[[0, 2]]).max()
    reach = radius * rng.uniform(0.4, 1.0) + rng.uniform(0.05, 0.45)
    _centre_on(figure, main, [reach * np.cos(angle), 0, reach * np.sin(angle)])


def _move(figure: _Figure, shift: np.ndarray) -> None:
    figure.prop.move(shift)
    figure.hands = [hand + shift for hand in figure.hands]
    figure.back = None if figure.back is None else figure.back + shift


def _out_of_the_way(rng: np.random.Generator, prop: Prop, camera: Camera, main: Prop) -> bool:
    """Whether a thing neither sits on the camera nor, mostly, hides the main object."""
    if np.linalg.norm(prop.vertices - camera.position, axis=1).min() < 0.5:
        return False
    seen, aim = camera.to_camera(prop.middle), camera.to_camera(main.middle)
    if seen[2] < 0.2:
        return False
    before = seen[2] < aim[2] * 0.85
    covers = np.linalg.norm(seen[:2] / seen[2] - aim[:2] / max(aim[2], 0.1))
    reach = 0.5 * (prop.size.max() / seen[2] + main.size.max() / max(aim[2], 0.1))
    return not (before and covers < 0.7 * reach and rng.random() < 0.85)
