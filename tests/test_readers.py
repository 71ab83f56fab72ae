"""Files of other systems: masks, keypoints, bodies and contacts, genuine layouts and damaged."""

import pickle
from pathlib import Path

import joblib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from hoi.artifacts import Frame
from hoi.body.keypoints import KEYPOINT
from hoi.config import read_config
from hoi.errors import AssetError, ConfigError, FrameFailure
from hoi.readers.attach import attach, upright_size
from hoi.readers.bodies import read_bodies
from hoi.readers.coco import mask_of
from hoi.readers.config import BodyFiles, ContactFiles, KeypointFiles, MaskFiles, OtherSystems
from hoi.readers.contacts import read_contacts
from hoi.readers.keypoints import read_people
from hoi.readers.masks import read_instances, read_pair
from hoi.readers.paths import FrameNames, fill
from hoi.readers.pickles import read_plain_pickle
from other_systems import HEIGHT, WIDTH, block, result, run_length_text, runs_of, write_json

NAMES = FrameNames("photo", "photo.jpg", "Date03_Sub03_chairblack_sit", "t0003.000")
PERSON, CHAIR = block(5, 3, 30, 44), block(25, 20, 50, 46)
NO_TABLES = {"methods": [], "ablation": [], "accuracy": []}
RNG = np.random.default_rng(1)


def masks(**values):
    return MaskFiles(**({"format": "coco_json", "path": "masks.json"} | values))


def keypoint_files(kind, path="{stem}.json", **values):
    return KeypointFiles(format=kind, path=path, **values)


# --------------------------------------------------------------------------------------- masks


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 60), st.integers(1, 60), st.floats(0, 1), st.integers(0, 9))
def test_run_length_masks_survive_the_round_trip(height, width, share, seed):
    mask = np.random.default_rng(seed).random((height, width)) < share
    for counts in (run_length_text(mask), runs_of(mask)):
        found = mask_of({"size": [height, width], "counts": counts}, None, Path("x"))
        np.testing.assert_array_equal(found, mask)


def test_run_lengths_are_those_of_coco_s_own_tools():
    # written by pycocotools 2.0: 7 x 9 pixels, rows 2-4 and columns 3-6 set
    mask = np.zeros((7, 9), bool)
    mask[2:5, 3:7] = True
    known = "g03400000<"
    assert run_length_text(mask) == known
    found = mask_of({"size": [7, 9], "counts": known}, None, Path("x"))
    np.testing.assert_array_equal(found, mask)


def test_a_results_list_names_its_images_by_file_by_number_or_through_annotations(tmp_path):
    entries = [
        result(PERSON, 1, 0.9),
        result(CHAIR, 62, 0.7),
        result(CHAIR, 67, 0.8, image="other.jpg"),
    ]
    write_json(tmp_path / "masks.json", entries)
    found = read_instances(masks(), NAMES, tmp_path, (WIDTH, HEIGHT))
    assert (found.labels, found.scores) == (["person", "chair"], [0.9, 0.7])
    np.testing.assert_array_equal(found.masks, [PERSON, CHAIR])

    numbered = [result(PERSON, 1, 0.9, image=139), result(CHAIR, 62, 0.8, image=140)]
    write_json(tmp_path / "masks.json", numbered)
    by_number = FrameNames("f", "000000000139.jpg")
    assert read_instances(masks(), by_number, tmp_path, (WIDTH, HEIGHT)).labels == ["person"]

    write_json(
        tmp_path / "instances.json",
        {
            "images": [{"id": 140, "file_name": "val/photo.jpg", "width": WIDTH, "height": HEIGHT}],
            "categories": [{"id": 62, "name": "Dining_Table"}],
            "annotations": [],
        },
    )
    described = masks(annotations="instances.json")
    assert read_instances(described, NAMES, tmp_path, (1, 1)).labels == ["dining table"]


def test_an_annotation_file_with_polygons_is_filled_at_its_image_s_size(tmp_path):
    content = {
        "images": [{"id": 1, "file_name": "photo.png", "width": WIDTH, "height": HEIGHT}],
        "categories": [{"id": 7, "name": "chair"}],
        "annotations": [
            {"image_id": 1, "category_id": 7, "segmentation": [[10, 10, 29, 10, 29, 19, 10, 19]]}
        ],
    }
    write_json(tmp_path / "masks.json", content)
    found = read_instances(masks(), NAMES, tmp_path, (1, 1))
    np.testing.assert_array_equal(found.masks[0], block(10, 10, 30, 20))


def test_a_file_of_one_photo_need_not_name_it(tmp_path):
    write_json(tmp_path / "photo.json", [result(PERSON, 1, 0.9, image=0)])
    found = read_instances(masks(path="{stem}.json"), NAMES, tmp_path, (WIDTH, HEIGHT))
    assert found.labels == ["person"]
    with pytest.raises(AssetError, match=r"photo\.json: no instance with a 'segmentation'"):
        read_instances(masks(path="photo.json"), NAMES, tmp_path, (WIDTH, HEIGHT))


DAMAGED_MASKS = [
    ([], "no instance"),
    ({"annotations": []}, "key 'images' is missing"),
    ([{"category_id": 1}], "key 'image_id' is missing"),
    ([result(PERSON, 1, 0.9, image=[1])], "an image id is"),
    ([result(PERSON, 12, 0.9)], "key 'category_id' is 12"),
    ([result(PERSON, "1", 0.9)], "key 'category_id' is '1'"),
    ([result(PERSON, 1, "high")], "key 'score' is 'high'"),
    ([result(PERSON, 1, 0.9) | {"segmentation": 3}], "expected an object with 'size'"),
    ([result(PERSON, 1, 0.9) | {"segmentation": {"size": [4, 4]}}], "key 'counts' is missing"),
    (
        [result(PERSON, 1, 0.9) | {"segmentation": {"size": [4, 4], "counts": [3, 4]}}],
        "key 'counts' of a mask covers 7 pixels",
    ),
    (
        [result(PERSON, 1, 0.9) | {"segmentation": {"size": [10**9, 4], "counts": ""}}],
        "key 'size' of a mask",
    ),
    (
        [result(PERSON, 1, 0.9) | {"segmentation": {"size": [4, 4], "counts": "ü"}}],
        "no run-length text",
    ),
    (
        [result(PERSON, 1, 0.9) | {"segmentation": {"size": [4, 4], "counts": "oooooooooo0"}}],
        "a number that is too long",
    ),
    ([result(PERSON, 1, 0.9) | {"segmentation": [[1, 2, 3]]}], "a polygon of 3 numbers"),
]


@pytest.mark.parametrize(("content", "message"), DAMAGED_MASKS)
def test_damaged_masks_are_named_with_their_key(tmp_path, content, message):
    write_json(tmp_path / "masks.json", content)
    with pytest.raises(AssetError, match=rf"masks\.json: .*{message}"):
        read_instances(masks(), NAMES, tmp_path, (WIDTH, HEIGHT))


def test_mask_pictures_are_read_and_damaged_ones_named(tmp_path):
    from PIL import Image

    files = MaskFiles(format="png", person="{stem}_h.png", object="{stem}_o.png")
    Image.fromarray(PERSON.astype(np.uint8) * 255).save(tmp_path / "photo_h.png")
    with pytest.raises(AssetError, match=r"photo_o\.png: no such file"):
        read_pair(files, NAMES, tmp_path)
    (tmp_path / "photo_o.png").write_bytes((tmp_path / "photo_h.png").read_bytes()[:60])
    with pytest.raises(AssetError, match=r"photo_o\.png: not a readable picture"):
        read_pair(files, NAMES, tmp_path)
    Image.fromarray(CHAIR.astype(np.uint8) * 255).save(tmp_path / "photo_o.png")
    for mask, expected in zip(read_pair(files, NAMES, tmp_path), (PERSON, CHAIR), strict=True):
        np.testing.assert_array_equal(mask, expected)


# ----------------------------------------------------------------------------------- keypoints


def table(count):
    return np.column_stack([np.arange(count), 100 + np.arange(count), np.full(count, 0.5)])


@pytest.mark.parametrize(
    ("kind", "content", "nose", "left_toe"),
    [
        ("openpose", {"people": [{"pose_keypoints_2d": table(25).ravel().tolist()}]}, 0, 19),
        ("openpose", {"people": [{"pose_keypoints_2d": table(18).ravel().tolist()}]}, 0, None),
        ("openpose", {"body_joints": table(25).ravel().tolist()}, 0, 19),
        (
            "coco_json",
            [{"image_id": "photo.jpg", "keypoints": table(17).ravel().tolist()}],
            0,
            None,
        ),
        ("coco_json", [{"image_id": "photo.jpg", "keypoints": table(26).ravel().tolist()}], 0, 20),
        (
            "coco_json",
            [
                {
                    "image_id": "photo.jpg",
                    "keypoints": table(17).ravel().tolist(),
                    "foot_kpts": (table(6) + [17, 17, 0]).ravel().tolist(),
                }
            ],
            0,
            17,
        ),
        (
            "mmpose",
            [{"keypoints": table(17)[:, :2].tolist(), "keypoint_scores": [0.5] * 17}],
            0,
            None,
        ),
        (
            "mmpose",
            {
                "meta_info": {},
                "instance_info": [
                    {
                        "frame_id": 0,
                        "instances": [
                            {
                                "keypoints": table(133)[:, :2].tolist(),
                                "keypoint_scores": [0.5] * 133,
                            }
                        ],
                    }
                ],
            },
            0,
            17,
        ),
    ],
)
def test_every_system_s_order_becomes_ours(tmp_path, kind, content, nose, left_toe):
    write_json(tmp_path / "photo.json", content)
    (person,) = read_people(keypoint_files(kind), NAMES, tmp_path)
    np.testing.assert_allclose(person[KEYPOINT["nose"]], [nose, 100 + nose, 0.5])
    toe = person[KEYPOINT["left_toe"]]
    np.testing.assert_allclose(
        toe, [0, 0, 0] if left_toe is None else [left_toe, 100 + left_toe, 0.5]
    )


def test_annotators_flags_become_confidence_and_failed_people_are_nobody(tmp_path):
    flags = np.tile([0, 1, 2], 6)[:17]
    points = np.column_stack([table(17)[:, :2], flags])
    content = {
        "images": [{"id": 1, "file_name": "photo.jpg"}],
        "annotations": [{"image_id": 1, "keypoints": points.ravel().tolist()}],
    }
    write_json(tmp_path / "photo.json", content)
    (person,) = read_people(keypoint_files("coco_json"), NAMES, tmp_path)
    np.testing.assert_allclose(person[:17, 2], np.array([0, 0.5, 1])[flags])
    write_json(tmp_path / "photo.json", {"body_joints": [0.0] * 75})
    assert read_people(keypoint_files("openpose"), NAMES, tmp_path).shape == (0, 21, 3)


@pytest.mark.parametrize(
    ("kind", "content", "message"),
    [
        ("openpose", {}, "key 'people' is missing"),
        ("openpose", {"people": [{}]}, "key 'pose_keypoints_2d' is missing"),
        ("openpose", {"people": {"a": 1}}, "key 'people' is a dict"),
        ("openpose", {"people": [{"pose_keypoints_2d": [1, 2]}]}, "holds 2 numbers"),
        ("openpose", {"people": [{"pose_keypoints_2d": [1.0] * 21}]}, "holds 7 keypoints"),
        ("openpose", {"people": [{"pose_keypoints_2d": ["a"] * 75}]}, "no array of numbers"),
        ("openpose", {"people": [{"pose_keypoints_2d": [1e9] * 75}]}, "no pixel"),
        ("openpose", [1], "expected an object with 'people'"),
        ("coco_json", [{"image_id": "photo", "keypoints": [[1], [2, 3]]}], "no array of numbers"),
        ("mmpose", [{"keypoints": [[1, 2]] * 17}], "key 'keypoint_scores' is missing"),
        ("mmpose", [{"keypoints": [1], "keypoint_scores": [1]}], "do not fit"),
        ("mmpose", {"instance_info": [{"instances": []}] * 2}, "2 frames of a video"),
        ("mmpose", {"instance_info": 3}, "key 'instance_info' is a int"),
    ],
)
def test_damaged_keypoints_are_named_with_their_key(tmp_path, kind, content, message):
    write_json(tmp_path / "photo.json", content)
    with pytest.raises(AssetError, match=rf"photo\.json: .*{message}"):
        read_people(keypoint_files(kind), NAMES, tmp_path)


@pytest.mark.parametrize("kind", ["openpose", "coco_json", "mmpose"])
def test_truncated_foreign_and_absent_json_is_named(tmp_path, kind):
    path = tmp_path / "photo.json"
    with pytest.raises(AssetError, match=r"photo\.json: no such file"):
        read_people(keypoint_files(kind), NAMES, tmp_path)
    for damaged in (b'{"people": [{"pose_', b"", b'{"people": "\xff"}', b"[" * 100_000):
        path.write_bytes(damaged)
        with pytest.raises(AssetError, match=r"photo\.json: not readable as JSON"):
            read_people(keypoint_files(kind), NAMES, tmp_path)


# -------------------------------------------------------------------------------------- bodies


def rotations(count=2):
    vectors = RNG.normal(size=(count, 24, 3)) * 0.5
    matrices = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(count, 24, 3, 3)
    return vectors, matrices.astype(np.float32)


def bodies(kind, path):
    return BodyFiles(format=kind, path=path)


def test_pare_s_file_of_a_photo_gives_all_its_people(tmp_path):
    vectors, matrices = rotations()
    output = {
        "pred_pose": matrices,
        "pred_shape": np.full((2, 10), 0.25, np.float32),
        "pred_cam": np.ones((2, 3), np.float32),
        "smpl_vertices": np.asfortranarray(RNG.normal(size=(2, 100, 3))),
        "bboxes": [np.zeros(4)],
    }
    for compress in (0, 3, ("gzip", 3)):
        joblib.dump(output, tmp_path / "photo.pkl", compress=compress)
        found = read_bodies(bodies("pare", "{stem}.pkl"), NAMES, tmp_path)
        np.testing.assert_allclose(found.poses, vectors, atol=1e-5)
        assert (found.betas == 0.25).all() and found.betas.shape == (2, 10)


def test_pare_s_file_of_a_video_says_how_to_get_one_a_photo(tmp_path):
    joblib.dump({1: {"pose": np.zeros(3), "frame_ids": np.zeros(3)}}, tmp_path / "photo.pkl")
    with pytest.raises(AssetError, match="--mode folder"):
        read_bodies(bodies("pare", "photo.pkl"), NAMES, tmp_path)


def test_4d_humans_is_read_from_its_tracks_and_from_saved_parameters(tmp_path):
    vectors, matrices = rotations()
    people = [
        {"global_orient": m[:1], "body_pose": m[1:], "betas": np.zeros(10, np.float32)}
        for m in matrices
    ]
    tracks = {"outputs/_DEMO/img/photo.jpg": {"smpl": people, "tid": [1, 2]}, "b.jpg": {}}
    joblib.dump(tracks, tmp_path / "demo.pkl", compress=3)
    kind = "four_d_humans"
    found = read_bodies(bodies(kind, "demo.pkl"), NAMES, tmp_path)
    np.testing.assert_allclose(found.poses, vectors, atol=1e-5)
    with pytest.raises(AssetError, match="frame called 'c'"):
        read_bodies(bodies(kind, "demo.pkl"), FrameNames("c", "c.jpg"), tmp_path)
    saved = {
        "global_orient": matrices[:, :1],
        "body_pose": matrices[:, 1:],
        "betas": np.zeros((2, 10)),
    }
    np.savez(tmp_path / "photo.npz", **saved)
    with open(tmp_path / "photo.pkl", "wb") as stream:
        pickle.dump({"pred_smpl_params": saved, "pred_cam": np.zeros((2, 3))}, stream)
    for name in ("{stem}.npz", "{stem}.pkl"):
        found = read_bodies(bodies(kind, name), NAMES, tmp_path)
        np.testing.assert_allclose(found.poses, vectors, atol=1e-5)


@pytest.mark.parametrize("protocol", range(6))
def test_frankmocap_s_own_file_and_behave_s_json_agree(tmp_path, protocol):
    vectors, _ = rotations(1)
    write_json(tmp_path / "k1.mocap.json", {"pose": vectors.ravel().tolist(), "betas": [0.5] * 10})
    person = {"pred_body_pose": vectors.reshape(1, 72), "pred_betas": np.full((1, 10), 0.5)}
    with open(tmp_path / "photo_prediction_result.pkl", "wb") as stream:
        pickle.dump({"pred_output_list": [person], "image_path": "x"}, stream, protocol=protocol)
    for name in ("k1.mocap.json", "{stem}_prediction_result.pkl"):
        found = read_bodies(bodies("frankmocap", name), NAMES, tmp_path)
        np.testing.assert_allclose(found.poses, vectors)
        assert (found.betas == 0.5).all()


def test_fingers_of_smplh_are_left_out_and_missing_hands_are_straight(tmp_path):
    pose = np.arange(156) / 100
    write_json(tmp_path / "a.json", {"pose": pose.tolist(), "betas": [0.0] * 10})
    found = read_bodies(bodies("smpl", "a.json"), NAMES, tmp_path)
    np.testing.assert_allclose(found.poses[0].ravel()[:66], pose[:66])
    assert not found.poses[0, 22:].any()
    np.savez(
        tmp_path / "a.npz", global_orient=pose[:3], body_pose=pose[3:66], betas=np.zeros((1, 10))
    )
    again = read_bodies(bodies("smpl", "a.npz"), NAMES, tmp_path)
    np.testing.assert_allclose(again.poses, found.poses)


@pytest.mark.parametrize(
    ("kind", "content", "message"),
    [
        ("pare", {}, "key 'pred_pose' is missing"),
        ("pare", {"pred_pose": np.zeros((1, 24, 3))}, "expected 24 rotation matrices"),
        ("pare", {"pred_pose": np.zeros((1, 24, 3, 3))}, "are no rotations"),
        ("pare", {"pred_pose": np.full((1, 24, 3, 3), np.nan)}, "holds NaN"),
        ("pare", {"pred_pose": "text"}, "no array of numbers"),
        ("pare", {"pred_pose": np.eye(3)[None, None].repeat(24, 1)}, "key 'pred_shape' is missing"),
        ("pare", [1], "expected an object with 'pred_pose'"),
        ("four_d_humans", {"a": 1}, "none of its 1 keys"),
        ("four_d_humans", {"photo.jpg": {"smpl": []}}, "nobody was tracked"),
        ("four_d_humans", {"photo.jpg": 3}, "expected an object with 'smpl'"),
        ("frankmocap", {"pred_output_list": []}, "key 'pred_output_list' holds no usable person"),
        ("frankmocap", {"pred_output_list": [None]}, "expected an object with 'pred_body_pose'"),
        ("frankmocap", {"pose": np.zeros(71), "betas": np.zeros(10)}, "holds 71 numbers"),
        ("smpl", {"pose": np.full(72, 1e6), "betas": np.zeros(10)}, "no angle in radians"),
        ("smpl", {"pose": np.zeros(72), "betas": np.zeros((2, 10))}, "for 1 people"),
        ("smpl", {"pose": {"a": 1}, "betas": np.zeros(10)}, "no array of numbers"),
    ],
)
def test_damaged_bodies_are_named_with_their_key(tmp_path, kind, content, message):
    joblib.dump(content, tmp_path / "photo.pkl")
    with pytest.raises(AssetError, match=rf"photo\.pkl: .*{message}"):
        read_bodies(bodies(kind, "photo.pkl"), NAMES, tmp_path)


# -------------------------------------------------------------------------------------- pickles


class Attack:
    def __init__(self, function, *arguments):
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


class Stateful:
    """An object whose state a pickle would set."""


def test_nothing_in_a_pickle_can_run(tmp_path):
    import os
    import subprocess

    target = tmp_path / "touched"
    attacks = [
        Attack(os.system, f"touch {target}"),
        Attack(subprocess.check_output, ["touch", str(target)]),
        Attack(eval, f"open({str(target)!r}, 'w')"),
        Attack(getattr, [], "append"),
        Attack(np.load, str(target)),
        Stateful(),
        np.array([Attack(os.system, f"touch {target}")], dtype=object),
        Path("x"),
    ]
    for content in attacks:
        for protocol in range(2, 6):
            with open(tmp_path / "a.pkl", "wb") as stream:
                pickle.dump({"pred_pose": content}, stream, protocol=protocol)
            with pytest.raises(AssetError, match=r"a\.pkl: it asks for .* refused"):
                read_plain_pickle(tmp_path / "a.pkl")
    joblib.dump({"pred_pose": attacks[6]}, tmp_path / "a.pkl")
    with pytest.raises(AssetError, match="refused"):
        read_plain_pickle(tmp_path / "a.pkl")
    assert not target.exists()


def test_a_pickle_that_sets_the_state_of_a_function_is_refused(tmp_path):
    # GLOBAL numpy.dtype, an empty dict, BUILD
    (tmp_path / "a.pkl").write_bytes(b"cnumpy\ndtype\n}b.")
    with pytest.raises(AssetError, match="state of an unexpected object; refused"):
        read_plain_pickle(tmp_path / "a.pkl")


def test_bombs_and_cut_arrays_are_refused(tmp_path):
    path = tmp_path / "a.pkl"
    joblib.dump({"a": np.arange(1000.0)}, path)
    data = path.read_bytes()
    path.write_bytes(data[:-200])
    with pytest.raises(AssetError, match=r"a\.pkl: not a readable pickle"):
        read_plain_pickle(path)
    path.write_bytes(data.replace(b"M\xe8\x03", b"J\xff\xff\xff\x7f"))
    with pytest.raises(AssetError, match=r"a\.pkl: "):
        read_plain_pickle(path)


def test_plain_content_is_read_as_it_was(tmp_path):
    from collections import OrderedDict, defaultdict

    content = {
        "list": [1, 2.5, "text", None, True, b"raw"],
        "scalar": np.float32(0.5),
        "ordered": OrderedDict(a=1),
        "default": defaultdict(list, {}),
        "fortran": np.asfortranarray(RNG.normal(size=(4, 5))),
        "empty": np.zeros((0, 3)),
        "big endian": np.arange(5, dtype=">f4"),
    }
    for write in (joblib.dump, lambda c, p: p.write_bytes(pickle.dumps(c))):
        write(content, tmp_path / "a.pkl")
        found = read_plain_pickle(tmp_path / "a.pkl")
        assert found["list"] == content["list"] and found["scalar"] == 0.5
        assert dict(found["ordered"]) == {"a": 1} and found["default"] == {}
        for key in ("fortran", "empty", "big endian"):
            np.testing.assert_array_equal(found[key], content[key])


@settings(max_examples=80, deadline=None)
@given(st.data())
def test_pickles_with_damaged_bytes_end_in_one_kind_of_error(tmp_path_factory, data):
    vectors = np.arange(72.0).reshape(1, 72) / 72
    plain = pickle.dumps({"pose": vectors, "betas": np.zeros((1, 10)), "name": "x"})
    damaged = bytearray(plain)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(plain) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "fuzzed.pkl"
    path.write_bytes(bytes(damaged[: data.draw(st.integers(1, len(plain)))]))
    try:
        read_bodies(bodies("smpl", str(path)), NAMES, path.parent)
    except AssetError as error:
        assert "fuzzed.pkl" in str(error)


@settings(max_examples=60, deadline=None)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers(-5, 200) | st.floats() | st.text(max_size=3),
        lambda inner: (
            st.lists(inner, max_size=4)
            | st.dictionaries(
                st.sampled_from(
                    [
                        "people",
                        "pose_keypoints_2d",
                        "keypoints",
                        "image_id",
                        "annotations",
                        "images",
                    ]
                    + [
                        "segmentation",
                        "size",
                        "counts",
                        "instances",
                        "instance_info",
                        "pose",
                        "betas",
                    ]
                    + ["category_id", "score", "categories", "id", "file_name", "name"]
                ),
                inner,
                max_size=5,
            )
        ),
        max_leaves=12,
    )
)
def test_json_of_any_shape_ends_in_one_kind_of_error(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "fuzzed.json"
    write_json(path, content)
    readers = [
        lambda: read_instances(masks(path=str(path)), NAMES, path.parent, (WIDTH, HEIGHT)),
        *(
            lambda kind=kind: read_people(keypoint_files(kind, str(path)), NAMES, path.parent)
            for kind in ("openpose", "coco_json", "mmpose")
        ),
        *(
            lambda kind=kind: read_bodies(bodies(kind, str(path)), NAMES, path.parent)
            for kind in ("pare", "four_d_humans", "frankmocap", "smpl")
        ),
    ]
    for read in readers:
        try:
            read()
        except AssetError as error:
            assert "fuzzed.json" in str(error)


# ------------------------------------------------------------------------------------- contacts


def test_contacts_are_probabilities_of_vertices(tmp_path):
    np.savez(tmp_path / "photo.npz", contact=np.array([[0], [1], [1]], bool))
    found = read_contacts(ContactFiles(path="{stem}.npz"), NAMES, tmp_path)
    assert found.tolist() == [0, 1, 1] and found.dtype == np.float32
    for content, message in (
        ({"other": np.zeros(3)}, "key 'contact' is missing; it has 'other'"),
        ({"contact": np.zeros((2, 3))}, r"key 'contact' has shape \(2, 3\)"),
        ({"contact": np.array([0, 2.0])}, "outside 0..1"),
        ({"contact": np.array([np.nan])}, "NaN"),
        ({"contact": np.array(["a"])}, "no array of numbers"),
        ({"contact": np.zeros(0)}, "has shape"),
        ({"contact": np.array([{}])}, "not a readable npz"),
    ):
        np.savez(tmp_path / "photo.npz", **content)
        with pytest.raises(AssetError, match=rf"photo\.npz: .*{message}"):
            read_contacts(ContactFiles(path="photo.npz"), NAMES, tmp_path)
    (tmp_path / "photo.npz").write_bytes(b"PK\x03\x04cut")
    with pytest.raises(AssetError, match=r"photo\.npz: not a readable npz"):
        read_contacts(ContactFiles(path="photo.npz"), NAMES, tmp_path)


# --------------------------------------------------------------------------------- configuration


def test_paths_are_filled_from_the_frame_s_names_and_start_in_the_data_set():
    assert fill("op/{stem}_keypoints.json", NAMES, "/d") == Path("/d/op/photo_keypoints.json")
    template = "sequences/{sequence}/{time}/k1.mocap.json"
    assert fill(template, NAMES, "/d").parts[-3:-1] == (NAMES.sequence, NAMES.time)
    assert fill("/abs/{frame_id}", NAMES, "/d") == Path("/abs/photo")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"keypoints": {"format": "openpose", "path": "{photo}.json"}}, "no frame has a {photo}"),
        ({"keypoints": {"format": "vitpose", "path": "a"}}, "openpose"),
        ({"masks": {"format": "png", "person": "a"}}, "format png needs object"),
        ({"masks": {"format": "coco_json"}}, "format coco_json needs path"),
        ({"faces": {}}, "unknown key"),
    ],
)
def test_wrong_settings_say_which_key(values, message):
    with pytest.raises(ConfigError, match=message) as caught:
        read_config({"other_systems": {"photos": values}, "tables": NO_TABLES})
    assert "other_systems.photos" in str(caught.value)
    with pytest.raises(ValidationError):
        OtherSystems(**values)


def test_named_files_are_what_the_detect_stage_takes():
    systems = {
        "photos": {
            "masks": {"format": "coco_json", "path": "a.json"},
            "keypoints": {"format": "mmpose", "path": "a.json"},
        }
    }
    config = read_config({"other_systems": systems, "tables": NO_TABLES})
    photos = config.detect_settings("photos")
    assert (photos.masks, photos.keypoints) == ("given", "given")
    assert config.detect_settings("behave_mini") == config.detect


# --------------------------------------------------------------------------------------- attach


def frame(size=(WIDTH, HEIGHT)):
    return Frame(
        frame_id="photo",
        category="chair",
        image=np.zeros((size[1], size[0], 3), np.uint8),
        intrinsics=np.eye(3),
    )


def test_everything_is_scaled_with_the_photo(tmp_path):
    write_json(tmp_path / "masks.json", [result(PERSON, 1, 0.9), result(CHAIR, 62, 0.7)])
    people = {"people": [{"pose_keypoints_2d": table(25).ravel().tolist()}]}
    write_json(tmp_path / "photo.json", people)
    systems = OtherSystems(masks=masks(), keypoints=keypoint_files("openpose"))
    small = attach(frame((WIDTH // 2, HEIGHT // 2)), systems, NAMES, tmp_path, (WIDTH, HEIGHT))
    assert small.given_instance_masks.shape == (2, HEIGHT // 2, WIDTH // 2)
    assert small.given_instance_masks[0].sum() == pytest.approx(PERSON.sum() / 4, rel=0.1)
    np.testing.assert_allclose(small.given_people[0, KEYPOINT["left_toe"]], [9.5, 59.5, 0.5])
    assert small.given_by == {"masks": "coco_json", "keypoints": "openpose"}
    assert systems.files(NAMES, tmp_path) == [tmp_path / "masks.json", tmp_path / "photo.json"]
    with pytest.raises(FrameFailure, match=r"mask_size_mismatch: photo\.jpg: the masks are 64x48"):
        attach(frame((90, 90)), systems, NAMES, tmp_path)


def test_a_turned_photo_has_the_size_it_is_shown_in(tmp_path):
    from PIL import ExifTags, Image

    picture = Image.new("RGB", (40, 20))
    picture.save(tmp_path / "plain.jpg")
    exif = picture.getexif()
    exif[ExifTags.Base.Orientation] = 6
    picture.save(tmp_path / "turned.jpg", exif=exif)
    assert upright_size(tmp_path / "plain.jpg") == (40, 20)
    assert upright_size(tmp_path / "turned.jpg") == (20, 40)


@pytest.mark.parametrize("kind", ["masks", "keypoints", "bodies", "contacts"])
def test_a_missing_file_fails_its_frame_by_name(tmp_path, kind):
    systems = OtherSystems(
        masks=masks() if kind == "masks" else None,
        keypoints=keypoint_files("openpose") if kind == "keypoints" else None,
        bodies=bodies("pare", "x.pkl") if kind == "bodies" else None,
        contacts=ContactFiles(path="x.npz") if kind == "contacts" else None,
    )
    with pytest.raises(FrameFailure, match="no such file") as caught:
        attach(frame(), systems, NAMES, tmp_path)
    assert caught.value.status == f"{kind}_unreadable"


def test_a_frame_with_all_of_it_survives_the_file(tmp_path):
    write_json(tmp_path / "masks.json", [result(PERSON, 1, 0.9)])
    vectors, _ = rotations(1)
    write_json(tmp_path / "b.json", {"pose": vectors.ravel().tolist(), "betas": [0.0] * 10})
    np.savez(tmp_path / "c.npz", contact=np.linspace(0, 1, 10))
    systems = OtherSystems(
        masks=masks(), bodies=bodies("frankmocap", "b.json"), contacts=ContactFiles(path="c.npz")
    )
    attach(frame(), systems, NAMES, tmp_path).save(tmp_path / "frame.npz")
    again = Frame.load(tmp_path / "frame.npz")
    np.testing.assert_allclose(again.given_poses, vectors)
    np.testing.assert_array_equal(again.given_instance_masks[0], PERSON)
    assert again.given_instances[0].label == "person" and len(again.given_contacts) == 10
