"""The export for the RHOBIN challenge, read back by the challenge's own formulas."""

import pickle

import numpy as np
import pytest
import torch
import trimesh
import yaml
from scipy.spatial.transform import Rotation

from behave_tree import TEMPLATE, TEMPLATE_FACES, BehaveTree
from hoi.artifacts import BodyFit, Joint
from hoi.body import DEFAULT_BODY, BodyModel
from hoi.chunks import FrameEntry, Index, artifact_path
from hoi.cli import main
from hoi.evaluate.rhobin import Submission, portable_pickle, register
from hoi.plain_pickle import load_plain
from test_body_files import small_body
from test_body_smpl_oracle import published_equations
from test_check_data import REPO

SEQUENCE = "Date03_Sub03_chairblack_sit"


def chair(back: float = 0.5):
    """Seat, back and one armrest: no symmetry at all."""
    parts = [
        trimesh.creation.box((0.5, 0.06, 0.5)),
        trimesh.creation.box((0.5, back, 0.05)).apply_translation([0, back / 2, -0.22]),
        trimesh.creation.box((0.05, 0.2, 0.4)).apply_translation([0.22, 0.1, 0]),
    ]
    mesh = trimesh.util.concatenate([part.subdivide().subdivide() for part in parts])
    return np.asarray(mesh.vertices - mesh.vertices.mean(0)), np.asarray(mesh.faces)


def similarity(seed: int):
    random = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed).as_matrix()
    return random.uniform(0.7, 1.4), rotation, random.normal(0, 0.5, 3) + [0, 0, 2.5]


@pytest.mark.parametrize("seed", range(3))
def test_a_template_is_registered_to_another_mesh_of_its_shape(seed):
    template, found = chair(), chair()
    finer = trimesh.Trimesh(*found, process=False).subdivide()
    scale, rotation, translation = similarity(seed)
    target = scale * finer.vertices @ rotation.T + translation
    fitted = register(template, (target, finer.faces), seed=0)
    expected = scale * template[0] @ rotation.T + translation
    assert np.abs(fitted - expected).max() < 0.01


def joint_of(body, betas, vertices, faces, exemplar="e1", human_scale=None):
    return Joint(
        frame_id="f", method="ours", exemplar=exemplar, object_scale=1.0, human_scale=human_scale,
        object_vertices=vertices, object_faces=faces, body_vertices=body, body_model="smpl",
    )  # fmt: skip


def body_fit(seed: int, entries):
    random = np.random.default_rng(seed)
    pose, betas, transl = random.normal(0, 0.3, 72), random.normal(0, 1, 10), random.normal(0, 1, 3)
    vertices, joints = published_equations(entries, pose, betas, transl)
    fit = BodyFit(
        frame_id="f", global_orient=pose[:3], body_pose=pose[3:], betas=betas, transl=transl,
        vertices=vertices, joints=joints,
    )  # fmt: skip
    return fit, vertices


@pytest.mark.parametrize("human_scale", [None, 1.25])
def test_the_challenges_formulas_give_back_the_scene(human_scale):
    """Bodies by SMPL's equations, objects by ``(R v + t) * scale``; two frames of one exemplar."""
    entries = small_body()
    template = chair()
    submission = Submission({"chairblack": template}, with_vertices=True)
    factor = human_scale or 1.0
    scenes = []
    for number in range(2):
        scale, rotation, translation = similarity(number)
        thing = scale * template[0] @ rotation.T + translation
        fit, body = body_fit(number, entries)
        joint = joint_of(factor * body, fit.betas, thing, template[1], human_scale=human_scale)
        submission.add(SEQUENCE, f"t000{number}.000", "chairblack", "male", fit, joint)
        scenes.append((factor * body, thing))
    content = pickle.loads(portable_pickle(submission.content()))
    rows = content[SEQUENCE]
    assert rows["frames"] == ["t0000.000", "t0001.000"] and rows["gender"] == "male"
    shapes = {key: rows[key].shape for key in ("poses", "betas", "trans", "obj_rots", "obj_trans")}
    assert shapes == {
        "poses": (2, 72), "betas": (2, 10), "trans": (2, 3), "obj_rots": (2, 3, 3),
        "obj_trans": (2, 3),
    }  # fmt: skip
    for k, (body, thing) in enumerate(scenes):
        posed, _ = published_equations(
            entries, rows["poses"][k], rows["betas"][k], rows["trans"][k]
        )
        placed = (template[0] @ rows["obj_rots"][k].T + rows["obj_trans"][k]) * rows["obj_scales"][
            k
        ]
        # up to the scale about the camera that no picture shows, both are the scene
        np.testing.assert_allclose(factor * posed, body, atol=1e-6)
        assert np.abs(factor * placed - thing).max() < 0.01
        np.testing.assert_allclose(rows["smpl_verts"][k], body, atol=1e-5)
        assert np.abs(rows["obj_verts"][k] - thing).max() < 0.01


def test_the_file_is_plain_data_for_any_numpy(tmp_path):
    content = {"s": {"poses": np.arange(6.0).reshape(2, 3), "obj_scales": [1.0], "frames": ["t"]}}
    data = portable_pickle(content)
    assert b"numpy._core" not in data and b"numpy.core" in data
    path = tmp_path / "results.pkl"
    path.write_bytes(data)
    loaded = load_plain(path)
    np.testing.assert_array_equal(loaded["s"]["poses"], content["s"]["poses"])


def write_run(folder, tree, model: str) -> None:
    """Results of one chunk of one frame, and one that failed, as the workflow leaves them."""
    frame_ids = [f"{SEQUENCE}-t0003.000", f"{SEQUENCE}-t0004.000"]
    fit, body = body_fit(0, small_body())
    scan = TEMPLATE - TEMPLATE.mean(0) + [0, 0, 2]
    joint = joint_of(body, fit.betas, scan, TEMPLATE_FACES)
    joint = joint.model_copy(update={"body_model": model})
    failed = Joint(frame_id="f", status="no_object_detected", detail="none")
    for stage, kind, artifacts in (
        ("joint/ours", Joint, (joint, failed)),
        ("smplify", BodyFit, (fit, fit)),
    ):
        index = folder / stage / "chair-000.json"
        entries = {}
        for frame_id, artifact in zip(frame_ids, artifacts, strict=True):
            assert isinstance(artifact, kind)
            path = artifact_path(index, frame_id)
            path.parent.mkdir(parents=True, exist_ok=True)
            artifact.model_copy(update={"frame_id": frame_id}).save(path)
            entries[frame_id] = FrameEntry(sha256="", status=artifact.status)
        Index(stage=stage, frames=entries).save(index)


def test_the_command_writes_what_the_workflow_left(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(REPO)
    tree = BehaveTree(tmp_path / "behave", tmp_path / "smplh")
    tree.sequence(SEQUENCE)
    mine = tmp_path / "mine.yaml"
    mine.write_text(yaml.safe_dump({"behave": {"root": str(tree.root)}}))
    words = ["export-rhobin", "--config", "config/config.yaml", str(mine)]
    words += ["--results", str(tmp_path / "run"), "--output", str(tmp_path / "out" / "results.pkl")]
    assert main(words) == 1
    assert "no results of method 'ours'" in capsys.readouterr().err
    write_run(tmp_path / "run", tree, "smpl24")
    assert main(words) == 0
    assert "1 of 2 frames in 1 sequences; the challenge asks for" in capsys.readouterr().out
    rows = load_plain(tmp_path / "out" / "results.pkl")[SEQUENCE]
    assert rows["frames"] == ["t0003.000"] and "smpl_verts" not in rows
    write_run(tmp_path / "run", tree, BodyModel.load(DEFAULT_BODY, dtype=torch.float64).identity)
    assert main(words) == 1
    assert "assets.body_model" in capsys.readouterr().err
