"""The BEHAVE reader: what it reads from a tree, and what it says of a damaged one."""

import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hoi.body.keypoints import FROM_BODY25, KEYPOINT
from hoi.datasets import behave
from hoi.datasets.behave_layout import (
    FrameRef,
    frame_folder,
    frame_ref,
    parse_frame_id,
    parse_sequence,
    sequence_name,
)
from hoi.errors import ConfigError, FrameFailure

SEQUENCE = "Date03_Sub03_chairblack_sit"
SIZE = (64, 48)


def write_ply(path: Path, offset=0.0) -> np.ndarray:
    """A tetrahedron as ASCII PLY."""
    vertices = np.array([[0, 0, 2], [1, 0, 2], [0, 1, 2], [0, 0, 3]], float) + offset
    faces = [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]
    lines = ["ply", "format ascii 1.0", "element vertex 4"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += ["element face 4", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, v)) for v in vertices]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
    return vertices


@pytest.fixture
def tree(tmp_path) -> Path:
    """A minimal BEHAVE tree of one frame, whose chair lies in the folder ``chair``."""
    folder = tmp_path / "sequences" / SEQUENCE / "t0003.000"
    folder.mkdir(parents=True)
    Image.new("RGB", SIZE, (90, 120, 40)).save(folder / "k1.color.jpg")
    mask = np.zeros(SIZE[::-1], np.uint8)
    mask[10:30, 5:20] = 255
    Image.fromarray(mask).save(folder / "k1.person_mask.png")
    Image.fromarray(mask[:, ::-1]).save(folder / "k1.obj_rend_mask.jpg")
    full = mask[:, ::-1].copy()
    full[30:40] = full[20:30]
    Image.fromarray(full).save(folder / "k1.obj_rend_full.png")
    joints = np.arange(75, dtype=float)
    (folder / "k1.color.json").write_text(json.dumps({"body_joints": joints.tolist()}))
    write_ply(folder / "person" / "fit02" / "person_fit.ply")
    write_ply(folder / "chair" / "fit01" / "chair_fit.ply", 1.0)
    calibration = {"fx": 100.0, "fy": 101.0, "cx": 64.0, "cy": 48.0, "width": 128, "height": 96}
    path = tmp_path / "calibs" / "intrinsics" / "1" / "calibration.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({"color": calibration}))
    splits = {"train": [], "test": [SEQUENCE, "Date03_Sub03_chairblack_hand"]}
    (tmp_path / "split.json").write_text(json.dumps(splits))
    return tmp_path


REF = frame_ref(SEQUENCE, "t0003.000")


def folder_of(tree: Path) -> Path:
    return frame_folder(tree, REF)


def status_of(call, *arguments) -> str:
    with pytest.raises(FrameFailure) as caught:
        call(*arguments)
    return caught.value.status


# ------------------------------------------------------------------------------------ names


def test_names_of_sequences_are_read_and_written_back():
    for name in (SEQUENCE, "Date03_Sub05_chairwood", "Date01_Sub01_keyboard_typing"):
        date, subject, object_name, action = parse_sequence(name)
        assert sequence_name(date, subject, object_name, action) == name
    assert parse_sequence("Date03_Sub05_chairwood")[3] == "mix"
    assert parse_sequence("Date03_Sub03_keyboard_typing")[3] == "type"
    assert parse_frame_id(REF.frame_id) == REF
    assert (REF.object_name, REF.action, REF.category) == ("chairblack", "sit", "chair")


@pytest.mark.parametrize(
    "sequence", ["../../etc", "Date03_Sub03_x/../../y", "Date03_Sub03_..", "/abs", ""]
)
def test_names_that_would_leave_the_tree_are_refused(sequence):
    with pytest.raises(ValueError):
        frame_ref(sequence, "t0003.000")


@pytest.mark.parametrize("time", ["..", "t0003.000/../..", "../t0003.000", "t0003", ""])
def test_times_that_would_leave_the_tree_are_refused(time):
    with pytest.raises(ValueError):
        frame_ref(SEQUENCE, time)


def test_a_reference_cannot_contradict_its_sequence():
    with pytest.raises(ValueError):
        FrameRef(SEQUENCE, "t0003.000", "stool", "sit", "stool")


# ---------------------------------------------------------------------------------- reading


def test_a_frame_is_read_with_its_camera_scaled_to_the_picture(tree):
    frame = behave.read_frame(tree, REF)
    assert frame.image.shape == (48, 64, 3)
    np.testing.assert_allclose(frame.intrinsics, [[50, 0, 32], [0, 50.5, 24], [0, 0, 1]])
    assert frame.given_person_mask.sum() == frame.given_object_mask.sum() == 20 * 15
    assert (frame.category, frame.object_name, frame.action) == ("chair", "chairblack", "sit")
    np.testing.assert_allclose(
        frame.given_keypoints[KEYPOINT["left_wrist"]], np.arange(21, 24, dtype=float)
    )
    assert (FROM_BODY25 >= 0).all()


def test_ground_truth_is_found_under_the_name_both_chairs_share(tree):
    truth = behave.read_ground_truth(tree, REF)
    assert len(truth.body_vertices) == len(truth.object_vertices) == 4
    np.testing.assert_allclose(truth.object_vertices - truth.body_vertices, 1.0)
    assert truth.visible_fraction == pytest.approx(20 / 30)
    assert truth.body_joints is None
    assert truth.body_model.startswith("mesh-4v-")


def test_an_object_given_by_parameters_is_its_template_centred_turned_and_moved(tree):
    folder = folder_of(tree) / "chair" / "fit01"
    (folder / "chair_fit.ply").unlink()
    template = write_ply(tree / "objects" / "chairblack" / "chairblack_f2500.ply", 5.0)
    pose = {"angle": np.array([0, 0, np.pi / 2]), "trans": np.array([1.0, 2.0, 3.0])}
    (folder / "chair_fit.pkl").write_bytes(pickle.dumps(pose))
    truth = behave.read_ground_truth(tree, REF)
    centred = template - template.mean(0)
    turned = np.stack([-centred[:, 1], centred[:, 0], centred[:, 2]], axis=1)
    np.testing.assert_allclose(truth.object_vertices, turned + [1, 2, 3], atol=1e-6)
    assert any(path.suffix == ".ply" for path in behave.ground_truth_files(tree, REF))


def test_optional_files_may_be_absent(tree):
    folder = folder_of(tree)
    for name in ("k1.person_mask.png", "k1.obj_rend_mask.jpg", "k1.color.json"):
        (folder / name).unlink()
    (tree / "calibs" / "intrinsics" / "1" / "calibration.json").unlink()
    frame = behave.read_frame(tree, REF)
    assert frame.given_person_mask is None
    assert frame.given_object_mask is None
    assert frame.given_keypoints is None
    assert "no calibration file" in frame.intrinsics_source


def test_all_zero_keypoints_stay_zeros(tree):
    (folder_of(tree) / "k1.color.json").write_text(json.dumps({"body_joints": [0.0] * 75}))
    assert not behave.read_frame(tree, REF).given_keypoints.any()


def test_keypoints_as_openpose_itself_writes_them_are_read(tree):
    people = {"people": [{"pose_keypoints_2d": list(range(75))}]}
    (folder_of(tree) / "k1.color.json").write_text(json.dumps(people))
    assert behave.read_frame(tree, REF).given_keypoints[KEYPOINT["nose"]].tolist() == [0, 1, 2]


def test_frames_are_listed_from_the_split_with_both_fits(tree):
    assert behave.list_frames(tree, "chair", "test") == [REF]
    shutil.rmtree(folder_of(tree) / "chair")
    with pytest.raises(ConfigError, match="no frames"):
        behave.list_frames(tree, "chair", "test")
    assert behave.list_frames(tree, "chair", "test", with_ground_truth=False) == [REF]


def test_wrong_groups_splits_and_folders_are_named(tree):
    with pytest.raises(ConfigError, match="sofa"):
        behave.list_frames(tree, "sofa", "test")
    with pytest.raises(ConfigError, match="validation"):
        behave.list_frames(tree, "chair", "validation")
    with pytest.raises(ConfigError, match=r"split\.json"):
        behave.list_frames(tree / "nowhere", "chair", "test")
    (tree / "split.json").write_text('{"test": ["../../etc/passwd"]}')
    with pytest.raises(ConfigError, match="not a BEHAVE split"):
        behave.list_frames(tree, "chair", "test")


def test_the_files_behind_a_frame_are_named_for_hashing(tree):
    names = {path.name for path in behave.frame_files(tree, REF)}
    assert names == {
        "k1.color.jpg", "k1.person_mask.png", "k1.obj_rend_mask.jpg", "k1.color.json",
        "calibration.json",
    }  # fmt: skip
    truth = {path.name for path in behave.ground_truth_files(tree, REF)}
    assert {"person_fit.ply", "chair_fit.ply", "k1.obj_rend_full.png"} <= truth


# ---------------------------------------------------------------------------------- damage


@pytest.mark.parametrize("kept", [0, 1, 20, 200, -5])
def test_a_truncated_image_is_unreadable(tree, kept):
    path = folder_of(tree) / "k1.color.jpg"
    path.write_bytes(path.read_bytes()[:kept])
    assert status_of(behave.read_frame, tree, REF) == "image_unreadable"


def test_an_absent_image_is_missing(tree):
    (folder_of(tree) / "k1.color.jpg").unlink()
    assert status_of(behave.read_frame, tree, REF) == "image_missing"


def test_a_mask_of_another_size_is_a_mismatch(tree):
    Image.new("L", (10, 10), 255).save(folder_of(tree) / "k1.person_mask.png")
    assert status_of(behave.read_frame, tree, REF) == "mask_size_mismatch"


@pytest.mark.parametrize(
    ("name", "status"),
    [
        ("k1.person_mask.png", "person_mask_empty"),
        ("k1.obj_rend_mask.png", "object_mask_empty"),
    ],
)
def test_an_empty_mask_is_named(tree, name, status):
    Image.new("L", SIZE, 0).save(folder_of(tree) / name)
    assert status_of(behave.read_frame, tree, REF) == status


def test_a_broken_mask_is_unreadable(tree):
    (folder_of(tree) / "k1.person_mask.png").write_bytes(b"no picture")
    assert status_of(behave.read_frame, tree, REF) == "mask_unreadable"


@pytest.mark.parametrize(
    "content",
    [
        "", "{", "[]", "3", '{"body_joints": 3}', '{"body_joints": [1, 2]}', '{"people": 4}',
        '{"body_joints": ["a"]}', '{"body_joints": [NaN' + ", 0" * 74 + "]}", "\x00\xff",
    ],
)  # fmt: skip
def test_bad_keypoint_files_are_unreadable(tree, content):
    (folder_of(tree) / "k1.color.json").write_text(content, encoding="utf-8")
    assert status_of(behave.read_frame, tree, REF) == "keypoints_unreadable"


@pytest.mark.parametrize("content", ["", '{"color": {}}', '{"color": {"fx": -1}}', "[1]"])
def test_a_bad_calibration_is_unreadable(tree, content):
    (tree / "calibs" / "intrinsics" / "1" / "calibration.json").write_text(content)
    assert status_of(behave.read_frame, tree, REF) == "calibration_unreadable"


@pytest.mark.parametrize("content", [b"", b"ply\nnonsense", b"\x00" * 300])
def test_a_damaged_mesh_is_unreadable(tree, content):
    (folder_of(tree) / "person" / "fit02" / "person_fit.ply").write_bytes(content)
    assert status_of(behave.read_ground_truth, tree, REF) == "ground_truth_unreadable"


def test_an_absent_fit_is_missing(tree):
    (folder_of(tree) / "person" / "fit02" / "person_fit.ply").unlink()
    assert status_of(behave.read_ground_truth, tree, REF) == "ground_truth_missing"


class _Malicious:
    def __init__(self, marker: str):
        self.marker = marker

    def __reduce__(self):
        import os

        return os.mkdir, (self.marker,)


def test_a_pickle_that_would_run_code_is_refused_and_runs_none(tree):
    folder = folder_of(tree) / "chair" / "fit01"
    (folder / "chair_fit.ply").unlink()
    write_ply(tree / "objects" / "chairblack" / "chairblack_f2500.ply")
    marker = tree / "owned"
    payload = {"angle": _Malicious(str(marker)), "trans": np.zeros(3)}
    (folder / "chair_fit.pkl").write_bytes(pickle.dumps(payload))
    assert status_of(behave.read_ground_truth, tree, REF) == "ground_truth_unreadable"
    assert not marker.exists()


@pytest.mark.parametrize(
    "content", [b"", b"\x80", pickle.dumps([1, 2]), pickle.dumps({"angle": np.zeros(2)})]
)
def test_damaged_parameters_are_unreadable(tree, content):
    folder = folder_of(tree) / "chair" / "fit01"
    (folder / "chair_fit.ply").unlink()
    write_ply(tree / "objects" / "chairblack" / "chairblack_f2500.ply")
    (folder / "chair_fit.pkl").write_bytes(content)
    assert status_of(behave.read_ground_truth, tree, REF) == "ground_truth_unreadable"
