"""Quantities of a robot at one state for a controller: inertia, nonlinear effects, frames, centre of mass."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.robot.actuators.joint_force import JointForce, joint_force
from trajopt.robot.contact import require_frame
from trajopt.robot.link_wrench import LinkWrench, wrench_force


@dataclass(frozen=True, kw_only=True)
class FrameState:
    """A frame at one state, in world axes at its origin.

    ``placement`` is in the world, ``jacobian`` J (6, nv) has linear rows first, ``velocity`` (6,) is J v and
    ``drift`` (6,) is dJ/dt v.
    """

    placement: pin.SE3
    jacobian: np.ndarray
    velocity: np.ndarray
    drift: np.ndarray


class RobotState:
    """Quantities of a model at a state (q, v), recomputed by `update`.

    ``mass`` (nv, nv) and ``nonlinear`` (nv,) are M and h of M a + h = S' tau + J' f, with the forces of
    springs and friction at joints and of known wrenches in h (Featherstone, Rigid Body Dynamics Algorithms,
    2008, sec. 9.2). Frames and the centre of mass are computed on demand.
    """

    def __init__(
        self, model: pin.Model, joint_forces: Sequence[JointForce] = (), wrenches: Sequence[LinkWrench] = ()
    ) -> None:
        self.joint_forces, self.wrenches = joint_forces, wrenches
        self.model, self.data = model, model.createData()
        self.q, self.v = pin.neutral(model), np.zeros(model.nv)
        self.mass, self.nonlinear = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
        self._rest = np.zeros(model.nv)
        self._frames: dict[int | str, FrameState] = {}
        self._centre: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None = None

    def update(self, q: np.ndarray, v: np.ndarray, t: float = 0.0) -> None:
        """Set a state (nq,), (nv,) at ``t`` s. Raises `InputError` for wrong shapes or non-finite values."""
        model, data = self.model, self.data
        for name, given, size in (("q", q, model.nq), ("v", v, model.nv)):
            if np.shape(given) != (size,):
                raise InputError(f"{name} of a state has shape {np.shape(given)}", f"allowed: ({size},)")
            if not np.isfinite(given).all():
                index = int(np.flatnonzero(~np.isfinite(given))[0])
                raise InputError(f"{name}[{index}] of a state is {given[index]}", "allowed: finite numbers")
        self.q, self.v = q, v
        self.mass = pin.crba(model, data, q).copy()
        self.nonlinear = pin.nonLinearEffects(model, data, q, v) - joint_force(model, self.joint_forces, q, v)
        self.nonlinear -= wrench_force(model, self.wrenches, t, q)
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, self._rest)  # last: the calls above include gravity
        pin.updateFramePlacements(model, data)
        self._frames, self._centre = {}, None

    def frame(self, frame: int | str) -> FrameState:
        """The state of a frame, by name or by index in the model. Raises `InputError` for an unknown one."""
        known = self._frames.get(frame)
        if known is None:
            number = self._index(frame)
            axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            jacobian = pin.getFrameJacobian(self.model, self.data, number, axes).reshape(6, self.model.nv)
            drift = pin.getFrameClassicalAcceleration(self.model, self.data, number, axes).vector
            known = FrameState(
                placement=self.data.oMf[number],
                jacobian=jacobian,
                velocity=jacobian @ self.v,
                drift=drift,
            )
            self._frames[frame] = known
        return known

    def joint(self, frame: int | str) -> int:
        """The joint that carries a frame. Raises `InputError` for an unknown one."""
        return int(self.model.frames[self._index(frame)].parentJoint)

    def _index(self, frame: int | str) -> int:
        if isinstance(frame, str):
            require_frame(self.model, frame, "a task or contact")
            return int(self.model.getFrameId(frame))
        if not 0 <= frame < self.model.nframes:
            raise InputError(
                f"a task or contact is of frame {frame}",
                f"allowed: a frame's name, or an index from 0 to {self.model.nframes - 1}",
            )
        return frame

    def centre_of_mass(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Position (3,), velocity (3,), Jacobian (3, nv) and drift (3,) of the centre of mass, world."""
        if self._centre is None:
            data = self.data
            pin.centerOfMass(self.model, data, pin.KinematicLevel.ACCELERATION, False)
            jacobian = pin.jacobianCenterOfMass(self.model, data, False).copy()
            self._centre = data.com[0].copy(), data.vcom[0].copy(), jacobian, data.acom[0].copy()
        return self._centre

    def angular_momentum(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angular momentum (3,) about the centre of mass, its matrix (3, nv), and its drift (3,)."""
        matrix = np.array(pin.ccrba(self.model, self.data, self.q, self.v)[3:])
        pin.computeCentroidalMomentumTimeVariation(self.model, self.data, self.q, self.v, self._rest)
        return self.data.hg.angular.copy(), matrix, self.data.dhg.angular.copy()
