"""Collect how well each way to cut out the object agrees with the labelled masks."""

from pathlib import Path

import pandas as pd
from chunk_job import logged

from hoi.detect.mask_methods import mask_table
from hoi.report.detection import masks_layout
from hoi.report.tables import as_html_page

dataset, split = snakemake.params.dataset, snakemake.params.split
with logged(snakemake):
    rows = pd.concat([pd.read_csv(path) for path in snakemake.input], ignore_index=True)
    table = mask_table(rows)
    laid_out = masks_layout(table, f"{dataset} ({split})")
    Path(snakemake.output.html).write_text(as_html_page([laid_out], laid_out.title))
    table.insert(0, "dataset", dataset)
    table.insert(1, "split", split)
    table.to_csv(snakemake.output.csv, index=False, float_format="%.3f")
