"""The linear inverted pendulum against closed forms and integration, and walks from it."""

import json
import math
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import nnls

from tests.support.command_lines import invoke
from trajopt import Contact, InputError, Robot, Solution, simulate
from trajopt.reduced import (
    CenterOfMassProgram,
    FootstepPlan,
    Pendulum,
    Walk,
    commanded_walk,
    guess_from_lip,
    walk_plan,
)
from trajopt.reduced.body_guess import DEFAULT_CLEARANCE
from trajopt.reduced.footsteps import Foothold, StepPhase, feet_of, support_vertices
from trajopt.reduced.lip import PendulumMotion
from trajopt.robot import legs_only, robot_file
from trajopt_library import robots
from trajopt_library.problems.bipeds import biped

PENDULUM = Pendulum(height=0.9)
COM, VELOCITY, ZMP = np.array([0.05, -0.02]), np.array([0.3, 0.1]), np.array([0.02, 0.03])
# Closed forms of hyperbolic functions over a second or so: rounding times exp(omega T) of about 30.
CLOSED = 1e-12
# scipy's DOP853 at rtol 1e-11.
INTEGRATED = 1e-8
# Second difference with 1e-4 s: truncation and rounding.
DIFFERENCED = 1e-6
# What OSQP leaves at 1e-9 in rows of order one, in m and m/s.
SOLVED = 1e-7
# The guess brings the CoM to its place by fixed-point steps, each of which leaves a tenth or so, m.
GUESSED = 1e-3
CONTROLS, TERMINALS = ("zmp_rate", "jerk"), ("rest", "captured")


def integrated(zmp: object, com: np.ndarray, velocity: np.ndarray, time: float) -> np.ndarray:
    """CoM and velocity (4,) by numeric integration of c'' = omega^2 (c - p(t))."""

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[2:], PENDULUM.omega**2 * (x[:2] - zmp(t))])

    start = np.concatenate([com, velocity])
    return solve_ivp(rate, (0, time), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]


def com_of(robot: Robot, q: np.ndarray) -> np.ndarray:
    return pin.centerOfMass(robot.model, robot.model.createData(), q)


def walk_of(**values: object) -> tuple[Robot, FootstepPlan, Pendulum, np.ndarray]:
    robot = biped("talos")
    com = com_of(robot, robot.reference)
    return robot, Walk(**values).plan(robot), Pendulum(height=com[2]), com[:2]


def distance_outside(point: np.ndarray, vertices: np.ndarray) -> float:
    """Residual of a point (2,) as a mean of vertices (n, 2) with weights, m: 0 inside their convex hull."""
    centred = np.vstack([(vertices - point).T, np.ones(len(vertices))])
    return float(nnls(centred, np.array([0.0, 0.0, 1.0]))[1])


def inside(robot: Robot, plan: FootstepPlan, motion: object) -> float:
    """Largest distance of the ZMP from its support polygon between and at samples, m."""
    worst, start = 0.0, 0.0
    for support in plan.supports:
        vertices = support_vertices(robot, support)
        for s in np.linspace(1e-9, 1 - 1e-9, 23):
            worst = max(worst, distance_outside(motion.zmp_at(start + s * support.duration), vertices))
        start += support.duration
    return worst


def test_motion_over_a_constant_zmp_is_that_of_numeric_integration() -> None:
    com, velocity = PENDULUM.after(COM, VELOCITY, ZMP, 0.7)
    assert_allclose([*com, *velocity], integrated(lambda t: ZMP, COM, VELOCITY, 0.7), atol=INTEGRATED)


def test_orbital_energy_is_constant_and_its_sign_says_whether_the_com_passes_the_zmp() -> None:
    energy = PENDULUM.orbital_energy(COM, VELOCITY, ZMP)
    assert_allclose(
        PENDULUM.orbital_energy(*PENDULUM.after(COM, VELOCITY, ZMP, 0.9), ZMP), energy, atol=CLOSED
    )
    behind = np.array([-0.1, -0.1])
    rates = PENDULUM.omega * np.array([0.101, 0.099])  # a little more and less than xi = p asks for
    energy = PENDULUM.orbital_energy(behind, rates, np.zeros(2))
    com, _ = PENDULUM.after(behind, rates, np.zeros(2), 3.0)
    assert (energy > 0).tolist() == [True, False] == (com > 0).tolist()


def test_divergent_component_follows_its_own_equation() -> None:
    start = PENDULUM.capture_point(COM, VELOCITY)
    dcm = PENDULUM.capture_point(*PENDULUM.after(COM, VELOCITY, ZMP, 0.8))
    assert_allclose(dcm, ZMP + math.exp(PENDULUM.omega * 0.8) * (start - ZMP), atol=CLOSED)


def test_stepping_on_the_capture_point_brings_the_pendulum_to_rest() -> None:
    com, velocity = PENDULUM.after(COM, VELOCITY, ZMP, 0.3)
    point = PENDULUM.capture_point(com, velocity)
    end, rate = PENDULUM.after(com, velocity, point, 6.0)
    left = math.exp(-6.0 * PENDULUM.omega)  # the stable component that remains, and rounding of the other
    assert_allclose(end, point, atol=left + CLOSED * math.exp(6.0 * PENDULUM.omega))
    assert_allclose(rate, 0.0, atol=PENDULUM.omega * (left + CLOSED * math.exp(6.0 * PENDULUM.omega)))


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_capture_radius_is_what_that_many_steps_of_full_reach_can_stop(steps: int) -> None:
    time, reach = 0.4, 0.5
    for offset, stops in ((-1e-6, True), (1e-6, False)):
        dcm = PENDULUM.capture_radius(steps, time, reach) + offset
        zmp = 0.0
        for _ in range(steps):
            dcm = zmp + math.exp(PENDULUM.omega * time) * (dcm - zmp)
            zmp = min(dcm, zmp + reach)
        assert (dcm <= zmp) is stops


def test_motion_over_a_linear_zmp_is_that_of_numeric_integration() -> None:
    first, last = np.array([0.0, 0.1]), np.array([0.2, -0.1])
    motion = PendulumMotion(
        pendulum=PENDULUM, times=[0.0, 0.6], zmp=[[first, last]], com_start=COM, dcm_end=last + 0.01
    )
    zmp = lambda t: first + (last - first) * t / 0.6  # noqa: E731
    expected = integrated(zmp, COM, motion.velocity(0.0), 0.6)
    assert_allclose([*motion.com(0.6), *motion.velocity(0.6)], expected, atol=INTEGRATED)
    assert_allclose(motion.dcm(0.6), last + 0.01, atol=CLOSED)


def test_a_piecewise_linear_zmp_is_of_second_order() -> None:
    rate, duration = 4.0, 1.5
    share = PENDULUM.omega**2 / (PENDULUM.omega**2 + rate**2)  # of the periodic response to p = sin(rate t)
    errors, counts = [], np.array([8, 16, 32, 64])
    for n in counts:
        times = np.linspace(0, duration, n + 1)
        values = np.repeat(np.sin(rate * times)[:, None], 2, axis=1)
        dcm_end = share * (np.sin(rate * duration) + rate / PENDULUM.omega * np.cos(rate * duration))
        motion = PendulumMotion(
            pendulum=PENDULUM, times=times, zmp=np.stack([values[:-1], values[1:]], axis=1),
            com_start=np.zeros(2), dcm_end=np.full(2, dcm_end),
        )  # fmt: skip
        errors.append(
            max(abs(motion.com(t)[0] - share * np.sin(rate * t)) for t in np.linspace(0, duration, 50))
        )
    slopes = [math.log2(a / b) for a, b in pairwise(errors)]
    assert_allclose(slopes, 2.0, atol=0.1)


def test_a_long_walk_keeps_its_digits() -> None:
    places = np.array([[0.1 * i, 0.1 * (-1) ** i] for i in range(41)])
    motion = PendulumMotion(
        pendulum=PENDULUM,
        times=np.linspace(0.0, 30.0, 41),
        zmp=np.stack([places[:-1], places[1:]], axis=1),
        com_start=COM,
        dcm_end=places[-1],
    )
    assert_allclose(motion.com(0.0), COM, atol=CLOSED)
    assert_allclose(motion.dcm(30.0), places[-1], atol=CLOSED)
    for t in motion.times[1:-1]:
        assert_allclose(motion.com(t - 1e-9), motion.com(t + 1e-9), atol=1e-8)


@pytest.mark.parametrize("terminal", TERMINALS)
@pytest.mark.parametrize("control", CONTROLS)
def test_program_keeps_the_zmp_inside_between_samples_and_meets_both_ends(
    control: str, terminal: str
) -> None:
    robot, plan, pendulum, com = walk_of(steps=3, turn=-0.15)
    motion = CenterOfMassProgram(
        robot=robot, plan=plan, pendulum=pendulum, com_start=com, control=control, terminal=terminal
    ).solve()
    assert inside(robot, plan, motion) < SOLVED
    assert_allclose([motion.com(0.0) - com, motion.velocity(0.0)], 0.0, atol=SOLVED)
    end = plan.duration
    dcm = pendulum.capture_point(motion.com(end), motion.velocity(end))
    assert_allclose(dcm, motion.zmp_at(end), atol=SOLVED)
    assert (np.abs(motion.velocity(end)).max() < SOLVED) == (terminal == "rest")


@pytest.mark.parametrize("control", CONTROLS)
def test_program_obeys_the_pendulum_between_samples(control: str) -> None:
    robot, plan, pendulum, com = walk_of()
    motion = CenterOfMassProgram(
        robot=robot, plan=plan, pendulum=pendulum, com_start=com, control=control
    ).solve()
    for t in (0.123, 0.777, 1.456):
        second = (motion.com(t + 1e-4) - 2 * motion.com(t) + motion.com(t - 1e-4)) / 1e-8
        assert_allclose(second, motion.acceleration(t), atol=DIFFERENCED * 10)
        expected = pendulum.omega**2 * (motion.com(t) - motion.zmp_at(t))
        assert_allclose(motion.acceleration(t), expected, atol=CLOSED)


@pytest.mark.long
def test_both_controls_tend_to_one_motion() -> None:
    robot, plan, pendulum, com = walk_of()
    apart = []
    for step in (0.1, 0.025):
        motions = [
            CenterOfMassProgram(
                robot=robot, plan=plan, pendulum=pendulum, com_start=com, control=control, step=step
            ).solve()
            for control in CONTROLS
        ]
        assert all(motion.duration == pytest.approx(plan.duration) for motion in motions)
        times = np.linspace(0, plan.duration, 40)
        apart.append(max(np.abs(motions[0].com(t) - motions[1].com(t)).max() for t in times))
    assert apart[1] < apart[0]
    assert apart[1] < 2e-3  # m: the costs differ by c' in the derivative of the ZMP


def bolt() -> Robot:
    feet = [Contact(frame=f"{side}_ANKLE", name=side) for side in ("FL", "FR")]
    legs = {f"{side}_{joint}": q for side in ("FL", "FR") for joint, q in {"HFE": 0.4, "KFE": -0.8}.items()}
    return Robot.from_urdf(robot_file("bolt_description/robots/bolt.urdf"), contacts=feet, reference=legs)


def test_point_feet_walk_on_segments_and_points_without_double_support_too() -> None:
    robot = bolt()
    com = com_of(robot, robot.reference)
    pendulum, feet = Pendulum(height=com[2]), feet_of(robot, robot.reference)
    # On points in one line there is no way forward from rest: the left foot steps out to the side.
    aside = np.array([0.0, 0.03, 0.0])
    moved = feet | {"FL": Foothold(position=feet["FL"].position + aside)}
    plan = FootstepPlan(
        (
            StepPhase(name="both", duration=0.3, feet=feet),
            StepPhase(name="right", duration=0.2, feet={"FR": feet["FR"]}),
            StepPhase(name="left", duration=0.2, feet={"FL": moved["FL"]}),
            StepPhase(name="end", duration=0.5, feet=moved),
        )
    )
    program = CenterOfMassProgram(
        robot=robot,
        plan=plan,
        pendulum=pendulum,
        com_start=feet["FL"].position[:2] / 2 + feet["FR"].position[:2] / 2,
    )
    motion = program.solve()
    assert inside(robot, plan, motion) < SOLVED
    assert_allclose(motion.zmp_at(0.4), feet["FR"].position[:2], atol=SOLVED)
    assert_allclose(motion.zmp_at(0.6), moved["FL"].position[:2], atol=SOLVED)


def test_a_walk_too_quick_for_its_feet_is_refused_with_advice() -> None:
    robot, plan, pendulum, com = walk_of(length=1.5, step_time=0.2, shift_time=0.06, double_support=0.05)
    program = CenterOfMassProgram(robot=robot, plan=plan, pendulum=pendulum, com_start=com)
    with pytest.raises(InputError, match="longer supports"):
        program.solve()


def test_footsteps_advance_turn_and_end_side_by_side() -> None:
    robot = biped("talos")
    start = feet_of(robot, robot.reference)
    plan = Walk(steps=5, length=0.2, turn=0.1, first="right").plan(robot)
    end = plan.supports[-1].feet
    apart = {
        name: np.linalg.norm(feet["left"].position - feet["right"].position)
        for name, feet in (("start", start), ("end", end))
    }
    assert_allclose(apart["end"], apart["start"], atol=CLOSED)
    assert_allclose([foot.yaw for foot in end.values()], 4 * 0.1, atol=CLOSED)
    ahead = (
        end["left"].position + end["right"].position - start["left"].position - start["right"].position
    ) / 2
    # Chords of one circle: length 0.2, turned by 0.1 each, the first by half of it.
    expected = 0.2 * sum(
        np.array([math.cos(0.1 * (k + 0.5)), math.sin(0.1 * (k + 0.5)), 0.0]) for k in range(4)
    )
    assert_allclose(ahead, expected, atol=CLOSED)
    assert list(plan.supports[1].feet) == ["left"]


def test_schedule_of_a_plan_lands_new_feet_on_their_footholds() -> None:
    robot = biped("talos")
    plan = Walk(steps=2).plan(robot)
    schedule = plan.schedule()
    assert schedule.duration == pytest.approx(plan.duration)
    assert [set(phase.footholds) for phase in schedule.phases] == [set(), set(), {"left"}, set(), {"right"}]
    assert_allclose(schedule.phases[2].footholds["left"], plan.supports[2].feet["left"].position)


def test_feet_of_a_guess_stand_still_and_swings_start_and_end_at_rest() -> None:
    robot = biped("talos")
    plan = Walk(steps=2).plan(robot)
    feet = plan.contact_paths(feet_of(robot, robot.reference), 0.1)
    begin, end = plan.supports[0].duration, plan.supports[0].duration + plan.supports[1].duration
    assert_allclose(feet.pose("right", 0.8).translation, plan.supports[0].feet["right"].position)
    assert feet.around("left", (begin + end) / 2)[2] == pytest.approx(0.5)
    middle = feet.pose("left", (begin + end) / 2).translation
    assert middle[2] - plan.supports[0].feet["left"].position[2] == pytest.approx(0.1)
    for t, inwards in ((begin, 1e-4), (end, -1e-4)):
        speed = (feet.pose("left", t + inwards).translation - feet.pose("left", t).translation) / 1e-4
        assert np.abs(speed).max() < 1e-2


def test_guess_puts_feet_on_their_path_and_the_com_on_its_motion() -> None:
    robot, plan, pendulum, com = walk_of(turn=0.1)
    motion = CenterOfMassProgram(robot=robot, plan=plan, pendulum=pendulum, com_start=com).solve()
    guess = guess_from_lip(robot, plan, motion)
    feet = plan.contact_paths(feet_of(robot, robot.reference), DEFAULT_CLEARANCE)
    assert_allclose(guess(0.0), robot.reference, atol=1e-9)
    for t in np.linspace(0.1, plan.duration, 7):
        q = guess(t)
        assert_allclose(com_of(robot, q)[:2], motion.com(t), atol=GUESSED)
        for name, foot in feet_of(robot, q).items():
            assert_allclose(foot.pose.homogeneous, feet.pose(name, t).homogeneous, atol=1e-8)


def flight() -> StepPhase:
    return StepPhase(name="flight", duration=0.1)


def still() -> PendulumMotion:
    return PendulumMotion(
        pendulum=PENDULUM, times=[0.0, 1.0], zmp=np.zeros((1, 2, 2)), com_start=COM, dcm_end=COM
    )


BAD = {
    "height": lambda: Pendulum(height=0.0),
    "steps": lambda: Walk(steps=1),
    "step_time": lambda: Walk(step_time=-1.0),
    "width": lambda: Walk(width=0.0),
    "length": lambda: Walk(length=math.nan),
    "biped": lambda: Walk().plan(robots.load("solo12")),
    "no contact": lambda: Walk(first="tail").plan(biped("talos")),
    "without being lifted": lambda: FootstepPlan(
        (
            StepPhase(name="a", duration=1.0, feet={"left": Foothold(position=np.zeros(3))}),
            StepPhase(name="b", duration=1.0, feet={"left": Foothold(position=np.ones(3))}),
        )
    ),
    "no foot": lambda: support_vertices(biped("talos"), flight()),
    "position of Foothold": lambda: Foothold(position=np.array([0.0, math.inf, 0.0])),
    "control": lambda: CenterOfMassProgram(
        robot=biped("talos"),
        plan=Walk().plan(biped("talos")),
        pendulum=PENDULUM,
        com_start=COM,
        control="force",
    ),
    "increasing": lambda: PendulumMotion(
        pendulum=PENDULUM, times=[0.0, 0.0], zmp=np.zeros((1, 2, 2)), com_start=COM, dcm_end=COM
    ),
    "free-flyer": lambda: guess_from_lip(robots.load("ur5"), FootstepPlan((flight(),)), still()),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_refused_in_one_line(what: str) -> None:
    with pytest.raises(InputError, match=what) as error:
        BAD[what]()
    assert "\n" not in str(error.value)


# Velocity of feet on the ground, over natural units.
STILL = 1e-3


@pytest.fixture(scope="module")
def talos() -> Robot:
    return legs_only(robots.load("talos"))


@pytest.fixture(scope="module")
def plan(talos: Robot) -> Solution:
    walk = commanded_walk(talos, steps=4, speed=0.3, turn_rate=0.2)
    return walk_plan(talos, walk)


def test_speeds_give_the_way_of_the_steps(talos: Robot):
    walk = commanded_walk(talos, steps=6, speed=0.3, turn_rate=-0.2, step_time=0.5, double_support=0.1)
    assert (walk.length, walk.turn, walk.side) == pytest.approx((0.18, -0.12, 0.0))
    feet = walk.plan(talos).supports
    way = np.mean([foot.position for foot in feet[-1].feet.values()], axis=0) - np.mean(
        [foot.position for foot in feet[0].feet.values()], axis=0
    )
    assert np.linalg.norm(way) <= 5 * 0.18
    assert feet[-1].feet["left"].yaw - feet[0].feet["left"].yaw == pytest.approx(-5 * 0.12)


@pytest.mark.parametrize("side_speed", [0.1, -0.1])
def test_feet_do_not_come_nearer_than_in_the_stance_when_walking_aside(talos: Robot, side_speed: float):
    walk = commanded_walk(talos, steps=9, speed=0.0, side_speed=side_speed)
    supports = [s.feet for s in walk.plan(talos).supports if len(s.feet) == 2]
    across = [float(feet["left"].position[1] - feet["right"].position[1]) for feet in supports]
    assert min(across) == pytest.approx(across[0]) == pytest.approx(across[-1])
    moved = supports[-1]["left"].position[1] - supports[0]["left"].position[1]
    assert moved == pytest.approx(8 * walk.side)


@pytest.mark.long
def test_the_centre_of_mass_stays_at_one_height_and_feet_on_their_footholds(talos: Robot, plan: Solution):
    data, model = talos.model.createData(), talos.model
    height = [pin.centerOfMass(model, data, q)[2] for q in plan.q]
    assert np.ptp(height) < 1e-3 * talos.length
    for i, frame in enumerate(plan.contact_frames):
        for k in np.flatnonzero(plan.active[:, i]):
            pin.computeJointJacobians(model, data, plan.q[k])
            pin.updateFramePlacements(model, data)
            jacobian = pin.getFrameJacobian(
                model, data, model.getFrameId(frame), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
            assert np.abs(jacobian @ plan.v[k]).max() < STILL * np.sqrt(9.81 * talos.length)


def test_torques_and_contact_forces_give_the_motion(talos: Robot, plan: Solution):
    assert plan.success
    model, data = talos.model, talos.model.createData()
    for k in range(0, len(plan.t), 7):
        needed = pin.rnea(model, data, plan.q[k], plan.v[k], plan.a[k])
        pin.computeJointJacobians(model, data, plan.q[k])
        pin.updateFramePlacements(model, data)
        for i, frame in enumerate(plan.contact_frames):
            jacobian = pin.getFrameJacobian(
                model, data, model.getFrameId(frame), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
            needed -= jacobian.T @ plan.f[k, i]
        needed[6:] -= plan.tau[k]
        weight = pin.computeTotalMass(model) * 9.81
        assert np.abs(needed).max() < 1e-2 * weight * talos.length


def test_a_saved_plan_is_a_solution_like_any_other(plan: Solution, tmp_path):
    file = plan.save(tmp_path / "walk.npz")
    loaded = Solution.load(file)
    assert loaded.description.problem == "walk"
    assert loaded.description.parameters["steps"] == 4
    assert invoke("check", file).exit_code in (0, 1)


@pytest.mark.long
def test_talos_walks_in_physics(plan: Solution):
    report = simulate(plan, controller="whole-body").report
    assert report.passed
    assert report.missed == 0
    assert report.base_error_max is not None
    assert report.base_error_max < 0.01
    assert report.controller is not None
    assert report.controller.relaxed == {"nothing": report.controller.ticks}


@pytest.mark.long
def test_the_command_writes_plan_and_simulation(tmp_path):
    plan, motion = tmp_path / "plan.npz", tmp_path / "motion.npz"
    done = invoke(
        "walk", "g1", "--steps", "3", "--plan", plan, "-o", motion, "--json", "--side-speed", "0.03"
    )
    assert done.exit_code == 0
    assert json.loads(done.stdout)["passed"]
    assert Solution.load(plan).description.parameters["side"] > 0
    assert Solution.load(motion).statistics.simulated


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("bolt",), "stands on points"),
        (("ur5",), "fixed base"),
        (("talos", "--steps", "1"), "steps of Walk is 1; allowed: a whole number >= 2"),
        (("talos", "--speed", "nan"), "speed of commanded_walk is nan"),
        (("talos", "--turn-rate", "30", "--crouch", "0"), "at the end of its range"),
        (("talos", "--steps", "2", "--step-time", "0.01", "--crouch", "0"), "turns at"),
        (("talos", "--crouch", "2"), "do not bend by a crouch of 2 m"),
    ],
)
def test_bad_input_is_one_line(given: tuple[str, ...], message: str):
    done = invoke("walk", *given)
    assert done.exit_code == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


def test_side_must_be_a_number():
    with pytest.raises(InputError, match="side of Walk is nan"):
        Walk(side=float("nan"))
