"""ROS 2 bags (rosbag2, sqlite3), written by the package ``rosbags`` without ROS."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.export.exported_motion import ExportedMotion
from trajopt.export.formats import package_of_format
from trajopt.export.links import frame_motion
from trajopt.export.ros_messages import EXTRA, NANOSECONDS, RosMessages, full_type
from trajopt.export.transforms import WORLD_FRAME, FrameTree, frame_tree
from trajopt.solution.local_states import rotation_matrices

# Version of the bag layout; ROS 2 reads it since it uses this version itself, and so does rosbags.
VERSION = 8
# First stamp, ns: tf takes a stamp of zero as "the latest", not as a time.
START = NANOSECONDS
# An infinite duration as rosbag2 writes it, s and ns.
ENDLESS = (9223372036, 854775807)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Bag:
    """A bag open for writing, and its topics so far."""

    writer: Any
    messages: RosMessages
    topics: dict[str, Any] = field(default_factory=dict)

    def write(self, topic: str, kind: str, stamp: int, message: Any, *, latched: bool = False) -> None:
        """Add a message; a latched one reaches later subscribers too, as tf and robot models need."""
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(
                topic,
                full_type(kind),
                typestore=self.messages.store,
                offered_qos_profiles=[_latched()] if latched else [],
            )
        self.writer.write(self.topics[topic], stamp, self.messages.bytes_of(kind, message))


def write_rosbag(motions: Sequence[ExportedMotion], path: Path, options: Mapping[str, Any]) -> None:
    """Write one motion; raises `InputError` where rosbags is not installed."""
    (motion,) = motions
    messages, tree = RosMessages.load(), frame_tree(motion)
    rosbag2 = package_of_format("rosbags.rosbag2", EXTRA)
    inner = path / path.name  # the writer creates its folder and names its file after it
    with rosbag2.Writer(inner, version=VERSION) as writer:
        for key, value in (("robot", motion.robot), ("problem", motion.problem)):
            writer.set_custom_data(key, value)
        bag = _Bag(writer=writer, messages=messages)
        _write_once(bag, motion, tree)
        for topic, kind, row, message in _sampled(messages, motion, tree):
            bag.write(topic, kind, _stamp(motion, row), message)
    for file in inner.iterdir():
        file.rename(path / file.name)
    inner.rmdir()


def _latched() -> Any:
    """Quality of service that keeps the last message for later subscribers."""
    kinds = package_of_format("rosbags.interfaces", EXTRA)
    endless = kinds.QosTime(*ENDLESS)
    return kinds.Qos(
        history=kinds.QosHistory.KEEP_LAST,
        depth=1,
        reliability=kinds.QosReliability.RELIABLE,
        durability=kinds.QosDurability.TRANSIENT_LOCAL,
        deadline=endless,
        lifespan=endless,
        liveliness=kinds.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=endless,
        avoid_ros_namespace_conventions=False,
    )


def _stamp(motion: ExportedMotion, row: int) -> int:
    return START + _since_start(motion, row)


def _since_start(motion: ExportedMotion, row: int) -> int:
    return round(float(motion.t[row]) * NANOSECONDS)


def _write_once(bag: _Bag, motion: ExportedMotion, tree: FrameTree) -> None:
    """Write what does not change: URDF, transforms of fixed links, and the trajectory as one message."""
    make, text = bag.messages.make, _urdf(motion)
    if text is not None:
        described = make("std_msgs/String", data=text)
        bag.write("/robot_description", "std_msgs/String", START, described, latched=True)
    fixed = _transforms(bag.messages, motion, tree, 0, fixed=True)
    if fixed:
        message = make("tf2_msgs/TFMessage", transforms=fixed)
        bag.write("/tf_static", "tf2_msgs/TFMessage", START, message, latched=True)
    if motion.plan.torque_names:
        kind = "trajectory_msgs/JointTrajectory"
        bag.write("/joint_trajectory", kind, START, _trajectory(bag.messages, motion))


def _urdf(motion: ExportedMotion) -> str | None:
    """Text of the robot's URDF; None if it has none or its file is missing."""
    source = motion.plan.description.visual
    if source is None or source.is_mjcf or not source.urdf.is_file():
        return None
    return source.urdf.read_text(encoding="utf-8", errors="replace")


def _trajectory(messages: RosMessages, motion: ExportedMotion) -> Any:
    """Trajectory of the joints with a torque; a stamp of zero means that it starts when received."""
    names = [name for name in motion.joint_names if name in motion.plan.torque_names]
    columns = [motion.joint_names.index(name) for name in names]
    points = [
        messages.make(
            "trajectory_msgs/JointTrajectoryPoint",
            positions=motion.joint_position[row, columns],
            velocities=motion.joint_velocity[row, columns],
            accelerations=motion.joint_acceleration[row, columns],
            effort=motion.joint_torque[row, columns],
            time_from_start=messages.duration(_since_start(motion, row)),
        )
        for row in range(len(motion.t))
    ]
    return messages.make(
        "trajectory_msgs/JointTrajectory", header=messages.header(0), joint_names=names, points=points
    )


def _sampled(
    messages: RosMessages, motion: ExportedMotion, tree: FrameTree
) -> Iterator[tuple[str, str, int, Any]]:
    """Yield topic, type, sample and message, in order of time."""
    names, odometry, wrenches = list(motion.joint_names), _odometry(messages, motion), _local_wrenches(motion)
    contacts = dict(zip(_topics(motion.plan.contact_frames), motion.plan.contact_frames, strict=True))
    for row in range(len(motion.t)):
        stamp = _stamp(motion, row)
        moving = _transforms(messages, motion, tree, row, fixed=False)
        yield "/tf", "tf2_msgs/TFMessage", row, messages.make("tf2_msgs/TFMessage", transforms=moving)
        if odometry:
            yield "/odom", "nav_msgs/Odometry", row, next(odometry)
        state = messages.make(
            "sensor_msgs/JointState",
            header=messages.header(stamp),
            name=names,
            position=motion.joint_position[row],
            velocity=motion.joint_velocity[row],
            effort=motion.joint_torque[row],
        )
        yield "/joint_states", "sensor_msgs/JointState", row, state
        for number, (topic, frame) in enumerate(contacts.items()):
            yield (
                topic,
                "geometry_msgs/WrenchStamped",
                row,
                messages.wrench(stamp, frame, wrenches[row, number]),
            )


def _transforms(
    messages: RosMessages, motion: ExportedMotion, tree: FrameTree, row: int, *, fixed: bool
) -> list[Any]:
    return [
        messages.transform(
            _stamp(motion, row),
            (tree.parents[i], tree.names[i]),
            tree.position[row, i],
            tree.quaternion[row, i],
        )
        for i in range(len(tree.names))
        if tree.fixed[i] == fixed
    ]


def _odometry(messages: RosMessages, motion: ExportedMotion) -> Iterator[Any] | None:
    """Odometry of the link that a moving base carries, sample by sample; None for a fixed base."""
    links, base = motion.links, motion.links.base
    if base is None:
        return None
    quaternion = links.quaternion[:, base][:, [1, 2, 3, 0]]
    turn = rotation_matrices(quaternion)
    twist = np.hstack(
        [
            np.einsum("nji,nj->ni", turn, velocity[:, base])
            for velocity in (links.linear_velocity, links.angular_velocity)
        ]
    )
    return (
        messages.odometry(
            _stamp(motion, row),
            (WORLD_FRAME, links.names[base]),
            (links.position[row, base], quaternion[row]),
            twist[row],
        )
        for row in range(len(motion.t))
    )


def _local_wrenches(motion: ExportedMotion) -> np.ndarray:
    """Contact forces and moments (n, nc, 6) along the axes of the contact frames."""
    frames = {name: motion.model.getFrameId(name) for name in motion.plan.contact_frames}
    quaternion = frame_motion(motion.model, frames, motion.q, motion.v).quaternion
    shape = (len(motion.t), len(frames), 3, 3)
    turn = rotation_matrices(quaternion[..., [1, 2, 3, 0]].reshape(-1, 4)).reshape(shape)
    parts = (np.einsum("ncji,ncj->nci", turn, motion.f[..., part]) for part in (slice(3), slice(3, 6)))
    return np.concatenate(list(parts), axis=-1)


def _topics(frames: Sequence[str]) -> list[str]:
    """Topics of contacts, in the characters that ROS allows; a number tells equal ones apart."""
    topics: list[str] = []
    for number, frame in enumerate(frames):
        name = re.sub(r"[^A-Za-z0-9_]|^(?=[0-9])", "_", frame)
        topic = f"/contacts/{name}/wrench"
        topics.append(f"/contacts/{name}_{number}/wrench" if topic in topics else topic)
    return topics
