"""Does the object search find the true pose from a clean mask, and how long does it take?

    python benchmarks/pose_recovery.py [--searches upright,so3,phosa] [--exemplars 1,20] [--quick]

A generated chair of about 1000 vertices stands at a random place and yaw before a Kinect's colour
camera that looks down on it; its exact mask is all that the search sees. With 20 exemplars nineteen
other chairs compete. Success: the best pose is within 2 degrees of the truth and its mask
overlaps by 0.98; `among` counts the frames where any kept pose of the right shape is within 2
degrees. Seconds are CPU seconds of one thread, kernels compiled before. The searches ``paper`` and
``phosa`` descend from 2000 random rotations, half a minute an exemplar: they get few frames.
Writes ``results/pose_recovery.csv``, or ``results/<name>.csv`` with ``--csv <name>``.
"""

from __future__ import annotations

import argparse
import math
import statistics
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np
import torch
from measure import rounded, show, write_csv

from hoi.artifacts import Detection, Frame, ObjectFit
from hoi.exemplars import Exemplar, save_library
from hoi.exemplars.procedural import generate
from hoi.geometry import project, rotation_angle, uniform_rotations, upright_rotations
from hoi.objectfit.config import ObjectFitConfig
from hoi.objectfit.stage import ObjectFitStage
from hoi.rendering import MeshTopology, render_silhouette, warm_up

WIDTH, HEIGHT = 1024, 768  # half a Kinect's colour image
INTRINSICS = np.array([[490.0, 0, 512], [0, 490.0, 384], [0, 0, 1]])
SEARCHES = {
    "upright": {"init": "upright"},
    "so3": {"init": "so3", "num_starts": 2000},
    "paper": {"init": "so3", "num_starts": 2000, "schedule": "paper"},
    "phosa": {"init": "so3", "num_starts": 2000, "schedule": "phosa_released"},
}
SLOW = ("paper", "phosa")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=40, help="of one exemplar")
    parser.add_argument("--category-frames", type=int, default=10, help="of several exemplars")
    parser.add_argument("--slow-frames", type=int, default=2, help="of the slow searches")
    parser.add_argument("--searches", default="upright,so3,phosa")
    parser.add_argument("--exemplars", default="1,20", help="how many compete")
    parser.add_argument("--quick", action="store_true", help="upright alone, a few frames")
    parser.add_argument("--csv", default="pose_recovery", help="name of the table")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    warm_up()
    rows = []
    for search in ["upright"] if arguments.quick else arguments.searches.split(","):
        for exemplars in map(int, arguments.exemplars.split(",")):
            frames = arguments.frames if exemplars == 1 else arguments.category_frames
            if search in SLOW and exemplars > 1:
                continue
            frames = arguments.slow_frames if search in SLOW else frames
            rows.append(measure(search, 4 if arguments.quick else frames, exemplars))
            show(rows[-1])
    write_csv(arguments.csv, rows)


@cache
def chair_number(seed: int) -> Exemplar:
    return generate("chair", 100 + seed)


def measure(search: str, frames: int, exemplars: int) -> dict[str, object]:
    """Recover `frames` known poses with one configuration of the search."""
    config = ObjectFitConfig(**SEARCHES[search])
    errors, ious, seconds, among = [], [], [], 0
    for seed in range(frames):
        chairs = [chair_number((seed + i) % 25) for i in range(exemplars)]
        chair = chairs[0]
        rotation, translation = placement(seed, config.init)
        frame, detection = photographed(chair, rotation, translation)
        with tempfile.TemporaryDirectory() as folder:
            save_library(chairs, Path(folder) / "chair.npz")
            stage = ObjectFitStage(config, folder)
            start = time.process_time()
            fit = stage(frame, detection, seed=0)
            seconds.append(time.process_time() - start)
        turned = degrees_off(fit, chair, rotation)
        errors.append(turned[0])
        ious.append(overlap(fit, chairs, detection))
        among += min(turned) < 2
    good = [error < 2 and iou >= 0.98 for error, iou in zip(errors, ious, strict=True)]
    return {
        "search": search,
        "exemplars": exemplars,
        "frames": frames,
        "success": rounded(float(np.mean(good))),
        "within_2_deg": rounded(float(np.mean(np.array(errors) < 2))),
        "among": rounded(among / frames),
        "median_deg": rounded(statistics.median(errors)),
        "mean_iou": rounded(statistics.mean(ious)),
        "least_iou": rounded(min(ious)),
        "cpu_s": rounded(statistics.mean(seconds)),
        "cpu_s_per_exemplar": rounded(statistics.mean(seconds) / exemplars),
    }


def placement(seed: int, init: str) -> tuple[np.ndarray, np.ndarray]:
    """A random pose of the kind that the starts are drawn from, and a place in view."""
    generator = torch.Generator().manual_seed(1000 + seed)
    if init == "so3":
        rotation = uniform_rotations(1, generator)[0]
    else:
        rotation = upright_rotations(1, generator)[0]
    depth, x, y = torch.rand(3, generator=generator).tolist()
    depth = 1.8 + 1.4 * depth
    return rotation.double().numpy(), np.array([(x - 0.5) * depth, (y - 0.5) * 0.6, depth])


def photographed(
    exemplar: Exemplar, rotation: np.ndarray, translation: np.ndarray
) -> tuple[Frame, Detection]:
    """A frame that shows the exemplar, and its exact mask."""
    placed = torch.from_numpy(exemplar.vertices @ rotation.T + translation).float()
    topology = MeshTopology.from_faces(exemplar.faces, len(exemplar.vertices))
    xy = project(placed, INTRINSICS)[None]
    mask = render_silhouette(xy, topology, HEIGHT, WIDTH, antialias=False)[0].numpy() > 0
    frame = Frame(
        frame_id="frame", dataset="benchmark", category="chair",
        image=np.zeros((HEIGHT, WIDTH, 3), np.uint8), intrinsics=INTRINSICS,
    )  # fmt: skip
    detection = Detection(
        frame_id="frame", person_box=np.array([0, 0, 1, 1.0]), object_box=np.array([0, 0, 1, 1.0]),
        person_mask=np.zeros_like(mask), object_mask=mask, keypoints=np.zeros((21, 3)),
    )  # fmt: skip
    return frame, detection


def degrees_off(fit: ObjectFit, truth: Exemplar, rotation: np.ndarray) -> list[float]:
    """Rotation error of each kept pose, best pose first; 180 where the shape is another."""
    assert fit.rotations is not None and fit.exemplars is not None
    return [
        math.degrees(float(rotation_angle(torch.from_numpy(found), torch.from_numpy(rotation))))
        if name == truth.name
        else 180.0
        for name, found in zip(fit.exemplars, fit.rotations, strict=True)
    ]


def overlap(fit: ObjectFit, exemplars: list[Exemplar], detection: Detection) -> float:
    """IoU of the best pose with the mask at the photo's resolution."""
    assert fit.rotations is not None and fit.translations is not None and fit.exemplars
    exemplar = next(e for e in exemplars if e.name == fit.exemplars[0])
    _, drawn = photographed(exemplar, fit.rotations[0], fit.translations[0])
    assert drawn.object_mask is not None and detection.object_mask is not None
    both = (drawn.object_mask & detection.object_mask).sum()
    return float(both / (drawn.object_mask | detection.object_mask).sum())


if __name__ == "__main__":
    main()
