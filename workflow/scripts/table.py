"""Collect the evaluations of several methods into one result table (Section 4.2)."""

import json
from collections import Counter
from pathlib import Path

import pandas as pd
from chunk_job import logged

from hoi.artifacts import Evaluation
from hoi.chunks import read_artifacts
from hoi.evaluate.tables import (
    evaluation_frame,
    named_protocols,
    summarise,
    summarise_contacts,
    under_protocol,
)
from hoi.report.tables import (
    ablation_layout,
    as_html_page,
    as_latex,
    layout,
    paper_reference,
)

table = snakemake.params.table
with logged(snakemake):
    per_method, everything = [], []
    further = {name: [] for name in table["also"]}
    for method in table["methods"]:
        seconds: Counter[str] = Counter()
        for path in snakemake.input[f"{method}_seconds"]:
            seconds.update(json.loads(Path(path).read_text()))
        evaluations = [
            evaluation
            for index in snakemake.input[method]
            for evaluation in read_artifacts(Evaluation, index)
        ]
        labels = {key: value | {"method": method} for key, value in table["frames"].items()}
        per_method.append(evaluation_frame(evaluations, labels, dict(seconds)))
        for name, parts in further.items():
            under = under_protocol(evaluations, name)
            parts.append(evaluation_frame(under, labels, dict(seconds)))
        everything += evaluations

    def summed(frames):
        return summarise(
            frames, table["category"], table["methods"], table["masks"], table["failure_cm"]
        )

    frames = pd.concat(per_method, ignore_index=True)
    summary = summed(frames)
    frames.to_csv(snakemake.output.frames, index=False, float_format="%.3f")
    summary.to_csv(snakemake.output.csv, index=False, float_format="%.3f")
    # one table for each protocol, the main one first, in the layout of the main table
    each = [
        (table["align"], frames),
        *((name, pd.concat(parts)) for name, parts in further.items()),
    ]
    protocols = pd.concat([named_protocols(summed(part), name) for name, part in each])
    protocols.to_csv(snakemake.output.protocols, index=False, float_format="%.3f")
    contacts = summarise_contacts(everything, table["frames"], table["category"], table["masks"])
    contacts.to_csv(snakemake.output.contacts, index=False, float_format="%.3f")
    in_print = "ablation" if table["ablation"] else table["category"]
    printed = paper_reference()
    printed[printed["table"] == in_print].to_csv(snakemake.output.paper, index=False)
    make_layout = ablation_layout if table["ablation"] else layout
    laid_out = make_layout(summary, table["methods"], detail=True)
    Path(snakemake.output.html).write_text(as_html_page(laid_out, laid_out[0].title))
    Path(snakemake.output.tex).write_text("\n\n".join(as_latex(part) for part in laid_out))
