"""A motion sampled at requested times, one value per time, with names."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt.dynamics.manifold import Coordinates, Joint
from trajopt.errors import InputError, expanded, require_positive, shown
from trajopt.motion.consistency import SAME_TIME
from trajopt.motion.interpolation import MotionSample
from trajopt.motion.local_states import local_state, rotation_matrices
from trajopt.motion.output import replacing
from trajopt.motion.robot_motion import (
    BaseAxes,
    QuaternionOrder,
    RobotMotion,
    is_base,
    position_names,
    velocity_names,
)
from trajopt.versions import optional_package

# Interval of a node: there contacts begin and end, and velocities, torques and forces may jump.
Side = Literal["after", "before"]
# A larger number of samples than 200 s at 1 kHz is a mistake and needs gigabytes.
MOST_SAMPLES = 200_000
AXES = "xyz"
# Fields of a sampled motion that a file has, and its names.
SAVED = ("t", "q", "v", "a", "tau", "drive_torque", "angle", "f", "active", "phase", "extrapolated")
NAMES = (
    *("joint_names", "position_names", "velocity_names", "torque_names", "angle_names"),
    *("contact_frames", "contact_names", "contact_kinds", "phase_names"),
)
_Motion = TypeVar("_Motion", bound="SampledMotion")


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledMotion(RobotMotion):
    """A motion at n times, one value each, from `Solution.sample`; SI units, read-only arrays.

    success: of the solution. t: (n,) s.
    q: (n, nq), ``position_names``; Pinocchio's convention, but quaternions in the order ``quaternion``.
    v, a: (n, nv), ``velocity_names``. For a free-flyer or planar base they are along ``base_velocity``: body
        axes as in Pinocchio (``a`` is the derivative of ``v``), or world axes, as derivatives of the base
        position, angular velocity and angular acceleration.
    tau: (n, nu) torques of the actuated rows, ``torque_names``, without joint friction.
    jerk: (n, nv) rates of ``a``, NaN for joints of several degrees of freedom. torque_rate: (n, nu) rates of
        ``tau``. Both are exported where jerks are the input.
    drive_torque: (n, nu) torques delivered by the drives: ``tau`` plus joint friction, which is known only
        if the robot ``has_drives``.
    angle: (n, m) angles, ``angle_names``, that q stores as cosine and sine; they count full turns.
    f: (n, nc, 6) force N and moment N m of the environment on each of ``contact_frames``, in world axes at
        the frame's origin; the moment is zero for a "point" (``contact_kinds``).
    active: (n, nc) whether the contact is active. phase: (n,) index into ``phase_names``.
    source: (n,) phase of the solution; in repeated cycles ``phase`` counts on.
    extrapolated: (n,) whether the time is before the first or after the last collocation point of its
        interval, where polynomials give a, tau, drive_torque and f without limits being imposed.
    """

    success: bool
    jerk: np.ndarray
    torque_rate: np.ndarray
    drive_torque: np.ndarray
    angle: np.ndarray
    source: np.ndarray
    extrapolated: np.ndarray
    phase_names: tuple[str, ...]
    quaternion: QuaternionOrder = "xyzw"
    base_velocity: BaseAxes = "body"

    def __post_init__(self) -> None:
        for array in self.rows.values():
            array.setflags(write=False)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of a file by name."""
        third = ("jerk", "torque_rate") if self.description.actuation == "jerk" else ()
        return {name: getattr(self, name) for name in (*SAVED, *third)}

    @property
    def rows(self) -> dict[str, np.ndarray]:
        """Return all arrays with one row per time by name."""
        return {name: getattr(self, name) for name in (*SAVED, "jerk", "torque_rate", "source")}

    def at(self: _Motion, rows: np.ndarray) -> _Motion:
        """Return the motion at some of its times, by index (k,)."""
        return replace(self, **{name: array[rows] for name, array in self.rows.items()})

    @property
    def problem(self) -> str:
        """Name of the problem."""
        return self.description.problem

    @property
    def robot(self) -> str:
        """Name of the robot."""
        return self.description.robot

    @property
    @override
    def position_names(self) -> tuple[str, ...]:
        return position_names(self.model, self.quaternion)

    @property
    @override
    def velocity_names(self) -> tuple[str, ...]:
        return velocity_names(self.model, self.base_velocity)

    @property
    def angle_names(self) -> tuple[str, ...]:
        """Names (m,) of the entries of ``angle``."""
        return tuple(joint.name for joint in turning_joints(self.model))

    @property
    def contact_kinds(self) -> tuple[str, ...]:
        """Kinds of the contacts, "point" or "surface"."""
        return tuple(contact.kind for contact in self.description.contacts)

    @property
    def has_drives(self) -> bool:
        """Whether the robot has drives."""
        return any(drive is not None for drive in self.drives)

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
        with drives, ``drive_torque/...``, and where jerks are the input ``jerk/...`` and ``torque_rate/...``,
        by the names of their entries; for each contact ``active/FRAME``, ``force/FRAME/x`` and, for a sole,
        ``moment/FRAME/x``; and ``extrapolated``.
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
        if self.description.actuation == "jerk":
            joints = np.isfinite(self.jerk).all(axis=0)
            known = tuple(name for name, joint in zip(self.velocity_names, joints, strict=True) if joint)
            groups["jerk"] = known, self.jerk[:, joints]
            groups["torque_rate"] = self.torque_names, self.torque_rate
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
    names = {name: np.array(getattr(motion, name), dtype=str) for name in NAMES}
    facts = {key: np.array(value) for key, value in motion.facts.items()}
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **motion.arrays, **names, **facts)


_WRITERS: dict[str, Callable[[SampledMotion, Path], None]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
    ".npz": _write_npz,
}


def sample_times(edges: np.ndarray, sampled: np.ndarray, rate: float | None, times: Any) -> np.ndarray:
    """Return times (n,) s of samples within a motion; raises `InputError`. See `Solution.sample`.

    edges: (I, 2) s of its intervals. sampled: (K,) s of its samples, used without ``rate`` and ``times``.
    """
    start, end = float(edges[0, 0]), float(edges[-1, 1])
    same = SAME_TIME * (end - start)
    if rate is not None and times is not None:
        raise InputError("rate and times are both given", "allowed: one of them")
    if times is not None:
        return _within(_numbers(times), start, end)
    if rate is None:
        return sampled[np.append(np.diff(sampled) > same, True)]
    require_positive("rate", rate, "Hz")
    rate = float(rate)
    count = (end - start) * rate
    if count >= MOST_SAMPLES:
        raise InputError(
            f"rate is {rate:g} Hz, {count:.3g} samples in {end - start:g} s",
            f"allowed: {MOST_SAMPLES} samples",
        )
    regular = start + np.arange(int(count + SAME_TIME * max(count, 1.0)) + 1) / rate
    return np.append(regular[regular < end - same], end)


def _numbers(times: Any) -> np.ndarray:
    try:
        numbers = np.atleast_1d(np.asarray(times))
    except ValueError:  # rows of different lengths
        numbers = np.zeros((0, 0))
    if numbers.ndim != 1 or numbers.dtype.kind not in "fiu":
        raise InputError(f"times are {shown(times)}", "allowed: a list of numbers, s")
    if not 0 < len(numbers) <= MOST_SAMPLES:
        raise InputError(f"times are {len(numbers)} numbers", f"allowed: 1 to {MOST_SAMPLES}")
    return numbers.astype(float)


def _within(times: np.ndarray, start: float, end: float) -> np.ndarray:
    same = SAME_TIME * (end - start)
    for row in np.flatnonzero(~((times >= start - same) & (times <= end + same)))[:1]:
        raise InputError(
            f"times[{row}] is {times[row]:.9g} s", f"allowed: within the motion, {start:g} to {end:.9g} s"
        )
    return np.clip(times, start, end)


def located(edges: np.ndarray, t: np.ndarray, side: Side) -> tuple[np.ndarray, np.ndarray]:
    """Return intervals at times ``t`` (n,) and fractions of them; a node is in the one on its ``side``."""
    if side not in get_args(Side):
        raise InputError(f"side is {shown(side)}", "allowed: 'after' or 'before'")
    same = SAME_TIME * float(edges[-1, 1] - edges[0, 0])
    if side == "after":
        numbers = np.searchsorted(edges[:, 0], t + same, side="right") - 1
    else:
        numbers = np.searchsorted(edges[:, 0], t - same, side="left") - 1
    numbers = np.clip(numbers, 0, len(edges) - 1)
    start, end = edges[numbers].T
    return numbers, np.clip((t - start) / (end - start), 0.0, 1.0)


def is_extrapolated(arrays: Mapping[str, np.ndarray], numbers: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return whether times ``t`` (n,) are outside the collocation points of intervals ``numbers`` (n,).

    A polynomial through one point is constant and does not extrapolate.
    """
    points, of_point = arrays["t"][arrays["collocation"]], arrays["interval"][arrays["collocation"]]
    first = points[np.searchsorted(of_point, numbers, side="left")]
    last = points[np.searchsorted(of_point, numbers, side="right") - 1]
    same = SAME_TIME * float(arrays["t"][-1] - arrays["t"][0])
    return (first < last) & ((t < first - same) | (t > last + same))


def in_convention(
    model: pin.Model, motion: MotionSample, quaternion: QuaternionOrder, base_velocity: BaseAxes
) -> MotionSample:
    """Convert the motion to a quaternion order and to axes of the base velocity."""
    q, v, a = motion.q.copy(), motion.v.copy(), motion.a.copy()
    for joint in Coordinates(model).joints:
        if base_velocity == "world" and is_base(model, joint):
            _, rate, second = local_state(model, motion.q, motion.q, motion.v, motion.a)
            v[:, joint.v], a[:, joint.v] = rate[:, joint.v], second[:, joint.v]
            if joint.rotation is not None:
                turn = rotation_matrices(motion.q[:, joint.q][:, 3:])
                for along, body in ((v, motion.v), (a, motion.a)):
                    along[:, joint.rotation] = np.einsum("nij,nj->ni", turn, body[:, joint.rotation])
        if quaternion == "wxyz" and joint.rotation is not None:
            entries = slice(joint.q.stop - 4, joint.q.stop)
            q[:, entries] = np.roll(q[:, entries], 1, axis=1)
    return MotionSample(q=q, v=v, a=a, tau=motion.tau, f=motion.f)


def turning_joints(model: pin.Model) -> list[Joint]:
    """Return the joints with an angle that q stores as cosine and sine."""
    return [joint for joint in Coordinates(model).joints if joint.kind in ("continuous", "planar")]


def angles_of(model: pin.Model, plan: RobotMotion, t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the angles (n, m) that q stores as cosine and sine, at times ``t`` (n,).

    They count full turns since the start of the plan, regardless of the times.
    """
    columns = []
    for joint in turning_joints(model):
        cos, sin = joint.q.stop - 2, joint.q.stop - 1
        near = np.interp(t, plan.t, np.unwrap(np.arctan2(plan.q[:, sin], plan.q[:, cos])))
        angle = np.arctan2(q[:, sin], q[:, cos])
        columns.append(angle + 2 * np.pi * np.round((near - angle) / (2 * np.pi)))
    return np.array(columns).T.reshape(len(t), len(columns))
