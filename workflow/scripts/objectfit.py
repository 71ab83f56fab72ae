"""Fit exemplars to the object mask of each frame of a chunk (Section 3.1)."""

from pathlib import Path

from chunk_job import files, run_stage

from hoi.artifacts import Detection, Frame, ObjectFit


def make_stage():
    from hoi.objectfit.config import ObjectFitConfig
    from hoi.objectfit.stage import ObjectFitStage

    config = ObjectFitConfig(**snakemake.params.identity["settings"])
    return ObjectFitStage(config, Path("resources/exemplars"))


run_stage(
    snakemake,
    "objectfit",
    ObjectFit,
    make_stage,
    inputs={
        "frame": (Frame, snakemake.input.frames),
        "detection": (Detection, snakemake.input.detections),
    },
    assets=files(snakemake, "exemplars"),
)
