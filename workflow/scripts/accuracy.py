"""Compare methods frame by frame, under every protocol (Section 4.2)."""

from pathlib import Path

import pandas as pd
from chunk_job import logged
from evaluations import protocols_of, read_evaluations

from hoi.evaluate.compare import paired
from hoi.evaluate.tables import named_protocols, summarise
from hoi.report.accuracy import draw_paired, paired_layout
from hoi.report.tables import ablation_layout, as_html_page

table = snakemake.params.table
with logged(snakemake):
    found = read_evaluations(snakemake.input, table)
    summaries, comparisons = {}, {}
    for name, frames in protocols_of(found, table).items():
        summaries[name] = summarise(
            frames, table["category"], table["methods"], table["masks"], table["failure_cm"]
        )
        comparisons[name] = paired(frames, table["methods"][0], table["category"])
    main = table["align"]
    protocols_of(found, table)[main].to_csv(
        snakemake.output.frames, index=False, float_format="%.3f"
    )
    pd.concat([named_protocols(summary, name) for name, summary in summaries.items()]).to_csv(
        snakemake.output.csv, index=False, float_format="%.3f"
    )
    pd.concat(comparisons.values()).to_csv(
        snakemake.output.paired, index=False, float_format="%.3f"
    )
    laid_out = ablation_layout(summaries[main], table["methods"], detail=True)
    Path(snakemake.output.html).write_text(
        as_html_page((*laid_out, paired_layout(comparisons[main])), "Accuracy")
    )
    draw_paired(comparisons[main], snakemake.output.picture)
