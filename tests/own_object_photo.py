"""A generated photo of somebody pushing a pushchair, as a user would lay it into a folder."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from hoi.actions.authoring import Arm, Description, Leg, pose_from_description
from hoi.body import DEFAULT_BODY, BodyModel
from hoi.body.skeleton import JOINT
from hoi.datasets.behave_mini.camera import Camera, kinect_intrinsics
from hoi.datasets.behave_mini.config import RenderConfig
from hoi.datasets.behave_mini.materials import Material, Scene, Surface
from hoi.datasets.behave_mini.person import Person, Pose
from hoi.datasets.behave_mini.render import RayScene, render
from hoi.datasets.behave_mini.room import build_room
from hoi.datasets.behave_mini.wardrobe import dress

WIDTH, HEIGHT = 640, 480
TONES = {"wheel": (0.03, 0.03, 0.03), "frame": (0.35, 0.36, 0.4), "seat": (0.45, 0.05, 0.07)}


class Photographed(NamedTuple):
    """Image (H, W, 3), masks (H, W), camera matrix, and what is true in the camera's frame."""

    image: np.ndarray
    person_mask: np.ndarray
    object_mask: np.ndarray
    intrinsics: np.ndarray
    object_vertices: np.ndarray
    body_vertices: np.ndarray


def pushing(parts) -> Photographed:
    """A person whose palms are on the handle of the pushchair in front.

    Args:
        parts: part -> trimesh in metres, y up, front +z, on the floor; see own_object_meshes.
    """
    person = Person(BodyModel.load(DEFAULT_BODY), np.zeros(10, np.float32))
    palm = (0.2, 0.16, 0.42)
    arms = {f"{side}_arm": Arm(palm=palm) for side in ("left", "right")}
    legs = {"left_leg": Leg(flex=18, knee=6), "right_leg": Leg(flex=-12, knee=14)}
    rotations = np.zeros((24, 3))
    rotations[1:] = pose_from_description(Description(**arms, **legs)).reshape(-1, 3)
    root = np.zeros(3)
    vertices, _ = person.skin(Pose(root, rotations))
    root = np.array([0, -vertices[:, 1].min(), 0])
    vertices, joints = person.skin(Pose(root, rotations))
    hands = joints[[JOINT["left_hand"], JOINT["right_hand"]]].mean(0)
    handle = parts["handle"].vertices
    top = handle[handle[:, 1] > handle[:, 1].max() - 0.03].mean(0)
    scene = Scene()
    looks = np.random.default_rng(5)
    wardrobe = dress(looks, person, scene)
    skin = np.full(len(person.faces), wardrobe.skin)
    scene.surfaces.append(Surface("person", vertices, person.faces, person.rest_vertices, skin))
    shift = np.array([0, 0, hands[2] - top[2]])
    placed = []
    for name, mesh in parts.items():
        points = np.asarray(mesh.vertices) + shift
        material = scene.material(Material(TONES.get(name, (0.05, 0.05, 0.06)), gloss=0.2))
        look = np.full(len(mesh.faces), material)
        faces = np.asarray(mesh.faces)
        scene.surfaces.append(Surface("object", points, faces, np.asarray(mesh.vertices), look))
        placed.append(points)
    points = np.concatenate(placed)
    camera = _camera(np.concatenate([points, vertices]))
    occupied = np.concatenate([vertices, points])
    build_room(looks, looks, scene, camera, occupied)
    rays = RayScene(scene)
    hits = rays.first_hits(camera)
    image = render(rays, hits, camera, wardrobe, RenderConfig(), looks)
    shown = rays.surfaces_at(hits)
    things = (shown >= 1) & (shown <= len(parts))
    return Photographed(
        image,
        shown == 0,
        things,
        camera.intrinsics,
        camera.to_camera(points),
        camera.to_camera(vertices),
    )


def _camera(points: np.ndarray) -> Camera:
    """From the person's left front, at breast height, level."""
    bearing = np.deg2rad(60)
    forward = -np.array([np.sin(bearing), 0, np.cos(bearing)])
    right = np.cross(forward, [0.0, 1.0, 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward])
    middle = (points.min(0) + points.max(0)) / 2
    position = np.array([middle[0], 1.1, middle[2]]) - 2.8 * forward
    intrinsics = kinect_intrinsics(WIDTH) * np.array([[1.7, 1, 1], [1, 1.7, 1], [1, 1, 1]])
    return Camera(rotation, position, intrinsics, WIDTH, HEIGHT)


def write_photo(shot: Photographed, folder: Path, name: str, category: str) -> None:
    """The photo, both masks, its focal length and the object's name."""
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(shot.image).save(folder / f"{name}.png")
    for which, mask in (("person", shot.person_mask), ("object", shot.object_mask)):
        Image.fromarray(mask.astype(np.uint8) * 255).save(folder / f"{name}.{which}_mask.png")
    lines = [f"object: {category}", f"focal_px: {float(shot.intrinsics[0, 0]):.2f}"]
    (folder / f"{name}.yaml").write_text("\n".join(lines) + "\n")
