"""The tidy results in the paper's layout, as text for a terminal, HTML and LaTeX.

A tidy table has one row per action and method (columns :data:`COLUMNS`), the action ``avg`` being
the unweighted mean over actions. Laid out as in the paper (Tables 1 and 2), rows are actions and
every method has the columns H (body) and O (object) as ``mean (std)``. Every table names its data
set, masks and protocol: the same reconstruction differs up to fourfold between protocols.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from hoi.errors import ArtifactError
from hoi.report.labels import method_label

COLUMNS = (
    "dataset", "protocol", "masks", "category", "action", "method", "n", "n_failed",
    "human_mean_cm", "human_std_cm", "human_median_cm",
    "object_mean_cm", "object_std_cm", "object_median_cm",
    "object_failure_rate", "seconds_per_frame",
)  # fmt: skip
AVERAGE = "avg"
DASH = "–"
Row = Mapping[str, Any]
_UNLIMITED = 1000  # characters

ABLATION_ORDER = ("no_action", "no_contact", "no_normal", "ours")

REFERENCE_NOTE = (
    "Columns marked “in print” are the numbers of the 3DV 2022 paper, measured on the real "
    "BEHAVE; they are not comparable with those of another data set or protocol."
)
MINI_NOTE = (
    "behave_mini is a generated data set: its numbers are not comparable with any measured on "
    "BEHAVE."
)


@dataclass(frozen=True)
class LaidOutTable:
    """A table ready for any renderer; every cell is plain text.

    Attributes:
        title: data set and category.
        caption: protocol, masks, units and how to read it.
        corner: header of the first column.
        groups: label and column heads of each group of columns, left to right.
        rows: label and cells, as many as all groups have columns.
        rule_before: index of the row (the average) that a line sets off, if any.
        notes: lines below the table.
        links: one address a cell, in the shape of `rows`; empty for none.
    """

    title: str
    caption: str
    corner: str
    groups: tuple[tuple[str, tuple[str, ...]], ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]
    rule_before: int | None = None
    notes: tuple[str, ...] = ()
    links: tuple[tuple[str, ...], ...] = ()


def read_results(path: Path | str) -> pd.DataFrame:
    """Read a tidy result table. Raises ArtifactError naming the file and what it lacks."""
    try:
        results = pd.read_csv(path, keep_default_na=True)
    except (OSError, ValueError) as error:
        raise ArtifactError(f"{path}: not a readable result table: {error}") from error
    _check(results, str(path))
    return results


def paper_reference() -> pd.DataFrame:
    """The paper's printed numbers: table (chair, table, keyboard, backpack, ablation), action,
    method, means and standard deviations in cm, and a note where they contradict one another."""
    table = pd.read_csv(Path(__file__).with_name("paper_tables.csv"))
    table["note"] = table["note"].fillna("")
    return table


def layout(
    results: pd.DataFrame,
    methods: Sequence[str] | None = None,
    *,
    detail: bool = False,
    reference: bool = False,
) -> tuple[LaidOutTable, ...]:
    """The paper's Table 1: one table per data set, masks, category and protocol.

    Args:
        results: tidy table.
        methods: columns in this order; all, in order of appearance, when None.
        detail: also the object's median and the share of frames counted as failures.
        reference: beside them the paper's printed numbers, labelled as such.

    Raises ArtifactError when a column is missing or an (action, method) pair appears twice.
    """
    _check(results, "results")
    return tuple(
        _by_action(part, protocol, methods, detail, reference) for part, protocol in _parts(results)
    )


def ablation_layout(
    results: pd.DataFrame,
    methods: Sequence[str] | None = None,
    *,
    detail: bool = False,
    reference: bool = False,
) -> tuple[LaidOutTable, ...]:
    """The paper's Table 2: one row per method, averaged over actions; arguments as `layout`."""
    _check(results, "results")
    return tuple(
        _by_method(part, protocol, methods, detail, reference) for part, protocol in _parts(results)
    )


def linked(table: LaidOutTable, gallery: str, methods: Iterable[str]) -> LaidOutTable:
    """The table with every number linked to its frames, worst first, in the page `gallery`."""
    names = {method_label(name): name for name in methods}
    names |= {f"{label} (full)": name for label, name in names.items()}  # of the ablation

    def address(row: str, group: str) -> str:
        method = names.get(group) or names.get(row)
        if method is None:
            return ""  # a number in print has no frames here
        of_action = "" if row in names or row.lower().startswith("av") else f"&action={row.lower()}"
        return f"{gallery}#order=worst:{method}{of_action}"

    links = tuple(
        tuple(address(row, label) for label, heads in table.groups for _ in heads)
        for row, _ in table.rows
    )
    return replace(table, links=links)


def as_text(table: LaidOutTable, width: int = 100) -> str:
    """The table for a terminal, without colours; its notes are wrapped to `width` characters.

    Numbers are never cut: a table that needs more than `width` characters takes them.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    drawn = Table(box=box.SIMPLE_HEAD, title=table.title, title_justify="left", pad_edge=False)
    drawn.add_column(table.corner, no_wrap=True)
    for label, heads in table.groups:
        for position, head in enumerate(heads):
            top = label if position == 0 else ""
            drawn.add_column(f"{top}\n{head}".strip("\n"), justify="right", no_wrap=True)
    for index, (label, cells) in enumerate(table.rows):
        if index == table.rule_before:
            drawn.add_section()
        drawn.add_row(label, *cells)
    stream = io.StringIO()
    plain: dict[str, Any] = {"color_system": None, "highlight": False, "markup": False}
    Console(file=stream, width=_UNLIMITED, **plain).print(drawn)
    notes = Console(file=stream, width=width, **plain)
    for line in (table.caption, *table.notes):
        notes.print(line)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()).strip("\n") + "\n"


def as_html(table: LaidOutTable) -> str:
    """The table as an HTML fragment (``<figure>``); everything is escaped."""
    from hoi.report.html import render

    return render("table.html.j2", table=table)


def as_html_page(tables: Iterable[LaidOutTable], heading: str) -> str:
    """The tables as one self-contained HTML page."""
    from hoi.report.html import render, source

    return render("tables.html.j2", tables=list(tables), heading=heading, style=source("style.css"))


def as_latex(table: LaidOutTable, label: str = "") -> str:
    """The table as a LaTeX float that needs no package."""
    spec = "l" + "".join("r" * len(heads) for _, heads in table.groups)
    top = [""] + [
        rf"\multicolumn{{{len(heads)}}}{{c}}{{{_latex(name)}}}" for name, heads in table.groups
    ]
    heads = [_latex(table.corner)] + [_latex_head(h) for _, group in table.groups for h in group]
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\begin{{tabular}}{{{spec}}}",
        r"\hline",
        " & ".join(top) + r" \\",
        " & ".join(heads) + r" \\",
        r"\hline",
    ]
    for index, (name, cells) in enumerate(table.rows):
        if index == table.rule_before:
            lines.append(r"\hline")
        lines.append(" & ".join([_latex(name), *map(_latex, cells)]) + r" \\")
    caption = " ".join((table.caption, *table.notes))
    lines += [
        r"\hline",
        r"\end{tabular}",
        rf"\caption{{\textbf{{{_latex(table.title)}.}} {_latex(caption)}}}",
    ]
    if label:
        lines.append(rf"\label{{{label}}}")
    return "\n".join([*lines, r"\end{table}"]) + "\n"


def spread(mean: float, std: float) -> str:
    """``mean (std)`` with one decimal as the paper prints it; a dash without a mean."""
    if not math.isfinite(mean):
        return DASH
    return f"{mean:.1f} ({std:.1f})" if math.isfinite(std) else f"{mean:.1f}"


def _check(results: pd.DataFrame, name: str) -> None:
    missing = [column for column in COLUMNS if column not in results.columns]
    if missing:
        raise ArtifactError(f"{name}: not a result table, it lacks {', '.join(missing)}")
    key = ["dataset", "protocol", "masks", "category", "action", "method"]
    twice = results[results.duplicated(key)]
    if len(twice):
        row = twice.iloc[0]
        raise ArtifactError(f"{name}: action {row['action']}, method {row['method']} appears twice")


def _records(rows: Any) -> list[dict[str, Any]]:
    return [{str(key): value for key, value in row.items()} for row in rows.to_dict("records")]


def _parts(results: pd.DataFrame) -> list[tuple[pd.DataFrame, str]]:
    """The rows of each table. Rows without a protocol (no frame came through) join each."""
    filled = results.fillna({"protocol": ""})
    parts = []
    for _, rows in filled.groupby(["dataset", "masks", "category"], sort=False, dropna=False):
        protocols = [name for name in rows["protocol"].unique() if name] or [""]
        parts += [(rows[rows["protocol"].isin([name, ""])], name) for name in protocols]
    return parts


def _by_action(
    rows: pd.DataFrame,
    protocol: str,
    methods: Sequence[str] | None,
    detail: bool,
    reference: bool,
) -> LaidOutTable:
    chosen = list(rows["method"].unique()) if methods is None else list(methods)
    found: dict[tuple[str, str], Row] = {
        (row["action"], row["method"]): row for row in _records(rows)
    }
    actions = list(dict.fromkeys(a for a in rows["action"] if a != AVERAGE))
    if AVERAGE in set(rows["action"]):
        actions.append(AVERAGE)
    heads = _heads(detail)
    groups = [(method_label(name), heads) for name in chosen]
    printed = _printed(rows["category"].iloc[0]) if reference else {}
    in_print = [name for name in ("phosa", "ours") if any(m == name for _, m in printed)]
    groups.append(("", ("n",)))
    groups += [(f"{method_label(name)}, in print", ("H", "O")) for name in in_print]
    laid = [
        (
            "Avg." if action == AVERAGE else str(action).capitalize(),
            (
                *(c for name in chosen for c in _cells(found.get((action, name)), detail)),
                _counts([found.get((action, name)) for name in chosen]),
                *(c for name in in_print for c in _cells(printed.get((action, name)), False)),
            ),
        )
        for action in actions
    ]
    average = len(laid) - 1 if actions and actions[-1] == AVERAGE else None
    table = _frame_of(rows, protocol, "Action", groups, laid, detail)
    extra = [_seconds(found, chosen)] if average is not None else []
    return _with_reference(replace(table, rule_before=average), extra, printed, in_print)


def _by_method(
    rows: pd.DataFrame,
    protocol: str,
    methods: Sequence[str] | None,
    detail: bool,
    reference: bool,
) -> LaidOutTable:
    averages = {row["method"]: row for row in _records(rows) if row["action"] == AVERAGE}
    if methods is None:
        known = [name for name in ABLATION_ORDER if name in averages]
        methods = [*(name for name in averages if name not in known), *known]
    printed = _printed("ablation") if reference else {}
    groups = [("", _heads(detail)), ("", ("n",))]
    if printed:
        groups.append(("in print", ("H", "O")))
    laid = [
        (
            "Ours (full)" if name == "ours" else method_label(name),
            (
                *_cells(averages.get(name), detail),
                _counts([averages.get(name)]),
                *(_cells(printed.get((AVERAGE, name)), False) if printed else ()),
            ),
        )
        for name in methods
    ]
    table = _frame_of(rows, protocol, "Method", groups, laid, detail)
    table = replace(table, title=f"{table.title}, ablation")
    return _with_reference(table, [], printed, ["ours"])


def _frame_of(rows, protocol, corner, groups, laid, detail) -> LaidOutTable:
    dataset, masks, category = (str(rows[key].iloc[0]) for key in ("dataset", "masks", "category"))
    caption = (
        f"Data set {dataset}, masks {masks}, protocol {protocol or 'unknown'}. Chamfer distance in "
        "cm, mean (std); H body, O object; Avg. is the unweighted mean over actions. "
        "n: frames with a result + frames that failed a stage (not in the means)."
    )
    if detail:
        caption += " med.: median of O. fail: share of frames whose O is beyond the failure limit."
    notes = (MINI_NOTE,) if "behave_mini" in dataset else ()
    return LaidOutTable(
        f"{dataset}: {category}", caption, corner, tuple(groups), tuple(laid), None, notes
    )


def _with_reference(table: LaidOutTable, extra, printed, in_print) -> LaidOutTable:
    notes = [*table.notes, *(line for line in extra if line)]
    if printed:
        notes.append(REFERENCE_NOTE)
        for (action, method), row in printed.items():
            if row["note"] and (method in in_print or not in_print):
                where = f"{method_label(method)}, {'Avg.' if action == AVERAGE else action}"
                notes.append(f"In print, {where}: {row['note']}.")
    return replace(table, notes=tuple(notes))


def _printed(category: str) -> dict[tuple[str, str], Row]:
    table = paper_reference()
    rows = _records(table[table["table"] == category])
    return {(row["action"], row["method"]): row for row in rows}


def _heads(detail: bool) -> tuple[str, ...]:
    return ("H", "O", "med.", "fail") if detail else ("H", "O")


def _cells(row: Row | None, detail: bool) -> tuple[str, ...]:
    if row is None:
        return (DASH,) * len(_heads(detail))
    cells = (
        spread(row["human_mean_cm"], row["human_std_cm"]),
        spread(row["object_mean_cm"], row["object_std_cm"]),
    )
    if not detail:
        return cells
    rate = row["object_failure_rate"]
    share = f"{100 * rate:.0f} %" if math.isfinite(rate) else DASH
    return (*cells, spread(row["object_median_cm"], math.nan), share)


def _counts(rows: list[Row | None]) -> str:
    """``12`` or ``12+1`` (one frame failed); one per method where they differ."""

    def count(row: Row | None) -> str:
        if row is None:
            return DASH
        failed = int(row["n_failed"])
        return f"{int(row['n'])}+{failed}" if failed else f"{int(row['n'])}"

    each = [count(row) for row in rows]
    return each[0] if len(set(each)) == 1 else " / ".join(each)


def _seconds(found: dict[tuple[str, str], Row], methods: list[str]) -> str:
    told = [
        f"{method_label(name)} {found[AVERAGE, name]['seconds_per_frame']:.1f}"
        for name in methods
        if (AVERAGE, name) in found and math.isfinite(found[AVERAGE, name]["seconds_per_frame"])
    ]
    return f"Seconds a frame: {', '.join(told)}." if told else ""


_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "–": "--", "“": "``", "”": "''",
}  # fmt: skip


def _latex(text: str) -> str:
    """Plain text for LaTeX; ``L_contact`` becomes the loss's symbol."""
    pieces = re.split(r"\bL_([a-z]+)\b", text)
    return "".join(
        rf"$\mathcal{{L}}_{{{piece}}}$"
        if odd % 2
        else "".join(_LATEX.get(letter, letter) for letter in piece)
        for odd, piece in enumerate(pieces)
    )


def _latex_head(head: str) -> str:
    return rf"$\mathcal{{{head}}}$ $\downarrow$" if head in {"H", "O"} else _latex(head)
