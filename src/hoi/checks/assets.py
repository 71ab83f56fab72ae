"""Sentences about everything else that a run reads: bodies, exemplars, photos."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hoi.checks.findings import Finding, few, missing, odd, ok, stop
from hoi.config import RunConfig
from hoi.errors import HoiError

BODY, OBJECTS, PHOTOS = "Body model", "Exemplars", "Photos"
_MESHES = (".obj", ".glb", ".ply")


def check_body(config: RunConfig) -> Iterator[Finding]:
    """The configured body model and, for true joints, SMPL-H."""
    from hoi.body import DEFAULT_BODY
    from hoi.body.files import read_body_file, read_smplh_file
    from hoi.body.smplh import GENDERS, smplh_path
    from hoi.body.topology import topology

    path = Path(config.assets.body_model)
    try:
        body = read_body_file(path)
    except HoiError as error:
        yield stop(BODY, f"{error}.")
        return
    name = topology(body.faces, len(body.v_template))
    embedded = read_body_file(DEFAULT_BODY)
    kind = (
        "the embedded body"
        if name == topology(embedded.faces, len(embedded.v_template))
        else "a body of your own"
    )
    yield ok(
        BODY,
        f"{path.name}: {kind}, {len(body.v_template)} vertices, {body.shapedirs.shape[-1]} shape "
        "components.",
    )
    if not Path(config.assets.pose_database).is_file():
        yield stop(BODY, f"assets.pose_database: there is no file {config.assets.pose_database}.")
    if not config.behave.smplh:
        return
    folder, found = Path(config.behave.smplh).expanduser(), []
    for gender in GENDERS:
        try:
            read_smplh_file(smplh_path(folder, gender))
            found.append(gender)
        except HoiError as error:
            if gender != "neutral":
                yield stop(BODY, f"behave.smplh: {error}.")
    if found:
        yield ok(BODY, f"SMPL-H: {', '.join(found)}.")


def check_exemplars(config: RunConfig) -> Iterator[Finding]:
    """Where candidate objects come from."""
    import trimesh

    settings = config.exemplars
    sources = [name for name in settings.sources if name != "folder"]
    if sources:
        yield ok(OBJECTS, f"Candidates that come with the package: {', '.join(sources)}.")
    for key in ("partnet", "shapenet"):
        folder = getattr(settings, key, "")
        if not folder:
            continue
        path = Path(folder).expanduser()
        if not path.is_dir():
            yield stop(OBJECTS, f"exemplars.{key}: there is no folder {path}.")
            continue
        try:
            yield ok(OBJECTS, f"{key}: {_shapes(config, key)}.")
        except (HoiError, OSError) as error:
            yield stop(OBJECTS, f"exemplars.{key}: {error}.")
    if "folder" not in settings.sources:
        return
    root = Path(settings.folder).expanduser()
    if not settings.folder or not root.is_dir():
        yield stop(OBJECTS, f"exemplars.folder: there is no folder {settings.folder!r}.")
        return
    count: Counter[str] = Counter()
    broken, open_ones = [], []
    for path in sorted(p for p in root.glob("*/*") if p.suffix.lower() in _MESHES):
        count[path.parent.name] += 1
        try:
            mesh: Any = trimesh.load(path, force="mesh", process=True)
            if not mesh.is_watertight:
                open_ones.append(f"{path.parent.name}/{path.name}")
        except Exception as error:  # the mesh loader raises whatever its parser met
            broken.append(f"{path.parent.name}/{path.name} ({type(error).__name__})")
    told = ", ".join(f"{name} {n}" for name, n in sorted(count.items()))
    yield (ok if count else stop)(OBJECTS, f"Own meshes in {root}: {told or 'none'}.")
    if open_ones:
        yield odd(OBJECTS, f"Not watertight, so remeshed to a closed surface: {few(open_ones)}.")
    if broken:
        yield odd(OBJECTS, f"Not readable: {few(broken)}.")


def _shapes(config: RunConfig, key: str) -> str:
    from hoi.exemplars.categories import known_categories

    alone = config.exemplars.model_copy(
        update={"sources": (), **{k: "" for k in ("partnet", "shapenet") if k != key}}
    )
    names = known_categories(alone)
    return f"shapes of {len(names)} categories ({few(names, 6)})" if names else "no known shapes"


def check_photos(config: RunConfig) -> Iterator[Finding]:
    """The folder of photos, when there is one."""
    from hoi.datasets.photos import list_photos
    from hoi.datasets.photos_config import AUTO

    try:
        refs = list_photos(config.photos)
    except HoiError as error:
        yield missing(PHOTOS, f"{error}.")
        return
    named = Counter(ref.category for ref in refs)
    told = ", ".join(f"{name} {n}" for name, n in sorted(named.items()) if name != AUTO)
    yield ok(
        PHOTOS,
        f"{len(refs)} in {config.photos.folder} (results/photos.csv): {told or 'none named'}"
        + (f"; {named[AUTO]} for the detector to name" if named[AUTO] else "")
        + ".",
    )
