"""Choose the exemplars of one category (Section 3.5)."""

from pathlib import Path

from hoi.exemplars.build import build_library
from hoi.exemplars.config import ExemplarsConfig

config = ExemplarsConfig(**snakemake.params.identity["settings"])
build_library(
    config,
    Path(snakemake.output[0]).parent,
    snakemake.wildcards.category,
    cache=Path(snakemake.config["memo"]) / "shapes",
    workers=snakemake.threads,
    own=[Path(file) for file in snakemake.input.own],
)
