"""Physically sensible pairs: who touches what where, feet on the floor, nothing through anything.

World frame: y up, floor at y = 0, metres; the person faces +z. A stager proposes a pose and the
place of the object from one action's rules; :func:`stage` keeps the first proposal whose hands
reach, whose feet stand and in which body and object do not cut into each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hoi.body.skeleton import JOINT
from hoi.datasets.behave_mini import poses
from hoi.datasets.behave_mini.collision import Solid
from hoi.datasets.behave_mini.config import BehaveMiniConfig
from hoi.datasets.behave_mini.person import SIDES, Person, Pose
from hoi.datasets.behave_mini.reaching import (
    Aim,
    Balance,
    Clearance,
    Reach,
    Task,
    foot_on,
    hand_on,
    solve,
)
from hoi.datasets.behave_mini.things import Surface, Thing

UP, DOWN = np.array([0.0, 1.0, 0.0]), np.array([0.0, -1.0, 0.0])
_BODY_SINK = 0.03  # metres of flesh that a seat presses in


@dataclass(frozen=True)
class Box:
    """A plain support that belongs to neither person nor object: size and centre, metres."""

    size: tuple[float, float, float]
    centre: tuple[float, float, float]


@dataclass(frozen=True)
class Proposal:
    """One try: the pose, the object's place, and what must hold."""

    pose: Pose
    rotation: np.ndarray
    translation: np.ndarray
    grips: list[tuple[str, np.ndarray]] = field(default_factory=list)
    feet: str = "floor"  # floor | free
    sink: float | None = None  # allowed depth of the object in the body, metres
    loose_parts: tuple[str, ...] = ()  # straps lie on the body wherever the scan froze them
    supports: tuple[Box, ...] = ()


@dataclass(frozen=True, eq=False)
class Pair:
    """A staged person and object in world coordinates."""

    person: Person
    pose: Pose
    vertices: np.ndarray
    thing: Thing
    rotation: np.ndarray
    translation: np.ndarray
    object_vertices: np.ndarray
    supports: tuple[Box, ...]
    action: str


def stage(
    rng: np.random.Generator, person: Person, thing: Thing, action: str, config: BehaveMiniConfig
) -> Pair | None:
    """One try at an action; None when the proposal is not physically sensible."""
    stager = _STAGERS[(thing.mesh.category, action)]
    made = stager(_Try(rng, person, thing, config, action))
    if made is None:
        return None
    vertices, _ = person.skin(made.pose)
    object_vertices = thing.vertices @ made.rotation.T + made.translation
    plausible = (
        _hands_reach(person, made, config.reach_tolerance_m)
        and _feet_stand(person, vertices, made.feet)
        and object_vertices[:, 1].min() > -0.004
        and _apart(person, vertices, thing, object_vertices, made, config)
    )
    if not plausible:
        return None
    return Pair(
        person, made.pose, vertices, thing, made.rotation, made.translation, object_vertices,
        made.supports, action,
    )  # fmt: skip


# ---------------------------------------------------------------------------------- checks


def _hands_reach(person: Person, made: Proposal, tolerance: float) -> bool:
    from hoi.datasets.behave_mini.person import forward_kinematics

    turned, placed = forward_kinematics(
        person.rest_joints, made.pose.root[None], made.pose.rotations[None]
    )
    for side, target in made.grips:
        j = JOINT[f"{side}_wrist"]
        palm = placed[0, j] + turned[0, j] @ person.palm(side)
        if np.linalg.norm(palm - target) > tolerance:
            return False
    return True


def _feet_stand(person: Person, vertices: np.ndarray, feet: str) -> bool:
    lowest = [vertices[person.parts[f"{side}_foot"], 1].min() for side in SIDES]
    if feet == "free":
        return min(lowest) > -0.012
    return min(lowest) > -0.03 and min(lowest) < 0.02 and max(lowest) < 0.12


def _apart(
    person: Person,
    vertices: np.ndarray,
    thing: Thing,
    object_vertices: np.ndarray,
    made: Proposal,
    config: BehaveMiniConfig,
) -> bool:
    """Neither object in body nor body in object, nor either in a support, beyond pressed flesh."""
    limit = config.max_depth_m if made.sink is None else made.sink
    firm = thing.part(*(n for n in thing.mesh.part_names if n not in made.loose_parts))
    points = firm.points @ made.rotation.T + made.translation
    near = ((points > vertices.min(0)) & (points < vertices.max(0))).all(1)
    if near.any():
        depth = Solid(vertices, person.faces).depth(points[near])
        if depth.max() > limit or (depth > 0.015).sum() / len(points) > config.max_inside_share:
            return False
    body = vertices[_coarse(person)]
    near = ((body > object_vertices.min(0)) & (body < object_vertices.max(0))).all(1)
    if near.any() and not made.loose_parts:
        depth = Solid(object_vertices, thing.faces).depth(body[near])
        if depth.max() > limit + 0.01:
            return False
    for box in made.supports:
        low, high = np.array(box.centre) - np.array(box.size) / 2, None
        high = low + np.array(box.size)
        for cloud, slack in ((vertices, _BODY_SINK), (object_vertices, 0.006)):
            inside = np.minimum(cloud - low, high - cloud).min(1)
            if inside.max() > slack:
                return False
    return True


def _coarse(person: Person) -> np.ndarray:
    return np.arange(0, len(person.rest_vertices), 3)


# ------------------------------------------------------------------------------ one try's tools


def turn_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def turn_x(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def turn_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


@dataclass(frozen=True, eq=False)
class _Try:
    """Everything a stager works with."""

    rng: np.random.Generator
    person: Person
    thing: Thing
    config: BehaveMiniConfig
    action: str

    def uniform(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def choose(self, *options):
        return options[int(self.rng.integers(len(options)))]

    def base(self, choices: tuple[np.ndarray, ...]) -> np.ndarray:
        return poses.pick(self.rng, choices, self.config.pose_jitter_rad)

    def standing(self, choices: tuple[np.ndarray, ...], slack: float = 1.0):
        """A standing start with its lower foot on the floor, and the tasks that keep it standing.

        Args:
            slack: below 1 lets the trunk leave its place above the feet (pushing, pulling).
        """
        rotations = self.base(choices)
        pose = Pose(np.zeros(3), rotations)
        vertices, joints = self.person.skin(pose)
        floor = min(vertices[self.person.parts[f"{s}_foot"], 1].min() for s in SIDES)
        joints = joints - [0.0, floor, 0.0]
        pose = Pose(np.array([0.0, -floor, 0.0]), rotations)
        tasks: list[Task] = [Clearance(self.person.height / 1.7)]
        ankles = []
        for side in SIDES:
            sign = 1.0 if side == "left" else -1.0
            x, _, z = joints[JOINT[f"{side}_ankle"]]
            x = sign * float(np.clip(sign * x, 0.07, 0.3))
            ankles.append((x, z))
            tasks += foot_on(self.person, side, x, z, turn_out=self.uniform(0.0, 0.3))
        middle = np.mean(ankles, axis=0) + [0.0, 0.05]
        tasks.append(Balance(middle, 1.5 * slack))
        # stand so that the middle of the feet is the origin
        return pose, tasks, middle

    def hold(self, grips, aim: float = 0.5, curl: tuple[float, float] = (0.2, 0.7)) -> list[Task]:
        """Tasks of hands on (side, point, outward normal) triples."""
        return [t for side, p, n in grips for t in hand_on(self.person, side, p, n, aim)]

    def reach(self, pose: Pose, tasks: list[Task], grips, curl: float = 0.4) -> Pose:
        """Solve, then close the fingers of the hands that hold."""
        solved = solve(self.person, pose, tasks)
        rotations = solved.rotations.copy()
        for side, *_ in grips:
            poses.curl_fingers(rotations, side, self.uniform(0.5, 1.2) * curl)
        for side in SIDES:
            if side not in [g[0] for g in grips]:
                poses.curl_fingers(rotations, side, self.uniform(0.1, 0.5))
        return Pose(solved.root, np.round(rotations, 6))

    def on_floor(self, rotation: np.ndarray, x: float = 0.0, z: float = 0.0) -> np.ndarray:
        """Translation that lets the turned object stand on the floor at (x, z)."""
        return np.array([x, -(self.thing.vertices @ rotation.T)[:, 1].min(), z])


def _by_height(height: float) -> tuple[np.ndarray, ...]:
    """Poses whose hands are roughly at this height without much reaching."""
    if height < 0.45:
        return poses.SQUAT + poses.STOOP
    if height < 0.68:
        return poses.STOOP
    if height < 0.95:
        return poses.LEAN + poses.LIFT
    if height < 1.25:
        return poses.LIFT
    return poses.RAISE


# ------------------------------------------------------------------------------------ sitting


@dataclass(frozen=True)
class _Seat:
    """Where to sit, in world coordinates with the sitter facing +z."""

    height: float
    front: float  # z of the front edge
    middle: float  # x
    backrest: Surface | None


def _sit(t: _Try, seat: _Seat, rotation: np.ndarray, translation: np.ndarray) -> Proposal | None:
    """Bottom on the seat, feet on the floor or hanging, hands somewhere people keep them."""
    rising = t.action == "sitstand"
    person, rotations = t.person, t.base(poses.RISE if rising else poses.SIT)
    lift = t.uniform(0.06, 0.26) if rising else 0.0
    depth = t.uniform(0.02, 0.12) if rising else t.uniform(0.10, 0.22)
    knee = person.rest_joints[JOINT["left_knee"]][1] - person.rest_vertices[:, 1].min()
    dangle = not rising and seat.height > knee + 0.12
    if rising and seat.height > knee + 0.2:
        return None
    root = np.array([seat.middle + t.rng.normal(0, 0.015), seat.height + 0.1 + lift, 0.0])
    root[2] = seat.front - depth
    feet: list[Task] = []
    if not dangle:
        ahead = t.uniform(0.1, 0.24) if rising else t.uniform(0.24, 0.42)
        spread = t.uniform(0.08, 0.2)
        for side, sign in zip(SIDES, (1, -1), strict=True):
            z = seat.front - 0.14 + ahead + t.uniform(-0.07, 0.07)
            x = root[0] + sign * (spread + t.uniform(-0.03, 0.03))
            feet += foot_on(person, side, x, z, turn_out=t.uniform(0, 0.35))
    pose = Pose(root, rotations)
    upright = _upright(t, 0.12) if seat.backrest is None and not rising else []
    lean_back = not rising and seat.backrest is not None and t.chance(0.75)
    gap = t.uniform(-0.004, 0.01)
    for _ in range(3):  # the flesh decides where the pelvis ends up: measure, correct
        keep = [Reach("pelvis", root, weight=30.0), Clearance(person.height / 1.7), *feet, *upright]
        pose = solve(person, Pose(root, rotations), keep, 0.0, 0.25)
        vertices, _ = person.skin(pose)
        bottom = np.percentile(vertices[person.parts["butt"], 1], 5)
        change = np.array([0.0, seat.height + lift - 0.012 - bottom, 0.0])
        if lean_back and seat.backrest is not None:
            change[2] = _behind(vertices[person.parts["back"]], seat.backrest) + gap
            change[2] = np.clip(root[2] + change[2], seat.front - 0.4, seat.front - 0.04) - root[2]
        root = root + change
        if np.abs(change).max() < 0.003:
            break
    grips = _sitting_hands(t, pose, rotation, translation, rising)
    tasks: list[Task] = [Reach("pelvis", pose.root, weight=40.0), *feet, *upright]
    tasks.append(Clearance(person.height / 1.7))
    pose = t.reach(pose, tasks + t.hold(grips, 0.4), grips, 0.25)
    return Proposal(
        pose, rotation, translation, [(s, p) for s, p, _ in grips],
        feet="free" if dangle else "floor", sink=0.05,
    )  # fmt: skip


def _upright(t: _Try, lean: float) -> list[Task]:
    """The trunk stands up by itself, leaning forward by about `lean` radians."""
    angle = lean + t.rng.normal(0.0, 0.08)
    up = np.array([0.0, np.cos(angle), np.sin(angle)])
    return [Aim("spine2", UP, up, 2.5), Aim("pelvis", UP, np.array([0.0, 1.0, 0.0]), 1.2)]


def _behind(back: np.ndarray, backrest: Surface) -> float:
    """How far forward (+z) the back must move so that it just touches the backrest."""
    best = -np.inf
    for low in np.arange(backrest.points[:, 1].min(), backrest.points[:, 1].max(), 0.05):
        rest = backrest.points[np.abs(backrest.points[:, 1] - low) < 0.05]
        skin = back[np.abs(back[:, 1] - low) < 0.05]
        if len(rest) > 2 and len(skin) > 2:
            central = rest[np.abs(rest[:, 0] - skin[:, 0].mean()) < 0.16]
            if len(central) > 2:
                best = max(best, np.percentile(central[:, 2], 92) - skin[:, 2].min())
    return float(best) if np.isfinite(best) else 0.0


def _sitting_hands(t: _Try, pose: Pose, rotation, translation, rising: bool):
    """Grips (side, point, outward normal) of a sitter: thighs, knees, arm rests, seat, or none."""
    vertices, joints = t.person.skin(pose)
    options = ["thighs", "thighs", "knees", "free"] if not rising else ["thighs", "knees", "free"]
    arms = t.thing.part("chair_arm").moved(rotation, translation)
    if len(arms.points) > 40:
        options += ["armrests"] * 3
    if not rising:
        options += ["seat_sides"]
    kinds = [t.choose(*options)] * 2 if t.chance(0.7) else [t.choose(*options) for _ in SIDES]
    grips = []
    for side, kind in zip(SIDES, kinds, strict=True):
        sign = 1.0 if side == "left" else -1.0
        hip, knee = joints[JOINT[f"{side}_hip"]], joints[JOINT[f"{side}_knee"]]
        if kind in ("thighs", "knees"):
            share = t.uniform(0.45, 0.75) if kind == "thighs" else t.uniform(0.85, 1.0)
            along = hip + share * (knee - hip)
            skin = vertices[t.person.parts[f"{side}_leg"]]
            near = skin[np.linalg.norm((skin - along)[:, [0, 2]], axis=1) < 0.05]
            if len(near):
                grips.append((side, np.array([along[0], near[:, 1].max() + 0.004, along[2]]), UP))
        elif kind == "armrests":
            mine = arms.where(sign * (arms.points[:, 0] - translation[0]) > 0.05)
            if len(mine.points) > 10:
                ahead = mine.points[:, 2].min() + t.uniform(0.55, 0.9) * np.ptp(mine.points[:, 2])
                target = np.array([mine.points[:, 0].mean(), 0.0, ahead])
                point, _ = mine.furthest(UP, target, 2.0)
                grips.append((side, point, UP))
        elif kind == "seat_sides":
            seat = _seat_surface(t.thing).moved(rotation, translation)
            near = joints[JOINT[f"{side}_hip"]] + [sign * 0.2, 0.0, 0.05]
            point, _ = seat.furthest([sign, 0, 0], near, 1.5)
            grips.append((side, point, np.array([sign * 0.8, 0.6, 0.0])))
    return grips


def _seat_surface(thing: Thing) -> Surface:
    surface = thing.part("chair_seat", "tabletop")
    return surface.where(surface.normals[:, 1] > 0.7)


def _sit_on_chair(t: _Try) -> Proposal | None:
    rotation = (
        turn_y(t.rng.normal(0, 0.06))
        if t.thing.has("chair_back")
        else turn_y(t.uniform(-np.pi, np.pi))
    )
    translation = t.on_floor(rotation)
    top = _seat_surface(t.thing).moved(rotation, translation)
    if len(top.points) < 10:
        return None
    # the plane one sits on: the upper skin of the seat's middle
    centre = np.median(top.points, axis=0)
    central = np.linalg.norm((top.points - centre)[:, [0, 2]], axis=1) < 0.15
    height = float(np.percentile(top.points[central, 1], 60))
    flat = top.points[np.abs(top.points[:, 1] - height) < 0.05]
    back = t.thing.part("chair_back").moved(rotation, translation)
    front_facing = back.where(back.points[:, 1] > height + 0.06)
    backrest = front_facing if len(front_facing.points) > 30 else None
    seat = _Seat(height, float(np.percentile(flat[:, 2], 97)), float(centre[0]), backrest)
    return _sit(t, seat, rotation, translation)


def _sit_on_table(t: _Try) -> Proposal | None:
    rotation = turn_y(t.choose(0, 1, 2, 3) * np.pi / 2 + t.rng.normal(0, 0.06))
    translation = t.on_floor(rotation)
    top = _seat_surface(t.thing).moved(rotation, translation)
    if len(top.points) < 10:
        return None
    height = float(np.percentile(top.points[:, 1], 70))
    middle = float(np.median(top.points[:, 0]) + t.rng.normal(0, 0.05))
    near = top.points[np.abs(top.points[:, 0] - middle) < 0.15]
    seat = _Seat(height, float(np.percentile(near[:, 2], 98)), middle, None)
    return _sit(t, seat, rotation, translation)


# ----------------------------------------------------------------------- a hand on furniture


def _hand_on_chair(t: _Try) -> Proposal | None:
    """Standing by a chair with one hand or both on its back, an arm rest or the stool's seat."""
    thing = t.thing
    kinds = ["back"] * 6 if thing.has("chair_back") else ["seat"] * 3
    kinds += ["arm"] if thing.has("chair_arm") else []
    kind = t.choose(*kinds)
    surface = {
        "back": thing.part("chair_back", "chair_head"),
        "arm": thing.part("chair_arm"),
        "seat": _seat_surface(thing),
    }[kind]
    low, high = surface.points.min(0), surface.points.max(0)
    both = t.chance(0.35) and kind != "arm"
    approach = t.choose("behind", "beside", "front") if not both else t.choose("behind", "front")
    sign = t.choose(-1.0, 1.0)
    yaw = {
        "behind": t.rng.normal(0, 0.3),
        "beside": sign * np.pi / 2 + t.rng.normal(0, 0.3),
        "front": np.pi + t.rng.normal(0, 0.3),
    }[approach]
    rotation = turn_y(yaw)
    spread = t.uniform(0.3, 0.45) * (high[0] - low[0])
    wanted = [spread, -spread] if both else [t.uniform(-0.35, 0.35) * (high[0] - low[0])]
    tops = [
        surface.furthest(UP, np.array([x, 0.0, t.uniform(low[2], high[2])]), 0.7) for x in wanted
    ]
    sites = [(rotation @ p, rotation @ n) for p, n in tops]
    lift = t.on_floor(rotation)[1]
    pose, tasks, middle = t.standing(_by_height(sites[0][0][1] + lift))
    centre = np.mean([s[0] for s in sites], axis=0)
    aside = 0.0 if both else -sign * t.uniform(0.12, 0.38)
    at = np.array([middle[0] + aside, 0.0, middle[1] + t.uniform(0.2, 0.5)])
    translation = at - centre
    translation[1] = lift
    sides = ("left", "right") if both else (("left",) if aside > 0 else ("right",))
    placed = sorted(((p + translation, n) for p, n in sites), key=lambda s: -s[0][0])
    grips = [(side, p + [0, 0.004, 0], UP) for side, (p, _) in zip(sides, placed, strict=True)]
    pose = t.reach(pose, tasks + t.hold(grips, 0.35), grips, 0.7)
    return Proposal(pose, rotation, translation, [(s, p) for s, p, _ in grips])


def _hand_on_table(t: _Try) -> Proposal | None:
    """Standing at a table with one palm or both on its top."""
    rotation = turn_y(t.choose(0, 1, 2, 3) * np.pi / 2 + t.rng.normal(0, 0.12))
    lift = t.on_floor(rotation)[1]
    top = _seat_surface(t.thing).moved(rotation, np.array([0, lift, 0]))
    if len(top.points) < 10:
        return None
    height = float(np.percentile(top.points[:, 1], 70))
    edge, width = top.points[:, 2].min(), np.ptp(top.points[:, 0])
    pose, tasks, middle = t.standing(_by_height(height + 0.1))
    away = t.uniform(0.14, 0.3) + max(0.0, 0.75 - height) * 0.25
    shift = np.array([middle[0] + t.uniform(-0.25, 0.25) * width, lift, middle[1] + away - edge])
    sides = SIDES if t.chance(0.5) else (t.choose(*SIDES),)
    grips = []
    for side in sides:
        sign = 1.0 if side == "left" else -1.0
        x = middle[0] + sign * t.uniform(0.12, 0.28)
        near = np.array([x, 0.0, middle[1] + away + t.uniform(0.05, 0.16)])
        on_top = top.moved(np.eye(3), shift - [0, lift, 0])
        point, _ = on_top.where(on_top.points[:, 1] > height - 0.02).furthest(UP, near, 3.0)
        grips.append((side, point + [0, 0.004, 0], UP))
    pose = t.reach(pose, tasks + t.hold(grips, 1.2), grips, 0.1)
    return Proposal(pose, rotation, shift, [(s, p) for s, p, _ in grips])


# ----------------------------------------------------------------- lifting and carrying things


def _carried(
    t: _Try, rotation: np.ndarray, sites, height: float, ahead: float, sink: float | None = None
) -> Proposal | None:
    """Held with both hands at two canonical (point, outward normal) sites in front of the body.

    Args:
        height: of the object's lowest point above the floor, metres.
        ahead: of the middle of the grips in front of the chest, metres.
    """
    grips = [(rotation @ p, rotation @ n) for p, n in sites]
    grips.sort(key=lambda g: -g[0][0])
    translation = np.array([0.0, height, 0.0]) + t.on_floor(rotation)
    middle = np.mean([g[0] for g in grips], axis=0)
    pose, tasks, _ = t.standing(_by_height(middle[1] + translation[1]))
    chest = t.person.skin(pose)[1][JOINT["spine3"]]
    translation[0] = chest[0] + t.rng.normal(0, 0.04) - middle[0]
    translation[2] = chest[2] + ahead - middle[2]
    held = [(side, p + translation, n) for side, (p, n) in zip(SIDES, grips, strict=True)]
    pose = t.reach(pose, tasks + t.hold(held, 0.5), held, 0.9)
    return Proposal(pose, rotation, translation, [(s, p) for s, p, _ in held], sink=sink)


def _chair_grips(t: _Try):
    thing = t.thing
    seat, back = thing.part("chair_seat"), thing.part("chair_back", "chair_head")
    low, high = seat.points.min(0), seat.points.max(0)
    level = (low + high) / 2
    front_back = t.chance(0.5)
    sides = [
        seat.furthest([s, 0, 0], level + [0, 0, t.uniform(-0.08, 0.08)], 1.0) for s in (1.0, -1.0)
    ]
    if not thing.has("chair_back"):
        if front_back:
            sides = [seat.furthest([0, 0, s], level, 1.0) for s in (1.0, -1.0)]
        return sides, np.pi / 2 if front_back else 0.0
    top, bottom = back.points[:, 1].max(), level[1]
    height = bottom + t.uniform(0.45, 0.85) * (top - bottom)
    kinds = ["back sides", "back sides", "seat sides", "back and seat"]
    kinds += ["arms"] * 2 if thing.has("chair_arm") else []
    kind = t.choose(*kinds)
    if kind == "arms":
        arms = thing.part("chair_arm")
        ahead = np.array([0, 0, arms.points[:, 2].mean() + t.uniform(-0.05, 0.1)])
        halves = [arms.where(s * arms.points[:, 0] > 0) for s in (1.0, -1.0)]
        if min(len(h.points) for h in halves) > 5:
            return [(h.furthest(UP, h.points.mean(0) * [1, 1, 0] + ahead, 1.0)[0], UP)
                    for h in halves], 0.0  # fmt: skip
        kind = "seat sides"
    if kind == "back sides":
        near = np.array([0.0, height, back.points[:, 2].mean()])
        return [back.furthest([s, 0, 0], near, 1.0) for s in (1.0, -1.0)], 0.0
    if kind == "back and seat":
        upper, _ = back.furthest(UP, np.array([0, 0, back.points[:, 2].mean()]), 0.7)
        lower, _ = seat.furthest([0, 0, 1], level, 1.0)
        return [(upper, UP), (lower, np.array([0.0, -0.8, 0.6]))], np.pi / 2
    return sides, 0.0


def _lift_chair(t: _Try) -> Proposal | None:
    high = t.action == "liftreal"
    sites, across = _chair_grips(t)
    yaw = across + t.choose(0.0, np.pi) + t.rng.normal(0, 0.3)
    tilt = t.uniform(-0.3, 0.9) if high else t.uniform(-0.2, 0.45)
    rotation = turn_x(tilt * t.choose(-1.0, 1.0)) @ turn_y(yaw) @ turn_z(t.rng.normal(0, 0.12))
    height = t.uniform(0.3, 0.85) if high else t.uniform(0.04, 0.45)
    return _carried(t, rotation, sites, height, t.uniform(0.25, 0.55))


def _lift_table(t: _Try) -> Proposal | None:
    """A table held at two opposite edges, or one side of it raised with the far legs standing."""
    quarter = t.choose(0, 1, 2, 3) * np.pi / 2
    turned = turn_y(quarter)
    top = t.thing.part("tabletop").moved(turned)
    low, high = top.points.min(0), top.points.max(0)
    level = (low + high) / 2
    if high[0] - low[0] < 0.85 and t.chance(0.7):
        near = level + [0, 0, t.uniform(-0.15, 0.0)]
        sites = [top.furthest([s, 0, 0], near, 1.0) for s in (1.0, -1.0)]
        rotation = turn_x(t.uniform(-0.25, 0.25)) @ turn_y(t.rng.normal(0, 0.15))
        height, ahead = t.uniform(0.04, 0.45), t.uniform(0.28, 0.5)
    else:
        spread = min(0.3, 0.4 * (high[0] - low[0]))
        sites = [
            (
                top.furthest([0, 0, -1], level + [s * spread, 0, 0], 1.0)[0],
                np.array([0, -0.8, -0.6]),
            )
            for s in (1.0, -1.0)
        ]
        rotation = turn_x(t.uniform(0.08, 0.4)) @ turn_y(t.rng.normal(0, 0.1))
        height, ahead = (0.0 if t.chance(0.6) else t.uniform(0.03, 0.3)), t.uniform(0.2, 0.42)
    canonical = [(turned.T @ p, turned.T @ n) for p, n in sites]
    return _carried(t, rotation @ turned, canonical, height, ahead)


def _move_table(t: _Try) -> Proposal | None:
    """Pushing or pulling a table that stands on the floor, both hands at its near edge."""
    rotation = turn_y(t.choose(0, 1, 2, 3) * np.pi / 2 + t.rng.normal(0, 0.15))
    lift = t.on_floor(rotation)[1]
    top = t.thing.part("tabletop").moved(rotation, np.array([0, lift, 0]))
    low, high = top.points.min(0), top.points.max(0)
    spread = min(t.uniform(0.16, 0.3), 0.42 * (high[0] - low[0]))
    pose, tasks, feet = t.standing(poses.PUSH if t.chance(0.75) else poses.LEAN, 0.35)
    shoulders = t.person.skin(pose)[1][JOINT["spine3"]]
    ahead = shoulders[2] + t.uniform(0.15, 0.42)
    shift = np.array([feet[0] - (low[0] + high[0]) / 2 + t.rng.normal(0, 0.04), lift,
                      ahead - low[2]])  # fmt: skip
    placed = top.moved(np.eye(3), shift - [0, lift, 0])
    middle = (placed.points.min(0) + placed.points.max(0)) / 2
    grips = []
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        near = middle + [sign * spread, 0.02, 0]
        point, _ = placed.furthest([0, 0.3, -0.95], near, 1.0)
        grips.append((side, point, np.array([0.0, 0.8, -0.6])))
    pose = t.reach(pose, tasks + t.hold(grips, 0.5), grips, 0.5)
    return Proposal(pose, rotation, shift, [(s, p) for s, p, _ in grips])


# ------------------------------------------------------------------------------------- bags


def _hanging(t: _Try, part: Surface, rotation: np.ndarray, choices) -> Proposal | None:
    """Carried at one side by its handle, the arm nearly straight."""
    side = t.choose(*SIDES)
    sign = 1.0 if side == "left" else -1.0
    handle, _ = part.furthest(UP, part.points.mean(0), 0.5)
    pose, tasks, feet = t.standing(choices)
    wrist = t.person.skin(pose)[1][JOINT[f"{side}_wrist"]]
    width = np.abs((t.thing.vertices @ rotation.T)[:, 0]).max()
    at = np.array([sign * (0.2 + width + t.uniform(0.0, 0.1)), wrist[1] - t.uniform(0.02, 0.1),
                   feet[1] + t.uniform(-0.12, 0.15)])  # fmt: skip
    at[0] = sign * min(sign * at[0], 0.5)
    translation = at - rotation @ handle
    short = -((t.thing.vertices @ rotation.T)[:, 1].min() + translation[1])
    if short > -0.02:  # too long to hang from a straight arm: bend it
        translation[1] += short + t.uniform(0.02, 0.12)
    grips = [(side, rotation @ handle + translation, UP * 0.3 + [sign, 0, 0])]
    pose = t.reach(pose, tasks + t.hold(grips, 0.15), grips, 1.3)
    return Proposal(pose, rotation, translation, [(s, p) for s, p, _ in grips],
                    loose_parts=("shoulder_strap",))  # fmt: skip


def _worn_backpack(t: _Try) -> Proposal | None:
    """On the back: the side of the straps touches it, straps lie around the shoulders."""
    pose, tasks, _ = t.standing(poses.WORN)
    pose = t.reach(pose, tasks, [])
    from hoi.datasets.behave_mini.person import forward_kinematics

    turned, _ = forward_kinematics(t.person.rest_joints, pose.root[None], pose.rotations[None])
    trunk = turned[0, JOINT["spine2"]]
    rotation = trunk @ turn_x(t.rng.normal(0, 0.05)) @ turn_y(np.pi + t.rng.normal(0, 0.06))
    vertices, joints = t.person.skin(pose)
    shoulder = (joints[JOINT["left_shoulder"]] + joints[JOINT["right_shoulder"]]) / 2
    body = t.thing.part("bag_body").moved(rotation)
    along = body.points @ trunk[:, 1]
    translation = trunk[:, 1] * (shoulder @ trunk[:, 1] - t.uniform(-0.03, 0.07) - along.max())
    middle = vertices[t.person.parts["back"]].mean(0)
    across = body.points @ trunk[:, 0]
    translation = translation + trunk[:, 0] * (
        middle @ trunk[:, 0] + t.rng.normal(0, 0.01) - (across.max() + across.min()) / 2
    )
    # slide it along the chest axis until the bag touches the back
    forward = trunk[:, 2]
    bag, back = body.points + translation, vertices[t.person.parts["back"]]
    touch = np.inf
    for level in np.arange(-0.25, 0.26, 0.05):
        centre = (bag @ trunk[:, 1]).mean() + level
        slab = bag[np.abs(bag @ trunk[:, 1] - centre) < 0.03]
        skin = back[np.abs(back @ trunk[:, 1] - centre) < 0.04]
        if len(slab) > 3 and len(skin) > 3:
            touch = min(touch, (skin @ forward).min() - (slab @ forward).max())
    if not np.isfinite(touch):
        return None
    translation = translation + forward * (touch + t.uniform(-0.002, 0.012))
    return Proposal(pose, rotation, translation, loose_parts=("shoulder_strap", "handle"))


def _backpack_in_hand(t: _Try) -> Proposal | None:
    """By its top handle at one side, or held up in front with both hands."""
    if t.chance(0.65):
        handle = t.thing.part("handle") if t.thing.has("handle") else t.thing.part("bag_body")
        return _hanging(t, handle, turn_y(t.choose(-1, 1) * np.pi / 2 + t.rng.normal(0, 0.35)),
                        poses.STAND + poses.WALK)  # fmt: skip
    body = t.thing.part("bag_body")
    level = body.points.mean(0) + [0, t.uniform(-0.08, 0.12), 0]
    sites = [body.furthest([s, 0, 0], level, 1.0) for s in (1.0, -1.0)]
    rotation = turn_x(t.rng.normal(0, 0.2)) @ turn_y(t.choose(0.0, np.pi) + t.rng.normal(0, 0.3))
    made = _carried(t, rotation, sites, t.uniform(0.55, 0.95), t.uniform(0.3, 0.48))
    return made and _loose(made, "shoulder_strap")


def _loose(made: Proposal, *parts: str) -> Proposal:
    from dataclasses import replace

    return replace(made, loose_parts=parts)


def _hugged(t: _Try) -> Proposal | None:
    """Held against chest or belly with both arms around it."""
    rotation = turn_x(t.rng.normal(0, 0.08)) @ turn_y(t.choose(0.0, np.pi) + t.rng.normal(0, 0.15))
    pose, tasks, _ = t.standing(poses.HUG)
    vertices, joints = t.person.skin(pose)
    body = t.thing.part("bag_body").moved(rotation)
    low, high = body.points.min(0), body.points.max(0)
    chest = joints[JOINT["spine3"]]
    translation = np.array([chest[0] - (low[0] + high[0]) / 2 + t.rng.normal(0, 0.02), 0.0, 0.0])
    translation[1] = chest[1] - t.uniform(0.0, 0.16) - (low[1] + high[1]) / 2
    front = vertices[np.concatenate([t.person.parts["chest"], t.person.parts["belly"]])]
    bag = body.points + translation
    touch = -np.inf
    for level in np.arange(bag[:, 1].min() + 0.03, bag[:, 1].max(), 0.05):
        slab = bag[np.abs(bag[:, 1] - level) < 0.03]
        skin = front[np.abs(front[:, 1] - level) < 0.04]
        if len(slab) > 3 and len(skin) > 3:
            touch = max(touch, skin[:, 2].max() - slab[:, 2].min())
    if not np.isfinite(touch):
        return None
    translation[2] = touch + t.uniform(0.0, 0.012)
    far = body.moved(np.eye(3), translation)
    centre = far.points.mean(0)
    upper = t.choose(*SIDES)
    grips = []
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        height = centre[1] + (0.07 if side == upper else -0.07) + t.rng.normal(0, 0.02)
        near = np.array([centre[0] + sign * t.uniform(0.0, 0.07), height, 0.0])
        point, _ = far.furthest([0, 0, 1], near, 1.5)
        grips.append((side, point, np.array([sign * 0.25, 0.0, 1.0])))
    pose = t.reach(pose, tasks + t.hold(grips, 1.0), grips, 0.35)
    made = Proposal(pose, rotation, translation, [(s, p) for s, p, _ in grips], sink=0.05)
    return _loose(made, "shoulder_strap", "handle")


def _lift_suitcase(t: _Try) -> Proposal | None:
    """By the handle at one side, or with both hands at its sides."""
    if t.chance(0.55):
        grip = t.thing.part("handle")
        if len(grip.points) < 5:
            return None
        rotation = turn_z(t.rng.normal(0, 0.05)) @ turn_y(
            t.choose(-1, 1) * np.pi / 2 + t.rng.normal(0, 0.25)
        )
        return _hanging(t, grip, rotation, poses.STAND + poses.WALK)
    body = t.thing.part("bag_body")
    level = body.points.mean(0) + [0, t.uniform(-0.12, 0.1), 0]
    sites = [body.furthest([s, 0, 0], level, 1.0) for s in (1.0, -1.0)]
    rotation = turn_x(t.rng.normal(0, 0.15)) @ turn_y(t.choose(0.0, np.pi) + t.rng.normal(0, 0.2))
    return _carried(t, rotation, sites, t.uniform(0.12, 0.6), t.uniform(0.3, 0.45))


def _move_suitcase(t: _Try) -> Proposal | None:
    """Pulled behind or pushed ahead by its handle, on the floor."""
    grip = t.thing.part("handle")
    if len(grip.points) < 5:
        return None
    side = t.choose(*SIDES)
    sign = 1.0 if side == "left" else -1.0
    pulling = t.chance(0.5)
    tilt = t.uniform(0.1, 0.5) if pulling else t.uniform(-0.05, 0.25)
    # the pull-out handle is at the rear: the rear looks at the person
    yaw = (np.pi if pulling else 0.0) + t.rng.normal(0, 0.25)
    rotation = turn_y(yaw) @ turn_x(-tilt)
    lift = t.on_floor(rotation)[1]
    handle = rotation @ grip.furthest(UP, grip.points.mean(0), 0.3)[0]
    pose, tasks, feet = t.standing(
        poses.WALK + poses.STAND if handle[1] + lift > 0.62 else poses.STOOP + poses.LEAN, 0.7
    )
    back = -t.uniform(0.1, 0.35) if pulling else t.uniform(0.15, 0.4)
    at = np.array([feet[0] + sign * t.uniform(0.2, 0.42), 0.0, feet[1] + back])
    translation = np.array([at[0] - handle[0], lift, at[2] - handle[2]])
    grips = [(side, handle + translation, np.array([sign * 0.5, 0.8, 0.0]))]
    pose = t.reach(pose, tasks + t.hold(grips, 0.2), grips, 1.2)
    return Proposal(pose, rotation, translation, [(s, p) for s, p, _ in grips])


def _suitcase_on_ground(t: _Try) -> Proposal | None:
    """Standing or lying on the floor with one hand or both on it."""
    flat = t.chance(0.45)
    yaw = turn_y(t.uniform(-np.pi, np.pi))
    rotation = yaw @ turn_x(t.choose(-1, 1) * np.pi / 2) if flat else yaw
    lift = t.on_floor(rotation)[1]
    body = t.thing.part("bag_body", "handle").moved(rotation, np.array([0, lift, 0]))
    top = body.where(body.normals[:, 1] > 0.5)
    if len(top.points) < 10:
        return None
    low, high = body.points.min(0), body.points.max(0)
    height = float(np.percentile(top.points[:, 1], 80))
    pose, tasks, feet = t.standing(poses.SQUAT if height < 0.4 else poses.STOOP, 0.8)
    knees = t.person.skin(pose)[1][[JOINT["left_knee"], JOINT["right_knee"]], 2].max()
    ahead = max(feet[1] + 0.2, knees + 0.06) + t.uniform(0.0, 0.12)
    if t.chance(0.35) and not flat:  # beside the person
        shift = np.array([t.choose(-1, 1) * t.uniform(0.4, 0.6), 0.0, t.uniform(0.0, 0.3)])
    else:
        shift = np.array([feet[0] + t.rng.normal(0, 0.06) - (low[0] + high[0]) / 2, 0.0,
                          ahead - low[2]])  # fmt: skip
    top = top.moved(np.eye(3), shift)
    centre = top.points.mean(0)
    both = t.chance(0.6) and abs(centre[0]) < 0.25
    sides = SIDES if both else (("left",) if centre[0] > 0 else ("right",))
    grips = []
    for side in sides:
        sign = 1.0 if side == "left" else -1.0
        x = centre[0] + (sign * 0.13 if both else t.rng.normal(0, 0.04))
        near = np.array([x, 0.0, centre[2] - t.uniform(0.0, 0.1)])
        point, _ = top.furthest(UP, near, 1.2)
        grips.append((side, point + [0, 0.004, 0], UP))
    pose = t.reach(pose, tasks + t.hold(grips, 0.5), grips, 0.3)
    return Proposal(pose, rotation, shift + [0, lift, 0], [(s, p) for s, p, _ in grips])


# --------------------------------------------------------------------------------- keyboards


def _typing(t: _Try) -> Proposal | None:
    """At a desk, standing or seated on a plain block, with both hands on the keys."""
    seated = t.chance(0.5)
    keys = t.thing.part("key")
    if len(keys.points) < 10:
        return None
    rotation = turn_y(np.pi + t.rng.normal(0, 0.08))
    size, thickness = t.thing.size, 0.03
    person = t.person
    if seated:
        desk, seat_height = t.uniform(0.68, 0.75), t.uniform(0.42, 0.47)
        rotations = t.base(poses.SIT)
        root = np.array([0.0, seat_height + 0.09, 0.0])
        feet: list[Task] = _upright(t, 0.1)
        for side, sign in zip(SIDES, (1, -1), strict=True):
            feet += foot_on(person, side, sign * t.uniform(0.09, 0.2), t.uniform(0.28, 0.45))
        pose = Pose(root, rotations)
        for _ in range(2):
            keep = [Reach("pelvis", root, weight=30.0), Clearance(person.height / 1.7), *feet]
            pose = solve(person, Pose(root, rotations), keep, 0.0, 0.25)
            vertices, _ = person.skin(pose)
            bottom = np.percentile(vertices[person.parts["butt"], 1], 5)
            root = root + [0.0, seat_height - 0.012 - bottom, 0.0]
        tasks: list[Task] = [Reach("pelvis", root, weight=40.0), *feet]
        tasks.append(Clearance(person.height / 1.7))
        front = vertices[person.parts["belly"], 2].max()
        stool = (Box((0.38, seat_height, 0.36), (0.0, seat_height / 2, float(root[2]) - 0.03)),)
    else:
        desk, stool = t.uniform(0.98, 1.12) * person.height / 1.75, ()
        pose, tasks, _ = t.standing(poses.LIFT[1:2] + poses.STAND)
        front = person.skin(pose)[0][person.parts["belly"], 2].max()
    near = front + t.uniform(0.05, 0.12)
    edge = near + t.uniform(0.03, 0.1)
    base = -(t.thing.vertices @ rotation.T)[:, 1].min()
    translation = np.array([t.rng.normal(0, 0.03), desk + base + 0.001, edge + size[2] / 2])
    placed = keys.moved(rotation, translation)
    low, high = placed.points.min(0), placed.points.max(0)
    grips = []
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        x = translation[0] + sign * min(t.uniform(0.07, 0.12), 0.3 * size[0])
        point = np.array([x, high[1] + 0.012, low[2] + t.uniform(-0.03, 0.02)])
        grips.append((side, point, np.array([sign * 0.15, 1.0, 0.0])))
    pose = t.reach(pose, tasks + t.hold(grips, 1.2), grips, 0.3)
    span = (t.uniform(0.9, 1.4), thickness, t.uniform(0.5, 0.65))
    top = Box(span, (t.rng.normal(0, 0.06), desk - thickness / 2, near + span[2] / 2))
    legs = tuple(
        Box((0.04, desk - thickness, 0.04),
            (top.centre[0] + s * (span[0] / 2 - 0.03), (desk - thickness) / 2,
             top.centre[2] + d * (span[2] / 2 - 0.03)))
        for s in (-1, 1) for d in (-1, 1)
    )  # fmt: skip
    return Proposal(pose, rotation, translation, [(s, p) for s, p, _ in grips], sink=0.02,
                    supports=(top, *legs, *stool))  # fmt: skip


def _carry_keyboard(t: _Try) -> Proposal | None:
    """Held at both ends, flat, tilted or upright."""
    frame = t.thing.surface
    level = np.array([0.0, 0.0, t.uniform(-0.3, 0.3) * t.thing.size[2]])
    sites = [frame.furthest([s, 0, 0], level, 1.0) for s in (1.0, -1.0)]
    tilt = t.uniform(-0.3, 1.5)
    rotation = (
        turn_z(t.rng.normal(0, 0.15))
        @ turn_x(tilt)
        @ turn_y(np.pi * t.choose(0, 1) + t.rng.normal(0, 0.15))
    )
    return _carried(t, rotation, sites, t.uniform(0.75, 1.3), t.uniform(0.25, 0.45))


_CHAIR = {
    "hand": _hand_on_chair,
    "lift": _lift_chair,
    "liftreal": _lift_chair,
    "sit": _sit_on_chair,
    "sitstand": _sit_on_chair,
}
_STAGERS: dict[tuple[str, str], Callable[[_Try], Proposal | None]] = {
    **{("chair", action): stager for action, stager in _CHAIR.items()},
    **{("stool", action): stager for action, stager in _CHAIR.items()},
    ("table", "hand"): _hand_on_table,
    ("table", "lift"): _lift_table,
    ("table", "move"): _move_table,
    ("table", "sit"): _sit_on_table,
    ("keyboard", "type"): _typing,
    ("keyboard", "move"): _carry_keyboard,
    ("backpack", "back"): _worn_backpack,
    ("backpack", "hand"): _backpack_in_hand,
    ("backpack", "hug"): _hugged,
    ("suitcase", "lift"): _lift_suitcase,
    ("suitcase", "move"): _move_suitcase,
    ("suitcase", "ground"): _suitcase_on_ground,
}
