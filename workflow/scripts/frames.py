"""Read the frames of a chunk, and their ground truth, from BEHAVE's layout."""

import json
from pathlib import Path

from chunk_job import logged

from hoi.artifacts import Frame, GroundTruth
from hoi.chunks import write_chunk
from hoi.datasets.behave import read_frame, read_ground_truth
from hoi.datasets.behave_config import BehaveConfig
from hoi.datasets.behave_layout import FrameRef, parse_frame_id
from hoi.digest import json_digest
from hoi.memo import Memo
from hoi.readers.attach import attach
from hoi.readers.config import OtherSystems
from hoi.readers.paths import behave_names

config = BehaveConfig(**snakemake.params.reader)
root = Path(config.root or "").expanduser()
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
others = OtherSystems(**snakemake.params.identity["settings"]["other_systems"])


def read_with_others(root: Path, ref: FrameRef, config: BehaveConfig) -> Frame:
    frame = read_frame(root, ref, config, dataset=dataset)
    if others == OtherSystems():
        return frame
    names = behave_names(ref.frame_id, ref.sequence, ref.time, config.kinect)
    return attach(frame, others, names, root)


memo = Memo(snakemake.config["memo"])
with logged(snakemake):
    for name, kind, read, index, seconds in (
        (
            "frames",
            Frame,
            read_with_others,
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
