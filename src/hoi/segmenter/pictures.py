"""Render scenes to files: the photo, who is where, and what a pose model says of the person."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from hoi.body import DEFAULT_BODY
from hoi.datasets.behave_mini.config import RenderConfig
from hoi.datasets.behave_mini.render import RayScene, render
from hoi.datasets.behave_mini.seeding import generator
from hoi.detect.backends import Box
from hoi.detect.boxes import mask_box
from hoi.errors import HoiError
from hoi.segmenter.config import SceneConfig
from hoi.segmenter.meshes import MeshStore
from hoi.segmenter.onlookers import Onlooker, fitting_boxes, registry_onlooker
from hoi.segmenter.photos import photographed
from hoi.segmenter.scenes import Composer, Instance

log = logging.getLogger(__name__)
POSE_DATABASE = Path(__file__).parents[1] / "data" / "poses" / "database.npz"
PERSON_SIDE = 256  # pixels of the stored person mask
_ATTEMPTS = 20
_MIN_PIXELS = 250  # of the main object, in a picture of 512 pixels
_FAST = RenderConfig(shadow_rays=1, bounce_rays=2, blur_px=2.4)


@dataclass(frozen=True, eq=False)
class Picture:
    """A rendered photo.

    Args:
        image: (S, S, 3) uint8 RGB.
        owner: (S, S) uint8, the number of the instance seen, 0 for the place itself.
        person: (256, 256) uint8 probability of the person by the pose model, 255 = certain;
            zeros where there is none.
        instances: what the numbers mean.
    """

    image: np.ndarray
    owner: np.ndarray
    person: np.ndarray
    instances: list[Instance]

    def number_of(self, kind: str) -> int:
        """The first instance of a kind; 0 when there is none."""
        return next((item.number for item in self.instances if item.kind == kind), 0)

    def mask_of(self, kind: str) -> np.ndarray:
        """(S, S) bool: where that instance is seen; empty when there is none."""
        number = self.number_of(kind)
        return (self.owner == number) & (number > 0)


def draw_picture(
    composer: Composer, config: SceneConfig, seed: int, name: str, look: Onlooker
) -> Picture:
    """The picture called `name`; it depends on the seed and its own name alone.

    Raises HoiError when no scene drawn for it shows its main object.
    """
    for attempt in range(_ATTEMPTS):
        rng = generator(seed, "segmenter", name, attempt)
        staged = composer(rng)
        rays = RayScene(staged.scene)
        hits = rays.first_hits(staged.camera)
        surfaces = rays.surfaces_at(hits)
        owner = np.where(surfaces >= 0, staged.owner[np.maximum(surfaces, 0)], 0)
        if (owner == 1).sum() < _MIN_PIXELS * (config.side / 512) ** 2:
            continue
        image = render(rays, hits, staged.camera, staged.wardrobe, _FAST, rng)
        if composer.held_out:  # training does this to every crop anew
            image = photographed(rng, image)
        kept = [item for item in staged.instances if (owner == item.number).any()]
        number = next((item.number for item in kept if item.kind == "person"), 0)
        large = number and (owner == number).sum() > 900 * (config.side / 512) ** 2
        seen = look(image, _loose_box(rng, owner == number) if large else None)
        drawn = fitting_boxes(seen.boxes, [mask_box(owner == item.number) for item in kept])
        kept = [replace(item, detected=own) for item, own in zip(kept, drawn, strict=True)]
        return Picture(image, owner.astype(np.uint8), _stored_person(seen.person), kept)
    raise HoiError(f"picture {name}: none of {_ATTEMPTS} scenes shows its main object")


def _loose_box(rng: np.random.Generator, mask: np.ndarray) -> Box:
    """A box as loose as a detector's."""
    box = np.array(mask_box(mask))
    box += np.tile(box[2:] - box[:2], 2) * rng.normal(0, 0.05, 4)
    x0, y0, x1, y1 = box.tolist()
    return x0, y0, x1, y1


def _stored_person(probability: np.ndarray | None) -> np.ndarray:
    if probability is None:
        return np.zeros((PERSON_SIDE, PERSON_SIDE), np.uint8)
    small = cv2.resize(probability, (PERSON_SIDE, PERSON_SIDE), interpolation=cv2.INTER_AREA)
    return np.rint(np.clip(small, 0, 1) * 255).astype(np.uint8)


def save_picture(picture: Picture, path: Path, jpeg_quality: int) -> None:
    """Write a picture as one file."""
    flag = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
    names = json.dumps([vars(item) for item in picture.instances])
    arrays = {
        "image": cv2.imencode(".jpg", np.ascontiguousarray(picture.image[..., ::-1]), flag)[1],
        "owner": cv2.imencode(".png", picture.owner)[1],
        "person": cv2.imencode(".png", picture.person)[1],
        "instances": np.frombuffer(names.encode(), np.uint8),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    with partial.open("wb") as file:
        flat = {key: np.asarray(value).ravel() for key, value in arrays.items()}
        np.savez(file, **flat)  # type: ignore[arg-type]  # names are ours
    partial.replace(path)


def picture_names(config: SceneConfig, split: str) -> list[str]:
    """Names of all pictures of ``train`` or ``validation``."""
    count = config.scenes if split == "train" else config.validation
    return [f"{split}-{number:05d}" for number in range(count)]


def render_pictures(
    names: Iterable[str],
    folder: Path,
    config: SceneConfig,
    seed: int,
    meshes: Path,
    models_dir: Path,
    body_model: Path = DEFAULT_BODY,
    pose_database: Path = POSE_DATABASE,
) -> list[Path]:
    """Render the named pictures that are not in `folder` yet; returns all their files.

    Args:
        meshes: folder written by :func:`hoi.segmenter.meshes.build_store`.
        models_dir: folder with the models' files.
    """
    files = [folder / f"{name}.npz" for name in names]
    composers: dict[bool, Composer] = {}
    look = registry_onlooker(models_dir)
    for file in files:
        if file.is_file():
            continue
        held_out = file.stem.startswith("validation")
        if held_out not in composers:
            store = MeshStore(meshes)
            composers[held_out] = Composer(config, store, held_out, body_model, pose_database, seed)
        picture = draw_picture(composers[held_out], config, seed, file.stem, look)
        save_picture(picture, file, config.jpeg_quality)
        log.info("%s: %s", file.stem, picture.instances[0].name)
    return files


def load_picture(path: Path) -> Picture:
    """Read a picture back."""
    with np.load(path, allow_pickle=False) as file:
        image = np.asarray(cv2.imdecode(file["image"], cv2.IMREAD_COLOR))
        owner = np.asarray(cv2.imdecode(file["owner"], cv2.IMREAD_UNCHANGED))
        person = np.asarray(cv2.imdecode(file["person"], cv2.IMREAD_UNCHANGED))
        rows = json.loads(file["instances"].tobytes())
    for row in rows:
        row["detected"] = tuple(tuple(box) for box in row.get("detected", ()))
    instances = [Instance(**row) for row in rows]
    return Picture(np.ascontiguousarray(image[..., ::-1]), owner, person, instances)
