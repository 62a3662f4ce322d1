"""A motion sampled at requested times, one value per time, with names."""

import csv
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from trajopt.dynamics.manifold import Coordinates, Joint
from trajopt.errors import InputError, expanded, shown
from trajopt.motion.output import replacing
from trajopt.pickling import picklable
from trajopt.versions import optional_package

# Order of a quaternion's entries, and axes of a moving base's velocity and acceleration.
QuaternionOrder = Literal["xyzw", "wxyz"]
BaseAxes = Literal["body", "world"]
QUATERNION_ORDERS: tuple[QuaternionOrder, ...] = ("xyzw", "wxyz")
BASE_AXES: tuple[BaseAxes, ...] = ("body", "world")
LINEAR, ANGULAR = (tuple(f"{kind}_{axis}" for axis in "xyz") for kind in ("linear", "angular"))
AXES = "xyz"


def require_convention(quaternion: str, base_velocity: str) -> None:
    """Raise `InputError` for an unknown quaternion order or unknown axes of the base velocity."""
    if quaternion not in QUATERNION_ORDERS:
        raise InputError(f"quaternion is {shown(quaternion)}", "allowed: 'xyzw' or 'wxyz'")
    if base_velocity not in BASE_AXES:
        raise InputError(f"base_velocity is {shown(base_velocity)}", "allowed: 'body' or 'world'")


def position_names(model: pin.Model, quaternion: QuaternionOrder = "xyzw") -> tuple[str, ...]:
    """Return names (nq,) of the entries of q: the joint, with the entry if the joint has several."""
    turn = tuple(f"q{entry}" for entry in quaternion)
    entries = {
        "freeflyer": ("x", "y", "z", *turn),
        "spherical": turn,
        "planar": ("x", "y", "cos", "sin"),
        "continuous": ("cos", "sin"),
    }
    return _named(model, lambda joint: entries.get(joint.kind) or _plain(model, joint))


def velocity_names(model: pin.Model, base_velocity: BaseAxes = "body") -> tuple[str, ...]:
    """Return names (nv,) of the entries of v; those along body or world axes end with "body" or "world"."""

    def entries(joint: Joint) -> tuple[str, ...]:
        axes = base_velocity if is_base(model, joint) else "body"
        linear, angular = ([f"{entry}_{axes}" for entry in part] for part in (LINEAR, ANGULAR))
        if joint.kind == "planar":
            return (*linear[:2], ANGULAR[2])
        parts = {"freeflyer": (*linear, *angular), "spherical": tuple(angular)}
        return parts.get(joint.kind) or _plain(model, joint)

    return _named(model, entries)


def is_base(model: pin.Model, joint: Joint) -> bool:
    """Return whether a joint is the base: the first joint, if it is a free-flyer or planar."""
    return joint.kind in ("freeflyer", "planar") and model.names[1] == joint.name


def _plain(model: pin.Model, joint: Joint) -> tuple[str, ...]:
    if joint.v.stop - joint.v.start == 1:
        return ("",)
    turns = model.joints[model.getJointId(joint.name)].shortname() == "JointModelSphericalZYX"
    return ("rz", "ry", "rx") if turns else ("x", "y", "z")


def _named(model: pin.Model, entries: Callable[[Joint], tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(
        f"{joint.name}/{entry}" if entry else joint.name
        for joint in Coordinates(model).joints
        for entry in entries(joint)
    )


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class SampledMotion:
    """A motion at n times, one value each, from `Solution.sample`; SI units, read-only arrays.

    problem, robot: names. success: of the solution. t: (n,) s.
    q: (n, nq), ``position_names``; Pinocchio's convention, but quaternions in the order ``quaternion``.
    v, a: (n, nv), ``velocity_names``. For a free-flyer or planar base they are along ``base_velocity``: body
        axes as in Pinocchio (``a`` is the derivative of ``v``), or world axes, as derivatives of the base
        position, angular velocity and angular acceleration.
    tau: (n, nu) torques of the actuated rows, ``torque_names``, without joint friction.
    drive_torque: (n, nu) torques delivered by the drives: ``tau`` plus joint friction, which is known only
        if the robot ``has_drives``.
    angle: (n, m) angles, ``angle_names``, that q stores as cosine and sine; they count full turns.
    f: (n, nc, 6) force N and moment N m of the environment on each of ``contact_frames``, in world axes at
        the frame's origin; the moment is zero for a "point" (``contact_kinds``).
    active: (n, nc) whether the contact is active. phase: (n,) index into ``phase_names``.
    extrapolated: (n,) whether the time is before the first or after the last collocation point of its
        interval, where polynomials give a, tau, drive_torque and f without limits being imposed.
    """

    problem: str
    robot: str
    success: bool
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    drive_torque: np.ndarray
    angle: np.ndarray
    f: np.ndarray
    active: np.ndarray
    phase: np.ndarray
    extrapolated: np.ndarray
    joint_names: tuple[str, ...]
    position_names: tuple[str, ...]
    velocity_names: tuple[str, ...]
    torque_names: tuple[str, ...]
    angle_names: tuple[str, ...]
    contact_frames: tuple[str, ...]
    contact_names: tuple[str, ...]
    contact_kinds: tuple[str, ...]
    phase_names: tuple[str, ...]
    quaternion: QuaternionOrder
    base_velocity: BaseAxes
    has_drives: bool

    def __post_init__(self) -> None:
        for array in self.arrays.values():
            array.setflags(write=False)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Return all arrays by name."""
        named = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in named.items() if isinstance(value, np.ndarray)}

    @property
    def force(self) -> np.ndarray:
        """Contact forces (n, nc, 3) in world axes, N."""
        return self.f[:, :, :3]

    @property
    def moment(self) -> np.ndarray:
        """Contact moments (n, nc, 3) in world axes at the frames' origins, N m."""
        return self.f[:, :, 3:]

    @property
    def joint_position(self) -> np.ndarray:
        """Positions (n, nu) of the actuated joints, rad or m, in the order of ``torque_names``.

        Raises `InputError` if such a joint has several degrees of freedom.
        """
        names, values = (*self.position_names, *self.angle_names), np.hstack([self.q, self.angle])
        missing = [name for name in self.torque_names if name not in names]
        if missing:
            raise InputError(f"'{missing[0]}' has no position", "allowed: joints of one degree of freedom")
        return values[:, [names.index(name) for name in self.torque_names]]

    @property
    def joint_velocity(self) -> np.ndarray:
        """Velocities (n, nu) of the actuated joints, rad/s or m/s, in the order of ``torque_names``."""
        names = list(self.velocity_names)
        missing = [name for name in self.torque_names if name not in names]
        if missing:
            raise InputError(f"'{missing[0]}' has no velocity", "allowed: joints")
        return self.v[:, [names.index(name) for name in self.torque_names]]

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Return all values as columns (n,) by name.

        These are ``t`` s; ``phase`` by name; ``q/...``, ``v/...``, ``a/...``, ``angle/...``, ``tau/...`` and,
        with drives, ``drive_torque/...`` by the names of their entries; for each contact ``active/FRAME``,
        ``force/FRAME/x`` and, for a sole, ``moment/FRAME/x``; and ``extrapolated``.
        """
        table = {"t": self.t, "phase": np.array(self.phase_names, dtype=object)[self.phase]}
        groups = {
            "q": (self.position_names, self.q),
            "v": (self.velocity_names, self.v),
            "a": (self.velocity_names, self.a),
            "angle": (self.angle_names, self.angle),
            "tau": (self.torque_names, self.tau),
            "drive_torque": (self.torque_names if self.has_drives else (), self.drive_torque),
            "active": (self.contact_frames, self.active),
        }
        for group, (names, values) in groups.items():
            table |= {f"{group}/{name}": values[:, i] for i, name in enumerate(names)}
        for i, frame in enumerate(self.contact_frames):
            table |= {f"force/{frame}/{axis}": self.force[:, i, k] for k, axis in enumerate(AXES)}
            if self.contact_kinds[i] == "surface":
                table |= {f"moment/{frame}/{axis}": self.moment[:, i, k] for k, axis in enumerate(AXES)}
        return table | {"extrapolated": self.extrapolated}

    @property
    def facts(self) -> dict[str, str]:
        """Return what holds for all samples: names, success and conventions."""
        return {
            "problem": self.problem,
            "robot": self.robot,
            "success": str(self.success),
            "quaternion": self.quaternion,
            "base_velocity": self.base_velocity,
            "units": "SI: s, m, rad, N, N m",
        }

    def to_pandas(self) -> Any:
        """Return `columns` as a ``pandas.DataFrame`` with `facts` as its ``attrs``.

        Raises `InputError` if pandas is not installed.
        """
        frame = optional_package("pandas").DataFrame(self.columns)
        frame.attrs.update(self.facts)
        return frame

    def save(self, path: str | Path) -> Path:
        """Write a file in the format of the path's ending, completely or not at all; return its path.

        ``.csv``: `columns` below a line of names, numbers in full, flags as 0 and 1. ``.parquet``: `columns`
        with their types and `facts` as metadata; requires pyarrow. ``.npz``: all fields by name.

        Raises `InputError` for another ending, a path that cannot be written, or without pyarrow.
        """
        target = expanded(path)
        write = _WRITERS.get(target.suffix.lower())
        if write is None:
            raise InputError(f"cannot write {target}: unknown ending", f"allowed: {', '.join(_WRITERS)}")
        with replacing(target) as unfinished:
            write(self, unfinished)
        return target


def _write_csv(motion: SampledMotion, path: Path) -> None:
    columns = motion.columns
    plain = [(values.astype(int) if values.dtype == bool else values).tolist() for values in columns.values()]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*plain, strict=True))


def _write_parquet(motion: SampledMotion, path: Path) -> None:
    arrow, parquet = optional_package("pyarrow"), optional_package("pyarrow.parquet")
    table = arrow.table({name: arrow.array(values) for name, values in motion.columns.items()})
    parquet.write_table(table.replace_schema_metadata(motion.facts), path)


def _write_npz(motion: SampledMotion, path: Path) -> None:
    texts = {name: entry for name, entry in vars(motion).items() if isinstance(entry, tuple)}
    names = {name: np.array(entry, dtype=str) for name, entry in texts.items()}
    facts = {key: np.array(value) for key, value in motion.facts.items()}
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **motion.arrays, **names, **facts)


_WRITERS: dict[str, Callable[[SampledMotion, Path], None]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
    ".npz": _write_npz,
}
