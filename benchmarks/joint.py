"""CPU seconds of the joint stage per frame, by method, schedule and number of hypotheses.

    python benchmarks/joint.py [--methods ours,paper] [--poses 2,4] [--quick]

A toy frame of the tests (a person sitting on a box chair) with five exemplars of about 1000
vertices and some poses of each; one thread, kernels compiled before. An evaluation is the objective
with its gradient; `plain` is the same in standard torch operations, nearest neighbours by distance
matrices and the silhouette by the torch back end. `loss` is the least final loss of all hypotheses.
Writes ``results/joint.csv``.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch
from measure import milliseconds, rounded, show, write_csv

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from hoi.body import DEFAULT_BODY
from hoi.exemplars import save_library
from hoi.exemplars.procedural import generate
from hoi.geometry import axis_angle_to_matrix
from hoi.joint import stage, terms
from hoi.joint.config import JointConfig
from hoi.joint.correspondence import nearest_reference
from hoi.joint.optimise import objective_of
from hoi.joint.problem import Problem
from hoi.joint.stage import JointStage
from hoi.rendering import silhouette_loss
from joint_scene import METHODS, Scene, sitting_scene

EXEMPLARS = 5


def with_hypotheses(scene: Scene, poses: int, folder: Path) -> Scene:
    """The scene's object fit with some poses, a few degrees apart, of each of five chairs."""
    exemplars = [generate("chair", seed) for seed in range(EXEMPLARS)]
    save_library(exemplars, folder / "chair.npz")
    objects = scene.objects
    assert objects.rotations is not None and objects.translations is not None
    angles = torch.zeros(poses, 3)
    angles[:, 1] = torch.linspace(0, 0.5, poses)
    turns = axis_angle_to_matrix(angles).double().numpy()
    fit = objects.model_copy(
        update={
            "exemplars": [exemplar.name for exemplar in exemplars] * poses,
            "rotations": np.repeat(objects.rotations[:1] @ turns, EXEMPLARS, 0),
            "translations": np.repeat(objects.translations[:1], EXEMPLARS * poses, 0),
            "ious": np.ones(EXEMPLARS * poses),
        }
    )
    return replace(scene, objects=fit, exemplars=exemplars)


@contextlib.contextmanager
def plain_operations() -> Iterator[None]:
    """The joint stage without its kernels."""
    slow_silhouette = functools.partial(silhouette_loss, backend="torch")
    with (
        mock.patch.object(terms, "nearest", nearest_reference),
        mock.patch.object(terms, "silhouette_loss", slow_silhouette),
    ):
        yield


def seconds_of(config: JointConfig, scene: Scene, folder: Path, repeats: int) -> tuple[float, Any]:
    """Least CPU seconds of some runs, and the result."""
    stage = JointStage(config, DEFAULT_BODY, folder)
    times, result = [], None
    for _ in range(repeats):
        start = time.process_time()
        result = stage(scene.frame, scene.detection, scene.body, scene.objects, scene.prior, seed=0)
        times.append(time.process_time() - start)
    return min(times), result


def iteration_ms(config: JointConfig, scene: Scene, folder: Path) -> tuple[float, float]:
    """CPU milliseconds of one evaluation of objective and gradient: ours, and plain operations."""
    problems = []

    def keep(problem: Problem, *_: Any) -> None:
        problems.append(problem)
        raise StopIteration

    with mock.patch.object(stage, "minimise", keep), contextlib.suppress(StopIteration):
        seconds_of(config, scene, folder, 1)
    problem = problems[0]
    objective = objective_of(problem, config.terms)
    own = milliseconds(lambda: objective(problem.start), repeats=9)
    with plain_operations():
        plain = milliseconds(lambda: objective(problem.start), repeats=3)
    return own, plain


def measure(method: str, schedule: str, poses: int, scene: Scene, folder: Path) -> dict[str, Any]:
    """One row."""
    config = METHODS.joint_settings(method).model_copy(
        update={
            "schedule": schedule,
            "poses_per_exemplar": poses,
            "max_hypotheses": EXEMPLARS * poses,
        }
    )
    iterations = config.chosen_schedule.iterations
    own, plain = iteration_ms(config, scene, folder)
    seconds, result = seconds_of(config, scene, folder, 2 if schedule == "fast" else 1)
    count = len(result.hypothesis_exemplars)
    least = np.sum([result.hypothesis_terms[name] for name in config.terms], axis=0).min()
    return {
        "method": method,
        "schedule": schedule,
        "optimiser": config.chosen_schedule.optimiser,
        "iterations": iterations,
        "hypotheses": count,
        "cpu_s": rounded(seconds),
        "cpu_s_per_hypothesis": rounded(seconds / count),
        "ms_per_evaluation": rounded(own),
        "plain_ms_per_evaluation": rounded(plain),
        "plain_over_ours": rounded(plain / own),
        "loss": rounded(float(least), 4),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--methods", default="ours,paper,phosa")
    parser.add_argument("--schedules", default="fast,paper")
    parser.add_argument("--poses", default="2,4", help="of each of the five exemplars")
    parser.add_argument("--quick", action="store_true", help="ours alone, 10 hypotheses, fast")
    parser.add_argument("--csv", default="joint", help="name of the table")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    methods, schedules, poses = arguments.methods, arguments.schedules, arguments.poses
    if arguments.quick:
        methods, schedules, poses = "ours", "fast", "2"
    rows = []
    with tempfile.TemporaryDirectory() as name:
        for count in map(int, poses.split(",")):
            scene = with_hypotheses(sitting_scene(), count, Path(name))
            for method in methods.split(","):
                for schedule in schedules.split(","):
                    rows.append(measure(method, schedule, count, scene, Path(name)))
                    show(rows[-1])
    write_csv(arguments.csv, rows)


if __name__ == "__main__":
    main()
