"""Run one stage over one chunk of frames: the loop that every stage shares.

A chunk's result is one artifact per frame in a folder, and an index beside it that names each
artifact by its sha256. A frame that fails, here or upstream, flows on as an artifact with a
status. What the memo knows is linked, not recomputed, so only frames whose inputs changed cost
time; the stage itself (and the libraries it imports) is loaded only when a frame needs it.
"""

from __future__ import annotations

import hashlib
import json
import random
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from hoi.artifacts import OK, Artifact
from hoi.digest import json_digest
from hoi.errors import ArtifactError, FrameFailure
from hoi.memo import Entry, Memo

A = TypeVar("A", bound=Artifact)
T = TypeVar("T")


class FrameEntry(BaseModel):
    """One frame's line in an index."""

    sha256: str
    status: str


class Index(BaseModel):
    """The artifacts of one stage for one chunk of frames, in frame order."""

    stage: str
    frames: dict[str, FrameEntry]

    def save(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(self.model_dump_json(indent=1) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> Index:
        try:
            return cls.model_validate_json(Path(path).read_text())
        except FileNotFoundError as error:
            raise ArtifactError(f"{path}: the index of this chunk is not there") from error
        except (ValidationError, UnicodeDecodeError) as error:
            raise ArtifactError(f"{path}: not a valid index: {error}") from error


def artifact_path(index_path: Path | str, frame_id: str) -> Path:
    """Where the artifact of one frame lies, given its chunk's index."""
    return Path(index_path).with_suffix("") / f"{frame_id}.npz"


def read_artifacts(kind: type[A], index_path: Path | str) -> Iterable[A]:
    """The artifacts of a chunk, in frame order."""
    for frame_id in Index.load(index_path).frames:
        yield kind.load(artifact_path(index_path, frame_id))


def frame_seed(seed: int, frame_id: str, stage: str) -> int:
    """The seed of one frame in one stage: the same alone, in a chunk, and with any job count."""
    return int(json_digest([seed, frame_id, stage])[:8], 16)


def run_chunk(
    stage: str,
    output_kind: type[Artifact],
    make_stage: Callable[[], Callable[..., Artifact]],
    inputs: Mapping[str, tuple[type[Artifact], Path | str]],
    index_path: Path | str,
    seconds_path: Path | str,
    memo: Memo,
    identity: Mapping[str, object],
    seed: int,
    views: Mapping[str, Callable[[Any], Artifact]] | None = None,
) -> Index:
    """Apply a stage to every frame of a chunk.

    Args:
        stage: name of the stage, for messages and statuses.
        output_kind: the artifact it writes.
        make_stage: builds the stage; called at most once, when a frame is not in the memo.
        inputs: argument name -> (artifact type, index of the chunk in that stage).
        index_path: where to write the index; artifacts go into the folder of the same name.
        seconds_path: where to write how long each frame took when it was computed.
        memo: where results are remembered.
        identity: everything else the result depends on: settings, code, assets.
        seed: the run's seed.
        views: argument name -> what the stage is given in place of that artifact: the part that it
            reads. A frame is computed again when this part changes, not when the rest does.
    """
    indexes = {name: Index.load(path) for name, (_, path) in inputs.items()}
    frame_ids = _common_frames(stage, indexes)
    views = views or {}

    def read(name: str, frame_id: str) -> Artifact:
        kind, path = inputs[name]
        artifact = kind.load(artifact_path(path, frame_id))
        return views[name](artifact) if name in views and artifact.ok else artifact

    def digest(name: str, frame_id: str) -> str:
        if name in views:
            return hashlib.sha256(read(name, frame_id).to_bytes()).hexdigest()
        return indexes[name].frames[frame_id].sha256

    def compute(frame_id: str) -> Artifact:
        artifacts = {name: read(name, frame_id) for name in inputs}
        for artifact in artifacts.values():
            if not artifact.ok:
                return output_kind.skipped(frame_id, artifact)
        return stage_of()(**artifacts, seed=frame_seed(seed, frame_id, stage))

    def prepare() -> None:
        needed = any(
            all(index.frames[frame_id].status == OK for index in indexes.values())
            for frame_id in frame_ids
        )
        if needed:
            stage_of()

    stage_of = _once(make_stage)
    keys = {
        frame_id: json_digest(
            {
                "stage": stage,
                "frame": frame_id,
                "seed": seed,
                "identity": identity,
                "inputs": {name: digest(name, frame_id) for name in inputs},
            }
        )
        for frame_id in frame_ids
    }
    return write_chunk(stage, output_kind, frame_ids, compute, keys, index_path, seconds_path, memo)


def write_chunk(
    stage: str,
    output_kind: type[Artifact],
    frame_ids: Sequence[str],
    compute: Callable[[str], Artifact],
    keys: Mapping[str, str],
    index_path: Path | str,
    seconds_path: Path | str,
    memo: Memo,
    prepare: Callable[[], None] = lambda: None,
) -> Index:
    """Write one artifact per frame, from the memo or by `compute`, and the chunk's index.

    `prepare` is called once, before the first frame that is not in the memo; what it takes
    (importing libraries, loading models) is no frame's time.
    """
    index_path = Path(index_path)
    entries: dict[str, Entry] = {}
    prepared = False
    for number, frame_id in enumerate(frame_ids, 1):
        path = artifact_path(index_path, frame_id)
        entry = memo.get(keys[frame_id], path)
        remembered = entry is not None
        if entry is None:
            if not prepared:
                started = time.perf_counter()
                prepare()
                prepared = True
                print(f"{stage} loaded ({time.perf_counter() - started:.1f} s)", file=sys.stderr)
            # one frame alone must give the same bytes as the whole run
            random.seed(0)
            np.random.seed(0)  # noqa: NPY002 - libraries may draw from the global generator
            started = time.perf_counter()
            try:
                artifact = compute(frame_id)
            except FrameFailure as failure:
                # a stage may tell more of its failure than the reason, e.g. what it looked at
                told = getattr(failure, "artifact", None)
                artifact = told or output_kind.failed(frame_id, failure, stage)
            except Exception as error:
                error.add_note(f"in stage {stage}, frame {frame_id}")
                raise
            seconds = time.perf_counter() - started
            artifact.save(path)
            entry = memo.put(keys[frame_id], path, artifact.status, seconds)
        entries[frame_id] = entry
        how = "remembered" if remembered else f"{entry.seconds:.1f} s"
        print(
            f"{stage} {number}/{len(frame_ids)} {frame_id}: {entry.status} ({how})",
            file=sys.stderr,
            flush=True,
        )
    _remove_strangers(index_path.with_suffix(""), set(frame_ids))
    index = Index(
        stage=stage,
        frames={
            frame_id: FrameEntry(sha256=entry.sha256, status=entry.status)
            for frame_id, entry in entries.items()
        },
    )
    index.save(index_path)
    seconds = {frame_id: round(entry.seconds, 3) for frame_id, entry in entries.items()}
    Path(seconds_path).write_text(json.dumps(seconds, indent=1) + "\n")
    return index


def _once(make: Callable[[], T]) -> Callable[[], T]:
    made: list[T] = []

    def get() -> T:
        if not made:
            made.append(make())
        return made[0]

    return get


def _common_frames(stage: str, indexes: Mapping[str, Index]) -> list[str]:
    first, *others = indexes.values()
    frame_ids = list(first.frames)
    for other in others:
        if list(other.frames) != frame_ids:
            raise ArtifactError(
                f"stage {stage}: its inputs list different frames; "
                f"{first.stage} and {other.stage} come from different runs"
            )
    return frame_ids


def _remove_strangers(folder: Path, frame_ids: set[str]) -> None:
    """Delete artifacts of frames that are no longer in this chunk."""
    for path in folder.glob("*.npz"):
        if path.stem not in frame_ids:
            path.unlink()
