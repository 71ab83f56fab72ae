"""The workflow as users run it, on a data set of two frames.

Every sentence that the documentation says about reruns is proven here by running.
"""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml

from llm_stub import Stub
from test_report_browser import CHROMIUM, QUIET

REPO = Path(__file__).parents[1]
TABLE = "results/behave_chair.csv"
GALLERY = "results/behave/gallery/chair.html"
TINY = {
    "dataset": "behave",
    "frames": "all",
    "chunk_size": 1,
    "detect": {"landmarks": "none"},
    "exemplars": {"sources": ["procedural"], "k": 3, "procedural_pool": 5, "kmeans_restarts": 1},
    "objectfit": {"upright": {"num_starts": 60}, "so3": {"num_starts": 60}},
    "report": {"image_width": 200, "ablation": False},
}
SEQUENCES = ("Date03_Sub03_chairblack_sit", "Date03_Sub03_chairblack_hand")
KEPT = ("config", "src", "workflow")
PER_FRAME = ("frames", "detect", "smplify", "objectfit", "actions", "priors", "joint", "evaluate")

pytestmark = pytest.mark.slow


class Checkout:
    """A copy of the repository with a data set of two frames."""

    def __init__(self, folder: Path, behave: Path):
        self.folder, self.behave = folder, behave
        for name in ("Snakefile", "workflow", "config", "profiles", "src"):
            source = REPO / name
            if source.is_dir():
                ignore = shutil.ignore_patterns("__pycache__", "*.egg-info")
                shutil.copytree(source, folder / name, ignore=ignore)
            else:
                shutil.copy(source, folder / name)
        self.configure()

    def configure(self, **changes) -> None:
        tiny = TINY | {"behave": {"root": str(self.behave)}} | changes
        (self.folder / "config" / "tiny.yaml").write_text(yaml.safe_dump(tiny))

    def run(self, *arguments: str, target: str | None = TABLE, check: bool = True):
        command = [sys.executable, "-m", "snakemake", *(target or "").split(), "-j2"]
        command += ["--configfile", "config/tiny.yaml", *arguments]
        done = subprocess.run(
            command,
            cwd=self.folder,
            env=os.environ | {"PYTHONPATH": str(self.folder / "src")},
            capture_output=True,
            text=True,
            timeout=900,
        )
        output = done.stdout + done.stderr
        if check:
            assert done.returncode == 0, output
        return output

    def planned(self, **kwargs) -> dict[str, int]:
        """Jobs that a run would start now, by rule; empty when there is nothing to do."""
        return jobs(self.run("-n", **kwargs))

    def edit(self, path: str, old: str, new: str) -> None:
        file = self.folder / path
        text = file.read_text()
        assert old in text, f"{old!r} is not in {path}"
        file.write_text(text.replace(old, new, 1))

    def logs(self, stage: str) -> str:
        return "".join(
            p.read_text() for p in sorted((self.folder / "logs/behave" / stage).rglob("*.log"))
        )


def jobs(output: str) -> dict[str, int]:
    table = re.search(r"Job stats:\njob +count\n[- ]+\n(.*?)\ntotal", output, re.DOTALL)
    if table is None:
        assert "Nothing to be done" in output, output
        return {}
    return {line.split()[0]: int(line.split()[1]) for line in table[1].splitlines() if line.strip()}


@pytest.fixture(scope="module")
def behave(tmp_path_factory):
    """Two generated frames in BEHAVE's layout."""
    from hoi.datasets.behave_layout import frame_ref
    from hoi.datasets.behave_mini.config import BehaveMiniConfig
    from hoi.datasets.behave_mini.generate import generate_frames

    root = tmp_path_factory.mktemp("behave")
    refs = [frame_ref(sequence, "t0003.000") for sequence in SEQUENCES]
    generate_frames(BehaveMiniConfig(image_width=512), root, refs)
    (root / "split.json").write_text(json.dumps({"train": [], "test": list(SEQUENCES)}))
    return root


@pytest.fixture(scope="module")
def finished(tmp_path_factory, behave):
    """A checkout whose main table is done, and a copy of what it was made from."""
    checkout = Checkout(tmp_path_factory.mktemp("checkout"), behave)
    checkout.pristine = tmp_path_factory.mktemp("pristine")
    for name in KEPT:
        shutil.copytree(checkout.folder / name, checkout.pristine / name)
    checkout.first_output = checkout.run()
    return checkout


@pytest.fixture
def done(finished):
    """The finished checkout, put back as it was after each test."""
    yield finished
    for source in (path for name in KEPT for path in (finished.pristine / name).rglob("*")):
        target = finished.folder / source.relative_to(finished.pristine)
        if source.is_file() and _differ(source, target):
            shutil.copy2(source, target)
    finished.configure()


def _differ(source: Path, target: Path) -> bool:
    """By content or time: the kernels' compiled code is kept while neither changes."""
    same_time = source.stat().st_mtime_ns == target.stat().st_mtime_ns
    return not same_time or source.read_bytes() != target.read_bytes()


def test_one_command_makes_the_table_with_every_stage(finished):
    counts = jobs(finished.first_output)
    assert set(PER_FRAME) <= set(counts)
    table = pd.read_csv(finished.folder / TABLE)
    assert set(table["method"]) == {"phosa", "ours"}
    assert set(table["action"]) == {"sit", "hand", "avg"}
    assert (table["n"] + table["n_failed"] > 0).all()
    assert (table["dataset"] == "behave").all() and table["protocol"].str.contains(
        "Procrustes"
    ).all()
    for sequence in SEQUENCES:
        for stage in ("frames", "detect", "smplify", "actions", "priors", "joint/ours"):
            assert list((finished.folder / "results/behave" / stage).rglob(f"{sequence}*.npz"))


@pytest.mark.models
@pytest.mark.skipif(
    not (REPO / "resources/models/all.ready").is_file(), reason="the detectors are not here"
)
def test_detectors_are_measured_on_the_frames_and_every_way_to_cut_out_is(done):
    shutil.copytree(REPO / "resources/models", done.folder / "resources/models", dirs_exist_ok=True)
    counts = jobs(done.run(target="results/detection.csv results/masks.csv"))
    assert counts["detect_registry"] == counts["masks"] == 2
    rates = pd.read_csv(done.folder / "results/detection.csv").set_index("category")
    assert rates.loc["all", "n"] == 2
    masks = pd.read_csv(done.folder / "results/masks.csv").set_index(["category", "box"])
    assert masks.loc[("all", "true box"), "n"] == 2
    methods = {"plain_grabcut", "grabcut", "network", "network_grabcut", "stage"}
    assert methods <= set(masks.columns)
    assert masks.loc[("all", "true box"), "network"] > 0.5
    assert "object masks" in (done.folder / "results/masks.html").read_text()
    assert done.planned(target="results/detection.csv results/masks.csv") == {}


def test_a_second_run_has_nothing_to_do(done):
    assert done.planned() == {}


def test_touching_every_file_recomputes_nothing(done):
    for path in [
        *done.folder.rglob("*.py"),
        *done.folder.rglob("*.smk"),
        *done.behave.rglob("*.*"),
    ]:
        if path.is_file() and ".snakemake" not in path.parts:
            os.utime(path)
    assert done.planned() == {}


def test_a_moved_checkout_recomputes_nothing(done, tmp_path):
    shutil.copytree(done.folder, tmp_path / "moved", copy_function=shutil.copyfile)
    moved = Checkout.__new__(Checkout)
    moved.folder, moved.behave = tmp_path / "moved", done.behave
    assert moved.planned() == {}


def test_a_comment_or_docstring_recomputes_nothing(done):
    path = done.folder / "src/hoi/joint/stage.py"
    path.write_text("# a comment\n" + path.read_text())
    done.edit("src/hoi/evaluate/stage.py", '"""Measure one', '"""Gauge one')
    assert done.planned() == {}


def test_settings_of_a_stage_that_the_table_does_not_use_recompute_nothing(done):
    done.configure(report={"image_width": 300}, photos={"folder": "somewhere"})
    assert done.planned() == {}


def test_the_weight_of_the_normal_loss_reruns_the_joint_stage_and_what_follows(done):
    before = {path: path.stat().st_mtime_ns for path in done.folder.glob("results/behave/*/*.json")}
    done.edit("config/config.yaml", "normal: 0.01", "normal: 0.02")
    counts = jobs(done.run())
    assert counts == {"joint": 2, "evaluate": 2, "table": 1}
    after = {path: path.stat().st_mtime_ns for path in done.folder.glob("results/behave/*/*.json")}
    assert after == before  # frames, detect, smplify, actions, priors were not touched
    done.edit("config/config.yaml", "normal: 0.02", "normal: 0.01")
    done.run()
    assert done.logs("joint/ours").count("remembered") == 2  # going back costs nothing


@pytest.mark.parametrize(
    ("module", "old", "new", "stages"),
    [
        ("joint/select.py", "def ", "_MARK = 1\n\n\ndef ", {"joint", "evaluate"}),
        ("evaluate/stage.py", "class ", "_MARK = 1\n\n\nclass ", {"evaluate"}),
        (
            "actions/retrieval.py",
            "def ",
            "_MARK = 1\n\n\ndef ",
            {"actions", "priors", "joint", "evaluate"},
        ),
    ],
)
def test_editing_the_code_of_a_stage_reruns_it_and_what_follows(done, module, old, new, stages):
    path = done.folder / "src/hoi" / module
    match = re.search(rf"^{old}", path.read_text(), re.MULTILINE)
    assert match
    text = path.read_text()
    path.write_text(text[: match.start()] + new + text[match.start() + len(old) :])
    assert set(done.planned()) == {*stages, "table"}


def test_two_settings_that_swap_their_values_are_noticed(done):
    done.edit("config/config.yaml", "contact: 1.0, normal: 0.01", "contact: 0.01, normal: 1.0")
    assert set(done.planned()) == {"joint", "evaluate", "table"}


def test_new_content_under_an_old_time_stamp_reruns_that_frame_alone(done):
    image = next(done.behave.rglob("*sit*/t*/k1.color.jpg"))
    content = image.read_bytes()
    try:
        image.write_bytes(content + b"\0")  # decodes to the same picture
        os.utime(image, (946684800, 946684800))
        planned = done.planned()
        assert planned["frames"] == 1 and planned["detect"] == 1 and planned["joint"] == 2
        done.run()
        # the picture is the same, so is its artifact: what follows is remembered, not computed
        for stage in ("detect", "smplify", "joint"):
            assert "remembered" in done.logs(stage)
    finally:
        image.write_bytes(content)
        done.run()


def test_deleted_results_come_back_without_computing(done):
    shutil.rmtree(done.folder / "results")
    done.run()
    for stage in ("detect", "smplify", "objectfit", "joint", "evaluate"):
        lines = done.logs(stage).splitlines()
        assert lines and all("remembered" in line for line in lines)


def test_frames_alone_and_with_any_number_of_jobs_give_the_same_bytes(
    done, tmp_path_factory, behave
):
    other = Checkout(tmp_path_factory.mktemp("one_job"), behave)
    other.configure(chunk_size=2)
    shutil.copytree(done.folder / "resources", other.folder / "resources")
    other.run("-j1")

    def digests(checkout):
        found = {}
        for index in (checkout.folder / "results/behave/joint/ours").glob("chair-???.json"):
            found |= json.loads(index.read_text())["frames"]
        return found

    assert digests(other) == digests(done)


CLICK_THROUGH = """<script>
(async () => {
  const wait = () => new Promise((done) => setTimeout(done, 200));
  const texts = (query) => Array.from(document.querySelectorAll(query), (e) => e.innerText.trim());
  while (!app || !document.querySelector("nav ul li")) await wait();
  const seen = { menu: texts("nav ul li") };
  for (const category of Object.keys(categories)) {
    app.setView({ navbarMode: "menu" });
    await wait();
    app.showCategory(category);
    await wait();
    seen[category] = texts("nav tbody tr");
    document.querySelector("nav tbody a").click();
    await wait();
    const shown = document.querySelector("iframe");
    seen[category + " shows"] = shown ? shown.src.slice(0, 14) : "";
  }
  const page = document.createElement("pre");
  page.id = "seen";
  page.textContent = JSON.stringify(seen);
  document.body.replaceChildren(page);
})();
</script></body>"""


def clicked_through(report: Path, folder: Path) -> dict:
    """What the report lists and opens in a browser, by category."""
    opened = folder / "report.html"
    opened.write_text(CLICK_THROUGH.join(report.read_text().rsplit("</body>", 1)))
    browser = subprocess.run(
        [str(CHROMIUM), *QUIET, f"--user-data-dir={folder / 'profile'}"]
        + ["--virtual-time-budget=20000", "--dump-dom", opened.as_uri()],
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | {"HOME": str(folder)},
    )
    console = [line for line in browser.stderr.splitlines() if ":CONSOLE" in line]
    assert not [line for line in console if "rror" in line], console
    found = re.search(r'<pre id="seen">(.*?)</pre>', browser.stdout, re.DOTALL)
    assert found, browser.stderr
    return json.loads(html.unescape(found[1]))


def test_a_frame_without_its_image_is_a_row_a_card_and_a_page_not_a_crash(done, tmp_path):
    image = next(done.behave.rglob("*hand*/t*/k1.color.jpg"))
    hidden = image.with_suffix(".hidden")
    image.rename(hidden)
    try:
        done.run(target=f"{TABLE} {GALLERY}")
        done.run("--report", "report.html", target=f"{TABLE} {GALLERY}")
        table = pd.read_csv(done.folder / TABLE).set_index(["action", "method"])
        assert table.loc[("hand", "ours"), "n_failed"] == 1
        assert table.loc[("sit", "ours"), "n"] == 1
        frames = pd.read_csv(done.folder / "results/behave_chair.frames.csv")
        assert "image_missing" in set(frames["status"])
    finally:
        hidden.rename(image)
        done.run()
    pages = done.folder / "results/behave/pages"
    whole, broken = (pages / f"{sequence}-t0003.000.html" for sequence in SEQUENCES)
    assert 'data-method="ours"' in whole.read_text() and "image missing" not in whole.read_text()
    for path in (broken, done.folder / GALLERY):
        text = path.read_text()
        assert "image missing" in text and "k1.color.jpg does not exist" in text
        assert "behave · chair" in text and "· hand" in text  # the plan knows, the frame cannot
    report = done.folder / "report.html"
    assert report.stat().st_size < 8e6

    if CHROMIUM is None:
        pytest.skip("the report was made, but there is no Chromium to open it")
    seen = clicked_through(report, tmp_path)
    assert seen["menu"][-3:] == ["1 Tables", "2 Gallery", "3 Frames"]
    assert seen["1 Tables"] == ["chair"] and seen["2 Gallery"] == ["chair"]
    assert seen["3 Frames"] == [
        f"{name.rsplit('_', 1)[1]} · {name}-t0003.000" for name in sorted(SEQUENCES)
    ]
    assert {seen[f"{name} shows"] for name in seen["menu"][-3:]} == {"data:text/html"}


def test_no_target_means_everything(done):
    planned = done.planned(target=None)
    assert {"ablation", "all"} <= set(planned)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joints": {}}, "joints: unknown key"),
        ({"seed": "many"}, "seed"),
        ({"smplify": {"no_such_number": 1}}, "smplify.no_such_number: unknown key"),
        ({"tables": {"methods": ["mine"]}}, "no method 'mine'"),
        ({"behave": {"root": "/nowhere"}}, "/nowhere"),
    ],
)
def test_an_unusable_configuration_stops_with_the_key_named(done, changes, message):
    done.configure(**changes)
    output = done.run(check=False)
    assert message in output and "Traceback" not in output


def recorded_models(folder: Path) -> None:
    """Two models: they say the same of sitting, in other words, and differ in all other actions."""
    from hoi.priors.answered import write_tables
    from hoi.priors.config import LanguageModelConfig

    said = {
        "first": {"length": " 0.85m", "sit": " seat/butt, charm/aura", "": " seat/hands"},
        "second": {"length": " 85 cm", "sit": " seat cushion/buttocks", "": " back/hands"},
    }

    def answer(body: dict) -> str:
        of, prompt = said[body["model"]], body["prompt"]
        if "length estimator" in prompt:
            return of["length"]
        sits = prompt.endswith("Action: sit\nObject: chair\nContacts:")
        return of["sit" if sits else ""]

    stub = Stub(answer)
    for model in ("first", "second"):
        config = LanguageModelConfig(
            base_url=stub.url, model=model, mode="record", recordings=str(folder),
            map_parts="aliases",
        )  # fmt: skip
        write_tables(config, REPO / "src/hoi/data/priors", folder / f"{model} tables")
    stub.close()


def test_another_language_model_reruns_priors_and_the_frames_whose_answers_changed(done):
    recordings = done.folder / "answers"
    recorded_models(recordings)

    def ask(model: str) -> None:
        nobody = "http://127.0.0.1:9/v1"
        asked = {"model": model, "recordings": str(recordings), "map_parts": "aliases"}
        done.configure(
            priors={"source": "llm", "max_hypotheses": 1, "llm": asked | {"base_url": nobody}}
        )

    try:
        ask("first")
        done.run()
        assert done.planned() == {}
        ask("second")
        counts = jobs(done.run())
        assert set(counts) == {"prior_tables", "priors", "joint", "evaluate", "table"}
        assert counts["priors"] == 2  # and no detection, body or object fit
        for method in ("ours", "phosa"):
            lines = done.logs(f"joint/{method}").splitlines()
            for sequence, remembered in zip(SEQUENCES, (True, False), strict=True):
                (line,) = [line for line in lines if f"{sequence}-t" in line]
                assert ("remembered" in line) == remembered, line
        answered = (done.folder / "resources/priors/contacts.csv").read_text()
        assert "second" in answered and "first" not in answered
    finally:
        done.configure()
        done.run()


NO_NETWORK = """
import socket

def refuse(self, address):
    if self.family != socket.AF_UNIX:
        raise OSError(f"the network was asked for {address}")

socket.socket.connect = socket.socket.connect_ex = refuse
"""


def test_a_fresh_checkout_replays_all_priors_without_a_network(tmp_path):
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=REPO, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a git checkout")
    fresh = tmp_path / "fresh"
    for name in filter(None, listed.stdout.split("\0")):
        wanted = name.startswith(("src/", "workflow/", "config/", "profiles/", "Snakefile"))
        if wanted and (REPO / name).is_file():
            (fresh / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(REPO / name, fresh / name)
    (tmp_path / "blocked").mkdir()
    (tmp_path / "blocked" / "sitecustomize.py").write_text(NO_NETWORK)
    asked = {"model": "GPT-3 as printed", "map_parts": "aliases", "gaps": "recorded"}
    settings = {"dataset": "behave_mini", "priors": {"source": "llm", "llm": asked}}
    (fresh / "config" / "replay.yaml").write_text(yaml.safe_dump(settings))
    targets = ["resources/priors/contacts.csv", "results/priors.csv"]
    command = [sys.executable, "-m", "snakemake", "-j1", *targets]
    done = subprocess.run(
        [*command, "--configfile", "config/replay.yaml"],
        cwd=fresh,
        env=os.environ | {"PYTHONPATH": f"{tmp_path / 'blocked'}:{fresh / 'src'}"},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for name in ("sizes", "contacts"):
        answered = pd.read_csv(fresh / f"resources/priors/{name}.csv")
        printed = pd.read_csv(fresh / f"src/hoi/data/priors/{name}.csv")
        printed = printed[printed["source"].str.contains("Tab.", regex=False)]
        asked_model = answered["model"] == asked["model"]
        keys = ["category"] if name == "sizes" else ["category", "action"]
        replayed = set(map(tuple, answered.loc[asked_model, keys].to_numpy()))
        assert replayed == set(map(tuple, printed[keys].to_numpy()))
    votes = pd.read_csv(fresh / "results/priors.csv")
    assert len(votes) >= 4
