"""``hoi check-data``: what it says of whole, partial and odd trees, and when it says stop."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from PIL import Image

from behave_tree import TEMPLATE_FACES, BehaveTree, write_json, write_mesh
from hoi.checks.cost import TYPICAL, seconds_per_frame, spoken
from hoi.checks.findings import Level, can_start
from hoi.checks.report import check_data
from hoi.cli import main
from hoi.config import load_configs, read_config

REPO = Path(__file__).parents[1]
SHIPPED = yaml.safe_load((REPO / "config" / "config.yaml").read_text())
SIT, HUG = "Date03_Sub03_chairblack_sit", "Date03_Sub04_backpack_hug"


@pytest.fixture
def tree(tmp_path, monkeypatch) -> BehaveTree:
    monkeypatch.chdir(REPO)
    made = BehaveTree(tmp_path / "behave", tmp_path / "smplh")
    made.sequence(SIT, times=("t0003.000", "t0004.000"))
    made.sequence(HUG)
    return made


def check(tree, results=Path("nowhere"), **changes):
    behave = {"root": str(tree.root), "smplh": str(tree.smplh)} | changes.pop("behave", {})
    return check_data(read_config(SHIPPED | {"behave": behave} | changes), results)


def told(report, level: Level) -> str:
    return "\n".join(f"{f.topic}: {f.text}" for f in report.findings if f.level is level)


def test_a_whole_tree_can_start_and_nothing_is_odd(tree):
    report = check(tree)
    assert can_start(report.findings)
    assert told(report, Level.ODD) == ""
    good = told(report, Level.OK)
    assert "lists 2 sequences in split 'test', 2 of them are on disk" in good
    assert "results/behave_chair.csv): 2 frames: sit 2." in good
    assert "results/behave_backpack.csv): 1 frames: hug 1." in good
    assert "k0, k1, k2, k3" in good and "distortion ignored" in good
    assert "SMPL-H: female, male." in good
    assert "smplh_root 'model' lies within 0.0 mm" in good
    assert "aligned by 24 joints (3)" in good
    assert "Table table (results/behave_table.csv): No frames on disk." in told(
        report, Level.MISSING
    )


def test_every_oddity_of_a_frame_is_told_with_an_example(tree):
    folder = tree.root / "sequences" / SIT
    write_json(folder / "t0003.000" / "k1.color.json", {"body_joints": [0.0] * 75})
    Image.new("L", (10, 10)).save(folder / "t0004.000" / "k1.person_mask.png")
    (folder / "t0004.000" / "k1.color.json").write_text("{")
    (folder / "t0004.000" / "k1.obj_rend_full.png").unlink()
    for second, name in ((5, "person"), (6, "chair")):
        shutil.rmtree(tree.frame(SIT, f"t000{second}.000") / name)
    shutil.copy(REPO / "LICENSE", tree.frame(SIT, "t0007.000") / "k1.obj_rend_mask.png")
    (tree.frame(SIT, "t0008.000") / "person/fit02/person_fit.ply").unlink()
    broken = tree.frame(SIT, "t0009.000")
    (broken / "k1.color.jpg").write_bytes(b"\xff\xd8no picture")
    (tree.frame(SIT, "t0010.000") / "k1.color.jpg").unlink()
    (tree.frame(SIT, "t0011.000") / "k1.person_mask.jpg").unlink()
    report = check(tree, evaluate={"min_visible_fraction": 0.3})
    strange = told(report, Level.ODD)
    for words, second in (
        ("all-zero keypoints", 3), ("another size than the picture", 4),
        ("damaged keypoint file", 4), ("no person fit", 5), ("no object fit", 6),
        ("mask that cannot be opened", 7), ("person_fit.pkl without person_fit.ply", 8),
        ("picture that cannot be opened", 9), ("no picture", 10), ("no person mask", 11),
    ):  # fmt: skip
        line = next(line for line in strange.splitlines() if words in line)
        assert f"{SIT}-t{second:04d}.000" in line and line.startswith("Table chair"), line
    assert "whole object" in told(report, Level.MISSING)
    assert "7 frames: sit 7" in told(report, Level.OK)  # of nine, two have no truth
    assert can_start(report.findings)


def test_sub_sampling_is_counted(tree):
    for second in range(5, 11):
        tree.frame(SIT, f"t{second:04d}.000")
    assert "4 frames: sit 4" in told(check(tree, behave={"every": 2}), Level.OK)
    assert "3 of 8 frames: sit 3" in told(check(tree, frames=3), Level.OK)


def test_without_smpl_no_frame_could_be_measured_and_that_stops(tree):
    report = check(tree, behave={"smplh": None})
    assert not can_start(report.findings)
    assert "behave.smplh" in told(report, Level.STOP)


def test_the_root_convention_is_found_out_from_the_data(tree):
    report = check(tree, behave={"smplh_root": "centred"})
    assert "set behave.smplh_root: model" in told(report, Level.ODD)


def test_open_scans_absent_cameras_and_lost_sequences_are_told(tree):
    write_mesh(
        tree.root / "objects/chairblack/chairblack_f1000.ply",
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
        TEMPLATE_FACES[:2] % 4,
    )
    shutil.rmtree(tree.root / "objects/backpack")
    shutil.rmtree(tree.root / "calibs" / "intrinsics")
    tree.splits["test"] += ["Date03_Sub05_stool", "Date03_Sub04_keyboard_lift"]
    write_json(tree.root / "split.json", tree.splits)
    (tree.root / "sequences" / "Date03_Sub04_keyboard_lift").mkdir()
    (tree.root / "sequences" / "notes").mkdir()
    report = check(tree)
    strange = told(report, Level.ODD)
    assert "Not watertight: the simplified scans of chairblack" in strange
    assert "No intrinsics of k1" in strange
    assert "left out: Date03_Sub04_keyboard_lift" in strange
    assert "no sequences: 'notes'" in strange
    lacking = told(report, Level.MISSING)
    assert "Not downloaded: Date03_Sub05_stool" in lacking
    assert "of backpack" in lacking


def test_names_that_are_no_utf8_are_told_and_harm_nothing(tree, tmp_path, capsys):
    for folder in (tree.root / "sequences", tree.root / "sequences" / SIT, tmp_path / "meshes"):
        os.makedirs(os.fsencode(folder) + b"/t\xff\xfe", exist_ok=True)
    path = os.fsencode(tmp_path / "meshes") + b"/t\xff\xfe/caf\xe9.obj"
    Path(os.fsdecode(path)).write_text("v 0 0 0\nnonsense\n")
    extra = tmp_path / "mine.yaml"
    own = {"sources": ["folder"], "folder": str(tmp_path / "meshes")}
    behave = {"root": str(tree.root), "smplh": str(tree.smplh)}
    extra.write_text(yaml.safe_dump({"exemplars": own, "behave": behave}))
    assert main(["check-data", "--config", "config/config.yaml", str(extra)]) == 0
    shown = capsys.readouterr().out
    assert "2 frames: sit 2" in shown and "no sequences: 't\\udcff\\udcfe'" in shown
    assert r"t\udcff\udcfe 1" in shown


def test_a_camera_without_a_pose_stops(tree):
    (tree.root / "calibs/Date03/config/2/config.json").unlink()
    report = check(tree, behave={"kinect": 2})
    assert "No pose of k2 on Date03" in told(report, Level.STOP)
    assert not can_start(report.findings)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda tree: shutil.rmtree(tree.root), "there is no folder"),
        (lambda tree: (tree.root / "split.json").unlink(), "split.json does not exist"),
        (lambda tree: (tree.root / "split.json").write_bytes(b"\xff\xfe"), "split.json"),
        (lambda tree: shutil.rmtree(tree.root / "sequences"), "0 of them are on disk"),
        (lambda tree: (tree.smplh / "SMPLH_male.pkl").write_bytes(b"\x80\x04cos\nsystem\n."),
         "SMPLH_male.pkl"),
    ],
)  # fmt: skip
def test_what_makes_a_run_impossible_is_named(tree, damage, words):
    damage(tree)
    report = check(tree)
    assert not can_start(report.findings)
    assert words in told(report, Level.STOP)


def test_an_absent_body_model_or_mesh_folder_stops(tree, tmp_path):
    report = check(tree, assets={"body_model": str(tmp_path / "SMPL.pkl")})
    assert "SMPL.pkl" in told(report, Level.STOP)
    (tmp_path / "meshes" / "chair").mkdir(parents=True)
    (tmp_path / "meshes" / "chair" / "mine.obj").write_text("v 0 0 0\n")
    shutil.copy(REPO / "LICENSE", tmp_path / "meshes" / "chair" / "broken.glb")
    own = {"sources": ["folder"], "folder": str(tmp_path / "meshes")}
    report = check(tree, exemplars=own)
    assert f"Own meshes in {tmp_path / 'meshes'}: chair 2" in told(report, Level.OK)
    assert "broken.glb" in told(report, Level.ODD)
    report = check(tree, exemplars=own | {"folder": str(tmp_path / "none")})
    assert "exemplars.folder" in told(report, Level.STOP)


def test_the_run_time_comes_from_earlier_runs_where_there_are_any(tmp_path):
    config = read_config(SHIPPED)
    typical = seconds_per_frame(config, tmp_path, ("ours",))
    assert typical == pytest.approx(sum(TYPICAL.values()))
    write_json(tmp_path / "joint" / "ours" / "chair-000.seconds.json", {"a": 99.0, "b": 101.0})
    (tmp_path / "joint" / "ours" / "chair-001.seconds.json").write_text("damaged")
    measured = seconds_per_frame(config, tmp_path, ("ours",))
    assert measured == pytest.approx(typical - TYPICAL["joint"] + 100)
    assert (spoken(50), spoken(600), spoken(9000)) == ("50 seconds", "10 minutes", "2.5 hours")


def test_the_command_prints_sentences_and_its_status_is_the_verdict(tree, tmp_path, capsys):
    extra = tmp_path / "mine.yaml"
    extra.write_text(yaml.safe_dump({"behave": {"smplh": str(tree.smplh)}}))
    words = ["check-data", "--config", "config/config.yaml", str(extra)]
    words += ["--behave", str(tree.root), "--frames", str(tmp_path / "frames.csv")]
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "A run can start." in shown and "Run time" in shown
    lines = (tmp_path / "frames.csv").read_text().splitlines()
    assert lines[0] == "table,frame,action,oddities" and len(lines) == 4
    (tree.root / "split.json").unlink()
    assert main(words) == 1
    assert "A run cannot start: see STOP above." in capsys.readouterr().out
    assert main(["check-data", "--config", str(tmp_path / "none.yaml")]) == 1
    assert "none.yaml" in capsys.readouterr().err


def test_the_embedded_data_set_needs_nothing(monkeypatch):
    monkeypatch.chdir(REPO)
    report = check_data(read_config(SHIPPED), Path("nowhere"))
    assert can_start(report.findings) and report.frames == {}
    assert "chair 24, table 20, keyboard 12, backpack 28" in told(report, Level.OK)


def test_a_run_is_planned_although_a_sequence_says_nonsense_of_itself(tree, tmp_path):
    """Its frames fail by name when they are read; the others are not lost."""
    from hoi.manifest import plan

    tree.sequence("Date03_Sub03_chairwood_sit")
    behave = {"root": str(tree.root), "smplh": str(tree.smplh)}
    config = read_config(SHIPPED | {"behave": behave, "memo": str(tmp_path / "memo")})

    def planned():
        return {f.frame_id: f.digest for chunk in plan(config, "chair") for f in chunk.frames}

    whole = planned()
    info = tree.root / "sequences" / SIT / "info.json"
    info.write_text('{"config": "../../../.."}')
    damaged = planned()
    changed = {name for name in whole if whole[name] != damaged[name]}
    assert len(whole) == 3 and changed == {f"{SIT}-t0003.000", f"{SIT}-t0004.000"}


def test_later_configuration_files_go_before_earlier_ones(tmp_path):
    first, second = tmp_path / "a.yaml", tmp_path / "b.yaml"
    first.write_text(yaml.safe_dump(SHIPPED | {"behave": {"root": "a", "kinect": 2}}))
    second.write_text("behave: {root: b}\n")
    config = load_configs([first, second])
    assert (config.behave.root, config.behave.kinect) == ("b", 2)


@pytest.mark.skipif(
    not os.environ.get("HOI_LARGE_TESTS"),
    reason="writes 41,000 files: set HOI_LARGE_TESTS=1, or run benchmarks/behave_metadata.py",
)
def test_the_metadata_of_4554_frames_takes_under_20_seconds(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(REPO / "benchmarks"))
    import behave_metadata

    behave_metadata.generate(tmp_path / "behave")
    count, listing, looking = behave_metadata.metadata(tmp_path / "behave")
    assert count == 4554
    assert listing + looking < 20
    sys.modules.pop("behave_metadata")


@pytest.mark.slow
def test_one_workflow_reads_the_released_layout(tree, tmp_path):
    """The rule that reads behave_mini's frames reads this tree, from another camera."""
    from hoi.artifacts import Frame, GroundTruth

    for name in ("src", "workflow", "Snakefile", "config", "profiles", "examples"):
        (tmp_path / name).symlink_to(REPO / name)
    settings = {"behave": {"root": str(tree.root), "smplh": str(tree.smplh), "kinect": 2}}
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(settings))
    done = subprocess.run(
        [sys.executable, "-m", "snakemake", "results/behave/truth/chair-000.json", "-j1",
         "--configfile", "mine.yaml"],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(REPO / "src")}, capture_output=True,
        text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    index = json.loads((tmp_path / "results/behave/truth/chair-000.json").read_text())
    assert [entry["status"] for entry in index["frames"].values()] == ["ok", "ok"]
    name = f"{SIT}-t0003.000.npz"
    truth = GroundTruth.load(tmp_path / "results/behave/truth/chair-000" / name)
    frame = Frame.load(tmp_path / "results/behave/frames/chair-000" / name)
    assert truth.body_joints is not None and frame.source.endswith("k2.color.jpg")
