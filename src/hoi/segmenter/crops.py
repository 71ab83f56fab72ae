"""The square crop around a box that the network sees, and the way back. Used by both sides."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from hoi.detect.backends import Box
from hoi.detect.boxes import longer_side, middle, square

SIDE = 320  # pixels of the network's square input
MARGIN = 1.5  # side of the crop / longer side of the box
USED_MARGIN = 1.6  # the same around a person, where the thing in use is looked for
HANDS_SHARE = 0.55  # side of the square around the hands / longer side of the person's box
_SMALLEST = 0.02  # share of such a crop that a thing has at least
_BEYOND = 1.1  # side of the crop around a person / longer side of the picture, at most
MEAN_BGR = (103.53, 116.28, 123.675)  # the backbone's normalisation
STD_BGR = (57.375, 57.12, 58.395)
_FILL = (124, 116, 103)  # RGB outside the picture: the mean, which normalises to about zero


def crop_matrix(
    box: Sequence[float],
    side: int = SIDE,
    margin: float = MARGIN,
    angle: float = 0.0,
    mirrored: bool = False,
    shift: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """(2, 3) crop_from_image: the box's surroundings as a square of `side` pixels.

    Args:
        box: x0, y0, x1, y1 in pixels (edges, not centres).
        margin: side of the square / longer side of the box.
        angle: radians that the picture is turned by; `mirrored` flips it left to right.
        shift: pixels that the square's middle lies off the box's.
    """
    x0, y0, x1, y1 = box
    scale = side / max(max(x1 - x0, y1 - y0) * margin, 1.0)
    cosine, sine = np.cos(angle) * scale, np.sin(angle) * scale
    matrix = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0]])
    if mirrored:
        matrix[0] *= -1
    middle = np.array([(x0 + x1) / 2 + shift[0], (y0 + y1) / 2 + shift[1]])
    matrix[:, 2] = side / 2 - matrix[:, :2] @ middle
    return matrix


def used_window(
    person: Sequence[float], shape: tuple[int, int], margin: float = USED_MARGIN
) -> Box:
    """The square around a person where the thing in use is looked for; hardly beyond the picture.

    Args:
        person: x0, y0, x1, y1 in pixels.
        shape: height and width of the picture.
    """
    side = max(longer_side(person), 1.0)
    return square(middle(person), min(margin * side, _BEYOND * max(shape)))


def cropped(
    image: np.ndarray,
    matrix: np.ndarray,
    side: int = SIDE,
    fill: float | tuple = 0,
    smooth: bool = True,
) -> np.ndarray:
    """The crop of an image (H, W) or (H, W, 3); `smooth` filters before it shrinks."""
    scale = float(np.sqrt(abs(np.linalg.det(matrix[:, :2]))))
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side]], float)
    inverse = np.linalg.inv(matrix[:, :2])
    seen = (corners - matrix[:, 2]) @ inverse.T
    reach = 4 + 2 / max(scale, 1e-6)
    height, width = image.shape[:2]
    low = np.clip(np.floor(seen.min(0) - reach), 0, [width, height]).astype(int)
    high = np.clip(np.ceil(seen.max(0) + reach), 0, [width, height]).astype(int)
    part = image[low[1] : high[1], low[0] : high[0]]
    if part.size == 0:
        shape = (side, side, *image.shape[2:])
        return np.broadcast_to(np.asarray(fill, image.dtype), shape).copy()
    if smooth and scale < 0.7:
        part = cv2.GaussianBlur(part, (0, 0), 0.45 * (1 / scale - 1) + 0.1)
    moved = matrix.copy()
    moved[:, 2] += matrix[:, :2] @ low
    return cv2.warpAffine(
        part,
        _at_centres(moved),
        (side, side),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=fill,
    )


def pasted(crop: np.ndarray, matrix: np.ndarray, shape: tuple[int, int], fill: float) -> np.ndarray:
    """(H, W): a crop's values back in the picture, `fill` outside the crop."""
    result = np.full(shape, fill, crop.dtype)
    rows, columns = crop_window(matrix, shape, crop.shape[0])
    size = columns.stop - columns.start, rows.stop - rows.start
    if min(size) < 1:
        return result
    moved = matrix.copy()
    moved[:, 2] += matrix[:, :2] @ [columns.start, rows.start]
    result[rows, columns] = cv2.warpAffine(
        crop,
        _at_centres(moved),
        size,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=fill,
    )
    return result


def crop_window(matrix: np.ndarray, shape: tuple[int, int], side: int) -> tuple[slice, slice]:
    """Rows and columns of the picture that the crop may show."""
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side]], float)
    seen = (corners - matrix[:, 2]) @ np.linalg.inv(matrix[:, :2]).T
    limits = shape[1], shape[0]
    low = np.clip(np.floor(seen.min(0)), 0, limits).astype(int)
    high = np.clip(np.ceil(seen.max(0)), low, limits).astype(int)
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _at_centres(matrix: np.ndarray) -> np.ndarray:
    """The same map for OpenCV, which counts from the middle of the first pixel."""
    moved = matrix.copy()
    moved[:, 2] += matrix[:, :2] @ [0.5, 0.5] - 0.5
    return moved


def picture_crop(image: np.ndarray, matrix: np.ndarray, side: int = SIDE) -> np.ndarray:
    """(side, side, 3) uint8 RGB crop of a picture."""
    return cropped(image, matrix, side, _FILL)


def box_crop(box: Sequence[float], matrix: np.ndarray, shape: tuple[int, int], side: int = SIDE):
    """(side, side) uint8: 255 inside the box (as far as it lies in the picture)."""
    height, width = shape
    x0, y0, x1, y1 = np.clip(box, 0, [width, height, width, height])
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    mask = np.zeros((side, side), np.uint8)
    placed = corners @ matrix[:, :2].T + matrix[:, 2] - 0.5
    cv2.fillConvexPoly(mask, np.round(placed * 16).astype(np.int32), 255, cv2.LINE_AA, 4)
    return mask


def extent_crop(extent: float | None, matrix: np.ndarray, side: int = SIDE) -> np.ndarray:
    """(side, side) uint8, the prompt where there is no box: how large a thing is looked for.

    Args:
        extent: its longer side in pixels of the picture; None when that is unknown.
        matrix: (2, 3) crop_from_image.

    One value everywhere: 0 for unknown, else half of the extent's share of the crop, so that it is
    never as bright as the inside of a box.
    """
    if extent is None:
        return np.zeros((side, side), np.uint8)
    scale = float(np.sqrt(abs(np.linalg.det(matrix[:, :2]))))
    share = np.clip(extent * scale / side, _SMALLEST, 1.0)
    return np.full((side, side), round(float(share) * 127), np.uint8)


def network_inputs(
    pictures: np.ndarray, boxes: np.ndarray, people: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Float inputs of the network.

    Args:
        pictures: (B, S, S, 3) uint8 RGB; boxes, people: (B, S, S) uint8, 255 = inside, = person;
            instead of a box, see :func:`extent_crop`.

    Returns:
        picture (B, 3, S, S) float32, BGR and normalised; prompt (B, 2, S, S) float32 in [0, 1].
    """
    bgr = (pictures[..., ::-1].astype(np.float32) - np.array(MEAN_BGR, np.float32)) / np.array(
        STD_BGR, np.float32
    )
    prompt = np.stack([boxes, people], axis=1).astype(np.float32) / 255
    return np.ascontiguousarray(bgr.transpose(0, 3, 1, 2)), prompt
