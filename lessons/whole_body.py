"""Newton's and Euler's equations of the whole robot, and their relation to the base rows of the dynamics.

The rate of momentum about the centre of mass is the wrench of gravity and contacts (Featherstone, "Rigid Body
Dynamics Algorithms", 2008, section 2.12); joint torques do not appear. `structure` defines the frames and the
transport to the base.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_content import frame_content
from trajopt.dynamics.model_quantities import generalized_force, require_shapes
from trajopt_library.lessons.newton_euler import outer_wrenches
from trajopt_library.lessons.structure import (
    MomentumMaps,
    base_joint_and_rows,
    composite_inertia,
    momentum_maps,
)


@dataclass(frozen=True, kw_only=True)
class WholeBodyBalance:
    """Newton's and Euler's equations of the whole robot, (6,) force N and moment N m each, at G.

    momentum_rate: rate of linear and angular momentum.
    gravity, contacts: wrench of the weight, and total wrench of the contacts.
    base_rows: (nb,), base rows of ``RNEA(q, v, a) - sum J^T f``.
    momentum: the maps between these rows and wrenches.
    """

    momentum_rate: np.ndarray
    gravity: np.ndarray
    contacts: np.ndarray
    base_rows: np.ndarray
    momentum: MomentumMaps

    @property
    def missing(self) -> np.ndarray:
        """Wrench (6,) that the motion needs beyond gravity and contacts.

        It is zero in a consistent motion of a floating base, and the bearing reaction of a fixed or planar
        base. Its base rows, ``momentum.base_rows(missing)``, equal ``base_rows`` for every motion.
        """
        return self.momentum_rate - self.gravity - self.contacts


def whole_body_balance(
    model: pin.Model,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    frames: Sequence[str] = (),
    wrenches: np.ndarray | None = None,
    base_joint: str | None = None,
) -> WholeBodyBalance:
    """Return the balance of the robot as a whole in a motion.

    Args:
        model: Model of any robot.
        motion: q (nq,), v (nv,), a (nv,).
        frames: Frames at whose origins wrenches act on the robot.
        wrenches: (n, 6: force N, moment N m), world axes.
        base_joint: Last joint of a virtual base; default: the root.

    Raises:
        InputError: If a frame, base or shape is wrong.
    """
    q, v, a = motion
    require_shapes(model, q=q, v=v, a=a)
    outer = outer_wrenches(frames, wrenches)
    for name in frames:
        frame_content(model, name)
    indices, rows = [model.getFrameId(name) for name in frames], base_joint_and_rows(model, base_joint)[1]
    data = model.createData()
    forces = generalized_force(model, data, motion, indices, outer)
    contacts, centre = np.zeros(6), pin.centerOfMass(model, data, q).copy()
    for index, wrench in zip(indices, outer, strict=True):
        arm = data.oMf[index].translation - centre
        contacts += np.concatenate([wrench[:3], wrench[3:] + np.cross(arm, wrench[:3])])
    rate = pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
    weight = composite_inertia(model, q).mass * model.gravity.linear
    return WholeBodyBalance(
        momentum_rate=rate.vector.copy(),
        gravity=np.concatenate([weight, np.zeros(3)]),
        contacts=contacts,
        base_rows=forces[:rows],
        momentum=momentum_maps(model, q, base_joint),
    )
