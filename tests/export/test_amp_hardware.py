"""Motions of AMP for hardware, read as its AMPLoader does: 61 numbers a frame, legs in Isaac Gym's order."""

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from tests.support.exported_plans import ROUNDING, place_of, plan_to_export, swinging_quadruped
from tests.support.refusals import assert_refused_in_one_line
from tests.support.synthetic_motions import sampled, standing
from trajopt.export.writing import export_motion

pytestmark = pytest.mark.long

RATE = 50
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
