"""ShapeNetCore folders: meshes without part labels, by WordNet synset.

Version 2 keeps ``<synset>/<model>/models/model_normalized.obj``, version 1
``<synset>/<model>/model.obj``. Both are y up. By what public code that reads them does, version 2
has its front at -z and version 1 at +x; `exemplars.shapenet_yaw_degrees` says otherwise.
"""

from __future__ import annotations

from pathlib import Path

from hoi.errors import ConfigError

#: Our noun -> synset folders of ShapeNetCore.
SYNSETS = {
    "chair": ("03001627",),
    "table": ("04379243",),
    "desk": ("04379243",),
    "couch": ("04256520",),
    "bed": ("02818832",),
    "mug": ("03797390",),
    "bottle": ("02876657",),
    "bowl": ("02880940",),
    "backpack": ("02773838",),
    "suitcase": ("02773838",),
    "handbag": ("02773838",),
    "keyboard": ("03085013",),
    "laptop": ("03642806",),
    "display": ("03211117",),
    "lamp": ("03636649",),
    "trashcan": ("02747177",),
    "skateboard": ("04225987",),
    "knife": ("03624134",),
    "cabinet": ("02933112",),
    "clock": ("03046257",),
}
_LAYOUTS = (("models/model_normalized.obj", 180.0), ("model.obj", -90.0))


def list_shapes(root: Path, noun: str) -> list[Path]:
    """The mesh files of a noun's synsets, sorted; empty when the noun or its folder is absent."""
    found = []
    for synset in SYNSETS.get(noun, ()):
        folder = root / synset
        models = sorted(folder.iterdir()) if folder.is_dir() else []
        for model in models:
            file = next((model / f for f, _ in _LAYOUTS if (model / f).is_file()), None)
            if file is not None:
                found.append(file)
    return found


def model_name(file: Path) -> str:
    """The model's hash, of either layout."""
    return file.parent.parent.name if file.parent.name == "models" else file.parent.name


def default_yaw(file: Path) -> float:
    """Degrees about y that bring the layout's front to +z."""
    return next(yaw for name, yaw in _LAYOUTS if file.name == Path(name).name)


def shapenet_nouns(root: Path | str) -> tuple[str, ...]:
    """Our nouns whose synset folder is there; raises ConfigError when the root is not."""
    folder = Path(root).expanduser()
    if not folder.is_dir():
        raise ConfigError(f"exemplars.shapenet: there is no folder {folder}")
    return tuple(n for n, synsets in SYNSETS.items() if any((folder / s).is_dir() for s in synsets))
