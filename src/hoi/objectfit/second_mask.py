"""The object's mask once more, with the fitted silhouette as prior.

Where mask and silhouette agree, a pixel is sure; where they differ, GrabCut decides by colour. So a
leg that the detector missed can come back, and a piece of wall that it took can go.
"""

from __future__ import annotations

import cv2
import numpy as np

from hoi.artifacts import ObjectFit
from hoi.detect.boxes import mask_box
from hoi.detect.config import SegmenterConfig
from hoi.detect.settling import refined
from hoi.geometry import project
from hoi.objectfit.search import Shape
from hoi.rendering import Roi, intrinsics_for, render_silhouette

_RESOLUTION = 256


def second_mask(
    image: np.ndarray,
    object_mask: np.ndarray,
    person_mask: np.ndarray,
    silhouette: np.ndarray,
    seed: int,
) -> np.ndarray:
    """(H, W) bool, without the person; empty where nothing is left.

    Args:
        image: (H, W, 3) uint8 RGB.
        object_mask, person_mask: (H, W) bool, what was detected.
        silhouette: (H, W) in [0, 1], see :func:`best_silhouette`.
    """
    chance = ((object_mask + silhouette) / 2).astype(np.float32)
    chance[person_mask] = 0
    box = mask_box((chance > 0.25) | object_mask)
    return refined(image, box, chance, SegmenterConfig(), seed) & ~person_mask


def best_silhouette(
    fit: ObjectFit, shapes: list[Shape], intrinsics: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """(H, W) float32 in [0, 1]: the best pose's whole outline inside the region of the fit.

    Args:
        fit: an object fit that came through.
        shapes: what it chose from.
        intrinsics: K (3, 3) of the fit's camera.
        size: height and width.
    """
    assert fit.exemplars and fit.rotations is not None and fit.translations is not None
    assert fit.roi is not None
    roi = Roi(*(float(value) for value in fit.roi))
    shape = next(shape for shape in shapes if shape.name == fit.exemplars[0])
    placed = shape.vertices.double().numpy() @ fit.rotations[0].T + fit.translations[0]
    points = project(
        shape.vertices.new_tensor(placed), intrinsics_for(roi, intrinsics, _RESOLUTION)
    )
    drawn = render_silhouette(points[None], shape.topology, _RESOLUTION, _RESOLUTION)[0].numpy()
    cell = roi.side / _RESOLUTION
    # OpenCV counts from pixel centres
    to_image = np.array([[cell, 0, roi.x0 + (cell - 1) / 2], [0, cell, roi.y0 + (cell - 1) / 2]])
    return cv2.warpAffine(drawn, to_image, size[::-1], flags=cv2.INTER_LINEAR)
