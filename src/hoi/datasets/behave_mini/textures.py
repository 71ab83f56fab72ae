"""Procedural textures: wood, cloth, plaster, tiles, carpet, pictures. sRGB, tileable enough.

Every function takes a generator and returns (SIZE, SIZE, 3) uint8.
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable

import cv2
import numpy as np

SIZE = 512


def fractal(rng: np.random.Generator, stretch: float = 1.0, low: int = 2, high: int = 8):
    """(SIZE, SIZE) float32 in [0, 1]: noise of all scales, drawn out `stretch` times along rows."""
    total = np.zeros((SIZE, SIZE), np.float32)
    for octave in range(low, high):
        rows = min(SIZE, 2**octave)
        columns = int(np.clip(2**octave / stretch, 2, SIZE))
        grain = rng.standard_normal((rows, columns)).astype(np.float32)
        total += cv2.resize(grain, (SIZE, SIZE), interpolation=cv2.INTER_CUBIC) * 0.62**octave
    total -= total.min()
    return total / total.max()


def _mix(share: np.ndarray, first, second) -> np.ndarray:
    share = np.clip(share, 0, 1)[..., None]
    return np.asarray(first) * (1 - share) + np.asarray(second) * share


def _finish(picture: np.ndarray) -> np.ndarray:
    return np.clip(picture, 0, 255).astype(np.uint8)


def hsv(rng: np.random.Generator, hue=(0.0, 1.0), saturation=(0.2, 0.8), value=(0.2, 0.9)):
    """A colour 0..255 drawn from ranges of hue, saturation and value."""
    h, s, v = (rng.uniform(*span) for span in (hue, saturation, value))
    return np.array(colorsys.hsv_to_rgb(h % 1.0, s, v)) * 255


def wood(rng: np.random.Generator, tone: np.ndarray | None = None) -> np.ndarray:
    if tone is None:
        tone = hsv(rng, (0.05, 0.1), (0.35, 0.65), (0.35, 0.8))
    grain = fractal(rng, 10.0, 3, 9)
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (grain * rng.uniform(2, 5) + fractal(rng, 6.0)))
    return _finish(_mix(0.35 * rings + 0.5 * grain, tone, np.asarray(tone) * 0.55))


def planks(rng: np.random.Generator) -> np.ndarray:
    base = wood(rng).astype(np.float32)
    count = int(rng.choice([4, 5, 6, 8]))
    height = SIZE // count
    for row in range(count):
        shift = int(rng.integers(SIZE))
        band = slice(row * height, (row + 1) * height)
        base[band] = np.roll(base[band], shift, axis=1) * rng.uniform(0.82, 1.12)
        base[row * height : row * height + 2] *= 0.5
        base[band, shift : shift + 2] *= 0.5
    return _finish(base)


def cloth(rng: np.random.Generator, tone: np.ndarray | None = None) -> np.ndarray:
    if tone is None:
        tone = hsv(rng, saturation=(0.1, 0.8), value=(0.1, 0.9))
    y, x = np.mgrid[:SIZE, :SIZE]
    weave = 0.5 + 0.25 * np.sin(x * np.pi / 2) + 0.25 * np.sin(y * np.pi / 2)
    return _finish(
        np.asarray(tone) * (0.86 + 0.14 * weave + 0.16 * (fractal(rng) - 0.5))[..., None]
    )


def denim(rng: np.random.Generator) -> np.ndarray:
    tone = hsv(rng, (0.58, 0.64), (0.35, 0.65), (0.2, 0.5))
    y, x = np.mgrid[:SIZE, :SIZE]
    twill = 0.5 + 0.5 * np.sin((x + y) * np.pi / 3)
    worn = fractal(rng, 0.4)
    return _finish(np.asarray(tone) * (0.7 + 0.2 * twill + 0.45 * worn)[..., None])


def striped(rng: np.random.Generator) -> np.ndarray:
    first = hsv(rng, saturation=(0.0, 0.7), value=(0.2, 0.95))
    second = hsv(rng, saturation=(0.0, 0.7), value=(0.1, 0.95))
    y, x = np.mgrid[:SIZE, :SIZE]
    along = x if rng.random() < 0.4 else y
    share = (np.sin(2 * np.pi * along * rng.integers(4, 16) / SIZE) > rng.uniform(-0.5, 0.5)) * 1.0
    if rng.random() < 0.35:  # plaid
        share = (share + (np.sin(2 * np.pi * (SIZE - x) * rng.integers(4, 12) / SIZE) > 0)) / 2
    return _finish(_mix(share, first, second) * (0.92 + 0.12 * fractal(rng))[..., None])


def wallpaper(rng: np.random.Generator) -> np.ndarray:
    """Soft stripes of two near tones."""
    tone = hsv(rng, saturation=(0.02, 0.25), value=(0.55, 0.9))
    x = np.mgrid[:SIZE, :SIZE][1]
    share = (np.sin(2 * np.pi * x * rng.integers(4, 10) / SIZE) > 0) * 1.0
    paper = _mix(share, tone, np.asarray(tone) * rng.uniform(0.8, 0.93))
    return _finish(paper * (0.95 + 0.1 * fractal(rng))[..., None])


def plaster(rng: np.random.Generator, tone: np.ndarray | None = None) -> np.ndarray:
    if tone is None:
        tone = hsv(rng, saturation=(0.0, 0.22), value=(0.62, 0.95))
    stain = fractal(rng, 1.0, 1, 4)
    grain = rng.standard_normal((SIZE, SIZE)).astype(np.float32)
    grain = cv2.GaussianBlur(grain, (0, 0), 1.2)
    return _finish(np.asarray(tone) * (0.95 + 0.08 * stain + 0.025 * grain)[..., None])


def carpet(rng: np.random.Generator) -> np.ndarray:
    tone = hsv(rng, saturation=(0.03, 0.32), value=(0.25, 0.7))
    tuft = cv2.GaussianBlur(rng.standard_normal((SIZE, SIZE)).astype(np.float32), (0, 0), 1.0)
    return _finish(np.asarray(tone) * (1.0 + 0.35 * tuft + 0.2 * (fractal(rng) - 0.5))[..., None])


def tiles(rng: np.random.Generator) -> np.ndarray:
    tone = hsv(rng, saturation=(0.0, 0.25), value=(0.4, 0.9))
    count = int(rng.choice([2, 3, 4]))
    cell = SIZE // count
    shade = cv2.resize(
        rng.uniform(0.88, 1.06, (count, count)).astype(np.float32), (SIZE, SIZE),
        interpolation=cv2.INTER_NEAREST,
    )  # fmt: skip
    picture = np.asarray(tone) * (shade * (0.92 + 0.16 * fractal(rng)))[..., None]
    joint = max(2, SIZE // 160)
    for line in range(0, SIZE, cell):
        picture[line : line + joint] *= 0.62
        picture[:, line : line + joint] *= 0.62
    return _finish(picture)


def bricks(rng: np.random.Generator) -> np.ndarray:
    tone = hsv(rng, (0.0, 0.08), (0.2, 0.6), (0.4, 0.8))
    picture = np.ones((SIZE, SIZE, 3)) * rng.uniform(150, 210)
    rows, height, width = 12, SIZE // 12, SIZE // 4
    for row in range(rows):
        for column in range(-1, 5):
            left = column * width + (width // 2 if row % 2 else 0)
            box = np.s_[
                row * height + 4 : (row + 1) * height, max(left + 4, 0) : max(left + width, 0)
            ]
            picture[box] = tone * rng.uniform(0.75, 1.1)
    return _finish(picture * (0.85 + 0.3 * fractal(rng))[..., None])


def painting(rng: np.random.Generator) -> np.ndarray:
    """A picture to hang: a made-up landscape or shapes."""
    share = np.linspace(0, 1, SIZE)[:, None] + 0.5 * (fractal(rng, 2.0, 1, 6) - 0.5)
    picture = _mix(share, hsv(rng), hsv(rng))
    ground = 0.4 * SIZE + 0.3 * SIZE * fractal(rng, 1.0, 1, 5)[0]
    below = np.arange(SIZE)[:, None] > ground
    picture[below] = _mix(fractal(rng), hsv(rng), hsv(rng))[below]
    for _ in range(int(rng.integers(0, 5))):
        centre = tuple(int(v) for v in rng.integers(0, SIZE, 2))
        cv2.circle(picture, centre, int(rng.integers(15, 90)), hsv(rng).tolist(), -1, cv2.LINE_AA)
    return _finish(picture)


def outdoors(rng: np.random.Generator) -> np.ndarray:
    """What a window shows: bright sky over blurred greenery."""
    share = np.linspace(0, 1, SIZE)[:, None] + np.zeros((SIZE, SIZE))
    picture = _mix(share, (200, 222, 250), (245, 248, 250))
    line = SIZE * (0.45 + 0.3 * fractal(rng, 1.0, 1, 6)[0])
    below = np.arange(SIZE)[:, None] > line
    picture[below] = _mix(fractal(rng), (105, 130, 85), (170, 180, 150))[below]
    return _finish(cv2.GaussianBlur(picture, (0, 0), 6))


def books(rng: np.random.Generator) -> np.ndarray:
    """Spines of books in a row."""
    picture, x = np.zeros((SIZE, SIZE, 3)), 0
    while x < SIZE:
        width = int(rng.integers(12, 40))
        top = int(rng.integers(0, SIZE // 4))
        tone = hsv(rng, saturation=(0.1, 0.8), value=(0.2, 0.9))
        picture[:, x : x + width] = 25
        picture[top:, x + 1 : x + width - 1] = tone
        label = int(rng.integers(SIZE // 3, SIZE // 2))
        picture[label : label + 40, x + 3 : x + width - 3] = tone * 0.4 + 130
        x += width
    return _finish(picture)


FLOORS: tuple[Callable[[np.random.Generator], np.ndarray], ...] = (planks, planks, carpet, tiles)
WALLS: tuple[Callable[[np.random.Generator], np.ndarray], ...] = (
    *(plaster,) * 6,
    bricks,
    wallpaper,
)
