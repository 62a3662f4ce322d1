"""A motion at an even rate: the plan's own polynomials, cycle after cycle, links where Pinocchio has them."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from tests.support.command_lines import invoke
from tests.support.exported_plans import (
    GAITS,
    KINDS,
    ROUNDING,
    moved_on,
    place_of,
    plan_to_export,
    resting_arm,
    rotation_of,
    swinging_arm,
)
from tests.support.refusals import assert_refused_in_one_line
from tests.support.synthetic_motions import sampled, standing
from trajopt.export.exported_motion import counted_angle, sample_cycles
from trajopt.export.formats import FORMATS
from trajopt.export.links import without_jumps
from trajopt.export.writing import export_motion
from trajopt.motion.solution import Solution

pytestmark = pytest.mark.long

# Central differences of a motion with this many samples a second are off by the step squared; m/s, rad/s.
FINE, DIFFERENCE = 4000.0, 2e-3
# Residual of the equations of motion over the weight: of a solver's tolerance, and of the mirror image by a
# robot whose description has a left side that is not quite its right one.
SOLVED, ASYMMETRY = 1e-5, 1e-3
# A step of a thousandth of a cycle across its end, less what the mean velocity makes of it: rad, m.
CLOSING = 1e-4
# Velocities jump by more than this in an impact: m/s, rad/s.
FELT = 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_one_cycle_is_the_plan_at_even_times(kind: str) -> None:
    plan = plan_to_export(kind)
    motion = sample_cycles(plan, 60)
    passes = 2 if kind == "mirrored walk" else 1
    half = np.searchsorted(motion.t, plan.t[-1])
    assert_allclose(np.diff(motion.t), 1 / 60, atol=ROUNDING)
    assert 0 <= passes * plan.t[-1] - motion.t[-1] + ROUNDING < 1 / 60
    own = plan.sample(times=motion.t[:half])
    for name in ("q", "v", "a", "tau", "drive_torque", "f", "active", "phase"):
        assert_array_equal(getattr(motion, name)[:half], getattr(own, name))
    for name in motion.joints.names:
        column = motion.joints.names.index(name)
        assert_allclose(motion.joints.position[:half, column], own.q[:, own.position_names.index(name)])
        assert_allclose(motion.joints.velocity[:half, column], own.v[:, own.velocity_names.index(name)])
        if name in own.torque_names:
            torque = own.drive_torque[:, own.torque_names.index(name)]
            assert_allclose(motion.joints.torque[:half, column], torque)


@pytest.mark.parametrize(("even", "end"), [(True, 1.02), (False, 1.0085)])
def test_a_motion_that_ends_at_rest_is_sampled_to_its_end(even: bool, end: float) -> None:
    plan = resting_arm(1.0085)
    motion = sample_cycles(plan, 50, even=even)
    assert motion.t[-1] == pytest.approx(end, abs=ROUNDING)
    assert_allclose(motion.q[-1], plan.q[-1], atol=ROUNDING)
    assert_allclose(motion.v[-1], 0.0, atol=ROUNDING)
    if even:
        assert_allclose(np.diff(motion.t), 1 / 50, atol=ROUNDING)
    assert len(sample_cycles(resting_arm(1.0), 50, even=even).t) == 51


def test_an_even_motion_that_does_not_rest_ends_at_its_last_whole_step() -> None:
    plan = swinging_arm()
    assert sample_cycles(plan, 30.5).t[-1] == pytest.approx(30 / 30.5)
    assert sample_cycles(plan, 30.5, even=False).t[-1] == plan.t[-1]


def carrying() -> tuple[Solution, str]:
    """Solo12 with 0.25 kg on a foot, and what warnings say of it."""
    robot = trajopt.robot("solo12")
    foot = robot.contacts[0].frame
    load = {"frame": foot, "mass": 0.25, "centre": [0.0] * 3, "inertia": np.eye(3) / 1000, "phases": [0]}
    return sampled(robot, [standing(robot)], 2, payloads=[load]), f"leaves out the payload: 0.25 kg on {foot}"


@pytest.mark.parametrize("name", FORMATS)
def test_a_payload_that_is_left_out_is_said(name: str, tmp_path: Path) -> None:
    plan, words = carrying()
    with pytest.warns(UserWarning, match=f"{name} {words}"):
        export_motion(plan, name, tmp_path / f"out{FORMATS[name].ending}")


@pytest.mark.parametrize(("form", "ending"), [("csv", "csv"), ("mjcf", "xml"), ("rosbag", "")])
def test_the_command_line_says_that_a_payload_is_left_out(form: str, ending: str, tmp_path: Path) -> None:
    plan, words = carrying()
    file = plan.save(tmp_path / "plan.npz")
    result = invoke("export", file, "--format", form, "-o", tmp_path / f"out.{ending}".rstrip("."))
    assert result.exit_code == 0
    assert result.stderr.count(f"trajopt: warning: {form} {words}; torques") == 1


@pytest.mark.parametrize("kind", ["turning trot", "planar hops"])
def test_later_cycles_are_the_first_one_moved_on(kind: str) -> None:
    plan, cycles = plan_to_export(kind), 3
    duration = plan.t[-1] - plan.t[0]
    motion = sample_cycles(plan, 40, cycles)
    assert motion.t[-1] > (cycles - 1) * duration
    for row in range(0, len(motion.t), 3):
        passed = min(int(motion.t[row] / duration + ROUNDING), cycles - 1)
        own = plan.sample(times=[motion.t[row] - passed * duration])
        carried = moved_on(plan, passed)
        for column, name in enumerate(motion.links.names):
            place = place_of(plan.model, name, own.q[0], own.v[0])
            pose = carried * place.pose
            assert_allclose(motion.links.position[row, column], pose.translation, atol=ROUNDING)
            assert_allclose(rotation_of(motion.links.quaternion[row, column]), pose.rotation, atol=ROUNDING)
            for found, expected in (
                (motion.links.linear_velocity, place.linear),
                (motion.links.angular_velocity, place.angular),
            ):
                assert_allclose(found[row, column], carried.rotation @ expected, atol=ROUNDING)
        assert_allclose(motion.f[row, :, :3], own.force[0] @ carried.rotation.T, atol=ROUNDING)
        assert_allclose(motion.tau[row], own.tau[0], atol=ROUNDING)
        assert_array_equal(motion.active[row], own.active[0])
        assert motion.phase_names[motion.phase[row]] == own.phase_names[own.phase[0]]


def test_the_second_half_of_a_walk_is_the_mirror_image_of_the_first() -> None:
    plan = plan_to_export("mirrored walk")
    duration, flip = plan.t[-1], np.array([1.0, -1.0, 1.0])
    motion, rows = sample_cycles(plan, 20 / duration), 20
    later = slice(rows, 2 * rows)
    shift = np.array(plan.description.periodicity.velocity) * duration
    for name in ("left_ankle_roll_link", "right_knee_link", "pelvis"):
        first, second = (motion.links.names.index(own) for own in (_opposite(name), name))
        position, velocity = motion.links.position, motion.links.linear_velocity
        assert_allclose(position[later, second], position[:rows, first] * flip + shift, atol=ROUNDING)
        assert_allclose(velocity[later, second], velocity[:rows, first] * flip, atol=ROUNDING)
    assert_allclose(motion.f[later, 0, :3], motion.f[:rows, 1, :3] * flip, atol=ROUNDING)
    assert_array_equal(motion.active[later, 0], motion.active[:rows, 1])
    left, right = (motion.joints.names.index(f"{side}_hip_pitch_joint") for side in ("left", "right"))
    assert_allclose(motion.joints.torque[later, left], motion.joints.torque[:rows, right], atol=ROUNDING)


def _opposite(name: str) -> str:
    return name.replace("left", "?").replace("right", "left").replace("?", "right")


@pytest.mark.parametrize("kind", GAITS)
def test_equations_of_motion_hold_in_every_cycle(kind: str) -> None:
    """Images of q, v, a, torques and forces belong together: inverse dynamics at a collocation point."""
    plan, cycles = plan_to_export(kind), 2
    model, data, duration = plan.model, plan.model.createData(), plan.t[-1]
    point = plan.t[plan.collocation][3]
    for past in range(cycles * (2 if kind == "mirrored walk" else 1)):
        motion = sample_cycles(plan, 1 / (past * duration + point), cycles)
        missing = pin.rnea(model, data, motion.q[1], motion.v[1], motion.a[1])
        missing[plan.n_unactuated :] -= motion.tau[1]
        for frame, wrench in zip(plan.contact_frames, motion.f[1], strict=True):
            number = model.getFrameId(frame)
            axes = pin.LOCAL_WORLD_ALIGNED
            missing -= pin.computeFrameJacobian(model, data, motion.q[1], number, axes).T @ wrench
        allowed = ASYMMETRY if past and kind == "mirrored walk" else SOLVED
        assert np.abs(missing).max() < allowed * pin.computeTotalMass(model) * 9.81


@pytest.mark.parametrize("kind", GAITS)
def test_cycles_join_without_a_jump(kind: str) -> None:
    plan = plan_to_export(kind)
    duration = plan.t[-1]
    motion = sample_cycles(plan, 1000 / duration, 2)
    moved = pin.difference(plan.model, motion.q[999], motion.q[1001])
    jump = moved - (motion.v[999] + motion.v[1001]) / 1000 * duration
    assert np.abs(jump).max() < CLOSING


@pytest.mark.parametrize("kind", KINDS)
def test_velocities_of_links_are_derivatives_of_their_poses(kind: str) -> None:
    motion = sample_cycles(plan_to_export(kind), FINE)
    row = len(motion.t) // 4
    position, quaternion = motion.links.position, motion.links.quaternion
    linear = (position[row + 1] - position[row - 1]) * FINE / 2
    assert_allclose(motion.links.linear_velocity[row], linear, atol=DIFFERENCE)
    for column in range(len(motion.links.names)):
        before, after = (rotation_of(quaternion[row + step, column]) for step in (-1, 1))
        assert_allclose(
            motion.links.angular_velocity[row, column], pin.log3(after @ before.T) * FINE / 2, atol=DIFFERENCE
        )


def test_a_sample_at_an_impact_has_the_values_after_it() -> None:
    plan = plan_to_export("an impact")
    after, row = int(plan.impact_index[0]), 4
    motion = sample_cycles(plan, row / plan.t[after])
    assert motion.t[row] == pytest.approx(plan.t[after])
    assert_allclose(motion.v[row], plan.v[after], atol=ROUNDING)
    assert np.abs(plan.v[after] - plan.v[after - 1]).max() > FELT
    place = place_of(plan.model, motion.links.names[-1], plan.q[after], plan.v[after])
    assert_allclose(motion.links.linear_velocity[row, -1], place.linear, atol=ROUNDING)
    assert motion.active[row, 0]
    assert not motion.active[row - 1, 0]


def test_angles_of_joints_without_end_count_whole_turns() -> None:
    """Three turns a second, of which ten samples a second see a third each."""
    t, rate = np.arange(40) / 10, 6 * np.pi
    q = np.column_stack([np.cos(rate * t + 1), np.sin(rate * t + 1)])
    found = counted_angle(q, np.full(40, rate), t)
    assert_allclose(found, rate * t + 1, atol=ROUNDING)


def test_quaternions_keep_their_sign_along_time() -> None:
    turned = np.array([[-1.0, 0, 0, 0], [1, 0, 0, 0], [-0.9, 0.1, 0, 0], [0.9, -0.1, 0, 0]])
    assert (without_jumps(turned)[:, 0] > 0).all()


def test_a_fixed_link_is_a_link_and_the_world_is_none() -> None:
    names = sample_cycles(swinging_arm()).links.names
    assert {"base_link", "shoulder_link", "tool0"} <= set(names)
    assert not {"world", "universe"} & set(names)
    assert names.index("shoulder_link") < names.index("wrist_3_link")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"cycles": 2}, "the solution is not periodic; allowed: `cycles=1`"),
        ({"cycles": 0}, "cycles"),
        ({"rate": 0.0}, "rate"),
        ({"rate": 1e9}, "allowed: 200000 samples"),
    ],
)
def test_bad_settings_are_refused_in_one_line(settings: dict[str, float], words: str) -> None:
    assert_refused_in_one_line(lambda: sample_cycles(swinging_arm(), **settings), words)
