"""Made-up furniture packs, so that the segmenter's recipe runs without any download."""

import io
import zipfile
from pathlib import Path

import cv2
import numpy as np

from hoi.segmenter.meshes import PACKS

_MATERIALS = """newmtl painted
Kd 0.8 0.7 0.6
Ks 0.3 0.3 0.3
map_Kd bricks.png
newmtl plain
Kd 0.1 0.4 0.8
newmtl glass
Kd 1 1 1
d 0.1
"""
_CORNERS = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def box_obj() -> str:
    """A cube of quads: one side textured, one glass, one without texture points."""
    lines = ["mtllib box.mtl"]
    lines += [f"v {x} {y} {z}" for x, y, z in _CORNERS]
    lines += [f"vt {u} {v}" for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))]
    for number, side in enumerate(_SIDES):
        lines.append(
            f"usemtl {('painted', 'painted', 'painted', 'plain', 'plain', 'glass')[number]}"
        )
        corners = [f"{c + 1}" if number == 3 else f"{c + 1}/{k + 1}" for k, c in enumerate(side)]
        lines.append("f " + " ".join(corners))
    return "\n".join(lines) + "\n"


def write_packs(folder: Path, entries: int = 6) -> Path:
    """One pack of each name; entry 1 is a chair, the others differ in size; people stand."""
    folder.mkdir(parents=True, exist_ok=True)
    picture = np.random.default_rng(0).integers(0, 255, (32, 40, 3), np.uint8)
    for pack in PACKS:
        person = pack == "Reallusion"
        lines = []
        for index in range(1, entries + 1):
            size = (50, 170, 30) if person else (30 + 10 * index, 40 + 8 * index, 35 + 5 * index)
            name = "Standing person" if person else ("Chair" if index == 1 else f"Thing {index}")
            lines += [
                f"name#{index}={name}",
                f"model#{index}=/box.obj",
                f"category#{index}={'Characters' if person else 'Office'}",
                f"creator#{index}=test",
                *(f"{k}#{index}={v}" for k, v in zip(("width", "height", "depth"), size,
                                                     strict=True)),
            ]  # fmt: skip
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as archive:
            archive.writestr("PluginFurnitureCatalog.properties", "\n".join(lines))
            archive.writestr("box.obj", box_obj())
            archive.writestr("box.mtl", _MATERIALS)
            archive.writestr("bricks.png", cv2.imencode(".png", picture)[1].tobytes())
        (folder / f"{pack}.sh3f").write_bytes(buffer.getvalue())
    return folder
