"""Which stronger model ``auto`` stands for on this machine. Imports no model library."""

from __future__ import annotations

import importlib.util
import os
import sys
from functools import cache
from pathlib import Path

from hoi.detect.config import DetectConfig, ModelFiles, StrongConfig
from hoi.digest import file_digest
from hoi.errors import AssetError

#: Models in the order in which ``auto`` prefers them, with the library each needs.
INSTANCE_MODELS = {
    "pointrend": "detectron2",
    "rtmdet": "mmdet",
    "dfine_seg": "dfine_seg",
    "torchvision": "torchvision",
}
BOX_MODELS = {"sam": "segment_anything", "onnx": "cv2"}
_TORCHVISION_FILE = "maskrcnn_resnet50_fpn_v2_coco-73cbd019.pth"


def resolved(config: DetectConfig) -> DetectConfig:
    """The configuration with ``auto`` replaced by a model that is here, or ``none``.

    The weights' sha256 is filled in, so that other weights make other results.

    Raises AssetError where a model is named and its library or a file of it is not there, or has
    not the sha256 that the configuration names.
    """
    strong = config.strong
    updates: dict[str, object] = {
        "instances": _chosen(strong, strong.instances, INSTANCE_MODELS),
        "from_box": _chosen(strong, strong.from_box, BOX_MODELS),
    }
    for name in (updates["instances"], updates["from_box"]):
        if name != "none":
            updates[str(name)] = _checked(str(name), getattr(strong, str(name)))
    return config.model_copy(update={"strong": strong.model_copy(update=updates)})


def importable(library: str) -> bool:
    """Whether a library is installed, without importing it."""
    if library in sys.modules:
        return True
    try:
        return importlib.util.find_spec(library) is not None
    except (ImportError, ValueError):
        return False


def weights_of(name: str, files: ModelFiles) -> Path | None:
    """The weights file: the one named, or the one that torchvision itself has downloaded."""
    if files.weights:
        return Path(files.weights).expanduser()
    if name != "torchvision":
        return None
    home = os.environ.get("TORCH_HOME") or Path("~/.cache/torch").expanduser()
    return Path(home) / "hub" / "checkpoints" / _TORCHVISION_FILE


def _chosen(strong: StrongConfig, asked: str, models: dict[str, str]) -> str:
    if asked != "auto":
        return asked
    ready = (name for name in models if _absence(name, models[name], getattr(strong, name)) is None)
    return next(ready, "none")


def _absence(name: str, library: str, files: ModelFiles) -> str | None:
    """What is missing, None when nothing is."""
    if not importable(library):
        return f"the library {library} is not installed (docs/detection.md)"
    weights = weights_of(name, files)
    if weights is None:
        return f"no weights are named (detect_photos.strong.{name}.weights)"
    if not weights.is_file():
        return f"there is no weights file {weights}"
    if name in ("pointrend", "rtmdet") and not Path(files.settings).expanduser().is_file():
        return f"there is no settings file (detect_photos.strong.{name}.settings)"
    return None


def _checked(name: str, files: ModelFiles) -> ModelFiles:
    library = (INSTANCE_MODELS | BOX_MODELS)[name]
    missing = _absence(name, library, files)
    if missing:
        raise AssetError(f"the model {name} is asked for, but {missing}")
    path = weights_of(name, files)
    assert path is not None
    found = _digest(path, path.stat().st_mtime_ns)
    if files.sha256 and found != files.sha256:
        raise AssetError(f"{path}: has sha256 {found}, the configuration says {files.sha256}")
    return files.model_copy(update={"weights": str(path), "sha256": found})


@cache
def _digest(path: Path, changed: int) -> str:
    return file_digest(path)
