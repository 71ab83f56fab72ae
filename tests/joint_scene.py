"""A toy scene for the joint stage's tests: a person sitting on a box chair, with exact masks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch

from hoi.artifacts import (
    BodyFit,
    Contact,
    Detection,
    Frame,
    Interaction,
    ObjectFit,
    Prior,
)
from hoi.body import DEFAULT_BODY, BodyModel, part_vertices
from hoi.config import load_config
from hoi.exemplars import Exemplar
from hoi.joint.config import JointConfig
from hoi.joint.inputs import Inputs
from hoi.joint.problem import BodyRegions, Problem, build_problem
from hoi.rendering import depth_map

#: the methods as users run them
METHODS = load_config(Path(__file__).parents[1] / "config" / "config.yaml")
INTRINSICS = np.array([[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]])
HEIGHT, WIDTH = 480, 640

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float) - 0.5
CUBE_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    + [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def box_object(name: str, category: str, boxes: dict[str, list[tuple]]) -> Exemplar:
    """An exemplar of boxes, part -> [(size, centre), ...], centred on its bounding box."""
    vertices, faces, parts, count = [], [], [], 0
    for index, (_, solids) in enumerate(boxes.items()):
        for size, centre in solids:
            vertices.append(CUBE * np.array(size) + np.array(centre))
            faces.append(CUBE_FACES + count)
            parts.append(np.full(12, index))
            count += 8
    points = np.concatenate(vertices)
    points -= (points.min(0) + points.max(0)) / 2
    return Exemplar(name, category, points, np.concatenate(faces), tuple(boxes),
                    np.concatenate(parts))  # fmt: skip


def box_chair(name: str = "box", arms: bool = False) -> Exemplar:
    """0.45 x 0.9 x 0.45 m, seat at 0.45 m, front +z."""
    legs = [((0.04, 0.42, 0.04), (x, 0.21, z)) for x in (-0.2, 0.2) for z in (-0.2, 0.2)]
    boxes = {
        "chair_seat": [((0.45, 0.04, 0.45), (0, 0.43, 0))],
        "chair_back": [((0.45, 0.45, 0.04), (0, 0.675, -0.205))],
        "chair_base": legs,
    }
    if arms:
        boxes["chair_arm"] = [((0.04, 0.04, 0.4), (x, 0.65, 0)) for x in (-0.2, 0.2)]
    return box_object(name, "chair", boxes)


@cache
def body_model() -> BodyModel:
    return BodyModel.load(DEFAULT_BODY)


@cache
def body_regions() -> BodyRegions:
    model = body_model()
    return BodyRegions(model.faces, part_vertices(model), model.num_vertices)


@dataclass
class Scene:
    """A person sitting on a box chair, seen by a level camera 3 m away, and its artifacts."""

    frame: Frame
    detection: Detection
    body: BodyFit
    objects: ObjectFit
    prior: Prior
    exemplars: list[Exemplar]
    true_vertices: np.ndarray


def _upright(yaw: float) -> np.ndarray:
    """Camera-from-canonical rotation of something upright whose front faces the camera at yaw 0."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.diag([1.0, -1.0, -1.0]) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _sitting() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and joints of a sitting body, y up, front +z."""
    model = body_model()
    pose = np.zeros((24, 3))
    names = list(model.joint_names)
    for side, sign in (("left", 1), ("right", -1)):
        pose[names.index(f"{side}_hip")] = [-1.5, 0.1 * sign, 0.15 * sign]
        pose[names.index(f"{side}_knee")] = [1.5, 0, 0]
        pose[names.index(f"{side}_shoulder")] = [0, -0.35 * sign, -1.1 * sign]
    pose = torch.tensor(pose.reshape(1, 72), dtype=torch.float32)
    with torch.no_grad():
        out = model(pose[:, :3], pose[:, 3:], torch.zeros(1, model.num_betas))
    return out.vertices[0].numpy().astype(float), out.joints[0].numpy().astype(float)


def chair_prior(**changes) -> Prior:
    sit = Interaction(
        action="sit",
        contacts=[
            Contact(object_part="chair_seat", body_part="butt"),
            Contact(object_part="chair_back", body_part="back"),
        ],
        stands_on_floor=True,
    )
    lift = Interaction(
        action="lift",
        contacts=[
            Contact(object_part=part, body_part=hand, side="both", probability=0.6)
            for part in ("chair_back", "chair_seat", "chair_arm")
            for hand in ("left_hand", "right_hand")
        ],
    )
    values = {"category": "chair", "size_m": 0.9, "size_axis": "height", "retrieved": sit,
              "default": lift}  # fmt: skip
    return Prior(frame_id="toy", **(values | changes))


def sitting_scene(yaw: float = 0.6, second: bool = False) -> Scene:
    """The object fit is exact; `second` adds a hypothesis, the same pose of another exemplar."""
    chair = box_chair()
    vertices, joints = _sitting()
    butt = vertices[body_regions().vertices["butt"]]
    seat_top = 0.0  # of the centred chair: seat top at .45 of .9 m
    shift = np.array([-butt[:, 0].mean(), seat_top - np.percentile(butt[:, 1], 8), 0])
    shift[2] = -0.17 - vertices[body_regions().vertices["back"], 2].min()
    rotation, translation = _upright(yaw), np.array([0.1, 0.25, 3.0])

    def to_camera(points: np.ndarray) -> np.ndarray:
        return points @ rotation.T + translation

    body, body_joints = to_camera(vertices + shift), to_camera(joints + shift)
    placed = to_camera(chair.vertices.astype(float))
    model = body_model()
    of_body = depth_map(body, model.faces, INTRINSICS, HEIGHT, WIDTH)
    of_chair = depth_map(placed, chair.faces, INTRINSICS, HEIGHT, WIDTH)
    thing, person = of_chair < of_body, of_body < of_chair
    exemplars = [chair] + ([box_chair("other", arms=True)] if second else [])
    count = len(exemplars)
    return Scene(
        frame=Frame(frame_id="toy", dataset="toy", category="chair",
                    image=np.zeros((HEIGHT, WIDTH, 3), np.uint8), intrinsics=INTRINSICS),
        detection=Detection(frame_id="toy", person_box=_box(person), object_box=_box(thing),
                            person_mask=person, object_mask=thing, keypoints=np.zeros((21, 3))),
        body=BodyFit(frame_id="toy", body_model=model.identity, global_orient=np.zeros(3),
                     body_pose=np.zeros(69), betas=np.zeros(model.num_betas),
                     transl=np.zeros(3), vertices=body, joints=body_joints),
        objects=ObjectFit(frame_id="toy", category="chair", exemplars=[e.name for e in exemplars],
                          rotations=np.stack([rotation] * count),
                          translations=np.stack([translation] * count),
                          ious=np.linspace(0.9, 0.8, count)),
        prior=chair_prior(),
        exemplars=exemplars,
        true_vertices=placed,
    )  # fmt: skip


def _box(mask: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(mask)
    return np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], float)


def method_config(name: str, **changes) -> JointConfig:
    """A method of config/config.yaml, made quick: a coarser distance field, fewer points."""
    quick = {"sdf_grid": 16, "part_points": 48, "surface_points": 150}
    return JointConfig(**({"method": name} | METHODS.methods[name].joint | quick | changes))


def inputs_of(scene: Scene) -> Inputs:
    return Inputs.gather(
        scene.frame, scene.detection, scene.body, scene.objects, scene.prior, roi_margin=0.3
    )


def problem_of(scene: Scene, config: JointConfig, seed: int = 0) -> Problem:
    interaction = scene.prior.retrieved
    assert interaction is not None
    regions = body_regions()
    return build_problem(config, inputs_of(scene), interaction, scene.exemplars, regions, seed)
