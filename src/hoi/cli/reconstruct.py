"""``hoi reconstruct photo.jpg --object chair``: photos in, 3D scenes out, by the workflow."""

from __future__ import annotations

import argparse
import json
import shutil
import time
from pathlib import Path
from typing import Any

from hoi.datasets.photos_config import PhotoNotes
from hoi.errors import ConfigError

#: The run's folder inside the folder of results.
WORK = ".run"
TABLE = "results/photos.csv"
_NAMES = {
    "scene": "scene.glb",
    "obj": "scene.obj",
    "ply": "scene.ply",
    "body": "smpl.npz",
    "object": "object.json",
    "overlay": "overlay.png",
    "turntable": "turntable.png",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Photos, what is in them, and where results go."""
    parser.add_argument("photos", nargs="+", type=Path, help="jpg, png, webp, heic, or folders")
    what = parser.add_argument_group("the object")
    what.add_argument("--object", metavar="NAME", help="chair, table, backpack, ...; else detected")
    what.add_argument("--box", type=_numbers(4), metavar="X0,Y0,X1,Y1", help="its box in pixels")
    what.add_argument("--point", type=_numbers(2), metavar="X,Y", help="a pixel of it")
    what.add_argument("--mask", type=Path, metavar="PNG", help="its mask: white, or cut out")
    what.add_argument("--mesh", type=Path, metavar="FILE", help="its own mesh: obj, glb, ply, ...")
    who = parser.add_argument_group("the person")
    who.add_argument("--person", type=int, metavar="N", help="the Nth from the left")
    who.add_argument("--person-box", type=_numbers(4), metavar="X0,Y0,X1,Y1", help="box in pixels")
    who.add_argument("--person-mask", type=Path, metavar="PNG", help="mask of the person")
    who.add_argument("--action", metavar="NAME", help="sit, lift, ...; overrules the retrieved one")
    who.add_argument("--smpl", type=Path, metavar="FILE", help="your SMPL .pkl or .npz")
    camera = parser.add_argument_group("the camera")
    camera.add_argument("--field-of-view", type=float, metavar="DEG", help="of the longer side")
    camera.add_argument("--focal", type=float, metavar="PX", help="focal length in pixels")
    run_options = parser.add_argument_group("the run")
    run_options.add_argument("--out", type=Path, default=Path("reconstructed"), metavar="FOLDER")
    run_options.add_argument("-j", "--jobs", type=int, default=2, metavar="N", help="parallel jobs")


def run(arguments: argparse.Namespace) -> int:
    """Reconstruct; 0 when every photo came through, else 1."""
    from rich.console import Console

    from hoi.cli.engine import WorkflowLocked, checkout, run_workflow
    from hoi.cli.photo_run import Request, prepare
    from hoi.cli.progress import shown

    console = Console()
    started = time.monotonic()
    root = checkout()
    out = arguments.out.expanduser().absolute()
    work = out / WORK
    work.mkdir(parents=True, exist_ok=True)
    ready = prepare(
        root,
        work,
        Request(
            photos=arguments.photos,
            notes=_notes(arguments),
            object_mask=arguments.mask,
            person_mask=arguments.person_mask,
            mesh=arguments.mesh,
            body_model=arguments.smpl,
        ),
    )
    count = len(ready.names)
    with shown(console, count) as progress:
        try:
            # built once for every run, and followed there when its code changes
            run_workflow(
                root,
                ready.shared_targets,
                directory=root,
                jobs=arguments.jobs,
                follow=progress.update,
            )
        except WorkflowLocked:
            if not all((root / target).is_file() for target in ready.shared_targets):
                raise
    with shown(console, count) as progress:
        run_workflow(
            root,
            [TABLE],
            directory=work,
            jobs=arguments.jobs,
            config_file=ready.config_file,
            follow=progress.update,
        )
    rows = collect(work, out)
    _tell(console, rows, out, time.monotonic() - started)
    return 0 if all(row["status"] == "ok" for row in rows) else 1


def collect(work: Path, out: Path) -> list[dict[str, Any]]:
    """Copy what the workflow made for people from the run's folder; the rows of its table.

    Every photo gets a folder with its files and page; ``index.html`` shows all of them.
    """
    import pandas as pd

    table = pd.read_csv(work / TABLE, dtype=str, keep_default_na=False)
    shutil.copyfile(work / TABLE, out / "photos.csv")
    made: dict[str, dict[str, str]] = {}
    for index in sorted((work / "results/photos/scenes").glob("photos-[0-9]*.json")):
        if not index.name.endswith(".object.json"):  # of a photo that is called like an index
            made |= json.loads(index.read_text())
    gallery = (work / "results/photos/gallery/photos.html").read_text()
    rows = []
    for (frame_id, files), row in zip(made.items(), table.to_dict("records"), strict=True):
        folder = out / frame_id
        folder.mkdir(exist_ok=True)
        for name in _NAMES.values():
            (folder / name).unlink(missing_ok=True)
        for kind, name in files.items():
            shutil.copyfile(work / "results/photos/scenes" / name, folder / _NAMES[kind])
        shutil.copyfile(work / f"results/photos/pages/{frame_id}.html", folder / "page.html")
        gallery = gallery.replace(f'"../pages/{frame_id}.html', f'"{frame_id}/page.html')
        rows.append({**{str(k): v for k, v in row.items()}, "folder": frame_id})
    (out / "index.html").write_text(gallery)
    return rows


def _notes(arguments: argparse.Namespace) -> PhotoNotes:
    """The options as notes; raises ConfigError naming the option."""
    from pydantic import ValidationError

    said = {
        "object": arguments.object,
        "box": arguments.box,
        "point": arguments.point,
        "person": arguments.person,
        "person_box": arguments.person_box,
        "action": arguments.action,
        "field_of_view_deg": arguments.field_of_view,
        "focal_px": arguments.focal,
    }
    try:
        return PhotoNotes(**{key: value for key, value in said.items() if value is not None})
    except ValidationError as error:
        first = error.errors()[0]
        key = str(first["loc"][0]) if first["loc"] else ""
        option = {"field_of_view_deg": "field-of-view", "focal_px": "focal"}.get(key, key)
        told = first["msg"].removeprefix("Value error, ")
        text = f"--{option.replace('_', '-')}: {told}" if option else f"--{told}"
        raise ConfigError(text) from None


def _numbers(count: int):
    """A parser of `count` numbers with commas between."""

    def parse(text: str) -> tuple[float, ...]:
        values = tuple(float(part) for part in text.split(","))
        if len(values) != count:
            raise ValueError(text)
        return values

    parse.__name__ = f"{count} numbers"  # what argparse calls it
    return parse


def _tell(console, rows: list[dict[str, Any]], out: Path, seconds: float) -> None:
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("photo", "object", "action", "size, m", "mask", "result"):
        table.add_column(name, overflow="fold")
    for row in rows:
        good = row["status"] == "ok"
        result = (
            f"[green]{row['folder']}/[/]"
            if good
            else f"[red]{row['status'].replace('_', ' ')}[/]: {row['detail']}"
        )
        table.add_row(
            row["photo"],
            row["object"],
            row["action"] or "–",
            row["object_size_m"] or "–",
            row["object_mask"] or "–",
            result,
        )
    console.print(table)
    done = sum(row["status"] == "ok" for row in rows)
    console.print(
        f"\n{done} of {len(rows)} reconstructed in {seconds:.0f} s. "
        f"Open [bold]{out / 'index.html'}[/] in a browser.",
        highlight=False,
    )
    for row in rows:
        if row["doubts"]:
            console.print(f"{row['photo']} is doubtful: {row['doubts']}.", style="yellow")
