"""A furnished room around the pair: floor, walls, window, door, shelves, plants, light.

Nothing in it belongs to a class of the data set's objects (no chair, table, bag or keyboard), so
that a detector cannot mistake the background for the object.
"""

from __future__ import annotations

import numpy as np

from hoi.datasets.behave_mini import textures
from hoi.datasets.behave_mini.camera import Camera
from hoi.datasets.behave_mini.materials import Material, Scene, Surface
from hoi.datasets.behave_mini.staging import turn_y


def build_room(
    looks: np.random.Generator,
    rng: np.random.Generator,
    scene: Scene,
    camera: Camera,
    pair: np.ndarray,
) -> None:
    """Add a room to the scene.

    Args:
        looks: generator of what a sequence keeps (materials); `rng` of what a frame draws anew.
        pair: (N, 3) points of person, object and supports, which nothing else may touch.
    """
    forward = camera.rotation[2] * [1.0, 0.0, 1.0]
    turn = turn_y(np.arctan2(forward[0], forward[2]) + rng.uniform(-0.5, 0.5))
    inside = np.concatenate([pair, camera.position[None]]) @ turn  # room axes: z away from camera
    low = inside.min(0) - [rng.uniform(0.6, 2.2), 0.0, rng.uniform(0.4, 1.2)]
    high = inside.max(0) + [rng.uniform(0.6, 2.2), 0.0, rng.uniform(0.6, 2.2)]
    ceiling = looks.uniform(2.4, 2.9)
    floor = _textured(scene, looks, textures.FLOORS, (0.9, 2.2), gloss=0.08)
    wall = _textured(scene, looks, textures.WALLS, (1.2, 2.5))
    white = scene.material(Material((0.75,) * 3))
    trim = scene.material(Material((looks.uniform(0.3, 0.8),) * 3, gloss=0.1))
    size = high - low
    middle = (low + high) / 2
    scene.box(
        "room", (size[0] + 0.2, 0.1, size[2] + 0.2), (middle[0], -0.0505, middle[2]), floor, turn
    )
    scene.box("room", (size[0] + 0.2, 0.1, size[2] + 0.2), (middle[0], ceiling + 0.05, middle[2]),
              white, turn)  # fmt: skip
    walls = _walls(low, high)
    for centre, along, inward, length in walls:
        thick = np.abs(along) * (length + 0.2) + np.abs(inward) * 0.1 + [0, ceiling, 0]
        place = centre - inward * 0.05
        scene.box("room", thick, (place[0], ceiling / 2, place[2]), wall, turn)
        board = np.abs(along) * length + np.abs(inward) * 0.024 + [0, 0.08, 0]
        scene.box("room", board, (centre[0], 0.04, centre[2]), trim, turn)
    _furnish(looks, rng, scene, walls, ceiling, turn, trim, pair @ turn, camera.position @ turn)
    _light(rng, scene, low, high, ceiling, turn, pair)


def _textured(scene, looks, choices, tile, gloss=0.0) -> int:
    make = choices[int(looks.integers(len(choices)))]
    texture = scene.texture(make(looks))
    return scene.material(Material((1, 1, 1), texture, looks.uniform(*tile), gloss=gloss, shine=20))


def _walls(low: np.ndarray, high: np.ndarray):
    """Centre at floor level, direction along, direction inward and length of each wall."""
    middle, size = (low + high) / 2, high - low
    x, z = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    return [
        (np.array([middle[0], 0, high[2]]), x, -z, size[0]),
        (np.array([low[0], 0, middle[2]]), z, x, size[2]),
        (np.array([high[0], 0, middle[2]]), z, -x, size[2]),
        (np.array([middle[0], 0, low[2]]), x, z, size[0]),
    ]


def _furnish(looks, rng, scene, walls, ceiling, turn, trim, pair, eye) -> None:
    """Things along the walls and on them."""
    kinds = (
        _window,
        _door,
        _picture,
        _picture,
        _cabinet,
        _cabinet,
        _shelf,
        _plant,
        _lamp,
        _box_pile,
    )
    for centre, along, inward, length in walls[:3]:
        spots = np.arange(-length / 2 + 0.55, length / 2 - 0.4, 1.05)
        for spot in spots:
            if rng.random() < 0.3:
                continue
            kind = kinds[int(rng.integers(len(kinds)))]
            at = centre + along * (spot + rng.uniform(-0.15, 0.15))
            depth = 0.05 if kind in (_window, _door, _picture) else 0.5
            reach = at + inward * depth / 2
            room_for_it = np.linalg.norm((pair - reach)[:, [0, 2]], axis=1).min() > 0.35 + depth / 2
            if room_for_it and np.linalg.norm((eye - reach)[[0, 2]]) > 1.2:
                kind(looks, rng, scene, at, along, inward, ceiling, turn, trim)


def _oriented(along, inward, width, height, depth) -> np.ndarray:
    return np.abs(along) * width + np.abs(inward) * depth + np.array([0, height, 0])


def _window(looks, rng, scene, at, along, inward, ceiling, turn, trim) -> None:
    width, height, low = rng.uniform(0.7, 1.0), rng.uniform(0.9, 1.3), rng.uniform(0.8, 1.0)
    glass = scene.material(Material((1, 1, 1), scene.texture(textures.outdoors(rng)), 1.0,
                                    glow=rng.uniform(0.5, 1.1)))  # fmt: skip
    up = np.array([0, 1.0, 0])
    centre = at + up * (low + height / 2) + inward * 0.008
    scene.panel("room", turn @ centre, turn @ along * width / 2, up * height / 2, glass, (1.0, 1.0))
    for side in (-1, 0, 1):
        scene.box("room", _oriented(along, inward, 0.05, height, 0.05),
                  centre + along * side * width / 2, trim, turn)  # fmt: skip
    for side in (-1, 1):
        scene.box("room", _oriented(along, inward, width + 0.1, 0.06, 0.08),
                  centre + up * side * height / 2, trim, turn)  # fmt: skip


def _door(looks, rng, scene, at, along, inward, ceiling, turn, trim) -> None:
    leaf = scene.material(Material((1, 1, 1), scene.texture(textures.wood(rng)), 1.0, 0.1))
    centre = at + np.array([0, 1.0, 0])
    scene.box("room", _oriented(along, inward, 0.85, 2.0, 0.05), centre, leaf, turn)
    for side in (-1, 1):
        scene.box("room", _oriented(along, inward, 0.07, 2.06, 0.07),
                  at + along * side * 0.45 + np.array([0, 1.03, 0]), trim, turn)  # fmt: skip
    knob = scene.material(Material((0.4,) * 3, gloss=0.7))
    scene.box("room", _oriented(along, inward, 0.12, 0.02, 0.12), centre + along * 0.33, knob, turn)


def _picture(looks, rng, scene, at, along, inward, ceiling, turn, trim) -> None:
    width, height = rng.uniform(0.3, 0.9), rng.uniform(0.3, 0.7)
    up = np.array([0, 1.0, 0])
    centre = at + up * rng.uniform(1.3, 1.7) + inward * 0.03
    canvas = scene.material(Material((1, 1, 1), scene.texture(textures.painting(rng)), 1.0))
    frame = scene.material(Material((rng.uniform(0.02, 0.6),) * 3, gloss=0.2))
    scene.panel(
        "room", turn @ centre, turn @ along * width / 2, up * height / 2, canvas, (1.0, 1.0)
    )
    scene.box("room", _oriented(along, inward, width + 0.06, height + 0.06, 0.03),
              centre - inward * 0.018, frame, turn)  # fmt: skip


def _cabinet(looks, rng, scene, at, along, inward, ceiling, turn, trim) -> None:
    width, height, depth = rng.uniform(0.5, 1.0), rng.uniform(0.7, 2.0), rng.uniform(0.35, 0.5)
    wooden = scene.material(Material((1, 1, 1), scene.texture(textures.wood(rng)), 0.8, 0.08))
    body = wooden if rng.random() < 0.6 else scene.material(Material((rng.uniform(0.4, 0.8),) * 3))
    centre = at + inward * depth / 2 + np.array([0, height / 2, 0])
    scene.box("room", _oriented(along, inward, width, height, depth), centre, body, turn)
    handle = scene.material(Material((rng.uniform(0.05, 0.5),) * 3, gloss=0.5))
    gap = scene.material(Material((0.02,) * 3))
    drawers = int(rng.integers(2, 5))
    for drawer in range(drawers):
        y = (drawer + 0.5) / drawers * height
        face = at + inward * (depth + 0.005)
        scene.box(
            "room", _oriented(along, inward, 0.12, 0.015, 0.03), face + [0, y, 0], handle, turn
        )
        crack = np.array([0, drawer / drawers * height + 0.003, 0])
        scene.box("room", _oriented(along, inward, width * 0.98, 0.006, 0.004),
                  at + inward * depth + crack, gap, turn)  # fmt: skip


def _shelf(looks, rng, scene, at, along, inward, ceiling, turn, trim) -> None:
    width, height, depth = rng.uniform(0.6, 0.95), rng.uniform(1.2, 2.1), 0.28
    board = scene.material(Material((1, 1, 1), scene.texture(textures.wood(rng)), 0.8))
    spines = scene.material(Material((1, 1, 1), scene.texture(textures.books(rng)), 0.32))
    for side in (-1, 1):
        scene.box("room", _oriented(along, inward, 0.02, height, depth),
                  at + along * side * width / 2 + inward * depth / 2 + [0, height / 2, 0],
                  board, turn)  # fmt: skip
    levels = np.linspace(0.05, height, int(height / 0.34))
    for y, above in zip(levels, [*levels[1:], None], strict=True):
        scene.box("room", _oriented(along, inward, width, 0.02, depth),
                  at + inward * depth / 2 + [0, y, 0], board, turn)  # fmt: skip
        if above is not None and rng.random() < 0.8:
            tall, wide = (above - y) * rng.uniform(0.6, 0.85), width * rng.uniform(0.4, 0.95)
            place = at + inward * depth * 0.4 + [0, y + 0.01 + tall / 2, 0]
            size = _oriented(along, inward, wide, tall, depth * 0.7)
            scene.box("room", size, place, spines, turn)


def _plant(looks, rng, scene, at, along, inward, ceiling, turn, trim) -> None:
    pot_tone = (textures.hsv(rng, (0.02, 0.1), (0.1, 0.7), (0.3, 0.9)) / 255) ** 2.2
    pot = scene.material(Material(tuple(pot_tone), gloss=0.1))
    leaf_tone = (textures.hsv(rng, (0.22, 0.38), (0.4, 0.8), (0.2, 0.55)) / 255) ** 2.2
    leaf = scene.material(Material(tuple(leaf_tone), gloss=0.2))
    base = at + inward * 0.25
    scene.box("room", (0.26, 0.28, 0.26), base + [0, 0.14, 0], pot, turn)
    count, spread, tall = 90, rng.uniform(0.18, 0.3), rng.uniform(0.5, 1.0)
    cloud = rng.normal(0, 1, (count, 3)) * [spread / 1.5, tall / 4, spread / 1.5]
    centre = base + [0, 0.28 + tall / 2, 0] + cloud
    first = rng.normal(0, 1, (count, 3))
    first *= rng.uniform(0.06, 0.14, (count, 1)) / np.linalg.norm(first, axis=1, keepdims=True)
    second = rng.normal(0, 1, (count, 3)) * 0.03
    corners = np.stack([centre - first, centre + second, centre + first, centre - second], axis=1)
    vertices = corners.reshape(-1, 3) @ turn.T
    index = np.arange(count)[:, None] * 4
    faces = np.concatenate([index + [0, 1, 2], index + [0, 2, 3]])
    scene.surfaces.append(Surface("room", vertices, faces, vertices, np.full(len(faces), leaf)))


def _lamp(looks, rng, scene, at, along, inward, ceiling, turn, trim) -> None:
    height = rng.uniform(1.3, 1.7)
    pole = scene.material(Material((0.08,) * 3, gloss=0.4))
    shade = scene.material(Material((0.9, 0.85, 0.7), glow=rng.uniform(0.2, 0.7)))
    base = at + inward * 0.25
    scene.box("room", (0.03, height, 0.03), base + [0, height / 2, 0], pole, turn)
    scene.box("room", (0.25, 0.02, 0.25), base + [0, 0.01, 0], pole, turn)
    scene.box("room", (0.3, 0.28, 0.3), base + [0, height, 0], shade, turn)


def _box_pile(looks, rng, scene, at, along, inward, ceiling, turn, trim) -> None:
    y = 0.0
    for _ in range(int(rng.integers(1, 4))):
        tone = (textures.hsv(rng, (0.05, 0.12), (0.2, 0.5), (0.4, 0.8)) / 255) ** 2.2
        card = scene.material(Material(tuple(tone)))
        size = rng.uniform([0.25, 0.18, 0.25], [0.5, 0.35, 0.45])
        scene.box("room", size, at + inward * 0.27 + [0, y + size[1] / 2, 0], card, turn)
        y += size[1]


def _light(rng, scene, low, high, ceiling, turn, pair) -> None:
    """A ceiling lamp near the pair, or daylight from the side, and the room's own light."""
    middle = pair.mean(0)
    if rng.random() < 0.65:
        offset = rng.uniform(-1.3, 1.3, 2)
        inside = np.array([middle[0] + offset[0], ceiling - 0.12, middle[2] + offset[1]])
        local = np.clip(inside @ turn, low + 0.3, high - 0.3)
        scene.light = turn @ (local * [1, 0, 1]) + [0, ceiling - 0.12, 0]
        scene.light_radius = rng.uniform(0.15, 0.35)
        shade = scene.material(Material((0.9, 0.9, 0.88), glow=2.0))
        wide = 2 * scene.light_radius
        scene.box(
            "room", (wide, 0.03, wide), local * [1, 0, 1] + [0, ceiling - 0.015, 0], shade, turn
        )
        warmth = np.array([1.0, rng.uniform(0.88, 1.0), rng.uniform(0.72, 1.0)])
    else:
        local = np.array([rng.choice([low[0] + 0.2, high[0] - 0.2]), 1.6,
                          rng.uniform(low[2] + 0.4, high[2] - 0.4)])  # fmt: skip
        scene.light = turn @ local
        scene.light_radius = rng.uniform(0.4, 0.7)
        warmth = np.array([rng.uniform(0.9, 1.0), rng.uniform(0.95, 1.0), 1.0])
    scene.key = warmth * rng.uniform(0.7, 1.4)
    scene.ambient = np.array([1.0, rng.uniform(0.94, 1.0), rng.uniform(0.86, 1.04)])
    scene.ambient = scene.ambient * rng.uniform(0.5, 0.85)
