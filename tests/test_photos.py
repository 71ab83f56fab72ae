"""Photos of one's own: names for objects nobody named, own masks, the table of outcomes."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hoi.artifacts import BodyFit, Detection, Frame, Joint, ObjectFit
from hoi.config import load_config
from hoi.datasets.photos_config import PhotosConfig
from hoi.detect.agreement import detection_table
from hoi.detect.naming import ObjectNamer, category_of_label
from hoi.errors import FrameFailure
from hoi.exemplars.categories import known_categories
from hoi.exemplars.config import ExemplarsConfig
from hoi.exemplars.vocabulary import exemplar_category
from hoi.manifest import plan
from hoi.report import show
from hoi.report.detection import detection_layout
from hoi.report.doubts import doubts
from hoi.report.photos import COLUMNS, object_size, photo_row
from hoi.report.tables import as_text
from test_detect_stage import (
    CHAIR,
    CHAIR_BOX,
    HEIGHT,
    PERSON,
    PERSON_BOX,
    REGISTRY,
    WIDTH,
    box,
    filled,
    frame,
    registry_stage,
    status_of,
)

ROOT = Path(__file__).parents[1]
CATEGORIES = known_categories(ExemplarsConfig())
OWN = REGISTRY.model_copy(update={"masks": "prefer_given"})
BLANK = np.zeros((HEIGHT, WIDTH, 3), np.uint8)


def name_of(*boxes):
    """What the object is called when the detector sees these boxes, whole picture or crop."""
    return ObjectNamer(REGISTRY, CATEGORIES, box_detectors={"eye": lambda image: list(boxes)})(
        BLANK
    )


# --------------------------------------------------------------------------------- names


def test_an_unnamed_object_gets_the_category_of_what_the_detector_sees_next_to_the_person():
    assert name_of(PERSON, box("dining table", 0.4, *CHAIR_BOX)) == "table"
    assert name_of(PERSON, box("teddy bear", 0.4, *CHAIR_BOX)) == "teddy"


def test_the_surest_object_is_meant_even_if_it_has_no_exemplars():
    assert name_of(PERSON, CHAIR, box("horse", 0.9, *CHAIR_BOX)) == "horse"


def test_an_object_that_nobody_named_must_be_seen_for_sure():
    assert name_of(PERSON, box("chair", 0.3, *CHAIR_BOX)) is None
    unsure = registry_stage([PERSON, box("chair", 0.3, *CHAIR_BOX)])
    with pytest.raises(FrameFailure, match="name the object") as caught:
        unsure(frame(category="auto"), seed=0)
    assert caught.value.status == "no_object_detected"


def test_nothing_or_nobody_has_no_name():
    assert name_of(PERSON) is None
    assert name_of(CHAIR) is None


def test_a_class_of_two_categories_names_the_first_that_owns_it():
    assert category_of_label(("stool", "chair"), {}) == {"chair": "stool"}
    assert category_of_label(("display", "suitcase"), {}) == {
        "tv": "display",
        "suitcase": "suitcase",
    }


@pytest.mark.parametrize(
    ("word", "category"),
    [("Teddy Bear", "teddy"), ("desk", "table"), ("skis", "skis"), ("cup", "mug"), ("owl", "owl")],
)
def test_everyday_words_become_categories_with_exemplars(word, category):
    assert exemplar_category(word, CATEGORIES) == category


def test_own_meshes_keep_their_word():
    assert exemplar_category("Desk", ("table", "desk")) == "desk"


def test_the_plan_knows_the_categories_of_photos(tmp_path):
    for name in ("a.jpg", "b.jpg", "broken.png"):
        (tmp_path / name).write_bytes(b"not opened by the plan")
    (tmp_path / "objects.yaml").write_text("a: Dining table\n")
    changes = {"photos": PhotosConfig(folder=str(tmp_path)), "memo": str(tmp_path / "memo")}
    (chunk,) = plan(load_config(ROOT / "config/config.yaml").model_copy(update=changes), "photos")
    found = [(info.category, info.object_name) for info in chunk.frames]
    assert found == [("table", "dining table"), ("auto", "auto"), ("auto", "auto")]


# ----------------------------------------------------------------------------- own masks


def test_an_own_object_mask_replaces_detection_of_the_object():
    own = filled((100.0, 40.0, 130.0, 70.0))
    photo = frame(given_person_mask=None, given_object_mask=own, category="tripod")
    result = registry_stage([PERSON, CHAIR], OWN)(photo, seed=0)
    np.testing.assert_array_equal(result.object_mask, own)
    np.testing.assert_array_equal(result.object_box, (100, 40, 130, 70))
    sources = result.object_mask_source, result.person_mask_source
    assert sources == ("given", "blazepose")
    assert (result.object_label, result.object_score) == ("tripod", None)
    assert result.person_score == PERSON.score


def test_an_own_mask_holds_even_where_the_rule_of_choice_doubts_it():
    photo = frame(given_person_mask=None, given_object_mask=filled((150.0, 0.0, 160.0, 8.0)))
    small = registry_stage([box("person", 0.8, 10, 80, 20, 100)], OWN)
    assert small(photo, seed=0).object_mask_source == "given"


def test_an_own_person_mask_chooses_the_person_and_is_not_overruled():
    own = filled(PERSON_BOX)
    photo = frame(given_person_mask=own, given_object_mask=None)
    result = registry_stage([box("person", 0.9, 100, 5, 155, 115), CHAIR], OWN)(photo, seed=0)
    np.testing.assert_array_equal(result.person_mask, own)
    assert not (result.object_mask & own).any()
    assert (result.person_score, result.object_label) == (None, "chair")


def test_with_both_masks_nothing_is_detected():
    def nobody_asks(image):
        raise AssertionError("the detector was asked")

    stage = registry_stage([], OWN)
    stage._find._detector = nobody_asks
    assert stage(frame(), seed=0).object_mask_source == "given"


def test_registry_ignores_the_masks_of_a_data_set():
    assert registry_stage([PERSON, CHAIR])(frame(), seed=0).object_mask_source == "stand_in"


def test_an_own_mask_without_a_person_is_a_status():
    photo = frame(given_person_mask=None)
    assert status_of(registry_stage([], OWN), photo) == "no_person_detected"


# --------------------------------------------------------------------------------- tables


def photo(**changes):
    values = dict(
        frame_id="a", dataset="photos", category="table", object_name="desk", source="a.jpg"
    )
    return Frame(status="image_unreadable", detail="cut off", **(values | changes))


def test_a_photo_that_cannot_be_read_has_a_row_with_its_name_and_reason():
    broken = photo(failed_stage="photos")
    skipped = [kind.skipped("a", broken) for kind in (Detection, BodyFit, ObjectFit, Joint)]
    row = photo_row(broken, *skipped, {}, 0.0)
    assert tuple(row) == COLUMNS
    told = row["photo"], row["object"], row["status"], row["failed_stage"], row["detail"]
    assert told == ("a.jpg", "table", "image_unreadable", "photos", "cut off")


@pytest.mark.parametrize(
    ("category", "object_name", "who"),
    [("table", "desk", "you"), ("skis", "auto", "detector"), ("auto", "auto", "nobody")],
)
def test_the_row_says_who_named_the_object(category, object_name, who):
    named = photo(category=category, object_name=object_name)
    skipped = [kind.skipped("a", named) for kind in (Detection, BodyFit, ObjectFit, Joint)]
    assert photo_row(named, *skipped, {}, 0.0)["named_by"] == who


def test_the_size_of_a_turned_object_is_measured_along_its_own_axes():
    from hoi.geometry import axis_angle_to_matrix

    torch = pytest.importorskip("torch")
    rotation = axis_angle_to_matrix(torch.tensor([[0.3, 0.8, -0.5]]))[0].numpy()
    corners = np.stack(np.meshgrid([0, 2.0], [0, 0.5], [0, 1.0]), -1).reshape(-1, 3)
    joint = Joint(
        frame_id="a",
        object_vertices=corners @ rotation.T + [0.1, 0.2, 3],
        object_rotation=rotation,
        object_faces=np.array([[0, 1, 2]]),
        body_vertices=corners,
        object_scale=1.0,
    )
    assert object_size(joint) == "2.00 x 0.50 x 1.00"


def doubted(name="skateboard", *, length=0.8, iou=0.9, seen=21, source="segmenter"):
    """What is said of an object of this length in metres, outline, keypoints and mask."""
    keypoints = np.zeros((21, 3))
    keypoints[:seen, 2] = 0.9
    filled = np.ones((4, 4), bool)
    found = Detection(
        frame_id="a", person_box=np.array([0, 0, 4, 4.0]), object_box=np.array([0, 0, 4, 4.0]),
        person_mask=filled, object_mask=filled, object_mask_source=source, keypoints=keypoints,
    )  # fmt: skip
    fit = ObjectFit(
        frame_id="a", exemplars=["x", "y"], rotations=np.tile(np.eye(3), (2, 1, 1)),
        translations=np.ones((2, 3)), ious=np.array([iou / 2, iou]),
    )  # fmt: skip
    joint = Joint(
        frame_id="a", object_vertices=np.array([[0, 0, 0], [0.2, 0.1, length]]),
        object_rotation=np.eye(3), object_faces=np.array([[0, 1, 1]]), object_scale=1.0,
        body_vertices=np.zeros((1, 3)),
    )  # fmt: skip
    return doubts(photo(category=name, object_name=name), found, fit, joint)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, None),
        ({"length": 1.3}, None),  # boards are 0.6 to 1.1 m, more or less
        ({"length": 1.5}, "1.50 m long, and such things are 0.6 to 1.1 m"),
        ({"length": 0.3}, "0.30 m long"),
        ({"name": "stroller", "length": 30.0}, None),  # nobody knows how large these are
        ({"iou": 0.5}, "looks like no exemplar (IoU of the outlines 0.50)"),
        ({"seen": 9}, "only 9 of 21 keypoints"),
        ({"source": "box_minus_person"}, "its box had to do"),
    ],
)
def test_a_result_that_stages_disagree_on_is_doubted(changes, told):
    said = doubted(**changes)
    assert len(said) == (told is not None)
    assert told is None or told in said[0]


def test_doubts_add_up_and_where_there_is_no_result_its_status_says_why():
    assert len(doubted(length=3.0, iou=0.2, seen=2, source="box")) == 4
    broken = photo()
    skipped = [kind.skipped("a", broken) for kind in (Detection, ObjectFit, Joint)]
    assert doubts(broken, *skipped) == []


def outcome(a_frame, *boxes):
    """The stage's artifact, failed or not."""
    try:
        return registry_stage(boxes)(a_frame, seed=0)
    except FrameFailure as failure:
        return failure.artifact


@pytest.fixture
def rates():
    stool = frame(category="stool", given_keypoints=None)
    far = box("chair", 0.7, 75, 10, 115, 55)
    table = detection_table(
        [
            (frame(), outcome(frame(), PERSON, CHAIR)),
            (frame(), outcome(frame(), PERSON, far)),
            (frame(), outcome(frame(), PERSON)),
            (stool, outcome(stool)),
        ],
        REGISTRY,
    )
    return table.assign(dataset="behave_mini", split="test")


def test_detection_rates_are_counted_by_category(rates):
    by = rates.set_index("category")
    assert by["n"].to_dict() == {"chair": 3, "stool": 1, "all": 4}
    assert by["person_found"].to_dict() == {"chair": 3, "stool": 0, "all": 3}
    assert by["object_right"].to_dict() == {"chair": 1, "stool": 0, "all": 1}
    assert by.loc["all", "failures"] == "no_object_detected 1; no_person_detected 1"
    # one right box and one wrong one came through
    assert by.loc["chair", "object_iou"] == pytest.approx(0.5)
    assert by.loc["chair", "keypoint_error_px"] == 0
    assert np.isnan(by.loc["stool", "person_iou"])
    assert by.loc["chair", ["object@0.9", "object@0.6", "object@ours"]].tolist() == [0, 1, 2]
    assert by.loc["chair", "right@ours"] == 1


def test_the_rates_print_as_a_table(rates, tmp_path, capsys):
    text = as_text(detection_layout(rates), width=200)
    (chair,) = [line.split() for line in text.splitlines() if line.startswith(" chair")]
    assert chair[:4] == ["chair", "3", "100", "33"]
    assert "stool: no_person_detected 1" in text
    rates.to_csv(tmp_path / "detection.csv", index=False)
    assert show.main([str(tmp_path / "detection.csv")]) == 0
    assert "behave_mini (test): detection" in capsys.readouterr().out


def test_the_table_of_photos_prints_with_its_reasons(tmp_path, capsys):
    broken = photo()
    skipped = [kind.skipped("a", broken) for kind in (Detection, BodyFit, ObjectFit, Joint)]
    path = tmp_path / "photos.csv"
    pd.DataFrame([photo_row(broken, *skipped, {}, 0.0)]).to_csv(path, index=False)
    assert show.main([str(path)]) == 0
    printed = capsys.readouterr().out
    assert "0 of 1 reconstructed" in printed and "a.jpg: cut off." in printed


def test_what_a_stage_left_out_does_not_hide_a_doubt(tmp_path, capsys):
    told = dict.fromkeys(COLUMNS, "") | {"photo": "a.jpg", "status": "ok"}
    told |= {"detail": "no part is called lid", "doubts": "only 9 of 21 keypoints are seen"}
    path = tmp_path / "photos.csv"
    pd.DataFrame([told]).to_csv(path, index=False)
    assert show.main([str(path)]) == 0
    printed = capsys.readouterr().out
    assert "a.jpg: no part is called lid." in printed
    assert "a.jpg: doubtful: only 9 of 21 keypoints are seen." in printed


def test_a_file_that_is_no_table_of_ours_is_refused(tmp_path, capsys):
    (tmp_path / "x.csv").write_text("a,b\n1,2\n")
    assert show.main([str(tmp_path / "x.csv")]) == 1
    assert "not a result table" in capsys.readouterr().err
