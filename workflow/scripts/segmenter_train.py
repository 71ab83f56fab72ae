"""Train the object segmenter, from its last checkpoint if there is one."""

import json
import logging
import shutil
from pathlib import Path

from chunk_job import logged

from hoi.digest import json_digest
from hoi.segmenter.config import TrainConfig
from hoi.segmenter.samples import SampleSet
from hoi.segmenter.training import train

identity = dict(snakemake.params.identity)
config = TrainConfig(**identity["settings"])
output = Path(snakemake.output[0])
parts = [json.loads(Path(part).read_text()) for part in snakemake.input.pictures]
files = [Path(name) for part in parts for name in part]
# the pictures' folder is named after all that they depend on
key = json_digest(identity | {"pictures": [str(file) for file in files]})
checkpoint = output.parent / "training" / f"{key[:16]}.pt"
with logged(snakemake):
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    nanodet = Path(snakemake.input.models).parent / "nanodet.onnx"
    train(SampleSet(files), config, identity["seed"], nanodet, checkpoint)
shutil.copyfile(checkpoint, output)
