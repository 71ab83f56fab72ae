"""Frame pages: nothing fetched, everything escaped, every stage's decision told."""

from __future__ import annotations

import base64
import gzip
import json
import re
import struct
from html.parser import HTMLParser

import numpy as np
import pytest

import report_synthetic as synthetic
from hoi.actions.database import DEFAULT_DATABASE, load_database
from hoi.artifacts import Action, Detection, Evaluation, Joint, Neighbour
from hoi.body import DEFAULT_BODY
from hoi.body.files import read_body_file
from hoi.report import viewer
from hoi.report.config import ReportConfig
from hoi.report.outcomes import number, share
from hoi.report.page import MethodView, frame_page
from hoi.report.poses import PoseShelf, pose_panels

CONFIG = ReportConfig(image_width=160, tile_width=64, supersampling=1)
FACES = synthetic.person()[1]
EXTERNAL = re.compile(r"(?:https?:)?//[\w.-]+\.[a-z]{2,}[^\s\"'`)]*", re.IGNORECASE)


def page(methods=None, frame=None, detection=None, config=CONFIG, **changes) -> str:
    return frame_page(
        frame or synthetic.frame(),
        detection or synthetic.detection(),
        [synthetic.method("phosa", x=0.9, object_cm=83.2), synthetic.method("ours")]
        if methods is None
        else methods,
        FACES,
        synthetic.exemplars(),
        config,
        **changes,
    )


class Reader(HTMLParser):
    """Tags that are opened, attributes, text, and tags that are left open."""

    VOID = frozenset({"meta", "link", "img", "br", "wbr", "input", "hr"})

    def __init__(self, text: str):
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.words: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data):
        if not self.open or self.open[-1] not in {"script", "style"}:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def unpacked(text: str, identity: str) -> bytes:
    found = re.search(rf'id="{identity}"[^>]*>([^<]*)</script>', text)
    assert found
    return gzip.decompress(base64.b64decode(found.group(1)))


def test_a_page_asks_no_network_for_anything():
    text = page(truth=synthetic.truth())
    for _, attributes in Reader(text).tags:
        for name in ("src", "href", "srcset", "action", "data", "poster"):
            assert re.match("data:|#", attributes.get(name, "data:"))
    assert not EXTERNAL.findall(re.sub(r"[A-Za-z0-9+/=]{200,}", "", text))
    assert "url(" not in text and "@import" not in text


def test_the_embedded_library_names_only_a_namespace_and_a_comment():
    script = unpacked(page(), "three-js").decode()
    assert set(re.findall(r"https?://[^\s\"'`)]+", script)) <= {
        "http://www.w3.org/1999/xhtml",
        "https://github.com/mrdoob/three.js/pull/23228",
    }
    assert "SPDX-License-Identifier: MIT" in script[:400]


def test_a_page_is_well_formed_and_every_picture_has_a_text():
    reader = Reader(page(truth=synthetic.truth()))
    assert not reader.open
    pictures = [attributes for tag, attributes in reader.tags if tag == "img"]
    (texture,) = [a for a in pictures if a.get("id") == "photo-texture"]
    assert "hidden" in texture  # the 3D view's, for nobody to look at
    pictures.remove(texture)
    assert len(pictures) == 1 + 1 + 5 + 2 * 3
    assert all(a["alt"] and a["src"].startswith("data:image/webp;base64,") for a in pictures)


def test_two_methods_with_a_full_size_body_and_the_truth_stay_below_one_megabyte():
    trimesh = pytest.importorskip("trimesh")
    body = trimesh.creation.icosphere(subdivisions=5)  # 10242 vertices: more than any body
    noise = np.random.default_rng(0).normal(0, 0.003, body.vertices.shape)
    vertices = (body.vertices * [0.3, 0.85, 0.2] + noise + [0, 0.15, 3]).astype(np.float32)
    fit = synthetic.body_fit(vertices=vertices)
    methods = [
        synthetic.method(name, body=fit, joint=synthetic.joint(method=name, x=x, vertices=vertices))
        for name, x in (("phosa", 0.9), ("ours", 0.3))
    ]
    truth = synthetic.truth().model_copy(update=dict(body_vertices=vertices, body_faces=body.faces))
    text = frame_page(
        synthetic.frame(), synthetic.detection(), methods, body.faces, synthetic.exemplars(),
        truth=truth,
    )  # fmt: skip
    assert len(text.encode()) < 1_000_000


def test_equal_inputs_give_an_equal_page():
    assert page() == page()


def test_the_head_names_frame_data_set_action_and_errors():
    text = Reader(page()).text
    for word in ("Date00_Sub00_chair_sit/t0001.000", "behave_mini", "chairwood", "in cm; smpl"):
        assert word in text
    assert "PHOSA 83.2 cm object 4.1 cm body action: sit ok placement" in text
    assert "Ours 9.3 cm object 4.1 cm body action: sit ok" in text


def test_the_head_says_what_speaks_against_the_method_shown_first():
    assert "doubtful" not in Reader(page()).text
    fine = synthetic.joint()
    vast = fine.model_copy(update={"object_vertices": fine.object_vertices * 2})
    doubtful = Reader(page([synthetic.method("ours", joint=vast)])).text
    assert "doubtful the object came out 1.80 m long, and such things are 0.6 to 1.1 m" in doubtful
    assert "doubtful" not in Reader(page([synthetic.method("phosa", joint=vast)])).text


def test_every_stage_tells_what_it_decided_and_why():
    text = Reader(page()).text
    for told in (
        "other class",  # detection: a rejected candidate's verdict
        "14 596 px",  # area of a mask
        "4.2 px reprojection error",
        "box_chair_3",  # an exemplar that lost
        "best silhouette",  # why the first won
        "480 exemplar and start pairs",
        "sit, distance 0.840",
        "pose_101",  # a runner-up
        "0.85 m, height",
        "paper table 5",
        "cushion: no such part",  # an answer that was not mapped
        "chair seat butt 1.00 paper table 6",
        "contact 0.6200 0.0310",  # a loss before and after
        "lowest total",  # the rule that chose the hypothesis
        "body 4.1 cm, object 9.3 cm",
    ):
        assert told in text, told


def test_a_decision_that_methods_share_is_told_once():
    text = Reader(page()).text
    assert text.count("best silhouette") == 1
    assert text.count("ok 4.2 px reprojection error") == 1
    other = synthetic.object_fit().model_copy(update=dict(searched=7))
    different = Reader(
        page([synthetic.method("phosa", objects=other), synthetic.method("ours")])
    ).text
    assert different.count("best silhouette") == 2
    assert "box_chair_0, IoU 0.91 Ours" in different  # whose it is
    assert "7 exemplar and start pairs" in different


def test_nothing_from_an_artifact_can_become_markup():
    evil = "<script>alert('x')</script><img src=x onerror=alert(1)>\"'"
    frame = synthetic.frame(evil, action=evil, source=evil)
    failure = synthetic.failed(Joint, evil, evil, "joint")
    fit = synthetic.object_fit().model_copy(update=dict(reasons=[evil] * 5))
    text = page(
        [synthetic.method(evil, joint=failure, objects=fit), synthetic.method("ours")], frame
    )
    assert "<script>alert" not in text and "<img src=x" not in text
    reader = Reader(text)
    assert not reader.open
    assert not any("onerror" in attributes for _, attributes in reader.tags)
    assert evil.split('"')[0] in reader.text


def test_a_failed_frame_keeps_its_photo_and_names_stage_and_cause():
    failure = synthetic.failed(Detection, "no_object_detected", "Best was a couch.", "detect")
    stopped = MethodView(
        "ours", joint=Joint.skipped("f", failure), evaluation=Evaluation.skipped("f", failure)
    )
    text = page([stopped], detection=failure)
    reader = Reader(text)
    assert "no object detected at stage detect: Best was a couch." in reader.text
    assert "Skipped: detect stopped. Best was a couch." in reader.text
    assert next(a["alt"] for tag, a in reader.tags if tag == "img").startswith("The photo.")
    assert 'id="three-js"' not in text and len(text) < 60_000


def test_a_method_that_failed_does_not_hide_the_one_that_worked():
    failure = synthetic.failed(Joint, "diverged", "The loss was not finite.", "joint")
    text = page([synthetic.method("phosa", joint=failure), synthetic.method("ours")])
    assert "Stage joint stopped: diverged: The loss was not finite." in Reader(text).text
    assert text.count("data-method=") == 1


def scenes_in(text: str):
    """The page's GLB: its JSON, and a function from node name to vertices in metres."""
    data = unpacked(text, "scenes-glb")
    magic, version, length = struct.unpack("<4sII", data[:12])
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size = struct.unpack("<I", data[12:16])[0]
    tree, binary = json.loads(data[20 : 20 + size]), data[28 + size :]

    def vertices(node: dict) -> np.ndarray:
        (primitive,) = tree["meshes"][node["mesh"]]["primitives"]
        accessor = tree["accessors"][primitive["attributes"]["POSITION"]]
        view = tree["bufferViews"][accessor["bufferView"]]
        rows = np.frombuffer(binary, "<i2", accessor["count"] * 4, view["byteOffset"])
        return rows.reshape(-1, 4)[:, :3] * node["scale"] + node["translation"]

    return tree, vertices


def test_the_embedded_scenes_are_those_of_the_results_in_one_frame_of_reference():
    methods = [synthetic.method("phosa", x=0.9), synthetic.method("ours")]
    tree, vertices = scenes_in(page(methods, truth=synthetic.truth()))
    tops = [tree["nodes"][k] for k in tree["scenes"][0]["nodes"]]
    assert [top["name"] for top in tops] == ["ours", "phosa", "truth"]
    transform = np.array(tree["scenes"][0]["extras"]["scene_from_camera"])
    joints = {method.name: method.joint for method in methods}
    for top in tops[:2]:
        parts = {tree["nodes"][k]["name"]: tree["nodes"][k] for k in top["children"]}
        joint = joints[top["name"]]
        for name, meant in (("body", joint.body_vertices), ("object", joint.object_vertices)):
            moved = meant @ transform[:3, :3].T + transform[:3, 3]
            np.testing.assert_allclose(vertices(parts[name]), moved, atol=1.5e-4)
    assert min(vertices(node)[:, 1].min() for node in tree["nodes"] if "mesh" in node) > -2e-4


def test_what_scenes_share_is_stored_once():
    one, _ = scenes_in(page([synthetic.method("ours")]))
    two, _ = scenes_in(page([synthetic.method("ours"), synthetic.method("no_normal")]))
    assert len(two["meshes"]) == 2 * len(one["meshes"])
    assert len(two["bufferViews"]) == len(one["bufferViews"])


def test_the_photo_hangs_where_its_camera_saw_it():
    tree, _ = scenes_in(page([synthetic.method("ours")]))
    extras = tree["scenes"][0]["extras"]
    camera_from_scene = np.linalg.inv(np.array(extras["scene_from_camera"]))
    corners = np.column_stack([extras["photo"], np.ones(4)]) @ camera_from_scene[:3].T
    pixels = corners @ synthetic.INTRINSICS.T
    expected = [[0, 0], [640, 0], [640, 480], [0, 480]]
    np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], expected, atol=0.1)
    assert corners[:, 2].min() > synthetic.joint().body_vertices[:, 2].max()


def test_timings_and_settings_are_told():
    told = Reader(page(seconds={"detect": 0.25, "joint/ours": 2.5}, settings={"seed": 7})).text
    assert "joint/ours 2.50" in told and "2.8 s on one core" in told and "seed: 7" in told


def test_without_the_viewer_the_page_says_why_and_keeps_the_pictures(monkeypatch):
    def changed(name):
        raise ValueError("gone")

    viewer.three_js.cache_clear()
    monkeypatch.setattr("trimesh.resources.get_bytes", changed)
    reader = Reader(page([synthetic.method("ours")]))
    assert "install trimesh 5.2" in reader.text
    assert sum(tag == "img" for tag, _ in reader.tags) == 10
    viewer.three_js.cache_clear()


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (1.256, 2, "1.26"),
        (0.0, 2, "0.00"),
        (0.0001, 2, "1.0e-04"),
        (None, 2, "–"),
        (float("nan"), 1, "–"),
        (-3.0, 0, "-3"),
    ],
)
def test_numbers_are_short_and_never_hide_a_small_value(value, digits, text):
    assert number(value, digits) == text


def test_sharing_keeps_the_order_of_methods():
    from hoi.report.outcomes import describe_action

    same = describe_action(synthetic.action())
    (shared,) = share([("phosa", same), ("ours", same)])
    assert shared.methods == ("phosa", "ours")


def test_every_file_that_a_page_is_made_of_is_named_so_that_edits_can_be_noticed():
    from hoi.report import asset_files

    names = {path.name for path in asset_files()}
    assert {"frame.html.j2", "style.css", "viewer.js", "gallery.js", "paper_tables.csv"} <= names
    assert not any(name.endswith(".py") for name in names)


def test_what_the_prior_says_beyond_the_paper_is_told():
    text = " ".join(Reader(page()).words)
    assert "height 0.75–1.15 m" in text
    assert "below, turned same" in text
    assert "leaning back (65%), upright (35%)" in text and "10%" in text


def test_the_nearest_pose_and_those_of_other_actions_are_pictures():
    database = load_database(DEFAULT_DATABASE)
    chair = database.rows_of("chair")
    other = next(row for row in chair if database.actions[row] != database.actions[chair[0]])
    body = synthetic.body_fit().model_copy(update={"body_pose": database.body_pose[chair[0]]})
    action = Action(
        frame_id="f",
        action=str(database.actions[chair[0]]),
        distance=0.1,
        pose_id=str(database.pose_ids[chair[0]]),
        pose_distance=0.1,
        runners_up=[
            Neighbour(
                pose_id=str(database.pose_ids[other]),
                action=str(database.actions[other]),
                distance=1.3,
            )
        ],
    )
    shelf = PoseShelf(database, read_body_file(DEFAULT_BODY))
    person, nearest, runner_up = pose_panels(body, action, shelf)
    assert nearest.title == action.action and runner_up.title == str(database.actions[other])
    blue = [(p.image[..., 2].astype(int) - p.image[..., 0] > 20).mean() for p in (person, nearest)]
    assert min(blue) > 0.05 and (runner_up.image != nearest.image).any()
    methods = [synthetic.method(name, action=action, body=body) for name in ("phosa", "ours")]
    assert page(methods, poses=shelf).count("Body pose:") == 3  # shared by both methods
    assert pose_panels(body, None, shelf) == () == pose_panels(None, action, shelf)
