"""Artifacts: equal content gives equal bytes, and nothing damaged is read in silence."""

import io
import pickle
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from hoi.artifacts import Action, Contact, Detection, Frame, Interaction, Prior
from hoi.errors import ArtifactError, FrameFailure


def a_frame(**changes):
    values = {
        "frame_id": "seq.t0001.000",
        "dataset": "toy",
        "category": "chair",
        "image": np.arange(60, dtype=np.uint8).reshape(4, 5, 3),
        "intrinsics": np.eye(3),
        "given_object_mask": np.eye(4, 5, dtype=bool),
    }
    return Frame(**(values | changes))


def test_round_trip_keeps_every_field(tmp_path):
    frame = a_frame()
    frame.save(tmp_path / "frame.npz")
    again = Frame.load(tmp_path / "frame.npz")
    for name in Frame.model_fields:
        np.testing.assert_array_equal(getattr(again, name), getattr(frame, name))


def test_nested_records_round_trip(tmp_path):
    sit = Interaction(action="sit", contacts=[Contact(object_part="chair_seat", body_part="butt")])
    prior = Prior(frame_id="a", size_m=0.85, retrieved=sit, default=sit)
    prior.save(tmp_path / "prior.npz")
    assert Prior.load(tmp_path / "prior.npz") == prior


def test_equal_artifacts_have_equal_bytes():
    assert a_frame().to_bytes() == a_frame().to_bytes()
    assert a_frame().to_bytes() != a_frame(category="table").to_bytes()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("image", np.zeros((4, 5))),
        ("intrinsics", np.full((3, 3), np.nan)),
        ("given_keypoints", np.zeros((21, 2))),
        ("image", np.array([object()])),
    ],
)
def test_wrong_shapes_and_numbers_are_refused(field, value):
    with pytest.raises(ValidationError, match=field):
        a_frame(**{field: value})


def test_ok_means_complete():
    with pytest.raises(ValidationError, match="person_box"):
        Detection(frame_id="a")
    assert not Detection.failed("a", FrameFailure("no_person_detected", "nobody"), "detect").ok


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_damaged_files_end_in_an_artifact_error(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("fuzz") / "frame.npz"
    content = bytearray(a_frame().to_bytes())
    position = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        content = content[:position]
    else:
        content[position] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    try:
        Frame.load(path)  # a flipped bit in unused zip fields may go unnoticed
    except ArtifactError as error:
        assert str(path) in str(error)


def test_an_artifact_of_another_stage_is_refused(tmp_path):
    a_frame().save(tmp_path / "frame.npz")
    with pytest.raises(ArtifactError, match="not a valid Action"):
        Action.load(tmp_path / "frame.npz")


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("a pickle ran",))


def test_a_pickle_inside_is_never_run(tmp_path):
    path = tmp_path / "frame.npz"
    array = io.BytesIO()
    np.lib.format.write_array(array, np.array([1]))
    with zipfile.ZipFile(path, "w") as archive:
        header = array.getvalue()[:128].replace(b"'<i8'", b"'|O' ")
        archive.writestr("image.npy", header + pickle.dumps(Bomb()))
    with pytest.raises(ArtifactError):
        Frame.load(path)
