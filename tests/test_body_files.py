"""Body model files: SMPL pickles without chumpy, refusal of unsafe and damaged ones."""

import contextlib
import io
import pickle
import sys
import types
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import sparse

from hoi.body import BodyModel
from hoi.body.files import REQUIRED, read_body_file
from hoi.body.skeleton import NUM_JOINTS, PARENTS
from hoi.errors import AssetError

SMPLH_PARENTS = [*PARENTS[:22]] + [
    start + k - 1 if k % 3 else wrist for wrist, start in ((20, 22), (21, 37)) for k in range(15)
]


def small_body(seed: int = 0, joints: int = NUM_JOINTS, parents=PARENTS) -> dict[str, np.ndarray]:
    """A made-up body of few vertices, shaped like a person as far as the reader looks."""
    random = np.random.default_rng(seed)
    centres = np.zeros((joints, 3))
    for joint in range(joints):
        side = 0.0 if joint in (0, 3, 6, 9, 12, 15) else 0.15 * (1 if joint % 3 == 1 else -1)
        centres[joint] = (side, 0.05 * (12 - min(joint, 12)) if joint < 12 else 0.9, 0.0)
    centres[[10, 11]] += (0, -0.1, 0.1)
    vertices = (centres[:, None] + random.normal(0, 0.03, (joints, 12, 3))).reshape(-1, 3)
    # a few vertices of the head lie on the sagittal plane, as a nose does
    vertices[15 * 12 : 15 * 12 + 4, 0] = 0.0
    count = len(vertices)
    weights = np.repeat(np.eye(joints), 12, axis=0) * 0.9 + 0.1 / joints
    regressor = np.repeat(np.eye(joints), 12, axis=1) / 12
    return {
        "v_template": vertices,
        "f": random.permuted(np.tile(np.arange(count), (60, 1)), axis=1)[:, :3].astype(np.uint32),
        "shapedirs": random.normal(0, 0.01, (count, 3, 10)),
        "posedirs": random.normal(0, 0.001, (count, 3, 9 * (joints - 1))),
        "J_regressor": regressor,
        "weights": weights,
        "kintree_table": np.array([[2**32 - 1, *parents[1:]], range(joints)], dtype=np.int64),
    }


@pytest.fixture
def chumpy_module(monkeypatch):
    """A look-alike of chumpy that exists only while the test writes its file."""
    chumpy, ch, reordering = (
        types.ModuleType(name) for name in ("chumpy", "chumpy.ch", "chumpy.reordering")
    )
    # pickles name the classes by these modules, as files written with chumpy do
    ch.Ch = type("Ch", (), {"__module__": "chumpy.ch"})
    reordering.Select = type("Select", (ch.Ch,), {"__module__": "chumpy.reordering"})
    for module in (chumpy, ch, reordering):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    return types.SimpleNamespace(Ch=ch.Ch, Select=reordering.Select)


def write_npz(path: Path, entries: dict) -> Path:
    np.savez(path, **entries)
    return path


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_smpl_pickle_with_chumpy_and_sparse_arrays_loads_like_the_plain_file(
    tmp_path, chumpy_module, protocol
):
    entries = small_body()
    plain = read_body_file(write_npz(tmp_path / "body.npz", entries))

    whole = chumpy_module.Ch()
    whole.__dict__ = {"x": entries["v_template"]}
    source = chumpy_module.Ch()
    source.__dict__ = {"x": np.concatenate([entries["shapedirs"], entries["shapedirs"]], axis=2)}
    size = source.x.shape
    selected = chumpy_module.Select()
    selected.__dict__ = {
        "a": source,
        "idxs": np.arange(np.prod(size)).reshape(size)[..., :10].ravel(),
        "preferred_shape": entries["shapedirs"].shape,
    }
    stored = entries | {
        "v_template": whole,
        "shapedirs": selected,
        "J_regressor": sparse.csc_matrix(entries["J_regressor"]),
        "bs_style": "lbs",
        "weights_scalar": np.float64(3.5),
    }
    path = tmp_path / "basicmodel.pkl"
    path.write_bytes(pickle.dumps(stored, protocol=protocol))
    for name in ("chumpy", "chumpy.ch", "chumpy.reordering"):
        sys.modules.pop(name)

    loaded = read_body_file(path)
    for field in vars(plain):
        np.testing.assert_allclose(getattr(loaded, field), getattr(plain, field), err_msg=field)
    assert "chumpy" not in sys.modules


class _Runs:
    def __init__(self, function, *arguments):
        self._call = (function, arguments)

    def __reduce__(self):
        return self._call


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        (exec, ("raise SystemExit('ran')",)),
        (eval, ("1",)),
        (__import__, ("os",)),
        (getattr, ("text", "upper")),
        (np.load, ("x",)),
        (Path, ("x",)),
    ],
)
def test_a_pickle_that_asks_for_code_is_refused_and_nothing_runs(tmp_path, function, arguments):
    path = tmp_path / "evil.pkl"
    path.write_bytes(pickle.dumps(small_body() | {"v_template": _Runs(function, *arguments)}))
    with pytest.raises(AssetError, match=r"evil\.pkl.*refused"):
        read_body_file(path)


def test_a_pickle_cannot_reach_code_through_dotted_names(tmp_path):
    path = tmp_path / "evil.pkl"
    path.write_bytes(b"\x80\x04\x8c\x05numpy\x8c\x0cndarray.dump\x93.")
    with pytest.raises(AssetError, match="refused"):
        read_body_file(path)


def test_an_npz_with_pickled_objects_is_refused(tmp_path):
    entries = small_body() | {"v_template": np.array([_Runs(eval, "1")], dtype=object)}
    with pytest.raises(AssetError, match=r"body\.npz"):
        read_body_file(write_npz(tmp_path / "body.npz", entries))


def test_smplh_becomes_24_joints_with_rigid_hands(tmp_path):
    entries = small_body(joints=52, parents=SMPLH_PARENTS)
    data = read_body_file(write_npz(tmp_path / "smplh.npz", entries))
    assert data.weights.shape == (52 * 12, NUM_JOINTS)
    np.testing.assert_allclose(data.weights.sum(1), 1)
    left_hand = entries["weights"][:, 22:37].sum(1)
    np.testing.assert_allclose(data.weights[:, 22], left_hand / entries["weights"].sum(1))
    np.testing.assert_array_equal(data.posedirs[..., :189], entries["posedirs"][..., :189])
    assert not data.posedirs[..., 189:].any()
    BodyModel(data)(torch.zeros(1, 3), torch.zeros(1, 69), torch.zeros(1, 10))


@pytest.mark.parametrize("key", REQUIRED)
def test_a_missing_key_is_named(tmp_path, key):
    entries = small_body()
    del entries[key]
    with pytest.raises(AssetError, match=rf"body\.npz.*'{key}'"):
        read_body_file(write_npz(tmp_path / "body.npz", entries))


@pytest.mark.parametrize("key", REQUIRED)
def test_a_key_of_wrong_shape_or_kind_is_named(tmp_path, key):
    for wrong in (np.zeros((2, 2)), np.array("text"), np.full((3, 3), np.nan)):
        entries = small_body() | {key: wrong}
        with pytest.raises(AssetError, match=rf"body\.npz.*'{key}'"):
            read_body_file(write_npz(tmp_path / "body.npz", entries))


def test_a_face_beyond_the_vertices_is_named(tmp_path):
    entries = small_body()
    entries["f"] = entries["f"] + 10_000
    with pytest.raises(AssetError, match="'f' names a vertex"):
        read_body_file(write_npz(tmp_path / "body.npz", entries))


def test_an_absent_file_says_what_to_set(tmp_path):
    with pytest.raises(AssetError, match=r"nowhere\.npz.*no such body model"):
        BodyModel.load(tmp_path / "nowhere.npz")


@pytest.fixture(scope="module")
def file_bytes() -> dict[str, bytes]:
    entries = small_body()
    stream = io.BytesIO()
    np.savez_compressed(stream, **entries)
    sparse_entries = entries | {"J_regressor": sparse.csc_matrix(entries["J_regressor"])}
    return {".npz": stream.getvalue(), ".pkl": pickle.dumps(sparse_entries)}


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(kind=st.sampled_from([".npz", ".pkl"]), share=st.floats(0, 0.999), data=st.data())
def test_truncated_and_scrambled_files_end_in_an_asset_error_or_load(
    tmp_path, file_bytes, kind, share, data
):
    whole = file_bytes[kind]
    path = tmp_path / f"body{kind}"
    path.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(AssetError, match="body"):
        read_body_file(path)

    scrambled = bytearray(whole)
    position = data.draw(st.integers(0, min(len(whole), 4000) - 1))
    scrambled[position] ^= data.draw(st.integers(1, 255))
    path.write_bytes(bytes(scrambled))
    with contextlib.suppress(AssetError):
        read_body_file(path)
