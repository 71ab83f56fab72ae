"""Optimise body and object of each frame of a chunk together (Section 3.4)."""

from pathlib import Path

from chunk_job import files, run_stage

from hoi.artifacts import BodyFit, Detection, Frame, GroundTruth, Joint, ObjectFit, Prior
from hoi.joint.config import JointConfig
from hoi.joint.reading import what_is_read

CONFIG = JointConfig(**snakemake.params.identity["settings"])


def make_stage():
    from hoi.joint.stage import JointStage

    return JointStage(CONFIG, Path(snakemake.input.body_model), Path("resources/exemplars"))


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
    views={"prior": lambda prior: what_is_read(prior, CONFIG)},
    assets=[snakemake.input.body_model, *files(snakemake, "exemplars")],
)
