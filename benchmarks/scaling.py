"""How cost grows with image size, batch, exemplars, hypotheses and frames.

    python benchmarks/scaling.py [--quick]

CPU seconds of one thread and the growth of peak memory, each measurement in a process of its own.
`silhouette` is the loss with gradient by the vertices of 64 meshes (or of a batch, at 128 pixels),
`objectfit` the search among exemplars of one category (or over frames, with five exemplars),
`joint` the fast schedule of `ours` on a toy frame. Writes ``results/scaling.csv``.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from importlib import import_module
from pathlib import Path
from typing import Any

from measure import rounded, show, write_csv

PARTS = {
    ("silhouette", "pixels"): (32, 64, 128, 256, 512),
    ("silhouette", "meshes"): (1, 16, 256),
    ("objectfit", "exemplars"): (5, 10, 20),
    ("objectfit", "frames"): (1, 2, 4),
    ("joint", "hypotheses"): (5, 10, 20),
}


def silhouette(pixels: int = 128, meshes: int = 64) -> float:
    from silhouette import Scene

    scene = Scene(pixels, meshes)
    scene.loss(scene.xy)
    start = time.process_time()
    for _ in range(3):
        scene.loss(scene.xy)
    return (time.process_time() - start) / 3


def objectfit(exemplars: int = 5, frames: int = 1) -> float:
    from pose_recovery import measure

    row = measure("upright", frames, exemplars)
    seconds = row["cpu_s"]
    assert isinstance(seconds, float)
    return seconds * frames


def joint(hypotheses: int) -> float:
    from joint import EXEMPLARS, METHODS, seconds_of, sitting_scene, with_hypotheses

    poses = hypotheses // EXEMPLARS
    settings = METHODS.joint_settings("ours").model_copy(
        update={"max_hypotheses": hypotheses, "poses_per_exemplar": poses}
    )
    with tempfile.TemporaryDirectory() as folder:
        scene = with_hypotheses(sitting_scene(), poses, Path(folder))
        return seconds_of(settings, scene, Path(folder), 2)[0]


def here(part: str, parameter: str, value: int) -> dict[str, float]:
    """Measure in this process."""
    import torch

    torch.set_num_threads(1)
    import_module({"objectfit": "pose_recovery"}.get(part, part))
    before = _peak_mb()
    run = {"silhouette": silhouette, "objectfit": objectfit, "joint": joint}[part]
    seconds = run(**{parameter: value})
    return {"cpu_s": seconds, "more_mb": _peak_mb() - before}


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def in_own_process(part: str, parameter: str, value: int) -> dict[str, Any]:
    command = [sys.executable, __file__, "--only", part, parameter, str(value)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{part} with {parameter} {value} failed:\n{done.stderr}")
    measured = json.loads(done.stdout.splitlines()[-1])
    return {
        "part": part,
        "parameter": parameter,
        "value": value,
        "cpu_s": rounded(measured["cpu_s"]),
        "cpu_ms_per_unit": rounded(1e3 * measured["cpu_s"] / value),
        "more_mb": round(measured["more_mb"]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs=3, metavar=("PART", "PARAMETER", "VALUE"))
    parser.add_argument("--quick", action="store_true", help="silhouettes alone")
    arguments = parser.parse_args()
    if arguments.only:
        part, parameter, value = arguments.only
        print(json.dumps(here(part, parameter, int(value))))
        return
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    rows = []
    for (part, parameter), values in PARTS.items():
        if arguments.quick and part != "silhouette":
            continue
        for value in values:
            rows.append(in_own_process(part, parameter, value))
            show(rows[-1])
    write_csv("quick_scaling" if arguments.quick else "scaling", rows)


if __name__ == "__main__":
    main()
