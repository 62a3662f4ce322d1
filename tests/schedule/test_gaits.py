"""Gaits as data and as schedules, soles that roll, and moments in words."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.driven_robots import HEXAPOD, around, walker
from tests.support.models import random_state
from tests.support.refusals import refusals, refused_calls
from trajopt import FlatGround, InputError, Moment, Phase, Schedule, end_of, middle_of, start_of
from trajopt.robot import biped_legs, edge_contacts, feet_in_base, quadruped_legs
from trajopt.robot.legs import feet_by_side
from trajopt.schedule import BIPED, END, QUADRUPED, Gait, Target, gait_of, rolled
from trajopt.schedule.gaits import HOPPER, LEAST_SHARE, gait_names
from trajopt.terms import swing_arcs
from trajopt.terrain import Patch, Surface
from trajopt_library import robots

PERIOD = 0.8
# Durations are sums and products of a few decimal fractions.
ROUNDING = 1e-12
MIRROR = {
    "front_left": "front_right",
    "front_right": "front_left",
    "hind_left": "hind_right",
    "hind_right": "hind_left",
}
EVERY = [*QUADRUPED.values(), *BIPED.values(), *HOPPER.values()]


def _stance_time(phases: tuple[Phase, ...], foot: str) -> float:
    return sum(phase.duration for phase in phases if foot in phase.contacts)


@pytest.mark.parametrize("gait", EVERY, ids=lambda gait: gait.name)
def test_phases_hold_every_foot_for_its_duty_factor(gait: Gait) -> None:
    phases = gait.phases(PERIOD)
    assert_allclose(sum(phase.duration for phase in phases), PERIOD, rtol=ROUNDING)
    for foot in gait.feet:
        assert_allclose(_stance_time(phases, foot), gait.duty_of(foot) * PERIOD, rtol=ROUNDING)


@pytest.mark.parametrize("gait", EVERY, ids=lambda gait: gait.name)
def test_contact_sets_are_those_of_the_duty_and_offset_of_every_foot(gait: Gait) -> None:
    phases, start = gait.phases(PERIOD), min(gait.offsets.values())
    ends = np.cumsum([phase.duration for phase in phases])
    for time in (np.arange(200) + 0.37) / 200:
        phase = phases[int(np.searchsorted(ends, time * PERIOD))]
        standing = {
            foot for foot in gait.feet if (time + start - gait.offsets[foot]) % 1.0 < gait.duty_of(foot)
        }
        assert set(phase.contacts) == standing


@pytest.mark.parametrize("gait", EVERY, ids=lambda gait: gait.name)
def test_a_cycle_begins_with_a_touchdown_and_neighbours_differ(gait: Gait) -> None:
    phases = gait.phases(PERIOD, cycles=2)
    assert set(phases[0].contacts) - set(phases[-1].contacts)
    for before, after in pairwise(phases):
        assert set(before.contacts) != set(after.contacts)
    names = [phase.name for phase in phases]
    assert len(set(names)) == len(names)


def test_named_footfalls_follow_their_definitions() -> None:
    def order(name: str) -> list[str]:
        return sorted(QUADRUPED[name].feet, key=lambda foot: QUADRUPED[name].offsets[foot])

    assert order("walk") == ["hind_left", "front_left", "hind_right", "front_right"]
    assert order("gallop") == ["hind_left", "hind_right", "front_left", "front_right"]
    assert order("rotary-gallop") == ["hind_left", "hind_right", "front_right", "front_left"]
    for pair in ({"front_left", "hind_right"}, {"front_right", "hind_left"}):
        assert pair in [set(phase.contacts) for phase in QUADRUPED["trot"].phases(PERIOD)]
    for pair in ({"front_left", "hind_left"}, {"front_right", "hind_right"}):
        assert pair in [set(phase.contacts) for phase in QUADRUPED["pace"].phases(PERIOD)]
    assert [phase.name for phase in QUADRUPED["pronk"].phases(PERIOD)] == ["quadruple_1", "flight_1"]
    for name in ("trot", "pace", "walk", "amble"):
        assert not any(set(phase.contacts) == set(MIRROR) for phase in QUADRUPED[name].phases(PERIOD))
    for name, flights in (("trot", 0), ("flying-trot", 2), ("bound", 2), ("gallop", 2), ("canter", 1)):
        assert sum(not phase.contacts for phase in QUADRUPED[name].phases(PERIOD)) == flights


def test_events_that_differ_by_rounding_are_one() -> None:
    gait = Gait(name="sum", duty={"a": 0.1 + 0.2, "b": 0.7}, offsets={"a": 0.0, "b": 0.3})
    assert 0.1 + 0.2 != 0.3
    assert [phase.contacts for phase in gait.phases(PERIOD)] == [("a",), ("b",)]


@pytest.mark.parametrize("shift", [0.1, 1 / 3, 0.77])
def test_a_shift_of_all_offsets_changes_nothing_but_the_clock(shift: float) -> None:
    gait = QUADRUPED["walk"]
    later = replace(gait, offsets={foot: offset + shift for foot, offset in gait.offsets.items()})
    first = gait.feet[2]
    for own, other in zip(gait.phases(PERIOD, start=first), later.phases(PERIOD, start=first), strict=True):
        assert own.contacts == other.contacts
        assert_allclose(own.duration, other.duration, atol=ROUNDING)


@pytest.mark.parametrize("name", ["trot", "pace", "walk", "amble", "flying-trot"])
def test_the_second_half_of_a_symmetric_gait_mirrors_the_first(name: str) -> None:
    gait = QUADRUPED[name]
    whole, half = gait.phases(PERIOD), gait.half_cycle(PERIOD, MIRROR)
    assert len(whole) == 2 * len(half)
    for i, phase in enumerate(half):
        assert phase.contacts == whole[i].contacts
        assert {MIRROR[foot] for foot in phase.contacts} == set(whole[len(half) + i].contacts)
        assert_allclose(phase.duration, whole[len(half) + i].duration, atol=ROUNDING)


def test_asymmetric_gaits_have_no_half() -> None:
    for name in ("bound", "pronk", "gallop", "rotary-gallop", "canter"):
        assert not QUADRUPED[name].is_symmetric(MIRROR)
        with pytest.raises(InputError, match="mirror image"):
            QUADRUPED[name].half_cycle(PERIOD, MIRROR)


def test_any_number_of_feet_has_gaits() -> None:
    tripod = Gait(name="tripod", duty=0.5, offsets={f"leg{i}": 0.5 * (i % 2) for i in range(6)})
    assert [len(phase.contacts) for phase in tripod.phases(PERIOD)] == [3, 3]
    wave = Gait(name="wave", duty=5 / 6, offsets={f"leg{i}": i / 6 for i in range(6)})
    assert [phase.name for phase in wave.phases(PERIOD)] == [f"support5_{i}" for i in range(1, 7)]
    dragged = Gait(name="dragged", duty={"a": 1, "b": 0.5}, offsets={"a": 0.2, "b": 0.7})
    assert [phase.contacts for phase in dragged.phases(PERIOD)] == [("a", "b"), ("a",)]


WAVES = {
    3: ("pronk", "wave"),
    5: ("alternating", "ripple", "wave"),
    6: ("tripod", "ripple", "wave"),
    8: ("alternating", "ripple", "wave"),
}


@pytest.mark.parametrize("count", WAVES)
def test_feet_of_any_number_step_from_hind_to_front(count: int) -> None:
    robot = walker(around(count))
    left, right = feet_by_side(robot)
    assert len(left) - len(right) == count % 2
    assert gait_names(robot) == WAVES[count]
    for name in set(WAVES[count]) - {"pronk"}:
        gait = gait_of(robot, name)
        swing = 1 - gait.duty_of(left[0])
        for behind, before in (*pairwise(left), *pairwise(right)):
            assert (gait.offsets[before] - gait.offsets[behind] - swing) % 1 == pytest.approx(0, abs=ROUNDING)
        air = [(count - len(support.feet), support.part) for support in gait.supports()]
        assert sum(feet * part for feet, part in air) == pytest.approx(count * swing)
        if name == "wave":
            assert {feet for feet, _ in air} == {1}


def test_a_tripod_has_the_outer_feet_of_a_side_and_the_middle_one_of_the_other() -> None:
    robot = walker(HEXAPOD)
    left, right = feet_by_side(robot)
    assert (left, right) == (("leg_4", "leg_2", "leg_0"), ("leg_5", "leg_3", "leg_1"))
    stances = [set(support.feet) for support in gait_of(robot, "tripod").supports()]
    assert stances == [{left[0], left[2], right[1]}, {right[0], right[2], left[1]}]
    with pytest.raises(InputError, match="gait 'trot' is unknown"):
        gait_of(robot, "trot")


def test_free_durations_are_bounded_by_parts_of_the_nominal_ones() -> None:
    for phase in QUADRUPED["walk"].phases(PERIOD, duration_bounds=(0.5, 2.0)):
        assert_allclose(phase.duration_bounds, [0.5 * phase.duration, 2.0 * phase.duration])


def test_gaits_that_are_none_are_refused() -> None:
    for duty, offsets in (
        (0.5, {}),
        (0.0, {"a": 0.0}),
        (1.2, {"a": 0.0}),
        (float("nan"), {"a": 0.0}),
        (0.5, {"a": float("inf")}),
        (1.0, {"a": 0.0, "b": 0.5}),
        ({"a": 0.5}, {"a": 0.0, "b": 0.5}),
        (True, {"a": 0.0}),
    ):
        with pytest.raises(InputError, match="allowed"):
            Gait(name="bad", duty=duty, offsets=offsets)
    trot = QUADRUPED["trot"]
    brief = trot.with_duty(0.5 + LEAST_SHARE / 4)
    for call in (
        lambda: brief.phases(PERIOD),
        lambda: trot.phases(0.0),
        lambda: trot.phases(PERIOD, cycles=0),
        lambda: trot.phases(PERIOD, start="tail"),
        lambda: trot.phases(PERIOD, duration_bounds=(1.1, 1.2)),
        lambda: trot.on({"front_left": "a"}),
        lambda: trot.on(dict.fromkeys(trot.feet, "a")),
        lambda: trot.half_cycle(PERIOD, {}),
        lambda: gait_of(robots.load("solo12"), "moonwalk"),
        lambda: gait_of(robots.load("ur5"), "trot"),
    ):
        with pytest.raises(InputError, match="allowed"):
            call()


@pytest.mark.parametrize("name", ["solo12", "go2", "anymal_c", "hyq"])
def test_legs_of_quadrupeds_are_found_in_any_pose_of_the_base(name: str) -> None:
    robot = robots.load(name)
    legs = quadruped_legs(robot)
    feet = feet_in_base(robot)
    assert feet[legs.front_left][0] > 0 > feet[legs.hind_left][0]
    assert feet[legs.front_left][1] > 0 > feet[legs.front_right][1]
    assert feet[legs.hind_left][1] > 0 > feet[legs.hind_right][1]
    shuffled = replace(robot, contacts=robot.contacts[::-1])
    assert quadruped_legs(shuffled) == legs
    moved = robot.reference.copy()
    moved[:7] = random_state(robot.model, 3)[0][:7]
    moved[3:7] = [0.0, 0.0, np.sin(1.2), np.cos(1.2)]
    for contact, position in feet_in_base(robot, moved).items():
        assert_allclose(position, feet[contact], atol=ROUNDING * 1e3)


def test_legs_are_found_by_geometry_whatever_their_names() -> None:
    robot = robots.load("solo12")
    legs = quadruped_legs(robot)
    swapped = {legs.front_left: "hind right", legs.hind_right: "front left"}
    renamed = replace(
        robot, contacts=tuple(replace(c, name=swapped.get(c.name, c.name)) for c in robot.contacts)
    )
    assert quadruped_legs(renamed).front_left == "hind right"
    assert legs.mirror[legs.hind_left] == legs.hind_right


def test_feet_of_bipeds_exclude_hands() -> None:
    talos = robots.load("talos")
    assert len(talos.contacts) > 2
    left, right = biped_legs(talos)
    feet = feet_in_base(talos)
    assert set(feet) == {left, right}
    assert feet[left][1] > 0 > feet[right][1]
    assert gait_of(talos, "walk").offsets[right] == 0.5


def test_robots_of_other_kinds_have_no_such_legs() -> None:
    for finder, name in (
        (quadruped_legs, "talos"),
        (biped_legs, "solo12"),
        (quadruped_legs, "ur5"),
        (biped_legs, "hopper"),
    ):
        with pytest.raises(InputError, match="allowed"):
            finder(robots.load(name))


def test_feet_on_one_line_are_refused() -> None:
    robot = robots.load("solo12")
    line = replace(robot, reference=robot.reference, contacts=(robot.contacts[0],) * 1 + robot.contacts[1:2])
    with pytest.raises(InputError, match="4 feet"):
        quadruped_legs(line)


def _schedule(gait: Gait) -> Schedule:
    return Schedule(gait.phases(PERIOD))


@pytest.mark.parametrize("gait", EVERY, ids=lambda gait: gait.name)
def test_parts_of_swings_are_those_of_the_gait(gait: Gait) -> None:
    """Against the closed form: the swing of a foot is from offset + duty to offset + 1."""
    schedule = _schedule(gait)
    inside, _ = swing_arcs(
        schedule, gait.feet, height=0.1, terrain=FlatGround(), next_name={foot: foot for foot in gait.feet}
    )
    begin, start = 0.0, min(gait.offsets.values())
    for phase in schedule.phases:
        parts = {part.contact: part for part in inside.parts[phase.name]}
        assert set(parts) == set(gait.feet) - set(phase.contacts)
        for foot, part in parts.items():
            for time, fraction in ((0.001, part.begin), (phase.duration / PERIOD - 0.001, part.end)):
                since = (begin + start + time - gait.offsets[foot]) % 1.0 - gait.duty_of(foot)
                assert_allclose(fraction, since / (1 - gait.duty_of(foot)), atol=0.01)
        begin += phase.duration / PERIOD


def test_swings_of_half_a_cycle_go_on_with_the_other_side() -> None:
    gait = QUADRUPED["walk"]
    half = Schedule(gait.half_cycle(PERIOD, MIRROR))
    whole, _ = swing_arcs(
        _schedule(gait), gait.feet, height=0.1, terrain=FlatGround(), next_name={f: f for f in gait.feet}
    )
    halved, _ = swing_arcs(half, gait.feet, height=0.1, terrain=FlatGround(), next_name=MIRROR)
    for phase in half.phases:
        for own, other in zip(halved.parts[phase.name], whole.parts[phase.name], strict=True):
            assert own.contact == other.contact
            assert_allclose([own.begin, own.end], [other.begin, other.end], atol=ROUNDING)


FEET = ("left", "right")
HEEL, TOE = 1 / 6, 1 / 4
WALK = Gait(name="walk", duty=0.6, offsets={"left": 0.0, "right": 0.5})
OTHER_FOOT = {"left": "right", "right": "left"}


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
    half = roll(Schedule(WALK.half_cycle(1.0, OTHER_FOOT)), next_name=OTHER_FOOT)
    assert [(phase.name, phase.contacts) for phase in half.phases] == [
        ("double_1", (*corners("left", "heel"), *corners("right", "toe"))),
        ("single_1a", corners("left", "heel", "toe")),
        ("single_1b", corners("left", "toe")),
    ]
    np.testing.assert_allclose([phase.duration for phase in half.phases], [0.1, 0.35, 0.05])


def test_a_whole_cycle_is_half_of_one_and_its_mirror_image():
    half = roll(Schedule(WALK.half_cycle(1.0, OTHER_FOOT)), next_name=OTHER_FOOT).phases
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


test_wrong_use_gives_one_clear_line = refusals(
    lambda changed: roll(steps(), **changed),
    ({"heel": 0.6, "toe": 0.4}, "heel and toe are 0.6 and 0.4.*flat"),
    ({"heel": -0.1}, "heel and toe are -0.1"),
    ({"soles": ("hand",)}, "hand are in no phase"),
    ({"soles": ()}, "none are in no phase"),
    ({"heel": 0.002}, "off phase 'double'.*allowed: at least"),
    ({"heel": float("nan")}, "heel"),
)


def test_footholds_of_soles_that_roll_are_refused():
    placed = Phase(name="land", duration=1.0, contacts=("left",), footholds={"left": np.zeros(3)})
    with pytest.raises(InputError, match="sole 'left' that rolls has a foothold in phase 'land'"):
        roll(Schedule((Phase(name="air", duration=0.2), placed)))


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


test_swings_below_the_ground_and_moments_of_the_whole_motion_are_refused = refused_calls(
    (lambda: swing_arcs(_schedule(BIPED["run"]), ("left",), height=-0.1, terrain=FlatGround()), "allowed"),
    (lambda: Moment(fraction=0.5), "of the motion; allowed: 0 to 1 of a phase"),
)


@pytest.mark.parametrize("at", [END, start_of("flight"), middle_of("flight"), end_of("flight")])
def test_targets_keep_their_moment_in_a_file(at):
    described = Target(frame="foot", position=(0.0, 0.0, 1.0), at=at).describe()
    assert Target.from_description(described).at == at


def test_a_waypoint_at_a_start_is_described_as_before():
    described = Target(frame="foot", position=(0.0, 0.0, 1.0), at=start_of("flight")).describe()
    assert set(described) == {"frame", "position", "rotation", "q", "phase"}
    assert described["phase"] == "flight"
