"""What the benchmarks share: timing, the machine in words, and CSV files that say where and how.

Every benchmark writes ``benchmarks/results/<name>.csv``: its rows, with the machine, its load, the
commit and the versions of the libraries in the last columns.
"""

from __future__ import annotations

import csv
import os
import platform
import statistics
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
LIBRARIES = ("numpy", "numba", "torch")


def milliseconds(run: Callable[[], object], per: int = 1, repeats: int = 9) -> float:
    """Median CPU time of one call divided by `per`, after one call that does not count.

    CPU time of this process, so that other jobs on the machine count little.
    """
    run()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return statistics.median(times) / per * 1e3


def machine() -> dict[str, str]:
    """Processor, cores, load of the last minute, commit and library versions."""
    versions = " ".join(f"{name} {_version(name)}" for name in LIBRARIES)
    return {
        "processor": _processor(),
        "cores": str(len(os.sched_getaffinity(0))),
        "load": f"{os.getloadavg()[0]:.1f}",
        "commit": _commit(),
        "versions": f"python {platform.python_version()} {versions}",
    }


def write_csv(name: str, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write rows (all with the same keys) and the machine to ``results/<name>.csv``."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.csv"
    here = machine()
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [*rows[0], *here], lineterminator="\n")
        writer.writeheader()
        writer.writerows({**row, **here} for row in rows)
    print(f"wrote {path}")
    return path


def show(row: Mapping[str, Any]) -> None:
    """Print one row as it is measured."""
    print("  ".join(f"{key} {value}" for key, value in row.items()), flush=True)


def rounded(value: float, digits: int = 3) -> float:
    """A number to so many significant digits, for tables."""
    return float(f"{value:.{digits}g}")


def _version(library: str) -> str:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "absent"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def _commit() -> str:
    here = Path(__file__).parent
    command = ["git", "-C", str(here), "describe", "--always", "--dirty", "--exclude=*"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"
