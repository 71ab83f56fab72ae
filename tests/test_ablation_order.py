"""Do the paper's ablations come out in its order? On 24 generated frames of the tuning split.

Opt-in, for it computes everything from the photos on: `make accuracy`.
"""

import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml

REPO = Path(__file__).parents[1]
METHODS = ["ours", "paper", "paper_no_action", "paper_no_contact", "paper_no_normal"]

pytestmark = pytest.mark.skipif(
    not os.environ.get("HOI_ACCURACY_TESTS"), reason="opt-in: `make accuracy`"
)


@pytest.fixture(scope="module")
def object_cm(tmp_path_factory) -> pd.Series:
    """Mean object error of each method."""
    folder = tmp_path_factory.mktemp("ablations")
    for name in ("Snakefile", "workflow", "config", "profiles", "src"):
        (folder / name).symlink_to(REPO / name)
    settings = {"split": "tune", "frames": 4, "tables": {"accuracy": METHODS}}
    (folder / "set.yaml").write_text(yaml.safe_dump(settings))
    command = [sys.executable, "-m", "snakemake", "-j2", "results/accuracy.csv"]
    done = subprocess.run(
        [*command, "--configfile", "set.yaml"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder / "src")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    frames = pd.read_csv(folder / "results/accuracy.frames.csv")
    assert frames.groupby("method").size().eq(24).all()
    return frames.groupby("method")["object_cm"].mean()


def test_each_part_of_the_method_is_needed(object_cm):
    assert object_cm["ours"] < 0.7 * object_cm["paper"]
    assert object_cm["paper"] < object_cm["paper_no_action"] < object_cm["paper_no_contact"]


def test_opposing_normals_make_no_difference_that_anybody_measured(object_cm):
    """2.6 cm in the paper, within the noise here: nothing is claimed but that it breaks nothing."""
    assert abs(object_cm["paper_no_normal"] - object_cm["paper"]) < 5
