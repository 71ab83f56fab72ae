"""From a mesh file to a photo's result with the two commands of the documentation, and no code."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial import cKDTree

from hoi.artifacts import Joint
from hoi.cli import main
from hoi.detect.models import require_models
from hoi.errors import AssetError
from own_object_meshes import stroller, write_glb
from own_object_photo import pushing, write_photo

REPO = Path(__file__).parents[1]
RUN = {
    "photos": {"folder": "my_photos"},
    "detect_photos": {"masks": "given", "keypoints": "registry"},
    "objectfit": {"upright": {"num_starts": 120}},
}
pytestmark = [pytest.mark.slow, pytest.mark.models]


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A checkout with a photo of a pushchair, which nothing in the package knows."""
    models = REPO / "resources" / "models"
    try:
        require_models(models, "pose")
    except AssetError as error:
        pytest.skip(f"the pose model is not there: {error}")
    folder = tmp_path_factory.mktemp("checkout")
    for name in ("Snakefile", "workflow", "profiles", "src"):
        (folder / name).symlink_to(REPO / name)
    shutil.copytree(REPO / "config", folder / "config")
    (folder / "resources").mkdir()
    (folder / "resources" / "models").symlink_to(models)
    (folder / "config" / "run.yaml").write_text(yaml.safe_dump(RUN))
    return folder


def snakemake(folder: Path, *arguments: str) -> str:
    command = [sys.executable, "-m", "snakemake", "-j1", "results/photos.csv"]
    command += ["--configfile", "config/run.yaml", *arguments]
    environment = os.environ | {"PYTHONPATH": str(REPO / "src")}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def row_of(folder: Path) -> pd.Series:
    return pd.read_csv(folder / "results" / "photos.csv").set_index("photo").loc["walk.png"]


def test_a_new_object_needs_one_command_and_no_code(checkout, monkeypatch):
    parts = stroller()
    shot = pushing(parts)
    write_photo(shot, checkout / "my_photos", "walk", "stroller")
    snakemake(checkout)
    before = row_of(checkout)
    assert before["status"] == "no_exemplars"

    mesh = write_glb(parts, checkout / "my_stroller.glb")
    monkeypatch.chdir(checkout)
    words = ["--category", "stroller", "--contact", "push:handle:hands"]
    assert main(["add-object", mesh.name, *words]) == 0
    snakemake(checkout)
    after = row_of(checkout)
    assert (after["status"], after["action"], after["exemplar"]) == ("ok", "push", "my_stroller")

    index = checkout / "results" / "photos" / "joint" / "ours" / "photos-000"
    placed = Joint.load(index / "walk.npz").object_vertices
    there, back = cKDTree(shot.object_vertices), cKDTree(placed)
    chamfer = there.query(placed)[0].mean() + back.query(shot.object_vertices)[0].mean()
    assert chamfer / 2 < 0.12  # metres, in the camera's frame; a stroller is a metre long
    assert np.ptp(placed, axis=0).max() < 1.6
    assert "Nothing to be done" in snakemake(checkout, "-n")
