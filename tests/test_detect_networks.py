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
_PLACES = (ROOT / "resources" / "models", ROOT / ".cache" / "models")
MODELS = Path(
    os.environ.get("HOI_MODELS")
    or next((folder for folder in _PLACES if (folder / "nanodet.onnx").is_file()), _PLACES[0])
)
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

    intrinsics = np.array([[5000.0, 0, 30], [0, 5000, 40], [0, 0, 1]])
    homography = Crop(np.array([30.0, 40.0]), 128.0, np.pi / 2).image_from_crop(intrinsics)

    def mapped(x, y):
        point = homography @ [x, y, 1]
        return point[:2] / point[2]

    np.testing.assert_allclose(mapped(128, 128), [30, 40])
    # a quarter turn: the crop's up is the picture's right
    np.testing.assert_allclose(mapped(128, 0), [30 + 64, 40], atol=1e-9)


class ScriptedPose:
    """BlazePose whose landmark model answers with people in given boxes, one a pass."""

    def __new__(cls, *answers, **settings):
        from hoi.detect.blazepose import BlazePose, Crop, _Reading

        class Pose(BlazePose):
            def __init__(self):
                self.config = DetectConfig().blazepose.model_copy(update=settings)
                self.left = list(answers)

            def _first_crops(self, image, box):
                return [Crop(np.array([50.0, 50.0]), 100.0, 0.0)]

            def _read(self, image, crop, intrinsics):
                (x0, y0, x1, y1), score = self.left.pop(0)
                points = np.column_stack([np.linspace(x0, x1, 39), np.linspace(y0, y1, 39)])
                points[33:35] = (x0 + x1) / 2, (y0 + y1) / 2  # middle of the hips, and above them
                points[34, 1] -= (y1 - y0) / 2
                flat = np.zeros((256, 256))
                return _Reading(np.eye(3), points, np.full(39, 0.9), np.zeros((39, 3)), flat, score)

        return Pose()


@pytest.mark.parametrize(
    ("second", "score", "kept"),
    [
        ((22, 12, 60, 96), 0.9, True),  # the same person, better centred
        ((70, 10, 130, 98), 0.99, False),  # a neighbour, though the model is surer of them
        ((22, 12, 60, 96), 0.2, False),  # nobody
    ],
)
def test_a_second_pass_counts_only_while_it_stays_with_the_person(second, score, kept):
    first, box = (20, 10, 60, 98), (18.0, 8.0, 62.0, 100.0)
    pose = ScriptedPose((first, 0.8), (second, score), passes=2)
    found = pose(np.zeros((120, 160, 3), np.uint8), box, np.diag([100.0, 100.0, 1.0]))
    assert not pose.left
    left, top = second[:2] if kept else first[:2]
    np.testing.assert_allclose(found.keypoints[:, :2].min(0), [left, top], atol=1)
    assert found.score == (score if kept else 0.8)


@pytest.mark.parametrize(
    ("box", "first_score", "wide"),
    [
        ((18.0, 8.0, 62.0, 100.0), 0.9, 0),  # seen whole
        ((18.0, 8.0, 62.0, 120.0), 0.9, 2),  # cut off at the knees by the picture's lower border
        ((18.0, 8.0, 62.0, 100.0), 0.2, 2),  # whole, but seen by no other crop
    ],
)
def test_wide_crops_are_for_who_is_cut_off_or_not_seen(box, first_score, wide):
    first, neighbour, better = (20, 10, 60, 98), (70, 10, 130, 98), (22, 12, 60, 96)
    answers = [(first, first_score), (neighbour, 0.99), (better, 0.95)][: 1 + wide]
    pose = ScriptedPose(*answers, passes=1, wide_shifts=(0.0, 0.3))
    found = pose(np.zeros((120, 160, 3), np.uint8), box, np.diag([100.0, 100.0, 1.0]))
    assert not pose.left
    # never the neighbour, though the model is surest of that one
    left, top = better[:2] if wide else first[:2]
    np.testing.assert_allclose(found.keypoints[:, :2].min(0), [left, top], atol=1)


def test_a_crop_at_the_side_shows_what_a_turned_camera_sees():
    from hoi.detect.blazepose import Crop

    intrinsics = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    crop = Crop(np.array([700.0, 300.0]), 200.0, 0.3)
    ray = np.linalg.inv(intrinsics) @ [700, 300, 1]
    ball = 4 * ray / np.linalg.norm(ray)
    around = np.random.default_rng(0).normal(size=(50, 3))
    around = ball + 0.5 * around / np.linalg.norm(around, axis=1, keepdims=True)
    seen = (around @ intrinsics.T) @ np.linalg.inv(crop.image_from_crop(intrinsics)).T
    turned = around @ crop.camera_from_crop(intrinsics)
    # the same picture up to the turned camera's own intrinsics: centred, square pixels
    zoom = (seen[:, :2] / seen[:, 2:] - 128) / (turned[:, :2] / turned[:, 2:])
    np.testing.assert_allclose(zoom, zoom.mean(), rtol=1e-6)


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

    @pytest.mark.parametrize("rows", [150, 180, 260])
    def test_who_is_cut_off_moves_like_the_whole_person(self, rows):
        from hoi.detect.blazepose import BlazePose

        whole = photo("coco_000000000785_skis.jpg", "skis")
        estimator = BlazePose(DetectConfig().blazepose, MODELS)
        box = (280.0, 44.0, 499.0, 387.0)
        seen = estimator(whole.image, box, whole.intrinsics)
        part = estimator(whole.image[:rows], (*box[:3], float(rows)), whole.intrinsics)
        elbows = [KEYPOINT["left_elbow"], KEYPOINT["right_elbow"]]
        away = np.linalg.norm((part.keypoints - seen.keypoints)[elbows, :2], axis=1)
        assert away.max() < 20  # 36 to 43 pixels from the crop around the visible part alone

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
        assert result.object_mask_source.startswith("segmenter")

    def test_a_category_without_a_class_is_declined(self, stage):
        with pytest.raises(FrameFailure) as caught:
            stage(photo("skimage_camera.png", "tripod"), seed=0)
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


# ---------------------------------------------------------- against a body whose pose is known

INTRINSICS = np.array([[488.0, 0, 512], [0, 488, 384], [0, 0, 1]])  # BEHAVE's, halved


def rendered_body(sideways: float, yaw: float):
    """A shaded picture of the default body, its box and its true keypoints (21, 3) in metres."""
    import torch

    from hoi.body import DEFAULT_BODY, BodyModel
    from hoi.body.skeleton import JOINT
    from hoi.rendering import depth_map

    model = BodyModel.load(DEFAULT_BODY)
    turned = cv2.Rodrigues(np.diag([1.0, -1, -1]) @ cv2.Rodrigues(np.array([0, yaw, 0.0]))[0])[0]
    pose = np.zeros((23, 3))
    pose[JOINT["left_shoulder"] - 1] = 0, -0.5, -0.7
    pose[JOINT["right_shoulder"] - 1] = 0, 0, 1.1
    pose[JOINT["left_hip"] - 1] = -0.7, 0, 0.1
    pose[JOINT["left_knee"] - 1] = 0.7, 0, 0
    inputs = [
        torch.tensor(np.reshape(value, (1, -1)), dtype=torch.float32)
        for value in (turned, pose, np.zeros(model.num_betas), [sideways, 0, 2.4])
    ]
    vertices = model.forward(*inputs).vertices[0].numpy()
    keypoints = model.keypoints(*inputs)[0].numpy()
    depth = depth_map(vertices, model.faces, INTRINSICS, 768, 1024)
    seen = np.isfinite(depth)
    rows, columns = np.indices(depth.shape)
    rays = np.stack([(columns - 511.5) / 488, (rows - 383.5) / 488, np.ones(depth.shape)], -1)
    points = rays * np.where(seen, depth, 5)[..., None]
    normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    light = np.clip(normals @ np.array([0.4, 0.7, 0.6]), -1, 1)
    image = np.full((*depth.shape, 3), 170.0)
    image[seen] = (80 + 110 * np.abs(light[seen]))[:, None] * np.array([1.0, 0.8, 0.7])
    columns, rows = np.flatnonzero(seen.any(0)), np.flatnonzero(seen.any(1))
    box = (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1)
    return image.clip(0, 255).astype(np.uint8), tuple(map(float, box)), keypoints


@pytest.mark.models
@pytest.mark.skipif(bool(_REASON), reason=_REASON)
@pytest.mark.parametrize("sideways", [-1.4, 0.0, 1.4])
@pytest.mark.parametrize("yaw", [0.0, 0.9])
def test_landmarks_agree_with_the_body_that_was_rendered(stage, sideways, yaw):
    image, box, truth = rendered_body(sideways, yaw)
    pose = stage._pose(image, box, INTRINSICS)
    assert pose is not None
    truth_px = truth @ INTRINSICS.T
    truth_px = truth_px[:, :2] / truth_px[:, 2:]
    size = longer_side(box)
    assert np.median(np.linalg.norm(pose.keypoints[:, :2] - truth_px, axis=1)) < 0.04 * size
    hips = truth[[KEYPOINT["left_hip"], KEYPOINT["right_hip"]]].mean(0)
    assert np.linalg.norm(pose.landmarks - (truth - hips), axis=1).mean() < 0.2

    def heading(points):  # of the hips and shoulders, seen from above
        across = sum(
            points[KEYPOINT[f"left_{part}"]] - points[KEYPOINT[f"right_{part}"]]
            for part in ("hip", "shoulder")
        )
        return np.degrees(np.arctan2(across[2], across[0]))

    # 15 to 30 degrees at the sides if the crop were just cut out of the picture
    error = (heading(pose.landmarks) - heading(truth) + 180) % 360 - 180
    assert abs(error) < 15


def depths(points):
    """Depth of the joints of arms, legs and trunk behind the middle of the hips, metres."""
    names = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    rows = [KEYPOINT[f"{side}_{name}"] for side in ("left", "right") for name in names]
    hips = points[[KEYPOINT["left_hip"], KEYPOINT["right_hip"]]].mean(0)
    return (points[rows] - hips)[:, 2]


def bones(points):
    """Lengths of upper arms, forearms, thighs and shins, metres."""
    pairs = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
    return np.array(
        [
            np.linalg.norm(points[KEYPOINT[f"{side}_{a}"]] - points[KEYPOINT[f"{side}_{b}"]])
            for side in ("left", "right")
            for a, b in pairs
        ]
    )


@pytest.mark.models
@pytest.mark.skipif(bool(_REASON), reason=_REASON)
@pytest.mark.parametrize("yaw", [0.9, -0.9])
def test_landmarks_have_the_depths_sign_and_the_size_of_the_body_that_was_rendered(stage, yaw):
    image, box, truth = rendered_body(0.0, yaw)
    pose = stage._pose(image, box, INTRINSICS)
    assert pose is not None
    real, guessed = depths(truth), depths(pose.landmarks)
    assert np.corrcoef(real, guessed)[0, 1] > 0.7
    far = np.abs(real) > 0.2  # of joints clearly before or behind the hips none is mirrored
    assert far.sum() >= 2 and (np.sign(real[far]) == np.sign(guessed[far])).all()
    assert 0.85 < np.median(bones(pose.landmarks) / bones(truth)) < 1.15


@pytest.mark.models
@pytest.mark.skipif(bool(_REASON), reason=_REASON)
def test_a_knee_and_a_hand_lifted_at_the_camera_are_nearer_and_understated(stage):
    """Seen from the front the model flattens depth: signs hold at knee and hand, sizes do not."""
    image, box, truth = rendered_body(0.0, 0.0)
    pose = stage._pose(image, box, INTRINSICS)
    assert pose is not None
    hips = truth[[KEYPOINT["left_hip"], KEYPOINT["right_hip"]]].mean(0)
    for name in ("left_knee", "left_wrist"):
        real, guessed = truth[KEYPOINT[name], 2] - hips[2], pose.landmarks[KEYPOINT[name], 2]
        assert real < -0.2 and real < guessed < 0
    assert 0.85 < np.median(bones(pose.landmarks) / bones(truth)) < 1.15


@pytest.mark.models
@pytest.mark.skipif(bool(_REASON), reason=_REASON)
def test_of_a_body_cut_off_by_the_picture_only_what_is_in_it_counts(stage):
    image, box, truth = rendered_body(0.0, 0.0)
    truth_px = truth @ INTRINSICS.T
    truth_px = truth_px[:, :2] / truth_px[:, 2:]
    hips = truth_px[[KEYPOINT["left_hip"], KEYPOINT["right_hip"]], 1].mean()
    end = int(hips + 20)  # the picture ends under the hips
    pose = stage._pose(image[:end], (*box[:3], float(end)), INTRINSICS)
    assert pose is not None
    inside = truth_px[:, 1] < end - 25
    error = np.linalg.norm(pose.keypoints[:, :2] - truth_px, axis=1)
    assert np.median(error[inside]) < 0.05 * longer_side(box)
    assert pose.keypoints[inside, 2].min() > 0.3
    for name in ("ankle", "heel", "toe"):
        for side in ("left", "right"):
            assert pose.keypoints[KEYPOINT[f"{side}_{name}"], 2] == 0
    assert pose.probability.shape == image[:end].shape[:2]
