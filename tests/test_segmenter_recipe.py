"""The segmenter's recipe on a few made-up meshes: it runs, resumes, and what it makes works."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pandas as pd
import pytest
import torch
import yaml
from onnx import helper

from hoi.detect.backends import DetectedBox
from hoi.detect.boxes import mask_box, overlap
from hoi.errors import AssetError
from hoi.segmenter.config import SceneConfig, TrainConfig
from hoi.segmenter.crops import SIDE
from hoi.segmenter.evaluation import METHODS, summary
from hoi.segmenter.export import write_weights
from hoi.segmenter.files import halved, load_model
from hoi.segmenter.meshes import MeshStore, build_store, fetch_packs
from hoi.segmenter.network import SegmentationNetwork, load_backbone
from hoi.segmenter.onlookers import Seen, detected_around, fitting_boxes
from hoi.segmenter.pictures import (
    POSE_DATABASE,
    Picture,
    draw_picture,
    load_picture,
    picture_names,
    save_picture,
)
from hoi.segmenter.restoring import calibrate, restored
from hoi.segmenter.runtime import DEFAULT_WEIGHTS, MaskNetwork
from hoi.segmenter.samples import SampleSet, poor_box
from hoi.segmenter.scenes import Composer, Instance
from hoi.segmenter.training import mask_loss, phases, read_weights, start_network, train
from segmenter_packs import write_packs

REPO = Path(__file__).parents[1]
BODY = REPO / "src/hoi/data/body/neutral.npz"
SCENES = SceneConfig(scenes=3, validation=1, side=96, textures=4, held_out_share=0.4)
TRAIN = TrainConfig(
    decoder_steps=3,
    whole_steps=2,
    batch=2,
    side=64,
    late_side=96,
    save_every=2,
    workers=1,
    used_share=0.5,
)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("segmenter")
    count = build_store(write_packs(folder / "packs"), folder / "meshes", SCENES.held_out_share)
    store = MeshStore(folder / "meshes")
    assert len(store.entries) == count
    return store


def onlooker(image, person):
    """Stands for the detector, which sees the same box in every picture, and the pose model."""
    boxes = [(10.0, 20.0, 60.0, 90.0)]
    if person is None:
        return Seen(None, boxes)
    probability = np.zeros(image.shape[:2], np.float32)
    x0, y0, x1, y1 = (int(max(edge, 0)) for edge in person)
    probability[y0:y1, x0 : (x0 + x1) // 2] = 1
    return Seen(probability, boxes)


@pytest.fixture(scope="module")
def composer(meshes):
    return Composer(SCENES, meshes, False, BODY, POSE_DATABASE, seed=1)


@pytest.fixture(scope="module")
def pictures(composer, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    files = []
    for name in picture_names(SCENES, "train"):
        files.append(folder / f"{name}.npz")
        save_picture(draw_picture(composer, SCENES, 1, name, onlooker), files[-1], 95)
    return files


@pytest.fixture(scope="module")
def samples(pictures):
    return SampleSet(pictures)


@pytest.fixture(scope="module")
def untrained(tmp_path_factory):
    """A checkpoint to start from, in place of the detector's weights."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("start") / "untrained.pt"
    torch.save(SegmentationNetwork().state_dict(), path)
    return path


# ----------------------------------------------------------------------------------- meshes


def test_meshes_keep_textures_sizes_and_lose_their_glass(meshes):
    entry = next(item for item in meshes.entries if item.name == "Scopia_2")
    mesh = meshes.load(entry)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), (0.5, 0.56, 0.45), atol=1e-6)
    assert mesh.vertices[:, 1].min() == pytest.approx(0, abs=1e-6)
    assert len(mesh.faces) == 10  # six sides less one of glass
    painted = mesh.texture_of[mesh.face_materials] >= 0
    assert painted.sum() == 6 and (~mesh.mapped).sum() == 2
    assert len(mesh.textures) == 1 and mesh.textures[0].shape == (32, 40, 3)


def test_what_the_embedded_data_set_shows_is_never_learned_from(tmp_path):
    from hoi.exemplars.furniture import furniture_models

    shown = {(m.pack, m.index) for m in furniture_models() if m.role == "ground_truth"}
    packs = write_packs(tmp_path / "packs", entries=32)
    build_store(packs, tmp_path / "meshes", 0.1)
    names = {entry.name for entry in MeshStore(tmp_path / "meshes").entries}
    assert ("BlendSwap-CC-0", 31) in shown and "BlendSwap-CC-0_31" not in names
    assert not names & {f"{pack}_{index}" for pack, index in shown}
    assert "BlendSwap-CC-0_30" in names


def test_validation_has_meshes_of_its_own(meshes):
    ours, theirs = ({e.name for e in meshes.split(held)} for held in (False, True))
    assert ours and theirs and not ours & theirs


def test_a_folder_without_meshes_or_packages_is_named(tmp_path):
    with pytest.raises(AssetError, match="holds no meshes"):
        MeshStore(tmp_path)
    (tmp_path / "sweethome3d-furniture_1_all.deb").write_bytes(b"not a package")
    with pytest.raises(AssetError, match="no Debian package"):
        fetch_packs(tmp_path)


# --------------------------------------------------------------------------------- pictures


def test_a_picture_is_the_same_alone_and_comes_back_from_its_file(composer, pictures, tmp_path):
    again = draw_picture(composer, SCENES, 1, "train-00001", onlooker)
    stored = load_picture(pictures[1])
    np.testing.assert_array_equal(again.owner, stored.owner)
    save_picture(again, tmp_path / "again.npz", 95)
    np.testing.assert_array_equal(load_picture(tmp_path / "again.npz").image, stored.image)
    assert again.instances == stored.instances
    other = draw_picture(composer, SCENES, 2, "train-00001", onlooker)
    assert (other.owner != again.owner).any()


def test_pictures_show_their_main_object_and_name_all_that_they_show(pictures):
    for file in pictures:
        picture = load_picture(file)
        numbers = {item.number for item in picture.instances}
        assert picture.number_of("main") == 1 and (picture.owner == 1).sum() > 8
        assert set(np.unique(picture.owner)) - {0} == numbers


def test_boxes_go_to_the_thing_that_they_fit_best():
    chair, table = (0.0, 0.0, 10.0, 10.0), (8.0, 0.0, 28.0, 10.0)
    boxes = [(0.0, 0.0, 9.0, 10.0), (0.0, 0.0, 10.0, 9.8), (9.0, 0.0, 28.0, 10.0)]
    boxes += [(0.0, 0.0, 28.0, 10.0)]  # both: of the larger one
    boxes += [(0.0, 0.0, 10.0, 3.9), (50.0, 50.0, 60.0, 60.0)]  # fit nothing well
    assert fitting_boxes(boxes, [chair, table]) == [
        ((0.0, 0.0, 10.0, 9.8), (0.0, 0.0, 9.0, 10.0)),
        ((9.0, 0.0, 28.0, 10.0), (0.0, 0.0, 28.0, 10.0)),
    ]
    assert fitting_boxes([], [chair, table]) == [(), ()]
    assert len(fitting_boxes([chair] * 9, [chair])[0]) == 3


def test_the_detector_looks_at_the_picture_and_around_the_person():
    shapes = []

    def detector(image):
        shapes.append(image.shape[:2])
        return [DetectedBox("chair", 0.5, (1.0, 2.0, 3.0, 4.0), "eye")]

    image = np.zeros((100, 200, 3), np.uint8)
    (alone,) = detected_around(detector, image, None)
    both = detected_around(detector, image, (100.0, 30.0, 120.0, 70.0))
    assert shapes == [(100, 200), (100, 200), (60, 60)]
    assert [item.box for item in both] == [alone.box, (81.0, 22.0, 83.0, 24.0)]


# ---------------------------------------------------------------------------------- samples


def test_crops_depend_on_seed_and_step_alone(samples, pictures):
    first = samples.batch(3, 7, 4, 64)
    second = SampleSet(pictures).batch(3, 7, 4, 64)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)
    assert (samples.batch(3, 8, 4, 64).picture != first.picture).any()


def test_a_target_lies_in_its_box(samples):
    batch = samples.batch(0, 0, 16, 64)
    assert batch.picture.shape == (16, 3, 64, 64) and batch.target.shape == (16, 1, 32, 32)
    assert batch.target.min() >= 0 and batch.target.max() <= 1
    boxes = batch.prompt[:, :1].reshape(16, 1, 32, 2, 32, 2).mean((3, 5))
    inside = (batch.target * boxes).sum((1, 2, 3)) / batch.target.sum((1, 2, 3))
    assert np.median(inside) > 0.85


def test_some_crops_show_a_person_and_what_they_use_without_a_box(samples):
    batch = samples.batch(0, 0, 16, 64, used_share=0.5)
    prompts = batch.prompt[:, 0]
    assert (prompts[:8].max((1, 2)) == 1).all()
    told = prompts[8:, 0, 0]  # of the size, the same everywhere
    assert (prompts[8:] == told[:, None, None]).all() and (told <= 0.5).all()
    assert len(np.unique(told)) > 2
    assert batch.prompt[8:, 1].any((1, 2)).all()  # a person says whose thing
    kinds = {(sample.picture, sample.number): sample.kind for sample in samples.samples}
    assert samples.uses
    for use in samples.uses:
        owner = samples.pictures[use.picture].owner
        person = owner == samples.pictures[use.picture].number_of("person")
        assert kinds[use.picture, use.number] == "main" and use.person == mask_box(person)


def test_what_nobody_touches_is_not_in_use(pictures, tmp_path):
    stored = load_picture(pictures[0])
    owner = np.zeros_like(stored.owner)
    owner[20:80, 20:40] = 2
    person = np.full_like(stored.person, 255)
    instances = [Instance(1, "main", "chair"), Instance(2, "person", "somebody")]
    for number, first in enumerate((40, 43)):  # at, and away from, a person of 60 pixels
        owner[20:80, 40:90] = 0
        owner[30:70, first : first + 40] = 1
        picture = Picture(stored.image, owner.copy(), person, instances)
        save_picture(picture, tmp_path / f"{number}.npz", 95)
    files = [tmp_path / "0.npz", tmp_path / "1.npz"]
    assert [use.picture for use in SampleSet(files).uses] == [0]


def test_what_is_held_is_mostly_seen_from_near(pictures, tmp_path):
    stored = load_picture(pictures[0])
    owner = np.zeros_like(stored.owner)
    owner[10:90, 20:40], owner[40:56, 40:56] = 2, 1  # a fifth of the person's height
    instances = [Instance(1, "main", "cup"), Instance(2, "person", "somebody")]
    person = np.full_like(stored.person, 255)
    save_picture(Picture(stored.image, owner, person, instances), tmp_path / "a.npz", 95)
    samples = SampleSet([tmp_path / "a.npz"])
    shares = samples.batch(0, 0, 60, 64, used_share=0.99).target[1:].mean((1, 2, 3))
    near = shares > (16 / 80) ** 2  # of a crop that is no larger than the person
    assert 0.4 < near.mean() < 0.75


def test_some_boxes_are_those_of_a_detector(pictures, tmp_path):
    stored = load_picture(pictures[0])
    owner = np.zeros_like(stored.owner)
    owner[30:70, 30:70] = 1
    drawn = (30.0, 30.0, 95.0, 70.0)  # none that is only jittered is as loose
    picture = replace(stored, owner=owner, instances=[Instance(1, "clutter", "chair", (drawn,))])
    save_picture(picture, tmp_path / "picture.npz", 95)
    samples = SampleSet([tmp_path / "picture.npz"])
    assert samples.samples[0].detected == (drawn,)
    prompts = samples.batch(0, 0, 60, 64).prompt[:, 0] > 0.5
    wide = [np.ptp(np.flatnonzero(p.any(0))) / np.ptp(np.flatnonzero(p.any(1))) for p in prompts]
    assert 0.25 < np.mean(np.array(wide) > 1.45) < 0.55


def test_some_boxes_are_as_poor_as_those_of_a_detector_that_is_wrong():
    rng = np.random.default_rng(0)
    thing, person = (40.0, 50.0, 80.0, 90.0), (70.0, 10.0, 90.0, 95.0)
    for people in (None, person):
        boxes = [poor_box(rng, thing, people) for _ in range(300)]
        overlaps = np.array([overlap(box, thing) for box in boxes])
        assert ((overlaps >= 0.2) & (overlaps <= 0.65)).mean() > 0.9
        reaches_up = np.mean([box[1] < 20 and box[0] > 30 for box in boxes])
        assert reaches_up > 0.02 if people else reaches_up < 0.02


def test_no_pictures_nothing_to_learn():
    with pytest.raises(AssetError, match="learn"):
        SampleSet([])


# --------------------------------------------------------------------------------- training


def weights(network):
    return {name: value.clone() for name, value in network.state_dict().items()}


def test_an_interrupted_training_ends_as_one_that_was_not(samples, untrained, tmp_path):
    config = TRAIN.model_copy(update={"init": str(untrained)})
    nowhere = tmp_path / "nanodet.onnx"
    whole = weights(train(samples, config, 5, nowhere, tmp_path / "whole.pt"))
    seen: list[int] = []

    def note(step, average):
        seen.append(step)

    for _ in range(2):  # leaves off inside each phase
        train(samples, config, 5, nowhere, tmp_path / "parts.pt", stop_after=2, watch=note)
    parts = weights(train(samples, config, 5, nowhere, tmp_path / "parts.pt", watch=note))
    assert seen == [2, 4, 5]  # no step was taken twice
    assert all(torch.equal(whole[name], parts[name]) for name in whole)
    finished = weights(train(samples, config, 5, nowhere, tmp_path / "parts.pt", watch=note))
    assert seen == [2, 4, 5]
    assert all(torch.equal(whole[name], finished[name]) for name in whole)
    started = weights(train(samples, config, 6, nowhere, tmp_path / "parts.pt"))  # another seed
    assert any(not torch.equal(whole[name], started[name]) for name in whole)


def test_each_phase_trains_what_it_says(samples, untrained, tmp_path):
    start = torch.load(untrained, weights_only=True)
    decoder = {"init": str(untrained), "whole_steps": 0}
    trained = train(samples, TRAIN.model_copy(update=decoder), 0, tmp_path, tmp_path / "a.pt")
    changed = {name for name, value in weights(trained).items() if not value.equal(start[name])}
    assert changed and not any(name.startswith("backbone.") for name in changed)
    both = {"init": str(untrained), "decoder_steps": 0}
    trained = train(samples, TRAIN.model_copy(update=both), 0, tmp_path, tmp_path / "b.pt")
    changed = {name for name, value in weights(trained).items() if not value.equal(start[name])}
    assert "backbone.convs.11.weight" in changed and "backbone.convs.2.weight" not in changed
    assert [phase.name for phase in phases(TRAIN)] == ["decoder", "whole"]


def test_training_learns_what_it_sees(samples, untrained, tmp_path):
    config = TrainConfig(
        init=str(untrained), decoder_steps=40, whole_steps=0, batch=8, side=64, late_side=64,
        averaging=0.8, warmup=5, workers=0,
    )  # fmt: skip
    trained = train(samples, config, 0, tmp_path, tmp_path / "learned.pt")
    stored = read_weights(tmp_path / "learned.pt")
    assert all(value.equal(stored[name]) for name, value in weights(trained).items())
    fresh = SegmentationNetwork()
    fresh.load_state_dict(torch.load(untrained, weights_only=True))
    batch = [torch.from_numpy(part) for part in samples.batch(99, 0, 16, 64)]
    with torch.no_grad():
        before, after = (
            float(mask_loss(n.eval()(batch[0], batch[1])[0], batch[2])) for n in (fresh, trained)
        )
    assert after < 0.75 * before


def test_shipped_weights_can_be_trained_on(samples, untrained, tmp_path):
    torch.manual_seed(3)
    original = SegmentationNetwork()
    for module in original.modules():  # batch norms that have something to fold
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.normal_(module.running_mean, 0, 0.1)
            torch.nn.init.uniform_(module.running_var, 0.5, 2)
            torch.nn.init.normal_(module.bias, 0, 0.1)
    original.eval()
    write_weights(original, tmp_path / "weights.onnx.gz")
    batch = samples.batch(0, 0, 8, SIDE, 0.25)
    inputs = torch.from_numpy(batch.picture), torch.from_numpy(batch.prompt)
    network = restored(tmp_path / "weights.onnx.gz")
    with torch.no_grad():
        expected = original(*inputs)[0]
        scale = expected.abs().max()
        assert (network(*inputs)[0] - expected).abs().max() < 0.01 * scale  # half precision
        expected = network(*inputs)[0]
        calibrate(network, [batch])
        assert (network(*inputs)[0] - expected).abs().max() < 1e-4 * scale
        calibrate(network, [batch])  # nothing more to do
        assert (network(*inputs)[0] - expected).abs().max() < 1e-4 * scale
        # training normalises by the batch, whose statistics these now are
        assert (network.train()(*inputs)[0] - expected).abs().max() < 0.02 * scale


def test_a_training_starts_from_shipped_weights(samples, untrained, tmp_path):
    config = TRAIN.model_copy(update={"init": str(DEFAULT_WEIGHTS), "side": 64, "whole_steps": 1})
    before = start_network(config, tmp_path, samples, 0).state_dict()
    after = train(samples, config, 0, tmp_path, tmp_path / "network.pt").state_dict()
    name = "backbone.convs.0.weight"
    assert torch.equal(before[name], after[name]) and before[name].abs().max() > 0.01


def test_another_network_is_not_restored(tmp_path):
    path = tmp_path / "weights.onnx.gz"
    path.write_bytes(b"no")
    with pytest.raises(AssetError, match="weights"):
        restored(path)
    model = onnx.load_from_string(load_model(DEFAULT_WEIGHTS))
    layers = [node for node in model.graph.node if node.op_type == "Conv"]
    spare = layers[3].input.pop()  # a layer without its bias
    path.write_bytes(halved(model))
    with pytest.raises(AssetError, match="not the layer"):
        restored(path)
    layers[3].input.append(spare)
    model.graph.node.append(helper.make_node("Conv", list(layers[3].input), ["more"]))
    path.write_bytes(halved(model))
    with pytest.raises(AssetError, match="layers, this version"):
        restored(path)


def test_a_file_that_is_no_detector_is_named(tmp_path):
    (tmp_path / "nanodet.onnx").write_bytes(b"")
    with pytest.raises(AssetError, match=r"nanodet\.onnx"):
        load_backbone(tmp_path / "nanodet.onnx")


# ----------------------------------------------------------------------- export, evaluation


def test_opencv_computes_what_torch_does(untrained, tmp_path):
    network = SegmentationNetwork()
    network.load_state_dict(torch.load(untrained, weights_only=True))
    for module in network.modules():  # as after training, when they mean something
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(module.running_mean, -0.2, 0.2)
            torch.nn.init.uniform_(module.running_var, 0.5, 2.0)
    write_weights(network, tmp_path / "weights.onnx.gz")
    picture, prompt = torch.randn(1, 3, SIDE, SIDE), torch.rand(1, 2, SIDE, SIDE)
    with torch.no_grad():
        expected = network.eval()(picture, prompt)[0].numpy()
    net = MaskNetwork(tmp_path / "weights.onnx.gz")._net
    net.setInput(picture.numpy(), "picture")
    net.setInput(prompt.numpy(), "prompt")
    np.testing.assert_allclose(net.forward().reshape(expected.shape), expected, atol=5e-3)


def test_the_summary_tells_detected_boxes_from_true_ones():
    rows = pd.DataFrame({"box": ["detected", "detected", "true"]})
    for method in METHODS:
        rows[method] = [0.4, 0.6, 0.1]
    rows["network"] += 0.1
    rows.loc[0, "in_use"] = np.nan  # nobody was seen
    table = summary(rows).set_index(["box", "method"])
    assert table.loc[("detected", "network"), "mean_iou"] == pytest.approx(0.6)
    assert table.loc[("detected", "in_use"), "n"] == 1
    assert table.loc[("detected", "in_use"), "mean_iou"] == pytest.approx(0.6)
    assert table.loc[("true", "network"), "n"] == 1
    assert table.loc[("all", "grabcut"), "over_half"] == pytest.approx(1 / 3)


# ---------------------------------------------------------------------------- the workflow


@pytest.mark.slow
@pytest.mark.models
@pytest.mark.skipif(
    not os.environ.get("HOI_LARGE_TESTS"), reason="two minutes and more: set HOI_LARGE_TESTS=1"
)
def test_one_command_makes_weights_and_their_table_and_then_has_nothing_to_do(tmp_path):
    for name in ("Snakefile", "workflow", "config", "profiles", "src"):
        source = REPO / name
        copy = shutil.copytree if source.is_dir() else shutil.copy
        copy(source, tmp_path / name)
    if (REPO / "resources/models").is_dir():
        shutil.copytree(REPO / "resources/models", tmp_path / "resources/models")
    tiny = {
        "segmenter": {
            "packs": str(write_packs(tmp_path / "packs")),
            "scenes": SCENES.model_dump(mode="json") | {"side": 160, "chunk": 2},
            "train": TRAIN.model_dump(mode="json"),
        }
    }
    (tmp_path / "config/tiny.yaml").write_text(yaml.safe_dump(tiny))

    def snakemake(*arguments):
        command = [sys.executable, "-m", "snakemake", "results/segmenter.csv", "-j2"]
        return subprocess.run(
            [*command, "--configfile", "config/tiny.yaml", *arguments],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(tmp_path / "src")},
            capture_output=True,
            text=True,
            timeout=900,
        )

    done = snakemake()
    assert done.returncode == 0, done.stdout + done.stderr
    table = pd.read_csv(tmp_path / "results/segmenter.csv")
    assert set(table["weights"]) == {"trained", "shipped"} and set(table["method"]) == set(METHODS)
    assert "Nothing to be done" in snakemake("-n").stdout + snakemake("-n").stderr
    # a lost marker costs no rendering: the pictures are still there
    marker = tmp_path / "resources/segmenter/pictures/train-000.json"
    files = [tmp_path / name for name in json.loads(marker.read_text())]
    times = [file.stat().st_mtime_ns for file in files]
    marker.unlink()
    assert snakemake().returncode == 0
    assert [file.stat().st_mtime_ns for file in files] == times
