"""Robots in a plane: the hopper is the machine of its figures, quadrupeds hop in their sagittal plane."""

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from trajopt import Contact, FlatGround, Phase, Problem, Robot, Schedule
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics.base_joint import Base
from trajopt.dynamics.model_quantities import generalized_force
from trajopt.robot.data import robot_file
from trajopt.schedule import middle_of
from trajopt.terms import (
    AccelerationCost,
    FrameHeight,
    FrictionCone,
    PositionLimits,
    PostureCost,
    SwingClearance,
    TerminalRest,
    TerminalState,
    TorqueCost,
    TorqueLimits,
    VelocityCost,
    VelocityLimits,
)
from trajopt_library import robots
from trajopt_library.robots import hopper

DISTANCE, STANCE, FLIGHT, LANDING = 0.1, 0.3, 0.25, 0.4  # m, s, s, s
GRAVITY = 9.81
# Ten times the solver's tolerance, in parts of the weight.
SOLVED = 1e-5


def go2(base: Base) -> Robot:
    legs = ("FL", "FR", "RL", "RR")
    angles = {"thigh": 0.8, "calf": -1.6}
    return Robot.from_urdf(
        robot_file("go2_description/urdf/go2.urdf"),
        base=base,
        contacts=[Contact(frame=f"{leg}_foot", name=leg) for leg in legs],
        reference={f"{leg}_{joint}_joint": angle for leg in legs for joint, angle in angles.items()},
        locked=[f"{leg}_hip_joint" for leg in legs],
    )


def solo(base: Base) -> Robot:
    bends = {"FL": 1, "FR": 1, "HL": -1, "HR": -1}
    return Robot.from_urdf(
        robot_file("solo_description/robots/solo.urdf"),
        base=base,
        contacts=[Contact(frame=f"{leg}_FOOT", name=leg) for leg in bends],
        reference={
            f"{leg}_{joint}": bend * angle
            for leg, bend in bends.items()
            for joint, angle in (("HFE", 0.8), ("KFE", -1.6))
        },
    )


def hop(robot: Robot) -> Problem:
    """Forward by ``DISTANCE`` and up by a tenth of the robot's length, from rest to rest."""
    end = robot.reference.copy()
    end[0] += DISTANCE
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, end)
    feet = {c.name: data.oMf[robot.model.getFrameId(c.frame)].translation.copy() for c in robot.contacts}
    legs, ground = tuple(feet), FlatGround(friction=0.7)
    height = 1 if robot.base == "planar" else 2

    def guess(t: float) -> np.ndarray:
        q, s = robot.reference.copy(), np.clip(t - STANCE, 0.0, FLIGHT)
        q[0] += DISTANCE * s / FLIGHT
        q[height] += GRAVITY * s * (FLIGHT - s) / 2
        return q

    return Problem(
        name="planar-hop",
        robot=robot,
        schedule=Schedule(
            (
                Phase(name="stance", duration=STANCE, contacts=legs),
                Phase(name="flight", duration=FLIGHT),
                Phase(name="landing", duration=LANDING, contacts=legs, footholds=feet),
            )
        ),
        terrain=ground,
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=(
            TorqueCost(weight=1.0),
            AccelerationCost(weight=2e-2, joints_only=True),
            VelocityCost(weight=1e-2, joints_only=True),
            PostureCost(weight=1e-1),
            TorqueLimits(),
            PositionLimits(),
            VelocityLimits(),
            FrictionCone(friction=ground.friction),
            SwingClearance(height=0.03, terrain=ground),
            FrameHeight(frame="root_joint", height=1.1 * robot.length, at=middle_of("flight")),
            TerminalState(q=end),
            TerminalRest(q=end),
        ),
        guess=guess,
        default_intervals=24,
    )


@pytest.mark.long
@pytest.mark.parametrize("make", [go2, solo])
def test_a_planar_quadruped_hops_and_passes_its_check(make):
    solution = trajopt.solve(hop(make("planar")), fixed_mesh=True)
    assert solution.converged, solution.statistics.advice
    assert solution.statistics.iterations <= 60
    report = trajopt.check(solution)
    assert report.within(AT_POINTS), str(report)
    assert report.gimbal_margin is None


def in_space(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A motion of the planar base as one of a free-flyer: pitch, nose up, is about the world's -y."""
    half = np.arctan2(q[3], q[2]) / 2
    pose = [q[0], 0.0, q[1], 0.0, -np.sin(half), 0.0, np.cos(half)]
    twist, change = ([x[0], 0.0, x[1], 0.0, -x[2], 0.0] for x in (v, a))
    return tuple(
        np.concatenate([base, x[n:]]) for base, x, n in ((pose, q, 4), (twist, v, 3), (change, a, 3))
    )


def test_a_plan_in_the_plane_obeys_the_free_flyers_dynamics():
    solution, floating = (trajopt.solve(hop(solo("planar")), fixed_mesh=True), solo("freeflyer"))
    model, data = floating.model, floating.model.createData()
    frames = [model.getFrameId(contact.frame) for contact in floating.contacts]
    in_plane = [0, 2, 4, *range(6, model.nv)]
    for k in np.flatnonzero(solution.collocation):
        motion = in_space(solution.q[k], solution.v[k], solution.a[k])
        force = generalized_force(model, data, motion, frames, solution.f[k])
        expected = np.concatenate([np.zeros(3), solution.tau[k]])
        np.testing.assert_allclose(force[in_plane], expected, atol=SOLVED * floating.weight)


ROUNDING = 1e-12


def points(q: np.ndarray) -> dict[str, np.ndarray]:
    """Hip, knee, foot and torso centre (3,) m by hand: angles from the vertical, nose up positive."""
    x, z, cosine, sine, hip, knee = q
    pitch = np.arctan2(sine, cosine)
    thigh = pitch - hip  # Pinocchio's y axis turns nose down
    shank = thigh - knee
    at = np.array([x, 0.0, z])

    def down(angle: float) -> np.ndarray:
        return np.array([np.sin(angle), 0.0, -np.cos(angle)])

    knee_point = at + hopper.THIGH_LENGTH * down(thigh)
    return {
        "hip": at,
        "knee": knee_point,
        "foot": knee_point + hopper.SHANK_LENGTH * down(shank),
        "torso": at - hopper.TORSO_CENTRE * hopper.TORSO_LENGTH * down(pitch),
        "thigh": at + hopper.THIGH_LENGTH / 2 * down(thigh),
        "shank": knee_point + hopper.SHANK_LENGTH / 2 * down(shank),
    }


POSTURE = np.array([0.3, 0.8, np.cos(0.4), np.sin(0.4), -0.7, 1.3])


def test_sizes_base_and_weight():
    robot = robots.load("hopper")
    assert (robot.base, robot.nq, robot.nv, robot.nu, robot.n_unactuated) == ("planar", 6, 5, 2, 3)
    assert robot.mass == pytest.approx(10.0)
    assert [contact.name for contact in robot.contacts] == ["foot"]


def test_frames_lie_where_the_links_angles_put_them():
    model = robots.load("hopper").model
    data = model.createData()
    pin.framesForwardKinematics(model, data, POSTURE)
    for name in ("hip", "knee", "foot"):
        found = data.oMf[model.getFrameId(name)].translation
        np.testing.assert_allclose(found, points(POSTURE)[name], atol=ROUNDING)


def test_the_centre_of_mass_is_that_of_three_boxes():
    model = robots.load("hopper").model
    masses = {"torso": hopper.TORSO_MASS, "thigh": hopper.THIGH_MASS, "shank": hopper.SHANK_MASS}
    at = points(POSTURE)
    expected = sum(mass * at[name] for name, mass in masses.items()) / sum(masses.values())
    found = pin.centerOfMass(model, model.createData(), POSTURE)
    np.testing.assert_allclose(found, expected, atol=ROUNDING)


def test_the_pitch_inertia_of_a_turning_body_is_that_of_its_boxes():
    """All links turn with the torso: the kinetic energy is that of one rigid body about the hip."""
    robot, rate = robots.load("hopper"), 2.0
    v = np.array([0.0, 0.0, rate, 0.0, 0.0])
    at, expected = points(POSTURE), 0.0
    for name, mass, length in (
        ("torso", hopper.TORSO_MASS, hopper.TORSO_LENGTH),
        ("thigh", hopper.THIGH_MASS, hopper.THIGH_LENGTH),
        ("shank", hopper.SHANK_MASS, hopper.SHANK_LENGTH),
    ):
        side = hopper.SLENDERNESS * length
        own = mass * (length**2 + side**2) / 12
        expected += (own + mass * np.sum((at[name] - at["hip"]) ** 2)) * rate**2 / 2
    found = pin.computeKineticEnergy(robot.model, robot.model.createData(), POSTURE, v)
    assert found == pytest.approx(expected, rel=1e-12)


def test_the_reference_stands_with_its_weight_over_the_foot():
    robot = robots.load("hopper")
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    foot = data.oMf[robot.model.getFrameId("foot")].translation
    assert foot[2] == pytest.approx(0.0, abs=ROUNDING)
    centre = pin.centerOfMass(robot.model, data, robot.reference)
    assert centre[0] == pytest.approx(foot[0], abs=ROUNDING)


def test_joints_can_hold_the_weight_on_a_bent_leg():
    robot = robots.load("hopper")
    lever = hopper.THIGH_LENGTH
    assert (robot.torque_limit > 2 * robot.weight * lever).all()
    np.testing.assert_array_equal(robot.velocity_limit[3:], hopper.SPEED)
