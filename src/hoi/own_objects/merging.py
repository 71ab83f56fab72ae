"""The package's tables and poses with those of the user's own objects added.

The stages read one pose database, one action space and one set of prior tables. These are written
for the frames that show an own object; all other frames keep reading the package's own files.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hoi.actions.database import PoseDatabase, load_database, save_database
from hoi.errors import AssetError, ConfigError
from hoi.own_objects.description import OwnObject
from hoi.own_objects.knowledge import pose_rows

GIVEN_RELATION = "Given"  # no edge of ConceptNet: the owner of the object says so
# table -> leading columns that name a row, and the own table that speaks in its place
_KEYS = {
    "sizes.csv": (1, "sizes.csv"),
    "extents.csv": (1, "sizes.csv"),
    "contacts.csv": (2, "contacts.csv"),
    "alternatives.csv": (2, "contacts.csv"),
    "arrangements.csv": (2, "contacts.csv"),
    "actions.csv": (2, "actions.csv"),
}


def merge_poses(database: PoseDatabase, objects: Mapping[str, OwnObject]) -> PoseDatabase:
    """The database with borrowed poses for every action of every own object.

    An only action without poses gets every pose: there is nothing to tell it from. Raises
    ConfigError naming object and action when there is nothing to borrow.
    """
    rows: list[int] = []
    labels: list[tuple[str, str, str]] = []
    for category, described in objects.items():
        for action, entry in described.actions.items():
            borrowed = _borrowed(database, described, action, entry.poses)
            rows += borrowed
            labels += [
                (f"{category}/{action}/{number:04d}_{database.pose_ids[row]}", category, action)
                for number, row in enumerate(borrowed)
            ]
    if not rows:
        return database
    ids, categories, actions = (np.array(column) for column in zip(*labels, strict=True))
    ups = database.pelvis_up
    return PoseDatabase(
        np.concatenate([database.pose_ids, ids]),
        np.concatenate([database.categories, categories]),
        np.concatenate([database.actions, actions]),
        np.concatenate([database.body_pose, database.body_pose[rows]]),
        None if ups is None else np.concatenate([ups, ups[rows]]),
    )


def _borrowed(
    database: PoseDatabase, described: OwnObject, action: str, sources: Sequence[str]
) -> list[int]:
    category = described.category
    if not sources:
        if action in database.actions_of(category):
            return []
        if len(described.actions) == 1:
            _, first = np.unique(database.body_pose, axis=0, return_index=True)
            return sorted(int(row) for row in first)
    rows = sorted({row for source in sources for row in pose_rows(source, database)})
    if not rows:
        raise ConfigError(
            f"{category}: no pose of the database shows {action!r} (poses: "
            f"{', '.join(sources) or 'none'}); edit its object.yaml or run hoi add-object "
            "again with --pose"
        )
    return rows


def merge_action_space(path: Path | str, objects: Mapping[str, OwnObject], out: Path | str) -> None:
    """The action space with own actions; the first of an object weighs most, the default one."""
    text = Path(path).read_text(encoding="utf-8")
    lines = [text.rstrip("\n")]
    for category, described in objects.items():
        heaviest = 100.0 + len(described.actions)
        lines += [
            "\t".join([category, category, GIVEN_RELATION, action, f"{heaviest - rank}", action])
            for rank, action in enumerate(described.actions)
        ]
    _write(Path(out), "\n".join(lines) + "\n")


def merge_tables(
    tables: Sequence[Path | str], objects: Mapping[str, OwnObject], folder: Path | str
) -> None:
    """Copies of the prior tables in `folder`, rows of own objects in place of the package's.

    Where an own object says a size or contacts, the package's other answers to the same question
    (extents, alternatives, arrangements) are left out, too. Columns that own objects have no word
    for stay empty. Raises AssetError for a damaged table.
    """
    own = _own_rows(objects)
    for table in map(Path, tables):
        with open(table, newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream)
            columns = list(reader.fieldnames or ())
            rows = list(reader)
        count, spoken = _KEYS[table.name]
        added = own.get(table.name, [])
        missing = sorted({key for row in added for key in row} - set(columns))
        if missing:
            raise AssetError(f"{table}: it lacks the columns {', '.join(missing)}")
        replaced = {tuple(row[c] for c in columns[:count]) for row in own[spoken]}
        kept = [row for row in rows if tuple(row[c] for c in columns[:count]) not in replaced]
        out = Path(folder) / table.name
        out.parent.mkdir(parents=True, exist_ok=True)
        with open(out, "w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(
                stream, columns, restval="", extrasaction="ignore", lineterminator="\n"
            )
            writer.writeheader()
            writer.writerows([*added, *kept])


def _own_rows(objects: Mapping[str, OwnObject]) -> dict[str, list[dict[str, str]]]:
    """Rows by table name, with the columns that own objects fill."""
    sizes, contacts, actions = [], [], []
    for category, described in objects.items():
        if described.size_m is not None:
            sizes.append(
                {
                    "category": category,
                    "size_m": f"{described.size_m:g}",
                    "size_axis": described.size_axis,
                    "source": described.size_source,
                }
            )
        for action, entry in described.actions.items():
            key = {"category": category, "action": action}
            actions.append(
                key
                | {
                    "stands_on_floor": "yes" if entry.stands_on_floor else "no",
                    "feet_on_floor": "yes" if entry.feet_on_floor else "no",
                }
            )
            contacts += [
                key
                | {
                    "answer_object_part": contact.object,
                    "answer_body_part": contact.body,
                    "object_part": contact.object,
                    "body_region": contact.body,
                    "side": contact.side,
                    "probability": f"{contact.probability:g}",
                    "source": contact.source,
                }
                for contact in entry.contacts
            ]
    return {"sizes.csv": sizes, "contacts.csv": contacts, "actions.csv": actions}


def merge_all(
    objects: Mapping[str, OwnObject],
    pose_database: Path | str,
    action_space: Path | str,
    tables: Sequence[Path | str],
    poses_out: Path | str,
    space_out: Path | str,
    tables_folder: Path | str,
) -> None:
    """Write everything that frames of own objects are looked up in."""
    save_database(merge_poses(load_database(pose_database), objects), poses_out)
    merge_action_space(action_space, objects, space_out)
    merge_tables(tables, objects, tables_folder)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
