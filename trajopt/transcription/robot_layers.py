"""The robot's functions at one point as a chain of layers, from local coordinates to forces.

For a free-flyer, the inverse dynamics and contact accelerations in base axes depend neither on the
orientation nor on the base's linear velocity (Galilean invariance). Gravity enters as an acceleration of
the base, s = R^T (p'' - g), and wrenches are rotated into base axes. These layers replace one graph over
(q, v, a, w), so that the rigid-body algorithm is differentiated over 10 fewer inputs:

    (z, known w) -> (quaternion, omega, omega', p'', joints, w)  exponential coordinates
      -> (omega, s, omega', joints, R^T w, R^T g)                base axes
      -> (tau, contact accelerations)                            Pinocchio, base at the identity
      -> o                                                       outputs that terms use

Pinocchio's functions include all contacts of the robot, with zero wrenches for inactive ones. So they are
built, and differentiated, once for all sets of active contacts.
"""

from collections.abc import Mapping

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.dynamics import rigid_body
from trajopt.dynamics.model_content import frame_content, load_content, once_per_content
from trajopt.dynamics.rotations import body_rates, exp_quaternion, quaternion_product, rotation_matrix
from trajopt.robot.contact import Contact
from trajopt.terms.context import Context
from trajopt.terms.context_symbols import Place, without_rolling

_Levers = Mapping[Contact, ca.SX | ca.DM]
_Layers = tuple[ca.Function, ...]


def robot_layers(context: Context, expression: ca.SX) -> tuple[ca.SX, _Layers]:
    """Symbols o that ``expression`` uses, and layers that compute them from z and the known wrenches."""
    values = context.robot_symbols()
    outputs, count = ca.vertcat(values, context.force_rates), values.numel()
    pattern = ca.jacobian_sparsity(expression, outputs)
    used = np.unique(pattern.get_triplet()[1]).astype(int)
    if len(used) == 0:
        return ca.SX(0, 1), ()
    needed = np.unique(used % count).tolist()  # rates of forces come last, and forces first
    in_base = needed[-1] < context.dynamics_symbols().numel() and context.has_free_flyer
    layers = (_base_axes_layers if in_base else _plain_layers)(context, needed)
    if used[-1] >= count:
        places = np.searchsorted(needed, used % count) + len(needed) * (used >= count)
        layers = _with_rates(context, layers, places.tolist())
    return outputs[used.tolist()], layers


def _with_rates(context: Context, layers: _Layers, used: list[int]) -> _Layers:
    """Layers from z to these entries of the outputs and their rates, each with its derivative along them."""
    values = layers[0](context.z)
    moved = [ca.Function("rates", [context.z], [ca.vertcat(values, context.rate(values))])]
    for layer in layers[1:]:
        s, rate = ca.SX.sym("s", layer.numel_in(0)), ca.SX.sym("ds", layer.numel_in(0))
        values = layer(s)
        both = ca.vertcat(values, ca.jtimes(values, s, rate))
        moved.append(ca.Function(layer.name(), [ca.vertcat(s, rate)], [both]))
    s = ca.SX.sym("s", moved[-1].numel_out(0))
    return (*moved, ca.Function("used", [s], [s[used]]))


def _plain_layers(context: Context, used: list[int]) -> _Layers:
    """Layers z -> (q, v, a, w) -> o.

    Where the dynamics do not depend on velocity (statics, impacts), only frames use it. Impacts have no
    gravity.
    """
    wrench = context.wrench_column()
    sizes = [part.numel() for part in (context.q, context.v, context.a, wrench)]
    inputs = ca.vertcat(context.z, context.given_wrenches)
    first = ca.Function("to_pinocchio", [inputs], [ca.vertcat(context.q, context.v, context.a, wrench)])
    s = ca.SX.sym("s", sum(sizes))
    q, v, a, forces = ca.vertsplit(s, [0, *np.cumsum(sizes).tolist()])
    levers = {contact: ca.DM(lever) for contact, lever in _levers(context).items()}
    frames, dimensions, w = _loads(_contacts(context), _of_all(context, forces), levers)
    extra = [name for name in context.frames if name not in frames]
    frames, dimensions = frames + extra, dimensions + [0] * len(extra)
    model, loads = context.robot.model, _given_loads(context)
    motion = rigid_body.fused(model, frames, dimensions, loads)(q, v, a, w)
    tau, rotation, position, velocity, acceleration = motion
    if not context.moving:
        still = _floating(model) if context.place is Place.IMPACT else model  # impulses: no gravity
        tau = rigid_body.fused(still, frames, dimensions, loads)(q, 0, a, w)[0]
    parts = [tau] if context.uses_dynamics else []
    for contact in context.used_accelerations:
        motion = acceleration[:, frames.index(contact.frame)]
        motion = without_rolling(motion, levers[contact]) if contact in levers else motion
        parts.append(motion[list(context.held_rows(contact))])
    for name in context.frames:
        i = frames.index(name)
        parts += [rotation[:, i], position[:, i], velocity[:, i], acceleration[:, i]]
    return first, ca.Function("fused", [s], [ca.vertcat(*parts)[used]])


def _floating(model: pin.Model) -> pin.Model:
    """The model without gravity."""
    floating = model.copy()
    floating.gravity = pin.Motion.Zero()
    return floating


def _contacts(context: Context) -> tuple[Contact, ...]:
    """All contacts of the robot, active or not."""
    return tuple(dict.fromkeys((*context.robot.contacts, *context.contacts)))


def _wrench_size(contact: Contact) -> int:
    return 3 if contact.kind == "point" else 6


def _of_all(context: Context, wrenches: ca.SX) -> ca.SX:
    """Wrenches of all contacts in one column, zero for inactive ones, then the known wrenches."""
    cuts = np.cumsum([0, *map(_wrench_size, context.contacts), 6 * len(context.given)]).tolist()
    *parts, given = ca.vertsplit(wrenches, cuts)
    active = dict(zip(context.contacts, parts, strict=True))
    return ca.vertcat(*[active.get(c, ca.SX.zeros(_wrench_size(c))) for c in _contacts(context)], given)


def _given_loads(context: Context) -> tuple:
    """Contents of the places of the known wrenches, see `rigid_body.fused`."""
    return tuple(load_content(*wrench.place(context.robot.model)) for wrench in context.given)


def _levers(context: Context) -> dict[Contact, np.ndarray]:
    """Levers (3,) of all contacts that can roll, in world axes; zero for those that do not roll here."""
    active = {contact: context.lever(contact) for contact in context.contacts}
    rolling = (contact for contact in _contacts(context) if contact.rolling)
    return {c: np.zeros(3) if (lever := active.get(c)) is None else lever for c in rolling}


def _loads(
    contacts: tuple[Contact, ...], wrenches: ca.SX, levers: _Levers
) -> tuple[list[str], list[int], ca.SX]:
    """Frames of the contacts, and sizes and column of the wrenches at their origins, in the given axes.

    Known wrenches come last. The force on a rolling ball acts at the point of contact, so it has a moment
    about the frame's origin.
    """
    cuts = np.cumsum([0, *map(_wrench_size, contacts)]).tolist()
    *by_contact, given = ca.vertsplit(wrenches, [*cuts, wrenches.numel()])
    parts = [
        ca.vertcat(wrench, ca.cross(wrench, levers[contact])) if contact in levers else wrench
        for contact, wrench in zip(contacts, by_contact, strict=True)
    ]
    return [c.frame for c in contacts], [part.numel() for part in parts], ca.vertcat(*parts, given)


def _base_axes_layers(context: Context, used: list[int]) -> _Layers:
    """Layers in base axes; the base's linear velocity p' does not enter (Galilean invariance)."""
    joints = ca.vertcat(context.q[7:], context.v[6:], context.a[6:])
    quaternion = quaternion_product(context.rotations[:4], exp_quaternion(context.xi[3:6]))
    omega, domega = body_rates(context.xi[3:6], context.dxi[3:6], context.ddxi[3:6])
    rates = ca.vertcat(quaternion, omega, domega, context.ddxi[:3], joints, context.wrench_column())
    contacts, model = _contacts(context), context.robot.model
    frames = tuple(frame_content(model, contact.frame) for contact in contacts)
    dynamics = _at_identity(model, contacts, frames, _given_loads(context))
    starts = np.cumsum([model.nv, *[contact.dimension for contact in contacts]]).tolist()
    outputs = [range(model.nv)] if context.uses_dynamics else []
    outputs += [range(starts[i], starts[i + 1]) for i in map(contacts.index, context.used_accelerations)]
    s = ca.SX.sym("s", dynamics.numel_out(0))
    picked = s[np.concatenate(outputs)[used].tolist()]
    return (
        ca.Function("body_rates", [ca.vertcat(context.z, context.given_wrenches)], [rates]),
        _to_base_axes(context, joints.numel()),
        dynamics,
        ca.Function("used", [s], [picked]),
    )


def _to_base_axes(context: Context, n_joints: int) -> ca.Function:
    """(quaternion, omega, omega', p'', joints, w) -> (omega, s, omega', joints, w, R^T g, levers), base axes.

    s = R^T (p'' - g) is the proper acceleration of the base. The outputs w and levers cover all contacts.
    """
    cuts = np.cumsum([0, 4, 3, 3, 3, n_joints, context.wrench_column().numel()]).tolist()
    s = ca.SX.sym("s", cuts[-1])
    quaternion, omega, domega, acceleration, joints, wrench = ca.vertsplit(s, cuts)
    to_base = rotation_matrix(quaternion).T
    gravity = ca.mtimes(to_base, ca.DM(context.robot.model.gravity.linear))
    felt = ca.mtimes(to_base, acceleration) - gravity
    turned = ca.vec(ca.mtimes(to_base, ca.reshape(wrench, 3, -1))) if wrench.numel() else wrench
    arms = [ca.mtimes(to_base, ca.DM(lever)) for lever in _levers(context).values()]
    parts = [omega, felt, domega, joints, _of_all(context, turned), gravity, *arms]
    return ca.Function("base_axes", [s], [ca.vertcat(*parts)])


@once_per_content
def _at_identity(model: pin.Model, contacts: tuple[Contact, ...], frames: tuple, loads: tuple) -> ca.Function:
    """(omega, s, omega', joints, w, R^T g, levers) -> (tau, accelerations of all contacts), base axes.

    Pinocchio's gravity is zero because s contains gravity, which is added back to contact accelerations.
    ``frames`` holds the contents of the contacts' frames, as part of the cache key, ``loads`` those of the
    known wrenches' places.
    """
    n_v, rolling = model.nv - 6, [contact for contact in contacts if contact.rolling]
    n_wrench = sum(map(_wrench_size, contacts)) + 6 * len(loads)
    cuts = np.cumsum([0, 3, 6, model.nq - 7, n_v, n_v, n_wrench, 3, *[3] * len(rolling)]).tolist()
    s = ca.SX.sym("s", cuts[-1])
    omega, rate, qj, vj, aj, wrenches, gravity, *arms = ca.vertsplit(s, cuts)
    q, v, a = ca.vertcat(0, 0, 0, 0, 0, 0, 1, qj), ca.vertcat(0, 0, 0, omega, vj), ca.vertcat(rate, aj)
    levers: _Levers = dict(zip(rolling, arms, strict=True))
    names, dimensions, w = _loads(contacts, wrenches, levers)
    tau, *_, acceleration = rigid_body.fused(_floating(model), names, dimensions, loads)(q, v, a, w)
    parts = [tau]
    for contact in contacts:
        own_gravity = ca.vertcat(gravity, ca.SX.zeros(contact.dimension - 3))
        motion = acceleration[:, names.index(contact.frame)]
        motion = without_rolling(motion, levers[contact]) if contact in levers else motion
        parts.append(motion[: contact.dimension] + own_gravity)
    return ca.Function("fused", [s], [ca.vertcat(*parts)])
