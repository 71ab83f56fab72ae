"""``hoi rating-sheet``: an empty sheet on which people rate the recorded sizes and contacts."""

from __future__ import annotations

import argparse
from pathlib import Path

from hoi.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The file to write, and the tables to rate."""
    parser.add_argument("sheet", type=Path, help="csv file to write; copy it for every rater")
    parser.add_argument(
        "--tables",
        type=Path,
        help="folder with sizes.csv and contacts.csv; default: the recorded ones of the package",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the sheet; refuses to overwrite one, it may be half filled."""
    from hoi.priors.study import RATING_COLUMNS, rating_sheet, write_rows
    from hoi.priors.tables import load_tables

    if arguments.sheet.exists():
        raise ConfigError(f"{arguments.sheet} exists; name a new file, or delete it")
    rows = rating_sheet(load_tables(arguments.tables))
    write_rows(arguments.sheet, RATING_COLUMNS, rows)
    print(
        f"{arguments.sheet}: {len(rows)} labels. Fill in `rater` and `correct` (yes or no), one "
        "copy a person, put the rows of all into one file, and name it under prior_study.ratings."
    )
    return 0
