"""Robots on walls, slopes and handles, humanoids on hands and feet, and the IRB 1600 against its drawing."""

import math
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import linprog

import trajopt
from tests.support.models import placement
from tests.support.refusals import refusals, refused
from tests.support.solved_problems import motion
from trajopt import Problem, Robot, Solution, check
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics import contact_jacobian, gravity_of
from trajopt.dynamics.model_quantities import mass_of
from trajopt.robot import biped_legs, contact_poses
from trajopt.robot.contact import centre_of_pressure
from trajopt.solving.solving import solve
from trajopt_library import problems, robots
from trajopt_library.problems import bipeds
from trajopt_library.problems.irb1600_transfer import nearest_posture
from trajopt_library.robots import irb1600

MOST_ITERATIONS = 60
TOLERANCE = 1e-8
REST = 1e-2  # rad/s, m/s: what eight intervals leave in the velocity of the soles
FORCE = 1e-6  # parts of the weight: what the solver's tolerance leaves in a force
SAME_FORCE = 1e-4  # parts of a force: the optimum is flat, its minimiser less sharp than its value


@lru_cache
def solved(name: str, intervals: int, **parameters: float) -> Solution:
    """The problem's solution from its own guess."""
    problem = problems.load(name, **parameters)
    return solve(
        problem,
        intervals=intervals,
        tolerance=TOLERANCE if name == "ur5-pull" else 1e-6,
        max_iterations=MOST_ITERATIONS,
    )


def assert_sound(solution: Solution) -> None:
    assert solution.converged, solution.statistics.advice
    assert solution.statistics.iterations <= MOST_ITERATIONS
    report = check(solution)
    assert report.within(AT_POINTS), report.failures(AT_POINTS)


def samples_of(solution: Solution, phase: str) -> np.ndarray:
    """Collocation points of a phase."""
    index = solution.description.phase_names.index(phase)
    return np.flatnonzero((solution.phase == index) & solution.collocation)


def weight_of(solution: Solution) -> float:
    return mass_of(solution.model) * gravity_of(solution.model)


# UR5 at a handle


def test_arm_pulls_a_handle_that_only_a_grasp_can_hold():
    solution = solved("ur5-pull", 12)
    assert_sound(solution)
    board = solution.description.surfaces[2]["grip"]
    force = solution.f[samples_of(solution, "pull"), 0, :3] @ board.normal
    assert np.all(force <= -60.0 + FORCE * weight_of(solution))
    assert solution.description.surfaces[0] == {}
    assert board.bilateral


def test_pull_is_the_least_torques_that_hold_the_force():
    """The arm is clamped: at each point the wrench minimises a quadratic cost with one active bound."""
    solution = solved("ur5-pull", 12)
    problem: Problem = problems.load("ur5-pull")
    board, model = problem.schedule.phases[2].surfaces["grip"], solution.model
    row = samples_of(solution, "pull")[0]
    q, still = solution.q[row], np.zeros(model.nv)
    jacobian = contact_jacobian(model, q, [("grip", 6)])
    gravity = pin.rnea(model, model.createData(), q, still, still)
    weight, length = problem.robot.weight, problem.robot.length
    # mean squares of torque over m g l and of the wrench over (m g, m g l), weights 1 and 0.01
    unit = np.array([weight] * 3 + [weight * length] * 3)
    quadratic = jacobian @ jacobian.T / (weight * length) ** 2 / 6 + 0.01 * np.diag(unit**-2) / 6
    linear = -jacobian @ gravity / (weight * length) ** 2 / 6
    normal = np.concatenate([board.normal, np.zeros(3)])
    kkt = np.block([[quadratic, normal[:, None]], [normal[None], np.zeros((1, 1))]])
    wrench = np.linalg.solve(kkt, np.append(-linear, -60.0))[:6]
    assert_allclose(solution.f[row, 0] / unit, wrench / unit, atol=SAME_FORCE * 60.0 / weight)


def test_arm_does_not_move_once_it_holds_the_handle():
    solution = solved("ur5-pull", 12)
    held = solution.phase > 0
    assert np.abs(np.diff(solution.q[held], axis=0)).max() < TOLERANCE


# Solo12 on a slope


@pytest.mark.slow
def test_quadruped_hops_uphill_and_downhill():
    for slope, distance in ((np.radians(20), 0.1), (np.radians(-15), 0.05)):
        solution = solved("solo12-slope", 18, slope=slope, distance=distance)
        assert_sound(solution)
        normal = np.array([-np.sin(slope), 0.0, np.cos(slope)])
        assert_allclose(solution.description.terrain.normal, normal)
        data, heights = solution.model.createData(), []
        radius = solution.meta["contact_radius"][0]
        for q in solution.q:
            pin.framesForwardKinematics(solution.model, data, q)
            feet = [data.oMf[solution.model.getFrameId(name)].translation for name in solution.contact_frames]
            heights.append([foot @ normal - radius for foot in feet])
        assert np.min(heights) > -1e-3
        assert np.max(np.abs(np.array(heights)[solution.active])) < 1e-3
        force = solution.f[solution.active & solution.collocation[:, None], :3]
        pressed = force @ normal
        sideways = np.linalg.norm(force - pressed[:, None] * normal, axis=1)
        assert np.all(sideways <= 0.8 * pressed + FORCE * weight_of(solution))
        travel = solution.q[-1, :3] - solution.q[0, :3]
        assert_allclose(travel, distance * np.array([np.cos(slope), 0.0, np.sin(slope)]), atol=1e-3)


# Talos at a wall


def talos(force: float, intervals: int = 8, **parameters: float) -> Solution:
    return solved("talos-wall", intervals, force=force, **parameters)


def sole_pressures(solution: Solution, rows: np.ndarray) -> np.ndarray:
    """Centres of pressure (n, 2, 2) of both soles in their own axes, m."""
    data, found = solution.model.createData(), []
    for row in rows:
        pin.framesForwardKinematics(solution.model, data, solution.q[row])
        for index, frame in enumerate(("left_sole_link", "right_sole_link")):
            rotation = data.oMf[solution.model.getFrameId(frame)].rotation
            force, moment = solution.f[row, index, :3], solution.f[row, index, 3:]
            found.append((rotation.T @ centre_of_pressure(force, moment, np.array([0.0, 0.0, 1.0])))[:2])
    return np.array(found).reshape(len(rows), 2, 2)


@pytest.mark.slow
@pytest.mark.parametrize(("force", "tilt"), [(80.0, 0.3), (-100.0, 0.0)])
def test_humanoid_pushes_and_pulls_with_its_hand(force, tilt):
    solution = talos(force, tilt=tilt, intervals=8 if force > 0 else 12)
    assert_sound(solution)
    wall = solution.description.surfaces[2]["wrist_left_ft_tool_link"]
    rows = samples_of(solution, "push")
    along = solution.f[rows, 2, :3] @ wall.normal
    slack = FORCE * weight_of(solution)
    assert np.all(along >= force - slack) if force > 0 else np.all(along <= force + slack)
    assert wall.bilateral == (force < 0)
    pressures = np.abs(sole_pressures(solution, np.flatnonzero(solution.collocation)))
    assert np.all(pressures <= np.array([0.1, 0.06]) + 1e-5)


@pytest.mark.slow
def test_humanoid_leans_beyond_its_feet_where_only_the_wall_holds_it():
    solution = talos(180.0)
    assert_sound(solution)
    model, data = solution.model, solution.model.createData()
    centre = pin.centerOfMass(model, data, solution.q[-1]).copy()
    pin.framesForwardKinematics(model, data, solution.q[-1])
    toes = data.oMf[model.getFrameId("left_sole_link")].act(np.array([0.1, 0.0, 0.0]))
    assert centre[0] > toes[0]
    assert np.abs(solution.v[-1]).max() < REST


@pytest.mark.slow
def test_wrench_of_every_sole_is_a_sum_of_coulomb_forces_at_its_corners():
    solution = talos(180.0)
    model, data = solution.model, solution.model.createData()
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    rim = np.column_stack([0.7 * np.cos(angles), 0.7 * np.sin(angles), np.ones(16)])
    corners = [np.array([x, y, 0.0]) for x in (-0.1, 0.1) for y in (-0.06, 0.06)]
    edges = np.array([np.concatenate([force, np.cross(at, force)]) for at in corners for force in rim])
    for row in np.flatnonzero(solution.collocation):
        pin.framesForwardKinematics(model, data, solution.q[row])
        for index, frame in enumerate(("left_sole_link", "right_sole_link")):
            turn = data.oMf[model.getFrameId(frame)].rotation.T
            wrench = np.concatenate([turn @ solution.f[row, index, :3], turn @ solution.f[row, index, 3:]])
            weight = weight_of(solution)
            # how far the wrench is from the cone, in parts of the weight
            size = edges.shape[0]
            slack = np.vstack([np.eye(6), -np.eye(6)])
            found = linprog(
                np.concatenate([np.zeros(size), np.ones(12)]),
                A_eq=np.vstack([edges, slack]).T,
                b_eq=wrench / weight,
            )
            assert found.fun < 1e-5


# Inverse kinematics of the library's postures; forces of a solver at 1e-6 over the weight.
PLACED, HAND_FORCE = 1e-4, 1e-5
FAMILIES = ("humanoid-climb", "humanoid-lean", "humanoid-push-off")
# The centre of mass is at least this far beyond the toes where hands are needed, m.
BEYOND = 0.05


def beyond_toes(robot: Robot, q: np.ndarray) -> float:
    """How far the centre of mass is ahead of the front edges of both soles, m."""
    poses = contact_poses(robot, q)
    toes = [poses[foot].act(np.array([robot.contact(foot).half_length, 0, 0])) for foot in biped_legs(robot)]
    return float(pin.centerOfMass(robot.model, robot.model.createData(), q)[0] - max(toe[0] for toe in toes))


@lru_cache
def certified(name: str) -> Solution:
    solution = motion(name)
    report = check(solution)
    assert solution.converged
    assert not report.failures(), report.failures()
    return solution


def forces(solution: Solution, phase: str, hand: str) -> np.ndarray:
    """Forces (n, 3) of a hand at a phase's collocation points, N."""
    rows = (solution.phase == solution.description.phase_names.index(phase)) & solution.collocation
    return solution.f[rows, list(solution.contact_frames).index(hand), :3]


@pytest.mark.parametrize("name", bipeds.HUMANOIDS)
def test_hands_are_mirror_images_and_feet_stand_as_without_arms(name):
    robot, legs = bipeds.humanoid(name), bipeds.biped(name.removesuffix("_arms"))
    poses, feet = contact_poses(robot, robot.reference), contact_poses(legs, legs.reference)
    left, right = (poses[hand].translation for hand in bipeds.hands(robot))
    assert left == pytest.approx(right * [1, -1, 1], abs=PLACED)
    assert all(poses[foot].isApprox(feet[foot], 1e-9) for foot in feet)
    assert robot.mass == pytest.approx(legs.mass)


@pytest.mark.parametrize("name", FAMILIES)
def test_guess_has_every_contact_in_its_place(name):
    problem, begin = problems.load(name), 0.0
    for index, phase in enumerate(problem.schedule.phases):
        for part in (1e-6, 0.3, 0.7, 1 - 1e-6):
            poses = contact_poses(problem.robot, problem.guess(begin + part * phase.duration))
            for contact in phase.contacts:
                place = problem.contact_place(contact, index)
                assert place is None or poses[contact].translation == pytest.approx(place, abs=PLACED)
        begin += phase.duration


@pytest.mark.parametrize("robot", bipeds.HUMANOIDS)
def test_who_pushes_off_starts_where_soles_alone_cannot_hold_it(robot):
    problem = problems.load("humanoid-push-off", robot=robot)
    assert beyond_toes(problem.robot, problem.initial_q) > BEYOND


test_settings_that_cannot_be_are_refused_in_one_line = refusals(
    lambda name, parameters: problems.load(name, **parameters),
    ("humanoid-push-off", {"lean": 0.8}, "cannot lean by 0.8 rad, soles flat; allowed: up to"),
    ("humanoid-push-off", {"distance": 1.5}, "miss a wall 1.5 m"),
    ("humanoid-push-off", {"robot": "bolt"}, "contacts that are not feet"),
    ("humanoid-lean", {"reach": 1.5}, "miss the goal beyond the table by"),
    ("humanoid-lean", {"distance": 1.5}, "miss the table by"),
    ("humanoid-climb", {"rail": 1.6}, "in phase 'left_hand_1'"),
    ("humanoid-climb", {"run": 0.15}, "steps are 0.15 m deep for soles of 0.17 m"),
    ("humanoid-climb", {"steps": 1.5}, "allowed: a whole number"),
)


@pytest.mark.slow
def test_hands_only_push_on_the_wall_and_let_go_of_a_standing_robot():
    solution = certified("humanoid-push-off")
    for hand in ("left_hand", "right_hand"):
        force = forces(solution, "push", hand)
        assert (force[:, 0] < 0).all()  # the wall is ahead: its normal is -x
        assert (np.linalg.norm(force[:, 1:], axis=1) <= -0.5 * force[:, 0] + HAND_FORCE * 1e3).all()
        assert not forces(solution, "recover", hand).any()
    assert solution.q[-1] == pytest.approx(bipeds.humanoid("g1_arms").reference, abs=1e-5)


@pytest.mark.slow
def test_who_leans_rests_on_the_table_beyond_its_toes():
    solution, robot = certified("humanoid-lean"), bipeds.humanoid("g1_arms")
    assert beyond_toes(robot, solution.q[-1]) > BEYOND
    assert np.abs(solution.v[-1]).max() < 1e-4
    weight = mass_of(solution.model) * gravity_of(solution.model)
    assert forces(solution, "stretch", "left_hand")[-1, 2] > 0.1 * weight


@pytest.mark.slow
def test_who_climbs_stands_a_step_higher():
    solution, robot = certified("humanoid-climb"), bipeds.humanoid("g1_arms")
    before, after = (contact_poses(robot, q) for q in (robot.reference, solution.q[-1]))
    for foot in biped_legs(robot):
        way = after[foot].translation - before[foot].translation
        assert way == pytest.approx([0.45 * robot.reference[2], 0.0, 0.35 * robot.reference[2]], abs=1e-5)
        assert after[foot].rotation[:, 2] == pytest.approx([0, 0, 1], abs=1e-5)
    # soles land at any yaw, with which the base's place goes: 3 mm at 0.2 rad
    assert solution.q[-1, :3] == pytest.approx(robot.reference[:3] + way, abs=0.01)


ROUNDING = 1e-12
# Payload that the data sheet allows, kg.
RATED = 8.0
# A row at its limit, by what an interior point leaves at a tolerance of 1e-6, and then some.
AT_LIMIT = 1e-2
# Part of a time-optimal motion in which nothing is at a limit: a few intervals around each switch.
SWITCHES = 0.15
INTERVALS = 30


def test_tool_is_where_the_drawing_has_it():
    """At zero: 0.15 + 0.6 + 0.065 m forward, 0.4865 + 0.7 m up; stretched forward 1.45 m to the wrist."""
    robot = irb1600.build()
    tool = placement(robot.model, np.zeros(6), irb1600.TOOL)
    assert_allclose(tool.translation, [0.815, 0.0, 1.1865], atol=ROUNDING)
    assert_allclose(tool.rotation[:, 2], [1.0, 0.0, 0.0], atol=ROUNDING)
    stretched = np.array([0.0, math.pi / 2, -math.pi / 2, 0.0, 0.0, 0.0])
    wrist = placement(robot.model, stretched, "joint_5")
    assert_allclose(wrist.translation, [1.45, 0.0, 0.4865], atol=ROUNDING)


def test_positive_joint_angles_turn_left_forward_and_down():
    robot = irb1600.build()
    moved = [placement(robot.model, 0.1 * np.eye(6)[i], irb1600.TOOL).translation for i in range(3)]
    assert moved[0][1] > 0
    assert moved[1][0] > 0.815
    assert moved[2][2] < 1.1865


def test_motors_hold_the_arm_with_its_load_in_every_posture():
    """Gravity torques stay within half of the limits that were read out of the garbled table."""
    robot = irb1600.build(payload=RATED)
    data, generator = robot.model.createData(), np.random.default_rng(0)
    stretched = np.array([0.0, math.pi / 2, -math.pi / 2, 0.0, 0.0, 0.0])
    postures = [stretched, *generator.uniform(robot.position_lower, robot.position_upper, (200, 6))]
    for q in postures:
        gravity = pin.computeGeneralizedGravity(robot.model, data, q)
        assert (np.abs(gravity) < 0.5 * robot.torque_limit).all()


def test_joint_side_limits_are_motor_torques_times_gear_ratios():
    robot = irb1600.build()
    assert_allclose(robot.torque_limit, [600, 1000, 500, 36, 36, 20], rtol=ROUNDING)
    assert_allclose(np.degrees(robot.velocity_limit), [180, 180, 200, 400, 400, 460])


@pytest.mark.parametrize("share", [0.5, 0.75, 1.0])
def test_reflected_motor_inertia_is_that_share_of_what_each_axis_moves(share):
    bare, geared = irb1600.build(motor_inertia=0.0), irb1600.build(motor_inertia=share)
    q = np.array(irb1600.REFERENCE)
    moved = np.diag(pin.crba(bare.model, bare.model.createData(), q))
    total = np.diag(pin.crba(geared.model, geared.model.createData(), q))
    assert_allclose(total, (1 + share) * moved, rtol=1e-12)


def test_payload_adds_its_mass_beyond_the_flange_and_leaves_the_motors():
    bare, loaded = irb1600.build(), irb1600.build(payload=RATED)
    assert loaded.mass - bare.mass == pytest.approx(RATED, rel=1e-12)
    assert_allclose(loaded.model.armature, bare.model.armature)
    side = (RATED / 7850.0) ** (1 / 3)
    moment = loaded.model.inertias[6].mass * loaded.model.inertias[6].lever[0]
    own = bare.model.inertias[6].mass * bare.model.inertias[6].lever[0]
    assert moment - own == pytest.approx(RATED * side / 2, rel=1e-9)


test_arms_that_cannot_be_are_refused = refusals(
    lambda change: irb1600.build(**change),
    ({"payload": -1.0}, "payload of the IRB 1600"),
    ({"motor_inertia": float("nan")}, "motor_inertia of the IRB 1600"),
    ({"material": "wood"}, "steel, aluminium, iron"),
)


@pytest.mark.long
def test_start_and_goal_hold_the_tool_where_it_was_asked():
    robot = robots.load("irb1600")
    q = nearest_posture(robot, np.array([0.7, 0.8, 1.1]), math.pi / 3, robot.reference)
    tool = placement(robot.model, q, irb1600.TOOL)
    assert_allclose(tool.translation, [0.7, 0.8, 1.1], atol=1e-9)
    assert tool.rotation[2, 2] == pytest.approx(-math.sin(math.pi / 3))
    with refused("cannot bring its tool"):
        nearest_posture(robot, np.array([2.0, 0.0, 1.0]), 0.0, robot.reference)


@pytest.mark.slow
def test_transfer_of_least_effort_is_solved_and_slower_is_cheaper():
    costs = []
    for duration in (1.2, 1.8):
        problem = problems.load("irb1600-transfer", duration=duration)
        solution = trajopt.solve(problem, intervals=INTERVALS)
        assert solution.converged
        assert solution.statistics.iterations <= 60
        assert trajopt.check(solution).within(AT_POINTS)
        costs.append(mean_motor_torque(problem, solution))
    assert costs[1] < costs[0]


def mean_motor_torque(problem, solution) -> float:
    """Mean square of motor torque over its limit, from the file's torques, weighted by time."""
    share = solution.tau / problem.robot.torque_limit
    points = solution.collocation
    return float(np.mean(share[points] ** 2))


@pytest.mark.slow
def test_transfer_of_least_time_is_at_a_limit_almost_always():
    """Pontryagin: while the duration can be shortened, some drive or some rate has no reserve."""
    problem = problems.load("irb1600-transfer", goal="time")
    solution = trajopt.solve(problem, intervals=2 * INTERVALS)
    assert solution.converged
    assert solution.statistics.iterations <= 60
    assert trajopt.check(solution).within(AT_POINTS)
    points = solution.collocation
    torque = np.abs(solution.tau[points]) / problem.robot.torque_limit
    rate = np.abs(solution.v[points]) / problem.robot.velocity_limit
    busiest = np.maximum(torque, rate).max(axis=1)
    assert np.mean(busiest < 1 - AT_LIMIT) < SWITCHES
    travel = np.abs(solution.q[-1] - solution.q[0])
    assert solution.t[-1] > (travel / problem.robot.velocity_limit).max()


def test_more_payload_and_larger_motors_take_longer_to_accelerate():
    """Acceleration of the second joint at full torque from rest, by forward dynamics."""
    found = []
    for change in ({}, {"payload": RATED}, {"payload": RATED, "motor_inertia": 1.0}):
        robot = irb1600.build(**change)
        tau = np.zeros(6)
        tau[1] = robot.torque_limit[1]
        q = np.array(irb1600.REFERENCE)
        found.append(pin.aba(robot.model, robot.model.createData(), q, np.zeros(6), tau)[1])
    assert found == sorted(found, reverse=True)
