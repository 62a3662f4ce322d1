"""Robots a thousand times lighter and heavier, mass ratios of 1e4 and more, gravity from 0 to 20 m/s^2."""

from functools import lru_cache, partial

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.extremes.changed_robots import longer, made, robot_file, with_gravity
from tests.extremes.motions import stand, turn_over
from tests.extremes.outcomes import Failed, Refused, Solved, assert_outcome
from trajopt.motion.solution import Solution
from trajopt.solvers.status import Status
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
