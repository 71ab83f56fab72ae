"""Ask a language model for sizes and contacts, or replay what it answered (Section 3.3)."""

from pathlib import Path

from chunk_job import logged

from hoi.priors.answered import write_tables
from hoi.priors.config import LanguageModelConfig

with logged(snakemake):
    # how to reach the server is no part of any result, so it comes past the parameters
    config = LanguageModelConfig(**snakemake.config["language_model"])
    write_tables(
        config,
        Path(snakemake.input.recorded[0]).parent,
        Path(snakemake.output.tables[0]).parent,
    )
