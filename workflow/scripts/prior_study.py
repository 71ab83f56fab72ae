"""Judge the priors: votes of people and models, agreement, sizes by axis (Section 4.1)."""

from pathlib import Path

from chunk_job import logged

from hoi.priors import study
from hoi.priors.config import StudyConfig
from hoi.priors.tables import load_tables

with logged(snakemake):
    config = StudyConfig(**snakemake.config["prior_study"])
    tables = load_tables(Path(snakemake.input.recorded[0]).parent)
    models = [study.voice_of_model(judge, tables) for judge in config.judges]
    output = snakemake.output
    study.write_rows(
        Path(output.study), study.STUDY_COLUMNS, study.study_table(config, tables, models)
    )
    study.write_rows(
        Path(output.agreement),
        study.AGREEMENT_COLUMNS,
        study.agreement_table([*study.voices_of_tables(tables), *models], config),
    )
    study.write_rows(Path(output.sizes), study.SIZE_COLUMNS, study.size_table(tables))
