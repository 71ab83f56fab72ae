"""What the stage scripts share: one Snakemake job = one stage over one chunk of frames."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hoi.artifacts import Artifact
from hoi.chunks import run_chunk
from hoi.digest import files_digest
from hoi.memo import Memo


def run_stage(
    job,
    stage: str,
    output_kind: type[Artifact],
    make_stage: Callable[[], Callable[..., Artifact]],
    inputs: Mapping[str, tuple[type[Artifact], str]],
    assets: Sequence[str] = (),
    views: Mapping[str, Callable[[Any], Artifact]] | None = None,
) -> None:
    """Run `stage` for the job that Snakemake hands to a script.

    Args:
        job: the script's ``snakemake`` object.
        stage, output_kind, make_stage, inputs, views: see :func:`hoi.chunks.run_chunk`.
        assets: files that every frame's result depends on, by content.
    """
    identity = dict(job.params.identity)
    seed = identity.pop("seed")
    identity["assets"] = files_digest(assets)
    with logged(job):
        run_chunk(
            stage,
            output_kind,
            make_stage,
            inputs,
            job.output.index,
            job.output.seconds,
            Memo(job.config["memo"]),
            identity,
            seed,
            views,
        )


def files(job, name: str) -> list[str]:
    """The files of one named input, however many there are."""
    value = job.input.get(name, [])
    return [value] if isinstance(value, str) else list(value)


@contextlib.contextmanager
def logged(job):
    """Send progress lines to the job's log file; an error still reaches the terminal."""
    with open(job.log[0], "w") as log, contextlib.redirect_stderr(log):
        yield
