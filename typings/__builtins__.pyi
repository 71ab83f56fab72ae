# What Snakemake hands to the scripts in workflow/scripts.
from typing import Any

snakemake: Any
