"""A mesh of one's own: oriented, scaled, labelled, described, and merged into what stages read."""

import argparse
import csv
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hoi.actions.database import load_database
from hoi.actions.space import DEFAULT_ACTION_SPACE, load_action_space
from hoi.cli import add_object as command
from hoi.cli import main
from hoi.config import load_config
from hoi.detect.labels import label_weights
from hoi.errors import AssetError, ConfigError
from hoi.exemplars.build import build_library
from hoi.exemplars.config import ExemplarsConfig
from hoi.exemplars.library import load_library, save_library
from hoi.exemplars.procedural import generate
from hoi.exemplars.vocabulary import exemplar_category
from hoi.own_objects import adding, picture
from hoi.own_objects.description import (
    OwnMesh,
    OwnObject,
    checked_category,
    detector_labels,
    mesh_paths,
    own_objects,
    read_description,
)
from hoi.own_objects.knowledge import body_region, object_part, parse_contact, poses_for
from hoi.own_objects.merging import merge_all
from hoi.own_objects.mesh_file import is_name, label_regions, read_mesh_file
from hoi.own_objects.orientation import canonical_from_file, guess_orientation, surface_points
from hoi.own_objects.prepare import MeshOptions, Prepared, prepare_mesh
from hoi.priors.config import ClientConfig, PriorsConfig
from hoi.priors.recordings import Question
from hoi.priors.stage import PriorStage
from hoi.priors.tables import NEEDED_TABLES, RECORDED, RICHER_TABLES
from own_object_meshes import stroller, umbrella, write_glb

CONFIG = Path(__file__).parents[1] / "config" / "config.yaml"
TABLES = [RECORDED / f"{name}.csv" for name in (*NEEDED_TABLES, *RICHER_TABLES)]
SMALL = 300  # vertices: quick


@pytest.fixture(scope="module")
def glb(tmp_path_factory):
    folder = tmp_path_factory.mktemp("meshes")
    return {
        "stroller": write_glb(stroller(), folder / "my_stroller.glb"),
        "umbrella": write_glb(umbrella(), folder / "my_umbrella.glb"),
    }


@pytest.fixture(scope="module")
def added(glb, tmp_path_factory):
    """A folder with a stroller and an umbrella, by the command line."""
    folder = tmp_path_factory.mktemp("my_objects")
    for category, contact in (("stroller", "push:handle:hands"), ("umbrella", "hold:handle:hand")):
        words = ["add-object", str(glb[category]), "--category", category, "--contact", contact]
        assert main([*words, "--folder", str(folder), "--config", str(CONFIG)]) == 0
    return folder


@pytest.fixture
def quick(glb, added, monkeypatch):
    """What is said of an object is the topic, not its mesh: that is prepared once, and undrawn."""
    monkeypatch.setattr(adding, "draw_picture", lambda *a, **k: None)

    def prepared(path, category, name, options):
        (known,) = load_library_of(added, Path(path).stem.removeprefix("my_"))
        parts = [options.groups.get(part, part) for part in known.part_names]
        names, index = np.unique(parts, return_inverse=True)
        renamed = replace(
            known,
            name=name,
            category=category,
            part_names=tuple(map(str, names)),
            face_parts=index[known.face_parts],
        )
        return Prepared(renamed, OwnMesh(file=Path(path).name), ())

    monkeypatch.setattr(adding, "prepare_mesh", prepared)


# ---------------------------------------------------------------------------- orientation


@pytest.mark.parametrize("up", ["y", "z", "-x"])
@pytest.mark.parametrize("front", ["x", "-y", "z"])
def test_the_rotation_takes_the_named_axes_up_and_to_the_front(up, front):
    if up[-1] == front[-1]:
        with pytest.raises(ConfigError, match="one axis"):
            canonical_from_file(up, front)
        return
    turn = canonical_from_file(up, front)
    sign = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
    for axis, wanted in ((up, (0, 1, 0)), (front, (0, 0, 1))):
        vector = np.array(sign[axis[-1]]) * (-1 if axis[0] == "-" else 1)
        np.testing.assert_array_equal(turn @ vector, wanted)
    assert np.linalg.det(turn) == pytest.approx(1)


def points_of(parts, turn):
    whole = trimesh.util.concatenate(list(parts.values()))
    return surface_points(whole.vertices @ turn.T, whole.faces)


def test_a_file_keeps_its_convention_unless_the_shape_says_otherwise():
    upright, z_up = np.eye(3), canonical_from_file("z", "-y").T
    assert guess_orientation(points_of(stroller(), upright), ".glb")[:2] == ("y", "z")
    assert guess_orientation(points_of(stroller(), z_up), ".stl")[:2] == ("z", "-y")
    table = trimesh.util.concatenate(
        [trimesh.creation.box((1.2, 0.04, 0.7))]
        + [trimesh.creation.box((0.05, 0.7, 0.05)).apply_translation((x, -0.37, z))
           for x in (-0.55, 0.55) for z in (-0.3, 0.3)]
    )  # fmt: skip
    lying = surface_points(table.vertices @ z_up.T, table.faces)  # z-up in a y-up format
    assert guess_orientation(lying, ".obj").up == "z"


def test_the_front_lies_in_the_mirror_plane_and_away_from_the_high_side():
    sideways = canonical_from_file("y", "x").T  # the pushchair looks along +x
    found = guess_orientation(points_of(stroller(), sideways), ".glb")
    assert (found.up, found.front) == ("y", "x")


def test_what_the_user_says_is_not_guessed():
    found = guess_orientation(points_of(stroller(), np.eye(3)), ".glb", up="x", front="-z")
    assert found == ("x", "-z", "as you said")


# ------------------------------------------------------------------------- mesh and parts


def test_a_mesh_in_any_unit_and_frame_becomes_the_same_upright_metric_object(glb, tmp_path):
    z_up = np.eye(4)
    z_up[:3, :3] = canonical_from_file("z", "-y").T
    turned = write_glb(stroller(), tmp_path / "scan.glb", z_up, scale=1000)
    options = MeshOptions(vertices=SMALL)
    reference = prepare_mesh(glb["stroller"], "stroller", "a", options)
    other = prepare_mesh(
        turned, "stroller", "b", MeshOptions(up="z", front="-y", unit="mm", vertices=SMALL)
    )
    np.testing.assert_allclose(other.exemplar.size, reference.exemplar.size, atol=0.01)
    assert other.exemplar.part_names == reference.exemplar.part_names
    assert reference.exemplar.part_names == ("frame", "handle", "seat", "wheel")
    handle = reference.exemplar.part_vertices("handle")
    points = reference.exemplar.vertices
    assert points[handle, 1].min() > 0.3 and points[handle, 2].max() < -0.3  # high, at the back
    wheel = points[reference.exemplar.part_vertices("wheel")]
    assert wheel[:, 1].max() < points[:, 1].min() + 0.26
    mesh = trimesh.Trimesh(points, reference.exemplar.faces, process=False)
    assert mesh.is_watertight


def test_the_size_that_the_user_says_overrules_the_unit(glb):
    options = MeshOptions(size_m=0.5, size_axis="height", vertices=SMALL)
    assert prepare_mesh(glb["umbrella"], "umbrella", "a", options).exemplar.size[
        1
    ] == pytest.approx(0.5, abs=0.01)


def test_an_implausible_size_asks_for_one(tmp_path):
    ball = {"ball": trimesh.creation.icosphere(1, radius=4e7)}
    with pytest.raises(AssetError, match="--size METRES"):
        prepare_mesh(write_glb(ball, tmp_path / "b.glb"), "globe", "b", MeshOptions())


def test_names_of_modelling_programs_are_no_parts():
    assert not any(map(is_name, ("mesh_0", "cube", "material", "geometry", "object_12", "node3")))
    assert all(map(is_name, ("handle", "seat", "rueckenlehne", "meshwork")))


def test_materials_tell_parts_apart_where_nodes_do_not(tmp_path):
    text = "o Mesh\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    text += "usemtl Grip\nf 1 2 3\nusemtl Blade\nf 1 2 4\n"
    (tmp_path / "tool.obj").write_text(text)
    assert read_mesh_file(tmp_path / "tool.obj").groups.tolist() == ["Grip", "Blade"]


def test_groups_labels_and_regions_name_parts_in_this_order(glb, tmp_path):
    mesh = read_mesh_file(glb["umbrella"])
    labels = tmp_path / "labels.txt"
    labels.write_text("\n".join(["cloth"] * len(mesh.faces)))
    options = MeshOptions(labels=labels, regions=("Top Knob: y>0.97",), vertices=SMALL)
    prepared = prepare_mesh(glb["umbrella"], "umbrella", "a", options)
    assert prepared.exemplar.part_names == ("cloth", "top_knob")
    renamed = MeshOptions(groups={"canopy": "roof", "shaft": "handle"}, vertices=SMALL)
    parts = prepare_mesh(glb["umbrella"], "umbrella", "a", renamed).exemplar.part_names
    assert parts == ("handle", "roof")
    with pytest.raises(ConfigError, match="no group 'lid'"):
        prepare_mesh(glb["umbrella"], "umbrella", "a", MeshOptions(groups={"lid": "x"}))
    labels.write_text("cloth\n")
    with pytest.raises(AssetError, match="1 lines for"):
        prepare_mesh(glb["umbrella"], "umbrella", "a", MeshOptions(labels=labels))


def test_regions_are_shares_of_the_bounding_box():
    centres = np.array([[0, 0, 0], [0, 1.0, 0], [2, 1.0, 4]])
    parts = label_regions(np.array(["a", "a", "a"]), centres, ["b: y>0.5", "c: y>0.5, z>0.9"])
    assert parts.tolist() == ["a", "b", "c"]
    for rule, message in (("b y>1", "write it as"), ("b: y>2", "holds no part")):
        with pytest.raises(ConfigError, match=message):
            label_regions(parts, centres, [rule])


@pytest.mark.parametrize("content", [b"", b"solid nothing", b"\0" * 200])
def test_a_damaged_mesh_file_is_named(tmp_path, content):
    for suffix in (".glb", ".obj", ".stl", ".ply"):
        path = tmp_path / f"bad{suffix}"
        path.write_bytes(content)
        with pytest.raises(AssetError, match=f"bad{suffix}"):
            read_mesh_file(path)


# ------------------------------------------------------------------------------ knowledge


@pytest.mark.parametrize(
    ("words", "meant"),
    [("hands", ("hand", "both")), ("hand", ("hand", "either")), ("one hand", ("hand", "either")),
     ("left hand", ("hand", "left")), ("both feet", ("foot", "both")), ("butt", ("butt", "")),
     ("fingers", ("hand", "both")), ("lower back", ("back", ""))],
)  # fmt: skip
def test_body_parts_in_words(words, meant):
    assert body_region(words) == meant


def test_unknown_parts_and_odd_contacts_are_refused_with_what_is_known():
    with pytest.raises(ConfigError, match=r"butt.*hand"):
        body_region("tentacle")
    with pytest.raises(ConfigError, match="wheel, handle"):
        object_part("rudder", ("wheel", "handle"))
    assert object_part("Wheels", ("wheel", "handle")) == "wheel"
    with pytest.raises(ConfigError, match="push:handle:hands"):
        parse_contact("push handle")


def test_poses_are_borrowed_from_actions_of_the_same_name_or_look():
    database = load_database(load_config(CONFIG).assets.pose_database)
    assert poses_for("sit", "chair", database) == ()
    assert "hold cup" in poses_for("hold", "umbrella", database)
    assert poses_for("push", "stroller", database) == ("move table", "walk bicycle")
    assert poses_for("levitate", "stroller", database) == ()


def test_a_category_is_a_plain_noun():
    assert checked_category(" Beach  Ball ") == "beach_ball"
    assert exemplar_category("Beach ball", ("ball", "beach_ball")) == "beach_ball"
    for word in ("../etc", "ball2", "", "a/b", "."):
        with pytest.raises(ValueError, match="no name"):
            checked_category(word)


# ------------------------------------------------------------------------------- the folder


def test_the_folder_says_everything_that_is_known(added):
    described = own_objects(added)
    assert sorted(described) == ["stroller", "umbrella"]
    push = described["stroller"].actions["push"]
    assert push.stands_on_floor and push.feet_on_floor
    assert [(c.object, c.body, c.side) for c in push.contacts] == [("handle", "hand", "both")]
    assert not described["umbrella"].actions["hold"].stands_on_floor
    assert described["stroller"].size_m == pytest.approx(1.058, abs=0.01)
    picture = (added / "stroller" / "picture.png").read_bytes()
    assert picture.startswith(b"\x89PNG") and len(picture) > 20_000
    (mesh,) = mesh_paths(added, described["stroller"])
    assert mesh.is_file()


def test_a_second_mesh_joins_the_first_and_keeps_what_is_known(added, glb, tmp_path, quick):
    folder = tmp_path / "copy"
    shutil.copytree(added, folder)
    words = ["add-object", str(glb["stroller"]), "--category", "stroller", "--name", "second"]
    words += ["--vertices", str(SMALL), "--contact", "carry:frame:hands", "--off-floor", "carry"]
    assert main([*words, "--folder", str(folder), "--config", str(CONFIG)]) == 0
    described = read_description(folder / "stroller" / "object.yaml")
    assert sorted(described.meshes) == ["my_stroller", "second"]
    assert list(described.actions) == ["push", "carry"]


def test_an_unknown_object_without_contacts_is_not_written(glb, tmp_path, capsys, quick):
    words = ["add-object", str(glb["umbrella"]), "--category", "umbrella"]
    assert main([*words, "--folder", str(tmp_path), "--config", str(CONFIG)]) == 1
    told = capsys.readouterr().out
    assert "canopy, handle, shaft" in told and "--contact" in told
    assert own_objects(tmp_path) == {}


def test_at_a_terminal_it_asks_and_a_no_writes_nothing(glb, tmp_path, quick):
    wishes = adding.Wishes(glb["umbrella"], "umbrella", "mine", vertices=SMALL)
    for last, accepted in (("n", False), ("", True)):
        answers = iter(["hold:grip:hand", "hold:handle:hand", "", last])
        questions = []

        def ask(question, answers=answers, questions=questions):
            questions.append(question)
            return next(answers)

        done = adding.add_object(wishes, tmp_path, load_config(CONFIG), ask)
        assert done.accepted == accepted == bool(own_objects(tmp_path))
        assert len(questions) == 4 and "right" in questions[-1]


def test_like_takes_the_contacts_that_fit_the_mesh(glb, tmp_path, quick):
    parts = {"handle": "handle", "canopy": "bag_body", "shaft": "bag_body"}
    wishes = adding.Wishes(
        glb["umbrella"], "trolley", "mine", vertices=SMALL, groups=parts, like="suitcase"
    )
    assert adding.add_object(wishes, tmp_path, load_config(CONFIG)).accepted
    described = own_objects(tmp_path)["trolley"]
    assert {"lift", "carry"} <= set(described.actions)
    assert described.detector_labels[0] == "suitcase"
    odd = adding.Wishes(glb["umbrella"], "trolley", "mine", vertices=SMALL, like="chair")
    with pytest.raises(ConfigError, match="chair_seat"):
        adding.add_object(odd, tmp_path, load_config(CONFIG))


def test_two_actions_must_be_told_apart_by_poses(glb, tmp_path, quick):
    contacts = ("levitate:canopy:hands", "hold:handle:hand")
    wishes = adding.Wishes(glb["umbrella"], "umbrella", "m", vertices=SMALL, contacts=contacts)
    with pytest.raises(ConfigError, match="--pose 'levitate="):
        adding.add_object(wishes, tmp_path, load_config(CONFIG))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"category": "pram"}, "its folder is"),
        ({"colour": "red"}, "colour"),
        ({"meshes": {}}, "meshes"),
        ({"meshes": {"../../etc": {"file": "x"}}}, "plain file name"),
        ({"size_m": -1}, "size_m"),
        ({"actions": {"push": {"contacts": [{"object": "a", "body": "tail"}]}}}, "no region"),
    ],
)
def test_a_wrong_description_names_file_and_key(added, tmp_path, change, message):
    import yaml

    content = yaml.safe_load((added / "stroller" / "object.yaml").read_text()) | change
    path = tmp_path / "stroller" / "object.yaml"
    path.parent.mkdir()
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(ConfigError, match=message) as caught:
        own_objects(tmp_path)
    assert "object.yaml" in str(caught.value)


# -------------------------------------------------------------------------- what stages read


@pytest.fixture(scope="module")
def merged(added, tmp_path_factory):
    out = tmp_path_factory.mktemp("own")
    config = load_config(CONFIG)
    merge_all(
        own_objects(added),
        config.assets.pose_database,
        DEFAULT_ACTION_SPACE,
        TABLES,
        out / "poses.npz",
        out / "actions.tsv",
        out,
    )
    return out


def test_poses_of_own_actions_are_borrowed_and_the_others_stay(merged):
    base = load_database(load_config(CONFIG).assets.pose_database)
    database = load_database(merged / "poses.npz")
    assert database.actions_of("stroller") == ["push"]
    rows = database.rows_of("stroller")
    kinds = {str(name).split("_", 1)[1].rsplit("_", 1)[0] for name in database.pose_ids[rows]}
    assert {"move_push_table", "bike_walk"} <= kinds
    np.testing.assert_array_equal(database.body_pose[: len(base)], base.body_pose)
    assert database.pelvis_up is not None and len(database.pelvis_up) == len(database)


def test_the_first_action_is_the_default_one(merged):
    space = load_action_space(merged / "actions.tsv")
    assert space.default_action("stroller", among=["push"]) == "push"
    before = load_action_space(DEFAULT_ACTION_SPACE)
    assert space.actions_of("chair") == before.actions_of("chair")


def test_the_prior_stage_finds_size_and_contacts_of_an_own_object(merged):
    stage = PriorStage(PriorsConfig(), merged)
    interaction = stage.interaction("stroller", "push")
    pairs = [(c.object_part, c.body_part, c.side) for c in interaction.contacts]
    assert pairs == [("handle", "left_hand", "both"), ("handle", "right_hand", "both")]
    assert interaction.stands_on_floor
    package = PriorStage(PriorsConfig())
    assert stage.interaction("chair", "sit") == package.interaction("chair", "sit")


def test_what_is_said_of_a_known_category_replaces_the_package_s_answer(added, tmp_path):
    chair = OwnObject.model_validate(
        {
            "category": "chair",
            "size_m": 1.2,
            "size_axis": "height",
            "actions": {"sit": {"contacts": [{"object": "chair_seat", "body": "lap"}]}},
            "meshes": {"a": {"file": "a.glb"}},
        }
    )
    config = load_config(CONFIG)
    outs = tmp_path / "p.npz", tmp_path / "a.tsv", tmp_path
    merge_all({"chair": chair}, config.assets.pose_database, DEFAULT_ACTION_SPACE, TABLES, *outs)
    stage = PriorStage(PriorsConfig(), tmp_path)
    assert [c.body_part for c in stage.interaction("chair", "sit").contacts] == ["lap"]
    with open(tmp_path / "sizes.csv", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["category"] == "chair"]
    assert [row["size_m"] for row in rows] == ["1.2"]


def test_an_unknown_category_is_its_own_meshes_and_a_known_one_keeps_the_package_s(added, tmp_path):
    described = own_objects(added)
    files = mesh_paths(added, described["stroller"])
    config = ExemplarsConfig(sources=("procedural",), procedural_pool=2, k=2, kmeans_restarts=1)
    build_library(config, tmp_path, "stroller", own=files)
    (only,) = load_library(tmp_path, "stroller")
    assert only.name == "my_stroller" and only.category == "stroller"

    mine = replace(generate("mug", 9), name="my_mug")
    save_library([mine], tmp_path / "my_mug.npz")
    build_library(config, tmp_path / "both", "mug", own=[tmp_path / "my_mug.npz"])
    names = [exemplar.name for exemplar in load_library(tmp_path / "both", "mug")]
    assert names[0] == "my_mug" and len(names) == 3


def test_detector_labels_concern_the_photos_of_their_object_alone(added):
    described = own_objects(added)
    assert detector_labels(described, ["stroller", "umbrella"]) == {}
    labelled = described["stroller"].model_copy(update={"detector_labels": ("bicycle", "chair")})
    assert detector_labels({"stroller": labelled}, ["chair"]) == {}
    labels = detector_labels({"stroller": labelled}, ["chair", "stroller"])
    assert label_weights("stroller", labels, 0.5) == {"bicycle": 1.0, "chair": 0.5}


def test_the_command_reads_its_mappings(capsys):
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    parsed = parser.parse_args(
        ["m.glb", "--category", "c", "--pose", "push=move table", "--pose", "push=walk bicycle"]
    )
    assert command._lists(parsed.pose, "--pose") == {"push": ("move table", "walk bicycle")}
    with pytest.raises(ConfigError, match="--part"):
        command._pairs(["nonsense"], "--part")


def test_the_person_in_the_picture_stands_on_the_objects_floor(added):
    (mesh,) = load_library_of(added, "stroller")
    both = picture.beside_a_person(mesh)
    person, thing = both.part_vertices("person"), both.part_vertices("wheel")
    floor = both.vertices[:, 1].min()
    assert both.vertices[person, 1].min() == pytest.approx(floor, abs=1e-3)
    assert both.vertices[thing, 1].min() == pytest.approx(floor, abs=1e-3)
    assert np.ptp(both.vertices[person, 1]) == pytest.approx(1.7, abs=1e-3)


def load_library_of(folder, category):
    from hoi.exemplars.library import load_library_file

    return load_library_file(mesh_paths(folder, own_objects(folder)[category])[0])


def test_the_folder_need_not_exist(tmp_path):
    assert own_objects(tmp_path / "nothing") == {}
    assert own_objects("") == {}


# -------------------------------------------------------------------------- language model


class Recorded:
    """A language model whose every answer was recorded."""

    def __init__(self, size, *contacts):
        self.config = ClientConfig(model="some-model", samples=max(len(contacts), 1))
        self._size, self._contacts = size, contacts

    def question(self, prompt, stop, template=""):
        return Question(
            api="completions", model="some-model", prompt=prompt, stop=stop, template=template
        )

    def ask(self, question, sample=0, again=False):
        assert "umbrella" in question.prompt
        return self._size if question.template.startswith("size") else self._contacts[sample]


def test_a_language_model_is_asked_for_size_and_contacts(glb, tmp_path, quick, monkeypatch):
    model = Recorded("90 cm", "handle/hands", "grip/left hand, handle/hands", "handle/tentacle")
    monkeypatch.setattr(adding, "model_of", lambda config: model)
    wishes = adding.Wishes(glb["umbrella"], "umbrella", "mine", asked=("hold",))
    done = adding.add_object(wishes, tmp_path, load_config(CONFIG))
    assert done.accepted and "grip/left hand" in done.report and "tentacle" in done.report
    described = own_objects(tmp_path)["umbrella"]
    (contact,) = described.actions["hold"].contacts
    assert (contact.object, contact.body, contact.side) == ("handle", "hand", "")
    assert contact.probability == pytest.approx(2 / 3, abs=1e-3)
    assert (described.size_m, described.size_source) == (0.9, "answer of some-model")


def test_answers_about_no_part_of_the_mesh_are_no_contacts(glb, tmp_path, quick, monkeypatch):
    monkeypatch.setattr(adding, "model_of", lambda config: Recorded("1m", "rudder/hands"))
    wishes = adding.Wishes(glb["umbrella"], "umbrella", "mine", asked=("hold",))
    with pytest.raises(ConfigError, match=r"rudder/hands.*--contact"):
        adding.add_object(wishes, tmp_path, load_config(CONFIG))


def test_asking_without_a_configured_model_says_what_to_configure(glb, tmp_path, quick):
    wishes = adding.Wishes(glb["umbrella"], "umbrella", "mine", asked=("hold",))
    with pytest.raises(ConfigError, match=r"priors\.llm"):
        adding.add_object(wishes, tmp_path, load_config(CONFIG))
