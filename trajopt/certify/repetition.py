"""A periodic plan cycle after cycle: each is the image of the one before under the plan's periodicity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.certify.closing import periodic_image
from trajopt.errors import InputError
from trajopt.solution.solution import Solution


def passes_of(plan: Solution, cycles: int) -> int:
    """How often a plan is gone through in ``cycles`` cycles: half a cycle and its mirror image are two.

    Raises `InputError` for several cycles of a plan that is not periodic.
    """
    described = plan.meta.get("periodicity")
    if cycles > 1 and not described:
        raise InputError("the solution is not periodic", "allowed: --cycles 1")
    return cycles * (2 if described and described["mirror"] else 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class CycleImage:
    """The map from a periodic plan's samples to those one pass later; arrays have one row a sample.

    described: the key ``periodicity`` of meta. duration: of a pass, s. index, sign: (nv,) for each row of v
    the one that it comes from. contacts: for each contact the one whose image it is. first: number of
    unactuated rows. to_force, to_moment: (3, 3) maps of contact forces and moments, world axes.
    """

    model: pin.Model
    described: dict[str, Any]
    duration: float
    index: np.ndarray
    sign: np.ndarray
    contacts: list[int]
    first: int
    to_force: np.ndarray
    to_moment: np.ndarray

    @classmethod
    def of(cls, plan: Solution) -> CycleImage:
        """The map of a plan that is periodic."""
        described = plan.meta["periodicity"]
        turned = pin.utils.rotate("z", float(described["turn"]))
        flip = np.array([1.0, -1.0, 1.0]) if described["mirror"] else np.ones(3)
        return cls(
            model=plan.model,
            described=described,
            duration=float(plan.interval_t[-1, 1] - plan.interval_t[0, 0]),
            index=np.array(described["index"], dtype=int),
            sign=np.array(described["sign"], dtype=float),
            contacts=image_of_contacts(plan, described),
            first=plan.n_unactuated,
            to_force=turned * flip,
            to_moment=turned * (flip if not described["mirror"] else -flip),
        )

    def of_states(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Images of configurations (n, nq) and velocities (n, nv)."""
        return periodic_image(self.model, self.described, q, v, self.duration)

    def of_accelerations(self, a: np.ndarray) -> np.ndarray:
        """Images of accelerations (n, nv)."""
        return np.asarray(self.sign * a[:, self.index])

    def of_torques(self, torque: np.ndarray) -> np.ndarray:
        """Images of torques (n, nu)."""
        return np.asarray(self.sign[self.first :] * torque[:, self.index[self.first :] - self.first])

    def of_contact_forces(self, f: np.ndarray) -> np.ndarray:
        """Images of contact forces and moments (n, nc, 6)."""
        own = f[:, self.contacts]
        return np.concatenate([own[..., :3] @ self.to_force.T, own[..., 3:] @ self.to_moment.T], axis=-1)

    def of_contacts(self, active: np.ndarray) -> np.ndarray:
        """Images of what is known of each contact (n, nc)."""
        return active[:, self.contacts]


def image_of_contacts(plan: Solution, described: dict[str, Any]) -> list[int]:
    """For each contact, the one whose image it is: the rows of v that move it map to the rows of that one."""
    index = np.array(described["index"], dtype=int)
    moved = [moving_rows(plan.model, frame) for frame in plan.contact_frames]
    return [moved.index({int(index[row]) for row in rows}) for rows in moved]


def moving_rows(model: pin.Model, frame: str) -> set[int]:
    """Rows of v that move a frame."""
    found: set[int] = set()
    for joint in list(model.supports[model.frames[model.getFrameId(frame)].parentJoint])[1:]:
        first = model.joints[joint].idx_v
        found |= set(range(first, first + model.joints[joint].nv))
    return found
