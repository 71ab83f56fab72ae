"""What makes renders look like photos: real photos behind them, and a camera's faults."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np

#: photos under free licences that come with installed packages, as backgrounds
_PHOTOS = {
    "skimage": ("data/coffee.png", "data/chelsea.png", "data/rocket.jpg", "data/grass.png",
                "data/gravel.png", "data/brick.png"),
    "sklearn": ("datasets/images/china.jpg", "datasets/images/flower.jpg"),
}  # fmt: skip


def photographed(rng: np.random.Generator, crop: np.ndarray) -> np.ndarray:
    """A crop as some camera would have taken it: tone, colour, sharpness, noise, compression."""
    x = crop.astype(np.float32)
    if rng.random() < 0.8:
        x = 255 * np.clip(x / 255, 0, 1) ** np.float32(np.exp(rng.normal(0, 0.25)))
    if rng.random() < 0.8:
        mean = x.mean()
        x = (x - mean) * np.float32(np.exp(rng.normal(0, 0.2))) + mean + rng.normal(0, 18)
    if rng.random() < 0.5:
        x = x * np.exp(rng.normal(0, 0.07, 3)).astype(np.float32)
    if rng.random() < 0.6:
        grey = x.mean(2, keepdims=True)
        keep = rng.uniform(0.0, 0.3) if rng.random() < 0.15 else rng.uniform(0.3, 1.3)
        x = grey + (x - grey) * np.float32(keep)
    draw = rng.random()
    if draw < 0.25:
        x = cv2.GaussianBlur(x, (0, 0), rng.uniform(0.4, 1.8))
    elif draw < 0.4:
        size = x.shape[1::-1]
        share = rng.uniform(0.35, 0.8)
        small = cv2.resize(x, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
        x = cv2.resize(small, size)
    elif draw < 0.5:
        x = cv2.filter2D(x, -1, _smear(rng, x.shape[0]))
    elif draw < 0.62:
        x = x + rng.uniform(0.2, 0.8) * (x - cv2.GaussianBlur(x, (0, 0), 1.5))
    if rng.random() < 0.5:
        x = x + rng.standard_normal(x.shape, dtype=np.float32) * np.float32(rng.uniform(1, 14))
    result = np.clip(x, 0, 255).astype(np.uint8)
    if rng.random() < 0.5:
        flag = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(25, 95))]
        result = np.asarray(cv2.imdecode(cv2.imencode(".jpg", result, flag)[1], cv2.IMREAD_COLOR))
    return result


def _smear(rng: np.random.Generator, side: int) -> np.ndarray:
    """The kernel of something that moved while the shutter was open."""
    reach = max(round(side * rng.uniform(0.008, 0.025)), 1)
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    angle = rng.uniform(0, np.pi)
    along = np.round(reach * np.array([np.cos(angle), np.sin(angle)])).astype(int)
    cv2.line(kernel, (reach - along).tolist(), (reach + along).tolist(), 1.0)
    return kernel / kernel.sum()


@cache
def free_photos() -> list[np.ndarray]:
    """Those that are installed: (H, W, 3) uint8 RGB each."""
    found = []
    for package, names in _PHOTOS.items():
        spec = find_spec(package)
        if spec is None or spec.origin is None:
            continue
        for name in names:
            picture = cv2.imread(str(Path(spec.origin).parent / name))
            if picture is not None:
                found.append(picture[..., ::-1].copy())
    return found
