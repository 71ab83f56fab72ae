"""Pass the images of one person with one object; the others fail with their reason."""

from chunk_job import logged

from hoi.artifacts import Detection
from hoi.chunks import Index, artifact_path, write_chunk
from hoi.digest import json_digest
from hoi.interactions.config import InteractionsConfig
from hoi.interactions.filters import check_interaction
from hoi.memo import Memo

config = InteractionsConfig(**snakemake.params.identity["settings"])
source = snakemake.input.detections
frames = Index.load(source).frames


def filtered(frame_id):
    detection = Detection.load(artifact_path(source, frame_id))
    if detection.ok:
        check_interaction(detection, config)
    return detection


with logged(snakemake):
    write_chunk(
        "interaction_filter",
        Detection,
        list(frames),
        filtered,
        {
            key: json_digest(["interaction_filter", entry.sha256, snakemake.params.identity])
            for key, entry in frames.items()
        },
        snakemake.output.index,
        snakemake.output.seconds,
        Memo(snakemake.config["memo"]),
    )
