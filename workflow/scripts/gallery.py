"""Draw the gallery of a table group: one card a frame, failures by cause."""

from pathlib import Path

from chunk_job import logged
from frame_artifacts import FrameArtifacts

from hoi.body import BodyModel
from hoi.report.config import ReportConfig
from hoi.report.gallery import card_of, gallery_page
from hoi.report.overlay import frame_thumbnail

config = ReportConfig(**snakemake.params.identity["settings"])
artifacts = FrameArtifacts(snakemake.input, snakemake.params.methods, snakemake.params.frames)
shown = set(snakemake.params.shown)
faces = BodyModel.load(Path(snakemake.input.body_model[0])).faces
cards = []
with logged(snakemake):
    for frame_id in artifacts.frame_ids():
        frame, detection = artifacts.frame(frame_id), artifacts.detection(frame_id)
        views = artifacts.views(frame_id)
        image = None
        if frame.ok:
            image = frame_thumbnail(frame, detection, views[-1].joint, faces, config)
        href = f"../pages/{frame_id}.html" if frame_id in shown else ""
        cards.append(card_of(frame, detection, views, href, image))
    heading = f"{snakemake.wildcards.dataset}: {snakemake.wildcards.group}"
    Path(snakemake.output[0]).write_text(gallery_page(cards, config, heading))
