"""Put trained and shipped weights into one table."""

import pandas as pd
from chunk_job import logged

with logged(snakemake):
    tables = [pd.read_csv(file) for file in snakemake.input]
    pd.concat(tables).to_csv(snakemake.output[0], index=False)
