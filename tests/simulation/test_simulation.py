"""Simulated motions: closed forms, what contacts hold, what feedback does, jumps and gaits tracked."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from tests.support.synthetic_motions import Motion, arm_motion, sampled, standing, tumbling_flight, with_meta
from trajopt import Contact, Robot, Solution, solve
from trajopt.control.reference import reference_of
from trajopt.errors import InputError
from trajopt.motion.cycles import periodic_image
from trajopt.motion.samples import sample_quantities
from trajopt.simulation.figures import farthest_travel
from trajopt.simulation.settings import SimulationSettings
from trajopt.simulation.simulate import simulate
from trajopt_library import problems, robots

pytestmark = pytest.mark.long

# The figure that jumps and gaits have to meet, m: of the base at the end.
AT_THE_END = 0.05
# Torques are held for a period of the controller: positions are off by what that leaves, rad and m.
HELD_TORQUE = 1e-4
# A body that the physics integrates in fourth order against its closed form, m.
CLOSED_FORM = 1e-8
# A contact gives way by about g over the square of its stiffness's rate, friction by its regularisation.
GIVES_WAY = 0.02
# MuJoCo stops iterating on contact forces here, over the weight.
SOLVER = 1e-6


@pytest.fixture(scope="module")
def stand() -> Solution:
    robot = robots.load("solo12")
    return sampled(robot, [standing(robot)], 10)


@pytest.fixture(scope="module")
def jump() -> Solution:
    return solve(problems.load("solo12-jump"), intervals=30)


def tilted(degrees: float, friction: float) -> dict[str, object]:
    angle = np.radians(degrees)
    normal = [-float(np.sin(angle)), 0.0, float(np.cos(angle))]
    return {"kind": "flat", "height": 0.0, "normal": normal, "friction": friction}


def block() -> Robot:
    """A floating box on a sole, without any joint."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(2.0, 0.4, 0.4, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("sole", joint, 0, pin.SE3(np.eye(3), np.array([0, 0, -0.05])), pin.OP_FRAME))
    # As far as it reaches: a body without links has no length of its own.
    model.addFrame(pin.Frame("tip", joint, 0, pin.SE3(np.eye(3), np.array([0.5, 0, 0])), pin.OP_FRAME))
    return Robot.from_model(
        model, contacts=[Contact(frame="sole", kind="surface", half_length=0.2, half_width=0.2)], name="block"
    )


def resting_block(degrees: float, friction: float) -> Solution:
    robot = block()
    turn = pin.utils.rotate("y", -np.radians(degrees))
    q = np.concatenate([turn @ np.array([0, 0, 0.05]), pin.Quaternion(turn).coeffs()])
    still, nothing = np.zeros(6), np.zeros((1, 6))
    motion = Motion(
        duration=0.5,
        contacts=("sole",),
        q=lambda t: q,
        v=lambda t: still,
        a=lambda t: still,
        tau=lambda t: np.zeros(0),
        f=lambda t: nothing,
    )
    sizes = {"contact_sizes": [[0.2, 0.2]], "terrain": tilted(degrees, friction), "friction": [friction]}
    return sampled(robot, [motion], 5, **sizes)


def test_robot_falls_as_it_must_without_ground(stand):
    plan = with_meta(stand, terrain=None, friction=[0.0] * 4)
    plan = replace(plan, tau=np.zeros_like(plan.tau))
    found = simulate(plan, kp=0.0, kd=0.0)
    t = np.append(found.timeline.t, found.timeline.t[-1] + found.timeline.period)
    centre = [pin.centerOfMass(plan.model, plan.model.createData(), q)[2] for q in _configurations(found)]
    fallen = centre[0] - 9.81 * t**2 / 2
    falling = found.timeline.planned + 1  # then it would be held
    np.testing.assert_allclose(centre[:falling], fallen[:falling], atol=CLOSED_FORM)


def _configurations(found):
    return found.scene.coordinates.from_mujoco(found.record.qpos)


def test_passive_arm_keeps_its_energy():
    robot = robots.load("ur5")
    motion = replace(arm_motion(robot), tau=lambda t: np.zeros(robot.nu))
    found = simulate(sampled(robot, [motion], 20), kp=0.0, kd=0.0)
    moved, model = found.as_solution(), robot.model
    energy = [
        pin.computeMechanicalEnergy(model, model.createData(), q, v)
        for q, v in zip(moved.q, moved.v, strict=True)
    ]
    # What the arm has in motion: against its height alone even a wrong integrator looks good.
    swing = max(
        pin.computeKineticEnergy(model, model.createData(), q, v)
        for q, v in zip(moved.q, moved.v, strict=True)
    )
    assert np.ptp(energy) < 1e-6 * swing


def test_arm_follows_its_inverse_dynamics_without_feedback():
    robot = robots.load("ur5")
    found = simulate(sampled(robot, [arm_motion(robot)], 40), kp=0.0, kd=0.0)
    assert 0 < found.report.joint_error_max < HELD_TORQUE


def test_flight_with_torques_is_that_of_another_integrator():
    robot = robots.load("solo12")
    found = simulate(sampled(robot, [tumbling_flight(robot)], 20), kp=0.0, kd=0.0)
    assert found.report.base_error_max < HELD_TORQUE
    assert found.report.joint_error_max < HELD_TORQUE


def test_feet_of_a_standing_robot_carry_what_the_plan_says(stand):
    found = simulate(stand)
    weight = found.scene.units.weight
    vertical = found.record.force[-1, :, 2]
    np.testing.assert_allclose(vertical, stand.f[-1, :, 2], atol=GIVES_WAY * weight / 4)
    assert vertical.sum() == pytest.approx(weight, rel=1e-3)
    assert found.report.passed
    assert found.report.held > 0
    assert found.report.slips == 0


def test_heavier_robot_presses_as_hard_as_it_is_heavy(stand):
    found = simulate(stand, mass_scale=1.2)
    assert found.record.force[-1, :, 2].sum() == pytest.approx(1.2 * found.scene.units.weight, rel=0.02)
    assert found.report.base_error_end > simulate(stand).report.base_error_end


def test_block_sticks_on_a_slope_within_the_friction_cone():
    report = simulate(resting_block(20.0, 0.5)).report  # tan 20 degrees = 0.36
    assert report.slip_travel < 1e-3
    assert report.slips == 0


def test_block_slides_down_a_slope_beyond_the_friction_cone():
    degrees, friction = 30.0, 0.3
    found = simulate(resting_block(degrees, friction))
    angle, t = np.radians(degrees), found.report.duration + found.report.held
    way = 9.81 * (np.sin(angle) - friction * np.cos(angle)) * t**2 / 2
    moved = np.linalg.norm(found.record.feet[-1, 0] - found.record.feet[0, 0])
    assert moved == pytest.approx(way, rel=GIVES_WAY)
    assert found.report.slips > 0


def test_feedback_takes_out_an_error_of_the_start(stand):
    free = simulate(stand, noise=0.01, kp=0.0, kd=0.0).report
    held = simulate(stand, noise=0.01).report
    assert held.joint_error_end < 0.1 * free.joint_error_end


@pytest.mark.parametrize("scale", [0.1, 4.0])
def test_robots_of_any_size_do_the_same_in_their_own_units(scale, stand):
    # Lengths times s, masses times s^3: times go with sqrt(s), forces with s^3, torques with s^4.
    model = pin.Model(stand.model)
    for index in range(1, model.njoints):
        own, inertia = model.jointPlacements[index], model.inertias[index]
        model.jointPlacements[index] = pin.SE3(own.rotation, scale * own.translation)
        model.inertias[index] = pin.Inertia(
            scale**3 * inertia.mass, scale * inertia.lever, scale**5 * inertia.inertia
        )
    for frame in range(model.nframes):
        own = model.frames[frame].placement
        model.frames[frame].placement = pin.SE3(own.rotation, scale * own.translation)
    model.armature[:] *= scale**5
    contacts = tuple(replace(one, radius=scale * one.radius) for one in stand.description.contacts)
    slow, q = np.sqrt(scale), stand.q.copy()
    q[:, :3] *= scale
    scaled = replace(
        stand, model=model, q=q, t=slow * stand.t, interval_t=slow * stand.interval_t,
        tau=scale**4 * stand.tau, f=scale**3 * stand.f,
        description=replace(stand.description, effort_limit=None, contacts=contacts),
    )  # fmt: skip
    free = with_meta(stand, effort_limit=None)
    mine = simulate(free, noise=0.005).report
    other = simulate(scaled, noise=0.005, control_rate=1000 / slow).report
    assert other.base_error_max / scale == pytest.approx(mine.base_error_max, rel=SOLVER)
    assert other.joint_error_max == pytest.approx(mine.joint_error_max, rel=SOLVER)


def test_same_seed_gives_the_same_motion_and_another_one_another(stand):
    first, again, other = (simulate(stand, noise=0.01, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.record.qpos, again.record.qpos)
    assert np.abs(first.record.qpos - other.record.qpos).max() > 0


def test_push_moves_the_base_to_its_side(stand):
    weight = 24.5
    pushed = simulate(stand, push=0.3 * weight)
    side = pushed.record.qpos[:, 1] - simulate(stand).record.qpos[:, 1]
    assert side.max() > 1e-3


def test_push_on_a_planar_robot_is_within_its_plane():
    plan = solve(problems.load("hopper-hop"), intervals=12)
    ahead = simulate(plan, push=5.0).record.qpos - simulate(plan).record.qpos
    assert np.abs(ahead[:, 0]).max() > 1e-3


def test_push_is_to_the_left_of_a_robot_that_looks_elsewhere(stand):
    quarter = pin.SE3(pin.utils.rotate("z", np.pi / 2), np.zeros(3))
    q = stand.q.copy()
    q[:, :7] = [pin.SE3ToXYZQUAT(quarter * pin.XYZQUATToSE3(row)) for row in q[:, :7]]
    turned = replace(stand, q=q, f=stand.f @ np.kron(np.eye(2), quarter.rotation.T))
    side = simulate(turned, push=7.0).record.qpos - simulate(turned).record.qpos
    assert side[:, 0].min() < -1e-3
    assert np.abs(side[:, 0]).max() > 5 * np.abs(side[:, 1]).max()


def test_sole_that_spins_on_the_spot_travels_by_the_chord_of_its_corners():
    corner, turn = np.array([0.1, 0.05, 0.0]), 0.5
    angles = np.linspace(0.0, turn, 20)
    places = np.array(
        [[side * pin.utils.rotate("z", angle) @ corner for side in (1, -1)] for angle in angles]
    )
    loaded, up = np.ones(len(angles), dtype=bool), np.array([0.0, 0.0, 1.0])
    chord = 2 * np.linalg.norm(corner) * np.sin(turn / 2)
    assert farthest_travel(places, loaded, up) == pytest.approx(chord, rel=1e-12)


def test_torques_stay_within_the_limits(stand):
    limit = 1.05 * np.abs(stand.tau).max()
    weak = with_meta(stand, effort_limit=[limit] * stand.tau.shape[1])
    found = simulate(weak, noise=0.02)
    assert np.abs(found.record.torque).max() <= limit
    assert found.report.saturated > 0


def test_jump_is_tracked(jump):
    report = simulate(jump).report
    assert report.passed
    assert not report.fell
    assert report.base_error_end < AT_THE_END
    assert report.missed == 0


def test_simulated_motion_obeys_pinocchios_equations_of_motion(jump):
    found = simulate(jump).as_solution()
    points, weight = found.collocation, 24.5
    force = sample_quantities(found).generalized_force[points]
    assert np.abs(force[:, :6]).max() < SOLVER * weight
    np.testing.assert_allclose(force[:, 6:], found.tau[points], atol=SOLVER * weight)


def test_simulated_motion_is_a_solution_file(jump, tmp_path):
    found = simulate(jump)
    loaded = Solution.load(found.as_solution().save(tmp_path / "simulated.npz"))
    assert loaded.statistics.simulated is True
    assert loaded.description.phase_names == (*jump.description.phase_names, "hold")
    assert loaded.statistics.simulation["passed"] is True
    assert loaded.t[-1] == pytest.approx(jump.t[-1] + found.report.held)
    np.testing.assert_allclose(loaded.q[0], jump.q[0], atol=1e-12)


def test_smaller_steps_change_little(jump):
    step = simulate(jump).report.timestep
    ends = [simulate(jump, timestep=step / part).record.qpos[-1] for part in (1, 2)]
    # Contacts make and break at other moments: far below the figure, not at rounding.
    assert np.abs(ends[0] - ends[1]).max() < 0.2 * AT_THE_END


def test_robot_on_ice_is_not_tracked(jump):
    report = simulate(jump, friction_scale=0.02).report
    assert not report.passed
    assert report.slips > 0
    assert report.failures


def test_robot_without_torques_falls(stand):
    report = simulate(replace(stand, tau=np.zeros_like(stand.tau)), kp=0.0, kd=0.0).report
    assert report.fell
    assert report.fall_time > 0
    assert any(report.fall_reason in why for why in report.failures)


def test_grasp_holds_what_the_plan_holds():
    plan = solve(problems.load("ur5-pull"), intervals=12)
    found = simulate(plan)
    pulling = found.timeline.phase == 2
    planned = sample_quantities(plan).position[-1, 0]
    assert np.abs(found.record.feet[pulling, 0] - planned).max() < 2e-3
    # The pull against the board's normal, 60 N, within what the feedback adds.
    pull = found.record.force[pulling, 0, :3].mean(axis=0)
    np.testing.assert_allclose(pull, found.timeline.f[pulling, 0, :3].mean(axis=0), atol=6.0)
    assert any("held as planned in grasp, pull" in note for note in found.report.notes)


def test_carried_object_is_felt():
    plan = solve(problems.load("arm-pick-place"), fixed_mesh=True)
    found = simulate(plan).report
    light = with_meta(plan, drop=("payloads",))
    without = simulate(light).report
    assert found.joint_error_max < HELD_TORQUE
    assert without.joint_error_max > 10 * found.joint_error_max


def test_cycles_follow_each_other_as_images():
    plan = solve(problems.load("hopper-gait"), fixed_mesh=True)
    reference = reference_of(plan, SimulationSettings().control_rate, cycles=3)
    count, described = len(reference.t) // 3, plan.description.periodicity
    duration = float(plan.t[-1] - plan.t[0])
    for cycle in (1, 2):
        first = count * cycle
        q, v = periodic_image(
            plan.model, described, reference.q[first - count], reference.v[first - count], duration
        )
        np.testing.assert_allclose(reference.q[first], q, atol=1e-9)
        np.testing.assert_allclose(reference.v[first], v, atol=1e-9)
    assert np.abs(np.diff(reference.q, axis=0)).max() < 0.05
    np.testing.assert_array_equal(np.unique(reference.phase), np.arange(6))
    assert not simulate(plan).report.fell


def test_half_a_cycle_is_followed_by_its_mirror_image():
    plan = solve(problems.load("quadruped-trot", cycle="half"), fixed_mesh=True)
    found = simulate(plan, cycles=1)
    reference, half = found.timeline, len(found.timeline.t) // 2
    np.testing.assert_array_equal(reference.active[0], ~reference.active[half])
    assert reference.t[-1] + reference.period == pytest.approx(2 * plan.t[-1], rel=1e-6)
    assert found.report.passed


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (
            {"timestep": 0.0},
            "timestep of SimulationSettings is 0.0; allowed: a finite number from 1e-09 to 0.01 or None",
        ),
        ({"kp": -1.0}, "kp of SimulationSettings is -1.0; allowed: a finite number from 0 to 1e+06"),
        (
            {"push": 1e300},
            "push of SimulationSettings is 1e+300; allowed: a finite number from -1e+09 to 1e+09",
        ),
        (
            {"mass_scale": float("nan")},
            "mass_scale of SimulationSettings is nan; allowed: a finite number from 1e-06 to 1e+06",
        ),
        ({"cycles": 0}, "cycles of SimulationSettings is 0; allowed: a whole number >= 1"),
        ({"cycles": 2}, "the solution is not periodic; allowed: `cycles=1`"),
        (
            {"gain": 2.0},
            "a simulation has no setting gain; allowed: timestep, control_rate, kp, kd, friction_scale, "
            "mass_scale, noise, seed, cycles, push, rolling, controller, gains, qp_solver, impulse, "
            "wrenches, events, sensor_noise, delay, torque_step, torque_rate, com_offset, ground_offsets",
        ),
        ({"rolling": 1}, "rolling of SimulationSettings is 1; allowed: True or False or None"),
        ({"noise": "much"}, "noise of SimulationSettings is 'much'; allowed: a finite number from 0 to 1"),
    ],
)
def test_wrong_settings_are_refused_in_one_line(settings, line, stand):
    with pytest.raises(InputError) as refused:
        simulate(stand, **settings)
    assert str(refused.value) == line


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"timestep": 1e-9}, "steps; allowed: "),
        ({"control_rate": 1e6}, "periods of its controller; allowed: "),
    ],
)
def test_simulations_that_take_hours_are_refused(settings, words, jump):
    with pytest.raises(InputError, match=words):
        simulate(jump, **settings)


def test_a_simulation_that_runs_away_ends_with_its_last_finite_state_and_says_so_in_the_report_alone(
    jump, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)  # where MuJoCo writes its log
    found = simulate(jump, push=1e9)
    assert found.report.fell
    assert np.isfinite(found.record.qpos).all()
    assert found.as_solution().save(tmp_path / "away.npz").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["away.npz"]
    assert capfd.readouterr() == ("", "")


def test_missing_mujoco_is_said_in_one_line(stand, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(InputError, match="MuJoCo, which is not installed; pip install"):
        simulate(stand)


def test_an_arm_is_not_pushed_and_its_report_says_nothing_of_feet():
    robot = robots.load("ur5")
    plan = sampled(robot, [arm_motion(robot)], 10)
    with pytest.raises(InputError, match="push of 50 N on the base, which is fixed; allowed: 0 N for an arm"):
        simulate(plan, push=50.0)
    table = simulate(plan).report.table()
    assert not any(word in table for word in ("touchdown", "slips", "contact forces", "base"))
    assert "joint error, rms" in table
