"""Draw the page of one frame: the photo, every stage's decision, the scene in 3D."""

from pathlib import Path

from chunk_job import logged
from frame_artifacts import FrameArtifacts

from hoi.report.config import ReportConfig
from hoi.report.page import frame_page

config = ReportConfig(**snakemake.config.get("report", {}))
frame_id = snakemake.wildcards.frame
artifacts = FrameArtifacts(snakemake.input, snakemake.params.methods)
with logged(snakemake):
    frame = artifacts.frame(frame_id)
    page = frame_page(
        frame,
        artifacts.detection(frame_id),
        artifacts.views(frame_id),
        artifacts.faces,
        artifacts.exemplars(frame.category),
        config,
        truth=artifacts.truth(frame_id),
        poses=artifacts.poses,
        seconds=artifacts.seconds(frame_id),
        settings=artifacts.settings,
        index=snakemake.params.index,
    )
    Path(snakemake.output[0]).write_text(page)
