"""The whole BEHAVE tree as released: four Kinects, SMPL-H fits, scans, the 30 fps extension."""

import json
import pickle

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from behave_tree import TEMPLATE_FACES, BehaveTree, write_json
from hoi.artifacts import Frame, GroundTruth
from hoi.body.smplh import SMPL_JOINTS
from hoi.body.topology import topology
from hoi.datasets import behave
from hoi.datasets.behave_30fps import frame_times
from hoi.datasets.behave_config import BehaveConfig
from hoi.datasets.behave_layout import OBJECTS, frame_ref, object_folder_names
from hoi.errors import AssetError, ConfigError, FrameFailure

CHAIR, BALL = "Date03_Sub03_chairblack_sit", "Date03_Sub03_yogaball"
WOMAN = "Date06_Sub06_stool_lift"
TIME = "t0003.000"


@pytest.fixture
def tree(tmp_path) -> BehaveTree:
    made = BehaveTree(tmp_path / "behave", tmp_path / "smplh")
    made.sequence(CHAIR)
    return made


def settings_of(tree, **changes) -> BehaveConfig:
    return BehaveConfig(root=str(tree.root), smplh=str(tree.smplh)).model_copy(update=changes)


def status_of(call, *arguments) -> str:
    with pytest.raises(FrameFailure) as caught:
        call(*arguments)
    return str(caught.value)


# ---------------------------------------------------------------------------------- cameras


@pytest.mark.parametrize("kinect", range(4))
def test_every_kinect_sees_the_truth_in_its_own_frame(tree, kinect):
    ref, config = frame_ref(CHAIR, TIME), BehaveConfig(kinect=kinect)
    frame = behave.read_frame(tree.root, ref, config)
    assert frame.source.endswith(f"k{kinect}.color.jpg")
    assert frame.intrinsics[0, 0] == pytest.approx((100 + kinect) / 2)
    assert frame.intrinsics_source == f"calibration of Kinect {kinect}, lens distortion ignored"
    assert frame.given_keypoints[0, 1] == kinect + 1  # the file of this camera
    truth = behave.read_ground_truth(tree.root, ref, config)
    rotation, translation = tree.poses[kinect]
    np.testing.assert_allclose(
        truth.object_vertices @ rotation.T + translation, tree.placed(CHAIR, TIME), atol=1e-5
    )
    np.testing.assert_allclose(
        truth.body_vertices @ rotation.T + translation, tree.posed(CHAIR, TIME)[0][0], atol=1e-5
    )


def test_a_sequence_names_its_own_calibrations(tree):
    other = tree.root / "calibs" / "elsewhere" / "2"
    calibration = {"color": {"fx": 7, "fy": 7, "cx": 1, "cy": 1, "width": 64, "height": 48}}
    write_json(other / "calibration.json", calibration)
    path = tree.root / "sequences" / CHAIR / "info.json"
    write_json(path, json.loads(path.read_text()) | {"intrinsic": "../../calibs/elsewhere"})
    frame = behave.read_frame(tree.root, frame_ref(CHAIR, TIME), BehaveConfig(kinect=2))
    assert frame.intrinsics[0, 0] == 7


@pytest.mark.parametrize("key", ["intrinsic", "config"])
@pytest.mark.parametrize("path", ["../../../../etc", "/etc", "..\x00", 3, ["x"]])
def test_a_path_that_leaves_the_data_set_is_refused(tree, key, path):
    info = tree.root / "sequences" / CHAIR / "info.json"
    write_json(info, json.loads(info.read_text()) | {key: path})
    told = status_of(behave.read_frame, tree.root, frame_ref(CHAIR, TIME))
    assert told.startswith("sequence_info_unreadable") and key in told and "info.json" in told


def test_a_tree_without_info_files_falls_back_on_the_layout(tree):
    (tree.root / "sequences" / CHAIR / "info.json").unlink()
    ref = frame_ref(CHAIR, TIME)
    for kinect in range(4):
        config = settings_of(tree, kinect=kinect)
        frame = behave.read_frame(tree.root, ref, config)
        assert frame.intrinsics[0, 0] == pytest.approx((100 + kinect) / 2)
        assert behave.read_ground_truth(tree.root, ref, config).body_joints is not None


def test_a_camera_pose_that_is_no_rotation_is_refused(tree):
    path = tree.root / "calibs" / "Date03" / "config" / "2" / "config.json"
    write_json(path, {"rotation": [2.0] * 9, "translation": [0, 0, 0]})
    told = status_of(
        behave.read_ground_truth, tree.root, frame_ref(CHAIR, TIME), BehaveConfig(kinect=2)
    )
    assert "calibration_unreadable" in told and "2/config.json" in told and "rotation" in told


# ------------------------------------------------------------------------------------ masks


@pytest.mark.parametrize("suffix", ["png", "jpg"])
@pytest.mark.parametrize("stem", ["obj_rend_mask", "obj_mask"])
def test_masks_come_as_png_or_jpg_and_rendered_or_segmented(tree, stem, suffix):
    folder = tree.root / "sequences" / CHAIR / TIME
    (folder / "k1.obj_rend_mask.png").rename(folder / "moved.png")
    with Image.open(folder / "moved.png") as mask:
        mask.save(folder / f"k1.{stem}.{suffix}")
    assert behave.read_frame(tree.root, frame_ref(CHAIR, TIME)).given_object_mask.sum() == 300


def test_the_visible_fraction_survives_a_full_mask_at_half_size(tree):
    ref = frame_ref(CHAIR, TIME)
    assert behave.read_ground_truth(tree.root, ref).visible_fraction == pytest.approx(2 / 3)
    full = tree.root / "sequences" / CHAIR / TIME / "k1.obj_rend_full.png"
    with Image.open(full) as mask:
        mask.resize((32, 24), Image.Resampling.BOX).save(full)
    assert behave.read_ground_truth(tree.root, ref).visible_fraction == pytest.approx(
        2 / 3, abs=0.05
    )
    full.unlink()
    assert behave.read_ground_truth(tree.root, ref).visible_fraction is None


# ------------------------------------------------------------------------------------- fits


@pytest.mark.parametrize(
    ("sequence", "stem"), [(CHAIR, "chair"), (BALL, "sports ball"), (WOMAN, "stool")]
)
def test_fits_are_found_under_the_names_that_objects_share(tree, sequence, stem):
    tree.sequence(sequence)
    ref = frame_ref(sequence, TIME)
    folder = tree.root / "sequences" / sequence / TIME
    assert (folder / stem / "fit01" / f"{stem}_fit.ply").is_file()
    np.testing.assert_allclose(
        behave.read_ground_truth(tree.root, ref).object_vertices,
        tree.placed(sequence, TIME),
        atol=1e-5,
    )
    # the object's own name works, too
    own = ref.object_name
    (folder / stem / "fit01" / f"{stem}_fit.ply").rename(folder / stem / "fit01" / f"{own}_fit.ply")
    (folder / stem / "fit01" / f"{stem}_fit.pkl").unlink(missing_ok=True)
    (folder / stem).rename(folder / own)
    assert behave.read_ground_truth(tree.root, ref).ok


def test_every_object_has_a_place_for_its_fits():
    assert len(OBJECTS) == 20
    assert object_folder_names("basketball") == ("sports ball", "basketball")
    assert all(object_folder_names(name)[-1] == name for name in OBJECTS)


def test_parameters_alone_give_the_mesh_that_the_data_set_stored(tree):
    """SMPL-H posed from pkl, and the scan centred by the mean of all its vertices as stored."""
    ref = frame_ref(CHAIR, TIME)
    stored = behave.read_ground_truth(tree.root, ref)
    for path in (tree.root / "sequences").rglob("*_fit.ply"):
        path.unlink()
    told = status_of(behave.read_ground_truth, tree.root, ref)
    assert "ground_truth_missing" in told and "behave.smplh" in told
    computed = behave.read_ground_truth(tree.root, ref, settings_of(tree))
    np.testing.assert_allclose(computed.body_vertices, stored.body_vertices, atol=1e-5)
    np.testing.assert_allclose(computed.object_vertices, stored.object_vertices, atol=1e-5)
    np.testing.assert_array_equal(computed.object_faces, TEMPLATE_FACES)
    assert computed.body_model == stored.body_model
    joints = tree.posed(CHAIR, TIME)[0].joints
    np.testing.assert_allclose(computed.body_joints, joints[list(SMPL_JOINTS)], atol=1e-5)


def test_the_gender_of_the_sequence_chooses_the_model(tree):
    tree.sequence(WOMAN, gender="female")
    ref = frame_ref(WOMAN, TIME)
    (tree.root / "sequences" / WOMAN / TIME / "person/fit02/person_fit.ply").unlink()
    truth = behave.read_ground_truth(tree.root, ref, settings_of(tree))
    np.testing.assert_allclose(truth.body_vertices, tree.posed(WOMAN, TIME)[0][0], atol=1e-5)
    (tree.smplh / "SMPLH_female.pkl").unlink()
    with pytest.raises(AssetError, match="female"):
        behave.read_ground_truth(tree.root, ref, settings_of(tree))


@pytest.mark.parametrize("root", ["model", "centred"])
def test_joints_lie_in_the_stored_mesh_whatever_the_root_convention(tree, root):
    ref = frame_ref(CHAIR, TIME)
    assert behave.read_ground_truth(tree.root, ref).body_joints is None
    truth = behave.read_ground_truth(tree.root, ref, settings_of(tree, smplh_root=root))
    joints = tree.posed(CHAIR, TIME)[0].joints
    np.testing.assert_allclose(truth.body_joints, joints[list(SMPL_JOINTS)], atol=1e-5)


def test_parameters_that_are_not_of_the_stored_mesh_are_told(tree):
    path = tree.root / "sequences" / CHAIR / "info.json"
    write_json(path, json.loads(path.read_text()) | {"gender": "female"})
    told = status_of(behave.read_ground_truth, tree.root, frame_ref(CHAIR, TIME), settings_of(tree))
    assert "ground_truth_inconsistent" in told and "gender" in told


def test_bodies_of_one_topology_have_one_name(tree):
    tree.sequence(WOMAN, gender="female")
    truths = [behave.read_ground_truth(tree.root, frame_ref(s, TIME)) for s in (CHAIR, WOMAN)]
    faces = tree.models["male"].faces
    assert truths[0].body_model == topology(faces, len(truths[0].body_vertices))
    # same number of vertices, other faces
    assert truths[1].body_model != truths[0].body_model


# ----------------------------------------------------------------------------- 30 fps extension


def test_the_30_fps_fits_replace_the_others(tree, tmp_path):
    times = (TIME, "t0003.033", "t0003.067")
    tree.write_30fps(tmp_path / "extension", CHAIR, times)
    config = settings_of(tree, fits_30fps=str(tmp_path / "extension"))
    ref = frame_ref(CHAIR, TIME)
    truth = behave.read_ground_truth(tree.root, ref, config)
    np.testing.assert_allclose(truth.object_vertices, tree.placed(CHAIR, TIME), atol=1e-5)
    np.testing.assert_allclose(truth.body_vertices, tree.posed(CHAIR, TIME)[0][0], atol=1e-5)
    names = {path.name for path in behave.ground_truth_files(tree.root, ref, config)}
    assert {"smpl_fit_all.npz", "object_fit_all.npz", "SMPLH_male.pkl"} <= names
    assert frame_times(tmp_path / "extension", CHAIR) == times
    assert behave.list_frames(tree.root, "chair", "test", config) == [ref]
    gone = frame_ref(CHAIR, "t0004.000")
    assert "t0004.000" in status_of(behave.read_ground_truth, tree.root, gone, config)


def test_frames_without_30_fps_fits_are_not_listed(tree, tmp_path):
    tree.frame(CHAIR, "t0004.000")
    tree.write_30fps(tmp_path / "extension", CHAIR, ["t0004.000"])
    config = settings_of(tree, fits_30fps=str(tmp_path / "extension"))
    listed = behave.list_frames(tree.root, "chair", "test", config)
    assert [ref.time for ref in listed] == ["t0004.000"]


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("smpl_fit_all.npz", "poses", None),
        ("smpl_fit_all.npz", "poses", np.zeros((1, 72))),
        ("smpl_fit_all.npz", "betas", np.full((1, 10), np.nan)),
        ("smpl_fit_all.npz", "trans", np.array([["a", "b", "c"]])),
        ("object_fit_all.npz", "angles", None),
        ("object_fit_all.npz", "frame_times", None),
        ("object_fit_all.npz", "frame_times", np.array(["../../x"])),
        ("object_fit_all.npz", "frame_times", np.array([3.0])),
    ],
)
def test_damage_in_the_extension_names_file_and_key(tree, tmp_path, name, key, value):
    tree.write_30fps(tmp_path, CHAIR, [TIME])
    path = tmp_path / CHAIR / name
    with np.load(path) as archive:
        content = {k: archive[k] for k in archive.files if k != key}
    np.savez(path, **content if value is None else content | {key: value})
    config = settings_of(tree, fits_30fps=str(tmp_path))
    told = status_of(behave.read_ground_truth, tree.root, frame_ref(CHAIR, TIME), config)
    assert "ground_truth_unreadable" in told and name in told and key in told


# ----------------------------------------------------------------------------------- listing


def test_dates_and_every_n_th_frame_can_be_chosen(tree):
    for second in (4, 5, 6, 7):
        tree.frame(CHAIR, f"t000{second}.000")
    tree.sequence(WOMAN, gender="female")

    def listed(**changes):
        return behave.list_frames(tree.root, "chair", "test", BehaveConfig(**changes))

    assert len(listed()) == 6
    assert {ref.sequence for ref in listed(dates=("Date03",))} == {CHAIR}
    thinned = [ref.time for ref in listed(every=2) if ref.sequence == CHAIR]
    assert thinned == ["t0003.000", "t0005.000", "t0007.000"]


@pytest.mark.parametrize("form", ["txt", "json", "pkl"])
def test_a_published_list_of_frames_replaces_the_split(tree, tmp_path, form):
    tree.frame(CHAIR, "t0004.000")
    tree.frame(CHAIR, "t0005.000")
    paths = [
        f"/data/behave/sequences/{CHAIR}/t0004.000/k1.color.jpg",
        f"{CHAIR}/t0005.000/k2.color.jpg",
    ]
    path = tmp_path / f"test.{form}"
    if form == "txt":
        path.write_text("# a comment\n" + "\n".join(paths) + "\n\n")
    else:
        content = {"train": [], "test": paths}
        data = json.dumps(content).encode() if form == "json" else pickle.dumps(content)
        path.write_bytes(data)
    for kinect, time in ((1, "t0004.000"), (2, "t0005.000")):
        config = BehaveConfig(frame_list=str(path), kinect=kinect)
        listed = behave.list_frames(tree.root, "chair", "test", config)
        assert [ref.time for ref in listed] == [time]


@pytest.mark.parametrize(
    "content",
    [b"\xff\xfe", b"../../etc/passwd", b"Date03_Sub03_chair..black/t0003.000", b"x/t0003.000/y"],
)
def test_a_damaged_list_of_frames_is_named(tree, tmp_path, content):
    path = tmp_path / "list.txt"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"list\.txt"):
        behave.list_frames(tree.root, "chair", "test", BehaveConfig(frame_list=str(path)))


# ----------------------------------------------------------------------------------- fuzzing


def readable_files(tree) -> list:
    """One file of every kind that the reader opens for the chair's frame."""
    config = settings_of(tree)
    ref = frame_ref(CHAIR, TIME)
    files = {
        *behave.frame_files(tree.root, ref),
        *behave.ground_truth_files(tree.root, ref, config),
    }
    folder = tree.root / "sequences" / CHAIR / TIME
    return sorted(files | {folder / "chair/fit01/chair_fit.pkl"})


@pytest.mark.parametrize("how", ["truncated", "scrambled", "not utf-8", "another type"])
def test_no_damage_to_any_file_ends_in_anything_but_a_reason(tree, how):
    config = settings_of(tree)
    ref = frame_ref(CHAIR, TIME)
    random = np.random.default_rng(0)
    for path in readable_files(tree):
        whole = path.read_bytes()
        hidden = None
        if path.name == "chair_fit.pkl":  # read only where the mesh is not there
            hidden = path.with_suffix(".ply").read_bytes()
            path.with_suffix(".ply").unlink()
        for _ in range(2):
            if how == "truncated":
                damaged = whole[: random.integers(len(whole))]
            elif how == "scrambled":
                damaged = bytearray(whole)
                for position in random.integers(len(whole), size=3):
                    damaged[position] ^= int(random.integers(1, 256))
            else:
                damaged = b"\xff\xfe\x00\x80" * 9 if how == "not utf-8" else b'{"a": [3, {}]}'
            path.write_bytes(bytes(damaged))
            for read, kind in ((behave.read_frame, Frame), (behave.read_ground_truth, GroundTruth)):
                try:
                    assert isinstance(read(tree.root, ref, config), kind)
                except (FrameFailure, AssetError) as error:
                    assert len(str(error)) > 20
        path.write_bytes(whole)
        if hidden is not None:
            path.with_suffix(".ply").write_bytes(hidden)
    assert behave.read_frame(tree.root, ref, config).ok


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    content=st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner),
        max_leaves=8,
    ),
    name=st.sampled_from(["info.json", "k1.color.json", "calibration.json", "split.json"]),
)
def test_any_json_in_place_of_a_known_file_is_read_or_refused(tree_once, content, name):
    path = next(p for p in sorted(tree_once.root.rglob(name)) if p.parent.name not in "023")
    whole = path.read_bytes()
    path.write_text(json.dumps(content), encoding="utf-8")
    try:
        behave.list_frames(tree_once.root, "chair", "test")
        behave.read_frame(tree_once.root, frame_ref(CHAIR, TIME))
    except (FrameFailure, ConfigError) as error:
        assert name in str(error)
    finally:
        path.write_bytes(whole)


@pytest.fixture(scope="module")
def tree_once(tmp_path_factory) -> BehaveTree:
    folder = tmp_path_factory.mktemp("behave")
    made = BehaveTree(folder / "behave", folder / "smplh")
    made.sequence(CHAIR)
    return made


class _Runs:
    def __reduce__(self):
        return print, ("owned",)


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ({"pose": _Runs(), "betas": np.zeros(10), "trans": np.zeros(3)}, "refused"),
        ({"pose": np.zeros(72), "betas": np.zeros(10), "trans": np.zeros(3)}, "'pose'"),
        ({"pose": np.zeros(156), "trans": np.zeros(3)}, "'betas'"),
        ({"pose": np.zeros(156), "betas": ["a"] * 10, "trans": np.zeros(3)}, "'betas'"),
        ({"pose": np.zeros(156), "betas": np.zeros(10), "trans": np.full(3, np.inf)}, "'trans'"),
        ([1, 2], "dictionary"),
        ({3: 4}, "dictionary"),
    ],
)
def test_damaged_person_parameters_are_named_and_run_nothing(tree, capsys, content, named):
    folder = tree.root / "sequences" / CHAIR / TIME / "person" / "fit02"
    (folder / "person_fit.ply").unlink()
    (folder / "person_fit.pkl").write_bytes(pickle.dumps(content))
    told = status_of(behave.read_ground_truth, tree.root, frame_ref(CHAIR, TIME), settings_of(tree))
    assert "ground_truth_unreadable" in told and "person_fit.pkl" in told and named in told
    assert "owned" not in capsys.readouterr().out
