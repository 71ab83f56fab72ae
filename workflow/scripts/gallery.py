"""Draw the gallery of one or several table groups: tables, failures by cause, a card a frame."""

import os
from pathlib import Path

from chunk_job import logged
from frame_artifacts import FrameArtifacts

from hoi.report.config import ReportConfig
from hoi.report.gallery import card_of, gallery_page
from hoi.report.overlay import frame_thumbnail
from hoi.report.tables import ablation_layout, as_html, layout, linked, read_results

config = ReportConfig(**snakemake.config.get("report", {}))
methods = snakemake.params.methods
artifacts = FrameArtifacts(snakemake.input, methods)
folder = Path(snakemake.output[0]).parent
pages = {
    Path(path).stem: os.path.relpath(path, folder) for path in snakemake.input.get("pages", [])
}
SHOWN = "ours"
TITLES = {"actions": "how well actions are told apart, with the nearest poses of each"}


def tables() -> list[str]:
    """The result tables among the inputs, every number linked to its frames on this page."""
    found = []
    for name, path in snakemake.input.items():
        if name.startswith("table_"):
            results = read_results(path)
            make = ablation_layout if name == "table_ablation" else layout
            found += [as_html(linked(part, "", methods)) for part in make(results, detail=True)]
    return found


cards = []
with logged(snakemake):
    for frame_id in artifacts.frame_ids():
        frame, detection = artifacts.frame(frame_id), artifacts.detection(frame_id)
        # groups are compared by different methods
        views = [view for view in artifacts.views(frame_id) if view.joint is not None]
        shown = next((view for view in views if view.name == SHOWN), views[-1])
        image = None
        if frame.ok:
            image = frame_thumbnail(frame, detection, shown.joint, artifacts.faces, config)
        truth = artifacts.truth(frame_id)
        cards.append(
            card_of(frame, detection, views, pages.get(frame_id, ""), image, truth, config)
        )
    others = {
        TITLES[Path(path).stem]: os.path.relpath(path, folder)
        for path in snakemake.input.get("others", [])
    }
    page = gallery_page(cards, config, snakemake.params.heading, tables(), others)
    Path(snakemake.output[0]).write_text(page)
