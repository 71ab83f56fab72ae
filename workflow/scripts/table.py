"""Collect the evaluations of several methods into one result table (Section 4.2)."""

from pathlib import Path

import pandas as pd
from chunk_job import logged
from evaluations import protocols_of, read_evaluations

from hoi.evaluate.tables import named_protocols, summarise, summarise_contacts
from hoi.report.tables import (
    ablation_layout,
    as_html_page,
    as_latex,
    layout,
    paper_reference,
)

table = snakemake.params.table
with logged(snakemake):
    found = read_evaluations(snakemake.input, table)
    by_protocol = protocols_of(found, table)

    def summed(frames):
        return summarise(
            frames, table["category"], table["methods"], table["masks"], table["failure_cm"]
        )

    frames = by_protocol[table["align"]]
    summary = summed(frames)
    frames.to_csv(snakemake.output.frames, index=False, float_format="%.3f")
    summary.to_csv(snakemake.output.csv, index=False, float_format="%.3f")
    # one table for each protocol, the main one first, in the layout of the main table
    protocols = pd.concat(
        [named_protocols(summed(part), name) for name, part in by_protocol.items()]
    )
    protocols.to_csv(snakemake.output.protocols, index=False, float_format="%.3f")
    everything = [evaluation for method in found for evaluation in method.evaluations]
    contacts = summarise_contacts(everything, table["frames"], table["category"], table["masks"])
    contacts.to_csv(snakemake.output.contacts, index=False, float_format="%.3f")
    in_print = "ablation" if table["ablation"] else table["category"]
    printed = paper_reference()
    printed[printed["table"] == in_print].to_csv(snakemake.output.paper, index=False)
    make_layout = ablation_layout if table["ablation"] else layout
    laid_out = make_layout(summary, table["methods"], detail=True)
    Path(snakemake.output.html).write_text(as_html_page(laid_out, laid_out[0].title))
    Path(snakemake.output.tex).write_text("\n\n".join(as_latex(part) for part in laid_out))
