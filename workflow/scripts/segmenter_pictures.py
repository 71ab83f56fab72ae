"""Render one part of the segmenter's pictures; those that are there already are kept."""

import json
import logging
from pathlib import Path

from chunk_job import logged

from hoi.digest import files_digest, json_digest
from hoi.segmenter.config import SceneConfig
from hoi.segmenter.pictures import picture_names, render_pictures

identity = dict(snakemake.params.identity)
config = SceneConfig(**identity["settings"])
names = picture_names(config, snakemake.wildcards.split)
first = int(snakemake.wildcards.part) * config.chunk
# how many there are decides no picture
looks = config.model_dump(mode="json", exclude={"scenes", "validation", "chunk"})
inputs = [snakemake.input.meshes, snakemake.input.body, snakemake.input.poses]
key = json_digest(identity | {"settings": looks, "inputs": files_digest(inputs)})
with logged(snakemake):
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    files = render_pictures(
        names[first : first + config.chunk],
        Path(snakemake.output[0]).parent / key[:16],
        config,
        identity["seed"],
        Path(snakemake.input.meshes).parent,
        Path(snakemake.input.models).parent,
        Path(snakemake.input.body),
        Path(snakemake.input.poses),
    )
Path(snakemake.output[0]).write_text(json.dumps([str(file) for file in files], indent=1) + "\n")
