"""Find the person and the object in each frame of a chunk (Section 3.1)."""

from pathlib import Path

from chunk_job import files, run_stage

from hoi.artifacts import Detection, Frame


def make_stage():
    from hoi.detect.config import DetectConfig
    from hoi.detect.stage import DetectStage

    config = DetectConfig(**snakemake.params.identity["settings"])
    return DetectStage(config, Path("resources/models"))


run_stage(
    snakemake,
    "detect",
    Detection,
    make_stage,
    inputs={
        "frame": (Frame, snakemake.input.frames),
    },
    assets=files(snakemake, "models"),
)
