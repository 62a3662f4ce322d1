"""What a simulated robot touches: ground of every kind, boards, obstacles; drives and sources."""

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from tests.support.synthetic_motions import arm_motion, at_rest, sampled, standing, with_meta
from trajopt import Solution
from trajopt.collision.description import robot_shapes
from trajopt.collision.shapes import LinkShape, SphereObstacle
from trajopt.motion.samples import sample_quantities
from trajopt.robot.actuators.drive import Drive
from trajopt.simulation.scene import AROUND_FOOT, build_scene
from trajopt.simulation.settings import SimulationSettings
from trajopt.simulation.simulate import simulate
from trajopt.simulation.site import Site
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.shapes import Bump
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import UP, Surface
from trajopt_library import robots

pytestmark = pytest.mark.long

# A standing robot moves by what its contacts give way, m.
STANDS = 1e-3
# Friction that holds gives way while it is loaded, m/s.
CREEPS = 1e-2
# MuJoCo's iterations on constraints end here, N m: some 1e-6 of what moves the arm.
SOLVER = 1e-4


@pytest.fixture(scope="module")
def stand() -> Solution:
    robot = robots.load("solo12")
    return sampled(robot, [standing(robot, 0.1)], 4)


@pytest.mark.parametrize(
    "terrain",
    [
        PiecewiseTerrain.gap(0.5, at=(1.0, 0.0)),
        PiecewiseTerrain.steps([0.1], 0.3, at=(1.0, 0.0)),
        SmoothTerrain(shapes=(Bump(rise=0.1, centre=(3.0, 0.0), radius=0.2),)),
    ],
    ids=["gap", "step", "bump"],
)
def test_robot_stands_on_every_kind_of_ground(terrain, stand):
    found = simulate(with_meta(stand, terrain=terrain.describe()))
    assert found.report.passed
    assert found.report.base_error_max < STANDS
    assert found.record.force[-1, :, 2].sum() == pytest.approx(found.scene.units.weight, rel=1e-3)


@pytest.mark.parametrize("rolling", [False, True])
def test_feet_touch_at_their_radius_whether_they_roll_or_not(rolling, stand):
    found = simulate(stand, rolling=rolling)
    assert found.report.base_error_max < STANDS
    place, radius = found.scene.place, stand.meta["contact_radius"][0]
    assert place.sizes == pytest.approx(np.full(4, radius if rolling else place.ball))
    assert place.sizes + place.lifts == pytest.approx(np.full(4, radius))
    height = found.record.feet[-1, :, 2]
    assert height == pytest.approx(np.full(4, radius), abs=STANDS)


def test_robot_falls_into_a_hole(stand):
    stones = PiecewiseTerrain.stepping_stones([(5.0, 5.0)], 0.2)
    report = simulate(with_meta(stand, terrain=stones.describe())).report
    assert not report.passed
    assert report.missed == 4


def test_board_of_a_phase_carries_only_what_the_plan_puts_on_it(stand):
    board = Surface(point=np.zeros(3), normal=np.array(UP), friction=0.7).describe()
    frames = stand.meta["contact_frames"]
    whole = with_meta(stand, terrain=None, surfaces=[dict.fromkeys(frames, board)])
    assert simulate(whole).report.base_error_max < STANDS
    # Front feet alone: the hind ones have nothing under them.
    half = with_meta(stand, terrain=None, surfaces=[dict.fromkeys(frames[:2], board)])
    found = simulate(half)
    assert not found.report.passed
    assert not found.record.force[:, 2:].any()


def test_capsule_that_passes_through_an_obstacle_is_found():
    robot = robots.load("ur5")
    plan, data = sampled(robot, [arm_motion(robot)], 10), robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, plan.q[plan.n_samples // 2])
    place = data.oMf[robot.model.getFrameId("tool0")].translation
    capsule = LinkShape.sphere("tool", "tool0", np.zeros(3), 0.03)
    for distance, hit in ((0.0, True), (5.0, False)):
        ball = SphereObstacle(name="ball", centre=place + np.array([0, 0, distance]), radius=0.05)
        scene = {"capsules": [capsule.describe()], "obstacles": [ball.describe()], "self_pairs": []}
        report = simulate(with_meta(plan, collision=scene)).report
        assert report.obstacle_hit is hit
        assert report.passed is not hit


def test_links_have_the_shapes_of_the_file():
    robot = robots.load("ur5")
    plan, data = sampled(robot, [arm_motion(robot)], 10), robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, plan.q[plan.n_samples // 2])
    shapes = robot_shapes(robot)
    forearm = next(shape for shape in shapes.shapes if shape.name == "forearm_link")
    middle = data.oMf[robot.model.getFrameId(forearm.frame)].act(forearm.points.mean(axis=0))
    for distance, hit in ((0.0, True), (5.0, False)):
        ball = SphereObstacle(name="ball", centre=middle + np.array([0, 0, distance]), radius=0.02)
        scene = {"capsules": [], "obstacles": [ball.describe()], "self_pairs": []}
        report = simulate(with_meta(plan, bodies=shapes.describe(), collision=scene)).report
        assert report.obstacle_hit is hit


def test_links_that_the_plan_has_on_the_ground_do_not_touch_it(stand):
    shapes = robot_shapes(robots.load("solo12"))
    plan = with_meta(stand, bodies=shapes.describe())
    scene = build_scene(Site.of_plan(plan), SimulationSettings())
    geoms = [scene.compiled.geom(i).name for i in np.flatnonzero(scene.links)]
    assert len(geoms) == len(shapes.shapes) - len(stand.contact_frames)
    assert simulate(plan).report.base_error_max < STANDS


def test_what_touches_within_its_ball_or_sole_is_a_foot(stand):
    solo12 = build_scene(Site.of_plan(stand), SimulationSettings())
    assert solo12.feet == pytest.approx(np.full(4, robots.load("solo12").contacts[0].radius + AROUND_FOOT))
    talos = robots.load("talos")
    sizes = [[own.half_length, own.half_width] if own.kind == "surface" else None for own in talos.contacts]
    plan = with_meta(sampled(talos, [standing(talos, 0.1)], 4), contact_sizes=sizes)
    extents = [np.hypot(*(size or (0.0, 0.0))) for size in sizes]
    assert build_scene(Site.of_plan(plan), SimulationSettings()).feet == pytest.approx(
        np.array(extents) + AROUND_FOOT
    )


def test_friction_of_drives_is_overcome_by_the_planned_torques():
    robot, drive = robots.load("ur5"), Drive(gear_ratio=100.0, viscous_friction=0.1, coulomb_friction=0.5)
    plan = sampled(robot, [arm_motion(robot)], 20, drives=[drive.to_meta()] * robot.nu)
    found, without = simulate(plan), simulate(with_meta(plan, drives=None))
    assert found.report.passed
    rate = plan.v[plan.collocation]
    more = np.abs(found.record.torque - without.record.torque).max(axis=0)
    np.testing.assert_allclose(more, 0.5 + 0.1 * np.abs(rate).max(axis=0), rtol=0.2)
    # What moves the robot is the same: a file has torques without the friction that drives overcome.
    moved = found.as_solution()
    points = moved.collocation
    force = sample_quantities(moved).generalized_force[points]
    np.testing.assert_allclose(force, moved.tau[points], atol=SOLVER)


def test_source_of_velocities_has_no_torque_limits():
    robot = robots.load("ur5")
    weak = sampled(robot, [arm_motion(robot)], 10, effort_limit=[1.0] * robot.nu)
    assert simulate(weak).report.saturated > 0.5
    source = simulate(with_meta(weak, actuation="acceleration")).report
    assert source.saturated == 0
    assert source.passed
    assert any("no torque limits" in note for note in source.notes)


def test_passive_joints_get_no_torque():
    robot = robots.load("acrobot")
    hanging = standing_pendulum(robot)
    found = simulate(hanging, noise=0.01)
    assert found.record.torque.shape[1] == robot.nu == 1
    assert found.report.joint_error_max < 0.1


def standing_pendulum(robot) -> Solution:
    return sampled(robot, [at_rest(robot, 1.0)], 4)


def test_joints_that_the_plan_takes_into_the_ground_are_named(stand):
    buried = replace(stand, q=stand.q - np.eye(stand.q.shape[1])[2] * 0.2)
    notes = simulate(buried).report.notes
    assert any("KFE" in note and "mm into the ground" in note for note in notes)


def test_friction_of_a_phase_holds_in_that_phase_alone():
    # On a slope of 0.2 that is icy while the second phase lasts, by surfaces on the plane of the ground.
    robot, slope = robots.load("solo12"), 0.2
    motion = standing(robot, 0.1)
    model = pin.Model(robot.model)
    model.gravity.linear = 9.81 * np.array([np.sin(np.arctan(slope)), 0.0, -np.cos(np.arctan(slope))])
    plan = replace(sampled(robot, [motion, motion], 4), model=model)
    frames = plan.meta["contact_frames"]
    speeds = {}
    for friction in (0.7, 0.1):
        ice = Surface(point=np.zeros(3), normal=np.array(UP), friction=friction).describe()
        found = simulate(with_meta(plan, surfaces=[{}, dict.fromkeys(frames, ice)]))
        half = found.timeline.planned // 2
        speeds[friction] = [found.record.qvel[row, 0] for row in (half, 2 * half)]
    assert np.abs(speeds[0.7]).max() < CREEPS
    assert abs(speeds[0.1][0]) < CREEPS
    # Feet that slide: a = g (sin - mu cos), but for what the legs' feedback takes up.
    sliding = 9.81 * np.cos(np.arctan(slope)) * (slope - 0.1) * 0.1
    assert speeds[0.1][1] == pytest.approx(sliding, rel=0.2)


def test_contact_that_slides_in_a_part_of_its_stance_does_not_slip(stand):
    robot = robots.load("solo12")
    plan, frames = sampled(robot, [standing(robot, 0.05)] * 2, 2), stand.meta["contact_frames"]
    belt = Surface(point=np.zeros(3), normal=np.array(UP), slip_speed=0.1).describe()
    found = simulate(with_meta(plan, surfaces=[{}, dict.fromkeys(frames[:2], belt)])).report.contacts
    assert [contact.travel is None for contact in found] == [True, True, False, False]


def test_board_carries_whole_soles():
    robot = robots.load("talos")
    feet = [contact for contact in robot.contacts if contact.kind == "surface"]
    plan = sampled(robot, [standing(robot, 0.01)], 1)
    sizes = [[c.half_length, c.half_width] if c in feet else None for c in robot.contacts]
    board = Surface(point=np.zeros(3), normal=np.array(UP)).describe()
    plan = with_meta(plan, terrain=None, contact_sizes=sizes, surfaces=[{feet[0].frame: board}])
    scene = build_scene(Site.of_plan(plan), SimulationSettings())
    state = mujoco.MjData(scene.compiled)
    state.qpos[:] = scene.coordinates.to_mujoco(plan.q[:1])[0]
    mujoco.mj_kinematics(scene.compiled, state)
    board = scene.compiled.geom("board0").id
    number = plan.contact_frames.index(feet[0].frame)
    for ball in np.flatnonzero(scene.contact_of == number):
        turn = state.geom_xmat[board].reshape(3, 3)
        local = turn.T @ (state.geom_xpos[ball] - state.geom_xpos[board])
        assert (scene.compiled.geom_size[board][:2] - np.abs(local[:2]) > 0.05 * scene.place.reach).all()
