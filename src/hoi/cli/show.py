"""``hoi show``: print result tables."""

from __future__ import annotations

import argparse

from hoi.report.show import main as show


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The csv files to print."""
    parser.add_argument("tables", nargs="+", help="csv files of results/")


def run(arguments: argparse.Namespace) -> int:
    """Print each table; 1 where one cannot be read."""
    return show(arguments.tables)
