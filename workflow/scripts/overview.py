"""Draw one frame's way from photo to scene on a sheet: the picture of the README."""

from pathlib import Path

from chunk_job import logged
from frame_artifacts import FrameArtifacts

from hoi.report.config import ReportConfig
from hoi.report.overlay import close_up, frame_overlays, jpeg, overview
from hoi.report.scene import gravity_up

config = ReportConfig(**(snakemake.config.get("report", {}) | snakemake.params.sharp))
frame_id = snakemake.params.frame
artifacts = FrameArtifacts(snakemake.input, [snakemake.params.method])
with logged(snakemake):
    frame = artifacts.frame(frame_id)
    (view,) = artifacts.views(frame_id)
    panels = frame_overlays(
        frame,
        artifacts.detection(frame_id),
        view.body,
        view.objects,
        view.joint,
        artifacts.faces,
        artifacts.exemplars(frame.category),
        config,
        gravity_up(view.joint, view.prior),
    )
    panels = [close_up(frame, artifacts.detection(frame_id), config), *panels[1:]]
    Path(snakemake.output[0]).write_bytes(jpeg(overview(panels), config.jpeg_quality))
