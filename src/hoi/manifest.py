"""Which frames a table needs, and the chunks in which they are worked through.

Made before anything runs, from names and file digests alone: no checkpoint, no heavy import.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from hoi.config import RunConfig
from hoi.datasets import behave_layout
from hoi.datasets.behave_config import BehaveConfig
from hoi.datasets.photos_config import PhotoNotes
from hoi.digest import file_digest, json_digest
from hoi.errors import FrameFailure
from hoi.exemplars.categories import known_categories
from hoi.exemplars.vocabulary import exemplar_category
from hoi.own_objects.description import own_objects, with_own_categories
from hoi.readers.config import OtherSystems
from hoi.readers.paths import FrameNames, behave_names

PHOTOS = "photos"
BEHAVE_MINI_ROOT = "resources/behave_mini"
INTERACTIONS = "interactions"


@dataclass(frozen=True)
class FrameInfo:
    """One frame, known before it is read. `digest` stands for the content of its raw files,
    `others` for that of the files in which other systems say something of it."""

    frame_id: str
    dataset: str
    category: str
    object_name: str
    action: str
    digest: str
    others: str = ""

    def labels(self) -> dict[str, str]:
        """What the tables say of the frame, also when a stage fails on it."""
        return {
            "dataset": self.dataset,
            "category": self.category,
            "object_name": self.object_name,
            "action": self.action,
        }


@dataclass(frozen=True)
class Chunk:
    """Frames that one job works through."""

    name: str
    group: str
    frames: tuple[FrameInfo, ...]

    @property
    def frame_ids(self) -> list[str]:
        return [frame.frame_id for frame in self.frames]

    @property
    def categories(self) -> list[str]:
        return sorted({frame.category for frame in self.frames})


def plan(config: RunConfig, group: str) -> list[Chunk]:
    """The chunks of one table group (chair, table, keyboard, backpack), photos or interactions."""
    size = config.chunk_size
    if group == PHOTOS:
        frames = _photos(config)
    elif group == INTERACTIONS:
        frames, size = _interactions(config), config.interactions.chunk_size
    elif config.dataset_name == "behave":
        frames = _behave(config, group)
    else:
        frames = _behave_mini(config, group)
    return [
        Chunk(f"{group}-{number:03d}", group, tuple(frames[start : start + size]))
        for number, start in enumerate(range(0, len(frames), size))
    ]


def _behave_mini(config: RunConfig, group: str) -> list[FrameInfo]:
    from hoi.datasets.behave_mini.plan import plan as plan_frames

    settings = config.behave_mini_settings
    # generated from settings and code alone; their digests reach the rule as parameters
    with FileDigests(Path(config.memo) / "digests.json") as digests:
        return [
            _info(ref, "behave_mini", "", _others_of(config, "behave_mini", ref, digests))
            for ref in plan_frames(settings, group, config.split)
        ]


def _behave(config: RunConfig, group: str) -> list[FrameInfo]:
    from hoi.datasets import behave

    root = config.behave_root
    refs = behave.list_frames(root, group, config.split, config.behave)
    refs = thinned(refs, config.frames)
    with FileDigests(Path(config.memo) / "digests.json") as digests:
        return [
            _info(
                ref,
                "behave",
                digests.of(_raw_files(root, ref, config.behave)),
                _others_of(config, "behave", ref, digests),
            )
            for ref in refs
        ]


def _raw_files(root: Path, ref: behave_layout.FrameRef, config: BehaveConfig) -> list[Path]:
    """The files behind one frame. A frame whose files cannot even be named fails when it is read,
    with its reason; here it counts by what it has."""
    from hoi.datasets import behave

    files: list[Path] = []
    for name in (behave.frame_files, behave.ground_truth_files):
        with contextlib.suppress(FrameFailure):
            files += name(root, ref, config)
    return files


def _photos(config: RunConfig) -> list[FrameInfo]:
    from hoi.datasets import photos

    folder = Path(config.photos.folder).expanduser()
    known = with_own_categories(
        known_categories(config.exemplars), own_objects(config.assets.own_objects)
    )
    with FileDigests(Path(config.memo) / "digests.json") as digests:
        return [
            FrameInfo(
                frame_id=ref.frame_id,
                dataset=PHOTOS,
                category=exemplar_category(ref.category, known),
                object_name=ref.category,
                action="",
                digest=_noted(digests.of(photos.photo_files(folder, ref)), ref.notes),
                others=_others(config, PHOTOS, FrameNames(ref.frame_id, ref.file), folder, digests),
            )
            for ref in photos.list_photos(config.photos)
        ]


def _noted(digest: str, notes: PhotoNotes) -> str:
    """The digest of a photo's files, and of what other files or settings say of it."""
    said = notes.model_dump(mode="json", exclude_none=True)
    said.pop("object", None)  # known as the frame's category and name
    return json_digest([digest, said]) if said else digest


def _interactions(config: RunConfig) -> list[FrameInfo]:
    from hoi.interactions import images

    own = own_objects(config.assets.own_objects)
    known = with_own_categories(known_categories(config.exemplars), own)
    with FileDigests(Path(config.memo) / "digests.json") as digests:
        return [
            FrameInfo(
                frame_id=ref.frame_id,
                dataset=INTERACTIONS,
                category=ref.category,
                object_name=ref.query,
                action=ref.action,
                digest=digests.of(images.image_files(config.interactions, ref)),
            )
            for ref in images.list_images(config.interactions, known)
        ]


def _info(ref: behave_layout.FrameRef, dataset: str, digest: str, others: str) -> FrameInfo:
    return FrameInfo(
        ref.frame_id, dataset, ref.category, ref.object_name, ref.action, digest, others
    )


def _others_of(
    config: RunConfig, dataset: str, ref: behave_layout.FrameRef, digests: FileDigests
) -> str:
    released = dataset == "behave"
    root = config.behave_root if released else Path(BEHAVE_MINI_ROOT)
    kinect = config.behave.kinect if released else 1
    names = behave_names(ref.frame_id, ref.sequence, ref.time, kinect)
    return _others(config, dataset, names, root, digests)


def _others(
    config: RunConfig, dataset: str, names: FrameNames, root: Path, digests: FileDigests
) -> str:
    """Digest of the other systems' files of one frame, empty when none are named."""
    systems = config.systems_for(dataset)
    if systems == OtherSystems():
        return ""
    # one by one: files of several systems may share their names
    return json_digest([digests.of([path]) for path in systems.files(names, root)])


def thinned(
    refs: list[behave_layout.FrameRef], per_action: int | str
) -> list[behave_layout.FrameRef]:
    """At most `per_action` frames of each action, spread evenly; all of them for ``all``."""
    if isinstance(per_action, str):
        return refs
    kept = []
    for action in sorted({ref.action for ref in refs}):
        of_action = [ref for ref in refs if ref.action == action]
        count = min(per_action, len(of_action))
        kept += [of_action[i * len(of_action) // count] for i in range(count)]
    return sorted(kept)


class FileDigests:
    """sha256 of files, remembered while a file's size, times and inode stay what they were."""

    def __init__(self, path: Path):
        self.path = path
        self.known: dict[str, list] = {}
        self.changed = False

    def __enter__(self) -> FileDigests:
        try:
            self.known = json.loads(self.path.read_text())
        except (FileNotFoundError, ValueError):
            self.known = {}
        return self

    def __exit__(self, *_: object) -> None:
        if self.changed:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            partial = self.path.with_suffix(f".{os.getpid()}")
            partial.write_text(json.dumps(self.known))
            partial.replace(self.path)

    def of(self, paths: Iterable[Path]) -> str:
        """One digest for several files, by name and content."""
        return json_digest({path.name: self._one(path) for path in paths})

    def _one(self, path: Path) -> str:
        stat = os.stat(path)
        stamp = [stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino]
        key = os.path.abspath(path)
        if self.known.get(key, [None])[0] != stamp:
            self.known[key] = [stamp, file_digest(path)]
            self.changed = True
        return self.known[key][1]


def frame_labels(chunks: Iterable[Chunk]) -> dict[str, dict[str, str]]:
    """Frame id -> what the tables say of it."""
    return {frame.frame_id: frame.labels() for chunk in chunks for frame in chunk.frames}


def chunk_settings(chunk: Chunk) -> list[dict[str, str]]:
    """A chunk's frames as plain data: a rule that reads raw files depends on it."""
    return [asdict(frame) for frame in chunk.frames]
