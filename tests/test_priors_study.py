"""The report on priors: the paper's figures, people's ratings, models' votes, agreement."""

import csv
import math

import pytest

from hoi.errors import AssetError
from hoi.priors.answered import interview_of
from hoi.priors.config import LanguageModelConfig, StudyConfig
from hoi.priors.study import (
    RATING_COLUMNS,
    STUDY_COLUMNS,
    Voice,
    agreement_table,
    labels_by_origin,
    model_rows,
    overlap,
    printed_rows,
    rating_rows,
    rating_sheet,
    size_table,
    study_row,
    study_table,
    voice_of_model,
    voices_of_tables,
    write_rows,
)
from hoi.priors.tables import load_tables
from llm_stub import Stub

CONFIG = StudyConfig()
SIT, CARRY = ("chair", "sit"), ("chair", "carry")
SEAT, BACK, ARM = ("chair_seat", "butt"), ("chair_back", "back"), ("chair_arm", "hand")


def test_the_buckets_and_percentages_are_the_papers():
    votes = [(10, 10), (7, 10), (6, 10), (4, 10), (3, 10)]
    row = study_row("contacts", "x", "y", "people", votes, CONFIG)
    assert (row["correct_pct"], row["uncertain_pct"], row["incorrect_pct"]) == (40, 40, 20)
    assert row["n_labels"] == 5 and row["votes_for_pct"] == 60 and row["votes_per_label"] == 10


def test_the_binomial_test_counts_votes_against_a_coin():
    row = study_row("sizes", "x", "y", "people", [(8, 10)], CONFIG)
    exact = sum(math.comb(10, k) for k in (8, 9, 10)) / 2**10
    assert row["p_value"] == pytest.approx(exact)
    assert study_row("sizes", "x", "y", "people", [(5, 10)] * 20, CONFIG)["p_value"] > 0.5


def test_the_papers_p_can_be_had_from_votes_but_not_from_its_20_labels():
    """15 labels of 20 correct, 5 uncertain: at least 15 x 7 + 5 x 4 votes of 200."""
    least = [(7, 10)] * 15 + [(4, 10)] * 5
    assert study_row("sizes", "x", "y", "people", least, CONFIG)["p_value"] < 0.001
    labels_as_votes = [(1, 1)] * 15 + [(0, 1)] * 5
    assert study_row("sizes", "x", "y", "people", labels_as_votes, CONFIG)["p_value"] > 0.01


def test_the_printed_percentages_add_up():
    for row in printed_rows():
        assert row["correct_pct"] + row["uncertain_pct"] + row["incorrect_pct"] == 100


# ---------------------------------------------------------------------------------- people


def ratings(tmp_path, lines):
    path = tmp_path / "ratings.csv"
    path.write_text("\n".join([",".join(RATING_COLUMNS), *lines]) + "\n")
    return path


def test_a_csv_of_ratings_gives_the_same_report(tmp_path):
    lines = [f"size,chair,,,,0.85,rater{i},{'yes' if i < 7 else 'no'}" for i in range(10)]
    lines += [f"contact,chair,sit,seat,butt,,rater{i},1" for i in range(10)]
    lines += [f"contact,chair,sit,leg,nose,,rater{i},{int(i < 3)}" for i in range(10)]
    sizes, contacts = rating_rows(ratings(tmp_path, lines), CONFIG)
    assert (sizes["subject"], sizes["correct_pct"], sizes["voters"]) == ("sizes", 100, "10 people")
    assert (contacts["n_labels"], contacts["correct_pct"], contacts["incorrect_pct"]) == (2, 50, 50)
    assert contacts["kind"] == "people" and contacts["note"] == "ratings.csv"


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("weight,chair,,,,1,ann,yes", "line 3, column subject: 'weight'"),
        ("size,chair,,,,0.85,bob,perhaps", "line 3, column correct: 'perhaps'"),
        ("size,chair,,,,0.85,ann,no", "line 3, column rater: ann rates 'chair 0.85' twice"),
        ("size,chair,,,,0.85,,no", "line 3, column rater: is empty"),
    ],
)
def test_a_bad_rating_is_named_by_line_and_column(tmp_path, line, problem):
    path = ratings(tmp_path, ["size,chair,,,,0.85,ann,yes", line])
    with pytest.raises(AssetError) as error:
        rating_rows(path, CONFIG)
    assert problem in str(error.value) and str(path) in str(error.value)


def test_an_absent_file_or_column_is_named(tmp_path):
    with pytest.raises(AssetError, match="not there"):
        rating_rows(tmp_path / "nothing.csv", CONFIG)
    (tmp_path / "short.csv").write_text("subject,category\n")
    with pytest.raises(AssetError, match="no column action"):
        rating_rows(tmp_path / "short.csv", CONFIG)


def test_the_sheet_lists_every_label_once_and_is_no_rating_until_it_is_filled(tmp_path):
    tables = load_tables()
    sheet = rating_sheet(tables)
    assert len(sheet) == len(tables.sizes) + sum(map(len, tables.contacts.values()))
    path = tmp_path / "sheet.csv"
    write_rows(path, RATING_COLUMNS, sheet)
    assert rating_rows(path, CONFIG) == []
    with open(path, newline="") as stream:
        rows = list(csv.DictReader(stream))
    write_rows(path, RATING_COLUMNS, [row | {"rater": "ann", "correct": "yes"} for row in rows])
    sizes, contacts = rating_rows(path, CONFIG)
    assert sizes["n_labels"] == len(tables.sizes)
    assert contacts["n_labels"] == sum(map(len, tables.contacts.values()))


# ---------------------------------------------------------------------------------- models

PAPER = Voice("paper", {"chair": (0.85,), "table": (0.75,)},
              {SIT: {SEAT: 1.0, BACK: 1.0}, CARRY: {ARM: 1.0}}, 1)  # fmt: skip
MODEL = Voice("model", {"chair": (0.8, 0.9, 3.0, 0.85, 0.85)},
              {SIT: {SEAT: 0.8, ARM: 0.2}, CARRY: {ARM: 0.6}}, 5)  # fmt: skip


def test_a_models_votes_on_its_own_labels_measure_how_sure_it_is():
    sizes, contacts = model_rows(MODEL, None, CONFIG)
    assert sizes["n_labels"] == 1 and sizes["votes_for_pct"] == 80
    assert contacts["n_labels"] == 3 and contacts["votes_for_pct"] == pytest.approx(100 * 8 / 15)
    third = 100 / 3
    buckets = [contacts[f"{name}_pct"] for name in ("correct", "uncertain", "incorrect")]
    assert buckets == [pytest.approx(third)] * 3


def test_a_models_votes_on_the_papers_labels_count_pairs_that_it_never_names():
    sizes, contacts = model_rows(MODEL, PAPER, CONFIG)
    assert sizes["labels"] == "paper" and sizes["n_labels"] == 1  # the table was not asked about
    assert contacts["n_labels"] == 3
    assert contacts["votes_for_pct"] == pytest.approx(100 * 7 / 15)  # BACK has none


def test_agreement_is_counted_on_what_both_were_asked():
    other = Voice("other", {"table": (1.5,)}, {CARRY: {ARM: 1.0}}, 1)
    rows = {(r["subject"], r["first"], r["second"]): r
            for r in agreement_table([PAPER, MODEL, other], CONFIG)}  # fmt: skip
    sizes = rows["sizes", "paper", "model"]
    assert (sizes["n"], sizes["same_pct"], sizes["median_factor"]) == (1, 100, 1)
    assert rows["sizes", "paper", "other"]["median_factor"] == 2
    contacts = rows["contacts", "paper", "model"]
    assert contacts["n"] == 2 and contacts["same_pct"] == 50
    assert contacts["mean_overlap"] == pytest.approx((1 / 2 + 1) / 2)  # ARM named too rarely
    assert ("sizes", "model", "other") not in rows


def test_nothing_touches_is_an_answer_that_can_be_agreed_on():
    assert overlap(set(), set()) == 1 and overlap({SEAT}, set()) == 0


def test_a_recorded_model_is_heard_and_what_it_was_not_asked_is_counted(tmp_path):
    stub = Stub(lambda body: " 0.85m" if "Length" in body["prompt"] else " seat/butt")
    config = LanguageModelConfig(base_url=stub.url, model="m", mode="record", samples=2,
                                 recordings=str(tmp_path))  # fmt: skip
    interview = interview_of(config)
    interview.size("chair")
    interview.contacts("chair", "sit")
    stub.close()
    voice = voice_of_model(config, load_tables())
    assert voice.sizes == {"chair": (0.85, 0.85)} and voice.contacts == {SIT: {SEAT: 1.0}}
    assert voice.note.startswith("2 questions recorded, ") and voice.samples == 2
    table = study_table(CONFIG, load_tables(), [voice])
    assert [row["kind"] for row in table[:2]] == ["printed in the paper"] * 2
    own = [row for row in table if row["labels"] == "its own"]
    assert [row["correct_pct"] for row in own] == [100, 100]
    write_rows(tmp_path / "priors.csv", STUDY_COLUMNS, table)
    with open(tmp_path / "priors.csv", newline="") as stream:
        assert len(list(csv.DictReader(stream))) == len(table)


def test_the_printed_and_the_authored_labels_share_no_question():
    paper, ours = voices_of_tables(load_tables())
    assert not set(paper.sizes) & set(ours.sizes)
    assert not set(paper.contacts) & set(ours.contacts)
    printed = labels_by_origin(load_tables(), printed=True)
    assert {a.source.split()[0] for each in printed.contacts.values() for a in each} == {"paper"}


# ---------------------------------------------------------------------------------- sizes


def test_a_couchs_height_taken_for_its_length_halves_it():
    rows = {row["category"]: row for row in size_table(load_tables())}
    assert rows["couch"]["factor_as_longest"] < 0.5
    assert rows["couch"]["in_range_as_reviewed"] == "yes"
    assert rows["backpack"]["factor_as_longest"] == rows["backpack"]["factor_as_reviewed"]
