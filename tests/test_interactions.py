"""A pose database from images: queries, the paper's filters, what is kept and what is counted."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from hoi.actions.config import ActionsConfig
from hoi.actions.database import DEFAULT_DATABASE, load_database, save_database
from hoi.actions.space import DEFAULT_ACTION_SPACE
from hoi.actions.stage import ActionStage
from hoi.artifacts import BodyFit, Candidate, Detection, Frame
from hoi.body.skeleton import mirror_pose
from hoi.config import load_config
from hoi.errors import ConfigError, FrameFailure
from hoi.interactions.collect import (
    KEPT,
    Outcome,
    collect,
    counts_table,
    duplicates,
    joined,
    outcome,
    picture_digest,
)
from hoi.interactions.config import InteractionsConfig
from hoi.interactions.filters import check_fit, check_interaction
from hoi.interactions.images import image_files, list_images, read_image
from hoi.manifest import INTERACTIONS, plan

CATEGORIES = ("chair", "stool", "table", "beach_ball")
CONFIG = Path(__file__).parents[1] / "config" / "config.yaml"


def put(folder, name, size=(400, 320), seed=0):
    folder.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 255, (size[1], size[0], 3), np.uint8)
    Image.fromarray(pixels).save(folder / name)


# -------------------------------------------------------------------------------- images


def test_folders_are_queries(tmp_path):
    put(tmp_path / "woman sit chair", "1.png")
    put(tmp_path / "woman sit chair", "1.object_mask.png")
    put(tmp_path / "man_throw_beach_ball", "1.png")
    put(tmp_path / "sit on armchair", "x.png")
    found = list_images(InteractionsConfig(folder=str(tmp_path)), CATEGORIES)
    labels = [(image.query, image.action, image.category) for image in found]
    assert labels == [
        ("man_throw_beach_ball", "throw", "beach_ball"),
        ("sit on armchair", "sit on", "chair"),
        ("woman sit chair", "sit", "chair"),
    ]
    assert len({image.frame_id for image in found}) == 3


def test_a_manifest_names_images_and_queries(tmp_path):
    put(tmp_path, "a.png")
    (tmp_path / "manifest.csv").write_text("image,query,url\na.png,woman sit chair,x\n")
    (image,) = list_images(InteractionsConfig(folder=str(tmp_path)), CATEGORIES)
    assert (image.file, image.action, image.category) == ("a.png", "sit", "chair")
    assert image_files(InteractionsConfig(folder=str(tmp_path)), image) == [tmp_path / "a.png"]


@pytest.mark.parametrize(
    ("manifest", "message"),
    [
        ("image,query\n../a.png,woman sit chair\n", r"line 2.*no file of this folder"),
        ("image,query\n/etc/x.png,woman sit chair\n", "no file of this folder"),
        ("image,words\na.png,x\n", "columns image and query"),
        ("image,query\na.png,chair\n", "no query"),
        ("image,query\n", "holds no"),
    ],
)
def test_a_wrong_manifest_is_named(tmp_path, manifest, message):
    (tmp_path / "manifest.csv").write_text(manifest)
    with pytest.raises(ConfigError, match=message):
        list_images(InteractionsConfig(folder=str(tmp_path)), CATEGORIES)


def test_a_missing_folder_says_what_to_set(tmp_path):
    for folder in ("", str(tmp_path / "nothing")):
        with pytest.raises(ConfigError, match=r"interactions\.folder"):
            list_images(InteractionsConfig(folder=folder), CATEGORIES)


@pytest.mark.parametrize(
    ("size", "passes"), [((301, 301), True), ((300, 900), False), ((900, 300), False)]
)
def test_both_sides_need_more_than_300_pixels(tmp_path, size, passes):
    put(tmp_path / "woman sit chair", "1.png", size)
    config = InteractionsConfig(folder=str(tmp_path))
    (image,) = list_images(config, CATEGORIES)
    if passes:
        frame = read_image(config, image)
        assert (frame.category, frame.action, frame.dataset) == ("chair", "sit", "interactions")
    else:
        with pytest.raises(FrameFailure) as caught:
            read_image(config, image)
        assert caught.value.status == "too_small"


def test_the_plan_chunks_the_images(tmp_path):
    for number in range(5):
        put(tmp_path / "woman sit chair", f"{number}.png", seed=number)
    changes = {
        "interactions": InteractionsConfig(folder=str(tmp_path), chunk_size=2),
        "memo": str(tmp_path / "memo"),
    }
    config = load_config(CONFIG).model_copy(update=changes)
    chunks = plan(config, INTERACTIONS)
    assert [len(chunk.frames) for chunk in chunks] == [2, 2, 1]


# -------------------------------------------------------------------------------- filters


def detection(*candidates, person=(0, 0, 100, 200), thing=(50, 100, 150, 220)):
    mask = np.zeros((240, 240), bool)
    return Detection(
        frame_id="a",
        person_box=np.array(person, float),
        object_box=np.array(thing, float),
        person_mask=mask,
        object_mask=mask,
        keypoints=np.zeros((21, 3)),
        candidates=list(candidates),
    )


def seen(label, verdict, score=0.9):
    return Candidate(label=label, score=score, box=(0, 0, 1, 1), verdict=verdict)


PAIR = (seen("person", "chosen"), seen("chair", "chosen"))


def reason(found, **settings):
    try:
        check_interaction(found, InteractionsConfig(**settings))
    except FrameFailure as failure:
        return failure.status
    return KEPT


@pytest.mark.parametrize(
    ("others", "status"),
    [
        ((), KEPT),
        ((seen("person", "other_person"),), "several_people"),
        ((seen("person", "background_person"),), "several_people"),
        ((seen("person", "background_person", 0.2),), KEPT),
        ((seen("person", "same_person"),), KEPT),
        ((seen("chair", "other_object"),), "several_objects"),
        ((seen("chair", "too_far_from_person"),), "several_objects"),
        ((seen("chair", "below_threshold", 0.1),), KEPT),
        ((seen("cup", "other_object"),), KEPT),
    ],
)
def test_exactly_one_person_and_one_object(others, status):
    assert reason(detection(*PAIR, *others)) == status


def test_boxes_apart_are_no_interaction():
    apart = detection(*PAIR, thing=(110, 0, 150, 200))
    assert reason(apart) == "no_interaction"
    assert reason(apart, min_box_iou=0.0) == KEPT


def test_a_body_that_misses_its_keypoints_is_not_believed():
    config = InteractionsConfig()
    check_fit(0.04 * 200, detection(), config)
    with pytest.raises(FrameFailure, match="poor_body_fit"):
        check_fit(0.06 * 200, detection(), config)


# ------------------------------------------------------------------------------- database


def body(pose=None, status="ok"):
    if status != "ok":
        return BodyFit(frame_id="a", status=status)
    return BodyFit(
        frame_id="a",
        global_orient=np.array([np.pi, 0, 0]),
        body_pose=np.zeros(69) if pose is None else pose,
        betas=np.zeros(10),
        transl=np.zeros(3),
        vertices=np.zeros((1, 3)),
        joints=np.zeros((24, 3)),
        reprojection_error_px=1.0,
    )


def frame(**changes):
    ready = {"image": np.zeros((8, 8, 3), np.uint8), "intrinsics": np.eye(3)}
    return Frame(frame_id="a", **{**ready, **changes})


def test_the_first_failure_of_an_image_counts():
    config, labels = InteractionsConfig(), ("chair", "sit")

    def status(first, second, third, again=False):
        return outcome("q", again, first, second, third, config, labels).status

    small = Frame(frame_id="a", status="too_small")
    failed = Detection(frame_id="a", status="several_people")
    assert status(frame(), detection(), body()) == KEPT
    assert status(small, failed, body(status="x")) == "too_small"
    assert status(frame(), failed, body(status="several_people")) == "several_people"
    assert status(frame(), detection(), body(), again=True) == "duplicate"
    assert status(small, failed, body(status="x"), again=True) == "too_small"


def test_the_same_picture_counts_once_for_the_same_labels(tmp_path):
    put(tmp_path / "woman sit chair", "1.png")
    put(tmp_path / "woman sit chair", "2.bmp.png")
    put(tmp_path / "man sit chair", "other.png", seed=1)
    config = InteractionsConfig(folder=str(tmp_path))
    pictures = [picture_digest(read_image(config, ref)) for ref in list_images(config, CATEGORIES)]
    assert len(pictures) == 3 and len(set(pictures)) == 2
    failed = [Frame(frame_id=name, status="image_unreadable") for name in "ab"]
    assert picture_digest(failed[0]) != picture_digest(failed[1])
    seen_before = duplicates([("a", "chair", "sit"), ("a", "chair", "lift"), ("a", "chair", "sit")])
    assert seen_before == [False, False, True]


def outcomes():
    rng = np.random.default_rng(1)
    poses = rng.normal(0, 0.4, (3, 69))
    up = np.array([0.6, 0.8, 0.0])
    return [
        Outcome("woman sit chair", "chair", "sit", "a", KEPT, poses[0], up),
        Outcome("man lift chair", "chair", "lift", "b", KEPT, poses[1], up),
        Outcome("woman sit chair", "chair", "sit", "c", "too_small"),
        Outcome("woman sit chair", "chair", "sit", "d", "odd_failure"),
    ]


def test_every_image_is_counted_once():
    table = counts_table(outcomes()).set_index("query")
    sit = table.loc["woman sit chair"]
    assert (sit["images"], sit["kept"], sit["too_small"], sit["other"]) == (3, 1, 1, 1)
    total = table.loc["all"]
    assert total["images"] == 4 and total["kept_share"] == pytest.approx(0.5)
    dropped = table.columns[3:-2]
    assert (table["images"] == table[list(dropped)].sum(axis=1) + table["kept"]).all()


def test_a_database_of_images_answers_the_action_stage(tmp_path):
    database = collect(outcomes(), InteractionsConfig())
    assert database is not None and len(database) == 4
    np.testing.assert_allclose(database.body_pose[1], mirror_pose(database.body_pose[0]), atol=1e-4)
    assert database.pelvis_up is not None
    np.testing.assert_allclose(database.pelvis_up[:2], [[0.6, 0.8, 0], [-0.6, 0.8, 0]])
    save_database(database, tmp_path / "own.npz")
    stage = ActionStage(ActionsConfig(), tmp_path / "own.npz", DEFAULT_ACTION_SPACE)
    lifted = body(outcomes()[1].body_pose)
    found = stage(frame(category="chair"), lifted)
    assert found.action == "lift" and found.detail == "nearest pose: b_00"


def test_the_package_s_poses_can_stay_beside_them(tmp_path):
    package = load_database(DEFAULT_DATABASE)
    own = collect(outcomes(), InteractionsConfig(mirrored=False))
    assert own is not None
    both = joined(package, own)
    save_database(both, tmp_path / "both.npz")
    again = load_database(tmp_path / "both.npz")
    assert len(again) == len(package) + 2 and again.pelvis_up is not None


def test_no_image_no_database():
    assert collect([outcomes()[2]], InteractionsConfig()) is None
    assert isinstance(counts_table([outcomes()[2]]), pd.DataFrame)
