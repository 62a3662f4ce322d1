"""Sample times of a motion, and the conventions of its samples."""

from collections.abc import Mapping
from typing import Any, Literal, get_args

import numpy as np
import pinocchio as pin

from trajopt.dynamics.manifold import Coordinates
from trajopt.errors import InputError, require_positive, shown
from trajopt.motion.consistency import SAME_TIME
from trajopt.motion.interpolation import MotionSample
from trajopt.motion.local_states import local_state, rotation_matrices
from trajopt.motion.sampled_motion import BaseAxes, QuaternionOrder, is_base

# Interval of a node: there contacts begin and end, and velocities, torques and forces may jump.
Side = Literal["after", "before"]
# A larger number of samples than 200 s at 1 kHz is a mistake and needs gigabytes.
MOST_SAMPLES = 200_000


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


def angles_of(
    model: pin.Model, plan: Mapping[str, np.ndarray], t: np.ndarray, q: np.ndarray
) -> tuple[tuple[str, ...], np.ndarray]:
    """Return names and values (n, m) of the angles that q stores as cosine and sine, at times ``t`` (n,).

    They count full turns since the start of the plan, regardless of the times.
    """
    names, columns = [], []
    for joint in Coordinates(model).joints:
        if joint.kind in ("continuous", "planar"):
            cos, sin = joint.q.stop - 2, joint.q.stop - 1
            near = np.interp(t, plan["t"], np.unwrap(np.arctan2(plan["q"][:, sin], plan["q"][:, cos])))
            angle = np.arctan2(q[:, sin], q[:, cos])
            names.append(joint.name)
            columns.append(angle + 2 * np.pi * np.round((near - angle) / (2 * np.pi)))
    return tuple(names), np.array(columns).T.reshape(len(t), len(names))
