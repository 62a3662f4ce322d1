"""The clock of a gait: modes, swings, changes, contacts that are early."""

import math

import pytest

from trajopt.control.mpc.clock import MOST_STRETCH, SETTLE, GaitClock, Stretch
from trajopt.schedule.gaits import QUADRUPED

FEET = ("front_left", "front_right", "hind_left", "hind_right")
PERIOD = 0.5


def clock_of(*gaits: str) -> GaitClock:
    return GaitClock(FEET, {name: (QUADRUPED[name], PERIOD) for name in gaits})


def touching(clock: GaitClock) -> dict[str, bool]:
    """Contacts touch as they are planned, and land on time."""
    return dict.fromkeys(clock.contacts, clock.remaining < 1e-9)


def test_a_stance_lasts_until_a_gait_is_asked_for() -> None:
    clock = clock_of("trot")
    (mode,) = clock.horizon(0.25)
    assert mode.contacts == FEET
    assert mode.duration == 0.25
    clock.advance(100.0, touching(clock))
    assert math.isinf(clock.remaining)
    clock.request("trot")
    assert clock.remaining == pytest.approx(SETTLE * PERIOD)
    modes = clock.horizon(0.25)
    assert [len(mode.contacts) for mode in modes] == [4, 2]
    assert clock.landing() == ()


def test_a_trot_alternates_diagonal_pairs_and_knows_its_swings() -> None:
    clock = clock_of("trot")
    clock.request("trot")
    clock.skip()
    first, second = clock.horizon(0.25)
    assert set(first.contacts) | set(second.contacts) == set(FEET)
    assert not set(first.contacts) & set(second.contacts)
    clock.advance(0.1, touching(clock))
    assert clock.remaining == pytest.approx(0.15)
    swings = clock.swings()
    for name in second.contacts:
        assert (swings[name][0].begin, swings[name][0].end) == pytest.approx((-0.1, 0.15))
        assert swings[name][1].begin == pytest.approx(0.4)
    for name in first.contacts:
        assert swings[name][0].begin == pytest.approx(0.15)
    assert set(clock.landing()) == set(second.contacts)


def test_time_that_passes_is_kept_over_many_modes() -> None:
    clock = clock_of("walk")
    clock.request("walk")
    clock.skip()
    for _ in range(1000):
        clock.advance(0.01, dict.fromkeys(FEET, False))
    cycle = sum(mode.duration for mode in clock.cycle_of("walk"))
    assert cycle == pytest.approx(PERIOD)
    begun = sum(mode.duration for mode in clock.cycle_of("walk")) * 20 - 10.0
    assert begun == pytest.approx(0.0, abs=1e-9)
    assert 0 < clock.remaining <= clock.whole + 1e-9


def test_early_contacts_end_a_mode_in_its_last_third_only() -> None:
    clock = clock_of("trot")
    clock.request("trot")
    clock.skip()
    down = dict.fromkeys(FEET, True)
    before = clock.horizon(0.25)[0].contacts
    clock.advance(0.1, down)
    assert clock.horizon(0.25)[0].contacts == before
    clock.advance(0.1, down)
    assert set(clock.horizon(0.25)[0].contacts) == set(FEET) - set(before)
    assert clock.remaining == pytest.approx(0.25)


def test_gaits_change_through_a_stance_after_the_present_mode() -> None:
    clock = clock_of("trot", "pace")
    clock.request("trot")
    clock.skip()
    clock.advance(0.1, touching(clock))
    clock.request("pace")
    assert [len(mode.contacts) for mode in clock.horizon(0.25)] == [2, 4, 2]
    clock.request("stand")
    modes = clock.horizon(0.25)
    assert [len(mode.contacts) for mode in modes] == [2, 4]
    clock.skip()
    assert math.isinf(clock.remaining)


def test_a_stance_on_the_way_to_a_gait_leads_to_another_gait_or_stays() -> None:
    clock = clock_of("trot", "pace")
    clock.request("trot")
    clock.advance(0.01, touching(clock))
    before = clock.remaining
    clock.request("pace")
    assert clock.remaining == before
    assert [len(mode.contacts) for mode in clock.horizon(0.25)] == [4, 2]
    clock.request("stand")
    assert math.isinf(clock.remaining)
    assert len(clock.horizon(0.25)) == 1


def test_a_copy_goes_on_apart() -> None:
    clock = clock_of("trot")
    clock.request("trot")
    twin = clock.copy()
    twin.skip()
    twin.advance(0.1, dict.fromkeys(FEET, False))
    assert clock.remaining == pytest.approx(SETTLE * PERIOD)
    assert clock.swings()[FEET[0]] != twin.swings()[FEET[0]]


def test_a_mode_is_stretched_within_bounds_and_the_next_is_as_the_gait_says() -> None:
    clock = clock_of("trot")
    clock.request("trot")
    clock.skip()
    clock.advance(0.05, dict.fromkeys(FEET, False))
    clock.stretch(Stretch(clock.number + 1, 0.1), 1.0)  # of another mode
    assert clock.remaining == pytest.approx(0.2)
    clock.stretch(Stretch(clock.number, 0.04), 0.5)
    assert clock.remaining == pytest.approx(0.22)
    clock.stretch(Stretch(clock.number, 9.0), 1.0)
    assert clock.remaining == pytest.approx(0.2 + MOST_STRETCH * 0.25)
    clock.stretch(Stretch(clock.number, -9.0), 1.0)
    assert clock.remaining == pytest.approx(0.2 - MOST_STRETCH * 0.25)
    clock.advance(clock.remaining, dict.fromkeys(FEET, False))
    assert clock.remaining == pytest.approx(0.25)
    standing = clock_of("trot")
    standing.stretch(Stretch(standing.number, -1.0), 1.0)
    assert math.isinf(standing.remaining)
