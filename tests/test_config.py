"""The configuration: the shipped file is valid, and mistakes are named by their key."""

from pathlib import Path

import pytest
import yaml

from hoi.config import load_config, read_config
from hoi.errors import ConfigError
from hoi.manifest import frame_labels, plan

PATH = Path(__file__).parents[1] / "config" / "config.yaml"
SHIPPED = yaml.safe_load(PATH.read_text())


def test_the_shipped_configuration_is_valid_and_uses_the_embedded_data():
    config = load_config(PATH)
    assert config.dataset_name == "behave_mini"
    assert read_config(SHIPPED | {"behave": {"root": "/data"}}).dataset_name == "behave"


def test_the_papers_weights_are_the_papers():
    terms = read_config(SHIPPED).joint_settings("paper").terms
    assert terms == {
        "contact": 1.0,
        "normal": 0.01,
        "penetration": 0.01,
        "object_scale": 0.01,
        "human_scale": 0.01,
        "reprojection": 0.0005,
    }
    schedule = read_config(SHIPPED).joint_settings("paper").paper
    assert (schedule.optimiser, schedule.iterations, schedule.learning_rate) == ("adam", 500, 2e-3)


def test_an_ablation_differs_from_ours_in_what_its_name_says_only():
    config = read_config(SHIPPED)
    ours = config.joint_settings("ours").model_dump()
    differences = {
        "no_action": {"action"},
        "no_contact": {"terms"},
        "no_normal": {"terms", "opposing_normals"},
    }
    for method, expected in differences.items():
        other = config.joint_settings(method).model_dump()
        assert {k for k in ours if ours[k] != other[k]} == expected | {"method"}
    without = set(config.joint_settings("no_contact").terms)
    assert set(ours["terms"]) - without == {"contact", "normal", "ground"}
    assert set(ours["terms"]) - set(config.joint_settings("no_normal").terms) == {"normal"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joint": {}}, "joint: unknown key"),
        ({"chunk_size": 0}, r"chunk_size: .*given: 0"),
        ({"detect": {"masks": "magic"}}, r"detect.masks: .*given: 'magic'"),
        ({"objectfit": {"so3": {"num_stars": 5}}}, "objectfit.so3.num_stars: unknown key"),
        ({"methods": SHIPPED["methods"] | {"ours": {"search": "sideways"}}}, "sideways"),
        ({"dataset": "behave"}, "behave.root"),
    ],
)
def test_mistakes_are_named_by_their_key(changes, message):
    with pytest.raises(ConfigError, match=message):
        read_config(SHIPPED | changes)


@pytest.mark.parametrize("content", [None, b"a: [1", b"- a\n- b", b"\xff\xfe\x00"])
def test_an_unreadable_file_is_named(tmp_path, content):
    path = tmp_path / "config.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"config\.yaml"):
        load_config(path)


def test_settings_of_a_methods_joint_stage_are_checked_too():
    broken = {"ours": {"joint": {"terms": {"contakt": 1.0}}}}
    with pytest.raises(ConfigError, match="contakt"):
        read_config(SHIPPED | {"methods": SHIPPED["methods"] | broken})


def test_chunks_cover_the_planned_frames_once_and_in_order():
    chunks = plan(read_config(SHIPPED | {"chunk_size": 5}), "chair")
    ids = [frame_id for chunk in chunks for frame_id in chunk.frame_ids]
    assert ids == sorted(set(ids)) and [len(c.frames) for c in chunks[:-1]] == [5] * (
        len(chunks) - 1
    )
    labels = frame_labels(chunks)
    assert {label["action"] for label in labels.values()} >= {"sit", "hand", "lift", "mix"}
    assert {label["category"] for label in labels.values()} == {"chair", "stool"}


def test_more_frames_contain_fewer_frames():
    few = plan(read_config(SHIPPED), "chair")
    many = plan(read_config(SHIPPED | {"frames": "all"}), "chair")
    ids = [{frame_id for chunk in chunks for frame_id in chunk.frame_ids} for chunks in (few, many)]
    assert ids[0] < ids[1]
