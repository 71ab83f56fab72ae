"""Look up object size and contacts for each frame of a chunk (Section 3.3)."""

from pathlib import Path

from chunk_job import files, run_stage

from hoi.artifacts import Action, Frame, Prior


def make_stage():
    from hoi.priors.config import LookupConfig
    from hoi.priors.stage import PriorStage

    config = LookupConfig(**snakemake.params.identity["settings"])
    return PriorStage(config, Path(snakemake.input.answers[0]).parent)


run_stage(
    snakemake,
    "priors",
    Prior,
    make_stage,
    inputs={
        "frame": (Frame, snakemake.input.frames),
        "action": (Action, snakemake.input.actions),
    },
    assets=files(snakemake, "answers"),
)
