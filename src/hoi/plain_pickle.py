"""Reading pickles that hold plain data, without ever running what is in them.

A pickle may name any function of any installed library and have it called. Data sets need numbers,
strings, containers and numpy arrays only, so exactly the few makers of those are answered, by
stand-ins that can make nothing else, and a file that asks for more is refused.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np


class RestrictedUnpickler(pickle.Unpickler):
    """Loads what `allowed` names and refuses the rest by name."""

    def __init__(self, data: bytes, allowed: Mapping[tuple[str, str], Any]):
        super().__init__(io.BytesIO(data), encoding="latin1")
        self.allowed = allowed

    def find_class(self, module: str, name: str) -> Any:
        """The stand-in of one name; raises UnpicklingError for every other name."""
        if (module, name) in self.allowed:
            return self.allowed[module, name]
        raise pickle.UnpicklingError(
            f"it asks for {module}.{name}, which is no plain data; refused, because loading it "
            "could run code"
        )


def load_plain(path: Path) -> dict[str, Any]:
    """The dictionary in a pickle of plain data.

    Raises UnpicklingError when the file is damaged, asks for anything but plain data, or holds
    something else than a dictionary with text keys.
    """
    try:
        content = RestrictedUnpickler(path.read_bytes(), PLAIN).load()
    except pickle.UnpicklingError:
        raise
    except Exception as error:  # damaged opcodes end in nearly every kind of exception
        raise pickle.UnpicklingError(f"damaged: {type(error).__name__}: {error}") from error
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise pickle.UnpicklingError(f"holds a {type(content).__name__}, expected a dictionary")
    return content


def _latin1_bytes(text: str, encoding: str = "latin1") -> bytes:
    if encoding not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError("the file asks for an unexpected text encoding")
    return text.encode("latin1")


def _new_array(cls: type, shape: tuple, typecode: Any) -> np.ndarray:
    """numpy's array maker, for plain arrays only; the pickle fills them in afterwards."""
    if cls is not np.ndarray:
        raise pickle.UnpicklingError("the file asks for an unexpected kind of array")
    return np.ndarray.__new__(np.ndarray, (0,), "b")


def _new_scalar(dtype: np.dtype, data: bytes) -> Any:
    if not isinstance(dtype, np.dtype) or dtype.hasobject:
        raise pickle.UnpicklingError("the file asks for an unexpected kind of number")
    return np.frombuffer(data, dtype=dtype, count=1)[0]


def _array_of_buffer(data: Any, dtype: np.dtype, shape: tuple, order: str = "C") -> np.ndarray:
    """How pickles of protocol 5 make arrays."""
    if not isinstance(dtype, np.dtype) or dtype.hasobject:
        raise pickle.UnpicklingError("the file asks for an unexpected kind of array")
    return np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if order == "F" else "C")


def _plain() -> dict[tuple[str, str], Any]:
    names: dict[tuple[str, str], Any] = {
        ("numpy", "ndarray"): np.ndarray,
        ("numpy", "dtype"): np.dtype,
        ("_codecs", "encode"): _latin1_bytes,
    }
    for core in ("numpy.core", "numpy._core"):
        names[f"{core}.multiarray", "_reconstruct"] = _new_array
        names[f"{core}.multiarray", "scalar"] = _new_scalar
        names[f"{core}.numeric", "_frombuffer"] = _array_of_buffer
    return names


#: What plain data needs: module and name as they stand in the file -> harmless maker.
PLAIN: dict[tuple[str, str], Any] = _plain()
