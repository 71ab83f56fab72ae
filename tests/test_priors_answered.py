"""From recorded answers to tables, and from tables to priors, without a server."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from hoi.artifacts import Action, Frame
from hoi.errors import ConfigError
from hoi.priors.answered import measured_axis, questions_of, recordings_digest, write_tables
from hoi.priors.client import MissingRecording
from hoi.priors.config import LanguageModelConfig, LookupConfig, PriorsConfig
from hoi.priors.interview import parts_of
from hoi.priors.mapping import expand_region
from hoi.priors.recordings import RECORDINGS, model_folder, read_recording
from hoi.priors.stage import PriorStage
from hoi.priors.study import labels_by_origin
from hoi.priors.tables import RECORDED, load_tables
from hoi.priors.voting import LabelledPair, distinct_answers, shares, verdict
from llm_stub import Stub

SMALL = {
    "sizes": ("chair,0.85,height,paper x,", "table,0.75,height,paper x,"),
    "contacts": (
        "chair,sit,chair seat,butt,chair_seat,butt,,1,paper x,",
        "chair,hand,chair back,hands,chair_back,hand,either,1,mine,",
        "table,work,tabletop,hands,tabletop,hand,both,1,paper x,",
    ),
    "actions": ("chair,sit,yes,yes", "chair,hand,yes,yes", "table,work,yes,yes"),
    "extents": ("chair,0.7,0.8,1.1,,,,,,,mine,", "table,0.7,0.74,0.8,,,,0.6,1.2,2.0,mine,"),
    "alternatives": (
        "chair,sit,upright,0.4,chair_seat,butt,,mine,",
        "chair,hand,on the back,0.5,chair_back,hand,either,mine,",
    ),
    "arrangements": ("chair,sit,below,same,0,mine,", "table,work,front,,0,mine,"),
}


@pytest.fixture
def recorded(tmp_path):
    """A small copy of the recorded tables."""
    folder = tmp_path / "recorded"
    folder.mkdir()
    for name, rows in SMALL.items():
        header = (RECORDED / f"{name}.csv").read_text().split("\n")[0]
        (folder / f"{name}.csv").write_text("\n".join([header, *rows]) + "\n")
    return folder


@pytest.fixture
def stub():
    server = Stub()
    yield server
    server.close()


def settings(stub, tmp_path, **changes) -> LanguageModelConfig:
    return LanguageModelConfig(
        **({"base_url": stub.url, "model": "m", "mode": "record",
            "recordings": str(tmp_path / "answers")} | changes)
    )  # fmt: skip


def rows(path: Path) -> list[dict]:
    with open(path, newline="") as stream:
        return list(csv.DictReader(stream))


def cloze(body: dict) -> str:
    """A model that knows chairs and is vague about tables."""
    prompt = body["prompt"]
    if "length estimator" in prompt:
        return " 0.9m" if prompt.endswith("chair:") else " quite long"
    subject = prompt.rpartition("Action: ")[2]
    if subject.startswith("sit"):
        return (" seat/butt, back/back", " seat/butt", " seat/butt, upholstery/soul")[body["seed"]]
    if subject.startswith("hand"):
        return (" none", " chair back/left hand", " chair back/left hand")[body["seed"]]
    return " well, the tabletop"


def test_shares_of_labels_become_a_table_that_the_stage_reads(stub, tmp_path, recorded):
    stub.answer = cloze
    config = settings(stub, tmp_path, samples=3, temperature=0.8, map_parts="aliases", gaps="none")
    write_tables(config, recorded, tmp_path / "tables")
    found = {
        (row["action"], row["object_part"], row["body_region"], row["side"]): row["probability"]
        for row in rows(tmp_path / "tables/contacts.csv")
    }
    assert found == {
        ("sit", "chair_seat", "butt", ""): "1",
        ("sit", "chair_back", "back", ""): "0.3333",
        ("sit", "", "", ""): "0.3333",  # upholstery/soul: shown, not used
        ("hand", "chair_back", "hand", "left"): "0.6667",
    }
    tables = load_tables(tmp_path / "tables")
    assert list(tables.sizes) == ["chair"] and tables.sizes["chair"].size_m == 0.9
    assert tables.arrangements["chair", "hand"].no_contact == pytest.approx(1 / 3, abs=1e-3)
    sets = tables.alternatives["chair", "sit"]
    assert [round(each.probability, 2) for each in sets] == [0.67, 0.33]
    assert [len(each.pairs) for each in sets] == [1, 2]
    assert [each.name for each in tables.alternatives["chair", "hand"]] == [
        "answer 1",
        "no contact",
    ]
    interaction = PriorStage(LookupConfig(), tmp_path / "tables").interaction("chair", "sit")
    assert len(interaction.unmapped) == 1 and interaction.unmapped[0].startswith("upholstery/soul")
    assert interaction.source == "language model (paper prompt)"


def test_rejected_answers_are_listed_with_their_reason(stub, tmp_path, recorded):
    stub.answer = cloze
    config = settings(stub, tmp_path, samples=3, temperature=0.8, map_parts="aliases", gaps="none")
    write_tables(config, recorded, tmp_path / "tables")
    rejected = rows(tmp_path / "tables/rejected.csv")
    assert [(row["category"], row["action"], row["sample"]) for row in rejected] == [
        ("table", action, str(sample)) for action in ("", "work") for sample in range(3)
    ]
    assert rejected[0]["answer"] == "quite long" and "no length" in rejected[0]["reason"]


def test_gaps_are_filled_from_the_recorded_tables_or_left_as_asked(stub, tmp_path, recorded):
    stub.answer = cloze
    for gaps in ("recorded", "none"):
        config = settings(
            stub, tmp_path, samples=3, temperature=0.8, map_parts="aliases", gaps=gaps
        )
        write_tables(config, recorded, tmp_path / f"gaps_{gaps}")
    filled, left = load_tables(tmp_path / "gaps_recorded"), load_tables(tmp_path / "gaps_none")
    table = {("table", "work")}
    assert set(filled.contacts) - set(left.contacts) == table and "table" not in left.sizes
    both = rows(tmp_path / "gaps_recorded/contacts.csv")
    assert {row["model"] for row in both if row["category"] == "chair"} == {"m"}
    assert [row["source"] for row in both if row["category"] == "table"] == ["paper x"]
    # who answers about contact answers about its alternatives; nobody asked for ranges
    assert {each.source for each in filled.alternatives["chair", "sit"]} == {
        "language model (paper prompt)"
    }
    assert filled.extents["chair"].source == "mine" and not left.extents


def test_replaying_gives_the_same_bytes_without_a_server(stub, tmp_path, recorded):
    stub.answer = cloze
    asked = settings(stub, tmp_path, samples=3, temperature=0.8, map_parts="aliases")
    write_tables(asked, recorded, tmp_path / "asked")
    requests = len(stub.requests)
    stub.close()
    replay = asked.model_copy(update={"mode": "replay", "base_url": "http://127.0.0.1:9/v1"})
    write_tables(replay, recorded, tmp_path / "replayed")
    names = [path.name for path in sorted((tmp_path / "asked").iterdir())]
    assert len(names) == 7
    for name in names:
        assert (tmp_path / "asked" / name).read_bytes() == (
            tmp_path / "replayed" / name
        ).read_bytes()
    assert len(stub.requests) == requests
    stub.server.server_close()


def test_the_digest_of_recordings_follows_the_answers_and_nothing_else(stub, tmp_path, recorded):
    stub.answer = cloze
    config = settings(stub, tmp_path, samples=3, temperature=0.8, map_parts="aliases")
    write_tables(config, recorded, tmp_path / "asked")
    before = recordings_digest(config)
    other = settings(stub, tmp_path, model="n", samples=3, temperature=0.8, map_parts="aliases")
    write_tables(other, recorded, tmp_path / "other")
    assert recordings_digest(config) == before != recordings_digest(other)
    path = next(Path(config.recordings).rglob("m/*.json"))
    record = json.loads(path.read_text())
    record["answers"]["0"]["served_model"] = "elsewhere"
    path.write_text(json.dumps(record))
    assert recordings_digest(config) == before
    record["answers"]["0"]["answer"] = " 3 m"
    path.write_text(json.dumps(record))
    assert recordings_digest(config) != before


def test_another_model_changes_the_priors_of_other_answers_alone(stub, tmp_path, recorded):
    """Byte by byte, so that nothing after the prior stage runs for a frame of equal answers."""

    def answer(body):
        by_hand = "Action: hand" in body["prompt"].rpartition("soccer/hands")[2]
        if "length estimator" in body["prompt"]:
            return " 0.9m"
        return " back/hands" if by_hand and body["model"] == "second" else " seat/butt, top/hands"

    stub.answer = answer
    photo = Frame(frame_id="f", category="chair", image=np.zeros((2, 2, 3), np.uint8),
                  intrinsics=np.eye(3))  # fmt: skip
    priors = {}
    for model in ("first", "second"):
        config = settings(stub, tmp_path, model=model, map_parts="aliases")
        write_tables(config, recorded, tmp_path / model)
        stage = PriorStage(LookupConfig(), tmp_path / model)
        for action in ("sit", "hand"):
            found = Action(frame_id="f", action=action, distance=0.1, default_action="sit")
            priors[model, action] = stage(frame=photo, action=found).to_bytes()
    assert priors["first", "sit"] == priors["second", "sit"]
    assert priors["first", "hand"] != priors["second", "hand"]


def test_an_unrecorded_question_stops_a_replay_and_says_which(stub, tmp_path, recorded):
    with pytest.raises(MissingRecording, match=r"Length of a chair:.*size/paper"):
        write_tables(settings(stub, tmp_path, mode="replay"), recorded, tmp_path / "t")
    assert not stub.requests


def test_a_gap_may_be_left_or_filled_instead(stub, tmp_path, recorded):
    for gaps, categories in (("none", set()), ("recorded", {"chair", "table"})):
        config = settings(stub, tmp_path, mode="replay", gaps=gaps)
        write_tables(config, recorded, tmp_path / gaps / "t")
        assert set(load_tables(tmp_path / gaps / "t").sizes) == categories
    assert not stub.requests


def test_json_answers_bring_ranges_sides_and_arrangements(stub, tmp_path, recorded):
    extent = {"low": 0.7, "typical": 0.9, "high": 1.1}
    size = {"height": extent, "width": extent, "depth": extent, "longest": 0.95}
    touching = {
        "contacts": [{"object_part": "chair_back", "body_part": "hand", "side": "right"}],
        "relation": "front", "facing": "opposite",
    }  # fmt: skip

    def answer(body):
        asked = body["messages"][-1]["content"]
        if asked.startswith("How large"):
            return json.dumps(size)
        return json.dumps(touching if "chair" in asked else touching | {"contacts": []})

    stub.answer = answer
    config = settings(stub, tmp_path, api="chat", prompt="json")
    write_tables(config, recorded, tmp_path / "tables")
    stage = PriorStage(LookupConfig(), tmp_path / "tables")
    photo = Frame(frame_id="f", category="chair", image=np.zeros((2, 2, 3), np.uint8),
                  intrinsics=np.eye(3))  # fmt: skip
    prior = stage(frame=photo, action=Action(frame_id="f", action="sit", distance=0.1))
    assert (prior.size_m, prior.size_axis) == (0.95, "longest")
    assert prior.extents is not None and prior.extents.depth is not None
    assert prior.extents.depth.high == 1.1
    assert prior.retrieved is not None and prior.retrieved.arrangement is not None
    assert [c.body_part for c in prior.retrieved.contacts] == ["right_hand"]
    assert prior.retrieved.arrangement.facing == "opposite"
    # an explicit "nothing touches" is an answer, not a gap
    table = stage.interaction("table", "work")
    assert table.contacts == [] and table.no_contact == 1.0


def test_every_object_and_action_of_the_recorded_tables_is_asked_about():
    tables = load_tables()
    sizes, actions = questions_of(tables)
    assert set(sizes) == set(tables.sizes)
    assert set(actions) == set(tables.contacts)  # so each of their objects has part labels
    assert all(parts_of(category) for category, _ in actions)


@pytest.mark.parametrize(
    ("category", "size", "axis"),
    [("couch", 0.91, "height"), ("couch", 2.0, "longest"), ("table", 0.75, "height"),
     ("desk", 0.75, "height"), ("keyboard", 0.61, "longest"), ("chair", 0.85, "height"),
     ("surfboard", 2.0, "longest"), ("unicorn", 2.0, "longest")],
)  # fmt: skip
def test_a_size_is_read_as_the_extent_that_it_is_nearest_to(category, size, axis):
    assert measured_axis(size, load_tables().extents.get(category)) == axis


def test_the_papers_printed_answers_replay_to_the_papers_labels(tmp_path):
    """Recorded prompt -> recorded answer -> parts -> labels: what the paper's tables hold."""
    config = LanguageModelConfig(model="GPT-3 as printed", gaps="none", map_parts="aliases")
    write_tables(config, RECORDED, tmp_path)
    replayed = load_tables(tmp_path)
    printed = labels_by_origin(load_tables(), printed=True)
    tabled = {k: v for k, v in printed.sizes.items() if "Tab." in v.source}
    assert {k: v.size_m for k, v in replayed.sizes.items()} == {
        k: v.size_m for k, v in tabled.items()
    }
    actions = {k: v for k, v in printed.contacts.items() if "Tab." in v[0].source}
    assert set(replayed.contacts) == set(actions) and len(actions) == 28

    def labels(answers):
        # a reviewer read the "leg" that rests on a tabletop as the thigh
        return {
            (a.object_part, region.replace("thigh", "leg"))
            for a in answers
            for region in expand_region(a.body_region, a.side)
            if a.object_part
        }

    for key, answers in actions.items():
        assert labels(replayed.contacts[key]) == labels(answers), key
        unlabelled = [sum(not a.object_part for a in each[key])
                      for each in (replayed.contacts, actions)]  # fmt: skip
        assert unlabelled[0] == unlabelled[1]


@pytest.mark.parametrize("wording", ["paper", "question", "json"])
def test_a_large_models_answers_make_whole_tables_in_every_wording(tmp_path, wording):
    config = LanguageModelConfig(
        model="Claude asked in a chat", api="chat", prompt=wording, samples=3, temperature=1.0,
        map_parts="aliases",
    )  # fmt: skip
    write_tables(config, RECORDED, tmp_path)
    replayed, ours = load_tables(tmp_path), load_tables()
    assert set(replayed.sizes) == set(ours.sizes)
    ratios = [replayed.sizes[c].size_m / ours.sizes[c].size_m for c in ours.sizes]
    assert 0.8 < sorted(ratios)[len(ratios) // 2] < 1.25
    assert len((tmp_path / "rejected.csv").read_text().splitlines()) == 1  # the header
    sitting = {(a.object_part, a.body_region) for a in replayed.contacts["chair", "sit"]}
    assert ("chair_seat", "butt") in sitting
    assert bool(replayed.extents) == (wording == "json")


def test_every_committed_recording_is_whole_and_names_its_origin():
    paths = list(RECORDINGS.rglob("*.json"))
    assert len(paths) >= 48
    for path in paths:
        question, answers = read_recording(path)
        assert path.parent.name == model_folder(question.model) and path.stem == question.key()
        assert answers and all(a.origin or a.served_model for a in answers.values()), path


def test_a_source_needs_a_named_model():
    with pytest.raises(ValueError, match=r"llm\.model"):
        PriorsConfig(source="llm")
    with pytest.raises(ConfigError, match="model"):
        write_tables(LanguageModelConfig(), RECORDED, Path("/nowhere"))


# ---------------------------------------------------------------------------------- voting

SEAT, BACK = LabelledPair("chair_seat", "butt"), LabelledPair("chair_back", "back")


def test_an_item_named_twice_in_one_answer_counts_once():
    assert shares(["aab", "b", ""]) == {"b": pytest.approx(2 / 3), "a": pytest.approx(1 / 3)}


def test_answers_in_another_order_are_the_same_set_and_hands_are_a_matter_of_degree():
    hands = [[LabelledPair("chair_seat", "hand", side)] for side in ("left", "both")]
    legs = [LabelledPair("tabletop", "leg", side) for side in ("left", "right")]
    ((pairs, _),) = distinct_answers([legs], 1)
    assert pairs == (LabelledPair("tabletop", "leg", "both"),)
    sets = distinct_answers([[SEAT, BACK], [SEAT], [BACK, SEAT], []], 2)
    assert sets == [((SEAT, BACK), 0.5), ((SEAT,), 0.25)]
    assert distinct_answers(hands, 5) == [((hands[0][0],), 1.0)]


@pytest.mark.parametrize(
    ("votes", "bucket"),
    [(10, "correct"), (7, "correct"), (6, "uncertain"), (4, "uncertain"), (3, "incorrect")],
)
def test_the_papers_buckets(votes, bucket):
    assert verdict(votes / 10) == bucket
    assert verdict(sum([0.1] * votes)) == bucket  # however the sum rounds
