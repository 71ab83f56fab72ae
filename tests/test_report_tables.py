"""Tables: the paper's layout, to the letter, from the tidy rows."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from hoi.errors import ArtifactError
from hoi.evaluate.compare import paired
from hoi.report.accuracy import draw_paired, paired_layout
from hoi.report.tables import (
    COLUMNS,
    ablation_layout,
    as_html,
    as_html_page,
    as_latex,
    as_text,
    layout,
    paper_reference,
    read_results,
    spread,
)
from test_report_page import EXTERNAL, Reader


def row(action, method, thing, n=4, n_failed=0, **changes):
    values = dict(
        dataset="behave_mini", protocol="smpl", masks="given", category="chair", action=action,
        method=method, n=n, n_failed=n_failed, human_mean_cm=7.25, human_std_cm=2.0,
        human_median_cm=7.0, object_mean_cm=thing, object_std_cm=thing / 2,
        object_median_cm=thing - 1, object_failure_rate=0.25, seconds_per_frame=3.04,
    )  # fmt: skip
    return values | changes


@pytest.fixture
def results() -> pd.DataFrame:
    return pd.DataFrame(
        [
            row("hand", "phosa", 80.0), row("sit", "phosa", 30.0, n=3, n_failed=1),
            row("avg", "phosa", 55.0, n=7, n_failed=1),
            row("hand", "ours", 30.0), row("sit", "ours", 20.0), row("avg", "ours", 25.0, n=8),
        ],
        columns=list(COLUMNS),
    )  # fmt: skip


def test_the_terminal_shows_the_papers_layout(results):
    (table,) = layout(results)
    lines = as_text(table).splitlines()
    assert lines[0].strip() == "behave_mini: chair"
    assert lines[2].split() == ["PHOSA", "Ours"]
    assert lines[3].split() == ["Action", "H", "O", "H", "O", "n"]
    body = [line.split() for line in lines[5:9] if line.strip()]
    assert [" ".join(cells) for cells in body] == [
        "Hand 7.2 (2.0) 80.0 (40.0) 7.2 (2.0) 30.0 (15.0) 4",
        "Sit 7.2 (2.0) 30.0 (15.0) 7.2 (2.0) 20.0 (10.0) 3+1 / 4",
        "Avg. 7.2 (2.0) 55.0 (27.5) 7.2 (2.0) 25.0 (12.5) 7+1 / 8",
    ]


def test_every_rendering_names_data_set_masks_protocol_and_units(results):
    (table,) = layout(results)
    for text in (as_text(table, 400), as_html(table), as_latex(table).replace("\\_", "_")):
        assert "Data set behave_mini, masks given, protocol smpl. Chamfer distance in cm" in text
        assert "not comparable with any measured on BEHAVE" in text


def test_numbers_are_never_cut_to_fit_the_terminal(results):
    (table,) = layout(results, detail=True, reference=True)
    text = as_text(table, width=40)
    assert "80.0 (40.0)" in text and "83.3 (167.7)" in text and "…" not in text


def test_latex_is_the_papers_table(results):
    (table,) = layout(results)
    lines = as_latex(table, label="tab:chair").splitlines()
    assert lines[2] == r"\begin{tabular}{lrrrrr}"
    assert lines[4] == (
        r" & \multicolumn{2}{c}{PHOSA} & \multicolumn{2}{c}{Ours} & \multicolumn{1}{c}{} \\"
    )
    assert lines[5].startswith(r"Action & $\mathcal{H}$ $\downarrow$ & $\mathcal{O}$ $\downarrow$")
    assert lines[7] == r"Hand & 7.2 (2.0) & 80.0 (40.0) & 7.2 (2.0) & 30.0 (15.0) & 4 \\"
    assert lines[9] == r"\hline"  # sets the average off
    assert lines[10].startswith("Avg. & 7.2 (2.0) & 55.0 (27.5)")
    assert r"\label{tab:chair}" in lines
    columns = [line.count("&") for line in lines if line.endswith(r"\\")]
    assert columns == [3, 5, 5, 5, 5]


def test_html_is_well_formed_self_contained_and_holds_the_same_cells(results):
    (table,) = layout(results)
    page = as_html_page([table], "Results")
    reader = Reader(page)
    assert not reader.open and not EXTERNAL.findall(page)
    assert "Hand 7.2 (2.0) 80.0 (40.0) 7.2 (2.0) 30.0 (15.0) 4" in reader.text
    spans = [int(a["colspan"]) for tag, a in reader.tags if tag == "th" and "colspan" in a]
    assert spans == [2, 2]


def test_detail_adds_median_and_failures(results):
    (table,) = layout(results, ["ours"], detail=True)
    assert table.groups[0] == ("Ours", ("H", "O", "med.", "fail"))
    assert table.rows[0] == ("Hand", ("7.2 (2.0)", "30.0 (15.0)", "29.0", "25 %", "4"))


def test_methods_are_taken_in_the_order_asked_and_an_absent_one_is_a_dash(results):
    (table,) = layout(results, ["ours", "paper"])
    assert [label for label, _ in table.groups] == ["Ours", "As printed", ""]
    assert table.rows[0][1] == ("7.2 (2.0)", "30.0 (15.0)", "–", "–", "4 / –")


def test_an_action_without_a_result_is_a_dash_with_its_failures_counted(results):
    results.loc[results["action"] == "hand", ["n", "n_failed", "protocol"]] = [0, 4, ""]
    numbers = [column for column in COLUMNS if column.endswith(("_cm", "_rate"))]
    results.loc[results["action"] == "hand", numbers] = np.nan
    (table,) = layout(results, detail=True)
    assert table.rows[0][1] == ("–",) * 8 + ("0+4",)


def test_each_protocol_gets_its_own_table(results):
    other = results.assign(protocol="joint", object_mean_cm=1.0)
    first, second = layout(pd.concat([results, other]))
    assert "protocol smpl" in first.caption and "protocol joint" in second.caption
    assert first.rows[0][1][1] == "80.0 (40.0)" and second.rows[0][1][1] == "1.0 (40.0)"


def test_the_ablation_has_a_row_a_method_in_the_papers_order(results):
    found = {"ours": 28.1, "no_normal": 30.7, "no_contact": 103.2, "no_action": 58.4}
    rows = [row("avg", name, value) for name, value in found.items()]
    (table,) = ablation_layout(pd.DataFrame(rows))
    assert [label for label, _ in table.rows] == [
        "No action", "No L_contact", "No L_normal", "Ours (full)",
    ]  # fmt: skip
    assert table.rows[1][1] == ("7.2 (2.0)", "103.2 (51.6)", "4")
    assert r"No $\mathcal{L}_{contact}$ & 7.2 (2.0)" in as_latex(table)
    assert "No <i>L</i><sub>contact</sub>" in as_html(table)


def test_the_papers_numbers_stand_apart_and_say_what_they_are(results):
    (table,) = layout(results, reference=True)
    labels = [label for label, _ in table.groups]
    assert labels == ["PHOSA", "Ours", "", "PHOSA, in print", "Ours, in print"]
    assert table.rows[0][1][-4:] == ("7.4 (2.5)", "83.3 (167.7)", "8.1 (2.6)", "34.3 (17.6)")
    assert any("measured on the real BEHAVE" in note for note in table.notes)


def test_what_is_wrong_in_the_papers_tables_is_said_beside_them(results):
    (table,) = layout(results.assign(category="table"), reference=True)
    notes = " ".join(table.notes)
    assert "probably a copy" in notes and "247.6" in notes


def test_the_transcribed_averages_agree_with_their_rows_unless_noted():
    reference = paper_reference()
    main = reference[reference["table"] != "ablation"]
    values = [c for c in main.columns if c.endswith("_cm")]
    for _, rows in main.groupby(["table", "method"]):
        average = rows[rows["action"] == "avg"].iloc[0]
        computed = rows[rows["action"] != "avg"][values].mean()
        agrees = np.allclose(computed, average[values].astype(float), atol=0.0651)
        assert agrees or average["note"], (average["table"], average["method"])
    assert len(reference) == 14 + 4 + 12 + 6 + 8


def test_cells_from_a_file_cannot_become_markup(results):
    evil = results.assign(category="<img src=x onerror=1> & 50% of_it")
    (table,) = layout(evil)
    assert "<img" not in as_html(table)
    assert r"\& 50\% of\_it" in as_latex(table)


def test_a_table_that_is_none_is_refused_by_name(tmp_path, results):
    path = tmp_path / "results.csv"
    results.drop(columns=["protocol", "n"]).to_csv(path, index=False)
    with pytest.raises(ArtifactError, match=r"results\.csv.*lacks protocol, n"):
        read_results(path)
    with pytest.raises(ArtifactError, match=r"absent\.csv"):
        read_results(tmp_path / "absent.csv")


def test_an_action_that_appears_twice_is_refused(results):
    with pytest.raises(ArtifactError, match="action hand, method phosa appears twice"):
        layout(pd.concat([results, results.head(1)]))


def test_a_table_survives_its_file(tmp_path, results):
    results.to_csv(tmp_path / "results.csv", index=False)
    assert layout(read_results(tmp_path / "results.csv")) == layout(results)


def test_mean_and_spread_are_printed_with_one_decimal():
    assert spread(28.14, 15.06) == "28.1 (15.1)"
    assert spread(float("nan"), 1.0) == "–"
    assert spread(3.0, float("nan")) == "3.0"


def test_the_paired_table_and_its_picture_show_every_method(tmp_path):
    base = np.linspace(5, 40, 20)
    frames = pd.DataFrame(
        [
            {"dataset": "behave_mini", "protocol": "p", "method": m, "frame_id": f"{i}",
             "object_cm": value * factor}
            for m, factor in (("ours", 1.0), ("phosa", 2.0), ("true_action", 0.9))
            for i, value in enumerate(base)
        ]
    )  # fmt: skip
    comparison = paired(frames, "ours", "chair")
    table = paired_layout(comparison)
    assert [name for name, _ in table.rows] == ["PHOSA", "Ours, told the action"]
    assert table.rows[0][1][3] == "2.00"
    assert "PHOSA" in as_html_page([table], "Accuracy")
    draw_paired(comparison, tmp_path / "a.png")
    draw_paired(comparison, tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
