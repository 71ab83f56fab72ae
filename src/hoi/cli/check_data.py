"""``hoi check-data``: what the configuration points at, in sentences, before a run."""

from __future__ import annotations

import argparse
from pathlib import Path

CONFIG = "config/config.yaml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The configuration, and where to write the list of frames."""
    parser.add_argument(
        "--config",
        nargs="+",
        type=Path,
        default=[Path(CONFIG)],
        metavar="FILE",
        help=f"configuration files, later ones go before earlier ones (default: {CONFIG})",
    )
    parser.add_argument("--behave", metavar="FOLDER", help="in place of behave.root")
    parser.add_argument(
        "--frames",
        type=Path,
        metavar="CSV",
        help="write every frame of the tables, and its oddities",
    )
    parser.add_argument(
        "--body-parts", type=Path, metavar="PNG", help="draw the body model's named regions"
    )
    parser.add_argument("-j", "--jobs", type=int, default=2, metavar="N", help="parallel jobs")


def run(arguments: argparse.Namespace) -> int:
    """Print the findings; 0 when a run can start, else 1."""
    from hoi.checks.behave import oddities_csv
    from hoi.checks.findings import as_text, can_start
    from hoi.checks.report import check_data
    from hoi.config import load_configs

    overrides = {"behave": {"root": arguments.behave}} if arguments.behave else {}
    config = load_configs(arguments.config, overrides)
    report = check_data(config, jobs=max(1, arguments.jobs))
    print(as_text(report.findings))
    if arguments.frames:
        arguments.frames.write_text(oddities_csv(report.frames), encoding="utf-8")
        print(f"\nFrames: {arguments.frames}")
    if arguments.body_parts:
        from hoi.checks.parts_picture import write_parts_picture

        write_parts_picture(Path(config.assets.body_model), arguments.body_parts)
        print(f"\nBody regions: {arguments.body_parts}")
    ready = can_start(report.findings)
    print("\nA run can start." if ready else "\nA run cannot start: see STOP above.")
    return 0 if ready else 1
