"""How long a run will take: what earlier runs took here, else what is typical."""

from __future__ import annotations

import json
import statistics
from pathlib import Path

from hoi.config import RunConfig

#: Seconds a frame on one quiet core, by the folder of a stage's results; medians over the chairs
#: of the embedded test split.
TYPICAL = {
    "frames": 0.1, "truth": 0.1, "detect": 0.5, "smplify": 1.2, "objectfit": 1.8,
    "actions": 0.15, "priors": 0.1, "joint": 1.7, "evaluate": 0.6,
}  # fmt: skip
_SHARED = ("frames", "truth", "detect", "smplify", "actions", "priors")
_SHEET = ".seconds.json"


def seconds_per_frame(config: RunConfig, results: Path, methods: tuple[str, ...]) -> float:
    """All stages of some methods for one frame, in seconds of one core."""
    searches = dict.fromkeys(config.methods[method].search for method in methods)
    stages = [
        *_SHARED,
        *(f"objectfit/{search}" for search in searches),
        *(f"{stage}/{method}" for method in methods for stage in ("joint", "evaluate")),
    ]
    return sum(_seconds(results, stage) for stage in stages)


def was_measured(results: Path) -> bool:
    """Whether any time sheet of an earlier run lies in a folder of results."""
    return any(results.glob(f"*/*{_SHEET}"))


def _seconds(results: Path, stage: str) -> float:
    found: list[float] = []
    for path in sorted((results / stage).glob(f"*{_SHEET}")):
        try:
            found += [float(value) for value in json.loads(path.read_text()).values()]
        except (OSError, ValueError, AttributeError, TypeError):
            continue
    return statistics.median(found) if found else TYPICAL[stage.partition("/")[0]]


def spoken(seconds: float) -> str:
    """A duration as people say it."""
    if seconds < 90:
        return f"{seconds:.0f} seconds"
    if seconds < 5400:
        return f"{seconds / 60:.0f} minutes"
    return f"{seconds / 3600:.1f} hours"
