"""The object fit of one frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import KDTree

from hoi.artifacts import Detection, Frame, ObjectFit
from hoi.errors import FrameFailure
from hoi.exemplars import library_path, load_library
from hoi.geometry import model_intrinsics, rotation_angle
from hoi.objectfit.config import ObjectFitConfig
from hoi.objectfit.search import Poses, Shape, View, narrow, rank, score_starts
from hoi.objectfit.starts import start_boxes, start_rotations
from hoi.rendering import Roi, SilhouetteTarget, crop_mask, intrinsics_for

GIVEN = "given"  # the source of masks that nobody detected


class ObjectFitStage:
    """Finds exemplars and poses whose silhouettes explain the object's visible mask.

    All exemplars of the category are scored at many start poses, the promising ones are refined
    through a differentiable silhouette, person pixels count as unknown, and the best exemplars are
    kept with their distinct poses [paper 3.1, 3.5].
    """

    def __init__(self, config: ObjectFitConfig, exemplars_dir: Path | str):
        """`exemplars_dir` holds one ``<category>.npz`` per category; read on first use."""
        self.config = config
        self._exemplars_dir = Path(exemplars_dir)
        self._shapes = cache(self._load_shapes)

    def __call__(self, frame: Frame, detection: Detection, seed: int) -> ObjectFit:
        """Fit one frame; the result depends on nothing but the arguments.

        Raises:
            FrameFailure: `no_exemplars`, `empty_object_mask` or `mask_size_mismatch`.
            AssetError: the category's library is damaged.
        """
        object_mask, person_mask = _masks(frame, detection, self.config.min_mask_pixels)
        fit = self._fit(frame, object_mask, person_mask, seed)
        if not self.config.second_mask or detection.object_mask_source == GIVEN:
            return fit
        from hoi.objectfit.second_mask import best_silhouette, second_mask

        image, shapes = frame.image, self._shapes(frame.category)
        assert image is not None
        drawn = best_silhouette(fit, shapes, _intrinsics(frame, self.config), image.shape[:2])
        again = second_mask(image, object_mask, person_mask, drawn, seed)
        if again.sum() < self.config.min_mask_pixels:
            return fit
        return min(fit, self._fit(frame, again, person_mask & ~again, seed), key=_residual)

    def _fit(
        self, frame: Frame, object_mask: np.ndarray, person_mask: np.ndarray, seed: int
    ) -> ObjectFit:
        config = self.config
        schedule = config.chosen_schedule
        shapes = self._shapes(frame.category)
        roi = Roi.around(_box(object_mask), config.roi_margin)
        view_at = _views(config, object_mask, person_mask, roi, _intrinsics(frame, config))

        generator = torch.Generator().manual_seed(seed)
        scoring = view_at(schedule.score_resolution)
        rotations = start_rotations(config, generator)
        boxes = start_boxes(config, scoring.target, generator)
        found = [score_starts(shape, rotations, boxes, scoring) for shape in shapes]
        searched = len(found) * config.num_starts
        prune_by = config.prune_by
        for step in schedule.steps:
            found = narrow(found, step, prune_by, view_at(step.resolution))
            prune_by = 1
        kept = [
            poses.best(config.poses_per_exemplar, config.distinct_deg)
            for poses in rank(found, 1)[: config.top_exemplars]
        ]
        grid = schedule.steps[-1].resolution
        return _artifact(frame, kept, roi, searched, len(shapes), grid)

    def _load_shapes(self, category: str) -> list[Shape]:
        if not library_path(self._exemplars_dir, category).is_file():
            raise FrameFailure(
                "no_exemplars", f"the exemplar library has no file for category {category!r}"
            )
        exemplars = load_library(self._exemplars_dir, category)
        if self.config.shapes == "medoid":
            exemplars = [exemplars[medoid([exemplar.vertices for exemplar in exemplars])]]
        return [Shape.of(exemplar) for exemplar in exemplars]


def _residual(fit: ObjectFit) -> float:
    """What the best pose leaves unexplained of the mask that it was fitted to."""
    assert fit.ious is not None
    return 1 - float(fit.ious[0])


def medoid(shapes: Sequence[np.ndarray]) -> int:
    """Index of the shape with the smallest sum of Chamfer distances to all others.

    Args:
        shapes: vertices (V, 3) of each, canonical frame, metres.
    """
    trees = [KDTree(shape) for shape in shapes]
    one_way = np.array([[tree.query(shape)[0].mean() for tree in trees] for shape in shapes])
    return int((one_way + one_way.T).sum(1).argmin())


def _masks(frame: Frame, detection: Detection, min_pixels: int) -> tuple[np.ndarray, np.ndarray]:
    """Object mask and the person's mask around it, checked."""
    assert frame.image is not None and detection.object_mask is not None
    object_mask = detection.object_mask > 0
    if object_mask.shape != frame.image.shape[:2]:
        raise FrameFailure(
            "mask_size_mismatch",
            f"the object mask is {object_mask.shape}, the photo {frame.image.shape[:2]}",
        )
    pixels = int(object_mask.sum())
    if pixels < min_pixels:
        raise FrameFailure(
            "empty_object_mask", f"{pixels} object pixels are visible, {min_pixels} are needed"
        )
    person = detection.person_mask
    if person is None:
        return object_mask, np.zeros_like(object_mask)
    if person.shape != object_mask.shape:
        raise FrameFailure(
            "mask_size_mismatch",
            f"the person mask is {person.shape}, the photo {frame.image.shape[:2]}",
        )
    return object_mask, (person > 0) & ~object_mask


def _intrinsics(frame: Frame, config: ObjectFitConfig) -> np.ndarray:
    assert frame.intrinsics is not None and frame.image is not None
    height, width = frame.image.shape[:2]
    return model_intrinsics(frame.intrinsics, height, width, config.camera)


def _box(mask: np.ndarray) -> np.ndarray:
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], float)


def _views(
    config: ObjectFitConfig,
    object_mask: np.ndarray,
    person_mask: np.ndarray,
    roi: Roi,
    intrinsics: np.ndarray,
) -> Callable[[int], View]:
    """The region at any resolution. Cells under the person or off the photo are unknown."""

    @cache
    def view_at(resolution: int) -> View:
        known = crop_mask(~person_mask, roi, resolution)
        covered = crop_mask(object_mask, roi, resolution)
        keep = np.where(known >= 1 - config.keep_threshold, known, 0)
        mask = covered / np.maximum(known, 1e-6)
        return View(intrinsics_for(roi, intrinsics, resolution), SilhouetteTarget(mask, keep))

    return view_at


def _artifact(
    frame: Frame, kept: Sequence[Poses], roi: Roi, searched: int, exemplars: int, grid: int
) -> ObjectFit:
    ranked = sorted(
        ((poses, i) for poses in kept for i in range(len(poses.ious))),
        key=lambda item: (-float(item[0].ious[item[1]]), item[0].shape.name, item[1]),
    )
    return ObjectFit(
        frame_id=frame.frame_id,
        category=frame.category,
        exemplars=[poses.shape.name for poses, _ in ranked],
        rotations=np.stack([poses.rotations[i].double().numpy() for poses, i in ranked]),
        translations=np.stack([poses.translations[i].double().numpy() for poses, i in ranked]),
        ious=np.array([float(poses.ious[i]) for poses, i in ranked]),
        losses=np.array([float(poses.losses[i]) for poses, i in ranked]),
        reasons=[_reason(poses, i, kept, searched, exemplars, grid) for poses, i in ranked],
        roi=roi.as_array(),
        searched=searched,
    )


def _reason(
    poses: Poses, index: int, kept: Sequence[Poses], searched: int, exemplars: int, grid: int
) -> str:
    place = 1 + [other.shape.name for other in kept].index(poses.shape.name)
    overlap = f"IoU {float(poses.ious[index]):.3f} on {grid} x {grid} pixels"
    if index == 0:
        return (
            f"{overlap}: best pose of the exemplar ranked {place} of {exemplars} "
            f"({searched} starts scored)"
        )
    turned = math.degrees(float(rotation_angle(poses.rotations[0], poses.rotations[index])))
    return f"{overlap}: pose {index + 1} of exemplar {place}, turned {turned:.0f} deg from its best"
