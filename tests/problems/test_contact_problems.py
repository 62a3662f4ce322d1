"""Robots on walls, slopes and handles, and humanoids on hands and feet: solved and checked."""

from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import linprog

from tests.support.solved_problems import motion
from trajopt.certify.check import check
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics.model_quantities import contact_jacobian, gravity_of, mass_of
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.robot import Robot, biped_legs, contact_poses
from trajopt.robot.contact import centre_of_pressure
from trajopt.solving.solving import solve
from trajopt_library import problems
from trajopt_library.problems import bipeds

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


@pytest.mark.parametrize(
    ("name", "parameters", "words"),
    [
        ("humanoid-push-off", {"lean": 0.8}, "cannot lean by 0.8 rad, soles flat; allowed: up to"),
        ("humanoid-push-off", {"distance": 1.5}, "miss a wall 1.5 m"),
        ("humanoid-push-off", {"robot": "bolt"}, "contacts that are not feet"),
        ("humanoid-lean", {"reach": 1.5}, "miss the goal beyond the table by"),
        ("humanoid-lean", {"distance": 1.5}, "miss the table by"),
        ("humanoid-climb", {"rail": 1.6}, "in phase 'left_hand_1'"),
        ("humanoid-climb", {"run": 0.15}, "steps are 0.15 m deep for soles of 0.17 m"),
        ("humanoid-climb", {"steps": 1.5}, "allowed: a whole number"),
    ],
)
def test_settings_that_cannot_be_are_refused_in_one_line(name, parameters, words):
    with pytest.raises(InputError, match=words):
        problems.load(name, **parameters)


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
