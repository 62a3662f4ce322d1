"""A known wrench on a link over time: wind, a rope, a cable, a tool.

    M a + h = S^T tau + sum_c J_c^T f_c + J^T w(t)

with J of a point of the link, and w linear in time between samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.arguments import Array3, checked
from trajopt.errors import InputError, numbers_of, shown
from trajopt.robot.contact import require_frame


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class LinkWrench:
    """A known force and torque on a link, constant or linear in time between samples.

    Args:
        frame: name of a frame of the model that moves.
        force: on the robot, (3,) or (n, 3), N, in world axes.
        torque: about the point, (3,) or (n, 3), N m, in world axes; one value holds at all times.
        times: (n,), s from the start of the motion, not descending; equal ones are a jump. Outside them the
            first and the last value hold. None for a constant wrench.
        point: where the force acts, (3,), m, in the frame's axes; default its origin.

    Raises:
        InputError: for numbers that are not finite, other shapes, or times that descend.
    """

    frame: str
    force: Any = (0.0, 0.0, 0.0)
    torque: Any = (0.0, 0.0, 0.0)
    times: Any = None
    point: Array3 = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        times = np.atleast_1d(numbers_of(0.0 if self.times is None else self.times))
        if not len(times) or times.ndim > 1 or not np.isfinite(times).all() or (np.diff(times) < 0).any():
            what = f"times of the wrench on '{self.frame}' are {shown(self.times)}"
            raise InputError(what, "allowed: (n,), finite, not descending, s")
        values = {"times": times}
        for name, unit in (("force", "N"), ("torque", "N m")):
            rows = numbers_of(getattr(self, name))
            values[name] = np.tile(rows, (len(times), 1)) if rows.shape == (3,) else rows
            if values[name].shape != (len(times), 3) or not np.isfinite(rows).all():
                what = f"{name} of the wrench on '{self.frame}' is {shown(getattr(self, name))}"
                raise InputError(what, f"allowed: (3,) or ({len(times)}, 3), finite, {unit}")
        for name, array in values.items():
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def at(self, t: Any) -> np.ndarray:
        """Force and torque (..., 6) at times (...), s; at a jump the later ones."""
        values = np.hstack([self.force, self.torque])
        place = np.interp(t, self.times, np.arange(len(values)))[..., None]
        before = place.astype(int)
        after = np.minimum(before + 1, len(values) - 1)[..., 0]
        return values[before[..., 0]] + (place - before) * (values[after] - values[before[..., 0]])

    def place(self, model: pin.Model) -> tuple[int, pin.SE3]:
        """Joint that moves the link, and the point in its axes. Raises `InputError`."""
        if not model.existFrame(self.frame):
            require_frame(model, self.frame, "a wrench")
        frame = model.frames[model.getFrameId(self.frame)]
        if not frame.parentJoint:
            raise InputError(f"a wrench acts on frame '{self.frame}', which is fixed", "allowed: moving ones")
        return int(frame.parentJoint), frame.placement * pin.SE3(np.eye(3), self.point)


def wrench_force(model: pin.Model, wrenches: Sequence[LinkWrench], t: Any, q: np.ndarray) -> np.ndarray:
    """Generalised forces J^T w (..., nv) of wrenches at times (...), s, and configurations (..., nq)."""
    rows = np.reshape(q, (-1, model.nq))
    total, data = np.zeros((len(rows), model.nv)), model.createData() if wrenches else None
    for wrench in wrenches:
        joint, place = wrench.place(model)
        for row, force, w in zip(rows, total, np.broadcast_to(wrench.at(t), (len(rows), 6)), strict=True):
            pin.computeJointJacobians(model, data, row)
            jacobian = pin.getFrameJacobian(model, data, joint, place, pin.LOCAL_WORLD_ALIGNED)
            force += jacobian.reshape(6, model.nv).T @ w
    return total.reshape(*np.shape(q)[:-1], model.nv)
