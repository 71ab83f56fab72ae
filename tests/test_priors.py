"""Recorded answers: the tables, the mapping of names, and the prior stage."""

import csv
import shutil

import numpy as np
import pytest

from hoi.actions.database import DEFAULT_DATABASE, load_database
from hoi.actions.space import DEFAULT_ACTION_SPACE, load_action_space
from hoi.artifacts import Action, Frame, Neighbour, Prior
from hoi.errors import AssetError, FrameFailure
from hoi.exemplars.vocabulary import part_names, partnet_parts
from hoi.priors.config import PriorsConfig
from hoi.priors.mapping import (
    BODY_REGIONS,
    OBJECT_PARTS,
    expand_region,
    map_body_part,
    map_object_part,
)
from hoi.priors.stage import PriorStage
from hoi.priors.tables import NEEDED_TABLES, RECORDED, RICHER_TABLES, load_tables

PAPER_SIZES = {
    "backpack": 0.5, "bed": 2.0, "bowl": 0.15, "clock": 0.3, "cup": 0.1, "door": 2.1, "hat": 0.3,
    "knife": 0.22, "mug": 0.12, "suitcase": 0.81, "bag": 0.5, "bottle": 0.3, "chair": 0.85,
    "couch": 0.91, "desk": 0.75, "handbag": 0.3, "keyboard": 0.61, "microwave": 0.5,
    "scissors": 0.2, "table": 0.75,
}  # fmt: skip
# category: action -> (object part, body part), as the supplement prints them
PAPER_CONTACTS = {
    "chair": {
        "sit": ["chair seat/butt", "chair back/back"],
        "carry": ["chair arms/hands", "chair back/hands", "chair seat/hands"],
        "rest": ["chair seat/butt", "chair back/back"],
        "stand on": ["chair seat/feet"],
        "stand next to": ["chair back/hands"],
        "sleep": ["chair seat/butt", "chair back/back"],
    },
    "table": {
        "sit": ["tabletop/butt", "tabletop/left leg", "tabletop/right leg"],
        "work": ["tabletop/hands"],
        "arrange": ["tabletop/hands"],
        "lay": ["tabletop/body"],
        "place": ["tabletop/hands"],
    },
    "backpack": {
        "carry": ["shoulder strap/hands", "support/hands"],
        "backpack": ["shoulder strap/shoulders", "support/shoulders", "bag body/back"],
        "mount": ["shoulder strap/hands", "shoulder strap/waist", "support/hands",
                  "support/waist"],
    },
    "suitcase": {
        "carry": ["handle/hands"],
        "pack": ["zipper/hands"],
        "lug": ["handle/hands"],
        "throw": ["handle/hands"],
    },
    "scissors": {
        "cut": ["blade handle/hands", "handle/hands"],
        "pass": ["blade/hands", "blade handle/hands", "handle/hands", "securing clip/hands"],
    },
    "keyboard": {name: ["key/hands"] for name in ("type", "play", "control", "enter")},
    "bowl": {
        "hold": ["bowl/hands"], "serve": ["bowl/hands"], "eat": ["bowl/mouth"],
        "wash": ["bowl/hands"],
    },
}  # fmt: skip


def frame_with(category: str) -> Frame:
    return Frame(
        frame_id="f",
        dataset="test",
        category=category,
        image=np.zeros((2, 2, 3), np.uint8),
        intrinsics=np.eye(3),
    )


def prior_of(category: str, action: str, default: str = "", **settings) -> Prior:
    artifact = Action(frame_id="f", action=action, distance=0.1, default_action=default)
    return PriorStage(PriorsConfig(**settings))(frame=frame_with(category), action=artifact)


# ------------------------------------------------------------------------------ the tables


def test_the_papers_twenty_sizes_are_there_verbatim():
    sizes = load_tables(paper_only=True).sizes
    printed = {k: v.size_m for k, v in sizes.items() if "Tab." in v.source}
    assert printed == PAPER_SIZES and len(printed) == 20


def test_the_papers_45_contact_pairs_are_there_verbatim():
    printed: dict[str, dict[str, list[str]]] = {}
    for (category, action), answers in load_tables(paper_only=True).contacts.items():
        words = [
            f"{a.answer_object_part}/{a.answer_body_part}" for a in answers if "Tab." in a.source
        ]
        if words:
            printed.setdefault(category, {})[action] = words
    assert printed == PAPER_CONTACTS
    assert sum(len(words) for actions in printed.values() for words in actions.values()) == 45
    assert sum(len(actions) for actions in printed.values()) == 28


@pytest.mark.parametrize("name", ["sizes.csv", "contacts.csv"])
def test_every_answer_says_where_it_comes_from(name):
    with open(RECORDED / name, newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert rows and all(row["source"].startswith(("paper ", "authored for hoi")) for row in rows)


def test_no_action_is_answered_by_the_paper_and_by_us():
    for answers in load_tables().contacts.values():
        assert len({answer.source.split()[0] for answer in answers}) == 1


def test_every_action_says_whether_the_object_stands_on_the_floor():
    tables = load_tables()
    assert set(tables.stands_on_floor) == set(tables.feet_on_floor) == set(tables.contacts)


def test_feet_leave_the_floor_on_a_table_and_on_a_chair_stood_on():
    for category, action in (("table", "sit"), ("chair", "stand on"), ("bicycle", "ride")):
        found = prior_of(category, action).retrieved
        assert found is not None and found.stands_on_floor and not found.feet_on_floor
    pushed = prior_of("table", "move").retrieved
    assert pushed is not None and pushed.stands_on_floor and pushed.feet_on_floor


def test_every_action_of_the_pose_database_has_contacts_and_a_size():
    database, tables = load_database(DEFAULT_DATABASE), load_tables()
    for category in database.all_categories():
        assert category in tables.sizes
        for action in database.actions_of(category):
            assert (category, action) in tables.contacts, (category, action)


def test_every_default_action_has_contacts():
    database, tables = load_database(DEFAULT_DATABASE), load_tables()
    space = load_action_space(DEFAULT_ACTION_SPACE)
    for category in {edge.category for edge in space.edges}:
        default = space.default_action(category, database.actions_of(category))
        assert (category, default) in tables.contacts


def test_every_contact_names_a_part_that_meshes_can_have():
    for (category, _), answers in load_tables().contacts.items():
        names = part_names(category) or tuple(partnet_parts("Bag")["level1"])
        for answer in answers:
            assert answer.object_part in (*names, ""), answer


def test_every_contact_names_a_region_of_the_body():
    from hoi.body import DEFAULT_BODY, BodyModel, part_vertices

    regions = part_vertices(BodyModel.load(DEFAULT_BODY))
    for answers in load_tables().contacts.values():
        for answer in answers:
            expanded = expand_region(answer.body_region, answer.side)
            assert expanded and all(len(regions[region]) for region in expanded), answer
    assert set(BODY_REGIONS) <= set(regions)


def test_a_stool_has_no_back_and_no_arms():
    stool = {
        answer.object_part
        for (category, _), answers in load_tables().contacts.items()
        if category == "stool"
        for answer in answers
    }
    assert stool <= {"chair_seat", "chair_base"}


@pytest.mark.parametrize(
    ("name", "line", "problem"),
    [
        ("sizes.csv", "sofa,two,height,me,", "column size_m: 'two' is not a number"),
        ("sizes.csv", "sofa,2.0,height,,", "column source: is empty"),
        ("sizes.csv", "chair,2.0,height,me,", "chair appears twice"),
        ("sizes.csv", "sofa,2.0,depth,me,", "column size_axis: 'depth'"),
        ("sizes.csv", "sofa,-1,height,me,", "not a plausible size"),
        ("contacts.csv", "sofa,sit,a,b,c,butt,up,1,me,", "column side: 'up'"),
        ("contacts.csv", "sofa,sit,a,b,c,butt,,3,me,", "column probability"),
        ("contacts.csv", "sofa,sit,a,b", "column is missing"),
        ("actions.csv", "sofa,sit,perhaps,no", "column stands_on_floor: 'perhaps'"),
        ("actions.csv", "sofa,sit,yes,perhaps", "column feet_on_floor: 'perhaps'"),
        ("sizes.csv", "sofa,2.0,height,me,a note, with a comma", "more values than columns"),
        ("extents.csv", "chair,1,1,1,1,1,1,1,1,1,me,", "chair appears twice"),
        ("extents.csv", "sofa,2,1,3,,,,,,,me,", "column height_m: 2.0, 1.0, 3.0"),
        ("extents.csv", "sofa,,1,,,,,,,,me,", "column height_low: is empty"),
        ("extents.csv", "sofa,,,,,,,,,,me,", "neither height nor width nor depth"),
        ("alternatives.csv", "chair,sit,upright,0.9,chair_seat,butt,,me,", "disagree"),
        ("alternatives.csv", "sofa,sit,a,2,chair_seat,butt,,me,", "column probability"),
        ("arrangements.csv", "chair,sit,below,,0,me,", "chair sit appears twice"),
        ("arrangements.csv", "sofa,sit,inside,,0,me,", "column relation: 'inside'"),
        ("arrangements.csv", "sofa,sit,,up,0,me,", "column facing: 'up'"),
        ("arrangements.csv", "sofa,sit,,,7,me,", "column no_contact: 7.0"),
    ],
)
def test_a_bad_row_is_named_with_file_line_and_column(tmp_path, name, line, problem):
    for table in RECORDED.glob("*.csv"):
        shutil.copy(table, tmp_path)
    with open(tmp_path / name, "a") as stream:
        stream.write(line + "\n")
    number = len((tmp_path / name).read_text().splitlines())
    with pytest.raises(AssetError) as error:
        load_tables(tmp_path)
    assert f"{name}, line {number}" in str(error.value) and problem in str(error.value)


def test_an_absent_table_is_named(tmp_path):
    with pytest.raises(AssetError, match=r"sizes\.csv"):
        load_tables(tmp_path)


def test_the_richer_tables_may_be_absent(tmp_path):
    for name in NEEDED_TABLES:
        shutil.copy(RECORDED / f"{name}.csv", tmp_path)
    tables = load_tables(tmp_path)
    assert tables.sizes and not (tables.extents or tables.alternatives or tables.arrangements)


@pytest.mark.parametrize("name", RICHER_TABLES)
def test_every_row_of_the_richer_tables_is_marked_as_ours(name):
    with open(RECORDED / f"{name}.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert rows and all(row["source"].startswith("authored for hoi") for row in rows)


def test_the_richer_tables_speak_of_recorded_actions_with_labels_that_exist():
    from hoi.body import DEFAULT_BODY, BodyModel, part_vertices

    regions = part_vertices(BodyModel.load(DEFAULT_BODY))
    tables = load_tables()
    assert set(tables.alternatives) <= set(tables.contacts)
    assert set(tables.arrangements) <= set(tables.contacts)
    for (category, action), sets in tables.alternatives.items():
        assert sum(each.probability for each in sets) == pytest.approx(1.0), (category, action)
        assert len(sets) > 1
        for pair in (pair for each in sets for pair in each.pairs):
            assert pair.object_part in OBJECT_PARTS.get(category, part_names(category))
            expanded = expand_region(pair.body_region, pair.side)
            assert expanded and all(len(regions[region]) for region in expanded)


def test_no_contact_is_said_alike_by_arrangements_and_alternatives():
    tables = load_tables()
    for key, sets in tables.alternatives.items():
        empty = sum(each.probability for each in sets if not each.pairs)
        if empty:
            assert tables.arrangements[key].no_contact == empty, key


def test_every_single_size_fits_the_range_of_the_extent_that_it_measures():
    tables = load_tables()
    assert len(tables.extents) >= 30
    for category, said in tables.extents.items():
        size = tables.sizes[category]
        ranges = [r for r in (said.height, said.width, said.depth) if r]
        low, _, high = said.height if size.axis == "height" else max(ranges, key=lambda r: r[1])
        assert 0.8 * low <= size.size_m <= 1.25 * high, category


# ----------------------------------------------------------------------------- the mapping


def test_the_mapping_gives_every_recorded_label_from_its_words():
    for (category, action), answers in load_tables().contacts.items():
        for answer in answers:
            words = answer.answer_object_part
            assert (map_object_part(category, words).label or "") == answer.object_part, answer
            if (category, action, answer.body_region) == ("table", "sit", "thigh"):
                continue  # reviewed: the "leg" that rests on a tabletop is the thigh
            expected = expand_region(answer.body_region, answer.side)
            assert map_body_part(answer.answer_body_part).regions == expected, answer


@pytest.mark.parametrize(
    ("category", "words", "label", "how"),
    [
        ("chair", "seat", "chair_seat", "alias"),
        ("chair", "The Armrests", "chair_arm", "alias"),
        ("chair", "chair_back", "chair_back", "exact"),
        ("stool", "back", None, "unmapped"),
        ("table", "table top", "tabletop", "alias"),
        ("keyboard", "keys", "key", "exact"),
        ("backpack", "support", None, "unmapped"),
        ("suitcase", "shoulder strap", None, "unmapped"),
        ("scissors", "securing clip", None, "unmapped"),
    ],
)
def test_object_words_map_to_labels(category, words, label, how):
    assert map_object_part(category, words) == (label, how)


@pytest.mark.parametrize(
    ("words", "regions"),
    [
        ("hands", ("left_hand", "right_hand")),
        ("both hands", ("left_hand", "right_hand")),
        ("left hand", ("left_hand",)),
        ("Fingertips", ("left_hand", "right_hand")),
        ("feet", ("left_foot", "right_foot")),
        ("right thigh", ("right_thigh",)),
        ("buttocks", ("butt",)),
        ("shoulders", ("shoulders",)),
        ("lower back", ("back",)),
        ("antenna", ()),
        ("left antenna", ()),
        ("", ()),
    ],
)
def test_body_words_map_to_regions(words, regions):
    assert map_body_part(words).regions == regions


def test_every_alias_leads_to_a_label():
    from hoi.priors import mapping

    for category, aliases in mapping._OBJECT_ALIASES.items():
        known = {part for parts in OBJECT_PARTS.values() for part in parts}
        assert set(aliases.values()) <= known, category
    for region in mapping._BODY_ALIASES.values():
        assert expand_region(region, "")


# ------------------------------------------------------------------------------- the stage


def test_sitting_on_a_chair_is_what_the_paper_says():
    prior = prior_of("chair", "sit")
    assert (prior.size_m, prior.size_axis) == (0.85, "height")
    assert prior.retrieved is not None
    pairs = [(c.object_part, c.body_part, c.probability) for c in prior.retrieved.contacts]
    assert pairs == [("chair_seat", "butt", 1.0), ("chair_back", "back", 1.0)]
    assert prior.retrieved.stands_on_floor and prior.retrieved.unmapped == []
    assert prior.retrieved.source == "paper Tab. contactexample (GPT-3)"


def test_hands_become_a_left_and_a_right_hand_that_keep_the_answers_side():
    prior = prior_of("chair", "lift", default="sit")
    assert prior.retrieved is not None and prior.default is not None
    parts = {(c.object_part, c.body_part, c.side) for c in prior.retrieved.contacts}
    assert ("chair_back", "left_hand", "both") in parts
    assert ("chair_back", "right_hand", "both") in parts
    assert not prior.retrieved.stands_on_floor
    assert prior.default.action == "sit"


def test_parts_that_no_mesh_has_are_reported_and_not_dropped():
    prior = prior_of("backpack", "carry")
    assert prior.retrieved is not None
    assert {c.object_part for c in prior.retrieved.contacts} == {"shoulder_strap"}
    assert len(prior.retrieved.unmapped) == 1
    assert prior.retrieved.unmapped[0].startswith("support/hands: ")


def test_the_printed_answers_alone_can_be_asked_for():
    assert prior_of("chair", "sit", answers="paper").size_m == 0.85
    with pytest.raises(FrameFailure) as failure:
        prior_of("chair", "lift", answers="paper")
    assert failure.value.status == "no_contact_prior"
    with pytest.raises(FrameFailure) as failure:
        prior_of("stool", "sit", answers="paper")
    assert failure.value.status == "no_size_prior"


def test_sizes_can_be_lengths_as_the_prompt_says():
    assert prior_of("chair", "sit", size_axis="longest").size_axis == "longest"


def test_improbable_contacts_can_be_left_out():
    prior = prior_of("chair", "lift", min_probability=0.5)
    assert prior.retrieved is not None
    assert {c.object_part for c in prior.retrieved.contacts} == {"chair_back", "chair_seat"}
    with pytest.raises(FrameFailure, match="no contact"):
        prior_of("chair", "lift", min_probability=0.9)


def test_a_prior_says_more_than_the_paper_where_the_tables_do():
    prior = prior_of("chair", "carry", default="sitstand")
    assert prior.retrieved is not None and prior.default is not None and prior.extents is not None
    assert prior.extents.height is not None and prior.extents.height.low < 0.85
    sets = prior.retrieved.alternatives
    assert [each.name for each in sets] == ["back and seat", "by the back", "by the seat"]
    parts = {(c.object_part, c.body_part, c.side) for c in sets[0].contacts}
    assert parts == {(f"chair_{part}", f"{side}_hand", "either")
                     for part in ("back", "seat") for side in ("left", "right")}  # fmt: skip
    assert prior.default.no_contact == 0.3
    assert prior.default.alternatives[1].contacts == []  # "no contact", the second most probable
    assert prior.default.arrangement is not None
    assert (prior.default.arrangement.relation, prior.default.arrangement.facing) == (
        "below", "same")  # fmt: skip


def test_alternatives_can_be_left_out_and_the_papers_answers_have_none():
    for settings in ({"alternatives": "none"}, {"answers": "paper"}):
        prior = prior_of("chair", "carry", **settings)
        assert prior.retrieved is not None and prior.retrieved.alternatives == []
    assert prior_of("chair", "carry", answers="paper").extents is None


def test_an_action_in_which_nothing_touches_has_no_contacts_and_is_no_failure(tmp_path):
    for table in RECORDED.glob("*.csv"):
        shutil.copy(table, tmp_path)
    with open(tmp_path / "arrangements.csv", "a") as stream:
        stream.write("chair,look at,front,,0.9,me,\nchair,juggle,,,0.2,me,\n")
    stage = PriorStage(PriorsConfig(), tmp_path)
    found = stage.interaction("chair", "look at")
    assert found.contacts == [] and found.no_contact == 0.9
    with pytest.raises(FrameFailure, match="no recorded contacts"):
        stage.interaction("chair", "juggle")


# -------------------------------------------------------------------------- wrong answers


def corrupted_pairs(seed: int, **settings) -> dict[tuple[str, str], float]:
    artifact = Action(frame_id="f", action="sit", distance=0.1)
    stage = PriorStage(PriorsConfig(**({"corrupt": 0.29} | settings)))
    interaction = stage(frame=frame_with("chair"), action=artifact, seed=seed).retrieved
    assert interaction is not None
    return {(c.object_part, c.body_part): c.probability for c in interaction.contacts}


TRUE = {("chair_seat", "butt"), ("chair_back", "back")}


def test_the_asked_share_of_pairs_is_wrong_and_the_same_seed_gives_the_same_ones():
    draws = [set(corrupted_pairs(seed)) for seed in range(150)]
    kept = sum(pair in draw for draw in draws for pair in TRUE) / (2 * len(draws))
    assert 0.64 < kept < 0.78
    assert set(corrupted_pairs(3)) == draws[3]
    wrong = {pair for draw in draws for pair in draw - TRUE}
    assert len(wrong) > 5 and {part for part, _ in wrong} <= set(OBJECT_PARTS["chair"])
    assert set(corrupted_pairs(0, corrupt=0.0)) == TRUE
    assert not set(corrupted_pairs(0, corrupt=1.0)) & TRUE


def test_voting_over_independent_answers_brings_the_true_pairs_back():
    kept = [set(corrupted_pairs(seed, votes=10)) for seed in range(40)]
    assert all(pairs <= TRUE for pairs in kept)
    assert sum(map(len, kept)) > 75  # of 80
    shares = [corrupted_pairs(seed, votes=10, min_share=0.0) for seed in range(20)]
    assert all(max(each.values()) == 1.0 for each in shares)
    wrong = [share for each in shares for pair, share in each.items() if pair not in TRUE]
    assert wrong and np.mean(wrong) < 0.3


def test_the_distinct_answers_of_a_vote_can_be_the_alternatives():
    artifact = Action(frame_id="f", action="sit", distance=0.1)
    config = PriorsConfig(corrupt=0.29, votes=10, alternatives="answers", max_alternatives=3)
    prior = PriorStage(config)(frame=frame_with("chair"), action=artifact, seed=1)
    assert prior.retrieved is not None
    sets = prior.retrieved.alternatives
    assert 1 < len(sets) <= 3 and sum(each.probability for each in sets) <= 1
    first = {(c.object_part, c.body_part) for c in sets[0].contacts}
    assert first == TRUE and sets[0].probability >= sets[1].probability


@pytest.mark.parametrize(
    ("category", "action", "status", "named"),
    [
        ("unicorn", "sit", "no_size_prior", "unicorn"),
        ("chair", "juggle", "no_contact_prior", "sit"),
    ],
)
def test_what_nobody_answered_is_a_failure_of_the_frame(category, action, status, named):
    with pytest.raises(FrameFailure) as failure:
        prior_of(category, action)
    assert failure.value.status == status and named in failure.value.detail


def test_a_prior_survives_its_file(tmp_path):
    prior = prior_of("backpack", "carry", default="backpack")
    prior.save(tmp_path / "prior.npz")
    assert Prior.load(tmp_path / "prior.npz") == prior
    assert prior.to_bytes() == prior_of("backpack", "carry", default="backpack").to_bytes()


def test_likely_actions_are_handed_on_and_equal_interactions_are_one():
    runners_up = [
        Neighbour(pose_id="b", action="rest", distance=1.1, probability=0.25),
        Neighbour(pose_id="c", action="stand on", distance=1.2, probability=0.2),
        Neighbour(pose_id="d", action="fly", distance=1.3, probability=0.15),
        Neighbour(pose_id="e", action="hand", distance=1.9, probability=0.01),
    ]
    action = Action(
        frame_id="f", action="sit", distance=1.0, probability=0.39, runners_up=runners_up
    )
    prior = PriorStage(PriorsConfig())(frame=frame_with("chair"), action=action)
    found = {item.action: item.probability for item in prior.hypotheses}
    assert found == pytest.approx({"sit": 0.64, "stand on": 0.2})
    assert list(found) == ["sit", "stand on"]
    one = PriorStage(PriorsConfig(max_hypotheses=1))(frame=frame_with("chair"), action=action)
    assert [item.action for item in one.hypotheses] == ["sit"]


def test_the_data_sets_own_action_is_kept_apart_for_oracles():
    action = Action(frame_id="f", action="sit", distance=1.0, probability=1.0)
    told = frame_with("chair").model_copy(update={"action": "hand"})
    prior = PriorStage(PriorsConfig())(frame=told, action=action)
    assert (prior.true.action, prior.retrieved.action) == ("hand", "sit")
    unsaid = frame_with("chair").model_copy(update={"action": "mix"})
    assert PriorStage(PriorsConfig())(frame=unsaid, action=action).true is None
