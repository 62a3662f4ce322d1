"""Disturbances of a simulation: sensors, drives, centre of mass, and ground, against closed forms."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from tests.support.command_lines import assert_refused, invoke
from tests.support.synthetic_motions import arm_motion, planar_flight, sampled, standing
from trajopt import Solution
from trajopt.control.reference import reference_of
from trajopt.errors import InputError
from trajopt.robot.mujoco_package import muted_mujoco
from trajopt.robot.natural_units import NaturalUnits
from trajopt.simulation.joint_feedback import gains_of
from trajopt.simulation.run import SimulationRun
from trajopt.simulation.scene import build_scene
from trajopt.simulation.settings import SimulationSettings
from trajopt.simulation.simulate import Simulation, plan_run, simulate
from trajopt.simulation.site import Site
from trajopt_library import robots

# Torques that are computed in another order differ by rounding, N m.
ROUNDING = 1e-12
# A standing robot ends within this of where its ground is, m: contacts give way, joints are springs.
GIVES_WAY = 1e-3
# Standard deviations of 30,000 samples are known to this, relative: five of their own.
SAMPLED = 5 / math.sqrt(2 * 30_000)


@pytest.fixture(scope="module")
def stand() -> Solution:
    robot = robots.load("solo12")
    return sampled(robot, [standing(robot, 0.1)], 4)


@pytest.fixture(scope="module")
def arm() -> Solution:
    robot = robots.load("ur5")
    return sampled(robot, [arm_motion(robot, 0.1)], 4)


def run_of(plan: Solution, **settings: Any) -> SimulationRun:
    own = SimulationSettings(**settings)
    return plan_run(build_scene(Site.of_plan(plan), own), reference_of(plan, own.control_rate), own)


def asked(found: Simulation, late: int) -> np.ndarray:
    """Torques (n, nu) of the joints' law on the recorded states ``late`` ticks ago."""
    reference = found.timeline
    gains = gains_of(found.scene, reference, reference.period, found.settings)
    rows = np.maximum(np.arange(len(reference.t)) - late, 0)
    error = reference.q - found.scene.coordinates.from_mujoco(found.record.qpos[rows])
    rate = reference.v - found.record.qvel[rows]
    return np.asarray(reference.drive_torque + gains.kp * error + gains.kd * rate)


@pytest.mark.parametrize("delay", [0, 1, 7])
def test_delayed_torques_are_those_of_the_state_so_many_ticks_ago(delay: int, arm: Solution) -> None:
    found = simulate(arm, delay=delay, noise=0.01)
    free = ~found.record.saturated
    assert free.mean() > 0.5
    np.testing.assert_allclose(found.record.torque[free], asked(found, delay)[free], rtol=1e-9, atol=1e-9)


def test_contacts_are_late_with_the_state(stand: Solution) -> None:
    run = run_of(stand, delay=2)
    seen = []
    for k in range(5):
        touching = np.arange(4) == k % 4
        seen.append(run.hardware.measure(run.data.qpos + k, run.data.qvel, touching))
    assert [int(found.touching.argmax()) for found in seen] == [0, 0, 0, 1, 2]
    assert [found.qpos[0] - run.data.qpos[0] for found in seen] == pytest.approx([0, 0, 0, 1, 2])


def test_torques_change_at_most_at_their_rate(arm: Solution) -> None:
    rate = 200.0
    found = simulate(arm, torque_rate=rate, noise=0.01)
    change = np.abs(np.diff(np.vstack([found.timeline.drive_torque[:1], found.record.torque]), axis=0))
    most = rate * found.timeline.period
    assert change.max() <= most + ROUNDING
    assert change.max() == pytest.approx(most)


def test_torques_are_multiples_of_their_step(stand: Solution) -> None:
    step = 0.05
    record = simulate(stand, torque_step=step, noise=0.005).record
    multiples = record.torque[~record.saturated] / step
    np.testing.assert_allclose(multiples, np.round(multiples), atol=1e-9)
    assert np.unique(np.round(multiples)).size > 3


def test_sensor_noise_has_its_standard_deviation(stand: Solution) -> None:
    size, units = 2e-3, NaturalUnits.of(stand.model)
    run = run_of(stand, sensor_noise=size)
    still = np.zeros(run.model.nv)
    places, rates = [], []
    for _ in range(30_000 // run.model.nv):
        found = run.hardware.measure(run.data.qpos, still, run.touching)
        error = np.zeros(run.model.nv)
        run.mujoco.mj_differentiatePos(run.model, error, 1.0, run.data.qpos, found.qpos)
        places.append(error)
        rates.append(found.qvel)
    length = np.where(np.arange(run.model.nv) < 3, units.length, 1.0)
    for values, unit in ((places, length), (rates, length / units.time)):
        scaled = np.array(values) / unit
        assert scaled.std() == pytest.approx(size, rel=SAMPLED)
        assert scaled[:, :3].std() == pytest.approx(size, rel=2 * SAMPLED)
        assert abs(scaled.mean()) < 5 * size / math.sqrt(scaled.size)


@pytest.mark.long
def test_noise_is_that_of_its_seed_and_apart_from_the_start_s(stand: Solution) -> None:
    first, again, other = (simulate(stand, sensor_noise=1e-3, seed=seed).record for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.qpos, again.qpos)
    assert np.abs(first.torque - other.torque).max() > 0
    np.testing.assert_array_equal(first.qpos[0], simulate(stand).record.qpos[0])
    started = [simulate(stand, noise=1e-3, sensor_noise=size, seed=3).record.qpos[0] for size in (0.0, 1e-3)]
    np.testing.assert_array_equal(*started)


def test_a_branch_goes_on_as_its_run_would(stand: Solution) -> None:
    with muted_mujoco():
        run = run_of(stand, sensor_noise=1e-3, delay=3, torque_rate=50.0, torque_step=0.01)
        record = run.start()
        run.advance(record, 0, 40)
        branch = run.branch()
        run.advance(record, 40, 80)
        whole = record.qpos.copy()
        record.qpos[40:] = 0.0
        branch.advance(record, 40, 80)
    np.testing.assert_array_equal(record.qpos[:80], whole[:80])


def test_defaults_measure_and_deliver_what_is(stand: Solution) -> None:
    run = run_of(stand)
    found, wanted = run.hardware.measure(run.data.qpos, run.data.qvel, run.touching), np.arange(12.0)
    np.testing.assert_array_equal(found.qpos, run.data.qpos)
    np.testing.assert_array_equal(found.qvel, run.data.qvel)
    assert run.hardware.command(wanted) is wanted


def centre_of_mass(run: SimulationRun) -> np.ndarray:
    run.mujoco.mj_forward(run.model, run.data)
    return np.asarray(run.data.subtree_com[0].copy())


def test_gains_are_those_of_the_masses_that_the_plan_knows(stand: Solution) -> None:
    nominal, heavier = run_of(stand), run_of(stand, mass_scale=1.2)
    for run in (nominal, heavier):
        run.events.enter(0, run.data)
    assert heavier.model.body_mass.sum() == pytest.approx(1.2 * nominal.model.body_mass.sum())
    np.testing.assert_allclose(heavier.controller.gains.kp, nominal.controller.gains.kp, rtol=1e-9)
    np.testing.assert_allclose(heavier.controller.gains.kd, nominal.controller.gains.kd, rtol=1e-9)


@pytest.mark.parametrize("mass_scale", [1.0, 1.2])
def test_the_centre_of_mass_of_the_whole_robot_is_off_by_its_offset(
    mass_scale: float, stand: Solution
) -> None:
    offset = np.array([0.02, -0.01, 0.005])
    nominal, off = (
        run_of(stand, com_offset=values, mass_scale=mass_scale) for values in ((0.0, 0.0, 0.0), offset)
    )
    q = stand.q[0].copy()
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.2, -0.3, 0.9)).coeffs()
    for run in (nominal, off):
        run.data.qpos[:] = run.scene.coordinates.to_mujoco(q[None])[0]
        run.events.enter(0, run.data)
    turned = pin.Quaternion(q[3:7]).toRotationMatrix() @ offset
    np.testing.assert_allclose(centre_of_mass(off) - centre_of_mass(nominal), turned, atol=1e-12)
    assert off.model.body_mass.sum() == pytest.approx(nominal.model.body_mass.sum(), rel=1e-12)
    np.testing.assert_allclose(off.model.body_inertia, nominal.model.body_inertia, rtol=1e-12)


def test_in_a_plane_the_offset_is_forward_and_up() -> None:
    robot = robots.load("hopper")
    plan = sampled(robot, [planar_flight(robot, 0.1)], 4)
    q = np.array([0.0, 0.6, 1.0, 0.0, 0.0, 0.0])
    centres = []
    for offset in ((0.0, 0.0, 0.0), (0.02, 0.0, 0.01)):
        run = run_of(plan, com_offset=offset)
        run.data.qpos[:] = run.scene.coordinates.to_mujoco(q[None])[0]
        run.events.enter(0, run.data)
        centres.append(centre_of_mass(run))
    np.testing.assert_allclose(centres[1] - centres[0], [0.02, 0.0, 0.01], atol=1e-12)


def test_a_standing_robot_bears_its_centre_of_mass_where_it_is(stand: Solution) -> None:
    found = simulate(stand, com_offset=(0.01, 0.0, 0.0))
    force, feet = found.record.force[-1], found.record.feet[-1]
    pressed = (force[:, 2] @ feet[:, :2]) / force[:, 2].sum()
    before = simulate(stand).record
    weights = before.force[-1][:, 2]
    moved = pressed - (weights @ before.feet[-1][:, :2]) / weights.sum()
    assert moved == pytest.approx([0.01, 0.0], abs=GIVES_WAY)


@pytest.mark.long
@pytest.mark.parametrize("offset", [0.01, -0.01])
def test_a_foot_stands_as_much_higher_as_its_ground(offset: float, stand: Solution) -> None:
    frame, robot = stand.contact_frames[0], robots.load("solo12")
    long = sampled(robot, [standing(robot, 0.4)], 4)
    level = simulate(long, controller="whole-body").record
    found = simulate(long, controller="whole-body", ground_offsets={frame: offset})
    lifted = found.record.feet[-1, :, 2] - level.feet[-1, :, 2]
    assert lifted == pytest.approx([offset, 0.0, 0.0, 0.0], abs=GIVES_WAY)
    assert (found.record.force[-1, :, 2] > 0.01 * found.scene.units.weight).all()
    assert not found.report.fell


def test_links_of_a_leg_have_the_ground_of_its_foot(stand: Solution) -> None:
    compiled = run_of(stand, ground_offsets={stand.contact_frames[1]: -0.02}).scene.compiled
    raised = [i for i in range(compiled.npair) if compiled.pair(i).name.endswith(" terrain.3")]
    touched = {compiled.pair(i).name.split()[0] for i in raised}
    assert touched
    frame = stand.model.frames[stand.model.getFrameId(stand.contact_frames[1])]
    leg = set(list(stand.model.supports[frame.parentJoint])[2:])
    bodies = {int(compiled.geom(name).bodyid[0]) for name in touched}
    assert bodies <= {compiled.body(f"body{joint}").id for joint in leg}
    assert compiled.geom("terrain.3").pos[2] == pytest.approx(-0.02)
    assert not any(
        compiled.pair(i).name == f"{name} terrain" for name in touched for i in range(compiled.npair)
    )


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (
            {"sensor_noise": -1.0},
            "sensor_noise of SimulationSettings is -1.0; allowed: a finite number from 0 to 1",
        ),
        ({"delay": 101}, "delay of SimulationSettings is 101; allowed: a whole number from 0 to 100"),
        ({"delay": 1.5}, "delay of SimulationSettings is 1.5; allowed: a whole number from 0 to 100"),
        (
            {"torque_step": -1.0},
            "torque_step of SimulationSettings is -1.0; allowed: a finite number from 0 to 1e+06",
        ),
        (
            {"torque_rate": math.inf},
            "torque_rate of SimulationSettings is inf; allowed: a finite number from 0 to 1e+12",
        ),
        (
            {"com_offset": 0.02},
            "com_offset of SimulationSettings is 0.02; allowed: 3, each a finite number from -10 to 10",
        ),
        (
            {"com_offset": (0, 0)},
            "com_offset of SimulationSettings is (0, 0); allowed: 3, each a finite number from -10 to 10",
        ),
        (
            {"com_offset": (0, 99, 0)},
            "com_offset[1] of SimulationSettings is 99; allowed: a finite number from -10 to 10",
        ),
        (
            {"ground_offsets": 0.02},
            "ground_offsets of SimulationSettings is 0.02; "
            "allowed: a mapping of a string to a finite number from -10 to 10",
        ),
        (
            {"ground_offsets": {"FL_FOOT": "high"}},
            "ground_offsets['FL_FOOT'] of SimulationSettings is 'high'; "
            "allowed: a finite number from -10 to 10",
        ),
        (
            {"ground_offsets": {"FL": 0.02}},
            "ground_offsets of SimulationSettings for 'FL'; did you mean FL_FOOT?"
            " allowed: FL_FOOT, FR_FOOT, HL_FOOT, HR_FOOT",
        ),
    ],
)
def test_wrong_settings_are_one_line(settings: dict[str, Any], line: str, stand: Solution) -> None:
    with pytest.raises(InputError) as refused:
        simulate(stand, **settings)
    assert str(refused.value) == line


def test_settings_that_a_robot_cannot_have_are_refused(arm: Solution) -> None:
    with pytest.raises(InputError, match="rolling has no effect on 'ur5'; allowed: for contacts"):
        simulate(arm, rolling=False)
    with pytest.raises(InputError, match="com_offset of a robot whose base is fixed; allowed: none"):
        simulate(arm, com_offset=(0.01, 0.0, 0.0))
    robot = robots.load("hopper")
    plan = sampled(robot, [planar_flight(robot, 0.1)], 4)
    with pytest.raises(InputError, match="to the side of a robot in a plane; allowed: x and z"):
        simulate(plan, com_offset=(0.0, 0.01, 0.0))


def test_the_command_takes_all_of_them(stand: Solution, tmp_path: Path) -> None:
    file, frame = stand.save(tmp_path / "stand.npz"), stand.contact_frames[0]
    words = ("--sensor-noise", 1e-4, "--seed", 3, "--delay", 1, "--torque-step", 0.001, "--torque-rate", 1e4)
    done = invoke("simulate", file, *words, "--com-offset", 0.001, 0, 0, "--ground-offset", f"{frame}=0.001")
    assert done.exit_code == 0, done.stderr
    offset = ("--ground-offset", f"{frame}=high")
    assert_refused(invoke("simulate", file, *offset), f"--ground-offset for '{frame}' is 'high'")
    assert_refused(
        invoke("simulate", file, "--ground-offset", "x=1"), "ground_offsets of SimulationSettings for 'x'"
    )
