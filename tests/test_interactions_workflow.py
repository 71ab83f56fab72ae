"""The interaction database by the workflow's own rules, on three images of one query."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml
from PIL import Image

from hoi.actions.database import load_database
from hoi.detect.models import require_models
from hoi.errors import AssetError
from own_object_meshes import stroller
from own_object_photo import pushing, write_photo

REPO = Path(__file__).parents[1]
RUN = {
    "interactions": {"folder": "images", "with_package": False},
    "detect_photos": {"masks": "given", "keypoints": "registry"},
}
pytestmark = [pytest.mark.slow, pytest.mark.models]


def test_images_become_poses_and_what_is_dropped_is_counted(tmp_path):
    models = REPO / "resources" / "models"
    try:
        require_models(models, "pose")
    except AssetError as error:
        pytest.skip(f"the pose model is not there: {error}")
    for name in ("Snakefile", "workflow", "profiles", "src"):
        (tmp_path / name).symlink_to(REPO / name)
    shutil.copytree(REPO / "config", tmp_path / "config")
    (tmp_path / "resources").mkdir()
    (tmp_path / "resources" / "models").symlink_to(models)
    (tmp_path / "config" / "run.yaml").write_text(yaml.safe_dump(RUN))
    images = tmp_path / "images" / "woman push stroller"
    for name in ("one", "same", "tiny"):
        write_photo(pushing(stroller()), images, name, "stroller")
    for path in images.glob("tiny*.png"):
        picture = Image.open(path)
        picture.resize((320, 240)).save(path)

    command = [sys.executable, "-m", "snakemake", "-j1", "results/interactions/database.npz"]
    done = subprocess.run(
        [*command, "--configfile", "config/run.yaml"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(REPO / "src")},
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    counts = pd.read_csv(tmp_path / "results/interactions/counts.csv").set_index("query")
    row = counts.loc["woman push stroller"]
    assert (row["images"], row["too_small"], row["duplicate"], row["kept"]) == (3, 1, 1, 1)
    database = load_database(tmp_path / "results/interactions/database.npz")
    assert len(database) == 2 and database.actions_of("stroller") == ["push"]
