"""SMPL and SMPL-H files: what they pose to, against independent implementations."""

import pickle
import sys

import numpy as np
import pytest
import torch
from scipy import sparse
from scipy.spatial.transform import Rotation

from hoi.body import BodyModel
from hoi.body.files import read_smplh_file
from hoi.body.skeleton import PARENTS
from hoi.body.smplh import SMPL_JOINTS, SmplhModel, smplh_path
from hoi.errors import AssetError
from test_body_files import SMPLH_PARENTS, chumpy_module, small_body  # noqa: F401 - a fixture


def published_equations(entries, pose, betas, trans):
    """SMPL's Eqs. 2-10 (Loper et al. 2015) as printed, from the file's own entries.

    Four-by-four matrices and a product along the ancestors of each joint; shares no code and no
    formulation with the package.
    """
    parents = [int(p) for p in entries["kintree_table"][0]]
    parents[0] = -1
    count = len(parents)
    axes = np.asarray(pose, float).reshape(count, 3)

    def rodrigues(w):
        angle = np.linalg.norm(w)
        skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]) / (angle or 1.0)
        return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew

    rotations = [rodrigues(w) for w in axes]
    shape_offset = sum(b * entries["shapedirs"][:, :, k] for k, b in enumerate(betas))  # Eq. 8
    shaped = entries["v_template"] + shape_offset
    rest = entries["J_regressor"] @ shaped  # Eq. 10
    entry, pose_offset = 0, np.zeros_like(shaped)
    for rotation in rotations[1:]:  # Eq. 9
        for value in (rotation - np.eye(3)).ravel():
            pose_offset += value * entries["posedirs"][:, :, entry]
            entry += 1
    posed = shaped + pose_offset  # Eq. 6

    def chain(joint):  # Eq. 4
        ancestors = []
        while joint >= 0:
            ancestors.append(joint)
            joint = parents[joint]
        world = np.eye(4)
        for node in reversed(ancestors):
            step = np.eye(4)
            step[:3, :3] = rotations[node]
            step[:3, 3] = rest[node] - (rest[parents[node]] if parents[node] >= 0 else 0)
            world = world @ step
        return world

    worlds = [chain(joint) for joint in range(count)]
    weights = entries["weights"] / entries["weights"].sum(1, keepdims=True)
    vertices = np.zeros_like(posed)
    for joint, world in enumerate(worlds):  # Eqs. 2 and 3
        unpose = np.eye(4)
        unpose[:3, 3] = -rest[joint]
        moved = np.c_[posed, np.ones(len(posed))] @ (world @ unpose).T
        vertices += weights[:, [joint]] * moved[:, :3]
    return vertices + trans, np.stack([world[:3, 3] for world in worlds]) + trans


def parameters(joints: int, seed: int = 0):
    random = np.random.default_rng(seed)
    return random.normal(0, 0.5, 3 * joints), random.normal(0, 1, 10), random.normal(0, 1, 3)


def write(path, entries):
    if path.suffix == ".npz":
        np.savez(path, **entries)
    else:
        path.write_bytes(pickle.dumps(entries, protocol=2))
    return path


def posed_by(model: BodyModel, pose, betas, trans):
    tensors = (torch.as_tensor(v)[None] for v in (pose[:3], pose[3:], betas, trans))
    vertices, joints = model(*tensors)
    return vertices[0].numpy(), joints[0].numpy()


@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
@pytest.mark.parametrize("regressor", [np.asarray, sparse.csc_matrix, sparse.coo_matrix])
def test_an_smpl_file_poses_to_the_published_equations(tmp_path, suffix, regressor):
    entries = small_body(seed=1)
    if suffix == ".npz" and regressor is not np.asarray:
        pytest.skip("npz files hold dense arrays")
    stored = entries | {"J_regressor": regressor(entries["J_regressor"])}
    model = BodyModel.load(write(tmp_path / f"SMPL{suffix}", stored), dtype=torch.float64)
    for seed in range(2):
        given = parameters(24, seed)
        expected = published_equations(entries, *given)
        for have, want in zip(posed_by(model, *given), expected, strict=True):
            np.testing.assert_allclose(have, want, atol=1e-10)


def test_an_smpl_file_with_chumpy_arrays_poses_to_the_published_equations(
    tmp_path,
    chumpy_module,  # noqa: F811
):
    entries = small_body(seed=2)
    stored = dict(entries)
    for key in ("v_template", "shapedirs", "posedirs", "weights"):
        stored[key] = chumpy_module.Ch()
        stored[key].__dict__ = {"x": entries[key]}
    path = write(tmp_path / "basicmodel_m_lbs_10_207_0_v1.0.0.pkl", stored)
    for name in ("chumpy", "chumpy.ch", "chumpy.reordering"):
        sys.modules.pop(name)
    model = BodyModel.load(path, dtype=torch.float64)
    given = parameters(24)
    for have, want in zip(
        posed_by(model, *given), published_equations(entries, *given), strict=True
    ):
        np.testing.assert_allclose(have, want, atol=1e-10)


@pytest.fixture(scope="module")
def smplh_entries():
    return small_body(seed=3, joints=52, parents=SMPLH_PARENTS)


@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
def test_an_smplh_file_poses_to_the_published_equations_fingers_included(
    tmp_path, smplh_entries, suffix
):
    model = SmplhModel.load(write(tmp_path / f"SMPLH_male{suffix}", smplh_entries))
    given = parameters(52)
    have = model.pose(*given)
    want = published_equations(smplh_entries, *given)
    np.testing.assert_allclose(have.vertices, want[0], atol=1e-10)
    np.testing.assert_allclose(have.joints, want[1], atol=1e-10)


def test_the_two_root_conventions_differ_by_the_rest_pelvis(tmp_path, smplh_entries):
    model = SmplhModel.load(write(tmp_path / "SMPLH_male.pkl", smplh_entries))
    pose, betas, trans = parameters(52, 4)
    as_model, centred = (model.pose(pose, betas, trans, root) for root in ("model", "centred"))
    np.testing.assert_allclose(centred.joints[0], trans, atol=1e-12)
    shaped = smplh_entries["v_template"] + smplh_entries["shapedirs"] @ betas
    pelvis = (smplh_entries["J_regressor"] @ shaped)[0]
    np.testing.assert_allclose(as_model.vertices - centred.vertices, pelvis + 0 * centred.vertices)


def test_smplh_read_as_a_24_joint_body_agrees_where_the_hands_are_flat(tmp_path, smplh_entries):
    """The reduced model is exact for a pose without fingers."""
    path = write(tmp_path / "SMPLH_female.npz", smplh_entries)
    pose, betas, trans = parameters(52, 5)
    pose[3 * 22 :] = 0
    full = SmplhModel.load(path).pose(pose, betas, trans)
    reduced = BodyModel.load(path, dtype=torch.float64)
    vertices, joints = posed_by(reduced, np.r_[pose[: 3 * 22], np.zeros(6)], betas, trans)
    np.testing.assert_allclose(vertices, full.vertices, atol=1e-10)
    np.testing.assert_allclose(joints, full.joints[list(SMPL_JOINTS)], atol=1e-10)


@pytest.mark.parametrize(
    "name", ["SMPLH_male.pkl", "SMPLH_MALE.pkl", "SMPLH_MALE.npz", "male/model.npz"]
)
def test_the_model_of_a_gender_is_found_under_its_usual_names(tmp_path, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).touch()
    assert smplh_path(tmp_path, "male") == tmp_path / name
    with pytest.raises(AssetError, match=r"female.*SMPLH_female\.pkl"):
        smplh_path(tmp_path, "female")
    with pytest.raises(AssetError, match=r"unknown gender"):
        smplh_path(tmp_path, "../male")


def test_an_smpl_file_is_no_smplh_file(tmp_path):
    with pytest.raises(AssetError, match=r"body\.npz.*'kintree_table' has 24 joints"):
        read_smplh_file(write(tmp_path / "body.npz", small_body()))


# ----------------------------------------------------------------------------- against smplx


SMPLX_ATOL = 1e-6  # metres; smplx adds 1e-8 to every rotation vector before taking its length


def wide_body(joints, parents):
    """A made-up body of 6890 vertices: smplx picks landmarks by SMPL's vertex numbers."""
    random = np.random.default_rng(7)
    small = small_body(joints=joints, parents=parents)
    chosen = random.integers(len(small["v_template"]), size=6890)
    wide = {key: small[key][chosen] for key in ("v_template", "shapedirs", "posedirs", "weights")}
    wide["weights"] = wide["weights"] / wide["weights"].sum(1, keepdims=True)
    regressor = random.random((joints, 6890))
    wide["J_regressor"] = regressor / regressor.sum(1, keepdims=True)
    return small | wide | {"f": random.integers(6890, size=(50, 3)).astype(np.uint32)}


def test_an_smpl_file_poses_as_smplx_does(tmp_path):
    smplx = pytest.importorskip("smplx")
    entries = wide_body(24, PARENTS)
    path = write(tmp_path / "SMPL_NEUTRAL.pkl", entries)
    pose, betas, trans = (torch.as_tensor(v)[None] for v in parameters(24))
    theirs = smplx.SMPL(str(path), dtype=torch.float64)(
        betas=betas, body_pose=pose[:, 3:], global_orient=pose[:, :3], transl=trans
    )
    ours = BodyModel.load(path, dtype=torch.float64)(pose[:, :3], pose[:, 3:], betas, trans)
    np.testing.assert_allclose(ours.vertices, theirs.vertices.detach(), atol=SMPLX_ATOL)
    np.testing.assert_allclose(ours.joints, theirs.joints[:, :24].detach(), atol=SMPLX_ATOL)


def test_an_smplh_file_poses_as_smplx_does(tmp_path):
    smplx = pytest.importorskip("smplx")
    hands = {
        f"hands_{what}{side}": value
        for side in "lr"
        for what, value in (("components", np.eye(45)), ("mean", np.zeros(45)))
    }
    path = write(tmp_path / "SMPLH_MALE.pkl", wide_body(52, SMPLH_PARENTS) | hands)
    pose, betas, trans = parameters(52)
    tensors = {
        "global_orient": pose[:3], "body_pose": pose[3:66], "left_hand_pose": pose[66:111],
        "right_hand_pose": pose[111:], "betas": betas, "transl": trans,
    }  # fmt: skip
    theirs = smplx.SMPLH(
        str(path), dtype=torch.float64, use_pca=False, flat_hand_mean=True, gender="male"
    )(**{key: torch.as_tensor(value)[None] for key, value in tensors.items()})
    ours = SmplhModel.load(path).pose(pose, betas, trans)
    np.testing.assert_allclose(ours.vertices, theirs.vertices[0].detach(), atol=SMPLX_ATOL)
    np.testing.assert_allclose(ours.joints, theirs.joints[0, :52].detach(), atol=SMPLX_ATOL)


def test_rotations_of_the_oracle_are_rotations():
    """The oracle's own Rodrigues formula, so that both sides cannot share a mistake."""
    entries = small_body()
    pose = np.zeros(72)
    pose[:3] = (0.3, -0.2, 0.9)
    _, joints = published_equations(entries, pose, np.zeros(10), np.zeros(3))
    rest = entries["J_regressor"] @ entries["v_template"]
    turned = Rotation.from_rotvec(pose[:3]).as_matrix()
    np.testing.assert_allclose(joints - joints[0], (rest - rest[0]) @ turned.T, atol=1e-12)
