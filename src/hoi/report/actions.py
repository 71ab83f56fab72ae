"""The page on action recognition: accuracies, confusions, and the nearest poses in pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from hoi.report.config import ReportConfig
from hoi.report.html import image_url, render, source
from hoi.report.poses import OTHER, SKIN, TILE, draw_body
from hoi.report.tables import DASH, LaidOutTable

SHARES = ("without_the_pose", "without_its_base_pose", "stated_probability", "as_the_paper",
          "always_default")  # fmt: skip
COLUMNS = ("category", "poses", "actions", "default_action", *SHARES)
_LABEL = 26
CONFUSION = "Confusion: "


class Tile(NamedTuple):
    """One posed body with its caption: vertices (V, 3), y up, front +z."""

    vertices: np.ndarray
    action: str
    caption: str


class PoseRow(NamedTuple):
    """A left-out pose, then the poses found for it, the nearest first."""

    tiles: tuple[Tile, ...]


def is_actions_table(table: pd.DataFrame) -> bool:
    """Whether the columns are those of ``results/actions.csv``."""
    return set(COLUMNS) <= set(table.columns)


def actions_layout(table: pd.DataFrame) -> LaidOutTable:
    """Leave-one-out accuracies for people, an average over categories last."""
    rows = [
        (str(row["category"]), _cells({str(key): value for key, value in row.items()}))
        for row in table.to_dict("records")
    ]
    mean = {"poses": table["poses"].sum(), "actions": table["actions"].sum(), "default_action": ""}
    mean |= {name: table[name].mean() for name in SHARES}
    return LaidOutTable(
        "Recognising actions: every pose of the database looked up among the others",
        "Share of poses whose nearest other pose shows the same action, in %. Left out is the pose "
        "itself, or its kind: all variants of the same description, which is harder and nearer to "
        "a new photo (over actions with another description). Stated: the mean probability that "
        "retrieval gives its answers then, which is their accuracy if it is right. As the paper: "
        "its kind, and poses compared by the rotation vectors of the joints alone. Always default: "
        "what answering the heaviest ConceptNet action gets right.",
        "Object",
        (("", ("poses", "actions")), ("left out", ("itself", "its kind", "stated", "as the paper")),
         ("default", ("action", "always"))),
        (*rows, ("average", _cells(mean))),
        len(rows),
    )  # fmt: skip


def confusion_layouts(confusion: pd.DataFrame) -> list[LaidOutTable]:
    """One table per category: rows are true actions, columns retrieved ones."""
    layouts = []
    for category, part in confusion.groupby("category", sort=False):
        counts = part.pivot(index="action", columns="retrieved", values="count")
        names = sorted({*counts.index, *counts.columns})
        counts = counts.reindex(index=names, columns=names)
        rows = tuple(
            (name, tuple(DASH if pd.isna(v) else f"{int(v)}" for v in counts.loc[name]))
            for name in names
        )
        layouts.append(
            LaidOutTable(
                f"{CONFUSION}{category}",
                "Rows: what the person does. Columns: what was retrieved. Poses of the same "
                "description were left out.",
                "action",
                (("retrieved", tuple(names)),),
                rows,
            )
        )
    return layouts


def pose_sheet(rows: Sequence[PoseRow], faces: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 picture: a row an action, the left-out pose first; wrong answers in red."""
    from PIL import Image, ImageDraw

    width, height = TILE
    columns = max(len(row.tiles) for row in rows)
    gap = 14  # between the question and its answers
    sheet = Image.new("RGB", (columns * width + gap, len(rows) * (height + _LABEL)), "white")
    draw = ImageDraw.Draw(sheet)
    for line, row in enumerate(rows):
        top = line * (height + _LABEL)
        truth = row.tiles[0].action
        for column, tile in enumerate(row.tiles):
            left = column * width + (gap if column else 0)
            base = SKIN if column < 2 else OTHER
            sheet.paste(Image.fromarray(draw_body(tile.vertices, faces, base)), (left, top))
            wrong = column == 1 and tile.action != truth
            ink = (190, 30, 30) if wrong else (30, 30, 30) if column < 2 else (120, 120, 120)
            draw.text((left + 4, top + height), tile.action, fill=ink)
            draw.text((left + 4, top + height + 12), tile.caption, fill=(120, 120, 120))
            if wrong:
                draw.rectangle((left, top, left + width - 2, top + height - 1), outline=ink)
    return np.asarray(sheet)


def actions_page(
    table: pd.DataFrame,
    confusion: pd.DataFrame,
    sheets: Mapping[str, np.ndarray],
    queries: Mapping[str, Sequence[str]],
    config: ReportConfig,
) -> str:
    """The HTML page.

    Args:
        table, confusion: what ``results/actions.csv`` and ``actions.confusion.csv`` hold.
        sheets: category -> picture of :func:`pose_sheet`.
        queries: category -> search phrases of its action space.
    """
    pictures = {
        name: {"url": image_url(sheet, config), "width": sheet.shape[1], "height": sheet.shape[0]}
        for name, sheet in sheets.items()
    }
    layouts = confusion_layouts(confusion)
    return render(
        "actions.html.j2",
        heading="Actions",
        style=source("style.css"),
        accuracy=actions_layout(table),
        confusions={str(layout.title).removeprefix(CONFUSION): layout for layout in layouts},
        pictures=pictures,
        queries=queries,
    )


def _cells(row: Mapping[str, object]) -> tuple[str, ...]:
    *found, always = (
        DASH if pd.isna(row[name]) else f"{100 * float(str(row[name])):.1f}"  # type: ignore[arg-type]
        for name in SHARES
    )
    named = row["default_action"]
    default = str(named) if isinstance(named, str) else ""
    return str(row["poses"]), str(row["actions"]), *found, default or DASH, always
