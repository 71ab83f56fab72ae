"""Training crops: cut from the rendered pictures, prompted imperfectly, and made photo-like.

Every batch has a generator of its own, so that a run that was interrupted goes on with the very
crops that it would have seen.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from hoi.datasets.behave_mini.seeding import generator
from hoi.errors import AssetError
from hoi.segmenter.crops import box_crop, crop_matrix, cropped, network_inputs, picture_crop
from hoi.segmenter.photos import free_photos, photographed
from hoi.segmenter.pictures import Picture, load_picture

_CLUTTER_WEIGHT = 0.3  # of a thing that nobody uses, against the main object's 1


@dataclass(frozen=True)
class Sample:
    """One thing in one picture and its tight box."""

    picture: int
    number: int
    box: tuple[float, float, float, float]
    weight: float
    kind: str


class Batch(NamedTuple):
    """Float32 arrays: picture (B, 3, S, S), prompt (B, 2, S, S), target (B, 1, S/2, S/2)."""

    picture: np.ndarray
    prompt: np.ndarray
    target: np.ndarray


class SampleSet:
    """All crops that a set of pictures offers.

    Args:
        files: written by :func:`hoi.segmenter.pictures.save_picture`.

    Raises AssetError when they offer none.
    """

    def __init__(self, files: Iterable[Path]):
        self.pictures = [load_picture(file) for file in files]
        self.samples = [
            sample
            for index, picture in enumerate(self.pictures)
            for sample in _samples_of(index, picture)
        ]
        if not self.samples:
            raise AssetError("no rendered picture shows anything to learn from")
        weights = np.array([sample.weight for sample in self.samples])
        self._shares = weights / weights.sum()

    def batch(self, seed: int, step: int, size: int, side: int) -> Batch:
        """The crops of one training step."""
        rng = generator(seed, "crops", step)
        chosen = rng.choice(len(self.samples), size, p=self._shares)
        crops = [self._crop(rng, self.samples[index], side) for index in chosen]
        pictures, boxes, people, targets = (np.stack(part) for part in zip(*crops, strict=True))
        inputs = network_inputs(pictures, boxes, people)
        halves = targets.reshape(size, side // 2, 2, side // 2, 2).mean((2, 4), np.float32) / 255
        return Batch(*inputs, halves[:, None].astype(np.float32))

    def _crop(self, rng: np.random.Generator, sample: Sample, side: int):
        picture = self.pictures[sample.picture]
        box = np.array(sample.box)
        extent = box[2:] - box[:2]
        spread = rng.uniform(0, 0.09) if rng.random() < 0.88 else 0.16
        box = box + np.tile(extent, 2) * np.clip(rng.normal(0, 1, 4), -2, 2) * spread
        shift = rng.normal(0, 0.03, 2) * extent.max()
        matrix = crop_matrix(
            box.tolist(),
            side,
            rng.uniform(1.3, 1.8),
            np.deg2rad(rng.normal(0, 6)),
            bool(rng.random() < 0.5),
            (shift[0], shift[1]),
        )
        shown = picture_crop(picture.image, matrix, side)
        whole = np.where(picture.owner == sample.number, 255, 0).astype(np.uint8)
        target = cropped(whole, matrix, side)
        person = _person_prompt(rng, picture, matrix, target, side)
        if rng.random() < 0.15:
            place = np.where(picture.owner == 0, 255, 0).astype(np.uint8)
            away = cropped(place, matrix, side, 255)[..., None].astype(np.float32) / 255
            shown = (shown * (1 - away) + _photo_crop(rng, side) * away).astype(np.uint8)
        prompt = box_crop(box.tolist(), matrix, picture.owner.shape, side)
        return photographed(rng, shown), prompt, person, target


def _samples_of(index: int, picture: Picture) -> list[Sample]:
    """Things large enough to be worth learning from; people are not."""
    height, width = picture.owner.shape
    scale = (width / 512) ** 2
    found = []
    for item in picture.instances:
        mask = picture.owner == item.number
        pixels = int(mask.sum())
        if item.kind in ("person", "bystander") or pixels < 180 * scale:
            continue
        columns, rows = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
        box = (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1)
        across, down = box[2] - box[0], box[3] - box[1]
        thin = pixels < 0.035 * across * down
        everywhere = across > 0.98 * width and down > 0.9 * height
        if max(across, down) < 18 * width / 512 or thin or everywhere:
            continue
        weight = 1.0 if item.kind == "main" else _CLUTTER_WEIGHT
        edges = (float(box[0]), float(box[1]), float(box[2]), float(box[3]))
        found.append(Sample(index, item.number, edges, weight, item.kind))
    return found


def _person_prompt(
    rng: np.random.Generator, picture: Picture, matrix: np.ndarray, target: np.ndarray, side: int
) -> np.ndarray:
    """(S, S) uint8 person mask as bad as it can be: the pose model's, a spoilt true one, none.

    Now and then it swallows the object or a part of it, as pose models do with worn bags.
    """
    draw = rng.random()
    number = picture.number_of("person")
    result = np.zeros((side, side), np.uint8)
    if number and draw < 0.85:
        mask = picture.person
        if draw >= 0.62:
            true = np.where(picture.owner == number, 255, 0).astype(np.uint8)
            mask = cv2.resize(true, picture.person.shape[::-1], interpolation=cv2.INTER_AREA)
            size = int(rng.integers(0, 4))
            if size:
                change = cv2.erode if rng.random() < 0.5 else cv2.dilate
                mask = change(mask, np.ones((size, size), np.uint8))
            mask = cv2.GaussianBlur(mask, (0, 0), rng.uniform(0.5, 3))
        small = matrix.copy()
        small[:, :2] *= picture.owner.shape[0] / mask.shape[0]
        result = cropped(mask, small, side)
    if draw < 0.95 and rng.random() < 0.18:
        eaten = target.copy()
        if rng.random() < 0.5:  # one side of it
            angle = rng.uniform(0, 2 * np.pi)
            y, x = np.mgrid[:side, :side] - side / 2
            eaten[x * np.cos(angle) + y * np.sin(angle) > rng.normal(0, side * 0.15)] = 0
        size = int(rng.integers(1, 5))
        if rng.random() < 0.5:
            eaten = cv2.dilate(eaten, np.ones((size, size), np.uint8))
        result = np.maximum(result, cv2.GaussianBlur(eaten, (0, 0), rng.uniform(1, 4)))
    return result


def _photo_crop(rng: np.random.Generator, side: int) -> np.ndarray:
    photos = free_photos()
    if not photos:
        return np.full((side, side, 3), rng.uniform(0, 255, 3)).astype(np.float32)
    photo = photos[int(rng.integers(len(photos)))]
    extent = int(min(photo.shape[:2]) * rng.uniform(0.25, 1))
    row = int(rng.integers(photo.shape[0] - extent + 1))
    column = int(rng.integers(photo.shape[1] - extent + 1))
    part = photo[row : row + extent, column : column + extent]
    part = cv2.resize(part, (side, side), interpolation=cv2.INTER_AREA)
    part = part[:, ::-1] if rng.random() < 0.5 else part
    tint = rng.uniform(0.5, 1.3) * np.exp(rng.normal(0, 0.1, 3))
    return np.clip(part * tint, 0, 255).astype(np.float32)
