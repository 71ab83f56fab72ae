"""Reading body model files: SMPL-format ``.npz`` and SMPL's own ``.pkl``, without chumpy.

A pickle may run any code when it is loaded. SMPL's pickles need numpy arrays, scipy sparse
matrices and chumpy arrays only, so the reader here resolves exactly those names, the last two to
inert stand-ins, and refuses a file that asks for anything else.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hoi.body.keypoints import SURFACE_KEYPOINTS, derive_surface_regressor
from hoi.body.skeleton import NUM_JOINTS, PARENTS
from hoi.errors import AssetError
from hoi.plain_pickle import PLAIN, RestrictedUnpickler

REQUIRED = (
    "v_template",
    "f",
    "shapedirs",
    "posedirs",
    "J_regressor",
    "weights",
    "kintree_table",
)
_SMPLH_JOINTS = 52
_SMPLH_PARENTS = (
    *PARENTS[:22],
    *(20, 22, 23, 20, 25, 26, 20, 28, 29, 20, 31, 32, 20, 34, 35),
    *(21, 37, 38, 21, 40, 41, 21, 43, 44, 21, 46, 47, 21, 49, 50),
)


@dataclass(frozen=True)
class BodyFile:
    """The content of a body model file, checked: V vertices, F faces, K shape components."""

    v_template: np.ndarray  # (V, 3) metres, T-pose, y up, +z front, +x the person's left
    faces: np.ndarray  # (F, 3) int64
    shapedirs: np.ndarray  # (V, 3, K) metres per unit of betas
    posedirs: np.ndarray  # (V, 3, 207) metres per entry of (R - I)
    joint_regressor: np.ndarray  # (24, V)
    weights: np.ndarray  # (V, 24) rows sum to one
    keypoint_regressor: np.ndarray  # (9, V) rows of SURFACE_KEYPOINTS


def read_body_file(path: Path | str) -> BodyFile:
    """Read and check a body model file.

    SMPL-H files (52 joints) are reduced to SMPL's 24: each hand becomes one rigid joint in the
    place of its middle knuckle.

    Raises:
        AssetError: the file is absent, damaged, unsafe or not a 24-joint SMPL-format model; the
            message names the file and the key.
    """
    path = Path(path)
    entries = _entries(path)
    arrays = {key: _numbers(path, key, entries.get(key)) for key in REQUIRED}
    if arrays["kintree_table"].shape[-1] == _SMPLH_JOINTS:
        arrays = _reduce_smplh(path, arrays)
    _check(path, arrays)
    return _assemble(path, arrays, entries)


@dataclass(frozen=True)
class SmplhFile:
    """The content of an SMPL-H file with all of its 52 joints, checked; units as `BodyFile`."""

    v_template: np.ndarray  # (V, 3)
    faces: np.ndarray  # (F, 3) int64
    shapedirs: np.ndarray  # (V, 3, K)
    posedirs: np.ndarray  # (V, 3, 459)
    joint_regressor: np.ndarray  # (52, V)
    weights: np.ndarray  # (V, 52)
    parents: tuple[int, ...]  # of every joint; -1 for the root


def read_smplh_file(path: Path | str) -> SmplhFile:
    """Read and check an SMPL-H file (MANO v1.2 ``SMPLH_male.pkl``, AMASS's ``model.npz``).

    Raises AssetError naming file and key, also for a model of another number of joints.
    """
    path = Path(path)
    entries = _entries(path)
    arrays = {key: _numbers(path, key, entries.get(key)) for key in REQUIRED}
    joints = arrays["kintree_table"].shape[-1] if arrays["kintree_table"].ndim == 2 else 0
    if joints != _SMPLH_JOINTS:
        raise AssetError(f"{path}: the key 'kintree_table' has {joints} joints, SMPL-H has 52")
    _check(path, arrays, _SMPLH_PARENTS)
    return SmplhFile(
        v_template=arrays["v_template"].astype(np.float64),
        faces=np.ascontiguousarray(arrays["f"], dtype=np.int64),
        shapedirs=arrays["shapedirs"].astype(np.float64),
        posedirs=arrays["posedirs"].astype(np.float64),
        joint_regressor=arrays["J_regressor"].astype(np.float64),
        weights=arrays["weights"].astype(np.float64),
        parents=_SMPLH_PARENTS,
    )


def _entries(path: Path) -> dict[str, Any]:
    """The named entries of a body model file, as they are stored."""
    if not path.is_file():
        raise AssetError(f"{path}: no such body model file; set the path of an SMPL .npz or .pkl")
    try:
        return _read_npz(path) if path.suffix == ".npz" else _read_pickle(path)
    except AssetError:
        raise
    except Exception as error:  # a damaged zip or pickle raises nearly every kind of exception
        raise AssetError(f"{path}: not a readable body model file: {error}") from error


def _read_npz(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as archive:
        wanted = (*REQUIRED, "keypoint_regressor")  # some files carry pickled extras: not read
        return {key: archive[key] for key in wanted if key in archive.files}


def _numbers(path: Path, key: str, value: Any) -> np.ndarray:
    """The entry as a finite numeric array."""
    if value is None:
        raise AssetError(f"{path}: the key {key!r} is missing; this is no SMPL-format body model")
    try:
        array = np.asarray(value.dense() if isinstance(value, _Stub) else value)
    except Exception as error:
        raise AssetError(f"{path}: the key {key!r} is damaged: {error}") from error
    if array.dtype.kind not in "iuf":
        raise AssetError(f"{path}: the key {key!r} holds {array.dtype} values, expected numbers")
    if not np.isfinite(array).all():
        raise AssetError(f"{path}: the key {key!r} holds NaN or infinity")
    return array


def _check(path: Path, arrays: dict[str, np.ndarray], parents: tuple[int, ...] = PARENTS) -> None:
    joints = len(parents)
    count = len(arrays["v_template"]) if arrays["v_template"].ndim else 0
    expected = {
        "v_template": (count, 3),
        "f": (None, 3),
        "shapedirs": (count, 3, None),
        "posedirs": (count, 3, 9 * (joints - 1)),
        "J_regressor": (joints, count),
        "weights": (count, joints),
        "kintree_table": (2, joints),
    }
    for key, shape in expected.items():
        have = arrays[key].shape
        if len(have) != len(shape) or any(
            want is not None and want != got for want, got in zip(shape, have, strict=True)
        ):
            raise AssetError(f"{path}: the key {key!r} has shape {have}, expected {shape}")
    if count == 0 or len(arrays["f"]) == 0:
        raise AssetError(f"{path}: the key 'v_template' or 'f' is empty")
    if tuple(_parents(arrays["kintree_table"])) != parents:
        raise AssetError(
            f"{path}: the key 'kintree_table' is not the tree of {joints} joints that it should be"
        )
    if arrays["f"].min() < 0 or arrays["f"].max() >= count:
        raise AssetError(f"{path}: the key 'f' names a vertex outside 0..{count - 1}")
    if (arrays["weights"].sum(1) <= 0).any():
        raise AssetError(f"{path}: the key 'weights' leaves a vertex without any joint")


def _parents(kintree_table: np.ndarray) -> np.ndarray:
    """The parents as signed numbers; files mark the root by 2^32 - 1 or by -1."""
    parents = kintree_table[0].astype(np.int64)
    parents[0] = -1
    return parents


def _assemble(path: Path, arrays: dict[str, np.ndarray], entries: dict[str, Any]) -> BodyFile:
    def double(key: str) -> np.ndarray:
        return arrays[key].astype(np.float64)

    vertices, weights = double("v_template"), double("weights")
    weights = weights / weights.sum(1, keepdims=True)
    if entries.get("keypoint_regressor") is not None:
        keypoints = _numbers(path, "keypoint_regressor", entries["keypoint_regressor"])
        if keypoints.shape != (len(SURFACE_KEYPOINTS), len(vertices)):
            raise AssetError(f"{path}: the key 'keypoint_regressor' has shape {keypoints.shape}")
    else:
        try:
            joints = double("J_regressor") @ vertices
            keypoints = derive_surface_regressor(vertices, weights, joints)
        except ValueError as error:
            raise AssetError(
                f"{path}: the key 'v_template' is no T-posed body with y up and z to the front: "
                "head or feet were not found"
            ) from error
    return BodyFile(
        v_template=vertices,
        faces=np.ascontiguousarray(arrays["f"], dtype=np.int64),
        shapedirs=double("shapedirs"),
        posedirs=double("posedirs"),
        joint_regressor=double("J_regressor"),
        weights=weights,
        keypoint_regressor=keypoints.astype(np.float64),
    )


def _reduce_smplh(path: Path, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """SMPL-H's 52 joints as SMPL's 24: finger weights go to one joint a hand."""
    if tuple(_parents(arrays["kintree_table"])) != _SMPLH_PARENTS:
        raise AssetError(f"{path}: the key 'kintree_table' is not SMPL-H's tree of 52 joints")
    middle_knuckles = (25, 40)
    weights, posedirs = arrays["weights"], arrays["posedirs"]
    if weights.shape[1:] != (_SMPLH_JOINTS,) or posedirs.shape[2:] != (9 * (_SMPLH_JOINTS - 1),):
        raise AssetError(f"{path}: the keys 'weights' and 'posedirs' do not match 52 joints")
    fingers = [weights[:, 22:37].sum(1, keepdims=True), weights[:, 37:52].sum(1, keepdims=True)]
    body_dirs = posedirs[..., : 9 * 21]
    return arrays | {
        "weights": np.concatenate([weights[:, :22], *fingers], axis=1),
        "posedirs": np.concatenate([body_dirs, np.zeros((*body_dirs.shape[:2], 18))], axis=2),
        "J_regressor": arrays["J_regressor"][[*range(22), *middle_knuckles]],
        "kintree_table": np.array([PARENTS, range(NUM_JOINTS)]),
    }


# ------------------------------------------------------------------------- pickles, safely


class _Stub:
    """Stands in for an object of a library that is not loaded: keeps its state, does nothing."""

    state: dict[str, Any]

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, dict):
            raise pickle.UnpicklingError("unexpected object state")
        self.state = state

    def dense(self) -> np.ndarray:
        raise NotImplementedError


class _ChumpyArray(_Stub):
    """chumpy.Ch (array in ``x``) or chumpy's selection (array ``a`` at flat ``idxs``)."""

    def dense(self) -> np.ndarray:
        if "x" in self.state:
            return np.asarray(self.state["x"])
        source = self.state["a"]
        values = source.dense() if isinstance(source, _Stub) else np.asarray(source)
        picked = values.ravel()[np.asarray(self.state["idxs"], dtype=np.int64)]
        return picked.reshape(self.state.get("preferred_shape", -1))


class _SparseMatrix(_Stub):
    """A scipy compressed sparse matrix, rebuilt from its three arrays."""

    by_column = False

    def dense(self) -> np.ndarray:
        from scipy import sparse

        kind = sparse.csc_matrix if self.by_column else sparse.csr_matrix
        parts = tuple(np.asarray(self.state[key]) for key in ("data", "indices", "indptr"))
        matrix = kind(parts, shape=tuple(self.state.get("_shape") or self.state["shape"]))
        matrix.check_format(full_check=True)
        return matrix.toarray()


class _CscMatrix(_SparseMatrix):
    by_column = True


class _CooMatrix(_Stub):
    """A scipy coordinate matrix, as converters of SMPL-H files write it."""

    def dense(self) -> np.ndarray:
        rows, columns = self.state.get("coords") or (self.state["row"], self.state["col"])
        rows, columns = (np.asarray(index, dtype=np.int64) for index in (rows, columns))
        shape = tuple(int(n) for n in self.state.get("_shape") or self.state["shape"])
        if len(shape) != 2 or min(rows.min(initial=0), columns.min(initial=0)) < 0:
            raise ValueError("a sparse matrix with impossible indices")
        matrix = np.zeros(shape)
        np.add.at(matrix, (rows, columns), np.asarray(self.state["data"]))
        return matrix


def _new_stub(cls: type, base: type, state: Any) -> _Stub:
    """What old pickles call to make an object; here it makes stand-ins only."""
    if not (isinstance(cls, type) and issubclass(cls, _Stub)) or base is not object:
        raise pickle.UnpicklingError("the file asks for an object of an unexpected class")
    return cls()


def _allowed() -> dict[tuple[str, str], Any]:
    names = dict(PLAIN)
    for module in ("copy_reg", "copyreg"):
        names[module, "_reconstructor"] = _new_stub
    for module in ("__builtin__", "builtins"):
        names[module, "object"] = object
    for form, stub in (("csc", _CscMatrix), ("csr", _SparseMatrix), ("coo", _CooMatrix)):
        for module in (f"scipy.sparse.{form}", f"scipy.sparse._{form}", "scipy.sparse"):
            names[module, f"{form}_matrix"] = stub
            names[module, f"{form}_array"] = stub
    return names


_ALLOWED = _allowed()


class _BodyUnpickler(RestrictedUnpickler):
    """Plain data, sparse matrices and whatever chumpy class a file names."""

    def find_class(self, module: str, name: str) -> Any:
        if module == "chumpy" or module.startswith("chumpy."):
            return _ChumpyArray
        return super().find_class(module, name)


def _read_pickle(path: Path) -> dict[str, Any]:
    content = _BodyUnpickler(path.read_bytes(), _ALLOWED).load()
    if not isinstance(content, dict):
        raise AssetError(f"{path}: holds a {type(content).__name__}, expected a dictionary")
    return content
