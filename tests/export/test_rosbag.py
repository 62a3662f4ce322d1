"""ROS 2 bags, read back by rosbags: transforms, joints, odometry and wrenches are those of Pinocchio."""

import math
import re
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

import trajopt
from tests.support.command_lines import invoke
from tests.support.exported_plans import (
    ROUNDING,
    place_of,
    plan_to_export,
    resting_arm,
    swinging_arm,
    swinging_quadruped,
)
from tests.support.refusals import assert_refused_in_one_line
from trajopt.export.writing import export_motion
from trajopt.motion.solution import Solution

pytestmark = pytest.mark.long

RATE = 30
# What the solver leaves of limits, relative.
SOLVED = 1e-4
SECOND = 1_000_000_000
KINDS = ["turning trot", "mirrored walk", "planar hops", "an arm", "an impact"]


class Bag:
    """Messages of each topic, with their times in ns, in the order of the bag."""

    def __init__(self, folder: Path) -> None:
        self.messages: dict[str, list[tuple[int, Any]]] = defaultdict(list)
        self.types: dict[str, str] = {}
        self.latched: set[str] = set()
        with AnyReader([folder]) as reader:
            for connection in reader.connections:
                self.types[connection.topic] = connection.msgtype
                profiles = connection.ext.offered_qos_profiles  # type: ignore[union-attr]
                if any(own.durability == QosDurability.TRANSIENT_LOCAL for own in profiles):
                    self.latched.add(connection.topic)
            for connection, time, raw in reader.messages():
                message = reader.deserialize(raw, connection.msgtype)
                self.messages[connection.topic].append((time, message))

    def only(self, topic: str) -> Any:
        """The one message of a topic."""
        ((_, message),) = self.messages[topic]
        return message

    def poses(self, row: int) -> dict[str, pin.SE3]:
        """Poses of all frames in the world at a sample, composed as tf does; each has one parent."""
        given = list(self.messages["/tf"][row][1].transforms)
        given += [one for _, message in self.messages["/tf_static"] for one in message.transforms]
        above = {one.child_frame_id: one for one in given}
        assert len(above) == len(given)
        return {name: composed(above, name) for name in above}


def composed(above: dict[str, Any], name: str) -> pin.SE3:
    pose = pin.SE3.Identity()
    for _ in range(len(above) + 1):
        if name == "world":
            return pose
        own = above[name].transform
        place, turn = own.translation, own.rotation
        rotation = pin.Quaternion(turn.w, turn.x, turn.y, turn.z).toRotationMatrix()
        pose = pin.SE3(rotation, numbers(place)) * pose
        name = above[name].header.frame_id
    raise AssertionError(f"{name} hangs in a circle")


def numbers(vector: Any) -> np.ndarray:
    return np.array([vector.x, vector.y, vector.z])


def nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def exported(plan: Solution, path: Path, **settings: Any) -> Bag:
    return Bag(export_motion(plan, "rosbag", path / "bag", **({"rate": RATE} | settings)))


@pytest.mark.parametrize("kind", KINDS)
def test_stamps_are_even_and_those_of_the_bag(kind: str, tmp_path: Path) -> None:
    plan = plan_to_export(kind)
    bag = exported(plan, tmp_path)
    count = len(bag.messages["/joint_states"])
    end = plan.t[-1] * (2 if kind == "mirrored walk" else 1)
    assert -ROUNDING < (count - 1) / RATE - end < 1 / RATE
    for topic, messages in bag.messages.items():
        if len(messages) == 1:
            continue
        times = np.array([time for time, _ in messages])
        even = np.append(np.arange(count - 1) / RATE, end)
        assert_array_equal(times, np.round(SECOND * (1 + even)))
        for time, message in messages:
            headers = [one.header for one in message.transforms] if topic == "/tf" else [message.header]
            assert {nanoseconds(header.stamp) for header in headers} == {time}


@pytest.mark.parametrize("kind", [*KINDS, "a virtual base", "a locked joint"])
def test_transforms_compose_to_the_frames_of_pinocchio(kind: str, tmp_path: Path) -> None:
    made = {"a virtual base": swinging_quadruped, "a locked joint": lambda: swinging_arm(("elbow_joint",))}
    plan = made[kind]() if kind in made else plan_to_export(kind)
    bag, model = exported(plan, tmp_path), plan.model
    links = {frame.name for frame in model.frames if frame.type == pin.BODY} - {"world", "universe"}
    for row in (0, 5):
        own = plan.sample(times=[row / RATE])
        poses = bag.poses(row)
        assert set(poses) >= links | set(plan.contact_frames)
        for name, pose in poses.items():
            place = place_of(model, name, own.q[0], own.v[0]).pose
            assert_allclose(pose.translation, place.translation, atol=ROUNDING)
            assert_allclose(pose.rotation, place.rotation, atol=ROUNDING)


def test_links_hang_from_the_links_of_the_description(tmp_path: Path) -> None:
    bag = exported(plan_to_export("turning trot"), tmp_path)
    moving = {one.child_frame_id: one.header.frame_id for one in bag.messages["/tf"][3][1].transforms}
    fixed = {one.child_frame_id: one.header.frame_id for one in bag.only("/tf_static").transforms}
    assert (moving["base_link"], moving["FL_SHOULDER"]) == ("world", "base_link")
    assert moving["FL_LOWER_LEG"] == "FL_UPPER_LEG"
    assert fixed == {f"{leg}_FOOT": f"{leg}_LOWER_LEG" for leg in ("FL", "FR", "HL", "HR")}


@pytest.mark.parametrize("kind", KINDS)
def test_joint_states_and_the_trajectory_are_the_plan_by_name(kind: str, tmp_path: Path) -> None:
    plan = plan_to_export(kind)
    bag, row = exported(plan, tmp_path), 5
    own = plan.sample(times=[row / RATE])
    trajectory = bag.only("/joint_trajectory")
    assert nanoseconds(trajectory.header.stamp) == 0
    assert len(trajectory.points) == len(bag.messages["/joint_states"])
    point, (_, state) = trajectory.points[row], bag.messages["/joint_states"][row]
    assert nanoseconds(point.time_from_start) == round(row / RATE * SECOND)
    assert sorted(trajectory.joint_names) == sorted(own.torque_names)
    for name in own.torque_names:
        position = own.q[0, own.position_names.index(name)]
        rate = own.velocity_names.index(name)
        torque = own.drive_torque[0, own.torque_names.index(name)]
        here, there = trajectory.joint_names.index(name), state.name.index(name)
        assert_allclose([point.positions[here], state.position[there]], position, atol=ROUNDING)
        assert_allclose([point.velocities[here], state.velocity[there]], own.v[0, rate], atol=ROUNDING)
        assert_allclose(point.accelerations[here], own.a[0, rate], rtol=ROUNDING, atol=ROUNDING)
        assert_allclose([point.effort[here], state.effort[there]], torque, rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.parametrize(("kind", "base"), [("turning trot", "base_link"), ("planar hops", "torso")])
def test_odometry_has_the_twist_along_the_axes_of_the_base(kind: str, base: str, tmp_path: Path) -> None:
    plan = plan_to_export(kind)
    bag, row = exported(plan, tmp_path), 5
    own = plan.sample(times=[row / RATE])
    place = place_of(plan.model, base, own.q[0], own.v[0])
    _, found = bag.messages["/odom"][row]
    assert (found.header.frame_id, found.child_frame_id) == ("world", base)
    back, turn = place.pose.rotation.T, found.pose.pose.orientation
    rotation = pin.Quaternion(turn.w, turn.x, turn.y, turn.z).toRotationMatrix()
    assert_allclose(rotation, place.pose.rotation, atol=ROUNDING)
    assert_allclose(numbers(found.pose.pose.position), place.pose.translation, atol=ROUNDING)
    assert_allclose(numbers(found.twist.twist.linear), back @ place.linear, atol=ROUNDING)
    assert_allclose(numbers(found.twist.twist.angular), back @ place.angular, atol=ROUNDING)


@pytest.mark.parametrize("kind", ["turning trot", "mirrored walk", "planar hops"])
def test_wrenches_are_the_forces_of_the_plan_turned_by_tf(kind: str, tmp_path: Path) -> None:
    """Into world axes by the transform of the frame that their header names."""
    plan = plan_to_export(kind)
    bag = exported(plan, tmp_path)
    for row in (0, 5):
        own, poses = plan.sample(times=[row / RATE]), bag.poses(row)
        for number, frame in enumerate(own.contact_frames):
            _, found = bag.messages[f"/contacts/{frame}/wrench"][row]
            turn = poses[found.header.frame_id].rotation
            assert found.header.frame_id == frame
            assert_allclose(turn @ numbers(found.wrench.force), own.force[0, number], atol=1e-7)
            assert_allclose(turn @ numbers(found.wrench.torque), own.moment[0, number], atol=1e-7)


def test_what_is_sent_once_reaches_subscribers_that_come_later(tmp_path: Path) -> None:
    bag = exported(plan_to_export("turning trot"), tmp_path)
    assert bag.latched == {"/tf_static", "/robot_description"}
    assert bag.types["/robot_description"] == "std_msgs/msg/String"
    text = bag.only("/robot_description").data
    assert set(re.findall(r'<link name="(\w+)"', text)) >= set(bag.poses(0))


def test_a_robot_without_a_urdf_has_no_description_and_an_arm_no_odometry(tmp_path: Path) -> None:
    assert "/robot_description" not in exported(plan_to_export("planar hops"), tmp_path).types
    assert "/odom" not in exported(plan_to_export("an arm"), tmp_path).types


def test_later_cycles_move_on(tmp_path: Path) -> None:
    plan = plan_to_export("turning trot")
    bag = exported(plan, tmp_path, cycles=2)
    travelled = numbers(bag.messages["/odom"][-1][1].pose.pose.position)
    assert len(bag.messages["/odom"]) == math.ceil(2 * plan.t[-1] * RATE - ROUNDING) + 1
    once = numbers(bag.messages["/odom"][len(bag.messages["/odom"]) // 2][1].pose.pose.position)
    assert travelled[0] > 1.5 * once[0] > 0


def test_a_trajectory_ends_at_the_end_of_the_plan_with_the_fields_asked_for(tmp_path: Path) -> None:
    plan = resting_arm(1.0085)
    file, folder = plan.save(tmp_path / "plan.npz"), tmp_path / "bag"
    fields = ("--fields", "positions,velocities")
    assert invoke("export", file, "--format", "rosbag", "-o", folder, *fields).exit_code == 0
    *_, last = Bag(folder).only("/joint_trajectory").points
    assert nanoseconds(last.time_from_start) == 1_008_500_000
    assert_allclose(last.positions, plan.q[-1], atol=ROUNDING)
    assert_allclose(last.velocities, 0.0, atol=ROUNDING)
    assert len(last.accelerations) == len(last.effort) == 0


def test_a_trajectory_at_1_khz_keeps_limits_of_acceleration_jerk_and_torque_rate(tmp_path: Path) -> None:
    plan = trajopt.solve(trajopt.load("arm-transfer", robot="panda", actuation="jerk"))
    points = exported(plan, tmp_path, rate=1000).only("/joint_trajectory").points
    t = np.array([nanoseconds(point.time_from_start) for point in points]) / SECOND
    a, tau = (np.array([getattr(point, name) for point in points]) for name in ("accelerations", "effort"))
    limit = trajopt.robot("panda").joint_limit
    inside = slice(0, -1)  # the last step is shorter than the rounding of stamps allows
    for values, kind in ((a, "jerk"), (tau, "torque_rate")):
        rates = np.abs(np.diff(values, axis=0))[inside] / np.diff(t)[inside, None]
        assert (rates <= limit(kind) * (1 + SOLVED)).all(), kind
        assert (rates > 0.2 * limit(kind)).any(), kind
    assert (np.abs(a) <= limit("acceleration") * (1 + SOLVED)).all()


def test_unknown_fields_are_refused(tmp_path: Path) -> None:
    def write() -> None:
        export_motion(resting_arm(1.0), "rosbag", tmp_path / "bag", fields="positions,efort")

    assert_refused_in_one_line(write, "hold 'efort'; did you mean effort? allowed: positions, velocities")


def test_an_earlier_bag_is_replaced_and_another_folder_is_not(tmp_path: Path) -> None:
    plan, target = plan_to_export("an arm"), tmp_path / "bag"
    for _ in range(2):
        export_motion(plan, "rosbag", target, RATE)
        assert sorted(path.name for path in target.iterdir()) == ["bag.db3", "metadata.yaml"]
    assert list(tmp_path.iterdir()) == [target]
    (target / "metadata.yaml").unlink()
    words = "it is there and is no such export; allowed: another name"
    assert_refused_in_one_line(lambda: export_motion(plan, "rosbag", target, RATE), words)


def test_missing_rosbags_is_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_to_export("an arm")
    for name in ("rosbags", "rosbags.typesys"):
        monkeypatch.setitem(sys.modules, name, None)
    words = "needs rosbags, which is not installed; pip install rosbags, or the extra 'ros'"
    assert_refused_in_one_line(lambda: export_motion(plan, "rosbag", tmp_path / "bag"), words)
    assert list(tmp_path.iterdir()) == []
