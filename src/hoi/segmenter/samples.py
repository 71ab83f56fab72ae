"""Training crops: cut from the rendered pictures, prompted imperfectly, and made photo-like.

Most show one thing, and are prompted with its box. Some show a person and have no box: what is to
be cut out then is the thing that this person uses, of which at most the size is told.

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
from hoi.detect.backends import Box
from hoi.detect.boxes import longer_side, mask_box, middle, overlap, square
from hoi.errors import AssetError
from hoi.segmenter.crops import (
    box_crop,
    crop_matrix,
    cropped,
    extent_crop,
    network_inputs,
    picture_crop,
    used_window,
)
from hoi.segmenter.photos import free_photos, photographed
from hoi.segmenter.pictures import Picture, load_picture

_CLUTTER_WEIGHT = 0.3  # of a thing that nobody uses, against the main object's 1
_POOR = 0.12  # of the boxes of things in use, those that show a part, or too much
_POOR_OVERLAPS = (0.2, 0.65)  # IoU of such a box with the thing's own
_DETECTED = 0.4  # of the other boxes shown, those of a detector, where it drew one
_USED_WITHIN = 0.03  # gap / longer side of the person's box, for a thing in use
_USED_MARGINS = (1.3, 2.0)  # side of the crop / longer side of the person's box
_HELD = 0.4  # longer side / that of the person's box, up to which a thing is looked at closely
_AT_HANDS = 0.6  # of the crops of such things, those of the hands' surroundings
_HANDS_SHARES = (0.4, 0.8)  # side of these / longer side of the person's box
_UNTOLD = 0.25  # of the others, those that say nothing of the thing's size
_EXTENT_SD = 0.35  # of the logarithm of the size that the others tell
_ALWAYS = 0.85  # of the draws for the person's prompt, those that give one


@dataclass(frozen=True)
class Sample:
    """One thing in one picture, its tight box, and boxes that a detector drew around it."""

    picture: int
    number: int
    box: Box
    detected: tuple[Box, ...]
    weight: float
    kind: str


@dataclass(frozen=True)
class Use:
    """A person in a picture and the thing they use: its number, and the boxes of both as seen."""

    picture: int
    number: int
    person: Box
    thing: Box


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
        self.uses = _uses(self.pictures, self.samples)
        weights = np.array([sample.weight for sample in self.samples])
        self._shares = weights / weights.sum()

    def batch(self, seed: int, step: int, size: int, side: int, used_share: float = 0.0) -> Batch:
        """The crops of one training step.

        Args:
            used_share: of the crops, those of a person and what they use, without a box.
        """
        rng = generator(seed, "crops", step)
        used = round(size * used_share) if self.uses else 0
        chosen = rng.choice(len(self.samples), size - used, p=self._shares)
        crops = [self._crop(rng, self.samples[index], side) for index in chosen]
        crops += [
            self._used_crop(rng, self.uses[index], side)
            for index in rng.choice(len(self.uses), used)
        ]
        pictures, boxes, people, targets = (np.stack(part) for part in zip(*crops, strict=True))
        inputs = network_inputs(pictures, boxes, people)
        halves = targets.reshape(size, side // 2, 2, side // 2, 2).mean((2, 4), np.float32) / 255
        return Batch(*inputs, halves[:, None].astype(np.float32))

    def _crop(self, rng: np.random.Generator, sample: Sample, side: int):
        picture = self.pictures[sample.picture]
        box = _prompted(rng, sample, picture)
        matrix = crop_matrix(box, side, rng.uniform(1.3, 1.8), **_moves(rng, box, 0.03))
        target = _target(picture, sample.number, matrix, side)
        person = _person_prompt(rng, picture, matrix, target, side, rng.random())
        prompt = box_crop(box, matrix, picture.owner.shape, side)
        return _shown(rng, picture, matrix, side), prompt, person, target

    def _used_crop(self, rng: np.random.Generator, use: Use, side: int):
        """The person's surroundings, or what is around their hands where they hold something.

        No box, and a person's mask, as that says whose thing.
        """
        picture = self.pictures[use.picture]
        reach, extent = longer_side(use.person), longer_side(use.thing)
        if extent < _HELD * reach and rng.random() < _AT_HANDS:
            window = square(middle(use.thing), rng.uniform(*_HANDS_SHARES) * reach)
            off, told = 0.15, True
        else:
            around = _jittered(rng, use.person)
            window = used_window(around, picture.owner.shape, rng.uniform(*_USED_MARGINS))
            off, told = 0.04, rng.random() >= _UNTOLD
        matrix = crop_matrix(window, side, 1.0, **_moves(rng, window, off))
        target = _target(picture, use.number, matrix, side)
        person = _person_prompt(rng, picture, matrix, target, side, rng.random() * _ALWAYS)
        about = extent * np.exp(rng.normal(0, _EXTENT_SD)) if told else None
        prompt = extent_crop(about, matrix, side)
        return _shown(rng, picture, matrix, side), prompt, person, target


def _prompted(rng: np.random.Generator, sample: Sample, picture: Picture) -> Box:
    """A detector's own box, or one as loose or, now and then, as poor as that."""
    if sample.kind == "main" and rng.random() < _POOR:
        person = picture.mask_of("person")
        return poor_box(rng, sample.box, mask_box(person) if person.any() else None)
    if sample.detected and rng.random() < _DETECTED:
        return sample.detected[int(rng.integers(len(sample.detected)))]
    return _jittered(rng, sample.box)


def poor_box(rng: np.random.Generator, box: Box, person: Box | None) -> Box:
    """A box such as detectors draw when they are wrong: of a part, beside it, or of too much.

    Args:
        box: the thing's own.
        person: that of the person, a part of whom the box may take in.
    """
    tight = np.array(box)
    size = tight[2:] - tight[:2]
    outwards = np.array([-1, -1, 1, 1])
    for _ in range(8):
        kind = rng.random()
        if kind < 0.45:  # a part
            kept = rng.uniform(0.3, 1.0, 2)
            first = tight[:2] + rng.integers(0, 2, 2) * (1 - kept) * size
            drawn = np.concatenate([first, first + kept * size])
        elif kind < 0.7:  # moved, and of another size
            centre = (tight[:2] + tight[2:]) / 2 + rng.normal(0, 0.25, 2) * size
            half = size * np.exp(rng.normal(0, 0.3, 2)) / 2
            drawn = np.concatenate([centre - half, centre + half])
        elif person is not None:  # with a part of the person
            reached = tight + rng.uniform(0.2, 1.0) * (np.array(person) - tight)
            drawn = np.where(outwards < 0, np.minimum(tight, reached), np.maximum(tight, reached))
        else:  # too large
            drawn = tight + outwards * rng.uniform(0, 0.6, 4) * np.tile(size, 2)
        x0, y0, x1, y1 = drawn.tolist()
        loose = _jittered(rng, (x0, y0, x1, y1))
        if _POOR_OVERLAPS[0] <= overlap(loose, box) <= _POOR_OVERLAPS[1]:
            return loose
    return _jittered(rng, box)


def _jittered(rng: np.random.Generator, box: Box) -> Box:
    """A box as loose as a detector's, now and then very loose."""
    sides = np.array(box)
    spread = rng.uniform(0, 0.09) if rng.random() < 0.88 else 0.16
    extent = np.tile(sides[2:] - sides[:2], 2)
    x0, y0, x1, y1 = (sides + extent * np.clip(rng.normal(0, 1, 4), -2, 2) * spread).tolist()
    return x0, y0, x1, y1


def _moves(rng: np.random.Generator, box: Box, off: float) -> dict:
    """How a crop is turned, mirrored, and moved by about `off` of the box."""
    return {
        "angle": np.deg2rad(rng.normal(0, 6)),
        "mirrored": bool(rng.random() < 0.5),
        "shift": tuple(rng.normal(0, off, 2) * longer_side(box)),
    }


def _target(picture: Picture, number: int, matrix: np.ndarray, side: int) -> np.ndarray:
    return cropped(np.where(picture.owner == number, 255, 0).astype(np.uint8), matrix, side)


def _shown(rng: np.random.Generator, picture: Picture, matrix: np.ndarray, side: int) -> np.ndarray:
    """The crop of the picture, now and then with a photo behind it, as a camera shows it."""
    shown = picture_crop(picture.image, matrix, side)
    if rng.random() < 0.15:
        place = np.where(picture.owner == 0, 255, 0).astype(np.uint8)
        away = cropped(place, matrix, side, 255)[..., None].astype(np.float32) / 255
        shown = (shown * (1 - away) + _photo_crop(rng, side) * away).astype(np.uint8)
    return photographed(rng, shown)


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
        box = mask_box(mask)
        across, down = box[2] - box[0], box[3] - box[1]
        thin = pixels < 0.035 * across * down
        everywhere = across > 0.98 * width and down > 0.9 * height
        if max(across, down) < 18 * width / 512 or thin or everywhere:
            continue
        weight = 1.0 if item.kind == "main" else _CLUTTER_WEIGHT
        found.append(Sample(index, item.number, box, item.detected, weight, item.kind))
    return found


def _uses(pictures: list[Picture], samples: list[Sample]) -> list[Use]:
    """The people who touch a main object, or nearly do."""
    found = []
    for sample in samples:
        picture = pictures[sample.picture]
        if sample.kind != "main" or not picture.person.any():
            continue
        mask = picture.mask_of("person")
        if not mask.any():
            continue
        person = mask_box(mask)
        away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
        if away[picture.owner == sample.number].min() < _USED_WITHIN * longer_side(person):
            found.append(Use(sample.picture, sample.number, person, sample.box))
    return found


def _person_prompt(
    rng: np.random.Generator,
    picture: Picture,
    matrix: np.ndarray,
    target: np.ndarray,
    side: int,
    draw: float,
) -> np.ndarray:
    """(S, S) uint8 person mask as bad as it can be: the pose model's, a spoilt true one, none.

    Now and then it swallows the object or a part of it, as pose models do with worn bags. `draw`
    in [0, 1] decides which it is.
    """
    number = picture.number_of("person")
    result = np.zeros((side, side), np.uint8)
    if number and draw < _ALWAYS:
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
