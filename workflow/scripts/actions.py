"""Recognise the action of each frame of a chunk by its nearest known pose (Section 3.2)."""

from pathlib import Path

from chunk_job import run_stage

from hoi.artifacts import Action, BodyFit, Frame


def make_stage():
    from hoi.actions.config import ActionsConfig
    from hoi.actions.stage import ActionStage

    config = ActionsConfig(**snakemake.params.identity["settings"])
    return ActionStage(
        config, Path(snakemake.input.pose_database), Path(snakemake.input.action_space)
    )


run_stage(
    snakemake,
    "actions",
    Action,
    make_stage,
    inputs={
        "frame": (Frame, snakemake.input.frames),
        "body": (BodyFit, snakemake.input.bodies),
    },
    assets=[snakemake.input.pose_database, snakemake.input.action_space],
)
