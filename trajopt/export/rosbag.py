"""ROS 2 bags (rosbag2, sqlite3), written by the package ``rosbags`` without ROS."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from trajopt.errors import not_among
from trajopt.export.exported_motion import ExportedMotion
from trajopt.export.formats import package_of_format
from trajopt.export.links import frame_motion, link_frames, without_jumps
from trajopt.motion.local_states import rotation_matrices

# Parent of the frames that have no parent link.
WORLD_FRAME = "world"
EXTRA = "ros"
# Nanoseconds per second; stamps are in nanoseconds.
NANOSECONDS = 1_000_000_000
# Entries of a covariance matrix; zeros mean that it is not known.
COVARIANCE = 36
# Version of the bag layout; ROS 2 reads it since it uses this version itself, and so does rosbags.
VERSION = 8
# First stamp, ns: tf takes a stamp of zero as "the latest", not as a time.
START = NANOSECONDS
# Fields of a trajectory's points -> arrays of `ExportedMotion`.
POINT_FIELDS = {
    "positions": "position",
    "velocities": "velocity",
    "accelerations": "acceleration",
    "effort": "torque",
}
# An infinite duration as rosbag2 writes it, s and ns.
ENDLESS = (9223372036, 854775807)


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameTree:
    """F frames at n times, each relative to its parent; SI units.

    names, parents: (F,); ``world`` is not a frame itself. fixed: (F,) whether it is fixed to its parent.
    position: (n, F, 3). quaternion: (n, F, 4) xyzw.
    """

    names: tuple[str, ...]
    parents: tuple[str, ...]
    fixed: tuple[bool, ...]
    position: np.ndarray
    quaternion: np.ndarray


def frame_tree(motion: ExportedMotion) -> FrameTree:
    """The tree of all links, and of the contact frames that are not links."""
    model, links = motion.model, motion.links
    contacts = {name: model.getFrameId(name) for name in motion.contact_frames if name not in links.names}
    touching = frame_motion(model, contacts, motion.q, motion.v)
    position = np.concatenate([links.position, touching.position], axis=1)
    turn = np.concatenate([links.quaternion, touching.quaternion], axis=1)[..., [1, 2, 3, 0]]
    frames, names = link_frames(model) | contacts, (*links.names, *contacts)
    joints = [
        model.frames[frames[name]].parentJoint if name in frames else model.getJointId(name) for name in names
    ]
    parents = _parents(model, frames, links.names, names, joints)
    moved, turned = _seen_from_parents(parents, position, turn)
    return FrameTree(
        names=names,
        parents=tuple(WORLD_FRAME if parent is None else names[parent] for parent in parents),
        fixed=tuple(
            joint == (0 if parent is None else joints[parent])
            for joint, parent in zip(joints, parents, strict=True)
        ),
        position=moved,
        quaternion=turned,
    )


def _parents(
    model: pin.Model,
    frames: dict[str, int],
    links: tuple[str, ...],
    names: tuple[str, ...],
    joints: list[int],
) -> list[int | None]:
    """Index of the parent link of each frame; None for the world.

    It is that of the robot's description. If the model does not have it, as behind a locked joint, it is the
    first link of the same joint, or of the joint before.
    """
    first = {joint: i for i, joint in reversed(list(enumerate(joints))) if i < len(links)}
    parents: list[int | None] = []
    for frame, (name, joint) in enumerate(zip(names, joints, strict=True)):
        above = _link_above(model, frames[name], links) if name in frames else None
        before = joint if first.get(joint, frame) != frame else model.parents[joint]
        if above is None and first.get(before, frame) != frame:
            above = first[before]
        parents.append(above)
    return parents


def _link_above(model: pin.Model, frame: int, links: tuple[str, ...]) -> int | None:
    """Index of the nearest link between a frame and the world; None if there is none."""
    passed: set[int] = set()
    while frame and frame not in passed:  # a locked joint may be its own parent
        passed.add(frame)
        frame = model.frames[frame].parentFrame
        above = model.frames[frame]
        if above.type == pin.BODY and above.name in links and frame not in passed:
            return links.index(above.name)
    return None


def _seen_from_parents(
    parents: list[int | None], position: np.ndarray, turn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, F, 3), and quaternions (n, F, 4) xyzw with continuous signs, relative to the parents."""
    moved, turned = position.copy(), turn.copy()
    for frame, parent in enumerate(parents):
        if parent is not None:
            back = Rotation.from_quat(turn[:, parent]).inv()
            moved[:, frame] = back.apply(position[:, frame] - position[:, parent])
            turned[:, frame] = (back * Rotation.from_quat(turn[:, frame])).as_quat()
    return moved, without_jumps(turned[..., [3, 0, 1, 2]])[..., [1, 2, 3, 0]]


@dataclass(frozen=True, kw_only=True, eq=False)
class RosMessages:
    """Creates messages from a store of types that ``rosbags`` brings along."""

    store: Any

    @classmethod
    def load(cls) -> RosMessages:
        """Load the types of ROS 2; raises `InputError` if rosbags is not installed."""
        typesys = package_of_format("rosbags.typesys", EXTRA)
        return cls(store=typesys.get_typestore(typesys.Stores.ROS2_HUMBLE))

    def make(self, kind: str, **fields: Any) -> Any:
        """Create a message of a type such as "geometry_msgs/Vector3"."""
        whole = {  # the serialiser reads arrays as blocks of memory
            name: np.ascontiguousarray(value) if isinstance(value, np.ndarray) else value
            for name, value in fields.items()
        }
        return self.store.types[full_type(kind)](**whole)

    def bytes_of(self, kind: str, message: Any) -> Any:
        """Serialise a message for a bag."""
        return self.store.serialize_cdr(message, full_type(kind))

    def header(self, stamp: int, frame: str = "") -> Any:
        """A header with a stamp in ns."""
        seconds, rest = divmod(stamp, NANOSECONDS)
        time = self.make("builtin_interfaces/Time", sec=seconds, nanosec=rest)
        return self.make("std_msgs/Header", stamp=time, frame_id=frame)

    def duration(self, length: int) -> Any:
        """A duration of ``length`` ns."""
        seconds, rest = divmod(length, NANOSECONDS)
        return self.make("builtin_interfaces/Duration", sec=seconds, nanosec=rest)

    def xyz(self, kind: str, values: np.ndarray) -> Any:
        """A "geometry_msgs" vector or point of three numbers."""
        x, y, z = values.tolist()
        return self.make(f"geometry_msgs/{kind}", x=x, y=y, z=z)

    def rotation(self, quaternion: np.ndarray) -> Any:
        """A quaternion message from x, y, z, w."""
        x, y, z, w = quaternion.tolist()
        return self.make("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)

    def transform(
        self, stamp: int, frames: tuple[str, str], position: np.ndarray, quaternion: np.ndarray
    ) -> Any:
        """Pose of the second frame in the first."""
        placed = self.make(
            "geometry_msgs/Transform",
            translation=self.xyz("Vector3", position),
            rotation=self.rotation(quaternion),
        )
        parent, child = frames
        return self.make(
            "geometry_msgs/TransformStamped",
            header=self.header(stamp, parent),
            child_frame_id=child,
            transform=placed,
        )

    def wrench(self, stamp: int, frame: str, wrench: np.ndarray) -> Any:
        """Force and moment (6,) at a frame's origin, along its axes."""
        parts = self.make(
            "geometry_msgs/Wrench",
            force=self.xyz("Vector3", wrench[:3]),
            torque=self.xyz("Vector3", wrench[3:]),
        )
        return self.make("geometry_msgs/WrenchStamped", header=self.header(stamp, frame), wrench=parts)

    def odometry(
        self, stamp: int, frames: tuple[str, str], pose: tuple[np.ndarray, np.ndarray], twist: np.ndarray
    ) -> Any:
        """Pose of the second frame in the first, and its twist (6,) along its own axes."""
        unknown = np.zeros(COVARIANCE)
        placed = self.make(
            "geometry_msgs/Pose", position=self.xyz("Point", pose[0]), orientation=self.rotation(pose[1])
        )
        moved = self.make(
            "geometry_msgs/Twist",
            linear=self.xyz("Vector3", twist[:3]),
            angular=self.xyz("Vector3", twist[3:]),
        )
        return self.make(
            "nav_msgs/Odometry",
            header=self.header(stamp, frames[0]),
            child_frame_id=frames[1],
            pose=self.make("geometry_msgs/PoseWithCovariance", pose=placed, covariance=unknown),
            twist=self.make("geometry_msgs/TwistWithCovariance", twist=moved, covariance=unknown),
        )


def full_type(kind: str) -> str:
    """Full name of a type, as in a bag: "std_msgs/String" becomes "std_msgs/msg/String"."""
    library, _, name = kind.partition("/")
    return f"{library}/msg/{name}"


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
    """Write one motion; raises `InputError` for an unknown field, and where rosbags is not installed."""
    (motion,) = motions
    fields = _trajectory_fields(options.get("fields", ",".join(POINT_FIELDS)))
    messages, tree = RosMessages.load(), frame_tree(motion)
    rosbag2 = package_of_format("rosbags.rosbag2", EXTRA)
    inner = path / path.name  # the writer creates its folder and names its file after it
    with rosbag2.Writer(inner, version=VERSION) as writer:
        for key, value in (("robot", motion.robot), ("problem", motion.problem)):
            writer.set_custom_data(key, value)
        bag = _Bag(writer=writer, messages=messages)
        _write_once(bag, motion, tree, fields)
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


def _trajectory_fields(names: str) -> list[str]:
    """Fields of a point from their names, separated by commas; raises `InputError`."""
    fields = [name.strip() for name in names.split(",")]
    for name in fields:
        if name not in POINT_FIELDS:
            raise not_among(POINT_FIELDS, name, f"fields of a trajectory's points hold '{name}'")
    return fields


def _write_once(bag: _Bag, motion: ExportedMotion, tree: FrameTree, fields: Sequence[str]) -> None:
    """Write what does not change: URDF, transforms of fixed links, and the trajectory as one message."""
    make, text = bag.messages.make, _urdf(motion)
    if text is not None:
        described = make("std_msgs/String", data=text)
        bag.write("/robot_description", "std_msgs/String", START, described, latched=True)
    fixed = _transforms(bag.messages, motion, tree, 0, fixed=True)
    if fixed:
        message = make("tf2_msgs/TFMessage", transforms=fixed)
        bag.write("/tf_static", "tf2_msgs/TFMessage", START, message, latched=True)
    if motion.torque_names:
        kind = "trajectory_msgs/JointTrajectory"
        bag.write("/joint_trajectory", kind, START, _trajectory(bag.messages, motion, fields))


def _urdf(motion: ExportedMotion) -> str | None:
    """Text of the robot's URDF; None if it has none or its file is missing."""
    source = motion.description.visual
    if source is None or source.is_mjcf or not source.urdf.is_file():
        return None
    return source.urdf.read_text(encoding="utf-8", errors="replace")


def _trajectory(messages: RosMessages, motion: ExportedMotion, fields: Sequence[str]) -> Any:
    """Trajectory of the joints with a torque; a stamp of zero means that it starts when received."""
    joints = motion.joints
    names = [name for name in joints.names if name in motion.torque_names]
    columns = [joints.names.index(name) for name in names]
    values = {name: getattr(joints, array)[:, columns] for name, array in POINT_FIELDS.items()}
    empty = np.zeros(0)
    points = [
        messages.make(
            "trajectory_msgs/JointTrajectoryPoint",
            **{name: array[row] if name in fields else empty for name, array in values.items()},
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
    joints, odometry, wrenches = motion.joints, _odometry(messages, motion), _local_wrenches(motion)
    contacts = dict(zip(_topics(motion.contact_frames), motion.contact_frames, strict=True))
    for row in range(len(motion.t)):
        stamp = _stamp(motion, row)
        moving = _transforms(messages, motion, tree, row, fixed=False)
        yield "/tf", "tf2_msgs/TFMessage", row, messages.make("tf2_msgs/TFMessage", transforms=moving)
        if odometry:
            yield "/odom", "nav_msgs/Odometry", row, next(odometry)
        state = messages.make(
            "sensor_msgs/JointState",
            header=messages.header(stamp),
            name=list(joints.names),
            position=joints.position[row],
            velocity=joints.velocity[row],
            effort=joints.torque[row],
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
    frames = {name: motion.model.getFrameId(name) for name in motion.contact_frames}
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
