"""Build the pose database: ``python -m hoi.actions.build_database [output.npz]``.

Every base pose of ``data/poses/base_poses.yaml`` is drawn several times from its ranges; every
other draw is mirrored left to right, some poses are interpolated between two others, and a little
noise is put on every joint. Equal input gives equal bytes.
"""

from __future__ import annotations

import argparse
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from scipy.spatial.transform import Rotation, Slerp

from hoi.actions.authoring import Arm, Description, Leg, Trunk, pose_from_description
from hoi.actions.config import COMPARED_JOINTS, DatabaseConfig
from hoi.actions.database import DEFAULT_DATABASE, PoseDatabase, save_database
from hoi.body.skeleton import JOINT, NUM_JOINTS, mirror_pose
from hoi.errors import AssetError

BASE_POSES: Path = Path(__file__).parents[1] / "data" / "poses" / "base_poses.yaml"
DEFAULTS = DatabaseConfig()  # type: ignore[call-arg]  # every field has a default


class _Drawn(NamedTuple):
    pose: np.ndarray  # (69,) radians
    tilt: float  # degrees by which the pelvis pitches forward


def build_database(
    config: DatabaseConfig = DEFAULTS, base_poses: Path | str = BASE_POSES
) -> PoseDatabase:
    """The database of all variants of all base poses; raises AssetError for a bad description."""
    sheet = yaml.safe_load(Path(base_poses).read_text(encoding="utf-8"))
    by_id = {entry["id"]: entry for entry in sheet["poses"]}
    rows: list[tuple[str, str, str, np.ndarray, float]] = []
    for entry in sheet["poses"]:
        for number in range(config.variants if entry["for"] else 0):
            rng = _generator(config.seed, entry["id"], number)
            drawn = _draw(sheet, by_id, entry["id"], rng)
            pose = _with_noise(drawn.pose, config.jitter_degrees, rng)
            if number % 2:
                pose = mirror_pose(pose)
            for action, categories in entry["for"].items():
                rows.append((f"{entry['id']}_{number:02d}", categories, action, pose, drawn.tilt))
    ids, categories, actions, poses, tilts = zip(*rows, strict=True)
    tilt = np.deg2rad(tilts)
    return PoseDatabase(
        np.array(ids),
        np.array(categories),
        np.array(actions),
        # four decimals: far below the noise, and the same on every machine
        np.round(np.stack(poses), 4).astype(np.float32),
        # a tilt to the side would change sign in the mirror; the descriptions have none
        np.round(np.stack((0 * tilt, np.cos(tilt), -np.sin(tilt)), 1), 4).astype(np.float32),
    )


def _generator(seed: int, pose_id: str, number: int) -> np.random.Generator:
    """Own numbers for every variant, so that a new pose changes no other."""
    return np.random.default_rng([seed, zlib.crc32(pose_id.encode()), number])


def _draw(
    sheet: dict[str, Any], by_id: dict[str, Any], pose_id: str, rng: np.random.Generator
) -> _Drawn:
    entry = by_id[pose_id]
    try:
        if "between" in entry:
            first, second = (_draw(sheet, by_id, name, rng) for name in entry["between"])
            share = _number(entry["at"], rng)
            tilt = (1 - share) * first.tilt + share * second.tilt
            return _Drawn(_interpolate(first.pose, second.pose, share), tilt)
        trunk = Trunk(**_numbers(_pick(sheet["trunks"], entry["trunk"], rng), rng))
        legs = _pick(sheet["legs"], entry["legs"], rng)
        arms = _pick(sheet["arms"], entry["arms"], rng)
        description = Description(
            trunk=trunk,
            left_leg=Leg(**_numbers(_side(legs, "left"), rng)),
            right_leg=Leg(**_numbers(_side(legs, "right"), rng)),
            left_arm=Arm(**_numbers(_side(arms, "left"), rng)),
            right_arm=Arm(**_numbers(_side(arms, "right"), rng)),
        )
        return _Drawn(pose_from_description(description), trunk.tilt)
    except (KeyError, TypeError) as error:
        raise AssetError(f"base pose {pose_id}: {error}") from error


def _pick(pieces: dict[str, Any], names: list[Any], rng: np.random.Generator) -> dict[str, Any]:
    """One of the named pieces; a piece may also be written out in place."""
    chosen = names[int(rng.integers(len(names)))]
    return chosen if isinstance(chosen, dict) else pieces[chosen]


def _side(limbs: dict[str, Any], side: str) -> dict[str, Any]:
    return limbs["both"] if "both" in limbs else limbs[side]


def _numbers(piece: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Draw every range of a piece. Vectors are lists of three numbers or ranges."""
    drawn: dict[str, Any] = {}
    for name, value in piece.items():
        is_vector = isinstance(value, list) and len(value) == 3
        drawn[name] = tuple(_number(v, rng) for v in value) if is_vector else _number(value, rng)
    return drawn


def _number(value: float | list[float], rng: np.random.Generator) -> float:
    if isinstance(value, list):
        low, high = value
        return float(rng.uniform(low, high))
    return float(value)


def _interpolate(first: np.ndarray, second: np.ndarray, share: float) -> np.ndarray:
    """The pose `share` of the way from `first` to `second`, joint by joint."""
    joints = zip(first.reshape(-1, 3), second.reshape(-1, 3), strict=True)
    return np.concatenate(
        [Slerp([0, 1], Rotation.from_rotvec(np.stack(pair)))(share).as_rotvec() for pair in joints]
    )


def _with_noise(pose: np.ndarray, degrees: float, rng: np.random.Generator) -> np.ndarray:
    noise = np.zeros((NUM_JOINTS, 3))
    joints = [JOINT[name] for name in COMPARED_JOINTS]
    noise[joints] = np.deg2rad(degrees) * rng.standard_normal((len(joints), 3))
    # knees and elbows are hinges
    for side in ("left", "right"):
        noise[JOINT[f"{side}_knee"], 1:] = 0
        noise[JOINT[f"{side}_elbow"], [0, 2]] = 0
    turned = Rotation.from_rotvec(pose.reshape(-1, 3)) * Rotation.from_rotvec(noise[1:])
    return turned.as_rotvec().reshape(-1)


def main() -> None:
    """Write the database and say what is in it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", nargs="?", type=Path, default=DEFAULT_DATABASE)
    output = parser.parse_args().output
    database = build_database()
    save_database(database, output)
    print(f"{output}: {len(database)} poses")
    for category in database.all_categories():
        labels = database.actions[database.rows_of(category)].tolist()
        counts = ", ".join(f"{name} {labels.count(name)}" for name in sorted(set(labels)))
        print(f"  {category}: {counts}")


if __name__ == "__main__":
    main()
