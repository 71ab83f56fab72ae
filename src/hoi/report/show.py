"""Print result tables: ``python -m hoi.report.show results/*.csv``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from hoi.errors import ArtifactError, HoiError
from hoi.report.actions import actions_layout, is_actions_table
from hoi.report.detection import (
    detection_layout,
    is_detection_table,
    is_masks_table,
    masks_layout,
)
from hoi.report.photos import is_photos_table, photos_layout
from hoi.report.tables import LaidOutTable, ablation_layout, as_text, layout, read_results


def main(paths: Sequence[str]) -> int:
    """Print the table of each csv file; the exit status."""
    if not paths:
        print(__doc__, file=sys.stderr)
        return 2
    for path in paths:
        try:
            tables = tables_of(path)
        except HoiError as error:
            print(error, file=sys.stderr)
            return 1
        for table in tables:
            print(as_text(table))
    return 0


def tables_of(path: str) -> tuple[LaidOutTable, ...]:
    """The laid-out tables of one csv file of any kind. Raises ArtifactError for other files."""
    try:
        raw = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise ArtifactError(f"{path}: not a readable table: {error}") from error
    if is_detection_table(raw):
        return (detection_layout(raw),)
    if is_actions_table(raw):
        return (actions_layout(raw),)
    if is_photos_table(raw):
        return (photos_layout(raw),)
    if is_masks_table(raw):
        title = Path(path).resolve().parent.name
        if {"dataset", "split"} <= set(raw.columns):  # the workflow's, not that of `hoi detection`
            title = f"{raw['dataset'][0]} ({raw['split'][0]})"
        return (masks_layout(raw, title),)
    make = ablation_layout if "ablation" in path else layout
    return make(read_results(path), detail=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
