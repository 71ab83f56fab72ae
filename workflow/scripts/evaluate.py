"""Measure one method on each frame of a chunk (Section 4.2)."""

from pathlib import Path

from chunk_job import run_stage

from hoi.artifacts import Evaluation, Frame, GroundTruth, Joint


def make_stage():
    from hoi.evaluate.config import EvaluateConfig
    from hoi.evaluate.stage import EvaluateStage

    config = EvaluateConfig(**snakemake.params.identity["settings"])
    return EvaluateStage(config, Path(snakemake.input.body_model))


run_stage(
    snakemake,
    "evaluate",
    Evaluation,
    make_stage,
    inputs={
        "frame": (Frame, snakemake.input.frames),
        "truth": (GroundTruth, snakemake.input.truth),
        "joint": (Joint, snakemake.input.joints),
    },
    assets=[snakemake.input.body_model],
)
