"""Generate frames of the embedded data set, in BEHAVE's own layout."""

import json
import sys
from pathlib import Path

from chunk_job import logged

from hoi.datasets.behave import frame_files, ground_truth_files
from hoi.datasets.behave_layout import parse_frame_id
from hoi.datasets.behave_mini.config import BehaveMiniConfig
from hoi.datasets.behave_mini.generate import generate_frames
from hoi.digest import files_digest, json_digest

root = Path("resources/behave_mini")
config = BehaveMiniConfig(**snakemake.params.identity["settings"])
refs = [parse_frame_id(frame_id) for frame_id in snakemake.params.frames]
with logged(snakemake):
    for number, ref in enumerate(refs, 1):
        generate_frames(config, root, [ref])
        print(f"generated {number}/{len(refs)}: {ref.frame_id}", file=sys.stderr, flush=True)
contents = {
    ref.frame_id: json_digest(
        files_digest([*frame_files(root, ref), *ground_truth_files(root, ref)])
    )
    for ref in refs
}
Path(snakemake.output[0]).write_text(json.dumps(contents, indent=1) + "\n")
