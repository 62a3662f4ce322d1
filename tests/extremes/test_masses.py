"""Masses and gravity at extremes, steps and horizons, every scheme and degree, and numbers that are none."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.extremes.changed_robots import longer, made, robot_file, solo, ur5, with_gravity
from tests.extremes.moves import reach, stance, stand, turn_over
from tests.extremes.outcomes import Failed, Refused, Solved, assert_outcome
from tests.support.problems import REACH
from tests.support.problems import reach as arm_reach
from trajopt import FlatGround, InputError, Phase, Problem, Schedule, Solution, middle_of, terms
from trajopt.solvers.status import Status
from trajopt.solving.solving import prepare
from trajopt.terrain import Surface
from trajopt_library import problems, robots

# Motions of similar robots agree up to rounding, which iterations of a solver multiply.
SIMILAR = 1e-6
ARM, HOP, JUMP = "arm-reach", "hopper-hop", "quadruped-jump-up"
# Family, its robot, kind, intervals, open loop, feet (m).
MOTIONS = {
    ARM: ("ur5", "arm", 10, 0.05, None),
    HOP: ("hopper", "hopper", 40, 0.1, None),
    JUMP: ("solo12", "quadruped", 15, 2.0, 0.05),
}
SHORT = [ARM, HOP, pytest.param(JUMP, marks=pytest.mark.slow)]


@lru_cache
def on_its_own_robot(name: str) -> Solution:
    """The solution on the robot as it is."""
    robot, _, intervals, open_loop, coarse = MOTIONS[name]
    make = partial(problems.load, name, robot=robot)
    return assert_outcome(Solved(open_loop=open_loop, coarse=coarse), make, intervals=intervals)


@pytest.mark.long
@pytest.mark.parametrize("mass", [1e-3, 1e3])
@pytest.mark.parametrize("name", SHORT)
def test_motion_of_a_similar_robot_is_the_same_and_forces_scale_with_its_mass(name, mass, tmp_path):
    robot, kind, intervals, open_loop, coarse = MOTIONS[name]
    path = robot_file(tmp_path, kind, f"similar(own({robot!r}), mass={mass})")
    found = assert_outcome(
        Solved(open_loop=open_loop, coarse=coarse), partial(made, name, path), intervals=intervals
    )
    own = on_its_own_robot(name)
    assert_allclose(found.t, own.t, rtol=SIMILAR)
    assert_allclose(found.q, own.q, atol=SIMILAR)
    assert_allclose(found.tau / mass, own.tau, atol=SIMILAR * np.abs(own.tau).max())
    assert_allclose(found.f / mass, own.f, atol=SIMILAR * max(np.abs(own.f).max(initial=0.0), 1.0))
    assert found.statistics.iterations == own.statistics.iterations


@pytest.mark.parametrize(("length", "gravity"), [(0.1, 1.0), (10.0, 1.0), (1.0, 2.0)])
def test_arm_of_another_size_or_gravity_moves_alike(length, gravity, tmp_path):
    path = robot_file(tmp_path, "arm", f"similar(own('ur5'), length={length}, gravity={gravity})")
    found, own = (
        assert_outcome(Solved(open_loop=0.05), partial(made, ARM, path), intervals=10),
        on_its_own_robot(ARM),
    )
    assert_allclose(found.t, own.t * np.sqrt(length / gravity), rtol=SIMILAR)
    assert_allclose(found.q, longer(robots.load("ur5"), own.q, length), atol=SIMILAR)
    torque = own.tau * length * gravity
    assert_allclose(found.tau, torque, atol=SIMILAR * np.abs(torque).max())


LIGHT_WRIST = "with_inertias(own('ur5'), lambda n, i: heavier(i, 1e-4 if 'wrist' in n else 1.0))"
POINT_MASSES = "with_inertias(own('{}'), lambda n, i: pin.Inertia(i.mass, i.lever, 1e-12 * np.eye(3)))"
LIGHT_SHANKS = "with_inertias(own('solo12'), lambda n, i: heavier(i, 1e-3 if 'KFE' in n else 1.0))"
HEAVY_BASE = "with_inertias(own('solo12'), lambda n, i: heavier(i, 320.0 if 'root' in n else 1.0))"


@pytest.mark.parametrize(
    ("robot", "open_loop"),
    [(LIGHT_WRIST, 0.05), (POINT_MASSES.format("ur5"), 0.1)],
    ids=["mass ratio 4e5", "inertias 1e-12"],
)
def test_arm_with_extreme_links_reaches(robot, open_loop, tmp_path):
    path = robot_file(tmp_path, "arm", robot)
    assert_outcome(Solved(open_loop=open_loop), partial(made, ARM, path), intervals=10)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "open_loop", "intervals"),
    [(LIGHT_SHANKS, 2.0, 15), (HEAVY_BASE, 4.0, 15), (POINT_MASSES.format("solo12"), 10.0, 30)],
    ids=["mass ratio 3e4", "base 1e4 times a shank", "inertias 1e-12"],
)
def test_quadruped_with_extreme_links_jumps(robot, open_loop, intervals, tmp_path):
    path = robot_file(tmp_path, "quadruped", robot)
    assert_outcome(Solved(open_loop=open_loop, coarse=0.1), partial(made, JUMP, path), intervals=intervals)


@pytest.mark.long
def test_tool_too_heavy_to_lift_is_infeasible_by_its_torques(tmp_path):
    heavy = "with_inertias(own('ur5'), lambda n, i: heavier(i, 1e4 if n == 'wrist_3_joint' else 1.0))"
    path = robot_file(tmp_path, "arm", heavy)
    assert_outcome(Failed(Status.INFEASIBLE, block="torque_limits"), partial(made, ARM, path), intervals=10)


MASSLESS_WRIST = "with_inertias(own('ur5'), lambda n, i: pin.Inertia.Zero() if n == 'wrist_3_joint' else i)"
MASSLESS_SHANKS = "with_inertias(own('solo12'), lambda n, i: pin.Inertia.Zero() if 'KFE' in n else i)"


@pytest.mark.parametrize(
    ("name", "robot"),
    [(ARM, MASSLESS_WRIST), pytest.param(JUMP, MASSLESS_SHANKS, marks=pytest.mark.slow)],
    ids=["wrist", "shanks"],
)
def test_joint_that_moves_no_mass_is_refused_by_name(name, robot, tmp_path):
    """Torques do not determine its motion, and no mesh is fine enough for the open loop."""
    _, kind, intervals, _, _ = MOTIONS[name]
    path = robot_file(tmp_path, kind, robot)
    refusal = Refused("no inertia is moved by joint '.*', so that torques do not determine how it moves")
    assert_outcome(refusal, partial(made, name, path), intervals=intervals)


OF_UR5 = "with_inertias(own('ur5'), lambda n, i: {})"
IMPOSSIBLE = {
    "no mass": (OF_UR5.format("pin.Inertia.Zero()"), "has no mass"),
    "negative mass": (
        OF_UR5.format("pin.Inertia(-i.mass, i.lever, i.inertia)"),
        "the mass moved by joint '.*' of 'ur5' is -",
    ),
    "mass NaN": (
        OF_UR5.format("pin.Inertia(np.nan, i.lever, i.inertia)"),
        "the mass moved by joint '.*' of 'ur5' is nan",
    ),
    "gravity NaN": ("with_gravity(own('ur5'), np.nan)", "gravity of robot 'ur5' is .*allowed: finite"),
    "armature negative": ("with_armature(own('ur5'), -1.0)", "armature of robot 'ur5' is negative"),
}


@pytest.mark.parametrize(("robot", "cause"), IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_inertia_that_no_body_has_is_refused(robot, cause, tmp_path):
    path = robot_file(tmp_path, "arm", robot)
    assert_outcome(Refused(cause), partial(made, ARM, path))


# Momenta over mass times length (squared) over duration, and carried weight: what collocation leaves.
MOMENTUM, CARRIED = 5e-3, 1e-3
# A turn of the base and the time for it.
YAW, DURATION = 0.2, 1.0


@pytest.mark.parametrize("gravity", [0.0, 1e-3, 1.62, 20.0])
def test_arm_reaches_in_any_gravity(gravity, tmp_path):
    path = robot_file(tmp_path, "arm", f"with_gravity(own('ur5'), {gravity})")
    assert_outcome(
        Solved(open_loop=4.0 if gravity > 9.81 else 1e-2), partial(made, "arm-reach", path), intervals=10
    )


@pytest.mark.long
@pytest.mark.parametrize("gravity", [0.0, 1e-3, 1.62, 20.0])
def test_quadruped_stands_in_any_gravity(gravity):
    solution = assert_outcome(
        Solved(open_loop=1e-3), lambda: stand(with_gravity(robots.load("solo12"), gravity))
    )
    carried = solution.f[solution.collocation][..., 2].sum(axis=1)
    weight = robots.load("solo12").mass * gravity
    assert_allclose(carried.mean(), weight, atol=CARRIED * max(weight, 1.0))  # from rest to rest


@pytest.mark.long
def test_floating_quadruped_turns_by_its_legs_alone():
    """No gravity, no contact, no momentum: it ends turned all the same, at rest where it was."""
    robot = with_gravity(robots.load("solo12"), 0.0)
    make = partial(turn_over, robot, yaw=YAW, duration=DURATION)
    solution = assert_outcome(Solved(open_loop=5e-2), make, intervals=20)
    model, data = solution.model, solution.model.createData()
    unit = robot.mass * robot.length / DURATION
    for q, v in zip(solution.q, solution.v, strict=True):
        momentum = pin.computeCentroidalMomentum(model, data, q, v)
        assert np.abs(momentum.linear).max() <= MOMENTUM * unit
        assert np.abs(momentum.angular).max() <= MOMENTUM * unit * robot.length
    turned = pin.rpy.matrixToRpy(pin.Quaternion(solution.q[-1, 3:7]).toRotationMatrix())
    assert_allclose(turned, [0.0, 0.0, YAW], atol=1e-6)


@pytest.mark.long
def test_without_gravity_nothing_that_stands_stops_its_rise(tmp_path):
    path = robot_file(tmp_path, "quadruped", "with_gravity(own('solo12'), 0.0)")
    expected = Failed(Status.INFEASIBLE, block="base_dynamics")
    assert_outcome(expected, partial(made, "quadruped-stand-up", path), intervals=15)


@pytest.mark.parametrize("name", ["quadruped-jump-up", "quadruped-jump-forward"])
def test_jump_without_gravity_is_refused(name, tmp_path):
    path = robot_file(tmp_path, "quadruped", "with_gravity(own('solo12'), 0.0)")
    assert_outcome(Refused("is without gravity"), partial(made, name, path))


@pytest.mark.slow
@pytest.mark.parametrize("gravity", [1e-3, 1.62, 20.0])
def test_quadruped_jumps_in_any_gravity(gravity, tmp_path):
    path = robot_file(tmp_path, "quadruped", f"with_gravity(own('solo12'), {gravity})")
    assert_outcome(Solved(open_loop=2.0, coarse=0.05), partial(made, "quadruped-jump-up", path), intervals=15)


NAN, INF = float("nan"), float("inf")
Make = Callable[[float], object]


def arm_problem(**changes: object) -> Problem:
    return replace(reach(ur5(), ur5().reference, ur5().reference), **changes)


def ending(term: object) -> Problem:
    return arm_problem(terms=(terms.TorqueCost(weight=1.0), term))


def spoiled(array: np.ndarray, value: float) -> np.ndarray:
    other = np.array(array, dtype=float)
    other.flat[-1] = value
    return other


Q = np.zeros(6)
HEIGHT = "frame's height"
PLACES: dict[str, tuple[str, Make]] = {
    "initial_q": ("initial_q of Problem .*finite numbers", lambda x: arm_problem(initial_q=spoiled(Q, x))),
    "initial_v": ("initial_v of Problem .*finite numbers", lambda x: arm_problem(initial_v=spoiled(Q, x))),
    "goal": ("q of TerminalState .*finite numbers", lambda x: ending(terms.TerminalState(q=spoiled(Q, x)))),
    "rest": ("q of TerminalRest .*finite numbers", lambda x: ending(terms.TerminalRest(q=spoiled(Q, x)))),
    "frame": (
        "position of FramePose .*finite numbers",
        lambda x: ending(terms.FramePose(frame="tool0", position=[0.3, 0.0, x])),
    ),
    "frame's rotation": (
        "rotation of FramePose .*finite numbers",
        lambda x: ending(terms.FramePose(frame="tool0", rotation=spoiled(np.eye(3), x))),
    ),
    "frame's velocity": (
        "velocity of FrameVelocity .*finite numbers",
        lambda x: ending(terms.FrameVelocity(frame="tool0", velocity=spoiled(Q, x))),
    ),
    HEIGHT: (
        "height of FrameHeight .*finite number",
        lambda x: ending(terms.FrameHeight(frame="tool0", height=x, at=middle_of("reach"))),
    ),
    "posture": (
        "q of PostureCost .*finite numbers",
        lambda x: ending(terms.PostureCost(weight=1.0, q=spoiled(Q, x))),
    ),
    "weight": ("weight of TorqueCost .*finite number", lambda x: terms.TorqueCost(weight=x)),
    "friction": ("friction of FrictionCone .*finite number", lambda x: terms.FrictionCone(friction=x)),
    "ground's friction": ("friction of FlatGround .*finite number", lambda x: FlatGround(friction=x)),
    "ground's height": ("height of FlatGround .*finite number", lambda x: FlatGround(height=x)),
    "ground's normal": (
        "normal of FlatGround .*finite numbers",
        lambda x: FlatGround(normal=np.array([0.0, 0.0, x])),
    ),
    "surface": ("normal of Surface", lambda x: Surface(point=np.zeros(3), normal=[0.0, x, 1.0])),
    "foothold": (
        r"footholds\['FL_FOOT'\] of Phase 'p' is .* finite numbers",
        lambda x: Phase(name="p", duration=1.0, contacts=("FL_FOOT",), footholds={"FL_FOOT": [0.0, x, 0.0]}),
    ),
    "duration": ("duration of Phase .*finite number", lambda x: Phase(name="p", duration=x)),
    "duration bounds": (
        "duration_bounds of Phase .*finite numbers",
        lambda x: Phase(name="p", duration=1.0, duration_bounds=(0.5, x)),
    ),
    "clearance": ("height of SwingClearance", lambda x: terms.SwingClearance(height=x, terrain=FlatGround())),
    "reference": ("reference of Robot 'ur5'", lambda x: replace(ur5(), reference=spoiled(Q, x))),
}


def refused(cause: str, make: Callable[[], Problem]) -> None:
    """As `assert_outcome` with `Refused`, but in this process: nothing here is solved."""
    with pytest.raises(InputError, match=cause) as caught:
        prepare(make(), intervals=2)
    assert caught.value.allowed
    assert "\n" not in str(caught.value)


# A frame that must be above -inf is not bound at all.
NONE = [(where, value) for where in PLACES for value in (NAN, INF, -INF) if (where, value) != (HEIGHT, -INF)]


@pytest.mark.parametrize(("where", "value"), NONE, ids=str)
def test_an_invalid_number_is_refused_where_it_is_given(where, value):
    """By the time it is built, or where its rows are; in one line that says what is allowed."""
    cause, make = PLACES[where]

    def build() -> Problem:
        made = make(value)
        return made if isinstance(made, Problem) else arm_problem()

    refused(cause, build)


@pytest.mark.parametrize("limit", [[NAN] * 6, [1.0] * 5 + [-1.0], [1.0] * 5])
def test_invalid_torque_limits_are_refused(limit):
    refused("torque_limits|limit of TorqueLimits", lambda: ending(terms.TorqueLimits(limit=np.array(limit))))


# How a guess may be wrong after 0.5 s, and what is said of it.
GUESSES: dict[str, tuple[str, Callable[[np.ndarray], object]]] = {
    "nan": ("is not finite", lambda q: q * NAN),
    "inf": ("is not finite", lambda q: q + INF),
    "none": (r"is of shape \(\)", lambda q: None),
    "words": ("is not numeric", lambda q: ["up"] * len(q)),
    "short": (r"is of shape \(\d+,\)", lambda q: q[:-1]),
}


@pytest.mark.long
@pytest.mark.parametrize("how", GUESSES)
@pytest.mark.parametrize("name", ["ur5", "solo12"])
def test_an_invalid_guess_is_refused_with_its_time(name, how):
    robot = robots.load(name)
    cause, wrong = GUESSES[how]
    q = robot.reference
    problem = reach(robot, q, q) if name == "ur5" else stance(robot, q, duration=1.0)
    broken = replace(problem, guess=lambda t: q if t < 0.7 else wrong(q))
    refused(rf"guess of problem '\w+' at t = 0\.[789]\d* s {cause}", lambda: broken)


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0)])
def test_an_invalid_quaternion_is_refused(quaternion):
    q = solo().reference.copy()
    q[3:7] = quaternion
    good = solo().reference
    unit = "quaternion .* not unit; allowed: norm 1"
    refused(f"initial_q .* {unit}", lambda: stance(solo(), q, good, guess=lambda t: good))
    refused(f"terminal_state .* {unit}", lambda: stance(solo(), good, q, guess=lambda t: good))
    refused(f"guess .* {unit}", lambda: stance(solo(), good, guess=lambda t: q))


def parameters() -> list[tuple[str, str]]:
    """Every numeric parameter of every family of the library."""
    return [
        (family.name, parameter.name)
        for family in problems.families().values()
        for parameter in family.parameters
        if isinstance(parameter.lower, float | int)
    ]


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e400"])
def test_no_parameter_of_any_problem_takes_an_invalid_number(value):
    for name, parameter in parameters():
        with pytest.raises(InputError, match=rf"parameter {parameter}\b.*; allowed: "):
            problems.load(name, **{parameter: value})


# Open loop, rad and parts of the length: about three times what was measured (docs/extremes.md).
STEPS_ARM = {
    "legendre:1": 12.0, "legendre:2": 0.4, "legendre:3": 4e-3, "legendre:4": 3e-5,
    "radau:1": 14.0, "radau:2": 4.0, "radau:3": 4e-2, "radau:4": 3e-4,
    "trapezoidal": 14.0, "hermite-simpson": 0.3, "semi-implicit-euler": 9.0,
}  # fmt: skip
HOPPER = {
    "legendre:1": 7.0, "legendre:2": 0.1, "legendre:3": 4e-4, "legendre:4": 1e-5,
    "radau:1": 9.0, "radau:2": 2.0, "radau:3": 3e-3, "radau:4": 2e-5,
    "trapezoidal": 2.0, "hermite-simpson": 0.2, "semi-implicit-euler": 9.0,
}  # fmt: skip
STEPS_JUMP = {
    "legendre:1": 12.0, "legendre:2": 0.5, "legendre:3": 1e-2, "legendre:4": 1e-3,
    "radau:2": 8.0, "radau:3": 6e-2, "radau:4": 5e-3, "hermite-simpson": 0.4,
}  # fmt: skip
# On the grid of the jump these let feet slide by more than a quarter of a leg.
TOO_COARSE = ("radau:1", "trapezoidal", "semi-implicit-euler")
# Where feet may be off between the points of these coarse grids, m: order one drifts by half a leg.
COARSE = {
    "legendre:1": 0.2, "legendre:2": 1e-2, "legendre:3": 1e-3, "legendre:4": 1e-3, "radau:1": 0.5,
    "radau:2": 5e-2, "radau:3": 1e-3, "radau:4": 1e-3, "trapezoidal": 0.3, "hermite-simpson": 1e-2,
    "semi-implicit-euler": 0.5,
}  # fmt: skip
# What the cubic of the one-joint arm is met to: tolerances of the solver, over the length of the reach.
CUBIC = 1e-6


@pytest.mark.long
@pytest.mark.parametrize("scheme", STEPS_ARM)
def test_arm_reaches_by_every_scheme(scheme):
    make = partial(problems.load, "ur5-reach")
    assert_outcome(Solved(open_loop=STEPS_ARM[scheme]), make, transcription=scheme, intervals=10)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", HOPPER)
def test_hopper_hops_by_every_scheme(scheme):
    expected = Solved(open_loop=HOPPER[scheme], coarse=COARSE[scheme])
    assert_outcome(expected, partial(problems.load, "hopper-hop"), transcription=scheme, intervals=40)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", [*STEPS_JUMP, *TOO_COARSE])
def test_quadruped_jumps_by_every_scheme(scheme):
    known = scheme in STEPS_JUMP
    expected = Solved(STEPS_JUMP[scheme], coarse=COARSE[scheme]) if known else Failed(Status.COARSE_GRID)
    assert_outcome(expected, partial(problems.load, "solo12-jump"), transcription=scheme, intervals=20)


def timed_reach(duration: float):
    """The one-joint arm's reach in another time: 60 deg and more, without gravity or limits."""
    return replace(
        arm_reach(),
        schedule=Schedule((Phase(name="reach", duration=duration),)),
        guess=lambda t: np.array([REACH * np.clip(t / duration, 0, 1)]),
    )


@pytest.mark.parametrize(
    ("duration", "intervals"),
    [
        *product([0.05, 1.0, 60.0], [5, 50]),
        pytest.param(0.05, 2000, marks=pytest.mark.slow),
        pytest.param(60.0, 2000, marks=pytest.mark.slow),
    ],
)
def test_least_acceleration_is_the_cubic_on_any_horizon_and_grid(duration, intervals):
    """The minimum of the integral of q''^2 from rest to rest is 3 s^2 - 2 s^3; steps of 25 us to 12 s."""
    solution = assert_outcome(Solved(open_loop=CUBIC), partial(timed_reach, duration), intervals=intervals)
    s = solution.t / duration
    assert_allclose(solution.q[:, 0], REACH * (3 * s**2 - 2 * s**3), atol=CUBIC * REACH)
    assert_allclose(
        solution.v[:, 0], REACH / duration * (6 * s - 6 * s**2), atol=CUBIC * 6 * REACH / duration
    )


@pytest.mark.long
@pytest.mark.parametrize("step", [1e-4, 1e-2, 0.2])
def test_quadruped_stands_still_at_any_step(step):
    """At rest nothing is discretised: forces that carry the weight, whatever the step."""
    make = partial(stand, robots.load("solo12"), duration=8 * step)
    solution = assert_outcome(Solved(open_loop=None), make, intervals=8)
    weight = robots.load("solo12").weight
    pushed = solution.f[solution.collocation][:, :, 2].sum(axis=1).mean() / weight
    assert_allclose(pushed, 1.0, atol=1e-3)


def test_too_few_intervals_are_refused():
    assert_outcome(Refused("2 intervals for 3 phases"), partial(problems.load, "solo12-jump"), intervals=2)


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan"), float("inf")])
def test_an_invalid_horizon_is_refused(duration):
    assert_outcome(Refused("duration"), partial(timed_reach, duration), intervals=5)


def test_reach_faster_than_the_motors_is_infeasible():
    assert_outcome(
        Failed(Status.INFEASIBLE, block="frame_pose"),
        partial(problems.load, "ur5-reach", duration=0.05),
        intervals=10,
    )
