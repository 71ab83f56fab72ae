"""Untrusted files of other systems: JSON, plain pickles and npz, with errors that name the key."""

from __future__ import annotations

import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hoi.errors import AssetError


def read_json(path: Path) -> Any:
    """The content of a JSON file; raises AssetError.

    The latest files are remembered, for one file often holds all frames.
    """
    try:
        stat = path.stat()
    except FileNotFoundError:
        raise AssetError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise AssetError(f"{path}: {error}") from error
    return _read_json(str(path), stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=4)
def _read_json(path: str, modified: int, size: int) -> Any:
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise AssetError(f"{path}: not readable as JSON: {error}") from error


def entry(mapping: Any, key: str, path: Path) -> Any:
    """The value of a key; raises AssetError naming file and key."""
    if not isinstance(mapping, dict):
        raise AssetError(f"{path}: expected an object with {key!r}, found {_kind(mapping)}")
    if key not in mapping:
        have = ", ".join(map(repr, list(mapping)[:8])) or "nothing"
        raise AssetError(f"{path}: key {key!r} is missing; it has {have}")
    return mapping[key]


def listed(value: Any, key: str, path: Path) -> list[Any]:
    """The value itself, which must be a list."""
    if not isinstance(value, list):
        raise AssetError(f"{path}: key {key!r} is {_kind(value)}, expected a list")
    return value


def numbers(value: Any, key: str, path: Path) -> np.ndarray:
    """A finite float64 array; raises AssetError naming file and key."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iufb":
            raise ValueError(f"holds {array.dtype} values")
        array = array.astype(np.float64)
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise AssetError(f"{path}: key {key!r} is no array of numbers: {error}") from None
    if not np.isfinite(array).all():
        raise AssetError(f"{path}: key {key!r} holds NaN or infinity")
    return array


def number(value: Any, key: str, path: Path) -> float:
    """One finite number; raises AssetError naming file and key."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise AssetError(f"{path}: key {key!r} is {value!r}, expected a number")
    return float(value)


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an npz file, never unpickled; raises AssetError."""
    if not path.is_file():
        raise AssetError(f"{path}: no such file")
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}
    except Exception as error:  # whatever zip, zlib and numpy make of damaged bytes
        raise AssetError(f"{path}: not a readable npz file: {error}") from error


def _kind(value: Any) -> str:
    return f"a {type(value).__name__}"
