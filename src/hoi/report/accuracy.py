"""The accuracy report: every method against one reference on the same frames, with intervals."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from hoi.report.labels import method_label
from hoi.report.tables import LaidOutTable

ORACLES = ("true_action", "true_body", "true_choice")


def paired_layout(paired: pd.DataFrame) -> LaidOutTable:
    """One row a method, worst first; columns of `hoi.evaluate.compare.paired`."""
    rows = paired.sort_values("difference_cm", ascending=False).to_dict("records")
    first = rows[0] if rows else {}
    reference = method_label(str(first.get("reference", "")))
    heads = ("mean", "difference", "95 % interval", "ratio", "95 % interval", "ref. better", "n")
    laid = [
        (
            method_label(str(row["method"])),
            (
                f"{row['method_mean_cm']:.1f}",
                f"{row['difference_cm']:+.1f}",
                f"{row['ci_low_cm']:+.1f} … {row['ci_high_cm']:+.1f}",
                f"{row['ratio']:.2f}",
                f"{row['ratio_ci_low']:.2f} … {row['ratio_ci_high']:.2f}",
                f"{row['share_reference_better']:.0%}",
                f"{row['n_pairs']}",
            ),
        )
        for row in rows
    ]
    caption = (
        f"Object error in cm, mean over frames, against {reference} "
        f"({first.get('reference_mean_cm', float('nan')):.1f} cm) on the same frames. Difference: "
        "method minus reference. Intervals: paired bootstrap over frames. Methods that are told a "
        "part of the truth are no results: they show which error comes from where."
    )
    title = f"{first.get('dataset', '')}: {first.get('category', '')}, paired"
    return LaidOutTable(title, caption, "Method", (("", heads),), tuple(laid))


def draw_paired(paired: pd.DataFrame, path: Path | str) -> None:
    """A picture of the differences and their intervals (png)."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = paired.sort_values("difference_cm").reset_index(drop=True)
    figure, axes = pyplot.subplots(figsize=(7.5, 1.2 + 0.34 * len(rows)), layout="constrained")
    low = rows["difference_cm"] - rows["ci_low_cm"]
    high = rows["ci_high_cm"] - rows["difference_cm"]
    told = rows["method"].isin(list(ORACLES)).to_numpy()
    for which, colour in ((told, "#7a8794"), (~told, "#c2410c")):
        axes.errorbar(
            rows["difference_cm"][which], rows.index[which], xerr=(low[which], high[which]),
            fmt="o", color=colour, capsize=3,
        )  # fmt: skip
    axes.axvline(0, color="black", linewidth=1)
    axes.set_yticks(rows.index, [method_label(name) for name in rows["method"]])
    reference = method_label(str(rows["reference"].iloc[0])) if len(rows) else ""
    axes.set_xlabel(f"object error minus that of {reference}, cm (95 % interval)")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110, metadata={"Software": None})
    pyplot.close(figure)
