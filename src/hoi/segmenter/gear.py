"""Generated things that people swing, wave and ride, for training scenes only.

The exemplar library (:mod:`hoi.exemplars.procedural`) has what the pipeline can fit; photos show
much more. These are shapes to learn outlines from: metres, y up, front +z. What has a handle holds
it at its lowest point.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hoi.exemplars.library import Exemplar
from hoi.exemplars.meshing import union_of_parts
from hoi.exemplars.procedural import LICENCE, SIDES, Parts
from hoi.exemplars.solids import ball, box, cushion, disc, ellipsoid, lathe, rod, tube

_VERTICES = 1000


def generate_gear(kind: str, number: int) -> Exemplar:
    """Thing number `number` of a kind, one of :data:`KINDS`."""
    rng = np.random.default_rng([number, *kind.encode()])
    mesh = union_of_parts(KINDS[kind](rng), _VERTICES)
    return Exemplar(f"{kind}_{number}", kind, *mesh, source="procedural", licence=LICENCE)


def _bat(rng: np.random.Generator) -> Parts:
    length, thick = rng.uniform(0.6, 1.1), rng.uniform(0.028, 0.036)
    grip = rng.uniform(0.3, 0.45) * length
    thin = rng.uniform(0.35, 0.5) * thick
    barrel = [(0, grip), (thin, grip), (thick, 0.7 * length), (thick, 0.97 * length), (0, length)]
    handle = [(0, 0), (1.6 * thin, 0), (1.6 * thin, 0.02), (thin, 0.03), (thin, grip), (0, grip)]
    return {"barrel": [lathe(barrel, 20)], "handle": [lathe(handle, 16)]}


def _racket(rng: np.random.Generator) -> Parts:
    handle, head = rng.uniform(0.15, 0.35), rng.uniform(0.22, 0.36)
    wide, bar = rng.uniform(0.7, 0.95) * head / 2, rng.uniform(0.008, 0.014)
    middle = handle + head / 2
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    hoop = [(wide * np.cos(a), middle + head / 2 * np.sin(a), 0) for a in around]
    parts: Parts = {
        "frame": [tube(hoop, bar, 6, closed=True)],
        "handle": [rod((0, 0, 0), (0, handle, 0), rng.uniform(0.012, 0.02))],
        "face": [],
    }
    if rng.random() < 0.5:  # strings, or the sheet that they look like from afar
        parts["face"] = [disc(1, 0.006).rotate((90, 0, 0)).scale((wide, head / 2, 1))
                         .translate((0, middle, 0))]  # fmt: skip
        return parts
    for share in np.linspace(-0.8, 0.8, int(rng.integers(5, 12))):
        reach = np.sqrt(1 - share**2)
        up, across = (reach * head / 2) * np.array([0, 1, 0]), (reach * wide) * np.array([1, 0, 0])
        column = np.array([share * wide, middle, 0])
        row = np.array([0, middle + share * head / 2, 0])
        parts["face"] += [rod(column - up, column + up, 0.0015, sides=4),
                          rod(row - across, row + across, 0.0015, sides=4)]  # fmt: skip
    return parts


def _umbrella(rng: np.random.Generator) -> Parts:
    length, radius = rng.uniform(0.7, 1.0), rng.uniform(0.4, 0.65)
    stick = [rod((0, 0, 0), (0, length, 0), 0.008)]
    if rng.random() < 0.2:  # furled
        furled = [(0, 0.2), (0.02, 0.22), (0.045, 0.6 * length), (0.012, 0.95 * length),
                  (0, length)]  # fmt: skip
        return {"stick": stick, "canopy": [lathe(furled, 10)]}
    deep, sides = rng.uniform(0.3, 0.6) * radius, int(rng.integers(6, 12))
    slope = np.linspace(0, 1, 6)
    inner = [(radius * s, length - 0.012 - deep * s**1.8) for s in slope]
    outer = [(radius * s, length - deep * s**1.8) for s in slope[::-1]]
    return {"stick": stick, "canopy": [lathe([*inner, *outer], sides)]}


def _frisbee(rng: np.random.Generator) -> Parts:
    radius, rim = rng.uniform(0.11, 0.15), rng.uniform(0.02, 0.035)
    profile = [(0, 0.8 * rim), (0.93 * radius, 0.7 * rim), (0.95 * radius, 0), (radius, 0),
               (radius, 0.5 * rim), (0.8 * radius, rim), (0, rim)]  # fmt: skip
    return {"disc": [lathe(profile, 28)]}


def _board(rng: np.random.Generator) -> Parts:
    """A snowboard or a longboard without wheels, lying along z."""
    length, width = rng.uniform(1.1, 1.7), rng.uniform(0.22, 0.32)
    waist, kick = rng.uniform(0.0, 0.15), rng.uniform(0.02, 0.1)

    def shape(points: np.ndarray) -> np.ndarray:
        shaped = np.array(points)
        t = np.abs(points[:, 2]) / (length / 2)
        shaped[:, 0] *= 1 - waist * (1 - t**2)
        shaped[:, 1] += kick * np.maximum(t - 0.7, 0) ** 2 / 0.09
        return shaped

    straight = length - width
    tail, nose = (disc(width / 2, 0.015, (0, 0, s * straight / 2)) for s in SIDES)
    plank = box((width, 0.015, straight)) + nose + tail
    bindings = [box((0.8 * width, 0.03, 0.12), (0, 0.02, s * 0.25)) for s in SIDES]
    return {
        "board": [plank.refine_to_length(0.08).warp_batch(shape)],
        "binding": bindings if rng.random() < 0.7 else [],
    }


def _motorcycle(rng: np.random.Generator) -> Parts:
    wheel, base = rng.uniform(0.27, 0.36), rng.uniform(0.62, 0.8)
    tyre = rng.uniform(0.05, 0.08)
    rim = [(wheel - tyre + tyre * np.cos(a), tyre * np.sin(a)) for a in np.arange(8) * np.pi / 4]
    ring = lathe(rim, 28).rotate((0, 0, 90))
    seat, top = rng.uniform(0.68, 0.85), rng.uniform(0.95, 1.15)
    wheels = [ring.translate((0, wheel, s * base)) for s in SIDES]
    for s in SIDES:
        hub = np.array([0, wheel, s * base])
        wheels.append(rod(hub - (0.06, 0, 0), hub + (0.06, 0, 0), 0.05))
        for angle in np.arange(5) * np.pi / 5:
            arm = (wheel - tyre) * np.array([0, np.sin(angle), np.cos(angle)])
            wheels.append(rod(hub - arm, hub + arm, 0.008, sides=4))
    engine = [box((0.34, 0.28, 0.42), (0, wheel + 0.08, -0.02))]
    engine += [rod((s * 0.1, wheel, 0.1), (s * 0.16, wheel, -base), 0.04) for s in SIDES]
    head = np.array([0, top - 0.1, 0.75 * base])
    forks = [rod((s * 0.09, wheel, base), head + (s * 0.09, 0, 0), 0.028) for s in SIDES]
    frame = [*forks, rod(head, (0, wheel + 0.15, 0.1), 0.04), rod((0, seat, -0.3), head, 0.035),
             rod((0, wheel, -base), (0, wheel + 0.1, -0.1), 0.04)]  # fmt: skip
    tank = [ellipsoid((0.3, 0.28, 0.55), (0, seat + 0.08, 0.22))]
    saddle = [cushion((0.26, 0.12, rng.uniform(0.5, 0.75)), (0, seat, -0.32), 0.05)]
    bar = rng.uniform(0.3, 0.42)
    steering = [tube([(-bar, top, 0.55 * base), (-0.12, top - 0.03, 0.7 * base),
                      (0.12, top - 0.03, 0.7 * base), (bar, top, 0.55 * base)], 0.016)]  # fmt: skip
    lamp = [ball(0.09, (0, top - 0.12, 0.75 * base + 0.1))]
    guards = [box((0.14, 0.02, 0.35), (0, 2 * wheel + 0.02, s * base)) for s in SIDES]
    fairing = [ellipsoid((0.42, 0.5, 0.35), (0, top - 0.2, 0.8 * base))]
    return {
        "wheel": wheels, "engine": engine, "frame": frame, "tank": tank, "seat": saddle,
        "handlebar": steering, "lamp": lamp, "guard": guards,
        "fairing": fairing if rng.random() < 0.3 else [],
    }  # fmt: skip


#: those with a handle at the bottom
SWUNG = ("bat", "racket", "umbrella")
KINDS: dict[str, Callable[[np.random.Generator], Parts]] = {
    "bat": _bat,
    "racket": _racket,
    "umbrella": _umbrella,
    "frisbee": _frisbee,
    "board": _board,
    "motorcycle": _motorcycle,
}
