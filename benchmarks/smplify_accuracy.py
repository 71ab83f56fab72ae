"""How near the fitted body comes to the true one, from simulated keypoints in the embedded data.

    python benchmarks/smplify_accuracy.py [--frames 12]

Reads the frames, detections and truths that a workflow run has left under ``results/`` (``make
demo``): generated people whose keypoints carry the noise and drop-outs of a detector. Conditions:
as they are; without the 3D landmarks that start the fit; with a third of the keypoints missing at
random; cut off below the hips. Errors in cm, means over frames: joints and vertices with the
pelvis put on the pelvis, and after a similarity alignment (pa). Writes
``results/smplify_accuracy.csv``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import rounded, show, write_csv

from hoi.artifacts import BodyFit, Detection, Frame, GroundTruth
from hoi.body.keypoints import KEYPOINTS
from hoi.chunks import frame_seed
from hoi.config import load_config
from hoi.errors import FrameFailure
from hoi.geometry import similarity_procrustes
from hoi.smplify.stage import SmplifyStage

ROOT = Path(__file__).parent.parent
PELVIS = 0
BELOW_HIPS = ("knee", "ankle", "toe", "heel")
LEGS = [i for i, name in enumerate(KEYPOINTS) if name.endswith(BELOW_HIPS)]


def hidden(detection: Detection, rows: np.ndarray) -> Detection:
    """Keypoints without confidence in some rows; landmarks are gone too."""
    assert detection.keypoints is not None
    keypoints = detection.keypoints.copy()
    keypoints[rows] = 0
    return detection.model_copy(update={"keypoints": keypoints, "landmarks": None})


def a_third(detection: Detection) -> Detection:
    rows = np.random.default_rng(0).permutation(len(KEYPOINTS))[: len(KEYPOINTS) // 3]
    return hidden(detection, rows)


CONDITIONS: dict[str, Callable[[Detection], Detection]] = {
    "as detected": lambda detection: detection,
    "no landmarks": lambda detection: detection.model_copy(update={"landmarks": None}),
    "a third missing, no landmarks": a_third,
    "cut below the hips, no landmarks": lambda detection: hidden(detection, np.array(LEGS)),
}


def errors_cm(found: np.ndarray, true: np.ndarray, root: tuple[np.ndarray, np.ndarray]):
    """Mean distance after moving root on root, and after a similarity alignment; cm."""
    moved = found - root[0] + root[1]
    scale, rotation, shift = similarity_procrustes(found, true)
    aligned = scale * found @ rotation.T + shift
    return [100 * np.linalg.norm(points - true, axis=1).mean() for points in (moved, aligned)]


def frame_errors(body: BodyFit, truth: GroundTruth) -> list[float]:
    assert body.joints is not None and truth.body_joints is not None
    assert body.vertices is not None and truth.body_vertices is not None
    root = body.joints[PELVIS], truth.body_joints[PELVIS]
    joints = errors_cm(body.joints, truth.body_joints, root)
    return [*joints, *errors_cm(body.vertices, truth.body_vertices, root)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--results", type=Path, default=ROOT / "results" / "behave_mini")
    arguments = parser.parse_args()
    files = sorted((arguments.results / "truth").glob("*/*.npz"))
    if not files:
        raise SystemExit(f"{arguments.results} holds no truth yet: run `make demo` first")
    torch.set_num_threads(1)
    config = load_config(ROOT / "config" / "config.yaml")
    assets = config.assets
    stage = SmplifyStage(config.smplify, ROOT / assets.body_model, ROOT / assets.pose_database)
    step = max(1, len(files) // arguments.frames)
    rows: list[dict[str, Any]] = []
    for name, change in CONDITIONS.items():
        errors, failed = [], 0
        for path in files[::step][: arguments.frames]:
            place = path.relative_to(arguments.results / "truth")
            frame = Frame.load(arguments.results / "frames" / place)
            detection = change(Detection.load(arguments.results / "detect" / place))
            seed = frame_seed(0, frame.frame_id, "smplify")
            try:
                body = stage(frame, detection, seed)
            except FrameFailure:
                failed += 1
                continue
            errors.append(frame_errors(body, GroundTruth.load(path)))
        joint, joint_pa, vertex, vertex_pa = np.mean(errors, axis=0)
        rows.append(
            {
                "keypoints": name,
                "frames": len(errors),
                "failed": failed,
                "joint_cm": rounded(joint),
                "joint_pa_cm": rounded(joint_pa),
                "vertex_cm": rounded(vertex),
                "vertex_pa_cm": rounded(vertex_pa),
                "worst_joint_cm": rounded(np.max(errors, axis=0)[0]),
            }
        )
        show(rows[-1])
    write_csv("smplify_accuracy", rows)


if __name__ == "__main__":
    main()
