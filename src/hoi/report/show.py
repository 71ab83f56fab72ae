"""Print result tables in the paper's layout: ``python -m hoi.report.show results/*.csv``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from hoi.errors import HoiError
from hoi.report.tables import ablation_layout, as_text, layout, read_results


def main(paths: Sequence[str]) -> int:
    """Print the table of each csv file; the exit status."""
    if not paths:
        print(__doc__, file=sys.stderr)
        return 2
    for path in paths:
        try:
            results = read_results(path)
        except HoiError as error:
            print(error, file=sys.stderr)
            return 1
        make = ablation_layout if "ablation" in path else layout
        for table in make(results, detail=True):
            print(as_text(table))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
