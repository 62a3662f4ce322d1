"""Families for any arm: goals, limits, sliding, obstacles; and what families share."""

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.refusals import refusals, refused
from tests.support.solved_problems import motion
from trajopt import InputError, Problem, check
from trajopt.certify.report import AT_POINTS
from trajopt.collision import robot_shapes
from trajopt.problem.bodies import ProblemBodies, bodies_of
from trajopt.robot import contact_positions, frame_pose
from trajopt.solving.exchange import GAP_SLACK, Exchange
from trajopt.solving.graded import solve as solve_graded
from trajopt.solving.solving import solve as solve_on_mesh
from trajopt.terms import Clearance
from trajopt.terrain import smooth_step
from trajopt_library import problems, robots
from trajopt_library.problems import arm_avoid, arm_reach, arm_transfer, arm_wipe, arms, common
from trajopt_library.problems.arm_wipe import Stroke

# Rows of a solved problem hold to 1e-6 of the reach.
PLACE = 1e-5  # m
TURN = 1e-5  # rad
# The stroke's place follows from its acceleration by a scheme of fourth order over 40 intervals.
ON_STROKE = 1e-4  # m
# Collocation leaves a velocity within the plane at the end, of the same order.
AT_REST = 1e-3  # m/s
# Step of central differences, and what they leave of a second derivative of order 1.
STEP, DIFFERENCE = 1e-4, 1e-5


def solve(family, **values):
    problem = family.load(values)
    solution = trajopt.solve(problem, fixed_mesh=True)
    assert solution.converged
    assert trajopt.check(solution).within(AT_POINTS)
    return problem, solution


@pytest.mark.parametrize("name", arms.ARMS)
def test_a_pose_of_the_tool_is_its_reference_turned_and_moved(name):
    arm = arms.load(name)
    turn, out, up = 0.7, -0.05, 0.1
    pose, reference = arm.pose(turn, out, up), arm.at_reference
    about = pin.rpy.rpyToMatrix(0.0, 0.0, turn)
    np.testing.assert_allclose(pose.rotation, about @ reference.rotation, atol=1e-12)
    assert pose.translation[2] - reference.translation[2] == pytest.approx(up * arm.robot.length)
    np.testing.assert_allclose(arm.cylinder(pose.translation), (turn, out, up), atol=1e-12)


@pytest.mark.parametrize("name", arms.ARMS)
def test_the_tool_points_out_of_the_arm(name):
    arm = arms.load(name)
    outward, robot = arm.at_reference.rotation @ arm.outward, arm.robot
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.reference)
    wrist = data.oMi[robot.model.njoints - 3].translation
    assert np.linalg.norm(outward) == pytest.approx(1.0)
    assert outward @ (arm.at_reference.translation - wrist) > 0


@pytest.mark.parametrize("name", arms.ARMS)
@pytest.mark.parametrize("module", [arm_reach, arm_transfer, arm_wipe])
def test_families_build_on_every_arm_with_a_guess_within_the_limits(name, module):
    problem = module.FAMILY.load({"robot": name})
    robot, duration = problem.robot, problem.schedule.duration
    assert problem.parameters["robot"] == name
    for t in np.linspace(0.0, duration, 9):
        q = problem.guess(t)
        assert pin.isNormalized(robot.model, q, 1e-9)
        assert (q >= robot.position_lower - 1e-9).all()
        assert (q <= robot.position_upper + 1e-9).all()
    np.testing.assert_allclose(problem.guess(0.0), problem.initial_q, atol=1e-12)


def test_a_reach_ends_at_rest_at_its_pose():
    problem, solution = solve(arm_reach.FAMILY, robot="ur5", x=0.3, y=0.4, roll=0.3)
    arm = arms.load("ur5")
    pose = frame_pose(problem.robot, solution.q[-1], arm.tool)
    where = arm.cylinder(pose.translation)
    goal = pin.rpy.rpyToMatrix(0.3, 0.0, 0.0) @ arm.pose(*where).rotation
    np.testing.assert_allclose(pose.translation[:2], (0.3, 0.4), atol=PLACE)
    default = arm.pose(arm_reach.TURN, 0.0, arm_reach.UP).translation
    assert pose.translation[2] == pytest.approx(default[2], abs=PLACE)
    assert np.linalg.norm(pin.log3(goal.T @ pose.rotation)) < TURN
    np.testing.assert_allclose(solution.v[-1], 0.0, atol=TURN)


def test_the_fastest_transfer_binds_limits_and_beats_its_guess():
    problem, solution = solve(arm_transfer.FAMILY, robot="ur5")
    robot, points = problem.robot, solution.collocation
    assert solution.t[-1] < problem.schedule.duration
    used = np.maximum(
        np.abs(solution.tau[points] / robot.torque_limit).max(axis=1),
        np.abs(solution.v[points] / robot.velocity_limit).max(axis=1),
    )
    assert np.mean(used > 0.99) > 0.9  # of the motion some limit binds


@pytest.mark.long
def test_a_slower_transfer_needs_less_torque_than_the_fastest():
    _, fast = solve(arm_transfer.FAMILY, robot="ur5")
    _, slow = solve(arm_transfer.FAMILY, robot="ur5", goal="effort")
    squares = [np.mean(s.tau[s.collocation] ** 2) for s in (fast, slow)]
    assert squares[1] < squares[0]


@pytest.mark.parametrize("shape", ["line", "circle"])
def test_a_stroke_moves_as_its_acceleration_says(shape):
    stroke = Stroke(
        shape=shape,
        size=0.4,
        centre=np.array([0.5, 0.1, 0.2]),
        across=np.array([0.0, 1.0, 0.0]),
        along=np.array([0.6, 0.0, 0.8]),
    )
    duration = 1.7

    def place(t: float) -> np.ndarray:
        s = t / duration
        return stroke(10 * s**3 - 15 * s**4 + 6 * s**5)

    for t in np.linspace(0.1, 1.6, 7):
        second = (place(t + STEP) - 2 * place(t) + place(t - STEP)) / STEP**2
        np.testing.assert_allclose(stroke.acceleration(t, duration), second, atol=DIFFERENCE)


@pytest.mark.parametrize("shape", ["line", "circle"])
def test_a_wiping_tool_follows_its_stroke_with_the_force_and_friction_asked_for(shape):
    force, friction = 30.0, 0.4
    problem, solution = solve(
        arm_wipe.FAMILY, robot="ur5", shape=shape, force=force, friction=friction, tilt=0.3, out=0.1
    )
    robot, surface = problem.robot, problem.schedule.phases[0].surfaces[arm_wipe.TOOL]
    frame, data = robot.model.getFrameId(arms.load("ur5").tool), robot.model.createData()
    length = math.pi * problem.parameters["size"] if shape == "circle" else problem.parameters["size"]
    travelled, last = 0.0, None
    for row in range(solution.n_samples):
        pin.forwardKinematics(robot.model, data, solution.q[row], solution.v[row])
        place = pin.updateFramePlacement(robot.model, data, frame).translation.copy()
        assert abs(surface.distance(place)) < ON_STROKE
        travelled += 0.0 if last is None else float(np.linalg.norm(place - last))
        last = place
        if solution.collocation[row]:
            velocity = pin.getFrameVelocity(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
            along = velocity - (surface.normal @ velocity) * surface.normal
            wanted = force * (
                surface.normal - friction * along / np.sqrt(along @ along + surface.slip_speed**2)
            )
            np.testing.assert_allclose(solution.f[row, 0, :3], wanted, atol=1e-5 * robot.weight)
    assert travelled == pytest.approx(length, rel=1e-2)  # samples are chords of a circle
    end = pin.getFrameVelocity(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
    assert np.linalg.norm(end) < AT_REST


def test_the_check_notices_friction_along_the_sliding():
    _, solution = solve(arm_wipe.FAMILY, robot="ur5")
    assert trajopt.check(solution).sliding_friction < 1e-6
    turned = solution.f.copy()
    turned[:, 0, :2] *= -1.0
    report = trajopt.check(replace(solution, f=turned))
    assert "sliding_friction" in report.failures(AT_POINTS)


test_what_an_arm_cannot_do_is_refused_in_one_line = refusals(
    lambda module, values: module.FAMILY.load(values),
    (arm_reach, {"robot": "solo12"}, "not an arm"),
    (arm_reach, {"robot": "ur5", "x": 5.0}, "reach"),
    (arm_transfer, {"robot": "ur5", "out": 1.0}, "reach"),
    (arm_transfer, {"robot": "ur5", "turn": 0.0, "out": 0.0, "up": 0.0}, "same posture"),
    (arm_wipe, {"robot": "ur5", "size": 4.0}, "stroke"),
    (arm_wipe, {"robot": "ur5", "shape": "spiral"}, "line"),
)
LINK = (
    '<inertial><mass value="1"/><inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial>'
)
LIMIT = '<limit lower="-2.5" upper="2.5" effort="80" velocity="3"/>'


@pytest.fixture
def three_joints(tmp_path: Path) -> str:
    """The file of an arm that turns, lifts and bends."""
    axes = enumerate(("0 0 1", "0 1 0", "0 1 0"))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="0 0 0.3"/><axis xyz="{axis}"/>{LIMIT}</joint>'
        for k, axis in axes
    )
    links = "".join(f'<link name="l{k}">{LINK}</link>' for k in range(4))
    tool = '<link name="tool"/><joint name="end" type="fixed"><parent link="l3"/><child link="tool"/>'
    tool += '<origin xyz="0 0 0.3"/></joint>'
    (tmp_path / "three.urdf").write_text(f'<robot name="three">{links}{joints}{tool}</robot>')
    file = tmp_path / "three.py"
    file.write_text(
        "from pathlib import Path\nfrom trajopt import Robot\nTOOL = 'tool'\ndef build():\n"
        "    file = Path(__file__).parent / 'three.urdf'\n"
        "    return Robot.from_urdf(file, base='fixed', reference={'j1': 0.5, 'j2': 0.8})\n"
    )
    return str(file)


GOAL = {"x": 0.3, "y": 0.2, "z": 0.6}


@pytest.mark.parametrize(
    ("family", "values"),
    [
        ("arm-reach", GOAL),
        ("arm-transfer", {}),
        ("arm-pick-place", {}),
        ("arm-avoid", {}),
        ("arm-wipe", {"tilt": 0.3}),
    ],
)
def test_an_arm_with_few_joints_is_told_that_a_pose_has_six_rows(family, values, three_joints):
    with refused(r"six rows.*'three' 3 joints.*orientation=free"):
        trajopt.load(family, robot=three_joints, **values)


def test_an_arm_with_few_joints_reaches_a_place(three_joints):
    problem, solution = solve(arm_reach.FAMILY, robot=three_joints, orientation="free", **GOAL)
    place = frame_pose(problem.robot, solution.q[-1], "tool").translation
    np.testing.assert_allclose(place, list(GOAL.values()), atol=PLACE)


def test_a_free_orientation_contradicts_a_turn():
    with pytest.raises(InputError, match=r"orientation=free and a turn.*orientation=given"):
        trajopt.load("arm-reach", orientation="free", yaw=0.3)


def test_a_plane_that_faces_sideways_is_one_line(three_joints):
    with pytest.raises(InputError, match=r"faces sideways.*tilt"):
        trajopt.load("arm-wipe", robot=three_joints)


POSE = 1e-6  # m and 1; what the solver's tolerance leaves
BETWEEN = 2e-3  # m; between the looks, and what one more look would gain
OTHERS = ("xarm7", "z1")  # arms that the family does not name


@lru_cache
def problem(robot: str) -> Problem:
    return arm_avoid.FAMILY.load({"robot": robot})


@lru_cache
def bodies(robot: str) -> ProblemBodies:
    return bodies_of(problem(robot))


@pytest.mark.long
@pytest.mark.parametrize("robot", [*arm_avoid.FAMILY.robots, *OTHERS])
def test_straight_joint_path_collides_and_the_guess_does_not(robot):
    built = problem(robot)
    scene, model, duration = bodies(robot).scene, built.robot.model, built.schedule.phases[0].duration
    start, goal = built.guess(0.0), built.guess(duration)
    way = pin.difference(model, start, goal)
    times = np.linspace(0.0, 1.0, 60)
    straight = scene.least_distances(pin.integrate(model, start, float(smooth_step(s)) * way) for s in times)
    by_obstacle = {
        name: min(d for (_, other), d in zip(scene.pairs, straight, strict=True) if other == name)
        for name in ("box", "post")
    }
    assert max(by_obstacle.values()) < -0.01  # both are in the way
    along = scene.least_distances(built.guess(s * duration) for s in times)
    assert along[scene.n_ground :].min() > 0


@pytest.mark.parametrize("robot", arm_avoid.FAMILY.robots)
def test_guess_starts_and_ends_at_rest_at_the_ends(robot):
    built, step = problem(robot), 1e-4
    duration = built.schedule.phases[0].duration
    assert built.guess(0.0) == pytest.approx(built.initial_q)
    for end, inside in ((0.0, step), (duration, duration - step)):
        moved = pin.difference(built.robot.model, built.guess(end), built.guess(inside))
        assert np.abs(moved).max() < step**2 / duration


@pytest.mark.long
@pytest.mark.parametrize("robot", ["ur5", "irb1600"])
def test_solution_is_clear_and_brings_the_tool_to_its_goal(robot):
    built = problem(robot)
    solution = solve_graded(built, fixed_mesh=True)
    assert solution.success, solution.statistics.advice
    report, exchange = check(solution), Exchange(built)
    assert report.ok, report.failures()
    assert report.obstacle_distance > built_margin(robot) - GAP_SLACK
    assert exchange.missing(exchange.look(solution)) == ()
    (tool,) = {term.frame for term in built.terms if hasattr(term, "frame")}
    end = built.guess(built.schedule.phases[0].duration)
    goal, reached = (frame_pose(built.robot, q, tool) for q in (end, solution.q[-1]))
    assert np.abs(goal.homogeneous - reached.homogeneous).max() < POSE


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["panda", "kinova", *OTHERS])
def test_other_arms_get_past_too(robot):
    solution = motion("arm-avoid", robot=robot)
    assert solution.success, solution.statistics.advice
    assert check(solution).ok
    assert check(solution).obstacle_distance > built_margin(robot) - BETWEEN


@pytest.mark.long
def test_motion_keeps_no_more_than_the_margin():
    built = problem("ur5")
    exchange = Exchange(built)
    distances = exchange.look(solve_graded(built, fixed_mesh=True)).distances
    scene = exchange.bodies.scene
    least = distances[:, scene.n_ground : scene.n_outer].min()
    assert built_margin("ur5") - GAP_SLACK < least < built_margin("ur5") + BETWEEN


def test_motion_that_knows_no_obstacle_collides():
    solution = solve_on_mesh(problem("ur5"))
    assert check(solution).obstacle_distance < -0.01


def test_arm_has_the_shapes_of_its_description_or_boxes():
    assert bodies("ur5").scene.shapes == robot_shapes(problem("ur5").robot).shapes
    assert {shape.kind for shape in bodies("irb1600").scene.shapes} == {"box"}


def test_obstacles_scale_with_the_arm():
    sizes = [
        next(o for o in bodies(r).scene.obstacles if o.name == "post").radius / problem(r).robot.length
        for r in ("ur5", "irb1600")
    ]
    assert sizes[0] == pytest.approx(sizes[1])


def built_margin(robot: str) -> float:
    (term,) = (term for term in problem(robot).terms if isinstance(term, Clearance))
    return term.margin


def test_margin_is_a_share_of_the_reach():
    assert built_margin("ur5") == pytest.approx(0.01 * problem("ur5").robot.length)
    assert bodies("ur5").widest == pytest.approx(built_margin("ur5"))


test_bad_parameters_are_refused_in_one_line = refusals(
    lambda values: arm_avoid.FAMILY.load(values),
    ({"robot": "solo12"}, "no tool"),
    ({"radius": 1.0}, "ur5.* cannot bring"),
    ({"margin": 0.5}, "margin"),
    ({"turn": "200deg"}, "turn"),
)


def test_duration_may_be_given():
    built = arm_avoid.FAMILY.load({"duration": 3.0, "turn": math.radians(40)})
    assert built.schedule.phases[0].duration == 3.0
    assert built.parameters["duration"] == 3.0


PATH_STEP = 1e-5  # s, of one-sided differences


def test_only_modules_with_a_family_are_problems():
    assert "common" not in problems.families()
    assert "solo12-jump" in problems.families()


def test_hermite_cubic_has_the_values_and_rates_of_its_ends():
    start, start_rate, end, end_rate = np.random.default_rng(0).normal(size=(4, 3))

    def path(t):
        return common.hermite(t / 0.4, 0.4, start, start_rate, end, end_rate)

    assert_allclose(path(0.0), start, atol=1e-15)
    assert_allclose(path(0.4), end, atol=1e-15)
    # One-sided differences: the path stands still beyond its ends.
    assert_allclose((path(PATH_STEP) - start) / PATH_STEP, start_rate, atol=1e3 * PATH_STEP)
    assert_allclose((end - path(0.4 - PATH_STEP)) / PATH_STEP, end_rate, atol=1e3 * PATH_STEP)
    assert_allclose([path(-1.0), path(1.0)], [start, end], atol=1e-15)


@pytest.mark.parametrize("impact", [False, True])
def test_hop_leaves_with_all_contacts_and_lands_on_all_footholds(impact):
    robot = robots.load("solo12")
    feet = contact_positions(robot, robot.reference)
    stance, flight, landing = common.hop_schedule(feet, (0.3, 0.2, 0.4), impact=impact).phases
    assert (stance.duration, flight.duration, landing.duration) == (0.3, 0.2, 0.4)
    assert stance.contacts == landing.contacts == tuple(feet)
    assert flight.contacts == ()
    assert landing.impact is impact
    for name, place in feet.items():
        assert_allclose(landing.footholds[name], place)


def test_share_of_effort_scales_limits_and_leaves_a_robot_without_limits_alone():
    robot = robots.load("ur5")
    assert_allclose(common.torque_limits(robot, torque_share=0.5).limit, robot.torque_limit / 2)
    assert common.torque_limits(replace(robot, torque_limit=None), torque_share=0.5).limit is None


def test_wall_is_upright_without_tilt_and_a_table_at_a_right_angle():
    assert_allclose(common.wall_normal(0.0), [-1.0, 0.0, 0.0])
    assert_allclose(common.wall_normal(math.pi / 2), [0.0, 0.0, 1.0], atol=1e-15)


@pytest.mark.parametrize("name", ["friction", "distance", "touchdown"])
def test_shared_parameters_refuse_what_is_out_of_range(name):
    with pytest.raises(InputError, match=name):
        problems.load("solo12-jump", **{name: -20.0})
