"""Seconds per frame of the joint stage, by method and schedule.

Run: ``OMP_NUM_THREADS=1 python benchmarks/joint.py``. A toy frame of the tests (a person sitting on
a box chair) with ten hypotheses of five exemplars of about 1000 vertices each; CPU seconds of one
thread, best of three after warm-up, so compilation and imports are not counted.

Measured on one of two shared x86-64 server cores, Python 3.11, torch 2.13, numba 0.68:

    ours        fast   lbfgs    40 it  K = 10  0.87 s
    ours        paper  adam    500 it  K = 10  5.41 s
    paper       fast   adam    120 it  K = 5   0.79 s
    paper       paper  adam    500 it  K = 5   3.32 s
    no_action   fast   lbfgs    40 it  K = 10  0.83 s
    no_contact  fast   lbfgs    40 it  K = 10  0.53 s
    no_normal   fast   lbfgs    40 it  K = 10  0.60 s
    phosa       fast   adam    100 it  K = 5   0.82 s
    phosa       paper  adam    400 it  K = 5   3.68 s
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from hoi.body import DEFAULT_BODY
from hoi.exemplars import save_library
from hoi.exemplars.procedural import generate
from hoi.joint.stage import JointStage
from joint_scene import METHODS, Scene, sitting_scene


def ten_hypotheses(scene: Scene, folder: Path) -> Scene:
    """The scene's object fit with two poses of each of five procedural chairs."""
    exemplars = [generate("chair", seed) for seed in range(5)]
    save_library(exemplars, folder / "chair.npz")
    objects = scene.objects
    assert objects.rotations is not None and objects.translations is not None
    fit = objects.model_copy(
        update={
            "exemplars": [exemplar.name for exemplar in exemplars] * 2,
            "rotations": np.repeat(objects.rotations, 10, 0),
            "translations": np.repeat(objects.translations, 10, 0),
            "ious": np.ones(10),
        }
    )
    return replace(scene, objects=fit, exemplars=exemplars)


def main() -> None:
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        scene = ten_hypotheses(sitting_scene(), Path(folder))
        for name in METHODS.methods:
            for schedule in ("fast", "paper"):
                config = METHODS.joint_settings(name).model_copy(update={"schedule": schedule})
                stage = JointStage(config, DEFAULT_BODY, Path(folder))
                seconds = []
                for _ in range(4 if schedule == "fast" else 2):
                    start = time.process_time()
                    result = stage(
                        scene.frame, scene.detection, scene.body, scene.objects, scene.prior, seed=0
                    )
                    seconds.append(time.process_time() - start)
                count = len(result.hypothesis_exemplars)
                chosen = config.chosen_schedule
                print(
                    f"{name:<11} {schedule:<6} {chosen.optimiser:<6} {chosen.iterations:>4} it  "
                    f"K = {count:<3} {min(seconds[1:]):.2f} s",
                    flush=True,
                )


if __name__ == "__main__":
    main()
