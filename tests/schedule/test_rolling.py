"""Soles that roll: phases are cut where heels and toes come and go, and nothing else changes."""

import numpy as np
import pytest

from trajopt.errors import InputError
from trajopt.robot import edge_contacts
from trajopt.schedule import Gait, Phase, Schedule, rolled
from trajopt.terrain import Patch, Surface

FEET = ("left", "right")
HEEL, TOE = 1 / 6, 1 / 4
WALK = Gait(name="walk", duty=0.6, offsets={"left": 0.0, "right": 0.5})
MIRROR = {"left": "right", "right": "left"}


def corners(foot: str, *edges: str) -> tuple[str, ...]:
    return tuple(name for edge in edges for name in edge_contacts(foot, edge))


def roll(schedule: Schedule, **changed) -> Schedule:
    return rolled(schedule, **({"soles": FEET, "heel": HEEL, "toe": TOE} | changed))


def steps(**settings) -> Schedule:
    both = ("left", "right")
    phases = (("stand", both), ("swing", ("left",)), ("double", both), ("other", ("right",)), ("rest", both))
    return Schedule(tuple(Phase(name=name, duration=0.5, contacts=feet, **settings) for name, feet in phases))


def stands(schedule: Schedule, corner: str) -> list[tuple[float, float]]:
    """Begin and end of every stance of a contact, s."""
    ends = np.cumsum([0.0, *(phase.duration for phase in schedule.phases)])
    spans: list[tuple[float, float]] = []
    for phase, begin, end in zip(schedule.phases, ends, ends[1:], strict=False):
        if corner in phase.contacts:
            joined = spans.pop()[0] if spans and abs(spans[-1][1] - begin) < 1e-12 else begin
            spans.append((joined, end))
    return spans


def test_half_a_cycle_rolls_over_heel_flat_and_toe():
    half = roll(Schedule(WALK.half_cycle(1.0, MIRROR)), next_name=MIRROR)
    assert [(phase.name, phase.contacts) for phase in half.phases] == [
        ("double_1", (*corners("left", "heel"), *corners("right", "toe"))),
        ("single_1a", corners("left", "heel", "toe")),
        ("single_1b", corners("left", "toe")),
    ]
    np.testing.assert_allclose([phase.duration for phase in half.phases], [0.1, 0.35, 0.05])


def test_a_whole_cycle_is_half_of_one_and_its_mirror_image():
    half = roll(Schedule(WALK.half_cycle(1.0, MIRROR)), next_name=MIRROR).phases
    whole = roll(Schedule(WALK.phases(1.0)), next_name={foot: foot for foot in FEET}).phases
    assert len(whole) == 2 * len(half)
    swapped = str.maketrans({"l": "r", "r": "l"})
    for one, two, image in zip(half, whole, whole[len(half) :], strict=False):
        assert one.contacts == two.contacts
        assert one.duration == pytest.approx(two.duration) == pytest.approx(image.duration)
        feet = {name.split("_")[0][0].translate(swapped) + name.split("_")[1] for name in one.contacts}
        assert feet == {name.split("_")[0][0] + name.split("_")[1] for name in image.contacts}


def test_stances_at_the_ends_are_flat_there_and_heels_stand_before_toes():
    flat, schedule = steps(), roll(steps())
    assert schedule.duration == pytest.approx(flat.duration)
    # Left stands from the start for 1.5 s, right lands at 1 s and stays.
    np.testing.assert_allclose(stands(schedule, "left_heel_left"), [(0, 1.5 * (1 - TOE)), (2, 2.5)])
    np.testing.assert_allclose(stands(schedule, "left_toe_left"), [(0, 1.5), (2 + 0.5 * HEEL, 2.5)])
    np.testing.assert_allclose(stands(schedule, "right_heel_left"), [(0, 0.5 * (1 - TOE)), (1, 2.5)])
    np.testing.assert_allclose(stands(schedule, "right_toe_left"), [(0, 0.5), (1 + 1.5 * HEEL, 2.5)])


def test_without_time_on_heel_or_toe_no_phase_is_cut():
    flat, schedule = steps(), roll(steps(), heel=0.0, toe=0.0)
    assert schedule.names == flat.names
    for before, after in zip(flat.phases, schedule.phases, strict=True):
        assert after.contacts == tuple(c for foot in before.contacts for c in corners(foot, "heel", "toe"))
        assert after.duration == before.duration


def test_parts_of_a_phase_share_its_bounds_its_impact_and_what_soles_touch():
    floor = Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), friction=0.4)
    face = Patch.rectangle(centre=(0.5, 0.0, 0.0), size=(2.0, 1.0), name="tile")
    phases = (
        Phase(name="air", duration=0.2),
        Phase(
            name="land",
            duration=1.0,
            contacts=("left", "hand"),
            duration_bounds=(0.5, 2.0),
            impact=True,
            surfaces={"hand": floor},
            patches={"left": face},
        ),
        Phase(name="fly", duration=0.2),
    )
    _, heel, flat, toe, _ = roll(Schedule(phases), soles=("left",)).phases
    assert [heel.impact, flat.impact, toe.impact] == [True, False, False]
    np.testing.assert_allclose(heel.duration_bounds, [0.5 * HEEL, 2.0 * HEEL])
    np.testing.assert_allclose(flat.duration + heel.duration + toe.duration, 1.0)
    for part in (heel, flat, toe):
        assert dict(part.surfaces) == {"hand": floor}
        assert part.patches == {name: face for name in part.contacts if name != "hand"}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"heel": 0.6, "toe": 0.4}, "heel and toe are 0.6 and 0.4.*flat"),
        ({"heel": -0.1}, "heel and toe are -0.1"),
        ({"soles": ("hand",)}, "hand are in no phase"),
        ({"soles": ()}, "none are in no phase"),
        ({"heel": 0.002}, "off phase 'double'.*allowed: at least"),
        ({"heel": float("nan")}, "heel"),
    ],
)
def test_wrong_use_gives_one_clear_line(changed, message):
    with pytest.raises(InputError, match=message) as raised:
        roll(steps(), **changed)
    assert "\n" not in str(raised.value)


def test_footholds_of_soles_that_roll_are_refused():
    placed = Phase(name="land", duration=1.0, contacts=("left",), footholds={"left": np.zeros(3)})
    with pytest.raises(InputError, match="sole 'left' that rolls has a foothold in phase 'land'"):
        roll(Schedule((Phase(name="air", duration=0.2), placed)))
