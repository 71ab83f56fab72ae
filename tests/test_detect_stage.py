"""The detect stage without model files: given data, the rule of choice, failures, GrabCut."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from hoi.artifacts import Detection, Frame, Hints
from hoi.body.keypoints import KEYPOINT
from hoi.detect import DetectConfig
from hoi.detect.backends import DetectedBox, PersonPose
from hoi.detect.boxes import gap, grown, mask_box, overlap, overlaps, pixel_window
from hoi.detect.config import (
    EvidenceConfig,
    GrabCutConfig,
    ResegmentConfig,
    TouchConfig,
)
from hoi.detect.counts import detection_counts, status_counts
from hoi.detect.evidence import Look, propose
from hoi.detect.finding import PairFinder
from hoi.detect.grabcut import GrabCut, draw_skeleton
from hoi.detect.labels import KNOWN, label_weights
from hoi.detect.resegment import segment_again, solid_box
from hoi.detect.stage import DetectionFailure, DetectStage
from hoi.detect.strong.instances import whole_picture_only
from hoi.detect.touching import between_hands, distance_m, expectation, held, touch_points
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


def keypoints(confidence=0.9, within=PERSON_BOX):
    rng = np.random.default_rng(0)
    points = rng.uniform(within[:2], within[2:], (21, 2))
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
    """The stage with stand-in back ends; looks around the person answer `crop_boxes`."""
    whole = iter([list(boxes)])

    def person(box):
        flat = np.zeros((21, 3), np.float32)
        return PersonPose(keypoints(within=box), flat, filled(box).astype(np.float32), 0.9)

    return DetectStage(
        config,
        box_detectors={"stand_in": lambda image: next(whole, list(crop_boxes))},
        pose_estimator=lambda image, box, intrinsics: person(box) if pose == "default" else pose,
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
    assert all(item.reason for item in result.candidates)
    assert [item.source for item in result.candidates] == ["stand_in, whole picture"] * 2
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
    with pytest.raises(FrameFailure, match="no class for 'harp'; give a box"):
        registry_stage([PERSON, CHAIR])(frame(category="harp"), seed=0)


def test_a_pose_model_that_sees_nobody_is_a_status():
    assert status_of(registry_stage([PERSON, CHAIR], pose=None), frame()) == "person_mask_empty"


def test_an_object_lost_in_the_picture_is_found_by_the_second_look():
    # the square around the person starts at column 0, row 0 and is clipped there
    crop = box("chair", 0.4, 50, 60, 90, 100)
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
    toy = box("chair", 0.5, 116, 88, 130, 100)
    result = hinted([LEFT, child, toy], person_point=(112, 90))
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


def verdicts(*boxes, category="chair", pose=None, **changes):
    """The verdict on each box, all seen in one look at the whole picture."""
    config = REGISTRY.model_copy(update=changes)
    weights = label_weights(category, config.labels, config.secondary_weight)
    config = whole_picture_only(config)  # no looks but one
    finder = PairFinder(config, {"eye": lambda image: list(boxes)}, pose)
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    _, choice = finder(image, np.eye(3), category, weights)
    said = {(item.label, item.box): item.verdict for item in choice.candidates}
    return tuple(said.get((item.label, item.box), "merged") for item in boxes)


def test_the_person_at_the_object_is_chosen_over_a_surer_one_elsewhere():
    alone = box("person", 0.9, 120, 10, 155, 100)
    assert verdicts(alone, PERSON, CHAIR) == ("other_person", "chosen", "chosen")


def test_people_far_smaller_than_the_largest_are_background():
    assert verdicts(PERSON, box("person", 0.9, 100, 10, 110, 30), CHAIR)[1] == "background_person"


def test_a_part_of_a_person_is_not_a_second_person():
    assert verdicts(PERSON, box("person", 0.5, 22, 12, 55, 60), CHAIR)[1] == "same_person"


def test_a_faint_large_box_around_a_person_makes_nobody_background():
    faint = box("person", 0.3, 0, 0, 155, 118)
    assert verdicts(faint, box("person", 0.6, 22, 12, 55, 60), CHAIR)[:2] == (
        "same_person",
        "chosen",
    )


def test_the_class_of_the_category_beats_a_look_alike_with_a_higher_score():
    couch = box("couch", 0.7, 55, 30, 100, 62)
    assert verdicts(PERSON, couch, CHAIR) == ("chosen", "other_object", "chosen")
    assert verdicts(PERSON, couch) == ("chosen", "chosen")


def test_the_box_of_the_person_is_no_object():
    itself = box("potted plant", 0.6, 20, 11, 61, 110)
    assert verdicts(PERSON, itself, CHAIR) == ("chosen", "same_as_person", "chosen")


def test_an_armchair_may_fill_the_box_of_who_sits_in_it():
    around = box("chair", 0.8, 20, 11, 61, 110)
    assert verdicts(PERSON, around) == ("chosen", "chosen")
    assert verdicts(PERSON, around, CHAIR) == ("chosen", "other_object", "chosen")


def test_an_object_out_of_reach_is_not_taken():
    far = box("chair", 0.9, 150, 10, 160, 20)
    assert verdicts(PERSON, far) == ("chosen", "too_far_from_person")


def test_the_papers_thresholds_reject_what_ours_accept():
    assert verdicts(PERSON, CHAIR, person_threshold=0.9) == ("below_threshold", "no_person")
    assert verdicts(PERSON, CHAIR, object_threshold=0.9) == ("chosen", "below_threshold")


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


# ----------------------------------------------------------------------------- segment again


def seeing(thing, reach, source="segmenter"):
    """A segmenter that sees `thing` up to `reach` pixels around the box it is asked with."""

    def segment(image, box, pose, seed):
        segment.asked.append(box)
        return thing & filled(grown(box, reach)), source

    segment.asked = []
    return segment


def again(segment, box, **settings):
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    return segment_again(segment, image, box, None, 0, ResegmentConfig(**settings))


def test_a_box_of_half_the_thing_grows_to_all_of_it():
    thing = filled((40, 20, 100, 100))
    segment = seeing(thing, reach=15)
    mask, source, box = again(segment, (40, 20, 100, 70))
    assert box == (40, 20, 100, 100) and source == "segmenter"
    np.testing.assert_array_equal(mask, thing)
    assert len(segment.asked) == 3
    # once is once
    assert again(seeing(thing, 15), (40, 20, 100, 70), passes=1)[2] == (40, 20, 100, 85)


def test_a_mask_that_missed_a_part_keeps_the_detectors_box():
    top = seeing(filled((40, 20, 100, 45)), reach=15)  # of a table whose legs are too thin
    mask, _, box = again(top, (40, 20, 100, 100))
    assert box == (40, 20, 100, 100) and len(top.asked) == 1
    np.testing.assert_array_equal(mask, filled((40, 20, 100, 45)))
    assert again(top, (40, 20, 100, 100), least_area=0.3)[2] == (40, 20, 100, 45)


def test_a_box_that_fits_is_asked_once():
    segment = seeing(filled((40, 20, 100, 100)), reach=15)
    assert again(segment, (39, 20, 101, 101))[2] == (40, 20, 100, 100)
    assert len(segment.asked) == 1


def test_masks_by_colour_keep_the_detectors_box():
    segment = seeing(filled((40, 20, 60, 40)), reach=0, source="grabcut")
    assert again(segment, (30, 10, 100, 100))[2] == (30, 10, 100, 100)
    assert len(segment.asked) == 1


def test_specks_do_not_stretch_the_box():
    mask = filled((40, 20, 100, 100))
    mask[5, 150:155] = True
    assert solid_box(mask, 0.02) == (40, 20, 100, 100)
    dust = np.zeros((HEIGHT, WIDTH), bool)
    dust[::10, ::10] = True
    assert solid_box(dust, 0.02) == mask_box(dust)


# ------------------------------------------------------------------------ evidence, contact


def standing(hand=(90.0, 60.0)):
    """An upright person of 100 px and 1.7 m whose left hand reaches to `hand`."""
    at = {
        "nose": (40, 15), "shoulder": (40, 28), "hip": (40, 60), "knee": (40, 84),
        "ankle": (40, 106), "heel": (40, 109), "toe": (44, 109), "eye": (40, 13), "ear": (40, 14),
        "elbow": (40, 45), "wrist": (40, 58),
    }  # fmt: skip
    points = np.zeros((21, 3), np.float32)
    for name, index in KEYPOINT.items():
        points[index] = *at[name.partition("_")[2] or name], 0.9
    points[KEYPOINT["left_elbow"], :2] = (40 + hand[0]) / 2, (45 + hand[1]) / 2
    points[KEYPOINT["left_wrist"], :2] = hand
    flat = (points[:, :2] - points[KEYPOINT["left_hip"], :2]) * 0.017
    landmarks = np.column_stack([flat, np.zeros(21)]).astype(np.float32)
    return PersonPose(points, landmarks, np.zeros((HEIGHT, WIDTH)), 0.9)


def test_the_thing_at_the_hand_is_chosen_over_a_surer_one_beside_the_person():
    held = box("bottle", 0.3, 105, 50, 112, 66)
    beside = box("bottle", 0.5, 62, 95, 69, 111)
    pose = standing(hand=(100.0, 58.0))
    chosen = verdicts(PERSON, beside, held, category="bottle", pose=lambda *_: pose)
    assert chosen == ("chosen", "other_object", "chosen")
    # without the pose, score and the gap between the boxes decide
    assert verdicts(PERSON, beside, held, category="bottle")[1] == "chosen"


def test_a_keyboard_is_where_both_hands_are():
    pose = standing(hand=(66.0, 58.0))  # the right hand hangs at 40, 58
    at_one = box("book", 0.9, 64, 48, 84, 66)
    at_both = box("keyboard", 0.3, 38, 56, 82, 66)
    chosen = verdicts(PERSON, at_one, at_both, category="keyboard", pose=lambda *_: pose)
    assert chosen == ("chosen", "other_object", "chosen")
    touch = touch_points(pose, PERSON.box, TouchConfig())
    farther = distance_m(at_one.box, touch, ("both_hands",))[0]
    assert distance_m(at_one.box, touch, ("hands",))[0] == 0 < farther
    assert distance_m(at_both.box, touch, ("both_hands",)) == (0, "both_hands")


def test_a_thing_of_the_wrong_size_is_not_meant():
    pose = standing(hand=(70.0, 70.0))
    room_sized, cup_sized = box("cup", 0.5, 60, 20, 120, 90), box("cup", 0.3, 68, 66, 75, 74)
    chosen = verdicts(PERSON, room_sized, cup_sized, category="cup", pose=lambda *_: pose)
    assert chosen == ("chosen", "below_threshold", "chosen")


def test_what_the_person_uses_decides_between_places_as_near():
    boxes = (box("person", 0.9, 60, 20, 90, 100), box("chair", 0.5, 30, 60, 58, 100),
             box("chair", 0.4, 92, 60, 118, 100))  # fmt: skip
    asked = []

    def chosen(used, **changes):
        def in_use(image, person, found, extent, held):
            asked.append((person, extent))
            return filled(used).astype(np.float32) * 0.9

        config = REGISTRY.model_copy(update=changes)
        finder = PairFinder(
            config, {"eye": lambda image: list(boxes)}, lambda *_: standing(), in_use
        )
        image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        _, choice = finder(image, np.eye(3), "chair", {"chair": 1.0})
        return choice.object.box, [c.reason for c in choice.candidates if c.label == "chair"]

    left, right = boxes[1].box, boxes[2].box
    assert chosen((30, 60, 58, 100))[0] == left
    found, reasons = chosen((92, 60, 118, 100), unused_weight=0.1)
    assert found == right and any("100% lies there" in reason for reason in reasons)
    person, extent = asked[-1]
    known = expectation("chair")
    assert person == boxes[0].box
    assert known.shortest_m < extent * 0.017 < known.longest_m  # 100 pixels stand for 1.7 m
    assert chosen((0, 0, 0, 0), unused_weight=0.1)[0] == left  # it sees nothing: no advice
    assert chosen((92, 60, 118, 100), unused_weight=1.0)[0] == left


def test_overlaps_of_many_boxes_are_those_of_pairs():
    rng = np.random.default_rng(0)
    first, second = (np.sort(rng.uniform(0, 9, (n, 2, 2)), axis=1).reshape(n, 4) for n in (5, 7))
    first[0] = 0  # an empty box
    pairs = [[overlap(one, other) for other in second] for one in first]
    np.testing.assert_allclose(overlaps(first, second), pairs)
    assert overlaps(first[:1], first[:1]) == 0


def test_detectors_look_again_at_the_hands_for_small_things():
    person = box("person", 0.9, 60, 20, 90, 100)  # 80 pixels tall
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    image = np.stack([columns, rows, rows], 2).astype(np.uint8)  # every pixel tells where it is

    def looks(category, pose):
        seen = []

        def eye(part):
            seen.append((*(part[..., :2].reshape(-1, 2).mean(0) + 0.5), len(part)))
            return [person] if len(seen) == 1 else []

        PairFinder(REGISTRY, {"eye": eye}, pose and (lambda *_: pose))(
            image, np.eye(3), category, {category: 1.0}
        )
        return np.array(seen[1:])

    pose, around = standing(), [75, 60, 120]  # the picture's whole height
    expected = [around, *((*between_hands(pose), share * 80) for share in (0.45, 0.7))]
    for small in ("keyboard", "cup"):
        np.testing.assert_allclose(looks(small, pose), expected, atol=1.5)
    np.testing.assert_allclose(looks("chair", pose)[0], around, atol=1.5)
    for posed, thing in ((pose, "chair"), (None, "chair"), (None, "keyboard")):
        assert len(looks(thing, posed)) == 2  # two sizes around the person
    with pytest.raises(ValidationError, match="hands"):
        DetectConfig(looks={"hands": (0.45, 0)})


def test_what_is_small_and_touched_by_hand_alone_is_held():
    assert held("keyboard", 0.6) and held("cup", 0.6)
    assert not held("backpack", 0.6)  # on the back, too
    assert not held("umbrella", 0.6) and not held("no such thing", 0.6)


def test_the_stage_asks_its_own_network_what_the_person_uses():
    """The shipped weights and the whole wiring; detectors and pose are stood in for."""
    boxes = [PERSON, CHAIR, box("chair", 0.4, 100, 60, 140, 110)]
    image = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
    image[60:110, 62:98] = (200, 120, 40)
    pose = replace(standing(), probability=filled(PERSON_BOX).astype(np.float32))

    def reasons(**changes):
        stage = DetectStage(
            REGISTRY.model_copy(update=changes),
            box_detectors={"eye": lambda image: boxes},
            pose_estimator=lambda *_: pose,
        )
        found = stage(frame(image=image), seed=0)
        return [c.reason for c in found.candidates if c.label == "chair"]

    assert all("x use" in reason for reason in reasons())
    assert not any("x use" in reason for reason in reasons(unused_weight=1.0))
    assert not any("x use" in reason for reason in reasons(object_masks="grabcut"))


def test_looks_that_agree_outweigh_one_that_is_surer():
    weights, settings = {"chair": 1.0}, EvidenceConfig()
    agreed = [Look(f"look {i}", (box("chair", 0.3, 50 + i, 50, 90, 100),)) for i in range(3)]
    alone = Look("look 3", (box("chair", 0.5, 0, 0, 30, 30),))
    best, other = propose([*agreed, alone], weights, settings, (HEIGHT, WIDTH))
    assert best.looks == 3 and best.evidence == pytest.approx(1 - 0.7**3)
    assert other.evidence == pytest.approx(0.5)
    assert best.seen.box[0] == pytest.approx(51) and best.seen.score == 0.3


def test_one_look_votes_once_for_one_place():
    twice = Look("eye", (box("chair", 0.3, 50, 50, 90, 100), box("chair", 0.2, 52, 50, 90, 100)))
    (place,) = propose([twice], {"chair": 1.0}, EvidenceConfig(), (HEIGHT, WIDTH))
    assert place.evidence == pytest.approx(0.3)


def test_a_sure_thing_of_another_class_is_hardly_evidence_and_a_person_none():
    seen = (box("dog", 0.95, 0, 0, 30, 30), box("dog", 0.5, 50, 50, 90, 100), PERSON)
    places = propose([Look("eye", seen)], {"chair": 1.0}, EvidenceConfig(faintest=1e-6), (120, 160))
    assert [place.seen.label for place in places] == ["dog", "dog"]
    assert all(place.unnamed for place in places)
    assert places[0].seen.score == 0.5 and places[0].evidence > 4 * places[1].evidence


def test_a_box_cut_off_by_the_look_counts_less_unless_the_picture_ends_there():
    window, settings = (40.0, 0.0, 120.0, 80.0), EvidenceConfig()
    inside, cut = box("chair", 0.5, 60, 20, 100, 60), box("chair", 0.5, 41, 20, 60, 60)
    at_the_edge = box("chair", 0.5, 60, 0, 80, 15)
    look = Look("eye", (inside, cut, at_the_edge), window)
    places = propose([look], {"chair": 1.0}, settings, (120, 160))
    assert [round(place.evidence, 3) for place in places] == [0.5, 0.5, 0.15]


# --------------------------------------------------------------------------------- labels


def test_every_category_of_the_tables_has_a_detector_class():
    for category in ("chair", "stool", "table", "keyboard", "backpack", "suitcase"):
        weights = label_weights(category, {}, 0.5)
        assert max(weights.values()) == 1.0 and set(weights) <= set(KNOWN)
    assert label_weights("table", {}, 0.5)["dining table"] == 1.0


def test_a_detector_class_stands_for_itself_and_auto_for_all_but_people():
    assert label_weights("horse", {}, 0.5) == {"horse": 1.0}
    everything = label_weights("auto", {}, 0.5)
    assert {"horse", "desk"} <= set(everything) and not {"person", "footwear"} & set(everything)
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
