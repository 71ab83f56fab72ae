"""A generated tree in BEHAVE's released layout: four Kinects, calibrations, scans, SMPL-H fits.

Everything is made up and small; names, keys, units and conventions are the data set's.
"""

from __future__ import annotations

import functools
import json
import pickle
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from hoi.body.smplh import SmplhModel
from hoi.datasets.behave_layout import object_folder_names, parse_sequence
from test_body_files import SMPLH_PARENTS, small_body

SIZE = (64, 48)
DISTORTION = [0.5, -2.6, 0.001, -0.0002, 1.5, 0.38, -2.4, 1.4]


def write_mesh(path: Path, vertices, faces) -> None:
    """An ASCII PLY that keeps every vertex in its place."""
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{x:.9g}" for x in v) for v in np.asarray(vertices, float)]
    lines += [f"3 {a} {b} {c}" for a, b, c in np.asarray(faces)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def write_json(path: Path, content) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


#: an uneven tetrahedron with one vertex twice: merging it would move the mean of the vertices
TEMPLATE = np.array([[0, 0, 0], [0.6, 0, 0], [0, 0.9, 0], [0, 0, 0.3], [0.6, 0, 0]], float) + 5
TEMPLATE_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [4, 2, 3]])


@functools.cache
def model_bytes(gender: str) -> bytes:
    """A made-up SMPL-H model, pickled as the released ones are."""
    seed = ("male", "female").index(gender)
    return pickle.dumps(small_body(seed=seed, joints=52, parents=SMPLH_PARENTS), protocol=2)


class BehaveTree:
    """Writes the tree under `root` and knows the truth of what it wrote."""

    def __init__(self, root: Path, smplh: Path):
        self.root, self.smplh = root, smplh
        self.models = {}
        smplh.mkdir(parents=True, exist_ok=True)
        for gender in ("male", "female"):
            path = smplh / f"SMPLH_{gender}.pkl"
            path.write_bytes(model_bytes(gender))
            self.models[gender] = SmplhModel.load(path)
        self.poses = {}  # kinect -> camera-to-world rotation and translation
        for kinect in range(4):
            random = np.random.default_rng(kinect)
            turn = random.normal(0, 0 if kinect == 1 else 0.7, 3)
            self.poses[kinect] = (
                Rotation.from_rotvec(turn).as_matrix(),
                random.normal(0, 0 if kinect == 1 else 1.0, 3),
            )
            color = {
                "fx": 100.0 + kinect, "fy": 101.0, "cx": 64.0, "cy": 48.0,
                "width": 128, "height": 96,
            }  # fmt: skip
            color["opencv"] = [color["fx"], color["fy"], color["cx"], color["cy"], *DISTORTION]
            folder = root / "calibs" / "intrinsics" / str(kinect)
            write_json(folder / "calibration.json", {"color": color})
        self.splits: dict[str, list[str]] = {"train": [], "test": []}

    def sequence(self, name: str, gender: str = "male", split: str = "test", times=("t0003.000",)):
        """One sequence with its scan, cameras and frames."""
        date, _, thing, _ = parse_sequence(name)
        info = {
            "config": f"../../calibs/{date}/config",
            "intrinsic": "../../calibs/intrinsics",
            "cat": thing,
            "gender": gender,
            "empty": None,
            "kinects": [0, 1, 2, 3],
            "beta": [0.0] * 10,
        }
        write_json(self.root / "sequences" / name / "info.json", info)
        for kinect, (rotation, translation) in self.poses.items():
            pose = {"rotation": rotation.ravel().tolist(), "translation": translation.tolist()}
            write_json(self.root / "calibs" / date / "config" / str(kinect) / "config.json", pose)
        folder = self.root / "objects" / thing
        write_mesh(folder / f"{thing}_f1000.ply", TEMPLATE, TEMPLATE_FACES)
        self.splits[split].append(name)
        write_json(self.root / "split.json", self.splits)
        return [self.frame(name, time) for time in times]

    def parameters(self, name: str, time: str):
        """The made-up truth of one frame: SMPL-H and object parameters."""
        random = np.random.default_rng([ord(c) for c in name + time])
        body = {
            "pose": random.normal(0, 0.3, 156),
            "betas": random.normal(0, 1, 10),
            "trans": random.normal(0, 0.3, 3) + [0, 0, 2.5],
        }
        thing = {"angle": random.normal(0, 1, 3), "trans": random.normal(0, 0.3, 3) + [0, 0, 2.2]}
        return body, thing

    def posed(self, name: str, time: str):
        body, _ = self.parameters(name, time)
        gender = json.loads((self.root / "sequences" / name / "info.json").read_text())["gender"]
        model = self.models[gender]
        return model.pose(body["pose"], body["betas"], body["trans"]), model.faces

    def placed(self, name: str, time: str) -> np.ndarray:
        """The object's vertices in the world, by the data set's published recipe."""
        _, thing = self.parameters(name, time)
        centred = TEMPLATE - TEMPLATE.mean(0)
        return centred @ Rotation.from_rotvec(thing["angle"]).as_matrix().T + thing["trans"]

    def frame(self, name: str, time: str) -> Path:
        folder = self.root / "sequences" / name / time
        folder.mkdir(parents=True, exist_ok=True)
        mask = np.zeros(SIZE[::-1], np.uint8)
        mask[10:30, 5:20] = 255
        full = mask[:, ::-1].copy()
        full[30:40] = full[20:30]
        for kinect in range(4):
            shade = (90 + 20 * kinect, 120, 40)
            Image.new("RGB", SIZE, shade).save(folder / f"k{kinect}.color.jpg")
            Image.fromarray(mask).save(folder / f"k{kinect}.person_mask.jpg")
            Image.fromarray(mask[:, ::-1]).save(folder / f"k{kinect}.obj_rend_mask.png")
            Image.fromarray(full).save(folder / f"k{kinect}.obj_rend_full.png")
            joints = np.arange(75, dtype=float) * (kinect + 1)
            write_json(folder / f"k{kinect}.color.json", {"body_joints": joints.tolist()})
        body, thing = self.parameters(name, time)
        posed, faces = self.posed(name, time)
        write_mesh(folder / "person" / "fit02" / "person_fit.ply", posed.vertices, faces)
        (folder / "person" / "fit02" / "person_fit.pkl").write_bytes(pickle.dumps(body))
        stem = object_folder_names(parse_sequence(name)[2])[0]
        fit = folder / stem / "fit01" / f"{stem}_fit"
        write_mesh(fit.with_suffix(".ply"), self.placed(name, time), TEMPLATE_FACES)
        fit.with_suffix(".pkl").write_bytes(pickle.dumps(thing))
        return folder

    def write_30fps(self, folder: Path, name: str, times) -> None:
        """The extension's two files of one sequence."""
        given = [self.parameters(name, time) for time in times]
        (folder / name).mkdir(parents=True, exist_ok=True)
        np.savez(
            folder / name / "smpl_fit_all.npz",
            poses=[body["pose"] for body, _ in given],
            betas=[body["betas"] for body, _ in given],
            trans=[body["trans"] for body, _ in given],
            frame_times=list(times),
        )
        np.savez(
            folder / name / "object_fit_all.npz",
            angles=[thing["angle"] for _, thing in given],
            trans=[thing["trans"] for _, thing in given],
            frame_times=list(times),
        )
