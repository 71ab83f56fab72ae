"""Count how often the detectors find the person and the right object (Section 4.2)."""

from pathlib import Path

from chunk_job import logged

from hoi.artifacts import Detection, Frame
from hoi.chunks import read_artifacts
from hoi.detect.agreement import detection_table
from hoi.detect.config import DetectConfig
from hoi.report.detection import detection_layout
from hoi.report.tables import as_html_page

config = DetectConfig(**snakemake.params.identity["settings"])


def pairs():
    """Frames that could be read, with what the detectors said; one in memory at a time."""
    indexes = zip(snakemake.input.frames, snakemake.input.detections, strict=True)
    for frames, detections in indexes:
        looked = read_artifacts(Detection, detections)
        for frame, detection in zip(read_artifacts(Frame, frames), looked, strict=True):
            if frame.ok:
                # the photo itself is not compared, and a thousand of them do not fit
                yield frame.model_copy(update={"image": None}), detection


with logged(snakemake):
    table = detection_table(pairs(), config)
    table.insert(0, "dataset", snakemake.params.dataset)
    table.insert(1, "split", snakemake.params.split)
    table.to_csv(snakemake.output.csv, index=False, float_format="%.3f")
    laid_out = detection_layout(table)
    Path(snakemake.output.html).write_text(as_html_page([laid_out], laid_out.title))
