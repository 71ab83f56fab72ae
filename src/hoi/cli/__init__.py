"""The ``hoi`` command: thin fronts over the workflow and the library, one module a subcommand.

Each module of `COMMANDS` has ``add_arguments(parser)`` and ``run(arguments) -> exit status``; it
is imported only when its subcommand is called, so that ``hoi --help`` answers at once.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence

from hoi.errors import HoiError

COMMANDS: dict[str, tuple[str, str]] = {
    "check-data": ("hoi.cli.check_data", "say what data is there, missing and odd, before a run"),
    "export-rhobin": ("hoi.cli.export_rhobin", "results on BEHAVE as RHOBIN's results.pkl"),
    "reconstruct": ("hoi.cli.reconstruct", "photos of people with objects -> 3D scenes"),
    "add-object": ("hoi.cli.add_object", "prepare a mesh of your own for photos that show it"),
    "detection": ("hoi.cli.detection", "how well people and objects are found on labelled photos"),
    "conceptnet": ("hoi.cli.conceptnet", "make the action space from ConceptNet's dump"),
    "rating-sheet": ("hoi.cli.rating_sheet", "an empty sheet for people who rate the priors"),
    "show": ("hoi.cli.show", "print result tables in the paper's layout"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one subcommand; the exit status. Errors of the library end as one sentence."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(
        prog="hoi", description="People and the objects they use, in 3D, from one photo."
    )
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="command")
    module = None
    for name, (path, summary) in COMMANDS.items():
        subparser = subparsers.add_parser(name, help=summary, description=summary)
        if words and words[0] == name:
            module = importlib.import_module(path)
            module.add_arguments(subparser)
    parsed = parser.parse_args(words)
    assert module is not None  # argparse has refused every name outside COMMANDS
    try:
        return module.run(parsed)
    except HoiError as error:
        print(f"hoi {parsed.command}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here", file=sys.stderr)
        return 130
