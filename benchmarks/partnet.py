"""Exemplar selection over a folder of a thousand shapes in PartNet's layout.

    python benchmarks/partnet.py --shapes 1000 --workers 2 --out benchmarks/results/partnet.csv

Writes generated chairs as PartNet folders into a temporary directory (not timed), then runs the
selection as the workflow does and reports time and the most memory that any process took.
"""

from __future__ import annotations

import argparse
import csv
import resource
import tempfile
import time
from pathlib import Path

from hoi.exemplars.build import build_library
from hoi.exemplars.config import ExemplarsConfig
from hoi.exemplars.partnet_fixture import write_shape
from hoi.exemplars.procedural import generate


def cpu_seconds() -> float:
    """CPU time of this process and of its finished workers."""
    return sum(
        usage.ru_utime + usage.ru_stime
        for usage in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def main() -> None:
    """Write the shapes, select, report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--shapes", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root, cache = Path(folder) / "data_v0", Path(folder) / "cache"
        for seed in range(options.shapes):
            write_shape(root, str(10_000 + seed), generate("chair", seed, 1000))
        config = ExemplarsConfig(sources=(), partnet=str(root))
        rows = []
        for run in ("first", "again, distances remembered"):
            started, cpu = time.perf_counter(), cpu_seconds()
            build_library(config, Path(folder) / "out", "chair", cache, options.workers)
            wall, used = time.perf_counter() - started, cpu_seconds() - cpu
            rows.append([run, options.shapes, options.workers, wall, used])
            print(run, f"{wall:.1f} s, {used:.1f} CPU seconds", flush=True)
        used = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        memory = [resource.getrusage(who).ru_maxrss / 1024 for who in used]
        size = sum(f.stat().st_size for f in cache.rglob("*")) / 2**20
    header = [
        "run",
        "shapes",
        "workers",
        "wall_seconds",
        "cpu_seconds",
        "main_process_mb",
        "worker_mb",
        "cache_mb",
    ]
    table = [
        [*row[:3], *(f"{t:.1f}" for t in row[3:]), *(f"{m:.0f}" for m in (*memory, size))]
        for row in rows
    ]
    for row in [header, *table]:
        print(", ".join(map(str, row)))
    if options.out:
        with options.out.open("w", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerows([header, *table])


if __name__ == "__main__":
    main()
