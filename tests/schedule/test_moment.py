"""Moments of a motion in words."""

import math

import pytest

from trajopt import InputError
from trajopt.schedule import END, Moment, end_of, middle_of, start_of
from trajopt.schedule.moment import Target


def test_functions_name_fractions_of_a_phase():
    assert (start_of("flight"), middle_of("flight"), end_of("flight")) == tuple(
        Moment("flight", fraction) for fraction in (0.0, 0.5, 1.0)
    )
    assert Moment() == END


def test_moments_read_as_words():
    moments = (start_of("flight"), Moment("flight", 0.25), end_of("flight"), END)
    assert [str(moment) for moment in moments] == [
        "start of phase 'flight'", "25 % of phase 'flight'", "end of phase 'flight'", "end of the motion",
    ]  # fmt: skip


@pytest.mark.parametrize("fraction", [-0.1, 1.1, math.nan, "0.5", None, True])
def test_a_fraction_is_from_zero_to_one(fraction):
    with pytest.raises(InputError, match=r"^fraction of Moment is .*; allowed: a finite number from 0 to 1$"):
        Moment("flight", fraction)


@pytest.mark.parametrize(
    ("phase", "allowed"), [("", "the name of a phase"), (3, "a string"), (("a", "b"), "a string")]
)
def test_a_phase_is_a_name(phase, allowed):
    with pytest.raises(InputError, match=rf"^phase of (a moment|start_of) is .*; allowed: {allowed}"):
        start_of(phase)


def test_a_part_of_the_whole_motion_is_no_moment():
    with pytest.raises(InputError, match="of the motion; allowed: 0 to 1 of a phase"):
        Moment(fraction=0.5)


@pytest.mark.parametrize("at", [END, start_of("flight"), middle_of("flight"), end_of("flight")])
def test_targets_keep_their_moment_in_a_file(at):
    described = Target(frame="foot", position=(0.0, 0.0, 1.0), at=at).describe()
    assert Target.from_description(described).at == at


def test_a_waypoint_at_a_start_is_described_as_before():
    described = Target(frame="foot", position=(0.0, 0.0, 1.0), at=start_of("flight")).describe()
    assert set(described) == {"frame", "position", "rotation", "q", "phase"}
    assert described["phase"] == "flight"
