"""Collect the evaluations of several methods into one result table (Section 4.2)."""

import json
from collections import Counter
from pathlib import Path

import pandas as pd
from chunk_job import logged

from hoi.artifacts import Evaluation
from hoi.chunks import read_artifacts
from hoi.evaluate.tables import evaluation_frame, summarise
from hoi.report.tables import ablation_layout, as_html_page, as_latex, layout

table = snakemake.params.table
with logged(snakemake):
    per_method = []
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
    frames = pd.concat(per_method, ignore_index=True)
    summary = summarise(
        frames, table["category"], table["methods"], table["masks"], table["failure_cm"]
    )
    frames.to_csv(snakemake.output.frames, index=False, float_format="%.3f")
    summary.to_csv(snakemake.output.csv, index=False, float_format="%.3f")
    make_layout = ablation_layout if table["ablation"] else layout
    laid_out = make_layout(summary, table["methods"], detail=True)
    Path(snakemake.output.html).write_text(as_html_page(laid_out, laid_out[0].title))
    Path(snakemake.output.tex).write_text("\n\n".join(as_latex(part) for part in laid_out))
