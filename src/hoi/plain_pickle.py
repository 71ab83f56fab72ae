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


class _ArrayType:
    """Stands for ``numpy.ndarray`` where a pickle names the class: it cannot be called."""


ARRAY = _ArrayType()


def _new_array(cls: Any, shape: Any, typecode: Any) -> np.ndarray:
    """numpy's array maker, for plain arrays only; the pickle fills them in afterwards."""
    if cls is not ARRAY:
        raise pickle.UnpicklingError("it holds an array of an unexpected class; refused")
    return np.zeros(0, "b")


def _new_scalar(dtype: Any, data: Any) -> Any:
    if not isinstance(dtype, np.dtype) or dtype.hasobject or not isinstance(data, bytes):
        raise pickle.UnpicklingError("it holds a number of an unexpected kind; refused")
    return np.frombuffer(data, dtype, count=1)[0]


def _array_of_buffer(data: Any, dtype: Any, shape: Any, order: Any = "C") -> np.ndarray:
    """How pickles of protocol 5 make arrays."""
    if not isinstance(dtype, np.dtype) or dtype.hasobject:
        raise pickle.UnpicklingError("it holds an array of Python objects; refused")
    return np.frombuffer(data, dtype).reshape(shape, order=order)


def _new_dtype(name: Any, *flags: Any) -> np.dtype:
    if not isinstance(name, str | bytes):
        raise pickle.UnpicklingError("it holds a dtype of an unexpected kind; refused")
    # a copy: its state is set next (byte order), which the shared dtypes of numpy would ignore
    return np.dtype(name.decode("latin1") if isinstance(name, bytes) else name, False, True)


def _latin1_bytes(text: str, encoding: str = "latin1") -> bytes:
    if encoding not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError("it asks for an unexpected text encoding; refused")
    return text.encode("latin1")


def _plain() -> dict[tuple[str, str], Any]:
    names: dict[tuple[str, str], Any] = {
        ("numpy", "ndarray"): ARRAY,
        ("numpy", "dtype"): _new_dtype,
        ("_codecs", "encode"): _latin1_bytes,
    }
    for core in ("numpy.core", "numpy._core"):
        names[f"{core}.multiarray", "_reconstruct"] = _new_array
        names[f"{core}.multiarray", "scalar"] = _new_scalar
        names[f"{core}.numeric", "_frombuffer"] = _array_of_buffer
    return names


#: What plain data needs: module and name as they stand in the file -> harmless maker.
PLAIN: dict[tuple[str, str], Any] = _plain()
