"""Dynamics in contact as CasADi functions, for custom transcriptions.

    M a + h = tau + J^T f,      J a + Jdot v = 0

for frames held in place: points (3 rows of J) or soles (6), with wrenches f in world axes at their origins.
Rows of J must be independent; `trajopt.certify.forward_dynamics` is numeric and accepts dependent ones.
"""

from collections.abc import Mapping, Sequence

import casadi as ca
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics import rigid_body


@checked
def contact_forward_dynamics(model: pin.Model, held: Mapping[str, int]) -> ca.Function:
    """Acceleration and wrenches ``(q, v, tau) -> (a, f)``: tau (nv,) N m, a (nv,), f (n,) N and N m.

    ``held`` gives 3 or 6 rows by the frame's name, in the order of f. Raises `InputError`.
    """
    q, v, tau = (ca.MX.sym(name, n) for name, n in (("q", model.nq), ("v", model.nv), ("tau", model.nv)))
    jacobian, drift = _contact_rows(model, held, q, v)
    mass, bias = rigid_body.mass_matrix(model)(q), rigid_body.bias_forces(model)(q, v)
    rows = jacobian.shape[0]
    system = ca.vertcat(ca.horzcat(mass, -jacobian.T), ca.horzcat(jacobian, ca.MX(rows, rows)))
    solved = ca.solve(system, ca.vertcat(tau - bias, -drift))
    names = ["q", "v", "tau"], ["a", "f"]
    return ca.Function(
        "contact_forward_dynamics", [q, v, tau], [solved[: model.nv], solved[model.nv :]], *names
    )


@checked
def contact_inverse_dynamics(
    model: pin.Model, held: Mapping[str, int], actuated_rows: Sequence[int]
) -> ca.Function:
    """Torques and wrenches of least norm, ``(q, v, a) -> (tau, f)``: ``[f; tau] = [J^T S^T]^+ (M a + h)``.

    ``tau`` (nu,) acts on ``actuated_rows`` of v. Contacts and actuators together must reach every row: a
    quadruped on two points cannot turn about the line between them. Raises `InputError`.
    """
    q, v, a = (ca.MX.sym(name, n) for name, n in (("q", model.nq), ("v", model.nv), ("a", model.nv)))
    jacobian, _ = _contact_rows(model, held, q, v)
    columns = ca.horzcat(jacobian.T, ca.MX(ca.DM.eye(model.nv)[:, list(actuated_rows)]))
    both = ca.mtimes(columns.T, ca.solve(ca.mtimes(columns, columns.T), rigid_body.rnea(model)(q, v, a)))
    rows, names = jacobian.shape[0], (["q", "v", "a"], ["tau", "f"])
    return ca.Function("contact_inverse_dynamics", [q, v, a], [both[rows:], both[:rows]], *names)


def _contact_rows(model: pin.Model, held: Mapping[str, int], q: ca.MX, v: ca.MX) -> tuple[ca.MX, ca.MX]:
    """J (n, nv) of the held frames, and Jdot v (n,)."""
    still = ca.MX.zeros(model.nv)
    jacobians = [rigid_body.frame_jacobian(model, name)(q)[:size, :] for name, size in held.items()]
    drifts = [rigid_body.frame_acceleration(model, name)(q, v, still)[:size] for name, size in held.items()]
    return ca.vertcat(ca.MX(0, model.nv), *jacobians), ca.vertcat(ca.MX(0, 1), *drifts)
