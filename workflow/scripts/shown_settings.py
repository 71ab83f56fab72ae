"""Write down what pages say of their configuration, and what the plan knows of the frames."""

import json
from pathlib import Path

told = {"settings": snakemake.params.settings, "frames": snakemake.params.frames}
Path(snakemake.output[0]).write_text(json.dumps(told, indent=1) + "\n")
