"""Methods compared frame by frame: differences on the same frames and how sure they are."""

from __future__ import annotations

import numpy as np
import pandas as pd

PAIRED_COLUMNS = (
    "dataset", "protocol", "category", "method", "reference", "n_pairs", "method_mean_cm",
    "reference_mean_cm", "difference_cm", "ci_low_cm", "ci_high_cm", "share_reference_better",
    "ratio", "ratio_ci_low", "ratio_ci_high",
)  # fmt: skip


def paired(
    frames: pd.DataFrame, reference: str, category: str, seed: int = 0, resamples: int = 10_000
) -> pd.DataFrame:
    """Every method against the reference on the frames where both have a result.

    The object's error counts. ``difference_cm`` is method minus reference, ``ratio`` the quotient
    of their means. Intervals are 95 % percentile bootstrap intervals over frames; actions are drawn
    in proportion, so the means here are over frames and not, as in the tables, over actions.

    Args:
        frames: rows of `hoi.evaluate.tables.evaluation_frame` for several methods.
        reference: the method that all others are compared with.
    """
    errors = frames.pivot_table(index="frame_id", columns="method", values="object_cm")
    rows = []
    for method in [name for name in frames["method"].unique() if name != reference]:
        both = errors[[method, reference]].dropna() if method in errors else errors.iloc[:0]
        if len(both) < 2:
            continue
        theirs, ours = np.asarray(both[method]), np.asarray(both[reference])
        drawn = np.random.default_rng(seed).integers(0, len(both), (resamples, len(both)))
        differences = (theirs - ours)[drawn].mean(1)
        ratios = theirs[drawn].mean(1) / ours[drawn].mean(1)
        rows.append(
            {
                "dataset": frames["dataset"].iloc[0],
                "protocol": frames["protocol"].dropna().iloc[0],
                "category": category,
                "method": method,
                "reference": reference,
                "n_pairs": len(both),
                "method_mean_cm": theirs.mean(),
                "reference_mean_cm": ours.mean(),
                "difference_cm": (theirs - ours).mean(),
                "ci_low_cm": np.percentile(differences, 2.5),
                "ci_high_cm": np.percentile(differences, 97.5),
                "share_reference_better": float((ours < theirs).mean()),
                "ratio": theirs.mean() / ours.mean(),
                "ratio_ci_low": np.percentile(ratios, 2.5),
                "ratio_ci_high": np.percentile(ratios, 97.5),
            }
        )
    return pd.DataFrame(rows, columns=list(PAIRED_COLUMNS))
