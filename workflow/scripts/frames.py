"""Read the frames of a chunk, and their ground truth, from BEHAVE's layout."""

import json
from functools import partial
from pathlib import Path

from chunk_job import logged

from hoi.artifacts import Frame, GroundTruth
from hoi.chunks import write_chunk
from hoi.datasets.behave import read_frame, read_ground_truth
from hoi.datasets.behave_config import BehaveConfig
from hoi.datasets.behave_layout import parse_frame_id
from hoi.digest import json_digest
from hoi.memo import Memo

config = BehaveConfig(**snakemake.params.reader)
root = Path(config.root).expanduser()
dataset = snakemake.wildcards.dataset
frames = {frame["frame_id"]: frame for frame in snakemake.params.frames}
generated = snakemake.input.get("generated")
if generated:  # the raw files were generated: their digests are known by now
    digests = json.loads(Path(generated).read_text())
    frames = {key: frame | {"digest": digests[key]} for key, frame in frames.items()}

# where the tree lies and which frames were picked change no frame
reader = config.model_dump(include={"kinect", "smplh_root"}) | {
    "smplh": bool(config.smplh),
    "fits_30fps": bool(config.fits_30fps),
}
memo = Memo(snakemake.config["memo"])
with logged(snakemake):
    for name, kind, read, index, seconds in (
        (
            "frames",
            Frame,
            partial(read_frame, dataset=dataset),
            snakemake.output.index,
            snakemake.output.seconds,
        ),
        (
            "truth",
            GroundTruth,
            read_ground_truth,
            snakemake.output.truth,
            snakemake.output.truth_seconds,
        ),
    ):
        write_chunk(
            name,
            kind,
            list(frames),
            lambda frame_id, read=read: read(root, parse_frame_id(frame_id), config),
            {
                key: json_digest([name, frame, reader, snakemake.params.identity])
                for key, frame in frames.items()
            },
            index,
            seconds,
            memo,
        )
