"""Run the workflow as a user would, and follow its output: what runs, what is done.

Only the command line knows Snakemake; the library and its stages do not.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import hoi
from hoi.errors import ConfigError, HoiError

_STARTS = re.compile(r"^Job (\d+): (.+)$")
_FINISHED = re.compile(r"^Finished jobid: (\d+) \(Rule: (\w+)\)")
_PLANNED = re.compile(r"^(\w+) +(\d+)$")
_LOCKED = "Directory cannot be locked"


class WorkflowFailed(HoiError):
    """Snakemake stopped; the message carries the end of what it said."""


class WorkflowLocked(WorkflowFailed):
    """Another run works in the same folder."""


@dataclass(frozen=True)
class Planned:
    """How many jobs of each rule a run will start."""

    jobs: dict[str, int]


@dataclass(frozen=True)
class Started:
    """A job began; `message` is the rule's own words."""

    job: str
    message: str


@dataclass(frozen=True)
class Finished:
    """A job of `rule` is done."""

    job: str
    rule: str


Event = Planned | Started | Finished


def checkout() -> Path:
    """The folder that holds the workflow: the working directory, else where `hoi` lies.

    Raises ConfigError when neither is a checkout: the workflow is not part of the package.
    """
    for folder in (Path.cwd(), Path(hoi.__file__).parents[2]):
        if (folder / "Snakefile").is_file() and (folder / "workflow" / "rules").is_dir():
            return folder
    raise ConfigError(
        "the workflow is not here: run this in a checkout of the repository, or install the "
        "package from one with `pip install -e .`"
    )


def run_workflow(
    root: Path,
    targets: Sequence[str],
    *,
    directory: Path,
    jobs: int,
    config_file: Path | None = None,
    follow: Callable[[Event], None] = lambda event: None,
) -> None:
    """Make `targets` with the workflow of the checkout `root`.

    Args:
        root: the checkout.
        targets: files, relative to `directory`.
        directory: where the workflow works.
        jobs: parallel jobs.
        config_file: settings that go before those of ``config/config.yaml``.
        follow: told what happens, as it happens.

    Raises WorkflowFailed with the end of the output, WorkflowLocked when another run works there.
    """
    command = [sys.executable, "-m", "snakemake", *targets, f"-j{jobs}"]
    command += ["--snakefile", str(root / "Snakefile"), "--directory", str(directory)]
    command += ["--workflow-profile", str(root / "profiles" / "default")]
    if config_file is not None:
        command += ["--configfile", str(config_file)]
    source = str(Path(hoi.__file__).parents[1])
    path = os.pathsep.join(filter(None, (source, os.environ.get("PYTHONPATH", ""))))
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env=os.environ | {"PYTHONPATH": path, "PYTHONUNBUFFERED": "1"},
    )
    assert process.stdout is not None
    said: list[str] = []
    try:
        for event in events(_remembering(process.stdout, said)):
            follow(event)
        status = process.wait()
    except BaseException:
        process.terminate()  # Snakemake ends its jobs; the next run goes on from here
        process.wait()
        raise
    if status != 0:
        text = "".join(said)
        kind = WorkflowLocked if _LOCKED in text else WorkflowFailed
        raise kind(_end_of(text, status))


def events(lines: Iterator[str]) -> Iterator[Event]:
    """What Snakemake's output says, line by line."""
    planned: dict[str, int] | None = None
    for line in lines:
        text = line.rstrip()
        if text == "Job stats:":
            planned = {}
        elif planned is not None:
            if text.startswith("total"):
                yield Planned(planned)
                planned = None
            elif found := _PLANNED.match(text):
                planned[found[1]] = int(found[2])
        elif found := _STARTS.match(text):
            yield Started(found[1], found[2])
        elif found := _FINISHED.match(text):
            yield Finished(found[1], found[2])


def _remembering(stream, said: list[str]) -> Iterator[str]:
    for line in stream:
        said.append(line)
        del said[:-400]
        yield line


def _end_of(text: str, status: int) -> str:
    if _LOCKED in text:
        return (
            "another run works in the same folder. Wait for it to end; if there is none, a run "
            "was killed: `snakemake --unlock` there"
        )
    lines = [line for line in text.splitlines() if line.strip()]
    return f"the workflow stopped (exit status {status}):\n" + "\n".join(lines[-30:])
