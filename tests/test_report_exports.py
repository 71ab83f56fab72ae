"""What a reconstruction is worth elsewhere: parameters, pose, turntable, gravity."""

import json

import numpy as np
import pytest

import report_synthetic as synthetic
from hoi.artifacts import Contact, Interaction
from hoi.report.config import ReportConfig
from hoi.report.exports import object_pose, turntable, write_object_json, write_smpl_npz
from hoi.report.scene import CAMERA_UP, gravity_up

VERTICES, FACES = synthetic.person()


def test_the_bodys_parameters_load_without_pickle_and_in_the_cameras_frame(tmp_path):
    joint, fit = synthetic.joint(), synthetic.body_fit()
    write_smpl_npz(tmp_path / "a.npz", fit, joint)
    write_smpl_npz(tmp_path / "b.npz", fit, joint)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz", allow_pickle=False) as found:
        assert {"global_orient", "body_pose", "betas", "transl", "scale"} <= set(found)
        np.testing.assert_array_equal(found["vertices"], joint.body_vertices)
        assert found["body_pose"].shape == (69,)


def test_the_objects_pose_places_its_exemplar(tmp_path):
    joint = synthetic.joint()
    rotation = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    points = np.array([[0, 0, 0], [0.4, 0.9, 0.5]], np.float32)
    placed = 2.0 * points @ rotation.T + [0.1, 0.2, 3.0]
    joint = joint.model_copy(
        update={
            "object_rotation": rotation,
            "object_translation": np.array([0.1, 0.2, 3.0]),
            "object_scale": 2.0,
            "object_vertices": placed.astype(np.float32),
        }
    )
    write_object_json(tmp_path / "o.json", synthetic.frame(), synthetic.prior(), joint)
    said = json.loads((tmp_path / "o.json").read_text())
    again = said["scale"] * points @ np.array(said["rotation"]).T + said["translation_m"]
    np.testing.assert_allclose(again, placed, atol=1e-5)
    assert said["size_m"] == {"width": 0.8, "height": 1.8, "depth": 1.0}
    assert said["camera"]["image_size"] == [synthetic.WIDTH, synthetic.HEIGHT]
    assert said["contacts"]


def test_a_frame_without_a_result_has_no_pose():
    from hoi.artifacts import Joint

    lost = synthetic.failed(Joint, "joint_diverged", "", "joint")
    with pytest.raises(ValueError, match="joint_diverged"):
        object_pose(synthetic.frame(), synthetic.prior(), lost)


def test_the_turntable_shows_both_from_eight_sides():
    sheet = turntable(synthetic.joint(), FACES, ReportConfig(), tile=48)
    assert sheet.shape == (96, 192, 3)
    views = sheet.reshape(2, 48, 4, 48, 3).transpose(0, 2, 1, 3, 4).reshape(8, 48, 48, 3)
    drawn = (views != 251).any(axis=-1).mean(axis=(1, 2))
    assert (drawn > 0.05).all()
    # turned, not repeated; a half turn mirrors the outline
    assert np.abs(views[0].astype(int) - views[2]).mean() > 1
    outline = (views[0] != 251).any(axis=-1), (views[4] != 251).any(axis=-1)
    assert (outline[0] != outline[1][:, ::-1]).mean() < 0.15


def standing(stands: bool):
    answer = Interaction(action="sit", contacts=[], stands_on_floor=stands)
    return synthetic.prior().model_copy(update={"retrieved": answer})


@pytest.mark.parametrize(
    ("pitch_deg", "stands", "follows"), [(20, True, True), (20, False, False), (80, True, False)]
)
def test_up_is_that_of_an_object_that_stands_else_the_cameras(pitch_deg, stands, follows):
    a = np.radians(pitch_deg)
    up = np.array([0.0, -np.cos(a), -np.sin(a)])  # a camera that looks down
    rotation = np.stack([[1.0, 0, 0], up, np.cross([1.0, 0, 0], up)], axis=1)
    joint = synthetic.joint().model_copy(update={"object_rotation": rotation})
    expected = up if follows else CAMERA_UP
    np.testing.assert_allclose(gravity_up(joint, standing(stands)), expected, atol=1e-12)


def test_contacts_are_those_of_the_action_that_was_followed():
    """Every likely action is tried: what was retrieved may not be what won."""
    prior = synthetic.prior()
    held = Interaction(
        action="lift", contacts=[Contact(object_part="chair_back", body_part="hand")]
    )
    prior = prior.model_copy(update={"hypotheses": [prior.retrieved, held]})
    joint = synthetic.joint()
    for action, part in (("sit", "chair_seat"), ("lift", "chair_back"), ("juggle", "chair_seat")):
        followed = joint.model_copy(update={"action": action})
        told = object_pose(synthetic.frame(), prior, followed)
        assert told["contacts"][0]["object_part"] == part
