"""Fetch the detectors' model files, pinned by version and sha256."""

import logging
from pathlib import Path

from hoi.detect.models import fetch_models

logging.basicConfig(level=logging.INFO, format="%(message)s")
fetch_models(Path(snakemake.output[0]).parent, snakemake.wildcards.which)
