"""Optimise body and object of each frame of a chunk together (Section 3.4)."""

from pathlib import Path

from chunk_job import files, run_stage

from hoi.artifacts import BodyFit, Detection, Frame, GroundTruth, Joint, ObjectFit, Prior


def make_stage():
    from hoi.joint.config import JointConfig
    from hoi.joint.stage import JointStage

    config = JointConfig(**snakemake.params.identity["settings"])
    return JointStage(config, Path(snakemake.input.body_model), Path("resources/exemplars"))


run_stage(
    snakemake,
    "joint",
    Joint,
    make_stage,
    inputs={
        "frame": (Frame, snakemake.input.frames),
        "detection": (Detection, snakemake.input.detections),
        "body": (BodyFit, snakemake.input.bodies),
        "objects": (ObjectFit, snakemake.input.objects),
        "prior": (Prior, snakemake.input.priors),
        **({"truth": (GroundTruth, snakemake.input.truth)} if snakemake.input.truth else {}),
    },
    assets=[snakemake.input.body_model, *files(snakemake, "exemplars")],
)
