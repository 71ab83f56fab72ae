"""The detectors themselves: decoding without model files, and real photos where the files are."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hoi.artifacts import Frame
from hoi.body.keypoints import KEYPOINT
from hoi.detect import DetectConfig
from hoi.detect.boxes import grown, longer_side
from hoi.detect.models import require_models
from hoi.detect.nanodet import SIDE, STRIDES, decode, letterbox, suppress
from hoi.detect.stage import DetectStage
from hoi.errors import AssetError, FrameFailure

ROOT = Path(__file__).parent.parent
MODELS = Path(os.environ.get("HOI_MODELS", ROOT / ".cache" / "models"))
PHOTOS = ROOT / "examples" / "photos"
NAMES = (
    "cc0_baby_teddy.jpg",
    "coco_000000000785_skis.jpg",
    "skimage_astronaut.png",
    "skimage_camera.png",
)


def _reason_to_skip() -> str:
    try:
        require_models(MODELS, "all")
    except AssetError as error:
        return str(error).splitlines()[0]
    missing = [name for name in NAMES if not (PHOTOS / name).is_file()]
    return f"{PHOTOS / missing[0]} is not there" if missing else ""


_REASON = _reason_to_skip()
needs_models = [pytest.mark.models, pytest.mark.skipif(bool(_REASON), reason=_REASON)]


def photo(name: str, category: str) -> Frame:
    path = PHOTOS / name
    image = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    height, width = image.shape[:2]
    focal = float(max(height, width))
    return Frame(
        frame_id=path.stem,
        dataset="photos",
        category=category,
        image=image,
        intrinsics=np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]),
    )


# -------------------------------------------------------------------------- without models


def test_letterbox_keeps_the_aspect_and_says_where_things_went():
    image = np.zeros((100, 300, 3), np.uint8)
    image[40:60, 90:150] = 255
    square, scale, offset = letterbox(image, SIDE)
    rows, columns = np.nonzero(square[..., 0] > 127)
    found = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    np.testing.assert_allclose((found - np.tile(offset, 2)) / scale, [90, 40, 150, 60], atol=1)


def test_a_certain_cell_decodes_to_its_box():
    scores = [np.zeros((1, (SIDE // stride) ** 2, 80), np.float32) for stride in STRIDES]
    logits = [np.zeros((1, (SIDE // stride) ** 2, 44), np.float32) for stride in STRIDES]
    cell = 5 * (SIDE // 16) + 7  # row 5, column 7 at stride 16
    scores[1][0, cell, 56] = 0.9
    logits[1][0, cell].reshape(4, 11)[np.arange(4), [1, 2, 3, 4]] = 100  # distances in strides
    values, boxes = decode(scores, logits)
    (found,) = suppress(values, boxes, 0.3, 0.6)
    assert found.label == "chair" and found.score == pytest.approx(0.9)
    centre = np.array([7.5, 5.5]) * 16
    np.testing.assert_allclose(found.box, [*(centre - [16, 32]), *(centre + [48, 64])], atol=1e-6)


def test_overlapping_boxes_of_one_class_merge_and_of_two_classes_stay():
    boxes = np.array([[0, 0, 10, 10], [0, 0, 10, 9], [50, 50, 60, 60]], float)
    scores = np.zeros((3, 80), np.float32)
    scores[0, 56], scores[1, 56], scores[0, 57], scores[2, 56] = 0.9, 0.8, 0.7, 0.6
    found = suppress(scores, boxes, 0.3, 0.6)
    assert [(item.label, round(item.score, 1)) for item in found] == [
        ("chair", 0.9),
        ("couch", 0.7),
        ("chair", 0.6),
    ]


def test_the_pose_detectors_anchors_are_as_many_as_its_outputs():
    from hoi.detect.blazepose import detector_anchors

    anchors = detector_anchors()
    assert anchors.shape == (2254, 2)
    assert anchors.min() > 0 and anchors.max() < 1
    np.testing.assert_allclose(anchors.mean(0), 0.5)


def test_a_crop_maps_its_centre_and_its_upright_axis():
    from hoi.detect.blazepose import Crop

    crop = Crop(np.array([30.0, 40.0]), 128.0, np.pi / 2)
    affine = crop.image_from_crop()
    np.testing.assert_allclose(affine @ [128, 128, 1], [30, 40])
    # a quarter turn: the crop's up is the picture's right
    np.testing.assert_allclose(affine @ [128, 0, 1], [30 + 64, 40], atol=1e-9)


def test_a_view_at_the_principal_point_is_the_cameras_own():
    from hoi.detect.blazepose import camera_from_view

    intrinsics = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    np.testing.assert_allclose(camera_from_view(np.array([320, 240]), intrinsics), np.eye(3))


@given(x=st.floats(-2000, 2000), y=st.floats(-2000, 2000))
def test_a_view_looks_along_its_pixels_ray_without_rolling(x, y):
    from hoi.detect.blazepose import camera_from_view

    intrinsics = np.array([[500.0, 0, 320], [0, 400, 240], [0, 0, 1]])
    rotation = camera_from_view(np.array([x, y]), intrinsics)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) > 0
    ray = rotation[:, 2]
    pixel = intrinsics @ ray / ray[2]
    np.testing.assert_allclose(pixel[:2], [x, y], atol=1e-4)
    # the smallest such turn: its axis lies in the image plane
    axis = np.array([rotation[1, 0] - rotation[0, 1]])
    np.testing.assert_allclose(axis, 0, atol=1e-9)


# ------------------------------------------------------------------------------ with models


@pytest.fixture(scope="module")
def stage():
    return DetectStage(DetectConfig(masks="registry", keypoints="registry"), MODELS)


@pytest.fixture(scope="module")
def skier(stage):
    return stage(photo("coco_000000000785_skis.jpg", "skis"), seed=0)


class TestOnPhotos:
    pytestmark = needs_models

    def test_the_skier_and_her_skis_are_found(self, skier):
        assert skier.object_label == "skis"
        x, y = (skier.object_box[:2] + skier.object_box[2:]) / 2
        assert 200 < x < 560 and 340 < y < 420

    def test_seen_keypoints_lie_in_the_persons_box(self, skier):
        seen = skier.keypoints[skier.keypoints[:, 2] > 0.5, :2]
        box = grown(skier.person_box, 0.1 * longer_side(skier.person_box))
        assert len(seen) > 15
        assert ((seen > box[:2]) & (seen < box[2:])).all()

    def test_the_person_mask_covers_the_keypoints_and_little_else(self, skier):
        body = [
            KEYPOINT[f"{side}_{part}"] for side in ("left", "right") for part in ("hip", "knee")
        ]
        columns, rows = skier.keypoints[body, :2].astype(int).T
        assert skier.person_mask[rows, columns].all()
        x0, y0, x1, y1 = skier.person_box
        assert 0.25 < skier.person_mask.sum() / ((x1 - x0) * (y1 - y0)) < 0.8

    def test_left_and_right_are_the_persons_own(self, skier):
        # She faces the camera: her left is on the picture's right.
        for name in ("shoulder", "hip", "ankle"):
            left, right = (
                skier.keypoints[KEYPOINT[f"{side}_{name}"]] for side in ("left", "right")
            )
            assert left[0] > right[0]

    def test_landmarks_are_metric_hip_centred_and_in_camera_axes(self, skier):
        landmarks = skier.landmarks
        hips = landmarks[[KEYPOINT["left_hip"], KEYPOINT["right_hip"]]]
        np.testing.assert_allclose(hips.mean(0), 0, atol=1e-5)
        at = {name: landmarks[index] for name, index in KEYPOINT.items()}
        assert at["nose"][1] < at["left_hip"][1] < at["left_heel"][1]  # y down
        assert at["left_shoulder"][0] > at["right_shoulder"][0]  # x right
        ears = (at["left_ear"] + at["right_ear"]) / 2
        assert at["nose"][2] < ears[2]  # z forward: a face looking at the camera is nearer
        shin = np.linalg.norm(at["left_knee"] - at["left_ankle"])
        assert 0.25 < shin < 0.55
        # landmarks and keypoints show the same pose
        flat = skier.keypoints[:, :2] - skier.keypoints[11:13, :2].mean(0)
        agreement = np.corrcoef(flat.ravel(), landmarks[:, :2].ravel())[0, 1]
        assert agreement > 0.95

    def test_the_mirrored_photo_mirrors_the_answer(self, stage, skier):
        original = photo("coco_000000000785_skis.jpg", "skis")
        width = original.image.shape[1]
        mirrored = original.model_copy(update={"image": original.image[:, ::-1].copy()})
        result = stage(mirrored, seed=0)
        for name in ("shoulder", "hip", "knee"):
            there = result.keypoints[KEYPOINT[f"left_{name}"]]
            here = skier.keypoints[KEYPOINT[f"right_{name}"]]
            assert abs((width - there[0]) - here[0]) < 15 and abs(there[1] - here[1]) < 15

    def test_child_and_teddy_are_told_apart(self, stage):
        result = stage(photo("cc0_baby_teddy.jpg", "teddy"), seed=0)
        assert result.object_label == "teddy bear"
        assert result.person_mask[200, 260] and result.object_mask[230, 450]
        assert result.object_mask_source == "grabcut"

    def test_a_category_without_a_class_is_declined(self, stage):
        with pytest.raises(FrameFailure) as caught:
            stage(photo("skimage_camera.png", "camera"), seed=0)
        assert caught.value.status == "no_object_detected"

    def test_a_picture_without_people_is_declined(self, stage):
        grass = np.random.default_rng(0).integers(60, 120, (240, 320, 3), np.uint8)
        empty = photo("skimage_camera.png", "chair").model_copy(update={"image": grass})
        with pytest.raises(FrameFailure) as caught:
            stage(empty, seed=0)
        assert caught.value.status == "no_person_detected"

    def test_what_lies_outside_the_picture_has_no_confidence(self, stage):
        frame = photo("skimage_astronaut.png", "helmet")
        pose = stage._pose(frame.image, (14.0, 14.0, 364.0, 507.0), frame.intrinsics)
        assert pose is not None
        for name in ("left_ankle", "right_ankle", "left_toe"):
            assert pose.keypoints[KEYPOINT[name], 2] < 0.1
        assert pose.keypoints[KEYPOINT["nose"], 2] > 0.9

    def test_one_frame_gives_the_same_bytes_again_and_in_a_fresh_stage(self, stage, skier):
        again = photo("coco_000000000785_skis.jpg", "skis")
        assert stage(again, seed=0).to_bytes() == skier.to_bytes()
        fresh = DetectStage(DetectConfig(masks="registry", keypoints="registry"), MODELS)
        assert fresh(again, seed=0).to_bytes() == skier.to_bytes()

    def test_given_masks_get_landmarks_from_a_crop_around_them(self, skier):
        stage = DetectStage(DetectConfig(), MODELS)
        given = photo("coco_000000000785_skis.jpg", "skis").model_copy(
            update={
                "given_person_mask": skier.person_mask,
                "given_object_mask": skier.object_mask,
                "given_keypoints": skier.keypoints,
            }
        )
        result = stage(given, seed=0)
        assert result.landmarks_source == "blazepose"
        assert np.abs(result.landmarks - skier.landmarks).max() < 0.15
