"""Measuring detectors: keypoint similarity, ways to cut out, labelled folders, the command."""

import csv
import json
import weakref
from dataclasses import replace

import cv2
import numpy as np
import pytest

from hoi.artifacts import Candidate, Detection
from hoi.body.keypoints import KEYPOINT
from hoi.cli import main
from hoi.datasets.labelled import read_labelled
from hoi.detect.agreement import detection_table, mask_iou
from hoi.detect.boxes import grown, mask_box
from hoi.detect.choice import CHOSEN
from hoi.detect.grabcut import plain_grabcut
from hoi.detect.labels import PERSON
from hoi.detect.mask_methods import FOUND, TRUE, compare_masks, mask_methods, mask_rows, mask_table
from hoi.detect.oks import SIGMAS, keypoint_similarity
from hoi.errors import ConfigError
from hoi.report import show
from hoi.report.detection import masks_layout
from hoi.report.tables import as_text
from test_detect_stage import CHAIR_BOX, PERSON_BOX, REGISTRY, filled, frame, picture

# ------------------------------------------------------------------------------------------ OKS


def labels(visible=1.0):
    points = np.random.default_rng(0).uniform(0, 100, (21, 2))
    return np.column_stack([points, np.full(21, visible)])


def test_the_similarity_of_a_perfect_pose_is_one_and_of_a_far_one_zero():
    truth = labels()
    assert keypoint_similarity(truth, truth, 900.0) == pytest.approx(1)
    assert keypoint_similarity(truth + [1e4, 0, 0], truth, 900.0) == pytest.approx(0)


def test_one_keypoint_off_by_its_own_spread_counts_exp_of_minus_a_half():
    truth, area = labels(), 900.0
    found = truth.copy()
    hip = KEYPOINT["left_hip"]
    found[hip, 0] += 2 * SIGMAS[hip] * np.sqrt(area)
    expected = (20 + np.exp(-0.5)) / 21
    assert keypoint_similarity(found, truth, area) == pytest.approx(expected)
    # the same error at the eye is graver
    worse = truth.copy()
    worse[KEYPOINT["left_eye"], 0] += 2 * SIGMAS[hip] * np.sqrt(area)
    assert keypoint_similarity(worse, truth, area) < expected


def test_what_is_not_labelled_does_not_count():
    truth = labels()
    truth[5:, 2] = 0
    found = truth.copy()
    found[5:, :2] += 1e4
    assert keypoint_similarity(found, truth, 900.0) == pytest.approx(1)
    assert np.isnan(keypoint_similarity(found, labels(visible=0), 900.0))


# ---------------------------------------------------------------------------------------- masks


def test_ways_to_cut_out_are_compared_from_the_found_and_from_the_true_box():
    image, truth, pose = picture()
    a_frame = frame(image=image, given_object_mask=truth, given_person_mask=pose.probability > 0)
    wrong = Detection(
        frame_id="f",
        person_box=np.array(PERSON_BOX),
        object_box=np.array(mask_box(truth)),
        candidates=[
            Candidate(label=PERSON, score=0.9, box=PERSON_BOX, verdict=CHOSEN),
            Candidate(label="chair", score=0.9, box=mask_box(truth), verdict="other_object"),
            Candidate(label="chair", score=0.5, box=(200, 150, 230, 190), verdict=CHOSEN),
        ],
        person_mask=pose.probability > 0,
        object_mask=truth,
        keypoints=pose.keypoints,
    )
    methods = mask_methods(REGISTRY)
    rows = compare_masks(a_frame, wrong, pose, methods, seed=0)
    table = mask_table(mask_rows(rows)).set_index(["category", "box"])
    assert set(methods) <= set(table.columns)
    assert table.loc[("chair", TRUE), "n"] == 1
    assert table.loc[("chair", FOUND), "whole_box"] == 0  # the wrong place
    true = table.loc[("chair", TRUE)]
    box, disc = filled(mask_box(truth), (200, 240)), truth
    assert true["whole_box"] == pytest.approx((box & disc).sum() / (box | disc).sum(), abs=0.02)
    assert np.isnan(true["stage"]) and table.loc[("chair", FOUND), "stage"] == 1
    assert true["grabcut"] > 0.9 > true["box_minus_person"] > 0.6
    text = as_text(masks_layout(table.reset_index(), "toys"), width=200)
    assert "toys: object masks" in text and "chair, true box" in text


@pytest.mark.parametrize(
    ("known", "title"), [("toys,test,", "toys (test): object masks"), ("", "mine: object masks")]
)
def test_the_table_of_masks_prints_whoever_wrote_it(tmp_path, capsys, known, title):
    columns = "category,box,n,plain_grabcut,stage"
    path = tmp_path / "mine" / "masks.csv"
    path.parent.mkdir()
    path.write_text(
        f"{'dataset,split,' if known else ''}{columns}\n{known}all,found box,3,0.59,0.828\n"
    )
    assert show.main([str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].strip() == title
    (row,) = [line.split() for line in lines if "found box" in line]
    assert row == ["all,", "found", "box", "3", "0.590", "0.828"]


def test_no_masks_make_an_empty_table():
    table = mask_table(mask_rows([]))
    assert list(table.columns) == ["category", "box", "n"] and table.empty
    assert "toys: object masks" in as_text(masks_layout(table, "toys"), width=200)


def test_plain_grabcut_knows_the_box_alone():
    image, truth, pose = picture()
    box = grown(mask_box(truth), 6)
    found, source = plain_grabcut(image, box, pose, 0)
    assert source == "plain_grabcut" and mask_iou(found, truth) > 0.9
    everywhere = replace(pose, probability=np.ones_like(pose.probability))
    np.testing.assert_array_equal(plain_grabcut(image, box, everywhere, 0)[0], found)
    large = cv2.resize(image, None, fx=5, fy=5)
    found, _ = plain_grabcut(large, tuple(5 * edge for edge in box), pose, 0)
    assert found.shape == large.shape[:2]
    assert mask_iou(found, cv2.resize(truth.astype(np.uint8), found.shape[::-1]) > 0) > 0.9


@pytest.mark.parametrize("box", [(-5.0, -5, 999, 999), (20.0, 20, 21, 60), (-9.0, -9, -3, -3)])
def test_plain_grabcut_answers_with_the_box_where_it_cannot_be_asked(box):
    image, _, pose = picture()
    found, source = plain_grabcut(image, box, pose, 0)
    assert source == "box" and found.shape == image.shape[:2]


def test_an_object_is_right_by_its_box_or_by_its_mask():
    truth = filled(CHAIR_BOX)
    speckled = truth.copy()
    speckled[2:4, 150:152] = True  # stretches its box to three times the size

    def right(box, mask, given=truth):
        found = Detection(
            frame_id="f",
            person_box=np.array(PERSON_BOX),
            object_box=np.array(box),
            person_mask=filled(PERSON_BOX),
            object_mask=filled(mask),
            keypoints=frame().given_keypoints,
        )
        row = detection_table([(frame(given_object_mask=given), found)], REGISTRY).iloc[-1]
        return tuple(row[["object_right", "object_box_right", "object_mask_right"]])

    loose, part, elsewhere = (20.0, 10, 100, 110), (55.0, 60, 65, 110), (100.0, 10, 150, 50)
    assert right(CHAIR_BOX, CHAIR_BOX) == (1, 1, 1)
    assert right(CHAIR_BOX, CHAIR_BOX, speckled) == (1, 1, 1)
    assert right(loose, CHAIR_BOX) == (1, 0, 1)
    assert right(CHAIR_BOX, part) == (1, 1, 0)
    assert right(elsewhere, elsewhere) == (0, 0, 0)


def test_a_table_of_many_photos_holds_one_at_a_time():
    failed = Detection(frame_id="f", status="no_object_detected", failed_stage="detect")
    read = []

    def pairs():
        for _ in range(4):
            photo = frame()
            read.append(weakref.ref(photo))
            yield photo, failed
            del photo
            assert sum(seen() is not None for seen in read) <= 1

    assert detection_table(pairs(), REGISTRY)["n"].tolist() == [4, 4]


def test_a_failed_frame_is_compared_with_the_true_box_alone():
    image, truth, pose = picture()
    failed = Detection(frame_id="f", status="no_object_detected", failed_stage="detect")
    boxes = compare_masks(
        frame(image=image, given_object_mask=truth),
        failed,
        pose,
        {"box": lambda *_: (truth, "")},
        0,
    )
    assert [(row["box"], row["iou"]) for row in boxes] == [(TRUE, 1.0)]


# ------------------------------------------------------------------------------ labelled folders


@pytest.fixture
def folder(tmp_path):
    """One labelled photo of 160 x 120 pixels."""
    (tmp_path / "masks").mkdir()
    picture = np.random.default_rng(0).integers(90, 110, (120, 160, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    for name, box in (("person", PERSON_BOX), ("chair", CHAIR_BOX)):
        mask = filled(box).astype(np.uint8) * 255
        cv2.imwrite(str(tmp_path / "masks" / f"{name}.png"), mask)
    points = [[x, 50, 2] for x in range(17)]
    (tmp_path / "a.json").write_text(json.dumps({"keypoints": np.ravel(points).tolist()}))
    write(tmp_path, "a.png,Chair,masks/chair.png,masks/person.png,a.json")
    return tmp_path


def write(folder, *lines, columns="photo,category,object_mask,person_mask,keypoints"):
    (folder / "labels.csv").write_text("\n".join([columns, *lines]) + "\n")


def test_labels_become_the_frames_given_masks_and_keypoints(folder):
    (labelled,) = read_labelled(folder)
    assert (labelled.frame_id, labelled.category) == ("a", "chair")
    np.testing.assert_array_equal(labelled.given_object_mask, filled(CHAIR_BOX))
    np.testing.assert_array_equal(labelled.given_person_mask, filled(PERSON_BOX))
    knee = labelled.given_keypoints[KEYPOINT["left_knee"]]
    assert knee.tolist() == [13, 50, 2]  # row 13 of COCO
    assert labelled.given_keypoints[KEYPOINT["left_toe"], 2] == 0
    write(folder, "a.png,chair,masks/chair.png,,")
    (labelled,) = read_labelled(folder)
    assert labelled.given_person_mask is None and labelled.given_keypoints is None


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("a.png,chair,masks/gone.png,,", r"line 2: there is no file masks/gone\.png"),
        ("a.png,chair,../../etc/passwd,,", "line 2: .* no file inside"),
        ("a.png,,masks/chair.png,,", "line 2: the category is empty"),
        ("a.png,chair,masks/chair.png,,labels.csv", r"line 2: labels\.csv: no list of x, y, v"),
        ("a.json,chair,masks/chair.png,,", "line 2: image_unreadable"),
    ],
)
def test_labels_that_cannot_be_used_are_named_by_their_line(folder, line, message):
    write(folder, line)
    with pytest.raises(ConfigError, match=rf"labels\.csv.*{message}"):
        list(read_labelled(folder))


def test_a_folder_without_labels_or_with_other_columns_says_what_it_needs(folder):
    write(folder, "a.png", columns="photo")
    with pytest.raises(ConfigError, match="category, object_mask are missing"):
        list(read_labelled(folder))
    write(folder, "a.png,x,y,z", columns="photo,category,object_mask,mood")
    with pytest.raises(ConfigError, match="mood are unknown"):
        list(read_labelled(folder))
    (folder / "labels.csv").unlink()
    with pytest.raises(ConfigError, match="it needs the columns photo"):
        list(read_labelled(folder))


def test_the_command_prints_and_writes_the_tables(folder, tmp_path, monkeypatch, capsys):
    """The stage's networks are stood in for; everything around them is real."""
    import hoi.detect.models
    import hoi.detect.stage
    from test_detect_stage import CHAIR, PERSON, registry_stage

    monkeypatch.setattr(hoi.detect.models, "fetch_models", lambda *_: [])
    stage = registry_stage([PERSON, CHAIR])
    monkeypatch.setattr(hoi.detect.stage, "DetectStage", lambda *_: stage)
    out = tmp_path / "out"
    assert main(["detection", str(folder), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "a.png: ok" in printed and "object masks" in printed
    header, chair, _ = (out / "detection.csv").read_text().splitlines()
    row = dict(zip(header.split(","), chair.split(","), strict=True))
    assert (row["n"], row["person_found"], row["object_right"]) == ("1", "1", "1")
    assert (row["object_box_right"], row["object_mask_right"]) == ("1", "1")
    assert row["object@0.6"] == "0" and row["right@ours"] == "1"
    assert (out / "masks.csv").read_text().count("true box") == 2
    (photo,) = csv.DictReader((out / "photos.csv").open())
    assert (photo["photo"], photo["status"], photo["right"]) == ("a.png", "ok", "True")
    assert float(photo["box_iou"]) > 0.5
    page = (out / "photos.html").read_text()
    assert "1 of 1 objects are right" in page and "the labelled chair in white" in page
    assert f"of the box {float(photo['box_iou']):.2f}" in page
    assert main(["detection", str(tmp_path / "nowhere")]) == 1
    assert "labels.csv" in capsys.readouterr().err
