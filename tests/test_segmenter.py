"""The object segmenter: shipped weights, geometry of its crops, its place in the detect stage."""

import gzip
from pathlib import Path

import cv2
import numpy as np
import pytest

from hoi.body.keypoints import KEYPOINT
from hoi.detect.backends import PersonPose
from hoi.detect.boxes import mask_box
from hoi.detect.config import DetectConfig, SegmenterConfig
from hoi.detect.grabcut import GrabCut
from hoi.detect.segmenter import Segmenter, object_segmenter_of, refined
from hoi.errors import AssetError
from hoi.segmenter.crops import (
    HANDS_SHARE,
    SIDE,
    box_crop,
    crop_matrix,
    cropped,
    extent_crop,
    network_inputs,
    pasted,
    picture_crop,
    used_window,
)
from hoi.segmenter.files import halved, load_model, widened
from hoi.segmenter.pictures import load_picture
from hoi.segmenter.runtime import DEFAULT_WEIGHTS, MaskNetwork

RENDERS = Path(__file__).parent / "data" / "segmenter"


@pytest.fixture(scope="module")
def network():
    return MaskNetwork()


def overlap(first, second):
    return (first & second).sum() / max((first | second).sum(), 1)


def nobody(shape):
    empty = np.zeros((21, 3), np.float32)
    return PersonPose(empty, empty, np.zeros(shape, np.float32), 0.0)


def ball_on_grass():
    """A shaded ball on green noise, where nothing but its outline gives the object away."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:240, :320].astype(np.float32)
    noise = cv2.GaussianBlur(rng.normal(0, 1, (240, 320)).astype(np.float32), (0, 0), 2)
    image = np.stack([70 + 90 * noise, 110 + 90 * noise, 60 + 60 * noise], -1)
    mask = (x - 150) ** 2 + (y - 120) ** 2 < 55**2
    shade = 1.1 - np.hypot(x - 130, y - 95) / 110
    image[mask] = (np.array([230, 120, 40]) * shade[..., None])[mask]
    return np.clip(image, 0, 255).astype(np.uint8), mask


# ------------------------------------------------------------------------------ crops


@pytest.mark.parametrize("mirrored", [False, True])
def test_what_is_cropped_and_pasted_is_where_it_was(mirrored):
    mask = np.zeros((300, 400), np.float32)
    mask[90:200, 120:260] = 1
    box = (110, 80, 280, 210)
    matrix = crop_matrix(box, angle=0.2, mirrored=mirrored)
    back = pasted(cropped(mask, matrix), matrix, mask.shape, 0.0) > 0.5
    assert overlap(back, mask > 0.5) > 0.97
    still = crop_matrix(box)
    back = pasted(cropped(mask, still), still, mask.shape, 0.0) > 0.5
    np.testing.assert_array_equal(back, mask > 0.5)


def test_the_box_lies_in_its_crop_as_the_pixels_do():
    shape, box = (200, 300), (50, 60, 200, 120)
    inside = np.zeros(shape, np.uint8)
    inside[60:120, 50:200] = 255
    matrix = crop_matrix(box)
    difference = box_crop(box, matrix, shape) / 255.0 - cropped(inside, matrix, smooth=False) / 255
    assert np.abs(difference).mean() < 0.01


@pytest.mark.parametrize("box", [(-40, -30, 20, 15), (290, 190, 340, 260), (10, 10, 10.2, 10.1)])
def test_boxes_at_the_edge_give_a_mask_of_the_pictures_size(network, box):
    image = np.zeros((200, 300, 3), np.uint8)
    probability = network(image, box, np.zeros((200, 300)))
    assert probability.shape == (200, 300) and np.isfinite(probability).all()
    assert probability.min() >= 0 and probability.max() <= 1


def test_a_crop_around_a_person_hardly_leaves_the_picture():
    def seen(person):
        x0, y0, x1, y1 = used_window(person, (200, 300))
        np.testing.assert_allclose((x0 + x1, y0 + y1), np.add(person[:2], person[2:]))
        assert x1 - x0 == pytest.approx(y1 - y0)
        return x1 - x0

    assert seen((100, 50, 140, 150)) == pytest.approx(1.6 * 100)
    assert seen((20, 0, 200, 199)) == pytest.approx(1.6 * 199)
    assert seen((0, 0, 280, 200)) == pytest.approx(1.1 * 300)


def test_the_size_that_is_told_is_a_share_of_the_crop():
    matrix = crop_matrix((40, 20, 200, 180), margin=1.0)  # 160 pixels of the picture
    assert not extent_crop(None, matrix).any()
    assert (extent_crop(80, matrix) == round(127 / 2)).all()
    assert (extent_crop(1e6, matrix) == 127).all() and extent_crop(1e-6, matrix).min() > 0


def test_a_crop_beyond_the_picture_is_filled():
    image = np.full((50, 50, 3), 200, np.uint8)
    away = picture_crop(image, crop_matrix((500, 500, 540, 540)))
    assert away.shape == (SIDE, SIDE, 3) and (away == away[0, 0]).all()
    picture, prompt = network_inputs(away[None], *np.zeros((2, 1, SIDE, SIDE), np.uint8))
    assert np.abs(picture).max() < 0.02 and not prompt.any()


# -------------------------------------------------------------------- the shipped weights


def test_the_weights_are_small_and_a_valid_onnx_model():
    import onnx

    assert DEFAULT_WEIGHTS.stat().st_size <= 9e6
    stored = onnx.load_from_string(gzip.decompress(DEFAULT_WEIGHTS.read_bytes()))
    onnx.checker.check_model(stored)
    wide = onnx.load_from_string(load_model(DEFAULT_WEIGHTS))
    assert not any(node.op_type == "Cast" and node.input[0].endswith(".half")
                   for node in wide.graph.node)  # fmt: skip
    again = halved(wide)
    assert widened(again) == widened(DEFAULT_WEIGHTS.read_bytes())


def test_a_damaged_or_missing_file_is_named(tmp_path):
    with pytest.raises(AssetError, match="nowhere"):
        MaskNetwork(tmp_path / "nowhere.onnx.gz")
    broken = tmp_path / "broken.onnx.gz"
    broken.write_bytes(DEFAULT_WEIGHTS.read_bytes()[:5000])
    with pytest.raises(AssetError, match="broken"):
        MaskNetwork(broken)


def test_an_object_that_only_its_shape_gives_away_is_found(network):
    image, mask = ball_on_grass()
    found = network(image, (92, 62, 208, 178), np.zeros(mask.shape)) > 0.5
    assert overlap(found, mask) > 0.85


def test_equal_pictures_give_equal_bytes(network):
    image, mask = ball_on_grass()
    empty = np.zeros(mask.shape)
    outcomes = {network(image, (92, 62, 208, 178), empty).tobytes() for _ in range(3)}
    assert len(outcomes) == 1


# ------------------------------------------------------------------------- the back end


def test_the_configuration_names_the_segmenter():
    assert isinstance(object_segmenter_of(DetectConfig()), Segmenter)
    assert isinstance(object_segmenter_of(DetectConfig(object_masks="grabcut")), GrabCut)


def test_grabcut_settles_only_the_unsure_pixels():
    image, mask = ball_on_grass()
    unsure = np.where(mask, 0.6, 0.1).astype(np.float32)
    unsure[cv2.erode(mask.astype(np.uint8), np.ones((25, 25))) > 0] = 0.95
    ring = cv2.dilate(mask.astype(np.uint8), np.ones((15, 15))) > 0
    unsure[ring & ~mask] = 0.55  # too large: the colours must cut it back
    settled = refined(image, (92, 62, 208, 178), unsure, SegmenterConfig(), seed=0)
    assert not settled[unsure < 0.2].any() and settled[unsure > 0.8].all()
    assert overlap(settled, mask) > overlap(unsure > 0.5, mask) + 0.1
    again = refined(image, (92, 62, 208, 178), unsure, SegmenterConfig(), seed=0)
    np.testing.assert_array_equal(settled, again)


def test_where_the_network_finds_nothing_colour_decides():
    image, mask = ball_on_grass()

    def blind(image, box, person, margin):
        return np.zeros(image.shape[:2], np.float32)

    colours = GrabCut(DetectConfig().grabcut, 0.5)
    stage = Segmenter(SegmenterConfig(), blind, colours)
    found, source = stage(image, (92, 62, 208, 178), nobody(mask.shape), seed=0)
    assert not source.startswith("segmenter") and found.any()


def test_a_person_mask_that_fills_the_box_is_withheld():
    shown = []

    def watched(image, box, person, margin):
        shown.append(float(person.max()))
        return np.ones(image.shape[:2], np.float32)

    image, _ = ball_on_grass()
    stage = Segmenter(SegmenterConfig(), watched, GrabCut(DetectConfig().grabcut, 0.5))
    for column in (140, 190):  # the person covers 40 %, then over 80 % of the box
        pose = nobody(image.shape[:2])
        pose.probability[:, :column] = 1
        stage(image, (100, 60, 200, 180), pose, seed=0)
    assert shown == [1.0, 0.0]


def test_the_source_says_whether_colour_had_a_say(network):
    image, mask = ball_on_grass()
    colours = GrabCut(DetectConfig().grabcut, 0.5)
    for refine, name in ((True, "segmenter_grabcut"), (False, "segmenter")):
        stage = Segmenter(SegmenterConfig(refine=refine), network, colours)
        found, source = stage(image, (92, 62, 208, 178), nobody(mask.shape), seed=0)
        assert source == name and overlap(found, mask) > 0.85


def test_what_is_held_is_looked_for_at_the_hands():
    windows = []

    class Network:
        def in_use(self, image, window, person, extent):
            windows.append(window)
            return person

    pose = nobody((200, 300))
    pose.keypoints[KEYPOINT["left_wrist"], :2] = 100, 80
    pose.keypoints[KEYPOINT["right_wrist"], :2] = 120, 90
    stage = Segmenter(SegmenterConfig(), Network(), GrabCut(DetectConfig().grabcut, 0.5))
    person = (90.0, 10.0, 150.0, 110.0)
    for held in (False, True):
        stage.in_use(np.zeros((200, 300, 3), np.uint8), person, pose, 20.0, held)
    assert windows[0] == used_window(person, (200, 300))
    x0, y0, x1, y1 = windows[1]
    assert ((x0 + x1) / 2, (y0 + y1) / 2) == (110, 85)
    assert x1 - x0 == pytest.approx(HANDS_SHARE * 100) and y1 - y0 == pytest.approx(x1 - x0)


# ------------------------------------------------------------------------- held-out renders


def test_without_a_box_it_finds_what_the_person_uses(network):
    scores = {}
    for file in sorted(RENDERS.glob("*.npz")):
        picture = load_picture(file)
        person = picture.owner == picture.number_of("person")
        if person.any():
            main = picture.owner == picture.number_of("main")
            extent = max(np.ptp(np.argwhere(main), axis=0))
            seen = cv2.resize(picture.person.astype(np.float32) / 255, main.shape[::-1])
            window = used_window(mask_box(person), main.shape)
            found = network.in_use(picture.image, window, seen, float(extent)) > 0.5
            scores[file.stem] = overlap(found, main)
    assert scores and np.mean(list(scores.values())) > 0.38, scores


def test_on_held_out_renders_it_is_far_better_than_colour_alone(network):
    config = DetectConfig()
    colours = GrabCut(config.grabcut, config.blazepose.visible)
    stage = Segmenter(config.segmenter, network, colours)
    scores = []
    for file in sorted(RENDERS.glob("*.npz")):
        picture = load_picture(file)
        truth = picture.owner == picture.number_of("main")
        person = cv2.resize(picture.person.astype(np.float32) / 255, truth.shape[::-1])
        pose = nobody(truth.shape)
        pose.probability[:] = person
        masks = [method(picture.image, mask_box(truth), pose, 0)[0] for method in (stage, colours)]
        scores.append([overlap(mask, truth) for mask in masks])
    ours, grabcut = np.mean(scores, axis=0)
    assert len(scores) == 3
    assert ours > 0.75 and ours > grabcut + 0.15, (ours, grabcut)
