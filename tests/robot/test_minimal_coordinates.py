"""The stance mode in minimal coordinates is the floating robot with its foot held still."""

from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.models import placement
from tests.support.problems import FOOT, hopper
from tests.support.refusals import refusals
from trajopt import Contact, InputError, Phase, Problem, Robot, Schedule, check
from trajopt.certify.report import AT_POINTS
from trajopt.errors import UnsupportedJointError
from trajopt.robot import Drive, StanceMode, Units, robot_file, stance_mode
from trajopt.solving.solving import solve
from trajopt.terms import AccelerationCost, PostureCost, TorqueCost, VelocityCost
from trajopt_library import robots


def _tilted(robot: Robot) -> Robot:
    """The same robot on a root joint that is displaced and turned in the world."""
    model = pin.Model(robot.model)
    model.jointPlacements[1] = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.8])), np.array([0.4, 0.1, -0.2]))
    return Robot.from_model(model, contacts=robot.contacts, reference=robot.reference)


def _go2() -> Robot:
    hips = [f"{leg}_hip_joint" for leg in ("FL", "FR", "RL", "RR")]
    return Robot.from_urdf(
        robot_file("go2_description/urdf/go2.urdf"), base="planar", contacts=["FL_foot", "RR_foot"],
        reference={f"{leg}_{joint}_joint": angle for leg in ("FL", "FR", "RL", "RR")
                   for joint, angle in (("thigh", 0.8), ("calf", -1.6))},
        locked=hips,
    )  # fmt: skip


def _bolt() -> Robot:
    return Robot.from_urdf(
        robot_file("bolt_description/robots/bolt.urdf"), contacts=["FL_FOOT", "FR_FOOT"],
        reference={f"{leg}_{joint}": angle for leg in ("FL", "FR")
                   for joint, angle in (("HFE", 0.5), ("KFE", -1.0))},
    )  # fmt: skip


def _wheel_on_a_leg() -> Robot:
    """A free body with a continuous, an unaligned and a sliding joint to its foot, armature on all."""
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    parent, generator = base, np.random.default_rng(2)
    kinds = (
        pin.JointModelRUBY(),
        pin.JointModelRevoluteUnaligned(0.36, 0.48, 0.8),
        pin.JointModelPrismaticUnaligned(0.0, 0.6, -0.8),
    )
    for name, kind in zip(("wheel", "skew", "slide"), kinds, strict=True):
        placement = pin.SE3(pin.exp3(generator.uniform(-1, 1, 3)), generator.uniform(-0.3, 0.3, 3))
        parent = model.addJoint(parent, kind, placement, name)
        model.appendBodyToJoint(parent, pin.Inertia.Random(), pin.SE3.Identity())
    model.appendBodyToJoint(base, pin.Inertia.Random(), pin.SE3.Identity())
    placement = pin.SE3(pin.exp3(generator.uniform(-1, 1, 3)), generator.uniform(-0.3, 0.3, 3))
    model.addFrame(pin.Frame("tip", parent, 0, placement, pin.FrameType.OP_FRAME))
    model.armature[6:] = [0.1, 0.2, 0.3]
    return Robot.from_model(model, contacts=["tip"])


CASES = {
    "hopper": lambda: (robots.load("hopper"), "foot"),
    "solo12": lambda: (robots.load("solo12"), "HL_FOOT"),
    "bolt": lambda: (_bolt(), "FR_FOOT"),
    "go2-planar": lambda: (_go2(), "RR_foot"),
    "sliding-shank": lambda: (hopper(), FOOT),
    "tilted": lambda: (_tilted(hopper()), FOOT),
    "wheel": lambda: (_wheel_on_a_leg(), "tip"),
}


@lru_cache
def mode_of(name: str) -> StanceMode:
    pin.seed(0)
    robot, contact = CASES[name]()
    return stance_mode(robot, contact)


def random_state(mode: StanceMode, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator, model = np.random.default_rng(seed), mode.robot.model
    q = pin.integrate(model, pin.neutral(model), generator.uniform(-1, 1, model.nv))
    return q, generator.uniform(-2, 2, model.nv), generator.uniform(-5, 5, model.nv)


# Rounding of algorithms over a dozen bodies with forces of tens of newtons.
ROUNDING = 1e-10
# Central differences of step 1e-5 of quantities of order one: truncation and cancellation below this.
DIFFERENCES = 1e-7
STEP = 1e-5
# Two schemes of order six on the same motion, each solved to 1e-6 in natural units.
SAME_OPTIMUM, SAME_PATH = 1e-5, 1e-4
every_case = pytest.mark.parametrize("name", CASES)


def foot_motion(mode: StanceMode, q, v, a) -> tuple[pin.SE3, np.ndarray, np.ndarray]:
    model, axes = mode.floating.model, pin.LOCAL_WORLD_ALIGNED
    data, frame = model.createData(), model.getFrameId(mode.floating.contact(mode.contact).frame)
    pin.forwardKinematics(model, data, q, v, a)
    return (
        pin.updateFramePlacement(model, data, frame),
        pin.getFrameVelocity(model, data, frame, axes).vector,
        pin.getFrameClassicalAcceleration(model, data, frame, axes).vector,
    )


@every_case
def test_the_stance_has_the_floating_robots_freedom_less_what_the_contact_takes(name):
    mode = mode_of(name)
    taken = 2 if mode.floating.base == "planar" else 3
    assert mode.robot.nv == mode.floating.nv - taken
    assert mode.robot.nu == mode.floating.nu
    assert mode.robot.n_unactuated == mode.floating.n_unactuated - taken
    assert mode.robot.base == "fixed"


@every_case
def test_a_lifted_foot_stands_still_at_its_foothold(name):
    mode, foothold = mode_of(name), np.array([0.3, -0.1, 0.2])
    if mode.floating.base == "planar":
        foothold[1] = mode.anchor[1]
    place, velocity, acceleration = foot_motion(mode, *mode.lifted(*random_state(mode), foothold))
    assert_allclose(place.translation, foothold, atol=ROUNDING)
    assert_allclose(velocity[:3], 0, atol=ROUNDING)
    assert_allclose(acceleration[:3], 0, atol=ROUNDING)


@every_case
def test_every_frame_lies_where_it_lies_in_the_floating_robot(name):
    mode = mode_of(name)
    q, v, a = random_state(mode)
    lifted = mode.lifted(q, v, a)
    ours, theirs = mode.robot.model, mode.floating.model
    data, other = ours.createData(), theirs.createData()
    pin.forwardKinematics(ours, data, q, v, a)
    pin.forwardKinematics(theirs, other, *lifted)
    pin.updateFramePlacements(ours, data)
    pin.updateFramePlacements(theirs, other)
    compared = 0
    for number, frame in enumerate(theirs.frames):
        if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME):
            found = ours.getFrameId(frame.name, frame.type)
            compared += 1
            assert_allclose(data.oMf[found].homogeneous, other.oMf[number].homogeneous, atol=ROUNDING)
            for motion in (pin.getFrameVelocity, pin.getFrameAcceleration):
                assert_allclose(
                    motion(ours, data, found).vector, motion(theirs, other, number).vector, atol=ROUNDING
                )
    assert compared


@every_case
def test_drop_inverts_lift(name):
    mode = mode_of(name)
    q, v, a = random_state(mode)
    back = mode.dropped(*mode.lifted(q, v, a))
    assert np.abs(pin.difference(mode.robot.model, q, back[0])).max() < ROUNDING
    for found, expected in zip(back[1:], (v, a, mode.anchor), strict=True):
        assert_allclose(found, expected, atol=ROUNDING)


@every_case
def test_lift_inverts_drop_of_a_floating_robot_whose_foot_stands_still(name):
    mode = mode_of(name)
    model, generator = mode.floating.model, np.random.default_rng(3)
    q = pin.integrate(model, mode.floating.reference, generator.uniform(-0.5, 0.5, model.nv))
    frame = model.getFrameId(mode.floating.contact(mode.contact).frame)
    jacobian = pin.computeFrameJacobian(model, model.createData(), q, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
    v = generator.uniform(-1, 1, model.nv)
    v -= np.linalg.pinv(jacobian) @ jacobian @ v
    drift = foot_motion(mode, q, v, np.zeros(model.nv))[2][:3]
    a = generator.uniform(-1, 1, model.nv)
    a -= np.linalg.pinv(jacobian) @ (jacobian @ a + drift)
    again = mode.lifted(*mode.dropped(q, v, a))
    assert np.abs(pin.difference(model, q, again[0])).max() < ROUNDING
    assert_allclose(again[1], v, atol=ROUNDING)
    assert_allclose(again[2], a, atol=ROUNDING)


@every_case
def test_lifted_rates_are_the_derivatives_of_the_lifted_motion(name):
    mode = mode_of(name)
    q, v, a = random_state(mode)
    model = mode.robot.model

    def lifted(t: float) -> tuple[np.ndarray, np.ndarray]:
        moved = pin.integrate(model, q, v * t + a * t * t / 2)
        # Along this path the stance rate is the right Jacobian's image of v + a t.
        rate = pin.dIntegrate(model, q, v * t + a * t * t / 2, pin.ArgumentPosition.ARG1) @ (v + a * t)
        return mode.lifted(moved, rate)[:2]

    before, after = lifted(-STEP), lifted(STEP)
    _, rate, change = mode.lifted(q, v, a)
    moved = pin.difference(mode.floating.model, before[0], after[0]) / (2 * STEP)
    assert_allclose(moved, rate, atol=DIFFERENCES)
    assert_allclose((after[1] - before[1]) / (2 * STEP), change, atol=DIFFERENCES)


@every_case
def test_energies_agree(name):
    mode = mode_of(name)
    q, v, _ = random_state(mode)
    floating_q, floating_v, _ = mode.lifted(q, v)
    energies = []
    for model, state in ((mode.robot.model, (q, v)), (mode.floating.model, (floating_q, floating_v))):
        data = model.createData()
        kinetic = pin.computeKineticEnergy(model, data, *state)
        energies.append((kinetic, pin.computePotentialEnergy(model, data, state[0])))
    assert_allclose(energies[0], energies[1], rtol=1e-12, atol=ROUNDING)


@every_case
def test_inverse_dynamics_and_ground_reaction_agree(name):
    """The stance's torques and Newton's force at the foot carry the same motion of the floating robot.

    The passive rows of a motion that nobody drives vanish; here they are the ankle's moment, so the random
    motion is that of both robots under the same wrench.
    """
    mode = mode_of(name)
    q, v, a = random_state(mode)
    stance, floating = mode.robot.model, mode.floating.model
    torque, force = pin.rnea(stance, stance.createData(), q, v, a), mode.ground_reaction(q, v, a)
    state = mode.lifted(q, v, a)
    data = floating.createData()
    frame = floating.getFrameId(mode.floating.contact(mode.contact).frame)
    jacobian = pin.computeFrameJacobian(floating, data, state[0], frame, pin.LOCAL_WORLD_ALIGNED)
    needed = pin.rnea(floating, data, *state)
    root, n = stance.jointPlacements[1].rotation, mode.robot.n_unactuated
    ankle = stance.createData()
    pin.forwardKinematics(stance, ankle, q)
    moment = root[:, 2] * torque[0] if n == 1 else ankle.oMi[1].rotation @ torque[:3]
    left = needed - jacobian.T @ np.concatenate([force, moment])
    base = mode.floating.n_unactuated
    assert_allclose(left[:base], 0, atol=ROUNDING)
    assert_allclose(left[base:][mode.torque_rows], torque[n:], atol=ROUNDING)


@every_case
def test_newtons_force_is_what_pinocchio_transmits_through_the_ankle(name):
    mode = mode_of(name)
    state, model = random_state(mode), mode.robot.model
    data = model.createData()
    pin.rnea(model, data, *state)
    assert_allclose(data.liMi[1].rotation @ data.f[1].linear, mode.ground_reaction(*state), atol=ROUNDING)


def test_ground_reaction_is_the_sum_over_links_of_mass_times_felt_acceleration():
    mode = mode_of("hopper")
    model, state = pin.Model(mode.robot.model), random_state(mode)
    total = np.zeros(3)
    for joint in range(1, model.njoints):
        centre = pin.Frame(
            f"centre {joint}", joint, 0, pin.SE3(np.eye(3), model.inertias[joint].lever), pin.OP_FRAME
        )
        number = model.addFrame(centre, False)
        extended = model.createData()
        pin.forwardKinematics(model, extended, *state)
        acceleration = pin.getFrameClassicalAcceleration(model, extended, number, pin.LOCAL_WORLD_ALIGNED)
        total += model.inertias[joint].mass * (acceleration.linear - model.gravity.linear)
    assert_allclose(mode.ground_reaction(*state), total, atol=ROUNDING)


@pytest.mark.parametrize("name", ["hopper", "solo12", "wheel"])
def test_maps_are_smooth_functions_of_symbols(name):
    mode = mode_of(name)
    for function, rows in ((mode.lift, mode.robot), (mode.drop, mode.floating), (mode.reaction, mode.robot)):
        point = [np.zeros(function.size1_in(i)) for i in range(function.n_in())]
        point[0] = pin.neutral(rows.model)
        derivative = ca.Function.jacobian(function)
        outputs = [np.zeros(function.size1_out(i)) for i in range(function.n_out())]
        assert all(np.isfinite(np.array(block)).all() for block in derivative.call([*point, *outputs]))


def standing_problem(robot: Robot, contacts: tuple[str, ...], q: np.ndarray, v: np.ndarray) -> Problem:
    """Effort against posture for a moment, from a given push; costs that mean the same in all coordinates."""
    return Problem(
        name="push",
        robot=robot,
        schedule=Schedule((Phase(name="stance", duration=0.2, contacts=contacts),)),
        initial_q=q,
        initial_v=v,
        terms=(
            TorqueCost(weight=1.0),
            AccelerationCost(weight=1e-2, joints_only=True),
            VelocityCost(weight=1e-2, joints_only=True),
            PostureCost(weight=1.0),
        ),
        guess=lambda t: q,
        default_intervals=8,
        default_transcription="legendre:3",
    )


@pytest.mark.long
@pytest.mark.parametrize("name", ["hopper", "bolt"])
def test_one_stance_has_the_same_optimum_in_minimal_and_in_excess_coordinates(name):
    mode = mode_of(name)
    q, push = mode.robot.reference, np.random.default_rng(5).uniform(-0.5, 0.5, mode.robot.nv)
    small = solve(standing_problem(mode.robot, (), q, push))
    contact = mode.floating.contact(mode.contact)
    lifted_q, lifted_v, _ = mode.lifted(q, push)
    large = solve(standing_problem(mode.floating, (contact.name,), lifted_q, lifted_v))
    assert small.converged, small.statistics.advice
    assert large.converged, large.statistics.advice
    for found in (small, large):  # nothing keeps Bolt's other foot above the ground here
        assert set(check(found).failures(AT_POINTS)) <= {"penetration"}, str(check(found))
    assert small.statistics.variables < large.statistics.variables
    assert small.statistics.objective == pytest.approx(large.statistics.objective, rel=SAME_OPTIMUM)
    scale = mode.floating.weight * mode.floating.length
    assert_allclose(large.tau[:, mode.torque_rows], small.tau, atol=SAME_PATH * scale)
    place = [other.name for other in mode.floating.contacts].index(contact.name)
    for k in np.flatnonzero(small.collocation):
        state = (small.q[k], small.v[k], small.a[k])
        moved = pin.difference(mode.floating.model, mode.lifted(*state)[0], large.q[k])
        assert np.abs(moved).max() < SAME_PATH
        assert_allclose(
            mode.ground_reaction(*state), large.f[k, place, :3], atol=SAME_PATH * mode.floating.weight
        )


@every_case
def test_joints_are_in_the_depth_first_order_that_pinocchio_wants(name):
    model = mode_of(name).robot.model
    assert model.check(model.createData())


def test_limits_armature_and_drives_stay_with_their_joints():
    robot = robots.load("hopper")
    strong = Drive(gear_ratio=5.0, rotor_inertia=1e-4, torque_limit=3.0)
    driven = robot.with_drives({"knee": strong})
    stance = stance_mode(driven, "foot").robot
    knee, hip = 0, 1
    assert_array_equal(stance.torque_limit[[hip, knee]], driven.torque_limit)
    assert (stance.drives[knee], stance.drives[hip]) == (strong, None)
    assert_array_equal(stance.model.armature, [0, *driven.model.armature[[4, 3]]])
    assert_array_equal(stance.position_lower[1:], driven.position_lower[[5, 4]])
    assert np.isinf(stance.position_lower[0])
    assert_array_equal(stance.velocity_limit[1:], driven.velocity_limit[[4, 3]])


def test_both_coordinates_have_the_same_units_and_reference():
    mode = mode_of("solo12")
    ours, theirs = Units(mode.robot), Units(mode.floating)
    assert (ours.length, ours.force, ours.time) == pytest.approx((theirs.length, theirs.force, theirs.time))
    lifted, _, _ = mode.lifted(mode.robot.reference)
    assert np.abs(pin.difference(mode.floating.model, mode.floating.reference, lifted)).max() < ROUNDING
    assert [contact.name for contact in mode.robot.contacts] == ["FL_FOOT", "FR_FOOT", "HR_FOOT"]


def test_the_anchor_is_where_the_model_stands():
    mode = stance_mode(robots.load("hopper"), "foot", anchor=[0.5, 7.0, 0.1])
    foot = placement(mode.robot.model, random_state(mode)[0], "foot").translation
    assert_allclose(foot, [0.5, 0.0, 0.1], atol=ROUNDING)  # a planar robot stays in its plane


@pytest.mark.long
def test_pictures_hang_on_the_turned_links():
    mode = mode_of("solo12")
    q, _, _ = random_state(mode)
    placed = []
    for robot, state in ((mode.robot, q), (mode.floating, mode.lifted(q)[0])):
        geometry = mode.floating.visual.geometry(robot.model)
        data = geometry.createData()
        pin.updateGeometryPlacements(robot.model, robot.model.createData(), geometry, data, state)
        placed.append(np.array([placement.homogeneous for placement in data.oMg]))
    assert_allclose(placed[0], placed[1], atol=ROUNDING)


test_what_has_no_stance_mode_is_refused = refusals(
    lambda make, contact, anchor: stance_mode(make(), contact, anchor=anchor),
    (lambda: robots.load("ur5"), "tool0", None, "has base='fixed'"),
    (lambda: robots.load("solo12"), "hand", None, "has no contact 'hand'"),
    (lambda: hopper("surface"), FOOT, None, "is a surface; a point contact"),
    (lambda: robots.load("hopper"), "foot", [0.0, np.nan, 0.0], "3 finite numbers"),
    (lambda: robots.load("hopper"), "foot", [0.0, 0.0], "3 finite numbers"),
)


def test_a_planar_robot_whose_leg_leaves_the_plane_is_refused():
    robot = Robot.from_urdf(robot_file("go2_description/urdf/go2.urdf"), base="planar", contacts=["FL_foot"])
    with pytest.raises(InputError, match=r"'FL_hip_joint' leaves the plane.*lock it"):
        stance_mode(robot, "FL_foot")


def test_a_ball_joint_in_the_leg_is_refused():
    model = pin.Model(hopper().model)
    ball = model.addJoint(model.getJointId("shank"), pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(ball, pin.Inertia.FromSphere(0.1, 0.05), pin.SE3.Identity())
    model.addFrame(pin.Frame("toe", ball, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = Robot.from_model(model, contacts=[Contact(frame="toe")])
    with pytest.raises(UnsupportedJointError, match=r"'ball' is of kind Spherical.*one degree of freedom"):
        stance_mode(robot, "toe")


test_passive_joints_must_exist_and_are_named_once = refusals(
    lambda passive: Robot.from_model(robots.load("hopper").model, passive=passive),
    (("elbow",), "'elbow' is unknown"),
    (("root_joint",), "'root_joint' is unknown; one of hip, knee"),
    (("hip", "hip"), "'hip' is named twice"),
)


def test_passive_joints_follow_the_base_and_leave_with_a_lock():
    robot = Robot.from_model(robots.load("hopper").model, passive=["hip"])
    assert (robot.n_unactuated, robot.nu, len(robot.torque_limit)) == (4, 1, 1)
    locked = robot.with_locked(["hip"])
    assert (locked.passive, locked.n_unactuated, locked.nu) == ((), 3, 1)
    assert_array_equal(locked.torque_limit, robot.torque_limit)


def test_any_joint_may_be_passive():
    hopper = robots.load("hopper")
    robot = Robot.from_model(hopper.model, passive=["knee"])
    assert_array_equal(robot.unactuated_rows, [0, 1, 2, 4])
    assert_array_equal(robot.actuated_rows, [3])
    assert_array_equal(robot.torque_limit, hopper.torque_limit[:1])
    assert robot.with_locked(["hip"]).nu == 0
