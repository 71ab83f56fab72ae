"""Seconds and peak memory of every stage on frames of the embedded data set.

    python benchmarks/pipeline.py [--frames 3]

Each stage runs in a process of its own on the inputs that a workflow run has left under
``results/`` (``make demo`` makes them), one thread, frame after frame. `first_s` is the first frame
with all that is loaded once, `cpu_s` the median of the others; `peak_mb` is the most memory the
process ever held, `base_mb` what its imports and assets take. Writes ``results/pipeline.csv``.
"""

from __future__ import annotations

import argparse
import json
import os
import resource as process
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from measure import rounded, show, write_csv

from hoi import artifacts
from hoi.chunks import frame_seed
from hoi.config import RunConfig, load_config

ROOT = Path(__file__).parent.parent
#: argument -> folder of the artifacts under the results, and their kind
INPUTS = {
    "frame": ("frames", artifacts.Frame),
    "detection": ("detect", artifacts.Detection),
    "body": ("smplify", artifacts.BodyFit),
    "objects": ("objectfit/upright", artifacts.ObjectFit),
    "action": ("actions", artifacts.Action),
    "prior": ("priors", artifacts.Prior),
    "joint": ("joint/ours", artifacts.Joint),
    "truth": ("truth", artifacts.GroundTruth),
}
#: stage -> the arguments of a call
STAGES = {
    "detect": ("frame",),
    "smplify": ("frame", "detection"),
    "objectfit": ("frame", "detection"),
    "actions": ("frame", "body"),
    "priors": ("frame", "action"),
    "joint": ("frame", "detection", "body", "objects", "prior"),
    "evaluate": ("frame", "truth", "joint"),
}


def make_stage(name: str, config: RunConfig, resources: Path) -> Callable[..., Any]:
    """The stage as the workflow makes it."""
    assets, data = config.assets, ROOT / "src" / "hoi" / "data"
    body_model, poses = ROOT / assets.body_model, ROOT / assets.pose_database
    if name == "detect":
        from hoi.detect.stage import DetectStage

        return DetectStage(config.detect_settings("behave_mini"), resources / "models")
    if name == "smplify":
        from hoi.smplify.stage import SmplifyStage

        return SmplifyStage(config.smplify, body_model, poses)
    if name == "objectfit":
        from hoi.objectfit.stage import ObjectFitStage

        return ObjectFitStage(config.objectfit["upright"], resources / "exemplars")
    if name == "actions":
        from hoi.actions.stage import ActionStage

        return ActionStage(config.actions, poses, data / "conceptnet" / "actions.tsv")
    if name == "priors":
        from hoi.priors.stage import PriorStage

        return PriorStage(config.priors, None)
    if name == "joint":
        from hoi.joint.stage import JointStage

        return JointStage(config.joint_settings("ours"), body_model, resources / "exemplars")
    from hoi.evaluate.stage import EvaluateStage

    return EvaluateStage(config.evaluate, body_model)


def run_stage(name: str, frames: int, results: Path, resources: Path) -> dict[str, Any]:
    """In this process: run one stage over some frames; seconds of each and memory in MB."""
    files = [path.relative_to(results / "frames") for path in (results / "frames").glob("*/*.npz")]
    kinds = {argument: INPUTS[argument] for argument in STAGES[name]}
    stage = make_stage(name, load_config(ROOT / "config" / "config.yaml"), resources)
    base, seconds = peak_mb(), []
    for path in sorted(files)[: frames + 1]:
        given = {key: kind.load(results / folder / path) for key, (folder, kind) in kinds.items()}
        start = time.process_time()
        stage(**given, seed=frame_seed(0, path.stem, name))
        seconds.append(time.process_time() - start)
    return {"seconds": seconds, "peak_mb": peak_mb(), "base_mb": base}


def peak_mb() -> float:
    """The most memory that this process has held, MB."""
    return process.getrusage(process.RUSAGE_SELF).ru_maxrss / 1024


def in_own_process(name: str, frames: int, results: Path, resources: Path) -> dict[str, Any]:
    command = [
        sys.executable, __file__, "--stage", name, "--frames", str(frames),
        "--results", str(results), "--resources", str(resources),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{name} failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--results", type=Path, default=ROOT / "results" / "behave_mini")
    parser.add_argument("--resources", type=Path, default=ROOT / "resources")
    parser.add_argument("--stage", choices=STAGES, help="run only this one and print JSON")
    arguments = parser.parse_args()
    if not (arguments.results / "joint" / "ours").is_dir():
        raise SystemExit(f"{arguments.results} has no results of `ours` yet: run `make demo` first")
    given = (arguments.frames, arguments.results, arguments.resources)
    if arguments.stage:
        import torch

        torch.set_num_threads(1)
        print(json.dumps(run_stage(arguments.stage, *given)))
        return
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    rows = []
    for name in STAGES:
        measured = in_own_process(name, *given)
        first, others = measured["seconds"][0], measured["seconds"][1:]
        rows.append(
            {
                "stage": name,
                "frames": len(others),
                "cpu_s": rounded(statistics.median(others)),
                "first_s": rounded(first),
                "peak_mb": round(measured["peak_mb"]),
                "base_mb": round(measured["base_mb"]),
            }
        )
        show(rows[-1])
    total = {"cpu_s": rounded(sum(row["cpu_s"] for row in rows)), "first_s": "", "base_mb": ""}
    peak = max(row["peak_mb"] for row in rows)
    rows.append({"stage": "all", "frames": arguments.frames, **total, "peak_mb": peak})
    write_csv("pipeline", rows)


if __name__ == "__main__":
    main()
