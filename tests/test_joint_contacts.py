"""From the interaction map to pairs of point sets."""

from hoi.artifacts import Contact
from hoi.joint.config import ContactRule
from hoi.joint.contacts import (
    ContactPair,
    expected_touching,
    paper_pairs,
    recipe_pairs,
    usable_contacts,
)

RULE = ContactRule()


def hands(part: str, side: str = "", probability: float = 1.0) -> list[Contact]:
    return [
        Contact(object_part=part, body_part=f"{which}_hand", side=side, probability=probability)
        for which in ("left", "right")
    ]


def test_sitting_pulls_the_seat_both_ways_and_the_back_one_way():
    contacts = [
        Contact(object_part="chair_seat", body_part="butt"),
        Contact(object_part="chair_back", body_part="back"),
    ]
    assert recipe_pairs(contacts, RULE) == [
        ContactPair(("chair_seat",), ("butt",), False, 1.0),
        ContactPair(("chair_seat",), ("butt",), True, 0.25),
        ContactPair(("chair_back",), ("back",), False, 0.5),
    ]


def test_a_tabletop_is_not_pulled_under_who_sits_on_its_edge():
    contacts = [Contact(object_part="tabletop", body_part="butt")]
    assert recipe_pairs(contacts, RULE) == [ContactPair(("tabletop",), ("butt",), False, 1.0)]


def test_one_hand_is_enough_when_the_answer_says_either():
    contacts = hands("chair_back", "either", 0.7) + hands("chair_seat", "either", 0.3)
    left, right = recipe_pairs(contacts, RULE)
    assert left.object_parts == right.object_parts == ("chair_back",)
    assert (left.body_parts, right.body_parts) == (("left_hand",), ("right_hand",))
    assert left.alternative == right.alternative == 0
    assert left.weight == 0.7


def test_both_hands_hold_what_is_lifted_each_wherever_it_is_nearest():
    contacts = hands("chair_back", "both", 0.6) + hands("chair_seat", "both", 0.6)
    contacts += hands("chair_arm", "both", 0.3)
    left, right = recipe_pairs(contacts, RULE)
    assert left.object_parts == ("chair_back", "chair_seat", "chair_arm")
    assert left.alternative == right.alternative == -1
    assert not left.to_body


def test_two_parts_held_by_either_hand_take_two_hands():
    contacts = hands("chair_back", "either", 0.9) + hands("chair_seat", "either", 0.9)
    assert expected_touching(contacts) == 1.8
    assert all(pair.alternative == -1 for pair in recipe_pairs(contacts, RULE))
    assert expected_touching(hands("chair_back")) == 1.5
    assert all(pair.alternative == 0 for pair in recipe_pairs(hands("chair_back"), RULE))


def test_a_named_side_always_counts():
    contacts = [Contact(object_part="handle", body_part="left_hand", side="left")]
    contacts.append(Contact(object_part="key", body_part="right_hand", side="right"))
    first, second = recipe_pairs(contacts, RULE)
    assert (first.object_parts, first.body_parts) == (("handle",), ("left_hand",))
    assert (second.object_parts, second.body_parts) == (("key",), ("right_hand",))
    assert first.alternative == second.alternative == -1


def test_either_of_two_large_regions_is_an_alternative_per_object_part():
    contacts = [
        Contact(object_part="bag_body", body_part=f"{side}_forearm", side="either")
        for side in ("left", "right")
    ]
    pairs = recipe_pairs(contacts + hands("handle", "either"), RULE)
    assert [pair.alternative for pair in pairs] == [0, 0, 1, 1]


def test_the_paper_pulls_every_listed_part_to_both_hands_together():
    contacts = hands("chair_back") + hands("chair_seat")
    assert paper_pairs(contacts) == [
        ContactPair(("chair_back",), ("left_hand", "right_hand"), True),
        ContactPair(("chair_seat",), ("left_hand", "right_hand"), True),
    ]


def test_the_paper_keeps_legs_that_are_named_one_by_one_apart():
    contacts = [
        Contact(object_part="tabletop", body_part=f"{side}_thigh", side=side)
        for side in ("left", "right")
    ]
    assert [pair.body_parts for pair in paper_pairs(contacts)] == [
        ("left_thigh",),
        ("right_thigh",),
    ]


def test_contacts_with_parts_that_do_not_exist_are_skipped_with_a_reason():
    contacts = [
        Contact(object_part="chair_arm", body_part="left_hand"),
        Contact(object_part="chair_seat", body_part="tail"),
        Contact(object_part="chair_seat", body_part="butt"),
    ]
    usable, skipped = usable_contacts(contacts, ["chair_seat"], ["butt", "left_hand"])
    assert usable == contacts[2:]
    assert "chair_arm" in skipped[0]
    assert "tail" in skipped[1]
