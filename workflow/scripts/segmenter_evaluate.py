"""Measure one set of weights on the validation pictures, beside GrabCut."""

import json
import logging
from pathlib import Path

from chunk_job import logged

from hoi.segmenter.evaluation import Evaluator, evaluate, summary

minimum = snakemake.params.identity["settings"]["minimum_box_overlap"]
parts = [json.loads(Path(part).read_text()) for part in snakemake.input.pictures]
files = [Path(name) for part in parts for name in part]
with logged(snakemake):
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    models = Path(snakemake.input.models).parent
    rows = evaluate(files, Evaluator(Path(snakemake.input.weights), models, minimum))
    rows.to_csv(snakemake.output.pictures, index=False, float_format="%.3f")
    table = summary(rows)
    table.insert(0, "weights", snakemake.wildcards.weights)
    table.to_csv(snakemake.output.summary, index=False, float_format="%.3f")
