"""``hoi reconstruct``: it prepares a folder, runs the workflow in it and copies results."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from hoi.cli import main
from hoi.cli.engine import Finished, Planned, Started, events
from hoi.cli.photo_run import Request, photo_list, prepare
from hoi.cli.progress import Estimate
from hoi.cli.reconstruct import WORK, collect
from hoi.datasets.photos import list_photos, read_photo
from hoi.datasets.photos_config import PhotoNotes
from hoi.errors import ConfigError

ROOT = Path(__file__).parents[1]


@pytest.fixture
def photo(tmp_path) -> Path:
    path = tmp_path / "mine" / "desk.jpg"
    path.parent.mkdir()
    Image.new("RGB", (80, 60), "grey").save(path)
    return path


def prepared(tmp_path, *photos: Path, **request):
    return prepare(ROOT, folder_of(tmp_path), Request(photos, **request))


def folder_of(tmp_path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir(exist_ok=True)
    return folder


def frames_of(run):
    return {
        ref.frame_id: read_photo(run.config.photos, ref) for ref in list_photos(run.config.photos)
    }


def test_options_reach_the_frame_that_the_stages_see(tmp_path, photo):
    notes = PhotoNotes(object="Chair", person=2, box=(1, 2, 30, 40), action="Sit", focal_px=90)
    frame = frames_of(prepared(tmp_path, photo, notes=notes))["desk"]
    assert (frame.category, frame.hints.person, frame.hints.action) == ("chair", 2, "sit")
    assert frame.hints.object_box == (1, 2, 30, 40)
    assert frame.intrinsics[0, 0] == 90


def test_what_lies_beside_a_photo_comes_along_and_options_go_before_it(tmp_path, photo):
    (photo.parent / "desk.yaml").write_text("object: table\nperson: 3\n")
    Image.new("L", (80, 60), 255).save(photo.parent / "desk.person_mask.png")
    frame = frames_of(prepared(tmp_path, photo, notes=PhotoNotes(object="stool")))["desk"]
    assert (frame.category, frame.hints.person) == ("stool", 3)
    assert frame.given_person_mask.all()


@pytest.mark.parametrize("mode", ["L", "RGBA"])
def test_a_mask_is_white_on_black_or_cut_out(tmp_path, photo, mode):
    drawn = np.zeros((60, 80), np.uint8)
    drawn[10:20, 30:50] = 255
    picture = Image.fromarray(drawn)
    if mode == "RGBA":
        picture = Image.merge("RGBA", [Image.new("L", (80, 60), 9)] * 3 + [picture])
    picture.save(tmp_path / "mask.png")
    run = prepared(tmp_path, photo, object_mask=tmp_path / "mask.png")
    np.testing.assert_array_equal(frames_of(run)["desk"].given_object_mask, drawn > 0)


def test_a_second_run_forgets_the_photos_of_the_first(tmp_path, photo):
    other = photo.with_name("other.png")
    Image.new("RGB", (80, 60)).save(other)
    assert set(prepared(tmp_path, photo, other).names) == {"desk", "other"}
    assert set(prepared(tmp_path, other).names) == {"other"}


def test_photos_of_one_name_from_two_folders_stay_apart(tmp_path, photo):
    twin = tmp_path / "twin" / "desk.png"
    twin.parent.mkdir()
    Image.new("RGB", (40, 30)).save(twin)
    run = prepared(tmp_path, photo, twin)
    assert {name: frame.image.shape for name, frame in frames_of(run).items()} == {
        "desk": (60, 80, 3),
        "desk_2": (30, 40, 3),
    }
    assert run.names == {"desk": photo, "desk_2": twin}


def test_a_folder_stands_for_its_photos(photo):
    assert photo_list([photo.parent, photo]) == [photo]


def test_an_own_mesh_is_the_only_candidate_of_its_category(tmp_path, photo):
    mesh = tmp_path / "bench.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    run = prepared(tmp_path, photo, mesh=mesh, notes=PhotoNotes(object="desk"))
    assert run.config.exemplars.sources == ("folder",)
    assert [p.name for p in Path(run.config.exemplars.folder, "table").iterdir()] == ["bench.obj"]
    # built for this run alone: the checkout's own exemplars stay
    assert not any("exemplars" in target for target in run.shared_targets)
    assert not (run.folder / "resources").is_symlink()


def test_named_objects_need_their_own_exemplars_only(tmp_path, photo):
    named = prepared(tmp_path, photo, notes=PhotoNotes(object="chair"))
    assert [t for t in named.shared_targets if "exemplars" in t] == [
        "resources/exemplars/chair.npz"
    ]
    assert len(prepared(tmp_path, photo).shared_targets) > 10  # any may be seen


def test_the_settings_of_a_run_are_a_file_that_snakemake_takes(tmp_path, photo):
    run = prepared(tmp_path, photo, notes=PhotoNotes(object="chair", box=(1, 2, 3, 4)))
    written = yaml.safe_load(run.config_file.read_text())
    assert written["photos"]["objects"] == {"desk": {"object": "chair", "box": [1, 2, 3, 4]}}
    assert run.config.methods  # the checkout's methods hold


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["none.jpg"], "there is no such photo"),
        (["{photo}", "{other}", "--person", "1"], "--person: meant for one photo"),
        (["{photo}", "--mask", "none.png"], "--mask: there is no file none.png"),
        (["{photo}", "--box", "9,9,1,1"], "box"),
        (["{photo}", "--mesh", "{photo}"], "--mesh: expected one of .obj"),
        (["{photo}", "--focal", "-3"], "--focal:"),
    ],
)
def test_wrong_options_are_named(tmp_path, photo, capsys, options, message):
    other = photo.with_name("other.jpg")
    Image.new("RGB", (8, 8)).save(other)
    words = [option.format(photo=photo, other=other) for option in options]
    assert main(["reconstruct", *words, "--out", str(tmp_path / "out")]) == 1
    assert message in capsys.readouterr().err


def test_a_mesh_without_a_name_is_refused(tmp_path, photo):
    mesh = tmp_path / "bench.obj"
    mesh.write_text("")
    with pytest.raises(ConfigError, match="--object"):
        prepared(tmp_path, photo, mesh=mesh)


SAID = """\
Job stats:
job        count
-------  -------
detect         1
page           2
total          3

[Sun Nov 22 12:50:09 2026]
Job 65: Detecting people and objects in photos-000
Finished jobid: 65 (Rule: detect)
1 of 3 steps (33%) done
"""


def test_snakemakes_words_become_events():
    assert list(events(iter(SAID.splitlines(keepends=True)))) == [
        Planned({"detect": 1, "page": 2}),
        Started("65", "Detecting people and objects in photos-000"),
        Finished("65", "detect"),
    ]


def test_seconds_left_follow_the_pace_of_what_is_done():
    now = [0.0]
    estimate = Estimate(clock=lambda: now[0])
    assert estimate.seconds_left() is None
    estimate.update(Planned({"detect": 1, "page": 1}))  # both weigh 5 s
    assert estimate.seconds_left() == 10
    estimate.update(Started("1", "Detecting"))
    assert estimate.stage == "Detecting"
    now[0] = 30.0
    estimate.update(Finished("1", "detect"))
    assert (estimate.share, estimate.seconds_left()) == (0.5, 30.0)
    estimate.update(Finished("2", "page"))
    assert estimate.seconds_left() == 0


def test_results_are_copied_with_links_that_work(tmp_path):
    work = tmp_path / "out" / WORK
    scenes, pages = work / "results/photos/scenes", work / "results/photos/pages"
    for folder in (scenes, pages, work / "results/photos/gallery"):
        folder.mkdir(parents=True)
    (work / "results/photos.csv").write_text("photo,status\na b.jpg,ok\nc.jpg,no_object_detected\n")
    (scenes / "photos-000.json").write_text(
        json.dumps({"a_b": {"scene": "a_b.glb", "body": "a_b.smpl.npz"}, "c": {}})
    )
    for name in ("a_b.glb", "a_b.smpl.npz"):
        (scenes / name).write_text(name)
    for name in ("a_b", "photos-000"):  # beside the index, and of a photo called like one
        (scenes / f"{name}.object.json").write_text('{"photo": "a b.jpg"}')
    for name in ("a_b", "c"):
        (pages / f"{name}.html").write_text("page")
    links = "".join(f'<a href="../pages/{name}.html">' for name in ("a_b", "c"))
    (work / "results/photos/gallery/photos.html").write_text(links)
    rows = collect(work, tmp_path / "out")
    assert [(row["photo"], row["folder"]) for row in rows] == [("a b.jpg", "a_b"), ("c.jpg", "c")]
    made = {str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").glob("[!.]*/*")}
    assert made == {"a_b/scene.glb", "a_b/smpl.npz", "a_b/page.html", "c/page.html"}
    index = (tmp_path / "out/index.html").read_text()
    assert index == '<a href="a_b/page.html"><a href="c/page.html">'
