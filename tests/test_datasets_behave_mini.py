"""The generated data set: it reads back as BEHAVE, it is consistent, and its bytes are fixed."""

import json
import subprocess
import sys

import numpy as np
import pytest

from hoi.datasets import behave
from hoi.datasets.behave_layout import TABLE_GROUPS, frame_folder
from hoi.datasets.behave_mini import BehaveMiniConfig, plan
from hoi.datasets.behave_mini.plan import group_actions, split_table
from hoi.errors import ConfigError
from hoi.geometry import project
from hoi.plain_pickle import load_plain

CONFIG = BehaveMiniConfig(image_width=512, frames_per_action=1)


def files_of(root):
    return {p.relative_to(root): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def refs():
    """A sitter, a lifter and a bag on a back."""
    chosen = [r for r in plan(CONFIG, "chair", "test") if r.action in ("sit", "lift")]
    return chosen + [r for r in plan(CONFIG, "backpack", "tune") if r.action == "back"]


@pytest.fixture(scope="module")
def root(tmp_path_factory, refs):
    from hoi.datasets.behave_mini.generate import generate_frames

    folder = tmp_path_factory.mktemp("behave_mini")
    generate_frames(CONFIG, folder, refs)
    return folder


# ------------------------------------------------------------------------------------ plan


@pytest.mark.parametrize("group", TABLE_GROUPS)
@pytest.mark.parametrize("split", ["test", "tune"])
def test_every_action_gets_its_frames_and_more_frames_keep_the_first(group, split):
    few, many = (plan(BehaveMiniConfig(frames_per_action=n), group, split) for n in (2, 7))
    assert len(set(few)) == 2 * len(group_actions(group))
    assert set(few) < set(many)
    assert many == sorted(many)
    for action in group_actions(group):
        assert sum(ref.action == action for ref in many) == 7
    assert {ref.sequence for ref in many} <= set(split_table()[split])


def test_splits_share_no_sequence_and_unknown_ones_are_refused():
    table = split_table()
    assert not set(table["test"]) & set(table["tune"])
    with pytest.raises(ConfigError, match="train"):
        plan(CONFIG, "chair", "train")
    with pytest.raises(ConfigError, match="sofa"):
        plan(CONFIG, "sofa", "test")


def test_planning_loads_nothing_heavy():
    code = (
        "import sys; from hoi.datasets.behave_mini import BehaveMiniConfig, plan;"
        "plan(BehaveMiniConfig(), 'chair', 'test');"
        "print([m for m in ('torch', 'open3d', 'numpy', 'cv2', 'numba') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_test_and_tune_objects_are_different_meshes_and_no_exemplar_candidates():
    from hoi.datasets.behave_mini.things import object_pool
    from hoi.exemplars.furniture import load_furniture

    seen: dict[str, str] = {}
    for group in TABLE_GROUPS.values():
        for name in group:
            for split in ("test", "tune"):
                for thing in object_pool(name, split):
                    key = thing.mesh.geometry_hash
                    assert key not in seen, f"{thing.mesh.name} is also {seen.get(key)}"
                    seen[key] = f"{name} {split}"
                    pool = load_furniture("exemplar_pool", thing.mesh.category)
                    assert key not in {mesh.geometry_hash for mesh in pool}


# --------------------------------------------------------------------------- what is written


def silhouettes(truth, intrinsics, height, width):
    from hoi.rendering import depth_map

    body = depth_map(truth.body_vertices, truth.body_faces, intrinsics, height, width)
    thing = depth_map(truth.object_vertices, truth.object_faces, intrinsics, height, width)
    return body, thing


def iou(first, second):
    return (first & second).sum() / (first | second).sum()


def test_masks_are_the_silhouettes_of_the_true_meshes(root, refs):
    for ref in refs:
        frame = behave.read_frame(root, ref, dataset="behave_mini")
        truth = behave.read_ground_truth(root, ref)
        height, width = frame.image.shape[:2]
        body, thing = silhouettes(truth, frame.intrinsics, height, width)
        assert iou((body < thing) & np.isfinite(body), frame.given_person_mask) > 0.97
        assert iou((thing < body) & np.isfinite(thing), frame.given_object_mask) > 0.97
        share = frame.given_object_mask.sum() / np.isfinite(thing).sum()
        assert truth.visible_fraction == pytest.approx(share, abs=0.02)
        assert truth.visible_fraction >= CONFIG.min_visible_fraction


def test_simulated_keypoints_lie_near_the_projected_joints(root, refs):
    from hoi.body.keypoints import KEYPOINTS
    from hoi.body.skeleton import JOINT

    for ref in refs:
        frame, truth = behave.read_frame(root, ref), behave.read_ground_truth(root, ref)
        shared = [(i, JOINT[name]) for i, name in enumerate(KEYPOINTS) if name in JOINT]
        given = frame.given_keypoints[[i for i, _ in shared]]
        true = project(truth.body_joints[[j for _, j in shared]], frame.intrinsics)
        found = given[:, 2] > 0
        assert found.sum() >= 6
        size = np.ptp(project(truth.body_vertices, frame.intrinsics)[:, 1])
        error = np.linalg.norm(given[found, :2] - true[found], axis=1)
        assert np.median(error) < 0.03 * size
        assert (error > 0).all()  # simulated, and not the truth itself


def test_the_body_parameters_make_the_stored_mesh(root, refs):
    import torch

    from hoi.body import DEFAULT_BODY, BodyModel

    model = BodyModel.load(DEFAULT_BODY)
    for ref in refs:
        truth = behave.read_ground_truth(root, ref)
        path = frame_folder(root, ref) / "person" / "fit02" / "person_fit.json"
        stored = json.loads(path.read_text())
        assert truth.body_model == stored["body_model"] == model.identity
        names = ("global_orient", "body_pose", "betas", "transl")
        output = model(*(torch.tensor([stored[name]]) for name in names))
        np.testing.assert_allclose(output.vertices[0], truth.body_vertices, atol=2e-4)
        np.testing.assert_allclose(output.joints[0], truth.body_joints, atol=2e-4)


def test_the_object_parameters_place_the_template_on_the_stored_mesh(root, refs):
    import trimesh
    from scipy.spatial.transform import Rotation

    for ref in refs:
        truth = behave.read_ground_truth(root, ref)
        sequence = root / "sequences" / ref.sequence
        info = json.loads((sequence / "info.json").read_text())
        template = trimesh.load(sequence / info["template"], process=False)
        (path,) = (frame_folder(root, ref)).glob("*/fit01/*_fit.pkl")
        pose = load_plain(path)
        centred = template.vertices - template.vertices.mean(0)
        rotation = Rotation.from_rotvec(pose["angle"]).as_matrix()
        np.testing.assert_allclose(
            centred @ rotation.T + pose["trans"], truth.object_vertices, atol=1e-5
        )


def test_people_touch_their_objects_without_sinking_into_them(root, refs):
    from hoi.datasets.behave_mini.collision import Solid

    for ref in refs:
        truth = behave.read_ground_truth(root, ref)
        body = Solid(truth.body_vertices, truth.body_faces)
        depth = body.depth(truth.object_vertices)
        assert depth.max() > -0.03  # nothing floats beside the person
        if ref.object_name != "backpack":  # straps are frozen as the mesh has them
            assert depth.max() < 0.06


def test_listing_finds_the_frames_again(root, refs):
    assert behave.list_frames(root, "chair", "test") == sorted(refs[:-1])
    assert behave.list_frames(root, "backpack", "tune") == refs[-1:]


# ------------------------------------------------------------------------------ determinism


def test_a_frame_alone_has_the_bytes_it_has_among_others(root, refs, tmp_path):
    from hoi.datasets.behave_mini.generate import generate_frames

    generate_frames(CONFIG, tmp_path, [refs[1]])
    alone = files_of(tmp_path)
    together = files_of(root)
    assert alone
    for name, content in alone.items():
        assert together[name] == content, name


def test_another_seed_makes_other_pictures(root, refs, tmp_path):
    from hoi.datasets.behave_mini.generate import generate_frames

    other = CONFIG.model_copy(update={"seed": 7, "image_width": 128})
    generate_frames(other, tmp_path, [refs[0]])
    first, second = (behave.read_ground_truth(r, refs[0]) for r in (root, tmp_path))
    assert np.abs(first.body_joints - second.body_joints).max() > 0.05


def test_the_camera_is_the_one_of_behave_at_the_chosen_size(root, refs):
    frame = behave.read_frame(root, refs[0])
    scale = CONFIG.image_width / 2048
    np.testing.assert_allclose(frame.intrinsics[0, 0], 979.784 * scale)
    np.testing.assert_allclose(frame.intrinsics[1, 2], 779.486 * scale)
