"""Read a chunk of searched images; images that are too small fail here (Section 3.2)."""

from chunk_job import logged

from hoi.artifacts import Frame
from hoi.chunks import write_chunk
from hoi.digest import json_digest
from hoi.interactions.config import InteractionsConfig
from hoi.interactions.images import list_images, read_image
from hoi.memo import Memo

config = InteractionsConfig(**snakemake.params.identity["settings"])
frames = {frame["frame_id"]: frame for frame in snakemake.params.frames}
listed = list_images(config, snakemake.params.categories)
images = {image.frame_id: image for image in listed if image.frame_id in frames}

with logged(snakemake):
    write_chunk(
        "interaction_images",
        Frame,
        list(frames),
        lambda frame_id: read_image(config, images[frame_id]),
        {
            key: json_digest(["interaction_images", frame, snakemake.params.identity])
            for key, frame in frames.items()
        },
        snakemake.output.index,
        snakemake.output.seconds,
        Memo(snakemake.config["memo"]),
    )
