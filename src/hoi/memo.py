"""A content-addressed memo: what was computed once from equal inputs is not computed again.

An entry is found by the digest of everything the result depends on; its payload is stored under
the digest of its own bytes and checked on the way out, so a damaged entry is recomputed, never
believed. Deleting the folder costs time and nothing else.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path

from pydantic import BaseModel, ValidationError


class Entry(BaseModel):
    """What the memo knows of one result."""

    sha256: str
    status: str
    seconds: float


class Memo:
    """The store in one folder, shared by all jobs; writes are atomic."""

    def __init__(self, folder: Path | str):
        self.folder = Path(folder)

    def get(self, key: str, destination: Path) -> Entry | None:
        """Place the result known by `key` at `destination`; None when there is none."""
        try:
            entry = Entry.model_validate_json(self._entry(key).read_text())
            payload = self._payload(entry.sha256)
            intact = hashlib.sha256(payload.read_bytes()).hexdigest() == entry.sha256
        except (FileNotFoundError, ValidationError, json.JSONDecodeError):
            return None
        if not intact:
            payload.unlink()
            return None
        _link(payload, destination)
        return entry

    def put(self, key: str, source: Path, status: str, seconds: float) -> Entry:
        """Remember the file `source` under `key`."""
        digest = hashlib.sha256(source.read_bytes()).hexdigest()
        _link(source, self._payload(digest))
        entry = Entry(sha256=digest, status=status, seconds=seconds)
        target = self._entry(key)
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_suffix(f".{os.getpid()}")
        partial.write_text(entry.model_dump_json())
        partial.replace(target)
        return entry

    def _entry(self, key: str) -> Path:
        return self.folder / "entries" / key[:2] / f"{key}.json"

    def _payload(self, digest: str) -> Path:
        return self.folder / "payloads" / digest[:2] / digest


def _link(source: Path, destination: Path) -> None:
    """Put `source` at `destination` atomically, sharing its bytes where the disk allows."""
    destination.parent.mkdir(parents=True, exist_ok=True)
    partial = destination.with_name(f"{destination.name}.{os.getpid()}")
    partial.unlink(missing_ok=True)
    try:
        os.link(source, partial)
    except OSError:
        shutil.copyfile(source, partial)
    partial.replace(destination)
