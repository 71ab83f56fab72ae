"""Pickles of plain data: numbers, texts, containers and numpy arrays, nothing that runs code.

Reads what ``pickle`` and ``joblib`` write, joblib's compressed files included, and refuses a file
that asks for any other name. To what :mod:`hoi.plain_pickle` answers come joblib's arrays and the
containers of its files; the state that a pickle may set goes to arrays and their dtypes alone.
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
from hoi.plain_pickle import ARRAY, PLAIN

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


class _JoblibArray:
    """joblib's wrapper: it tells shape and dtype, the raw bytes follow it in the stream."""

    state: dict[str, Any]

    def read(self, stream: Any) -> np.ndarray:
        if self.state.get("subclass") is not ARRAY:
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


def _ordered(*items: Any) -> OrderedDict[Any, Any]:
    return OrderedDict(*items)


def _with_default(*factory: Any) -> dict[Any, Any]:
    """A plain dict in place of a defaultdict: its factory would be called."""
    return {}


_ALLOWED: dict[tuple[str, str], Any] = PLAIN | {
    ("collections", "OrderedDict"): _ordered,
    ("collections", "defaultdict"): _with_default,
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): _JoblibArray,
}
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
