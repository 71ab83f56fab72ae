"""Selection of exemplars, the library file and the user's own meshes."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from hoi.errors import AssetError, ConfigError
from hoi.exemplars import Exemplar, load_library, save_library
from hoi.exemplars.build import build_library, candidates, select
from hoi.exemplars.config import ExemplarsConfig
from hoi.exemplars.furniture import load_furniture
from hoi.exemplars.library import library_path
from hoi.exemplars.procedural import generate
from hoi.exemplars.selection import grid_points, representatives, signed_distances, unit_box
from hoi.exemplars.sweethome import parse_obj

SMALL = ExemplarsConfig(procedural_pool=8, k=6, grid=16, kmeans_restarts=3)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_unit_box_is_filled_whatever_the_size_and_place(seed):
    random = np.random.default_rng(seed)
    vertices = random.normal(size=(20, 3)) * random.uniform(0.01, 10, 3) + random.normal(size=3)
    boxed = unit_box(vertices)
    np.testing.assert_allclose(boxed.min(axis=0), -0.5, atol=1e-5)
    np.testing.assert_allclose(boxed.max(axis=0), 0.5, atol=1e-5)


@pytest.mark.parametrize("category", ["chair", "mug"])
def test_the_sign_of_the_distances_agrees_with_an_independent_inside_test(category):
    exemplar = generate(category, 1)
    distances = signed_distances(exemplar.vertices, exemplar.faces, grid=12)
    boxed = trimesh.Trimesh(unit_box(exemplar.vertices), exemplar.faces, process=False)
    inside = boxed.contains(grid_points(12))
    clear = np.abs(distances) > 1e-4
    np.testing.assert_array_equal((distances < 0)[clear], inside[clear])
    assert 0.01 < inside.mean() < 0.9


def test_the_distances_of_a_sphere_are_those_of_the_formula():
    sphere = trimesh.creation.icosphere(4, radius=3.0)
    distances = signed_distances(sphere.vertices + 7, sphere.faces, grid=10)
    np.testing.assert_allclose(distances, np.linalg.norm(grid_points(10), axis=1) - 0.5, atol=0.003)


def test_representatives_are_the_members_nearest_to_the_cluster_means():
    random = np.random.default_rng(5)
    centres = random.normal(size=(4, 50)) * 20
    features = np.repeat(centres, 6, axis=0) + random.normal(size=(24, 50))
    groups = features.reshape(4, 6, 50)
    distance = np.linalg.norm(groups - groups.mean(axis=1, keepdims=True), axis=2)
    expected = np.sort(distance.argmin(axis=1) + 6 * np.arange(4))
    np.testing.assert_array_equal(representatives(features, 4, seed=0), expected)


def test_a_pool_smaller_than_k_represents_itself():
    np.testing.assert_array_equal(representatives(np.eye(3), 20, seed=0), [0, 1, 2])


def test_building_twice_gives_the_same_bytes(tmp_path):
    first = build_library(SMALL, tmp_path / "a", "stool").read_bytes()
    second = build_library(SMALL, tmp_path / "b", "stool").read_bytes()
    assert first == second
    assert len(load_library(tmp_path / "a", "stool")) == 6


@pytest.mark.parametrize(
    "category", ["chair", "stool", "table", "suitcase", "backpack", "keyboard"]
)
def test_no_true_object_of_the_embedded_data_set_is_a_candidate(category):
    truths = {e.geometry_hash for e in load_furniture("ground_truth", category)}
    assert truths
    pool = candidates(ExemplarsConfig(procedural_pool=40), category)
    assert not truths & {e.geometry_hash for e in pool}
    assert not {e.name for e in load_furniture("ground_truth", category)} & {e.name for e in pool}


def test_an_open_candidate_is_refused_by_name():
    chair = generate("chair", 0)
    torn = Exemplar("torn", "chair", chair.vertices, chair.faces[:-3], chair.part_names,
                    chair.face_parts[:-3])  # fmt: skip
    with pytest.raises(AssetError, match="torn"):
        select([torn], SMALL)


def test_a_category_without_any_source_is_a_config_error():
    with pytest.raises(ConfigError, match="zeppelin"):
        candidates(ExemplarsConfig(), "zeppelin")


def test_a_library_survives_the_round_trip(tmp_path):
    written = [generate("mug", s) for s in range(3)]
    save_library(written, library_path(tmp_path, "mug"))
    for a, b in zip(written, load_library(tmp_path, "mug"), strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
        np.testing.assert_array_equal(a.faces, b.faces)
        np.testing.assert_array_equal(a.face_parts, b.face_parts)
        assert (a.name, a.part_names, a.licence) == (b.name, b.part_names, b.licence)
        assert a.geometry_hash == b.geometry_hash


@pytest.mark.parametrize("damage", ["cut", "garbage", "other format", "wrong counts", "pickle"])
def test_a_damaged_library_is_an_asset_error_naming_the_file(tmp_path, damage):
    path = library_path(tmp_path, "mug")
    save_library([generate("mug", 0)], path)
    if damage == "cut":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    elif damage == "garbage":
        path.write_bytes(b"not an archive")
    else:
        with np.load(path) as stored:
            arrays = dict(stored)
        if damage == "other format":
            arrays["meta"] = np.frombuffer(b'{"format": "x"}', np.uint8)
        elif damage == "wrong counts":
            arrays["faces"] = arrays["faces"][:-1]
        else:
            arrays["faces"] = np.array([{"a": 1}], dtype=object)
        np.savez(path, **arrays)
    with pytest.raises(AssetError, match=r"mug\.npz is damaged"):
        load_library(tmp_path, "mug")


def test_an_absent_library_says_how_to_build_it(tmp_path):
    with pytest.raises(AssetError, match=r"hoi\.exemplars\.build mug"):
        load_library(tmp_path, "mug")


def test_a_library_of_another_category_is_refused(tmp_path):
    save_library([generate("mug", 0)], library_path(tmp_path, "chair"))
    with pytest.raises(AssetError, match="no chair"):
        load_library(tmp_path, "chair")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"face_parts": np.full(12, 7)}, "parts outside"),
        ({"faces": np.full((12, 3), 99)}, "outside 0..7"),
        ({"vertices": np.full((8, 3), np.nan)}, "NaN"),
        ({"vertices": np.eye(3)[np.arange(8) % 3] + 5}, "centred"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(change, message):
    box = trimesh.creation.box((1, 1, 1))
    arrays = {"vertices": box.vertices, "faces": box.faces, "face_parts": np.zeros(12)} | change
    with pytest.raises(ValueError, match=message):
        Exemplar("b", "box", part_names=("whole",), **arrays)


def write_chair_obj(path, scale=1.0):
    """An OBJ chair facing +y with z up, as a user's modeller may write it."""
    boxes = {
        "Chair Seat": ((0.4, 0.4, 0.05), (0, 0, 0.45)),
        "chair_back.001": ((0.4, 0.05, 0.5), (0, -0.2, 0.7)),
        "chair_base": ((0.1, 0.1, 0.45), (0, 0, 0.22)),
    }
    lines, count = [], 1
    for name, (size, centre) in boxes.items():
        box = trimesh.creation.box(size)
        lines.append(f"g {name}")
        lines += ["v {} {} {}".format(*(scale * (v + centre))) for v in box.vertices]
        lines += ["f {}//1 {}//1 {}//1".format(*(f + count)) for f in box.faces]
        count += len(box.vertices)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines))


def own(tmp_path, **changes):
    return ExemplarsConfig(sources=("folder",), folder=str(tmp_path), **changes)


def test_own_meshes_with_named_groups_keep_them_as_parts(tmp_path):
    write_chair_obj(tmp_path / "chair" / "mine.obj", scale=100)
    # z up and front +y becomes front -z: half a turn brings it to +z.
    config = own(tmp_path, folder_up="z", folder_unit_metres=0.01, folder_yaw_degrees=180)
    (chair,) = candidates(config, "chair")
    assert (chair.name, chair.source) == ("mine", "folder")
    assert set(chair.part_names) == {"chair_seat", "chair_back", "chair_base"}
    np.testing.assert_allclose(chair.size, [0.4, 0.95, 0.425], atol=0.015)
    back = chair.vertices[chair.part_vertices("chair_back")]
    assert back[:, 2].mean() < -0.1
    assert back[:, 1].mean() > 0.1


def test_own_meshes_without_names_are_divided_by_the_rule_or_left_whole(tmp_path):
    chair = generate("chair", 0)
    plain = trimesh.Trimesh(chair.vertices, chair.faces, process=False)
    for category in ("chair", "gnome"):
        (tmp_path / category).mkdir()
        plain.export(tmp_path / category / "thing.ply")
    config = own(tmp_path)
    assert {"chair_seat", "chair_back"} <= set(candidates(config, "chair")[0].part_names)
    assert candidates(config, "gnome")[0].part_names == ("whole",)


def test_named_nodes_of_a_glb_become_parts(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((1, 0.05, 1)), node_name="tabletop")
    leg = trimesh.creation.box((0.1, 0.7, 0.1))
    below = trimesh.transformations.translation_matrix([0, -0.35, 0])
    scene.add_geometry(leg, node_name="table_base", transform=below)
    (tmp_path / "table").mkdir()
    scene.export(tmp_path / "table" / "t.glb")
    (table,) = candidates(own(tmp_path), "table")
    assert set(table.part_names) == {"tabletop", "table_base"}
    top = table.vertices[table.part_vertices("tabletop"), 1].mean()
    assert top > table.vertices[table.part_vertices("table_base"), 1].mean()


def test_an_own_mesh_in_the_wrong_unit_or_damaged_is_named(tmp_path):
    write_chair_obj(tmp_path / "chair" / "huge.obj", scale=1000)
    with pytest.raises(AssetError, match=r"huge\.obj.*folder_unit_metres"):
        candidates(own(tmp_path), "chair")
    (tmp_path / "chair" / "huge.obj").write_text("v 0 0\nf 1 2 3")
    with pytest.raises(AssetError, match=r"huge\.obj cannot be read"):
        candidates(own(tmp_path), "chair")


def test_the_folder_source_needs_an_existing_folder(tmp_path):
    with pytest.raises(ConfigError, match=r"exemplars\.folder"):
        candidates(own(tmp_path / "nowhere"), "chair")


def test_obj_polygons_become_fans_and_negative_indices_count_back():
    text = "o top\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1 2/2 3/3 4/4\ng rest\nf -4 -3 -2"
    vertices, faces, groups = parse_obj(text)
    assert vertices.shape == (4, 3)
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert groups.tolist() == ["top", "top", "rest"]


def test_a_contact_sheet_shows_every_exemplar_in_the_colours_of_its_parts(tmp_path):
    from hoi.exemplars.contact_sheet import contact_sheet, part_colours, render

    chairs = [generate("chair", s) for s in range(3)]
    sheet = contact_sheet(chairs, tmp_path / "sheet.png", columns=2, size=80)
    assert (tmp_path / "sheet.png").stat().st_size > 0
    assert sheet.shape == (2 * 110, 160, 3)
    picture = render(chairs[0], 120).reshape(-1, 3).astype(float)
    drawn = picture[(picture < 250).any(axis=1)]
    assert 0.05 < len(drawn) / len(picture) < 0.8
    hues = drawn / drawn.max(axis=1, keepdims=True)
    for colour in part_colours(chairs[0].part_names) / 1.0:
        assert (np.abs(hues - colour / colour.max()).max(axis=1) < 0.03).any()
