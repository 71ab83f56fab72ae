"""Fit the body to the keypoints of each frame of a chunk (Section 3.1, Equation 1)."""

from pathlib import Path

from chunk_job import run_stage

from hoi.artifacts import BodyFit, Detection, Frame


def make_stage():
    from hoi.smplify.config import SmplifyConfig
    from hoi.smplify.stage import SmplifyStage

    config = SmplifyConfig(**snakemake.params.identity["settings"])
    return SmplifyStage(
        config, Path(snakemake.input.body_model), Path(snakemake.input.pose_database)
    )


run_stage(
    snakemake,
    "smplify",
    BodyFit,
    make_stage,
    inputs={
        "frame": (Frame, snakemake.input.frames),
        "detection": (Detection, snakemake.input.detections),
    },
    assets=[snakemake.input.body_model, snakemake.input.pose_database],
)
