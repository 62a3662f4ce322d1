"""The motion that a replay shows: a solution at an even frame rate, as placements in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.model_quantities import gravity_of, mass_of
from trajopt.solution import Solution

# Pictures a second of playback: what screens show.
FRAME_RATE = 60.0
# A sole pressed with less than this part of the weight has no meaningful centre of pressure.
LEAST_PRESSURE = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A solution at n frames; njoints counts the universe, nc contacts.

    t: (n,) s of the solution. frame_rate: frames a second of playback. speed: solution over playback time.
    joints: (n, njoints, 4, 4) world placements. feet: (n, nc, 3) m, contact frames.
    pressed: (n, nc, 3) m, where the force acts. force: (n, nc, 3) N in world axes. active: (n, nc).
    weight: N.
    """

    t: np.ndarray
    frame_rate: float
    speed: float
    joints: np.ndarray
    feet: np.ndarray
    pressed: np.ndarray
    force: np.ndarray
    active: np.ndarray
    weight: float

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.t)


def motion_of(solution: Solution, speed: float = 1.0) -> Motion:
    """Resample ``solution`` on the manifold at about `FRAME_RATE`, first and last sample included.

    Forces are interpolated linearly within an interval. Raises `InputError` without a duration.
    """
    start, duration = float(solution.t[0]), float(solution.t[-1] - solution.t[0])
    if not duration > 0:
        raise InputError("the solution lasts 0 s", "a replay needs a duration")
    steps = max(1, round(duration / speed * FRAME_RATE))
    t = start + duration * np.linspace(0.0, 1.0, steps + 1)
    joints, contacts = _placements(solution, solution.interpolate(t))
    wrench, active = _contact_wrenches(solution, t)
    weight = _weight(solution.model)
    feet = contacts[:, :, :3, 3]
    return Motion(
        t=t,
        frame_rate=steps * speed / duration,
        speed=speed,
        joints=joints,
        feet=feet,
        pressed=feet + _pressure_offsets(solution, contacts, wrench, weight),
        force=wrench[:, :, :3],
        active=active,
        weight=weight,
    )


def _placements(solution: Solution, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World placements of the joints (n, njoints, 4, 4) and contact frames (n, nc, 4, 4)."""
    model, data = solution.model, solution.model.createData()
    frames = [model.getFrameId(name) for name in solution.contact_frames]
    joints = np.empty((len(q), model.njoints, 4, 4))
    contacts = np.empty((len(q), len(frames), 4, 4))
    for row, configuration in enumerate(q):
        pin.framesForwardKinematics(model, data, configuration)
        for joint in range(model.njoints):
            joints[row, joint] = data.oMi[joint].homogeneous
        for column, frame in enumerate(frames):
            contacts[row, column] = data.oMf[frame].homogeneous
    return joints, contacts


def _contact_wrenches(solution: Solution, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    last = np.clip(np.searchsorted(solution.t, t, side="right") - 1, 0, len(solution.t) - 2)
    span = solution.t[last + 1] - solution.t[last]
    part = np.where(span > 0, (t - solution.t[last]) / np.where(span > 0, span, 1.0), 1.0)
    part = np.clip(part, 0.0, 1.0)[:, None, None]
    wrench = (1 - part) * solution.f[last] + part * solution.f[last + 1]
    return wrench, solution.active[last]


def _pressure_offsets(
    solution: Solution, contacts: np.ndarray, wrench: np.ndarray, weight: float
) -> np.ndarray:
    """From each contact frame to its centre of pressure, ``n x m / (n . f)``; zero for points."""
    offsets = np.zeros((*wrench.shape[:2], 3))
    normal, force, moment = contacts[:, :, :3, 2], wrench[:, :, :3], wrench[:, :, 3:]
    pressure = np.einsum("nci,nci->nc", normal, force)
    soles = np.array([kind == "surface" for kind in solution.meta.get("contact_kinds", ())], dtype=bool)
    if soles.any():
        pressed = (np.abs(pressure) > LEAST_PRESSURE * weight) & soles
        offsets[pressed] = np.cross(normal, moment)[pressed] / pressure[pressed][:, None]
    return offsets


def _weight(model: pin.Model) -> float:
    mass = mass_of(model)
    return mass * gravity_of(model) if mass > 0 else 1.0
