"""Repeated cycles of a periodic plan: each pass is the periodic image of the previous one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import base_of
from trajopt.errors import InputError
from trajopt.motion.description import PeriodicImage
from trajopt.motion.robot_motion import RobotMotion
from trajopt.motion.sampled_motion import SampledMotion, turning_joints
from trajopt.motion.solution import Solution
from trajopt.robot.mirror import signed


def passes_of(plan: Solution, cycles: int) -> int:
    """Return how many passes of a plan make ``cycles`` cycles: two per cycle if the plan is half of one.

    Raises `InputError` for several cycles of a plan that is not periodic.
    """
    described = plan.description.periodicity
    if cycles > 1 and not described:
        raise InputError("the solution is not periodic", "allowed: `cycles=1`")
    return cycles * (2 if described and described.mirror else 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class CycleImage:
    """The map from a periodic plan's samples to those one pass later; arrays have one row per sample.

    described: periodicity of the state. duration: of a pass, s. index, sign: (nv,) for each row of v, the
    row that it is the image of, and its sign. contacts: for each contact, the one that it is the image of.
    actuated: rows (nu,) with a torque. to_force, to_moment: (3, 3) maps of forces and moments, world axes.
    """

    model: pin.Model
    described: PeriodicImage
    duration: float
    index: np.ndarray
    sign: np.ndarray
    contacts: list[int]
    actuated: np.ndarray
    to_force: np.ndarray
    to_moment: np.ndarray

    @classmethod
    def of(cls, plan: Solution) -> CycleImage:
        """Return the map for a plan; raises `InputError` if it is not periodic."""
        described = plan.description.periodicity
        if described is None:
            raise InputError("the solution is not periodic", "allowed: a plan with a periodicity")
        turned = pin.utils.rotate("z", described.turn)
        flip = np.array([1.0, -1.0, 1.0]) if described.mirror else np.ones(3)
        return cls(
            model=plan.model,
            described=described,
            duration=float(plan.interval_t[-1, 1] - plan.interval_t[0, 0]),
            index=described.index,
            sign=described.sign,
            contacts=image_of_contacts(plan, described),
            actuated=plan.actuated_rows,
            to_force=turned * flip,
            to_moment=turned * (flip if not described.mirror else -flip),
        )

    def of_states(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Images of configurations (n, nq) and velocities (n, nv)."""
        return periodic_image(self.model, self.described, q, v, self.duration)

    def of_motion(self, motion: SampledMotion) -> SampledMotion:
        """Image of a motion, with its times and phases; quaternions xyzw, the base along its own axes."""
        q, v = self.of_states(motion.q, motion.v)
        turning = [joint.v.stop - 1 for joint in turning_joints(self.model)]
        wrenches = motion.f[:, self.contacts]
        force, moment = wrenches[..., :3] @ self.to_force.T, wrenches[..., 3:] @ self.to_moment.T
        return replace(
            motion,
            q=q,
            v=v,
            a=self.sign * motion.a[:, self.index],
            angle=self.sign[turning] * motion.angle[:, [turning.index(row) for row in self.index[turning]]],
            jerk=self.sign * motion.jerk[:, self.index],
            tau=self.of_torques(motion.tau),
            torque_rate=self.of_torques(motion.torque_rate),
            drive_torque=self.of_torques(motion.drive_torque),
            f=np.concatenate([force, moment], axis=-1),
            active=motion.active[:, self.contacts],
        )

    def of_gains(self, gains: np.ndarray) -> np.ndarray:
        """Images of feedback gains (n, nu, 2 nv), see `Solution.gains`."""
        columns = np.concatenate([self.index, self.index + len(self.index)])
        turned = np.moveaxis(np.tile(self.sign, 2) * gains[:, :, columns], 1, 2)
        image = self.of_torques(turned.reshape(-1, gains.shape[1]))
        return np.moveaxis(image.reshape(turned.shape), 2, 1)

    def of_torques(self, torque: np.ndarray) -> np.ndarray:
        """Images of torques (n, nu)."""
        image, joints = torque.copy(), len(self.actuated)
        columns = np.searchsorted(self.actuated, self.index[self.actuated])
        image[:, :joints] = self.sign[self.actuated] * torque[:, columns]
        return image


def gains_in_passes(plan: Solution, times: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Return feedback gains (n, nu, 2 nv) of a plan at ``times`` (n,) in passes ``number`` (n,).

    Times are those of the plan, s. Gains are of the base's own axes, so that only a reflection changes them,
    and two cancel. Raises `InputError` for a plan without gains.
    """
    gains, odd = plan.gains(times), number % 2 == 1
    if odd.any():
        gains[odd] = CycleImage.of(plan).of_gains(gains[odd])
    return gains


def pass_numbers(plan: Solution, motion: SampledMotion) -> np.ndarray:
    """Return the pass (n,), from 0, in which each sample of a repeated plan lies, see `in_passes`."""
    return np.asarray((motion.phase - motion.source) // len(plan.phase_names))


def in_passes(plan: Solution, motion: SampledMotion, number: np.ndarray) -> SampledMotion:
    """Return samples (n,) of a periodic plan in passes ``number`` (n,), ascending from 0, see `passes_of`.

    Each pass is the image of the previous one. Times stay; phases are counted through all passes.
    """
    passes, names = int(number[-1]) + 1, plan.phase_names
    if passes > 1:
        image, parts = CycleImage.of(plan), []
        for past in range(passes):
            part = motion.at(number == past)
            for _ in range(past):
                part = image.of_motion(part)
            parts.append(part.rows)
        joined: dict[str, Any] = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
        motion = replace(motion, **joined)
    return replace(motion, phase=motion.source + number * len(names), phase_names=names * passes)


def image_of_contacts(plan: RobotMotion, described: PeriodicImage) -> list[int]:
    """Return for each contact the one it is the image of: the rows of v that move one map to the other's.

    Raises `InputError` if there is none.
    """
    index = described.index
    moved = [moving_rows(plan.model, frame) for frame in plan.contact_frames]
    images = [{int(index[row]) for row in rows} for rows in moved]
    for frame, image in zip(plan.contact_frames, images, strict=True):
        if image not in moved:
            raise InputError(
                f"the periodicity takes contact '{frame}' to none", "allowed: one of the contacts"
            )
    return [moved.index(image) for image in images]


def moving_rows(model: pin.Model, frame: str) -> set[int]:
    """Return the rows of v that move a frame."""
    rows: set[int] = set()
    for joint in list(model.supports[model.frames[model.getFrameId(frame)].parentJoint])[1:]:
        first = model.joints[joint].idx_v
        rows |= set(range(first, first + model.joints[joint].nv))
    return rows


def periodic_image(
    model: pin.Model, described: PeriodicImage, q: np.ndarray, v: np.ndarray, duration: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the image of a state (nq,), (nv,), or of n states (n, nq), (n, nv), under a periodicity."""
    index, sign = described.index, described.sign
    moved = described.moved(duration)
    turn, origin = described.turn, described.origin
    image = q.copy()
    for joint in list(model.joints)[1:]:
        if joint.nv == 1:
            other = next(
                candidate for candidate in list(model.joints)[1:] if candidate.idx_v == index[joint.idx_v]
            )
            image[..., joint.idx_q : joint.idx_q + joint.nq] = signed(
                q[..., other.idx_q : other.idx_q + other.nq], sign[joint.idx_v]
            )
    base = base_of(model)
    if base == "freeflyer":
        rotation = pin.utils.rotate("z", turn)
        position = q[..., :3] * sign[:3] + (1 - sign[:3]) * origin
        image[..., :3] = origin + (position - origin) @ rotation.T + moved
        mirrored = q[..., 3:7] * ([-1.0, 1.0, -1.0, 1.0] if described.mirror else np.ones(4))
        image[..., 3:7] = mirrored @ _turning(turn).T
    elif base == "planar":
        image[..., :2] += moved[[0, 2]]
    elif base == "virtual":
        image[..., :3] += moved
    return image, sign * v[..., index]


def periodicity_error(plan: Solution) -> float | None:
    """Return the largest difference (m, rad, m/s, rad/s) of the last state from the image of the first.

    `PeriodicImage` defines the image. None if the plan is not periodic.
    """
    described = plan.description.periodicity
    if not described:
        return None
    q, v = periodic_image(plan.model, described, plan.q[0], plan.v[0], float(plan.t[-1] - plan.t[0]))
    apart = pin.difference(plan.model, q, plan.q[-1])
    return float(max(np.abs(apart).max(), np.abs(v - plan.v[-1]).max()))


def _turning(turn: float) -> np.ndarray:
    """Return the matrix (4, 4) that turns quaternions (x, y, z, w) by ``turn`` rad about the vertical."""
    c, s = np.cos(turn / 2), np.sin(turn / 2)
    return np.array([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, c, s], [0.0, 0.0, -s, c]])
