"""The detect stage without model files: given data, the rule of choice, failures, GrabCut."""

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from hoi.artifacts import Detection, Frame, Hints
from hoi.body.keypoints import KEYPOINT
from hoi.detect import DetectConfig
from hoi.detect.backends import DetectedBox, PersonPose
from hoi.detect.boxes import gap, grown, mask_box, overlap, pixel_window
from hoi.detect.choice import choose
from hoi.detect.config import GrabCutConfig
from hoi.detect.counts import detection_counts, status_counts
from hoi.detect.grabcut import GrabCut, draw_skeleton
from hoi.detect.labels import COCO80, label_weights
from hoi.detect.stage import DetectionFailure, DetectStage
from hoi.errors import AssetError, FrameFailure

HEIGHT, WIDTH = 120, 160
GIVEN = DetectConfig(landmarks="none")
REGISTRY = DetectConfig(masks="registry", keypoints="registry")
PERSON_BOX = (20.0, 10.0, 60.0, 110.0)
CHAIR_BOX = (55.0, 60.0, 100.0, 110.0)


def filled(box, shape=(HEIGHT, WIDTH)):
    mask = np.zeros(shape, bool)
    mask[pixel_window(box, *shape)] = True
    return mask


def keypoints(confidence=0.9):
    rng = np.random.default_rng(0)
    points = rng.uniform(PERSON_BOX[:2], PERSON_BOX[2:], (21, 2))
    return np.column_stack([points, np.full(21, confidence)]).astype(np.float32)


def frame(**changes):
    values = dict(
        frame_id="f",
        dataset="test",
        category="chair",
        image=np.full((HEIGHT, WIDTH, 3), 200, np.uint8),
        intrinsics=np.array([[150, 0, 80], [0, 150, 60], [0, 0, 1.0]]),
        given_person_mask=filled(PERSON_BOX),
        given_object_mask=filled(CHAIR_BOX),
        given_keypoints=keypoints(),
    )
    return Frame(**(values | changes))


def box(label, score, *corners):
    return DetectedBox(label, score, corners)


PERSON = box("person", 0.8, *PERSON_BOX)
CHAIR = box("chair", 0.5, *CHAIR_BOX)


def registry_stage(boxes, config=REGISTRY, pose="default", crop_boxes=()):
    """The stage with stand-in back ends; the second look answers `crop_boxes`."""
    answers = iter([list(boxes), list(crop_boxes)])
    person = PersonPose(
        keypoints(), np.zeros((21, 3), np.float32), filled(PERSON_BOX).astype(np.float32), 0.9
    )
    return DetectStage(
        config,
        box_detector=lambda image: next(answers),
        pose_estimator=lambda image, box, intrinsics: person if pose == "default" else pose,
        object_segmenter=lambda image, box, pose, seed: (filled(box), "stand_in"),
    )


def status_of(stage, an_image):
    with pytest.raises(FrameFailure) as caught:
        stage(an_image, seed=0)
    return caught.value.status


# ---------------------------------------------------------------------------------- given


def test_given_masks_and_keypoints_pass_through_with_their_boxes():
    result = DetectStage(GIVEN)(frame(), seed=0)
    np.testing.assert_array_equal(result.person_box, PERSON_BOX)
    np.testing.assert_array_equal(result.object_box, CHAIR_BOX)
    np.testing.assert_array_equal(result.person_mask, filled(PERSON_BOX))
    np.testing.assert_array_equal(result.keypoints, keypoints())
    sources = result.person_mask_source, result.object_mask_source, result.keypoints_source
    assert sources == ("given", "given", "given")
    assert result.landmarks is None and result.landmarks_source == "none"
    assert result.object_label == "chair" and result.person_score is None


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        (dict(given_person_mask=None), "person_mask_empty"),
        (dict(given_object_mask=None), "object_mask_empty"),
        (dict(given_person_mask=np.zeros((HEIGHT, WIDTH), bool)), "person_mask_empty"),
        (dict(given_object_mask=np.zeros((HEIGHT, WIDTH), bool)), "object_mask_empty"),
        (dict(given_object_mask=np.ones((HEIGHT, WIDTH - 1), bool)), "mask_size_mismatch"),
        (dict(given_person_mask=np.ones((WIDTH, HEIGHT), bool)), "mask_size_mismatch"),
        (dict(given_keypoints=None), "no_keypoints"),
        (dict(given_keypoints=np.zeros((21, 3))), "no_keypoints"),
        (dict(given_keypoints=keypoints(0.1)), "no_keypoints"),
    ],
)
def test_bad_given_data_is_a_status(changes, status):
    assert status_of(DetectStage(GIVEN), frame(**changes)) == status


def test_landmarks_come_from_the_pose_model_even_when_all_else_is_given():
    landmarks = np.random.default_rng(1).normal(size=(21, 3)).astype(np.float32)
    asked = []

    def pose(image, person_box, intrinsics):
        asked.append(person_box)
        return PersonPose(keypoints(0.5), landmarks, np.zeros((HEIGHT, WIDTH)), 0.9)

    result = DetectStage(DetectConfig(), pose_estimator=pose)(frame(), seed=0)
    np.testing.assert_array_equal(result.landmarks, landmarks)
    assert asked == [PERSON_BOX]
    assert (result.landmarks_source, result.keypoints_source) == ("blazepose", "given")


def test_a_person_the_pose_model_misses_still_has_given_keypoints():
    result = DetectStage(DetectConfig(), pose_estimator=lambda *_: None)(frame(), seed=0)
    assert result.ok and result.landmarks is None
    assert result.landmarks_source.startswith("none: ")


def test_model_files_are_asked_for_only_when_needed(tmp_path):
    assert GIVEN.needed_models == "none"
    assert DetectConfig().needed_models == "pose"
    assert REGISTRY.needed_models == "all"
    DetectStage(GIVEN, None)
    with pytest.raises(AssetError, match="--which pose"):
        DetectStage(DetectConfig(), tmp_path)
    with pytest.raises(AssetError, match="--which all"):
        DetectStage(REGISTRY, tmp_path)


# ------------------------------------------------------------------------------- registry


def test_detected_person_and_object_fill_the_artifact():
    result = registry_stage([PERSON, CHAIR])(frame(), seed=0)
    assert (result.person_score, result.object_score, result.object_label) == (0.8, 0.5, "chair")
    assert [item.verdict for item in result.candidates] == ["chosen", "chosen"]
    assert result.person_mask_source == result.keypoints_source == "blazepose"
    assert result.object_mask_source == "stand_in"
    assert not (result.person_mask & result.object_mask).any()


@pytest.mark.parametrize(
    ("boxes", "status"),
    [
        ([], "no_person_detected"),
        ([CHAIR, box("person", 0.1, *PERSON_BOX)], "no_person_detected"),
        ([PERSON], "no_object_detected"),
        ([PERSON, box("dog", 0.9, *CHAIR_BOX)], "no_object_detected"),
        ([PERSON, box("chair", 0.08, *CHAIR_BOX)], "no_object_detected"),
        ([box("person", 0.9, 0, 0, 20, 30), box("chair", 0.9, 140, 100, 160, 120)],)
        + ("no_object_detected",),
    ],
)
def test_what_is_not_detected_is_a_status_that_keeps_the_candidates(boxes, status):
    with pytest.raises(DetectionFailure) as caught:
        registry_stage(boxes)(frame(), seed=0)
    assert caught.value.status == status
    kept = caught.value.artifact
    assert (kept.status, kept.failed_stage, len(kept.candidates)) == (status, "detect", len(boxes))
    assert all(item.verdict for item in kept.candidates)


def test_a_category_without_a_detector_class_says_so():
    with pytest.raises(FrameFailure, match="no class for 'harp'"):
        registry_stage([PERSON, CHAIR])(frame(category="harp"), seed=0)


def test_a_pose_model_that_sees_nobody_is_a_status():
    assert status_of(registry_stage([PERSON, CHAIR], pose=None), frame()) == "person_mask_empty"


def test_an_object_lost_in_the_picture_is_found_by_the_second_look():
    # the square around the person starts at column 0, row 0 and is clipped there
    crop = box("chair", 0.4, 50, 60, 90, 110)
    result = registry_stage([PERSON], crop_boxes=[crop])(frame(), seed=0)
    np.testing.assert_array_equal(result.object_box, crop.box)
    far = box("person", 0.8, 100, 20, 140, 100)
    near = box("chair", 0.4, 30, 40, 60, 80)
    result = registry_stage([far], crop_boxes=[near])(frame(), seed=0)
    np.testing.assert_array_equal(result.object_box, [90, 40, 120, 80])


def test_a_second_person_fails_only_when_one_is_required():
    boxes = [PERSON, box("person", 0.7, 100, 10, 140, 110), CHAIR]
    assert registry_stage(boxes)(frame(), seed=0).ok
    strict = REGISTRY.model_copy(update={"require_single_person": True})
    assert status_of(registry_stage(boxes, strict), frame()) == "several_people"


def hinted(boxes, config=REGISTRY, crop_boxes=(), category="chair", **hints):
    stage = registry_stage(boxes, config, crop_boxes=crop_boxes)
    return stage(frame(category=category, hints=Hints(**hints)), seed=0)


LEFT, RIGHT = box("person", 0.6, 0, 10, 40, 110), box("person", 0.9, 90, 10, 130, 110)


def test_people_are_counted_from_the_left_whatever_their_scores():
    for number, person in ((1, LEFT), (2, RIGHT)):
        result = hinted([RIGHT, CHAIR, LEFT], person=number)
        np.testing.assert_array_equal(result.person_box, person.box)
    with pytest.raises(FrameFailure, match="person 3 from the left"):
        hinted([RIGHT, CHAIR, LEFT], person=3)


def test_a_point_chooses_the_person_however_small():
    child = box("person", 0.3, 105, 80, 120, 100)
    result = hinted([LEFT, child, CHAIR], person_point=(112, 90))
    np.testing.assert_array_equal(result.person_box, child.box)
    with pytest.raises(FrameFailure, match="person_box"):
        hinted([LEFT, CHAIR], person_point=(112, 90))


def test_a_point_chooses_the_object_whatever_its_score_or_class():
    faint = box("chair", 0.06, 120, 20, 150, 50)
    result = hinted([PERSON, CHAIR, faint], object_point=(130, 30))
    np.testing.assert_array_equal(result.object_box, faint.box)
    dog = box("dog", 0.4, 120, 20, 150, 50)
    result = hinted([PERSON, CHAIR, dog], object_point=(130, 30), category="harp")
    assert result.object_label == "dog"
    with pytest.raises(FrameFailure, match="give the object's box"):
        hinted([PERSON, CHAIR], object_point=(130, 30))


def test_a_drawn_box_needs_no_detector_class():
    result = hinted([PERSON, CHAIR], object_box=(100, 20, 150, 60), category="trashcan")
    np.testing.assert_array_equal(result.object_box, (100, 20, 150, 60))
    assert (result.object_label, result.object_score) == ("trashcan", None)
    result = hinted([CHAIR], person_box=PERSON_BOX)
    np.testing.assert_array_equal(result.person_box, PERSON_BOX)
    assert result.person_score is None


def test_equal_input_gives_equal_bytes():
    stage = GrabCut(GrabCutConfig(), 0.5)
    image, mask, pose = picture()
    outcomes = {stage(image, mask_box(mask), pose, seed=3)[0].tobytes() for _ in range(3)}
    assert len(outcomes) == 1
    results = [registry_stage([PERSON, CHAIR])(frame(), seed=0).to_bytes() for _ in range(2)]
    assert results[0] == results[1]
    assert Detection.model_validate(registry_stage([PERSON, CHAIR])(frame(), seed=0)).ok


# --------------------------------------------------------------------------------- choice


def verdicts(*boxes, category="chair", **changes):
    config = REGISTRY.model_copy(update=changes)
    weights = label_weights(category, config.labels, config.secondary_weight)
    return choose(boxes, weights, config).verdicts


def test_the_person_at_the_object_is_chosen_over_a_surer_one_elsewhere():
    alone = box("person", 0.9, 120, 10, 155, 100)
    assert verdicts(alone, PERSON, CHAIR) == ("other_person", "chosen", "chosen")


def test_people_far_smaller_than_the_largest_are_background():
    assert verdicts(PERSON, box("person", 0.9, 100, 10, 110, 30), CHAIR)[1] == "background_person"


def test_a_part_of_a_person_is_not_a_second_person():
    assert verdicts(PERSON, box("person", 0.5, 22, 12, 55, 60), CHAIR)[1] == "same_person"


def test_the_class_of_the_category_beats_a_look_alike_with_a_higher_score():
    couch = box("couch", 0.7, *CHAIR_BOX)
    assert verdicts(PERSON, couch, CHAIR) == ("chosen", "other_object", "chosen")
    assert verdicts(PERSON, couch) == ("chosen", "chosen")


def test_the_box_of_the_person_is_no_object():
    itself = box("chair", 0.9, 20, 11, 61, 110)
    assert verdicts(PERSON, itself, CHAIR) == ("chosen", "same_as_person", "chosen")


def test_an_object_out_of_reach_is_not_taken():
    far = box("chair", 0.9, 150, 10, 160, 20)
    assert verdicts(PERSON, far) == ("chosen", "too_far_from_person")


def test_the_papers_thresholds_reject_what_ours_accept():
    paper = dict(person_threshold=0.9, object_threshold=0.9)
    assert verdicts(PERSON, CHAIR, **paper) == ("below_threshold", "below_threshold")


def test_the_choice_does_not_depend_on_the_order_of_the_boxes():
    boxes = [PERSON, CHAIR, box("chair", 0.3, 60, 50, 90, 100), box("person", 0.6, 90, 5, 130, 110)]
    chosen = {
        frozenset(
            item
            for item, verdict in zip(order, verdicts(*order), strict=True)
            if verdict == "chosen"
        )
        for order in (boxes, boxes[::-1], boxes[2:] + boxes[:2])
    }
    assert len(chosen) == 1


# --------------------------------------------------------------------------------- labels


def test_every_category_of_the_tables_has_a_detector_class():
    for category in ("chair", "stool", "table", "keyboard", "backpack", "suitcase"):
        weights = label_weights(category, {}, 0.5)
        assert max(weights.values()) == 1.0 and set(weights) <= set(COCO80)
    assert label_weights("table", {}, 0.5)["dining table"] == 1.0


def test_a_detector_class_stands_for_itself_and_auto_for_all_but_people():
    assert label_weights("horse", {}, 0.5) == {"horse": 1.0}
    assert len(label_weights("auto", {}, 0.5)) == 79
    assert label_weights("person", {}, 0.5) == {}


def test_labels_in_the_config_replace_the_tables_row():
    assert label_weights("chair", {"chair": ("bed", "couch")}, 0.5) == {"bed": 1.0, "couch": 0.5}


@pytest.mark.parametrize("names", [("chaise",), ("person",), ()])
def test_a_label_no_detector_knows_is_a_config_error(names):
    with pytest.raises(ValidationError, match="chair"):
        DetectConfig(labels={"chair": names})


def test_unknown_keys_are_config_errors():
    with pytest.raises(ValidationError, match="treshold"):
        DetectConfig(treshold=0.5)


# -------------------------------------------------------------------------- boxes, GrabCut


def test_boxes_measure_what_they_say():
    assert mask_box(filled((3, 4, 10, 8))) == (3, 4, 10, 8)
    assert overlap((0, 0, 2, 2), (1, 0, 3, 2)) == pytest.approx(1 / 3)
    assert gap((0, 0, 1, 1), (4, 5, 6, 7)) == 5
    assert gap((0, 0, 4, 4), (1, 1, 2, 2)) == 0
    assert grown((1, 1, 2, 2), 1) == (0, 0, 3, 3)
    assert pixel_window((-5, 0.5, 3.2, 900), 10, 10) == (slice(0, 10), slice(0, 4))


def picture():
    """A red disc and a blue person before a grey wall, the person in front."""
    rng = np.random.default_rng(0)
    image = np.full((200, 240, 3), 128, np.uint8)
    disc = cv2.circle(np.zeros((200, 240), np.uint8), (140, 110), 50, 1, -1) > 0
    person = filled((60, 20, 110, 190), (200, 240))
    image[disc], image[person] = (200, 40, 40), (40, 60, 200)
    image = np.clip(image + rng.normal(0, 6, image.shape), 0, 255).astype(np.uint8)
    points = np.zeros((21, 3), np.float32)
    for name, at in (("shoulder", (70, 100, 50)), ("hip", (72, 98, 110)), ("ankle", (74, 96, 185))):
        points[KEYPOINT[f"right_{name}"]] = at[0], at[2], 1
        points[KEYPOINT[f"left_{name}"]] = at[1], at[2], 1
    pose = PersonPose(points, np.zeros((21, 3), np.float32), person.astype(np.float32), 1.0)
    return image, disc & ~person, pose


def test_grabcut_finds_a_coloured_object_beside_a_person():
    image, truth, pose = picture()
    mask, source = GrabCut(GrabCutConfig(), 0.5)(image, mask_box(truth), pose, seed=0)
    assert source == "grabcut"
    assert (mask & truth).sum() / (mask | truth).sum() > 0.95


def test_grabcut_on_a_plain_wall_falls_back_to_the_box_without_the_person():
    _, _, pose = picture()
    image = np.full((200, 240, 3), 128, np.uint8)
    mask, source = GrabCut(GrabCutConfig(minimum_fill=0.9), 0.5)(
        image, (100, 60, 190, 160), pose, seed=0
    )
    assert source in ("box_minus_person", "box")
    assert mask.any() and not mask[:, 200:].any()


def test_a_bag_that_the_person_mask_swallowed_is_found_by_its_colour():
    image, _, pose = picture()
    worn = np.zeros(image.shape[:2], bool)
    worn[60:100, 72:98] = True
    image[worn] = 200, 200, 30
    mask, source = GrabCut(GrabCutConfig(), 0.5)(image, (70, 56, 100, 104), pose, seed=0)
    assert source == "grabcut_ignoring_person"
    assert (mask & worn).sum() / (mask | worn).sum() > 0.9


def test_a_bag_of_the_persons_colour_keeps_its_box():
    image, _, pose = picture()
    worn = (70.0, 60.0, 100.0, 100.0)
    mask, source = GrabCut(GrabCutConfig(minimum_fill=1.0), 0.5)(image, worn, pose, seed=0)
    assert source == "box"
    assert mask_box(mask) == worn


@pytest.mark.parametrize("corner", [(-30, -30, 5, 5), (235, 195, 260, 230), (10, 10, 10.4, 10.4)])
def test_grabcut_survives_boxes_at_the_edge(corner):
    image, _, pose = picture()
    mask, _ = GrabCut(GrabCutConfig(), 0.5)(image, corner, pose, seed=0)
    assert mask.shape == image.shape[:2]


def test_the_skeleton_covers_only_seen_limbs():
    _, _, pose = picture()
    drawn = draw_skeleton((200, 240), pose.keypoints, 0.5, 0.03)
    assert drawn[80, 85] and not drawn[30, 85]
    hidden = pose.keypoints * np.array([1, 1, 0], np.float32)
    assert not draw_skeleton((200, 240), hidden, 0.5, 0.03).any()


# --------------------------------------------------------------------------------- counts


def failed(stage, an_image):
    try:
        return stage(an_image, seed=0)
    except DetectionFailure as failure:
        return failure.artifact


def test_failures_are_counted_per_category_at_the_papers_thresholds_and_ours():
    image = frame()
    wrong_place = box("chair", 0.95, 100, 10, 150, 40)
    pairs = [
        (image, failed(registry_stage(boxes), image))
        for boxes in (
            [PERSON, CHAIR],
            [box("person", 0.95, *PERSON_BOX), box("chair", 0.92, *CHAIR_BOX)],
            [PERSON],
            [PERSON, wrong_place],
        )
    ]
    pairs.append((image, DetectStage(GIVEN)(image, seed=0)))
    table = detection_counts(pairs, REGISTRY).set_index(["category", "threshold"])
    assert table.loc[("chair", "ours"), "n"] == 4
    assert table.loc[("chair", "0.9"), ["person", "object", "correct_object"]].tolist() == [1, 2, 1]
    assert table.loc[("chair", "0.6"), ["person", "object", "correct_object"]].tolist() == [4, 2, 1]
    assert table.loc[("chair", "ours"), ["person", "correct_object"]].tolist() == [4, 2]
    assert table.loc[("all", "ours"), "object_failure_rate"] == pytest.approx(0.5)
    statuses = status_counts(pairs).set_index("status")["n"]
    assert statuses["no_object_detected"] == 1 and statuses["ok"] == 4


def test_without_a_reference_mask_any_object_counts():
    image = frame(given_object_mask=None)
    pairs = [(image, failed(registry_stage([PERSON, CHAIR]), image))]
    table = detection_counts(pairs, REGISTRY).set_index(["category", "threshold"])
    assert np.isnan(float(table["correct_object"].astype(float).iloc[0]))
    assert table.loc[("chair", "ours"), "object_failure_rate"] == 0
    assert table.loc[("chair", "0.6"), "object_failure_rate"] == 1


def test_nothing_detected_at_all_gives_an_empty_table():
    assert detection_counts([(frame(), DetectStage(GIVEN)(frame(), seed=0))], REGISTRY).empty
