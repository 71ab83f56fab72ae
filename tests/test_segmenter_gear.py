"""Things that training scenes generate, and how people hold and ride them."""

import numpy as np
import pytest

from hoi.datasets.behave_mini.materials import Scene
from hoi.segmenter.gear import KINDS, SWUNG, generate_gear
from hoi.segmenter.photos import _smear
from hoi.segmenter.props import Looks, Prop, TextureBank, prop_of_exemplar
from hoi.segmenter.scenes import _Figure, _heading, _mount, _swing


@pytest.fixture(scope="module")
def bank():
    return TextureBank(0, 3)


def prop(kind, number, bank):
    rng = np.random.default_rng(number)
    thing = prop_of_exemplar(rng, Looks(rng, Scene(), bank, 0, 0), generate_gear(kind, number))
    thing.stand()
    return thing


def figure(hands=True):
    """A post of a person's size at the origin, looking along +x."""
    corners = [(x, y, z) for x in (-0.2, 0.2) for y in (0.0, 1.7) for z in (-0.2, 0.2)]
    held = [np.array([0.3, 1.1, side]) for side in (-0.3, 0.3)] if hands else []
    front = np.array([1.0, 0.0, 0.0])
    return _Figure(Prop("post", np.array(corners), []), hands, held, None, front)


@pytest.mark.parametrize("kind", KINDS)
def test_things_have_the_size_of_such_things_and_depend_on_their_number(kind):
    low, high = {"frisbee": (0.2, 0.32), "motorcycle": (1.6, 2.5)}.get(kind, (0.4, 1.8))
    for number in range(6):
        thing = generate_gear(kind, number)
        assert low < np.ptp(thing.vertices, axis=0).max() < high
        assert np.array_equal(thing.vertices, generate_gear(kind, number).vertices)
        assert set(thing.face_parts) == set(range(len(thing.part_names)))
    assert not np.array_equal(generate_gear(kind, 0).vertices, generate_gear(kind, 1).vertices)


@pytest.mark.parametrize("kind", SWUNG)
def test_a_handle_is_at_the_bottom_and_thin(kind):
    for number in range(6):
        points = generate_gear(kind, number).vertices
        handle = points[points[:, 1] < points[:, 1].min() + 0.1]
        assert np.abs(handle[:, [0, 2]]).max() < 0.05  # its canopy may be lopsided


@pytest.mark.parametrize("kind", SWUNG)
@pytest.mark.parametrize("hands", [True, False])
def test_what_is_swung_starts_in_a_hand(kind, hands, bank):
    for number in range(5):
        thing, person = prop(kind, number, bank), figure(hands)
        lowest = np.argmin(thing.vertices[:, 1])
        _swing(np.random.default_rng(number), person, thing)
        grip = thing.vertices[lowest]
        if hands:
            assert min(np.linalg.norm(grip - hand) for hand in person.hands) < 0.08
        else:
            assert np.linalg.norm(grip[[0, 2]]) < 0.6
            assert 0.5 < grip[1] < 1.5
        assert thing.vertices[:, 1].min() > -0.7


def test_one_stands_on_a_board_and_sits_above_the_middle_of_a_motorcycle(bank):
    for number in range(8):
        rng = np.random.default_rng(number)
        board, person = prop("board", number, bank), figure()
        _mount(rng, person, board, seated=False)
        feet = person.prop.vertices[person.prop.vertices[:, 1].argsort()[:4]].mean(0)
        near = np.linalg.norm(board.vertices - feet, axis=1)
        assert near.min() < 0.25
        motorcycle, rider = prop("motorcycle", number, bank), figure()
        _mount(rng, rider, motorcycle, seated=True)
        aside = (rider.prop.middle - motorcycle.middle)[[0, 2]]
        assert np.linalg.norm(aside) < 0.6
        lowest = min(p.vertices[:, 1].min() for p in (motorcycle, rider.prop))
        assert lowest > -0.6


def test_riders_look_along_what_they_ride(bank):
    motorcycle = prop("motorcycle", 3, bank)
    turned = np.pi / 3
    rotation = np.array(
        [[np.cos(turned), 0, np.sin(turned)], [0, 1, 0], [-np.sin(turned), 0, np.cos(turned)]]
    )
    motorcycle.turn(rotation)
    headings = [_heading(np.random.default_rng(number), motorcycle) for number in range(20)]
    off = [abs(np.sin(heading - turned)) for heading in headings]
    assert max(off) < 0.35
    assert len({np.cos(heading - turned) > 0 for heading in headings}) == 2


def test_a_smear_is_a_line_that_keeps_the_light():
    for number in range(10):
        kernel = _smear(np.random.default_rng(number), 256)
        lit = np.argwhere(kernel > 0) - (np.array(kernel.shape) - 1) / 2
        along, across = np.linalg.svd(lit, compute_uv=False)
        assert kernel.sum() == pytest.approx(1)
        assert across < 0.4 * along
        assert 2 <= np.ptp(lit, axis=0).max() <= 13
