"""Modes read from forces, heights and places."""

import numpy as np
import pytest

from trajopt.schedule import Schedule
from trajopt.study.discovery.modes import ModeSequence, read_modes

LENGTH = 0.3
FEET = ("a", "b")


def read(rows, *, rise=0.1, moved=0.1, **settings):
    """Modes of rows of '#' and '.' of two feet, a second long; one in the air is ``rise`` high and moves."""
    on = np.array([[mark == "#" for mark in row] for row in rows]).T
    n = len(on)
    times = (np.arange(n) + 0.5) / n
    places = np.zeros((n, 2, 3))
    places[:, :, 0] = moved * np.cumsum(~on, axis=0)
    gaps = np.where(on, 0.0, rise)
    return read_modes(FEET, times, 1.0, on, gaps, places, length=LENGTH, **settings)


def test_each_change_of_contacts_begins_a_mode():
    modes = read(["####....", "..######"])
    assert modes.key == (("a",), ("a", "b"), ("b",))
    np.testing.assert_allclose([duration for _, duration in modes.modes], [0.25, 0.25, 0.5])


def test_a_foot_that_neither_rises_nor_moves_has_not_been_lifted():
    modes = read(["########", "###..###"], rise=0.001, moved=0.001)
    assert modes.key == (FEET,)
    assert modes.unlifted == 1
    assert read(["########", "###..###"], rise=0.05, moved=0.001).unlifted == 0
    assert read(["########", "###..###"], rise=0.001, moved=0.05).unlifted == 0


def test_a_swing_over_the_end_of_a_cycle_is_one_swing():
    cycle = np.array([1.0, 0.0, 0.0])
    modes = read(["########", "..####.."], rise=0.001, cycle=cycle)
    assert modes.unlifted == 0
    assert len(modes.modes) == 2
    begun = modes.from_touchdown()
    assert begun.key == (FEET, ("a",))
    assert begun.duration == pytest.approx(1.0)
    assert begun.shift % 1.0 == pytest.approx(0.25)


def test_modes_at_the_ends_are_those_that_stand_there():
    modes = read(["........", "########"], ends=(FEET, FEET))
    assert modes.key[0] == modes.key[-1] == FEET
    assert modes.without_short(0.3, periodic=False).key == modes.key


@pytest.mark.parametrize("periodic", [False, True])
def test_short_modes_go_to_their_neighbours(periodic):
    modes = ModeSequence(((("a",), 0.5), (("a", "b"), 0.02), (("b",), 0.48)))
    rounded = modes.without_short(0.1, periodic)
    assert rounded.key == (("a",), ("b",))
    assert rounded.duration == pytest.approx(modes.duration)
    assert rounded.dropped == 1


def test_a_flicker_between_equal_modes_joins_them():
    modes = ModeSequence(((("a",), 0.5), ((), 0.02), (("a",), 0.48)))
    assert modes.without_short(0.1, periodic=False).modes == ((("a",), pytest.approx(1.0)),)


def test_a_short_first_mode_of_a_cycle_moves_its_begin():
    modes = ModeSequence((((), 0.02), (("a",), 0.5), (("a", "b"), 0.48)))
    rounded = modes.without_short(0.1, periodic=True)
    assert rounded.duration == pytest.approx(1.0)
    assert 0 <= rounded.shift <= 0.02


def test_the_schedule_is_written_as_python():
    modes = ModeSequence(((("a",), 0.5), ((), 0.25), (("a", "b"), 0.25)))
    scope: dict[str, Schedule] = {}
    exec(modes.source(), scope)
    phases = scope["SCHEDULE"].phases
    assert [phase.name for phase in phases] == ["single_1", "flight_1", "double_1"]
    assert [(phase.contacts, phase.duration) for phase in phases] == list(modes.modes)


def test_neighbours_have_one_mode_less_or_two_changes_the_other_way_round():
    modes = ModeSequence(((FEET, 0.3), (("a",), 0.2), ((), 0.1), (FEET, 0.4)))
    near = dict(modes.neighbours(False))
    assert near["without-1"].key == (FEET, (), FEET)
    assert near["swapped-1"].key == (FEET, ("b",), (), FEET)
    assert "without-0" not in near  # a motion that is no cycle keeps its ends
    assert "without-3" not in near
    for each in near.values():
        assert each.duration == pytest.approx(modes.duration)
    assert "without-3" in dict(modes.neighbours(True))


def test_cycles_are_apart_by_the_time_in_which_a_contact_is_down_in_one_only():
    trot = ModeSequence(((("a",), 0.5), (("b",), 0.5)))
    late = ModeSequence(((("b",), 1.0), (("a",), 1.0)))
    stand = ModeSequence(((FEET, 1.0),))
    assert trot.apart(late) == pytest.approx(0.0)  # at the best shift, whatever the period
    assert trot.apart(stand) == pytest.approx(0.5)
    assert stand.apart(trot) == trot.apart(stand)
