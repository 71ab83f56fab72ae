"""Pickles of plain data: numbers, texts, containers and numpy arrays, nothing that runs code.

Reads what ``pickle`` and ``joblib`` write, joblib's compressed files included, and refuses a file
that asks for any other name. What may be called is made anew here; the state that a pickle may
set goes to arrays and their dtypes alone.
"""

from __future__ import annotations

import gzip
import io
import pickle
import zlib
from collections import OrderedDict
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from hoi.errors import AssetError

_MAX_BYTES = 1 << 31


def read_plain_pickle(path: Path) -> Any:
    """The content of a pickle; raises AssetError that names the file and what was refused."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise AssetError(f"{path}: no such file") from None
    except OSError as error:
        raise AssetError(f"{path}: {error}") from error
    try:
        return _PlainUnpickler(io.BytesIO(_decompressed(data))).load()
    except pickle.UnpicklingError as error:
        raise AssetError(f"{path}: {error}") from error
    except Exception as error:  # a damaged pickle raises nearly every kind of exception
        raise AssetError(f"{path}: not a readable pickle: {error!r}") from error


def _decompressed(data: bytes) -> bytes:
    if data[:2] == b"\x1f\x8b":
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            plain = stream.read(_MAX_BYTES + 1)
    elif data[:1] == b"\x78":
        plain = zlib.decompressobj().decompress(data, _MAX_BYTES + 1)
    else:
        return data
    if len(plain) > _MAX_BYTES:
        raise pickle.UnpicklingError("it grows over 2 GiB when it is decompressed; refused")
    return plain


class _ArrayType:
    """Stands for ``numpy.ndarray`` where a pickle names the class: it cannot be called."""


_ARRAY = _ArrayType()


class _JoblibArray:
    """joblib's wrapper: it tells shape and dtype, the raw bytes follow it in the stream."""

    state: dict[str, Any]

    def read(self, stream: Any) -> np.ndarray:
        if self.state.get("subclass") is not _ARRAY:
            raise pickle.UnpicklingError("it holds an array of an unexpected class; refused")
        dtype, shape = self.state["dtype"], tuple(int(n) for n in self.state["shape"])
        if not isinstance(dtype, np.dtype) or dtype.hasobject:
            raise pickle.UnpicklingError("it holds an array of Python objects; refused")
        if self.state.get("numpy_array_alignment_bytes") is not None:
            stream(stream(1)[0])
        count = int(np.prod(shape, dtype=np.int64))
        size = count * dtype.itemsize
        if count < 0 or size > _MAX_BYTES:
            raise pickle.UnpicklingError("it holds an array over 2 GiB; refused")
        data = stream(size)
        if len(data) != size:
            raise EOFError("an array is cut short")
        flat = np.frombuffer(data, dtype)
        if self.state.get("order") == "F":
            return flat.reshape(shape[::-1]).transpose()
        return flat.reshape(shape)


def _new_array(cls: Any, shape: Any, typecode: Any) -> np.ndarray:
    if cls is not _ARRAY:
        raise pickle.UnpicklingError("it holds an array of an unexpected class; refused")
    return np.zeros(0, "b")


def _new_scalar(dtype: Any, data: Any) -> Any:
    if not isinstance(dtype, np.dtype) or dtype.hasobject or not isinstance(data, bytes):
        raise pickle.UnpicklingError("it holds a number of an unexpected kind; refused")
    return np.frombuffer(data, dtype, count=1)[0]


def _from_buffer(data: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
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


def _ordered(*items: Any) -> OrderedDict[Any, Any]:
    return OrderedDict(*items)


def _with_default(*factory: Any) -> dict[Any, Any]:
    """A plain dict in place of a defaultdict: its factory would be called."""
    return {}


_ALLOWED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): _ARRAY,
    ("numpy", "dtype"): _new_dtype,
    ("_codecs", "encode"): _latin1_bytes,
    ("collections", "OrderedDict"): _ordered,
    ("collections", "defaultdict"): _with_default,
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): _JoblibArray,
}
for _core in ("numpy.core", "numpy._core"):
    _ALLOWED[f"{_core}.multiarray", "_reconstruct"] = _new_array
    _ALLOWED[f"{_core}.multiarray", "scalar"] = _new_scalar
    _ALLOWED[f"{_core}.numeric", "_frombuffer"] = _from_buffer
for _module in ("builtins", "__builtin__"):
    for _factory in ("list", "dict", "int", "float", "set", "tuple"):
        _ALLOWED[_module, _factory] = f"{_factory} (named only)"


class _PlainUnpickler(pickle._Unpickler):  # type: ignore[name-defined]
    """The unpickler written in Python: joblib's arrays need a hook where state is set."""

    dispatch: ClassVar[dict[int, Any]] = dict(pickle._Unpickler.dispatch)  # type: ignore[attr-defined]

    def __init__(self, file: io.BytesIO):
        super().__init__(file, encoding="latin1")
        self._raw_read = file.read

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _ALLOWED:
            return _ALLOWED[module, name]
        raise pickle.UnpicklingError(
            f"it asks for {module}.{name}; refused, because loading it could run code. Save plain "
            "numpy arrays instead (tensors: .cpu().numpy())"
        )

    def load_build(self) -> None:
        stack: list[Any] = self.stack  # type: ignore[attr-defined]
        state = stack.pop()
        target: Any = stack[-1]
        if isinstance(target, _JoblibArray) and isinstance(state, dict):
            target.state = state
            stack[-1] = target.read(self._raw_read)
        elif isinstance(target, np.ndarray | np.dtype) and isinstance(state, tuple):
            target.__setstate__(state)  # type: ignore[attr-defined]
        else:
            raise pickle.UnpicklingError("it sets the state of an unexpected object; refused")

    dispatch[pickle.BUILD[0]] = load_build
