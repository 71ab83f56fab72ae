"""Writes frames of the generated data set in BEHAVE's layout.

A frame depends on the configuration, its own names, the body model and the furniture alone: it
has the same bytes alone, in any order, and written by any number of processes at once.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from scipy.spatial.transform import Rotation

from hoi.body import DEFAULT_BODY, BodyModel
from hoi.body.keypoints import FROM_BODY25, KEYPOINT
from hoi.datasets.behave_calibration import KINECTS
from hoi.datasets.behave_layout import (
    MIX,
    FrameRef,
    frame_folder,
    object_folder_names,
    parse_sequence,
    sequence_folder,
)
from hoi.datasets.behave_mini.camera import Camera, place_camera
from hoi.datasets.behave_mini.config import BehaveMiniConfig, KeypointNoiseConfig
from hoi.datasets.behave_mini.materials import Material, Scene, Surface
from hoi.datasets.behave_mini.person import Person, Pose
from hoi.datasets.behave_mini.plan import STAGED_ACTIONS, plan, split_table
from hoi.datasets.behave_mini.render import Hits, RayScene, render
from hoi.datasets.behave_mini.room import build_room
from hoi.datasets.behave_mini.seeding import generator
from hoi.datasets.behave_mini.staging import Pair, stage
from hoi.datasets.behave_mini.textures import wood
from hoi.datasets.behave_mini.things import Thing, thing_of
from hoi.datasets.behave_mini.wardrobe import Wardrobe, decorate, dress
from hoi.errors import HoiError

_SEARCH_WIDTH = 256  # of the picture that decides whether a camera sees enough


class View(NamedTuple):
    """A staged pair and a camera that sees enough of it."""

    pair: Pair
    camera: Camera


def generate_frames(
    config: BehaveMiniConfig,
    root: Path | str,
    refs: Iterable[FrameRef],
    body_model: Path = DEFAULT_BODY,
) -> list[FrameRef]:
    """Write these frames, and the files of the data set that they refer to; returns them.

    Raises HoiError when a frame cannot be staged within `max_attempts`.
    """
    refs, root = list(refs), Path(root)
    with _one_thread():
        model = BodyModel.load(body_model)
        _write_commons(root)
        for sequence in dict.fromkeys(ref.sequence for ref in refs):
            _write_sequence(config, root, sequence, model)
        for ref in refs:
            _write_frame(config, root, ref, model)
    return refs


def generate_sequence(
    config: BehaveMiniConfig, root: Path | str, sequence: str, body_model: Path = DEFAULT_BODY
) -> list[FrameRef]:
    """Write the frames of one sequence that the configuration plans; returns them."""
    from hoi.datasets.behave_layout import TABLE_GROUPS
    from hoi.datasets.behave_mini.plan import split_of

    split, object_name = split_of(sequence), parse_sequence(sequence)[2]
    group = next(g for g, names in TABLE_GROUPS.items() if object_name in names)
    refs = [ref for ref in plan(config, group, split) if ref.sequence == sequence]
    return generate_frames(config, root, refs, body_model)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Sums are taken in one order only, so that results are the same on every machine load."""
    from threadpoolctl import threadpool_limits

    before = torch.get_num_threads(), cv2.getNumThreads()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(limits=1):
            yield
    finally:
        torch.set_num_threads(before[0])
        cv2.setNumThreads(before[1])


# ------------------------------------------------------------------------------ what is shown


def person_of(config: BehaveMiniConfig, sequence: str, model: BodyModel) -> Person:
    """The body of one sequence."""
    betas = generator(config.seed, "body", sequence).normal(0.0, config.betas_sd, model.num_betas)
    return Person(model, np.clip(betas, -2.0, 2.0).astype(np.float32))


def view_of(config: BehaveMiniConfig, ref: FrameRef, person: Person, thing: Thing) -> View:
    """The first sensible staging of a frame with a camera that sees enough of the object."""
    for attempt in range(config.max_attempts):
        rng = generator(config.seed, "stage", ref.sequence, ref.time, attempt)
        action = ref.action
        if action == MIX:
            options = STAGED_ACTIONS[ref.object_name]
            choice = generator(config.seed, "mix", ref.sequence, ref.time)
            action = options[int(choice.integers(len(options)))]
        pair = stage(rng, person, thing, action, config)
        if pair is None:
            continue
        points = np.concatenate([pair.vertices, pair.object_vertices])
        for _ in range(8):
            camera = place_camera(rng, points, config)
            if camera and _visible_share(pair, camera) >= config.min_visible_fraction + 0.03:
                return View(pair, camera)
    raise HoiError(
        f"{ref.frame_id} could not be staged in {config.max_attempts} attempts; "
        "raise max_attempts, relax the tolerances or choose another seed of behave_mini: some "
        "bodies never fit some objects"
    )


def _visible_share(pair: Pair, camera: Camera) -> float:
    """Visible over full object silhouette in a small picture."""
    factor = _SEARCH_WIDTH / camera.width
    scale = np.array([[factor], [factor], [1.0]])
    height = max(1, round(camera.height * factor))
    small = Camera(
        camera.rotation, camera.position, camera.intrinsics * scale, _SEARCH_WIDTH, height
    )
    scene = Scene()
    _add_pair(scene, pair, None, np.zeros(len(pair.thing.mesh.part_names), int), 0)
    rays = RayScene(scene)
    visible = (rays.surfaces_at(rays.first_hits(small)) == 1).sum()
    full = full_object_mask(pair, small).sum()
    return float(visible / full) if full > 20 else 0.0


def full_object_mask(pair: Pair, camera: Camera) -> np.ndarray:
    """(H, W) bool silhouette of the object as if nothing stood before it."""
    scene = Scene()
    thing = pair.thing
    scene.surfaces.append(
        Surface("object", pair.object_vertices, thing.faces, thing.vertices, _zeros(thing.faces))
    )
    rows = camera.project(pair.object_vertices)[:, 1]
    first = int(np.clip(np.floor(rows.min()) - 1, 0, camera.height - 1))
    last = int(np.clip(np.ceil(rows.max()) + 1, first + 1, camera.height))
    mask = np.zeros((camera.height, camera.width), bool)
    mask[first:last] = RayScene(scene).hit(camera, first, last - first)
    return mask


def _zeros(faces: np.ndarray) -> np.ndarray:
    return np.zeros(len(faces), int)


def _add_pair(
    scene: Scene, pair: Pair, wardrobe: Wardrobe | None, part_materials: np.ndarray, support: int
) -> None:
    """The person is surface 0, the object surface 1, supports follow."""
    person, thing = pair.person, pair.thing
    skin = _zeros(person.faces) + (wardrobe.skin if wardrobe else 0)
    scene.surfaces.append(
        Surface("person", pair.vertices, person.faces, person.rest_vertices, skin)
    )
    scene.surfaces.append(
        Surface(
            "object", pair.object_vertices, thing.faces, thing.vertices,
            part_materials[thing.mesh.face_parts],
        )
    )  # fmt: skip
    for box in pair.supports:
        scene.box("support", box.size, box.centre, support)


# --------------------------------------------------------------------------------- one frame


def _write_frame(config: BehaveMiniConfig, root: Path, ref: FrameRef, model: BodyModel) -> None:
    person, thing = person_of(config, ref.sequence, model), thing_of(config.seed, ref.sequence)
    view = view_of(config, ref, person, thing)
    pair, camera = view
    looks = generator(config.seed, "looks", ref.sequence)
    rng = generator(config.seed, "picture", ref.sequence, ref.time)
    scene = Scene()
    wardrobe = dress(looks, person, scene)
    parts = decorate(looks, ref.object_name, thing.mesh.part_names, scene)
    support = scene.material(Material((1, 1, 1), scene.texture(wood(looks)), 0.9, 0.1))
    _add_pair(scene, pair, wardrobe, parts, support)
    occupied = np.concatenate([s.vertices for s in scene.surfaces])
    build_room(looks, rng, scene, camera, occupied)
    rays = RayScene(scene)
    hits = rays.first_hits(camera)
    photo = render(rays, hits, camera, wardrobe, config.render, rng)
    shown = rays.surfaces_at(hits)
    folder = frame_folder(root, ref)
    quality = [cv2.IMWRITE_JPEG_QUALITY, config.render.jpeg_quality]
    _write(folder / "k1.color.jpg", _encoded(".jpg", photo[..., ::-1], quality))
    _write_mask(folder / "k1.person_mask.png", shown == 0)
    _write_mask(folder / "k1.obj_rend_mask.png", shown == 1)
    _write_mask(folder / "k1.obj_rend_full.png", full_object_mask(pair, camera))
    joints = simulated_keypoints(pair, camera, rays, hits, config.keypoints, rng)
    _write_json(folder / "k1.color.json", {"body_joints": joints.ravel().round(3).tolist()})
    _write_ground_truth(folder, ref, pair, camera)


def simulated_keypoints(
    pair: Pair,
    camera: Camera,
    rays: RayScene,
    hits: Hits,
    noise: KeypointNoiseConfig,
    rng: np.random.Generator,
) -> np.ndarray:
    """(25, 3) BODY_25 joints as a detector might report them: projected truth plus errors.

    Joints hidden by the object or by the body itself are less exact, less sure and often missing.
    """
    points = pair.person.keypoints(pair.pose)
    pixels, depth = camera.project(points), camera.to_camera(points)[:, 2]
    size = np.ptp(camera.project(pair.vertices)[:, 1])
    column = np.clip(pixels[:, 0].astype(int), 0, camera.width - 1)
    row = np.clip(pixels[:, 1].astype(int), 0, camera.height - 1)
    own = rays.surfaces_at(hits)[row, column] == 0
    in_front = depth - hits.depth[row, column]
    hidden = np.where(own, in_front > 0.16, in_front > 0.03)
    sd = np.where(hidden, noise.hidden_sd, noise.visible_sd) * size
    found = pixels + rng.normal(0, 1, pixels.shape) * sd[:, None]
    sure = np.where(
        hidden, rng.uniform(0.2, 0.6, len(pixels)), rng.uniform(0.65, 0.95, len(pixels))
    )
    drop = rng.random(len(pixels)) < np.where(hidden, noise.hidden_drop, noise.visible_drop)
    known = np.column_stack([found, sure]) * ~drop[:, None]
    body25 = np.zeros((25, 3))
    has = FROM_BODY25 >= 0
    body25[FROM_BODY25[has]] = known[has]
    for joint, names in ((1, ("left_shoulder", "right_shoulder")), (8, ("left_hip", "right_hip"))):
        pair_of = known[[KEYPOINT[name] for name in names]]
        if (pair_of[:, 2] > 0).all():  # OpenPose's neck and mid hip
            body25[joint] = pair_of.mean(0)
    return body25


def _write_ground_truth(folder: Path, ref: FrameRef, pair: Pair, camera: Camera) -> None:
    """Meshes and parameters in the camera's frame, which is BEHAVE's world."""
    person, thing = pair.person, pair.thing
    orient = camera.rotation @ Rotation.from_rotvec(pair.pose.rotations[0]).as_matrix()
    rotations = pair.pose.rotations.copy()
    rotations[0] = Rotation.from_matrix(orient).as_rotvec()
    transl = camera.to_camera(pair.pose.root) - person.rest_joints[0]
    vertices, joints = person.skin(Pose(camera.to_camera(pair.pose.root), rotations))
    person_folder = folder / "person" / "fit02"
    _write(person_folder / "person_fit.ply", ply_bytes(vertices, person.faces))
    described = {
        "body_model": person.model.identity,
        "joints": np.round(joints, 6).tolist(),
        "global_orient": np.round(rotations[0], 6).tolist(),
        "body_pose": np.round(rotations[1:].ravel(), 6).tolist(),
        "betas": np.round(person.betas.astype(float), 6).tolist(),
        "transl": np.round(transl, 6).tolist(),
        "action": pair.action,
    }
    _write_json(person_folder / "person_fit.json", described)
    turned = camera.rotation @ pair.rotation
    moved = camera.to_camera(pair.translation)
    name = object_folder_names(ref.object_name)[0]
    object_folder = folder / name / "fit01"
    placed = thing.vertices @ turned.T + moved
    _write(object_folder / f"{name}_fit.ply", ply_bytes(placed, thing.faces))
    # BEHAVE's pose refers to the template centred on the mean of its vertices
    centred = moved + turned @ thing.vertices.mean(0)
    pose = {"angle": Rotation.from_matrix(turned).as_rotvec(), "trans": centred}
    _write(object_folder / f"{name}_fit.pkl", pickle.dumps(pose, protocol=4))


# ------------------------------------------------------------------------------- common files


def _write_commons(root: Path) -> None:
    names = ("fx", "fy", "cx", "cy", "width", "height")
    color = dict(zip(names, KINECTS[1], strict=True))
    _write_json(root / "calibs" / "intrinsics" / "1" / "calibration.json", {"color": color})
    _write_json(root / "split.json", split_table())
    _write(root / "README.md", _README.encode())


def _write_sequence(config: BehaveMiniConfig, root: Path, sequence: str, model: BodyModel) -> None:
    date, _, object_name, _ = parse_sequence(sequence)
    thing = thing_of(config.seed, sequence)
    person = person_of(config, sequence, model)
    template = Path("objects") / object_name / f"{thing.mesh.name}.obj"
    info = {
        "dataset": "behave_mini",
        "generated": True,
        "cat": object_name,
        "kinects": [1],
        "intrinsic": "../../calibs/intrinsics",
        "config": f"../../calibs/{date}/config",
        "template": f"../../{template.as_posix()}",
        "object_mesh": thing.mesh.name,
        "object_licence": thing.mesh.licence,
        "body_model": model.identity,
        "beta": np.round(person.betas.astype(float), 6).tolist(),
        "seed": config.seed,
    }
    _write_json(sequence_folder(root, sequence) / "info.json", info)
    world = {"rotation": np.eye(3).ravel().tolist(), "translation": [0.0, 0.0, 0.0]}
    _write_json(root / "calibs" / date / "config" / "1" / "config.json", world)
    _write(root / template, _obj_bytes(thing))


_README = """\
# behave_mini

Generated by `hoi`; nothing here was photographed. The layout is that of the BEHAVE data set.

- Bodies: the embedded CC0 body model, shapes and poses drawn at random for every sequence and
  frame. A subject number does not mean one body.
- Objects: curated CC0 and CC-BY furniture and generated objects that are never used as exemplars;
  `info.json` of a sequence names its mesh and licence. Several meshes share one object name.
- `k1.color.json` holds SIMULATED keypoints: projected true joints plus noise, drop-outs and lower
  confidence where a joint is hidden. No pose detector has seen these pictures.
- Masks are exact. Meshes are in metres in the frame of camera k1 (OpenCV axes).
- `split.json`: `test` is reported, `tune` is for choosing settings; they share no object mesh.
"""


def _obj_bytes(thing: Thing) -> bytes:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in thing.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in thing.faces + 1]
    return ("\n".join(lines) + "\n").encode()


def ply_bytes(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """A binary PLY mesh; equal meshes give equal bytes."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    return header.encode() + np.asarray(vertices, "<f4").tobytes() + rows.tobytes()


def _encoded(suffix: str, picture: np.ndarray, options: list[int]) -> bytes:
    done, data = cv2.imencode(suffix, np.ascontiguousarray(picture), options)
    if not done:
        raise HoiError(f"could not encode a {suffix} picture")
    return data.tobytes()


def _write_mask(path: Path, mask: np.ndarray) -> None:
    _write(path, _encoded(".png", mask.astype(np.uint8) * 255, [cv2.IMWRITE_PNG_COMPRESSION, 4]))


def _write_json(path: Path, content: dict) -> None:
    _write(path, (json.dumps(content, indent=1, sort_keys=True) + "\n").encode())


def _write(path: Path, data: bytes) -> None:
    """Write in one step, so that processes writing the same file never see half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    partial.write_bytes(data)
    partial.replace(path)
