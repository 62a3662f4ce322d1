"""Lagrange's equations derived from the energies of the links, as CasADi functions of a numeric model.

The only input is the placements of the links' centres of mass at a configuration. Velocities
are their time derivatives (by algorithmic differentiation), energies are sums over the links,

    K = sum 1/2 m |c'|^2 + 1/2 omega^T I omega  (+ 1/2 sum armature_j v_j^2),     P = - sum m g^T c,

and the equations are ``d/dt dL/dx' - dL/dx = tau`` with ``L = K - P``. This uses no inertia matrix and no
RNEA, so it is independent of what `rigid_body` and `newton_euler` compute.

**Coordinates.** ``x`` (nv,) are exponential coordinates around the configuration of evaluation,
``q(x) = integrate(q, x)``. Where q' = v (revolute, continuous, prismatic, translation, spherical ZYX: fixed
bases and virtual joints) this is the textbook's ``x = q`` up to a shift. For a free-flyer, planar or
spherical joint ``v = Jr(x) x'`` with the right Jacobian of its group, and at ``x = 0`` both ``v = x'`` and
``v' = x''`` hold because ``d/dt Jr x' = - 1/2 [x', x'] = 0``; so the generalised forces are Pinocchio's for
every joint. Armature multiplies ``x'`` there: rotors do not turn with the body, as in Pinocchio.

Every function is built once per model content and takes q (nq,), v and a (nv,) in Pinocchio's
conventions and SI units. It raises `UnsupportedJointError` for joints that `rigid_body` does not support.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.dynamics import rigid_body
from trajopt.dynamics.model_content import once_per_content


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """The links' centres of mass near a configuration, one column per joint; ``x``, ``rate`` are symbols."""

    q: ca.SX
    x: ca.SX
    rate: ca.SX
    position: ca.SX  # (3, n), world
    rotation: ca.SX  # (9, n), column-major, to the world


def _motion(model: pin.Model) -> _Motion:
    tagged, names = model.copy(), []
    for index in range(1, model.njoints):
        names.append(f"centre of mass of the link of joint {index}")
        at_centre = pin.SE3(np.eye(3), model.inertias[index].lever)
        tagged.addFrame(pin.Frame(names[-1], index, 0, at_centre, pin.OP_FRAME), False)
    q, x, rate = ca.SX.sym("q", model.nq), ca.SX.sym("x", model.nv), ca.SX.sym("rate", model.nv)
    rest = ca.SX.zeros(model.nv)
    at = rigid_body.integrate(model)(q, x)
    placements = rigid_body.fused(tagged, names, [0] * len(names))  # only its placements are used
    _, rotation, position, _, _ = placements.call([at, rest, rest, ca.SX(0, 1)])
    return _Motion(q=q, x=x, rate=rate, position=position, rotation=rotation)


def _link_energies(model: pin.Model, motion: _Motion) -> ca.SX:
    """Return the kinetic energies (n) of the links from the time derivatives of their placements."""
    velocity = ca.jtimes(ca.vec(motion.position), motion.x, motion.rate)
    turning = ca.jtimes(ca.vec(motion.rotation), motion.x, motion.rate)
    energies = []
    for column, inertia in enumerate(list(model.inertias)[1:]):
        linear = velocity[3 * column : 3 * column + 3]
        rotation = ca.reshape(motion.rotation[:, column], 3, 3)
        spin = ca.mtimes(rotation.T, ca.reshape(turning[9 * column : 9 * column + 9], 3, 3))
        omega = ca.vertcat(spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]) / 2
        rotating = ca.dot(omega, ca.mtimes(ca.DM(inertia.inertia), omega))
        energies.append((inertia.mass * ca.sumsqr(linear) + rotating) / 2)
    return ca.vertcat(*energies)


def _potentials(model: pin.Model, motion: _Motion) -> ca.SX:
    masses = ca.DM([inertia.mass for inertia in list(model.inertias)[1:]])
    return -masses * ca.mtimes(motion.position.T, ca.DM(model.gravity.linear))


def _armature_energy(model: pin.Model, motion: _Motion) -> ca.SX:
    return ca.dot(motion.rate, ca.DM(model.armature) * motion.rate) / 2


def _at_configuration(name: str, motion: _Motion, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    around = ca.Function(name, [motion.x, *inputs], outputs)
    return ca.Function(name, inputs, around.call([ca.SX.zeros(motion.x.shape), *inputs]))


@once_per_content
def kinetic_energies(model: pin.Model) -> ca.Function:
    """Return ``(q, v) -> (links (n), armature)`` in J: energy of each joint's link, and of all rotors."""
    motion = _motion(model)
    energies = [_link_energies(model, motion), _armature_energy(model, motion)]
    return _at_configuration("kinetic_energies", motion, [motion.q, motion.rate], energies)


@once_per_content
def potential_energies(model: pin.Model) -> ca.Function:
    """Return ``q -> energies (n)``, J: each joint's link's energy in gravity, zero at the world's origin."""
    motion = _motion(model)
    return _at_configuration("potential_energies", motion, [motion.q], [_potentials(model, motion)])


@once_per_content
def equations_of_motion(model: pin.Model) -> ca.Function:
    """Return ``(q, v, a) -> tau`` (nv; N, N m): ``d/dt dL/dx' - dL/dx``."""
    motion = _motion(model)
    q, x, rate, a = motion.q, motion.x, motion.rate, ca.SX.sym("a", model.nv)
    kinetic = ca.sum1(_link_energies(model, motion)) + _armature_energy(model, motion)
    lagrangian = kinetic - ca.sum1(_potentials(model, motion))
    momentum = ca.gradient(lagrangian, rate)
    momentum_rate = ca.jtimes(momentum, x, rate) + ca.jtimes(momentum, rate, a)
    tau = momentum_rate - ca.gradient(lagrangian, x)
    return _at_configuration("equations_of_motion", motion, [q, rate, a], [tau])


def _link_inertia(model: pin.Model, motion: _Motion) -> ca.SX:
    """Return the inertia matrix in x' of the links alone, from the Jacobians of their placements."""
    along, turning = ca.jacobian(motion.position, motion.x), ca.jacobian(motion.rotation, motion.x)
    total = ca.SX.zeros(model.nv, model.nv)
    for column, inertia in enumerate(list(model.inertias)[1:]):
        rotation = ca.reshape(motion.rotation[:, column], 3, 3)
        axes = turning[9 * column : 9 * column + 9, :]  # columns of dR/dx, stacked
        # Entry (2, 1) of R^T dR is the third axis times the derivative of the second, and so on.
        spin = [ca.mtimes(rotation[:, i].T, axes[3 * j : 3 * j + 3, :]) for i, j in ((2, 1), (0, 2), (1, 0))]
        angular, linear = ca.vertcat(*spin), along[3 * column : 3 * column + 3, :]
        total += inertia.mass * ca.mtimes(linear.T, linear)
        total += ca.mtimes([angular.T, ca.DM(inertia.inertia), angular])
    return total


@once_per_content
def inertia_matrix(model: pin.Model) -> ca.Function:
    """Return ``q -> D`` (nv, nv): ``sum m Jv^T Jv + Jw^T R I R^T Jw + diag(armature)``."""
    motion = _motion(model)
    inertia = _link_inertia(model, motion) + ca.diag(ca.DM(model.armature))
    return _at_configuration("inertia_matrix", motion, [motion.q], [inertia])


@once_per_content
def coriolis_matrix(model: pin.Model) -> ca.Function:
    """Return ``(q, v) -> C`` (nv, nv) by Christoffel symbols: C v are the Coriolis and centrifugal forces.

    With q' = v, ``C_kj = 1/2 sum_i (dD_kj/dq_i + dD_ki/dq_j - dD_ij/dq_k) v_i``, and D' - 2 C is skew
    symmetric. If v = Jr x', it is the same in x minus ``D Jr'``. This keeps both properties, with D' the rate
    of the matrix in v, and leaves C v unchanged.
    """
    motion = _motion(model)
    q, x, rate = motion.q, motion.x, motion.rate
    inertia = _link_inertia(model, motion)
    inertia_rate = ca.reshape(ca.jtimes(ca.vec(inertia), x, rate), model.nv, model.nv)
    across = ca.jacobian(ca.mtimes(inertia, rate), x)  # sum_i dD_ki/dx_j x'_i in row k, column j
    christoffel = (inertia_rate + across - across.T) / 2
    coriolis = christoffel - ca.mtimes(inertia, _right_jacobian_rate(model, motion))
    return _at_configuration("coriolis_matrix", motion, [q, rate], [coriolis])


def _right_jacobian_rate(model: pin.Model, motion: _Motion) -> ca.SX:
    """Return the rate (nv, nv) of Jr(x), from x' to v: zero where q' = v, else ``- 1/2 ad`` at x = 0."""
    step = ca.SX.sym("step", model.nv)
    integrate, difference = rigid_body.integrate(model), rigid_body.difference(model)
    reached = difference(integrate(motion.q, motion.x), integrate(motion.q, motion.x + step))
    at_zero = ca.substitute(ca.jacobian(reached, step), step, ca.SX.zeros(model.nv))
    return ca.reshape(ca.jtimes(ca.vec(at_zero), motion.x, motion.rate), model.nv, model.nv)


@once_per_content
def gravity_forces(model: pin.Model) -> ca.Function:
    """Return ``q -> G`` (nv; N, N m): ``dP/dx``."""
    motion = _motion(model)
    forces = ca.gradient(ca.sum1(_potentials(model, motion)), motion.x)
    return _at_configuration("gravity_forces", motion, [motion.q], [forces])
