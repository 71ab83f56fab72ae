"""Fetch the detectors' model files, pinned by version and sha256."""

from pathlib import Path

from hoi.detect.models import fetch_models

fetch_models(Path(snakemake.output[0]).parent, snakemake.wildcards.which)
