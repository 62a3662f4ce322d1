"""Dynamics in contact without contact forces: projection onto the motions that contacts allow.

With the orthogonal projector ``P = I - J^+ J`` onto the null space of J (P J^T = 0) the forces vanish:

    P (M a + h) = P S^T tau,      (I - P) a = -J^+ Jdot v

(Aghili, "A unified approach for inverse and direct dynamics of constrained multibody systems", 2005;
Righetti et al., "Inverse dynamics control of floating-base robots with external constraints", 2011).
The dynamically consistent projector ``N = I - M^-1 J^T (J M^-1 J^T)^+ J`` (Khatib 1987) does the same
for accelerations: a = N M^-1 (S^T tau - h) - M^-1 J^T (J M^-1 J^T)^+ Jdot v.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.certify.contact.contact_dynamics import require_arrays, rows_with_actuator
from trajopt.certify.contact.contact_response import contact_response, mass_factor, numeric_rank
from trajopt.certify.contact.contact_set import ContactKinematics, ContactSet, contact_kinematics
from trajopt.dynamics.model_quantities import mass_matrix_at
from trajopt.errors import InputError

_Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class ContactTorques:
    """Torques and contact wrenches that produce a motion.

    Args:
        torque: Torques (nu,) of the actuated rows.
        wrenches: Contact wrenches (n, 6), world axes, at frame origins.
        residual: M a + h - S^T tau - J^T f (nv,); zero if actuators and contacts can produce the motion.
        contact_acceleration: J a + Jdot v (n, 6) of the given motion; zero if the contacts allow it.
        fully_actuated: Whether torques can produce every acceleration that the contacts allow.
    """

    torque: np.ndarray
    wrenches: np.ndarray
    residual: np.ndarray
    contact_acceleration: np.ndarray
    fully_actuated: bool


@checked
def null_space_projector(jacobian: np.ndarray, unit: float = 0.0) -> np.ndarray:
    """Return ``P = I - J^+ J`` (nv, nv): symmetric, P P = P, J P = 0; rank-deficient J (n, nv) allowed.

    Singular values of J count as zero relative to the largest, or to ``unit`` if that is larger.
    """
    _, singular, right = np.linalg.svd(jacobian)
    allowed = right[numeric_rank(singular, unit) :]
    return allowed.T @ allowed


@checked
def consistent_projector(mass: np.ndarray, contacts: ContactSet, jacobian: np.ndarray) -> np.ndarray:
    """Return ``N = I - M^-1 J^T (J M^-1 J^T)^+ J`` (nv, nv): N N = N, J N = 0, M N symmetric.

    ``mass`` is (nv, nv), ``jacobian`` (n_rows, nv) of ``contacts``. Raises `InputError` unless M is positive
    definite.
    """
    response = contact_response(mass_factor(mass), contacts, jacobian)
    allowed = null_space_projector(response.whitened.T, response.unit)
    return np.linalg.solve(response.lower.T, allowed @ response.lower.T)


@checked
def projected_forward_dynamics(
    model: pin.Model, q: np.ndarray, v: np.ndarray, tau: np.ndarray, contacts: ContactSet
) -> np.ndarray:
    """Return the acceleration (nv,) under tau (nv,) from the projected equations alone, without forces.

    Solves ``(P M + s (I - P)) a = P (tau - h) - s J^+ Jdot v``, regular for every s > 0; s is the mean of
    M's diagonal. Raises `InputError` for wrong shapes and numbers that are not finite.
    """
    require_arrays({"q": (q, model.nq), "v": (v, model.nv), "tau": (tau, model.nv)})
    data = model.createData()
    mass = mass_matrix_at(model, q)
    rows = contact_kinematics(model, data, q, v, contacts)
    scaled = contacts.scale[:, None] * rows.jacobian
    projector = null_space_projector(scaled, contacts.moment_arm)
    size = float(np.mean(np.diag(mass)))
    held = -_pseudo_inverse(scaled, contacts.moment_arm) @ (contacts.scale * rows.drift)
    allowed = projector @ (tau - pin.nle(model, data, q, v))
    return np.linalg.solve(projector @ mass + size * (np.eye(model.nv) - projector), allowed + size * held)


@checked
def projected_inverse_dynamics(
    model: pin.Model, motion: _Motion, contacts: ContactSet, *, actuated_rows: np.ndarray | None = None
) -> ContactTorques:
    """Return minimum-norm torques of a motion (q, v, a), ``tau = (P S^T)^+ P (M a + h)``, and their wrenches.

    They have the least norm of all torques that produce the motion, independently of the metric of P if the
    motion is possible. The wrenches are ``(J^T)^+ (M a + h - S^T tau)``. ``actuated_rows`` (nu,) of v have an
    actuator; default: all but those of the model's base. Raises `InputError`.
    """
    needed, rows, scaled, actuated = _needed(model, motion, contacts, actuated_rows)
    projector = null_space_projector(scaled, contacts.moment_arm)
    torque = _pseudo_inverse(projector[:, actuated], 1.0) @ (projector @ needed)
    remaining = needed.copy()
    remaining[actuated] -= torque
    forces = _pseudo_inverse(scaled.T, contacts.moment_arm) @ remaining
    computed = remaining - scaled.T @ forces, torque, forces
    return _torques(contacts, rows, motion[2], computed, scaled, actuated)


@checked
def least_norm_inverse_dynamics(
    model: pin.Model,
    motion: _Motion,
    contacts: ContactSet,
    *,
    actuated_rows: np.ndarray | None = None,
    torque_scale: float | np.ndarray | None = None,
) -> ContactTorques:
    """Return the torques and wrenches of least combined norm, ``[f; tau] = [J^T S^T]^+ (M a + h)``.

    The norm is ``|f|^2 + |m|^2 / arm^2 + |tau / torque_scale|^2``; ``torque_scale`` (a number or (nu,)), in
    m for a rotation and without unit for a translation, defaults to the moment arm of ``contacts``. The
    smaller it is, the costlier torques are: `projected_inverse_dynamics` is the limit at zero. Raises
    `InputError`.
    """
    needed, rows, scaled, actuated = _needed(model, motion, contacts, actuated_rows)
    size = len(actuated)
    given = contacts.moment_arm if torque_scale is None else torque_scale
    if np.shape(given) not in ((), (size,)) or not (np.asarray(given) > 0).all():
        raise InputError(f"torque_scale is {given}", f"a positive number or {size} of them")
    arms = np.broadcast_to(np.asarray(given, dtype=float), (size,))
    actuation = np.zeros((model.nv, size))
    actuation[actuated] = np.diag(arms)
    columns = np.hstack([scaled.T, actuation])
    both = _pseudo_inverse(columns, contacts.moment_arm) @ needed
    forces, torque = both[: contacts.n_rows], arms * both[contacts.n_rows :]
    computed = needed - columns @ both, torque, forces
    return _torques(contacts, rows, motion[2], computed, scaled, actuated)


def _needed(
    model: pin.Model, motion: _Motion, contacts: ContactSet, actuated_rows: np.ndarray | None
) -> tuple[np.ndarray, ContactKinematics, np.ndarray, np.ndarray]:
    """Return M a + h (nv,), the contact kinematics, their scaled Jacobian and the actuated rows."""
    q, v, a = motion
    require_arrays({"q": (q, model.nq), "v": (v, model.nv), "a": (a, model.nv)})
    data = model.createData()
    needed = pin.rnea(model, data, q, v, a)
    rows = contact_kinematics(model, data, q, v, contacts)
    scaled = contacts.scale[:, None] * rows.jacobian
    return needed, rows, scaled, rows_with_actuator(model, actuated_rows)


def _torques(
    contacts: ContactSet,
    rows: ContactKinematics,
    acceleration: np.ndarray,
    computed: tuple[np.ndarray, np.ndarray, np.ndarray],
    scaled: np.ndarray,
    actuated: np.ndarray,
) -> ContactTorques:
    residual, torque, forces = computed
    projector = null_space_projector(scaled, contacts.moment_arm)
    actuation = np.linalg.svd(projector[:, actuated], compute_uv=False)
    return ContactTorques(
        torque=torque,
        wrenches=contacts.wrenches(contacts.scale * forces),
        residual=residual,
        contact_acceleration=contacts.table(rows.jacobian @ acceleration + rows.drift),
        fully_actuated=numeric_rank(actuation, 1.0) == round(float(np.trace(projector))),
    )


def _pseudo_inverse(matrix: np.ndarray, unit: float) -> np.ndarray:
    left, singular, right = np.linalg.svd(matrix, full_matrices=False)
    rank = numeric_rank(singular, unit)
    return (right[:rank].T / singular[:rank]) @ left[:, :rank].T
