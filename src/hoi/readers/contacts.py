"""Contact of every body vertex, as DECO, BSTRO, POSA or an annotator give it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hoi.errors import AssetError
from hoi.readers.config import ContactFiles
from hoi.readers.files import entry, numbers, read_npz
from hoi.readers.paths import FrameNames, fill


def read_contacts(files: ContactFiles, names: FrameNames, root: Path) -> np.ndarray:
    """(V,) float32 probability of contact of every body vertex, from key ``contact``.

    Raises AssetError naming file and key.
    """
    path = fill(files.path, names, root)
    values = numbers(entry(read_npz(path), "contact", path), "contact", path)
    values = values.reshape(-1) if values.size == max(values.shape, default=0) else values
    if values.ndim != 1 or not len(values):
        raise AssetError(f"{path}: key 'contact' has shape {values.shape}, expected (vertices,)")
    if values.min() < 0 or values.max() > 1:
        raise AssetError(f"{path}: key 'contact' holds values outside 0..1")
    return values.astype(np.float32)
