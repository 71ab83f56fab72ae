"""The gallery: one card a frame, causes counted, links that cannot mislead."""

from __future__ import annotations

import numpy as np

import report_synthetic as synthetic
from hoi.artifacts import Detection, Evaluation, Frame, Joint
from hoi.report.config import ReportConfig
from hoi.report.gallery import (
    card_of,
    causes_by_method,
    failures_by_cause,
    gallery_page,
    pick_frames,
)
from hoi.report.page import MethodView
from hoi.report.tables import LaidOutTable, as_html, linked
from test_report_page import EXTERNAL, Reader

IMAGE = np.full((30, 40, 3), 128, np.uint8)


def good(name: str, error: float = 9.3):
    frame = synthetic.frame(name)
    methods = [synthetic.method("phosa", object_cm=83.2), synthetic.method("ours", object_cm=error)]
    return card_of(frame, synthetic.detection(), methods, f"frames/{name}.html", IMAGE)


def lost(name: str):
    failure = synthetic.failed(Detection, "no_object_detected", "Best was a couch.", "detect")
    methods = [
        MethodView(method, evaluation=Evaluation.skipped(name, failure))
        for method in ("phosa", "ours")
    ]
    return card_of(synthetic.frame(name), failure, methods, "", IMAGE)


def half(name: str):
    failure = synthetic.failed(Joint, "diverged", "Not finite.", "joint")
    methods = [synthetic.method("phosa", joint=failure), synthetic.method("ours")]
    return card_of(synthetic.frame(name), synthetic.detection(), methods, "", IMAGE)


def test_every_frame_has_a_card_with_its_errors_and_status():
    text = gallery_page([good("a"), lost("b"), half("c")])
    reader = Reader(text)
    assert not reader.open
    cards = [a for tag, a in reader.tags if tag == "li"]
    assert [card["data-status"] for card in cards] == ["ok", "no_object_detected", "ok"]
    assert cards[0]["data-error1"] == "9.3000" and cards[1]["data-error1"] == ""
    assert "3 frames, 1 without a result" in reader.text
    assert "detect: Best was a couch." in reader.text


def test_failures_are_counted_by_cause_with_the_methods_they_stopped():
    rows = failures_by_cause([lost("b"), half("c"), lost("d"), good("a")])
    assert [(r["stage"], r["status"], r["methods"], r["count"], r["share"]) for r in rows] == [
        ("detect", "no_object_detected", "all", "2", "50 %"),
        ("joint", "diverged", "phosa", "1", "25 %"),
    ]
    assert rows[0]["example"] == "b"
    assert failures_by_cause([good("a")]) == []


def test_a_frame_that_could_not_be_read_is_a_card_too():
    frame = synthetic.failed(Frame, "unreadable_image", "Truncated.", "frame")
    card = card_of(frame, None, [MethodView("ours")])
    assert card.status == "unreadable_image"
    assert "unreadable image" in Reader(gallery_page([card])).text


def test_links_are_relative_and_nothing_is_fetched():
    text = gallery_page([good("a")])
    links = [a["href"] for tag, a in Reader(text).tags if tag == "a"]
    assert links == ["#cause=placement&method=phosa"] + ["frames/a.html"] * 2
    assert not EXTERNAL.findall(text)


def test_other_pages_are_named_beside_the_frames():
    page = gallery_page([], others={"actions & poses": "actions.html"})
    assert '<a class="page" href="actions.html">actions &amp; poses</a>' in page
    assert "More:" not in gallery_page([])


def test_names_and_statuses_are_escaped():
    evil = "<b onclick=alert(1)>\"'&"
    failure = synthetic.failed(Joint, evil, evil, "joint")
    card = card_of(
        synthetic.frame(evil), synthetic.detection(), [MethodView(evil, joint=failure)], evil
    )
    reader = Reader(gallery_page([card], heading=evil))
    assert not reader.open and not any("onclick" in a for _, a in reader.tags)


def test_cards_beyond_the_limit_are_counted_not_forgotten():
    cards = [good("a"), lost("b"), lost("c")]
    reader = Reader(gallery_page(cards, ReportConfig(max_cards=1)))
    assert sum(tag == "li" for tag, _ in reader.tags) == 1
    assert "The last 2 frames have no card" in reader.text
    assert "no object detected all 2 67 %" in reader.text


def test_an_empty_gallery_says_so():
    assert "There are no frames yet." in Reader(gallery_page([])).text


def test_equal_cards_give_an_equal_gallery():
    assert gallery_page([good("a"), lost("b")]) == gallery_page([good("a"), lost("b")])


def test_pages_are_given_evenly_over_the_actions_in_the_order_of_the_run():
    frames = [("s1", "sit"), ("s2", "sit"), ("s3", "sit"), ("l1", "lift"), ("h1", "hand")]
    assert pick_frames(frames, 3) == ["s1", "l1", "h1"]
    assert pick_frames(frames, 4) == ["s1", "s2", "l1", "h1"]
    assert pick_frames(frames, 99) == [name for name, _ in frames]


def test_causes_are_counted_by_method_in_the_order_of_the_pipeline():
    found = causes_by_method([good("a"), lost("b"), half("c")], ["phosa", "ours"])
    counts = {row["cause"]: [cell["count"] for cell in row["cells"]] for row in found["rows"]}
    # b: detection for both; a: 83 cm of phosa; c: phosa diverged, ours is fine
    assert counts == {"detection": [1, 1], "placement": [2, 0]}
    assert found["totals"] == [3, 1]


def test_a_frame_without_errors_shows_what_came_out_and_no_empty_table():
    view = synthetic.method("ours", evaluation=None)
    card = card_of(synthetic.frame("a"), synthetic.detection(), [view], "", IMAGE)
    text = gallery_page([card])
    assert "<table" not in text[text.index('class="card"') : text.index("What stopped")]
    assert "sit · object 0.45 × 0.90 × 0.45 m" in Reader(text).text
    assert "worst first" not in text and "Chamfer" not in text


def test_a_card_without_errors_says_what_speaks_against_its_result():
    poor = synthetic.object_fit().model_copy(update={"ious": np.array([0.3, 0.4])})
    view = synthetic.method("ours", evaluation=None, objects=poor)
    card = card_of(synthetic.frame("a"), synthetic.detection(), [view], "", IMAGE)
    assert "looks like no exemplar (IoU of the outlines 0.40)" in Reader(gallery_page([card])).text


def test_tables_on_the_page_lead_to_their_frames():
    table = LaidOutTable("t", "", "Action", (("Ours", ("H",)), ("In print", ("H",))),
        (("Sit", ("1.0", "7.1")), ("Avg.", ("1.0", "7.2"))))  # fmt: skip
    text = gallery_page([good("a")], tables=[as_html(linked(table, "", ["phosa", "ours"]))])
    links = [a["href"] for tag, a in Reader(text).tags if tag == "a" and "order" in a["href"]]
    assert links == ["#order=worst:ours&action=sit", "#order=worst:ours"]
