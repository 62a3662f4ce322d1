"""ROS 2 messages by the name of their type, serialised by the package ``rosbags``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trajopt.export.formats import package_of_format

EXTRA = "ros"
# Nanoseconds per second; stamps are in nanoseconds.
NANOSECONDS = 1_000_000_000
# Entries of a covariance matrix; zeros mean that it is not known.
COVARIANCE = 36


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
