"""The robot's functions at one point as a chain of layers, from local coordinates to forces.

For a free-flyer the inverse dynamics and the contacts' accelerations need no orientation once all is
in base axes, and do not depend on the base's own velocity (Galilean invariance). Gravity enters as
an acceleration of the base, s = R^T (p'' - g), and wrenches are turned into base axes. So three layers
replace one graph over (q, v, a, w), and the rigid-body algorithm is differentiated over 10 fewer inputs:

    z -> (quaternion, omega, omega', p'', joints, w)             exponential coordinates
      -> (omega, s, omega', joints, R^T w, R^T g)                base axes
      -> (tau, contact accelerations)                            Pinocchio, base at the identity
"""

from collections.abc import Mapping

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.dynamics import rigid_body
from trajopt.dynamics.rotations import body_rates, exp_quaternion, quaternion_product, rotation_matrix
from trajopt.robot.contact import Contact
from trajopt.terms.context import Context
from trajopt.terms.context_symbols import Place, without_rolling

_Levers = Mapping[Contact, ca.SX | ca.DM]
_Layers = tuple[ca.Function, ...]


def robot_layers(context: Context, expression: ca.SX) -> tuple[ca.SX, _Layers]:
    """Symbols o that ``expression`` uses, and the layers that compute them from the context's z."""
    groups = [context.dynamics_symbols(), context.frame_symbols()]
    outputs = ca.vertcat(*groups)
    pattern = ca.jacobian_sparsity(expression, outputs)
    used = np.unique(pattern.get_triplet()[1]).astype(int)
    if len(used) == 0:
        return ca.SX(0, 1), ()
    split = groups[0].numel()
    if np.all(used < split) and context.has_free_flyer:
        return outputs[used.tolist()], _base_axes_layers(context, used.tolist())
    return outputs[used.tolist()], _plain_layers(context, used.tolist())


def _plain_layers(context: Context, used: list[int]) -> _Layers:
    """Layers z -> (q, v, a, w) -> o.

    Where the dynamics do not depend on velocity (statics, impacts), it enters frames alone; impacts have no
    gravity.
    """
    wrench = context.wrench_column()
    sizes = [part.numel() for part in (context.q, context.v, context.a, wrench)]
    first = ca.Function("to_pinocchio", [context.z], [ca.vertcat(context.q, context.v, context.a, wrench)])
    s = ca.SX.sym("s", sum(sizes))
    q, v, a, forces = ca.vertsplit(s, [0, *np.cumsum(sizes).tolist()])
    levers: _Levers = {contact: ca.DM(lever) for contact, lever in _levers(context).items()}
    frames, dimensions, w = _loads(context, forces, levers)
    model = context.robot.model
    tau, rotation, position, velocity, acceleration = rigid_body.fused(model, frames, dimensions)(q, v, a, w)
    if not context.moving:
        tau = _still(context, frames, dimensions)(q, 0, a, w)[0]
    parts = [tau] if context.uses_dynamics else []
    for contact in context.used_accelerations:
        motion = acceleration[:, frames.index(contact.frame)]
        motion = without_rolling(motion, levers[contact]) if contact in levers else motion
        parts.append(motion[list(context.held_rows(contact))])
    for name in context.frames:
        i = frames.index(name)
        parts += [rotation[:, i], position[:, i], velocity[:, i], acceleration[:, i]]
    return first, ca.Function("fused", [s], [ca.vertcat(*parts)[used]])


def _still(context: Context, frames: list[str], dimensions: list[int]) -> ca.Function:
    """Inverse dynamics at rest; without gravity for an impact, where forces are impulses."""
    model = context.robot.model
    if context.place is Place.IMPACT:
        model = model.copy()
        model.gravity = pin.Motion.Zero()
    return rigid_body.fused(model, frames, dimensions)


def _levers(context: Context) -> dict[Contact, np.ndarray]:
    """Levers (3,) of the contacts that roll, in world axes."""
    levers = ((contact, context.lever(contact)) for contact in context.contacts)
    return {contact: lever for contact, lever in levers if lever is not None}


def _loads(context: Context, forces: ca.SX, levers: _Levers) -> tuple[list[str], list[int], ca.SX]:
    """Frames of the fused function, sizes of their wrenches, and these, in the axes of ``forces``.

    Active contacts come first, then frames that terms use. The force on a ball that rolls acts where it
    touches, so it has a moment about the frame's origin.
    """
    frames, dimensions, parts, start = [], [], [], 0
    for contact in context.contacts:
        size = 3 if contact.kind == "point" else 6
        wrench, start = forces[start : start + size], start + size
        if contact in levers:
            wrench = ca.vertcat(wrench, ca.cross(wrench, levers[contact]))
        frames.append(contact.frame)
        dimensions.append(wrench.numel())
        parts.append(wrench)
    extra = [name for name in context.frames if name not in frames]
    return frames + extra, dimensions + [0] * len(extra), ca.vertcat(*parts)


def _base_axes_layers(context: Context, used: list[int]) -> _Layers:
    """The base's own velocity p' enters nowhere (Galilean invariance)."""
    joints = ca.vertcat(context.q[7:], context.v[6:], context.a[6:])
    wrench = context.wrench_column()
    quaternion = quaternion_product(context.rotations[:4], exp_quaternion(context.xi[3:6]))
    omega, domega = body_rates(context.xi[3:6], context.dxi[3:6], context.ddxi[3:6])
    rates = ca.vertcat(quaternion, omega, domega, context.ddxi[:3], joints, wrench)
    return (
        ca.Function("body_rates", [context.z], [rates]),
        _to_base_axes(context, joints.numel(), wrench.numel()),
        _at_identity(context, joints.numel(), wrench.numel(), used),
    )


def _to_base_axes(context: Context, n_joints: int, n_wrench: int) -> ca.Function:
    """(quaternion, omega, omega', p'', joints, w) -> (omega, s, omega', joints, w, R^T g, levers), base axes.

    s = R^T (p'' - g) is the proper acceleration of the base.
    """
    cuts, levers = np.cumsum([0, 4, 3, 3, 3, n_joints, n_wrench]).tolist(), _levers(context).values()
    s = ca.SX.sym("s", cuts[-1])
    quaternion, omega, domega, acceleration, joints, wrench = ca.vertsplit(s, cuts)
    to_base = rotation_matrix(quaternion).T
    gravity = ca.mtimes(to_base, ca.DM(context.robot.model.gravity.linear))
    felt = ca.mtimes(to_base, acceleration) - gravity
    turned = ca.vec(ca.mtimes(to_base, ca.reshape(wrench, 3, -1))) if n_wrench else wrench
    arms = [ca.mtimes(to_base, ca.DM(lever)) for lever in levers]
    return ca.Function("base_axes", [s], [ca.vertcat(omega, felt, domega, joints, turned, gravity, *arms)])


def _at_identity(context: Context, n_joints: int, n_wrench: int, used: list[int]) -> ca.Function:
    """(omega, s, omega', joints, w, R^T g, levers) -> (tau, contact accelerations), base axes.

    Pinocchio's gravity is zero here: s contains gravity, which is added back to contact accelerations.
    """
    n_v = context.coordinates.nv - 6
    rolling = list(_levers(context))
    cuts = np.cumsum([0, 3, 6, n_joints - 2 * n_v, n_v, n_v, n_wrench, 3, *[3] * len(rolling)]).tolist()
    s = ca.SX.sym("s", cuts[-1])
    omega, rate, qj, vj, aj, forces, gravity, *arms = ca.vertsplit(s, cuts)
    q, v, a = ca.vertcat(0, 0, 0, 0, 0, 0, 1, qj), ca.vertcat(0, 0, 0, omega, vj), ca.vertcat(rate, aj)
    levers: _Levers = dict(zip(rolling, arms, strict=True))
    frames, dimensions, wrench = _loads(context, forces, levers)
    floating = context.robot.model.copy()
    floating.gravity = pin.Motion.Zero()
    tau, *_, acceleration = rigid_body.fused(floating, frames, dimensions)(q, v, a, wrench)
    parts = [tau] if context.uses_dynamics else []
    for contact in context.used_accelerations:
        own_gravity = ca.vertcat(gravity, ca.SX.zeros(contact.dimension - 3))
        motion = acceleration[:, frames.index(contact.frame)]
        motion = without_rolling(motion, levers[contact]) if contact in levers else motion
        parts.append(motion[: contact.dimension] + own_gravity)
    return ca.Function("fused", [s], [ca.vertcat(*parts)[used]])
