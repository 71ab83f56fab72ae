"""Everything that ``hoi check-data`` says."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from hoi.checks.assets import check_body, check_exemplars, check_photos
from hoi.checks.behave import SET, check_behave
from hoi.checks.behave_frames import FrameSurvey
from hoi.checks.cost import seconds_per_frame, spoken, was_measured
from hoi.checks.findings import Finding, ok
from hoi.config import RunConfig
from hoi.datasets.behave_layout import TABLE_GROUPS

TIME = "Run time"


class Report(NamedTuple):
    """Findings, and the frames of every table where the data set is BEHAVE."""

    findings: list[Finding]
    frames: dict[str, list[FrameSurvey]]


def check_data(config: RunConfig, results: Path = Path("results"), jobs: int = 2) -> Report:
    """Walk everything that a configuration points at; nothing is written."""
    frames: dict[str, list[FrameSurvey]] = {}
    if config.dataset_name == "behave":
        findings, frames = check_behave(config)
        counts = {group: _kept(config, found) for group, found in frames.items()}
    else:
        findings, counts = _embedded(config)
    findings += [*check_body(config), *check_exemplars(config), *check_photos(config)]
    findings += _time(config, counts, results / config.dataset_name, jobs)
    return Report(findings, frames)


def _kept(config: RunConfig, found: list[FrameSurvey]) -> int:
    from hoi.manifest import thinned

    return len(thinned([seen.ref for seen in found], config.frames))


def _embedded(config: RunConfig) -> tuple[list[Finding], dict[str, int]]:
    from hoi.datasets.behave_mini.plan import plan

    settings = config.behave_mini_settings
    counts = {group: len(plan(settings, group, config.split)) for group in TABLE_GROUPS}
    told = ", ".join(f"{group} {count}" for group, count in counts.items())
    text = (
        "behave.root is not set, so the tables are of behave_mini, which is generated when it is "
        f"needed. Frames of each table (split {config.split!r}): {told}."
    )
    return [ok(SET, text)], counts


def _time(config: RunConfig, counts: dict[str, int], results: Path, jobs: int) -> list[Finding]:
    if not any(counts.values()) or not config.tables.methods:
        return []
    each = seconds_per_frame(config, results, config.tables.methods)
    basis = "as earlier runs here took" if was_measured(results) else "typical of one quiet core"
    tables = ", ".join(
        f"{group} {spoken(count * each / jobs)}" for group, count in counts.items() if count
    )
    methods = " and ".join(config.tables.methods)
    return [
        ok(
            TIME,
            f"About {each:.0f} seconds a frame for {methods}, {basis}. With {jobs} jobs: "
            f"{tables}; together {spoken(sum(counts.values()) * each / jobs)}.",
        )
    ]
