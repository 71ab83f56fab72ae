"""The report on action recognition: search phrases, accuracies, confusions and pictures."""

import numpy as np
import pandas as pd
import pytest
import torch
import trimesh

from hoi.actions.database import DEFAULT_DATABASE, PoseDatabase, load_database
from hoi.actions.leave_one_out import accuracy_report, confusion_table, examples
from hoi.actions.queries import Query, parse_query, queries, write_queries
from hoi.actions.space import DEFAULT_ACTION_SPACE, load_action_space
from hoi.body import DEFAULT_BODY, BodyModel
from hoi.body.files import read_body_file
from hoi.body.upright import stand
from hoi.errors import ConfigError
from hoi.report.actions import (
    PoseRow,
    Tile,
    actions_layout,
    actions_page,
    confusion_layouts,
    is_actions_table,
    pose_sheet,
)
from hoi.report.config import ReportConfig
from hoi.report.show import tables_of


@pytest.fixture(scope="module")
def keyboards():
    database = load_database(DEFAULT_DATABASE)
    rows = database.rows_of("keyboard")
    fields = (database.pose_ids, database.categories, database.actions, database.body_pose)
    return PoseDatabase(*(field[rows] for field in fields), database.pelvis_up[rows])


@pytest.fixture(scope="module")
def space():
    return load_action_space(DEFAULT_ACTION_SPACE)


# -------------------------------------------------------------------------- search phrases


def test_queries_are_sentences_of_a_person_an_action_and_an_object(space):
    found = [str(query) for query in queries(space, "chair")]
    assert found[:2] == ["woman sit chair", "man sit chair"]
    assert "woman stand on chair" in found
    assert len(found) == 2 * len(space.actions_of("chair"))


@pytest.mark.parametrize(
    ("text", "query"),
    [
        ("woman sit chair", Query("woman", "sit", "chair")),
        ("man_stand_on_chair", Query("man", "stand on", "chair")),
        ("Carry the suitcase", Query("", "carry", "suitcase")),
        ("person-throw-beach-ball", Query("person", "throw", "beach_ball")),
        ("girl fly kite", Query("girl", "fly", "kite")),
    ],
)
def test_a_folder_s_name_is_read_as_a_query(text, query):
    assert parse_query(text, ["chair", "suitcase", "ball", "beach_ball"]) == query


@pytest.mark.parametrize("text", ["chair", "", "woman chair", "holidays"])
def test_other_names_are_no_queries(text):
    with pytest.raises(ConfigError, match="woman sit chair"):
        parse_query(text, ["chair"])


def test_every_query_of_the_action_space_is_read_back(space):
    nouns = sorted({edge.category for edge in space.edges})
    for noun in nouns:
        for query in queries(space, noun):
            assert parse_query(str(query), nouns) == query


def test_the_table_of_queries_says_what_the_database_already_knows(space, tmp_path):
    write_queries(space, ["keyboard"], {("keyboard", "type")}, tmp_path / "q.csv")
    table = pd.read_csv(tmp_path / "q.csv")
    known = table.set_index("query")["in_database"]
    assert known["man type keyboard"] == "yes" and (known == "no").any()


# ------------------------------------------------------------------------------ accuracies


def test_the_report_compares_with_the_paper_and_with_never_looking(keyboards, tmp_path):
    table = accuracy_report(keyboards, default_action=lambda category: "type")
    (row,) = table.to_dict("records")
    assert row["always_default"] == pytest.approx(np.mean(keyboards.actions == "type"))
    assert 0.8 < row["without_the_pose"] <= 1
    assert 0 < row["without_its_base_pose"] < row["without_the_pose"]
    assert is_actions_table(table)
    table.to_csv(tmp_path / "actions.csv", index=False)
    (layout,) = tables_of(str(tmp_path / "actions.csv"))
    assert layout == actions_layout(pd.read_csv(tmp_path / "actions.csv"))
    assert [name for name, _ in layout.rows] == ["keyboard", "average"]


def test_confusions_add_up_to_the_accuracy(keyboards):
    confusion = confusion_table(keyboards, ["keyboard"])
    right = confusion.loc[confusion["action"] == confusion["retrieved"], "count"].sum()
    share = accuracy_report(keyboards)["without_its_base_pose"][0]
    assert right / confusion["count"].sum() == pytest.approx(share)
    (layout,) = confusion_layouts(confusion)
    assert [name for name, _ in layout.rows] == list(layout.groups[0][1])


def test_examples_never_show_a_variant_of_the_left_out_pose(keyboards):
    def base(row):
        return str(keyboards.pose_ids[row]).rsplit("_", 1)[0]

    found = examples(keyboards, "keyboard")
    assert [example.action for example in found] == ["move", "type"]
    for example in found:
        assert keyboards.actions[example.row] == example.action
        assert base(example.row) not in {base(row) for row in example.found}
        assert list(example.distances) == sorted(example.distances)
        assert len({keyboards.actions[row] for row in example.found}) == len(example.found)


# -------------------------------------------------------------------------------- pictures


def test_a_pose_is_stood_up_by_its_pelvis():
    body = read_body_file(DEFAULT_BODY)
    up = np.array([0.0, np.cos(0.7), -np.sin(0.7)])
    upright, bent = stand(body, np.zeros(69)), stand(body, np.zeros(69), up)
    assert upright[:, 1].min() == bent[:, 1].min() == 0
    head = upright[:, 1].argmax()
    assert bent[head, 1] < upright[head, 1] - 0.1
    assert bent[head, 2] > bent[upright[:, 1].argmin(), 2] + 0.5  # bent forward, not back


def test_a_pose_for_a_picture_is_that_of_the_fitted_model():
    pose = load_database(DEFAULT_DATABASE).body_pose[500]
    model = BodyModel.load(DEFAULT_BODY)
    with torch.no_grad():
        given = (np.zeros(3), pose, np.zeros(model.num_betas), np.zeros(3))
        posed, _ = model(*(torch.as_tensor(part).float().reshape(1, -1) for part in given))
    wanted = posed[0].numpy()
    found = stand(read_body_file(DEFAULT_BODY), pose)
    assert np.abs(found - (wanted - [0, wanted[:, 1].min(), 0])).max() < 1e-5


def test_wrong_answers_are_framed_and_the_page_holds_everything(keyboards):
    solid = trimesh.creation.box((0.4, 1.7, 0.2))
    box, faces = np.asarray(solid.vertices), np.asarray(solid.faces)

    def sheet(answer):
        tiles = (Tile(box, "move", "left out"), Tile(box, answer, "1.00"))
        return pose_sheet([PoseRow(tiles)], faces)

    def red(picture):
        return int((picture.astype(int) @ [1, -1, 0] > 120).sum())

    assert red(sheet("type")) > 300 and red(sheet("move")) == 0
    table = accuracy_report(keyboards)
    confusion = confusion_table(keyboards, ["keyboard"])
    page = actions_page(
        table, confusion, {"keyboard": sheet("type")}, {"keyboard": ["man type"]}, ReportConfig()
    )
    assert "data:image/webp;base64," in page and "man type" in page
    assert "Confusion: keyboard" in page and "http" not in page.replace("http-equiv", "")
