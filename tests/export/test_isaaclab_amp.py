"""Isaac Lab's motions, read as its MotionLoader does: names, order of quaternions, frames of velocities."""

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from tests.support.exported_plans import (
    KINDS,
    ROUNDING,
    SINGLE,
    moved_on,
    place_of,
    plan_to_export,
    rotation_of,
    swinging_quadruped,
)
from tests.support.refusals import assert_refused_in_one_line
from tests.support.synthetic_motions import sampled, standing
from trajopt.export.exported_motion import sample_cycles
from trajopt.export.writing import export_motion

pytestmark = pytest.mark.long

RATE = 50


class LoadedMotion:
    """What the loader keeps: names, arrays, the time between frames; and what it does not read."""

    def __init__(self, path: Path) -> None:
        with np.load(path) as data:
            self.dof_names, self.body_names = data["dof_names"].tolist(), data["body_names"].tolist()
            self.dt = 1.0 / data["fps"]
            keys = [f"dof_{kind}" for kind in ("positions", "velocities", "torques")]
            keys += [f"body_{kind}" for kind in ("positions", "rotations")]
            keys += [f"body_{kind}_velocities" for kind in ("linear", "angular")]
            self.arrays = {key: data[key] for key in (*keys, "contact_forces", "contact_active")}
            self.types = {key: data[key].dtype for key in keys}
            self.fps = data["fps"]


@pytest.mark.parametrize("kind", KINDS)
def test_file_has_the_keys_shapes_and_types_that_the_loader_reads(kind: str, tmp_path: Path) -> None:
    read = LoadedMotion(export_motion(plan_to_export(kind), "isaaclab-amp", tmp_path / "a.npz", RATE))
    frames = len(read.arrays["dof_positions"])
    links, dofs = len(read.body_names), len(read.dof_names)
    assert {str(kind) for kind in read.types.values()} == {"float32"}
    assert (read.fps.shape, read.fps.dtype.kind, int(read.fps)) == ((), "i", RATE)
    assert read.arrays["dof_velocities"].shape == (frames, dofs)
    assert read.arrays["body_rotations"].shape == (frames, links, 4)
    assert read.arrays["body_angular_velocities"].shape == (frames, links, 3)
    assert len(set(read.body_names)) == links
    assert all(isinstance(name, str) for name in (*read.dof_names, *read.body_names))


@pytest.mark.parametrize("kind", KINDS)
def test_every_frame_is_the_plan_by_numeric_pinocchio(kind: str, tmp_path: Path) -> None:
    plan, model = plan_to_export(kind), plan_to_export(kind).model
    read = LoadedMotion(export_motion(plan, "isaaclab-amp", tmp_path / "a.npz", RATE))
    for row in range(0, int(plan.t[-1] * RATE), 5):
        own = plan.sample(times=[row * read.dt])
        for column, name in enumerate(read.dof_names):
            position = own.q[0, own.position_names.index(name)]
            assert_allclose(read.arrays["dof_positions"][row, column], position, atol=SINGLE)
            rate = own.v[0, own.velocity_names.index(name)]
            assert_allclose(read.arrays["dof_velocities"][row, column], rate, rtol=SINGLE, atol=SINGLE)
            torque = own.drive_torque[0, own.torque_names.index(name)]
            assert_allclose(read.arrays["dof_torques"][row, column], torque, rtol=SINGLE, atol=SINGLE)
        for column, name in enumerate(read.body_names):
            place = place_of(model, name, own.q[0], own.v[0])
            arrays = {key: read.arrays[key][row, column] for key in read.arrays if key.startswith("body")}
            assert_allclose(arrays["body_positions"], place.pose.translation, atol=SINGLE)
            assert_allclose(rotation_of(arrays["body_rotations"]), place.pose.rotation, atol=SINGLE)
            assert_allclose(arrays["body_linear_velocities"], place.linear, atol=5 * SINGLE)
            assert_allclose(arrays["body_angular_velocities"], place.angular, rtol=SINGLE, atol=5 * SINGLE)
        assert_allclose(read.arrays["contact_forces"][row], own.force[0], rtol=SINGLE, atol=1e-4)
        assert_array_equal(read.arrays["contact_active"][row], own.active[0])


def test_cycles_follow_each_other(tmp_path: Path) -> None:
    plan, duration = plan_to_export("turning trot"), plan_to_export("turning trot").t[-1]
    path = export_motion(plan, "isaaclab-amp", tmp_path / "a.npz", 10 / duration, 3)
    positions = LoadedMotion(path).arrays["body_positions"][:, 0]
    assert len(positions) == 31
    for passed in (1, 2):
        expected = [moved_on(plan, passed).act(np.float64(row)) for row in positions[:10]]
        assert_allclose(positions[10 * passed : 10 * passed + 10], expected, atol=SINGLE)


def test_a_rate_that_is_no_whole_number_is_kept(tmp_path: Path) -> None:
    path = export_motion(plan_to_export("an arm"), "isaaclab-amp", tmp_path / "a.npz", 62.5)
    assert LoadedMotion(path).dt == 1 / 62.5
    assert len(sample_cycles(plan_to_export("an arm"), 62.5).t) == len(
        LoadedMotion(path).arrays["dof_positions"]
    )


# Sizes of a frame's parts, in their order.
PARTS = {
    "root_pos": 3,
    "root_rot": 4,
    "joint_pos": 12,
    "toe_pos": 12,
    "lin_vel": 3,
    "ang_vel": 3,
    "joint_vel": 12,
    "toe_vel": 12,
}
# Central differences at 4 kHz are off by the step squared: m/s.
FINE, DIFFERENCE = 4000.0, 1e-3


def loaded(path: Path) -> dict[str, np.ndarray]:
    """Parts of all frames, legs from PyBullet's order (FR, FL, RR, RL) to Isaac Gym's (FL, FR, RL, RR)."""
    described = json.loads(path.read_text())
    assert float(described["MotionWeight"]) > 0
    frames = np.array(described["Frames"])
    assert frames.shape[1] == sum(PARTS.values()) == 61
    starts = np.cumsum([0, *PARTS.values()])
    found = {name: frames[:, starts[i] : starts[i + 1]] for i, name in enumerate(PARTS)}
    for name in ("joint_pos", "toe_pos", "joint_vel", "toe_vel"):
        first, second, third, fourth = np.split(found[name], 4, axis=1)
        found[name] = np.hstack([second, first, fourth, third])
    return found | {"duration": np.array((len(frames) - 1) * float(described["FrameDuration"]))}


@pytest.mark.parametrize("base", ["freeflyer", "virtual"])
def test_frames_are_the_plan_by_numeric_pinocchio(base: str, tmp_path: Path) -> None:
    plan = plan_to_export("turning trot") if base == "freeflyer" else swinging_quadruped()
    read = loaded(export_motion(plan, "amp-hardware", tmp_path / "a.json", RATE))
    legs = ("FL", "FR", "HL", "HR")
    joints = [f"{leg}_{joint}" for leg in legs for joint in ("HAA", "HFE", "KFE")]
    assert plan.t[-1] - 1 / RATE < read["duration"] <= plan.t[-1]
    for row in range(len(read["root_pos"])):
        own = plan.sample(times=[row / RATE])
        root = place_of(plan.model, "base_link", own.q[0], own.v[0])
        back = root.pose.rotation.T
        assert_allclose(read["root_pos"][row], root.pose.translation, atol=ROUNDING)
        rotation = pin.Quaternion(read["root_rot"][row]).toRotationMatrix()  # x, y, z, w
        assert_allclose(rotation, root.pose.rotation, atol=ROUNDING)
        assert_allclose(read["lin_vel"][row], back @ root.linear, atol=ROUNDING)
        assert_allclose(read["ang_vel"][row], back @ root.angular, atol=ROUNDING)
        assert_allclose(read["joint_pos"][row], [own.q[0, own.position_names.index(j)] for j in joints])
        assert_allclose(read["joint_vel"][row], [own.v[0, own.velocity_names.index(j)] for j in joints])
        for number, leg in enumerate(legs):
            foot = place_of(plan.model, f"{leg}_FOOT", own.q[0], own.v[0])
            expected = root.pose.actInv(foot.pose.translation)
            assert_allclose(read["toe_pos"][row, 3 * number : 3 * number + 3], expected, atol=ROUNDING)


def test_velocities_of_toes_are_derivatives_of_their_places_on_the_base(tmp_path: Path) -> None:
    read = loaded(export_motion(plan_to_export("turning trot"), "amp-hardware", tmp_path / "a.json", FINE))
    row = len(read["toe_pos"]) // 4
    difference = (read["toe_pos"][row + 1] - read["toe_pos"][row - 1]) * FINE / 2
    assert_allclose(read["toe_vel"][row], difference, atol=DIFFERENCE)


@pytest.mark.parametrize(("name", "first"), [("anymal_c", "RF"), ("go2", "FR"), ("hyq", "rf")])
def test_legs_are_told_apart_by_where_they_are(name: str, first: str, tmp_path: Path) -> None:
    robot = trajopt.robot(name)
    plan = sampled(robot, [standing(robot)], 2)
    described = json.loads(export_motion(plan, "amp-hardware", tmp_path / "a.json").read_text())
    assert described["JointNames"][0].startswith(first)
    frame = np.array(described["Frames"][0])
    toes = frame[19:31].reshape(4, 3)
    assert_array_equal(np.sign(toes[:, 0]), [1, 1, -1, -1])
    assert_array_equal(np.sign(toes[:, 1]), [-1, 1, -1, 1])


def test_a_periodic_motion_wraps_and_another_does_not(tmp_path: Path) -> None:
    path = export_motion(plan_to_export("turning trot"), "amp-hardware", tmp_path / "a.json", RATE)
    assert json.loads(path.read_text())["LoopMode"] == "Wrap"
    robot = trajopt.robot("solo12")
    plan = sampled(robot, [standing(robot)], 2)
    path = export_motion(plan, "amp-hardware", path, RATE)
    assert json.loads(path.read_text())["LoopMode"] == "Clamp"


def test_torques_and_forces_are_beside_the_frames(tmp_path: Path) -> None:
    plan = plan_to_export("turning trot")
    described = json.loads(export_motion(plan, "amp-hardware", tmp_path / "a.json", RATE).read_text())
    own = plan.sample(times=[5 / RATE])
    torque = [own.drive_torque[0, own.torque_names.index(name)] for name in described["JointNames"]]
    assert_allclose(described["JointTorques"][5], torque)
    order = [own.contact_frames.index(name) for name in described["ToeNames"]]
    assert_allclose(described["ToeForces"][5], own.force[0, order].ravel())
    assert_array_equal(described["ToeContacts"][5], own.active[0, order])


@pytest.mark.parametrize("kind", ["mirrored walk", "an arm", "planar hops"])
def test_other_robots_are_refused_in_one_line(kind: str, tmp_path: Path) -> None:
    words = "allowed: a quadruped with a floating base and three joints a leg"
    target = tmp_path / "a.json"
    assert_refused_in_one_line(lambda: export_motion(plan_to_export(kind), "amp-hardware", target), words)
    assert list(tmp_path.iterdir()) == []
