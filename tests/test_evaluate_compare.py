"""Paired comparisons of methods."""

import numpy as np
import pandas as pd
import pytest

from hoi.evaluate.compare import paired


def frames_of(**errors) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {
                "dataset": "toy",
                "protocol": "p",
                "method": method,
                "frame_id": str(i),
                "object_cm": e,
            }
            for method, values in errors.items()
            for i, e in enumerate(values)
        ]
    )


def test_a_constant_difference_has_no_uncertainty():
    base = np.random.default_rng(0).uniform(5, 50, 30)
    (row,) = paired(frames_of(ours=base, other=base + 3), "ours", "chair").to_dict("records")
    assert row["difference_cm"] == pytest.approx(3)
    assert (row["ci_low_cm"], row["ci_high_cm"]) == pytest.approx((3, 3))
    assert (row["n_pairs"], row["share_reference_better"]) == (30, 1.0)


def test_the_interval_is_that_of_a_normal_mean():
    rng = np.random.default_rng(1)
    ours, other = rng.uniform(5, 50, 400), rng.uniform(5, 50, 400)
    (row,) = paired(frames_of(ours=ours, other=other), "ours", "chair").to_dict("records")
    difference = other - ours
    half = 1.96 * difference.std(ddof=1) / 20
    assert row["ci_low_cm"] == pytest.approx(difference.mean() - half, abs=0.15)
    assert row["ci_high_cm"] == pytest.approx(difference.mean() + half, abs=0.15)


def test_frames_without_both_results_are_left_out():
    table = paired(
        frames_of(ours=[1.0, 2.0, np.nan, 4.0], other=[2.0, np.nan, 3.0, 6.0], third=[np.nan] * 4),
        "ours", "chair",
    )  # fmt: skip
    assert table["method"].tolist() == ["other"]
    assert table.loc[0, "n_pairs"] == 2
    assert table.loc[0, "ratio"] == pytest.approx(8 / 5)
