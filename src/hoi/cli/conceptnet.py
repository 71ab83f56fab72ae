"""``hoi conceptnet``: the action space from ConceptNet's own dump."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The dump and where to write the table."""
    parser.add_argument("dump", type=Path, help="conceptnet-assertions-5.7.0.csv.gz")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("resources/conceptnet/actions.tsv"),
        help="the table, for assets.action_space (default: %(default)s)",
    )
    parser.add_argument(
        "--noun",
        action="append",
        default=[],
        metavar="NOUN=CATEGORY",
        help="a further noun to look for, e.g. armchair=chair",
    )
    parser.add_argument("--min-weight", type=float, default=1.0, help="lighter edges are left out")


def run(arguments: argparse.Namespace) -> int:
    """Read the dump once and write the table."""
    from hoi.actions.conceptnet import write_action_space
    from hoi.errors import ConfigError

    nouns = {}
    for given in arguments.noun:
        noun, equals, category = given.partition("=")
        if not (noun and equals and category):
            raise ConfigError(f"--noun {given!r}: expected noun=category, e.g. armchair=chair")
        nouns[noun] = category
    rows, count = write_action_space(
        arguments.dump, arguments.out, nouns=nouns, min_weight=arguments.min_weight
    )
    print(
        f"{arguments.out}: {rows} edges out of {count.lines:,} lines "
        f"({count.lines_per_second:,.0f} a second, {count.damaged} damaged)\n"
        f"Look through it, then set assets.action_space: {arguments.out}\n"
        "(data of ConceptNet 5, CC BY-SA 4.0)"
    )
    return 0
