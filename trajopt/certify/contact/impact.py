"""Rigid inelastic impact: contacts close instantaneously and stay closed.

    M (v+ - v-) = J^T Lambda,      J v+ = 0

for the contacts that are active after the impact, both new and old ones. q does not change, and
non-impulsive forces have no effect (Featherstone 2008, sec. 11.7; Hurmuzlu and Marghitu
1994). v+ is the projection of v- onto J v = 0 in the metric of M, so kinetic energy falls by
1/2 (v+ - v-)^T M (v+ - v-). The contacts are modelled as bilateral: if an impulse pulls, or leaves its
friction cone (`friction.cone_margins`), the contact would lift or slide instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.arguments import checked
from trajopt.certify.contact.contact_dynamics import require_arrays
from trajopt.certify.contact.contact_response import ContactRank, contact_rank, contact_response, mass_factor
from trajopt.certify.contact.contact_set import ContactSet, contact_kinematics


@dataclass(frozen=True, kw_only=True)
class MomentumAbout:
    """Linear momentum (3,) in kg m/s, angular momentum (3,) about ``point`` (3,) in kg m^2/s; world axes.

    It includes only the links: spinning rotors (armature) change joint rows of M, but not these.
    """

    linear: np.ndarray
    angular: np.ndarray
    point: np.ndarray

    def about(self, point: ArrayLike) -> MomentumAbout:
        """Return the same momentum with the angular part about another world point (3,) m."""
        new = np.asarray(point, dtype=float)
        moved = self.angular + np.cross(self.point - new, self.linear)
        return MomentumAbout(linear=self.linear, angular=moved, point=new)

    def __sub__(self, other: MomentumAbout) -> MomentumAbout:
        back = other.about(self.point)
        return MomentumAbout(
            linear=self.linear - back.linear, angular=self.angular - back.angular, point=self.point
        )


@dataclass(frozen=True, kw_only=True)
class Impact:
    """Result of an impact.

    Attributes:
        velocity: v+ (nv,).
        impulses: Impulses (n, 6) on the robot, N s and N m s, world axes, at frame origins.
        rank: Rank of the contact rows; if it is redundant, the impulses have minimum norm.
        energy_before, energy_after: Kinetic energy 1/2 v^T M v, J; energy_loss is that of the velocity jump.
        jump: Change of momentum about the centre of mass.
        impulse: Sum of the contacts' impulses, as a momentum about the centre of mass.
        dynamics_residual, contact_velocity: M (v+ - v-) - J^T Lambda (nv,); J v+ (n, 6), m/s and rad/s.
    """

    velocity: np.ndarray
    impulses: np.ndarray
    rank: ContactRank
    energy_before: float
    energy_after: float
    energy_loss: float
    jump: MomentumAbout
    impulse: MomentumAbout
    dynamics_residual: np.ndarray
    contact_velocity: np.ndarray

    @property
    def root_impulse(self) -> MomentumAbout:
        """Impulse of the world on the root joint, jump - impulse; zero for a free-flyer."""
        return self.jump - self.impulse


@checked
def impact(model: pin.Model, q: np.ndarray, v_minus: np.ndarray, contacts: ContactSet) -> Impact:
    """Return velocity and impulses for an impact, after which all ``contacts`` are active.

    q (nq,) and v_minus (nv,) are just before it. Raises `InputError` for wrong shapes, numbers that are not
    finite, or a mass matrix that is not positive definite.
    """
    require_arrays({"q": (q, model.nq), "v_minus": (v_minus, model.nv)})
    data = model.createData()
    lower = mass_factor(pin.crba(model, data, q))
    rows = contact_kinematics(model, data, q, v_minus, contacts)
    response = contact_response(lower, contacts, rows.jacobian)
    change, forces = response.least(-contacts.scale * rows.velocity)
    v_plus = v_minus + change
    stacked = contacts.scale * forces
    impulses = contacts.wrenches(stacked)
    before, after = momentum_of_links(model, q, v_minus), momentum_of_links(model, q, v_plus)
    return Impact(
        velocity=v_plus,
        impulses=impulses,
        rank=contact_rank(contacts, rows.jacobian, response),
        energy_before=_kinetic_energy(lower, v_minus),
        energy_after=_kinetic_energy(lower, v_plus),
        energy_loss=_kinetic_energy(lower, v_plus - v_minus),
        jump=after - before,
        impulse=total_wrench(model, q, contacts, impulses, after.point),
        dynamics_residual=lower @ (lower.T @ (v_plus - v_minus)) - rows.jacobian.T @ stacked,
        contact_velocity=contacts.table(rows.jacobian @ v_plus),
    )


def momentum_of_links(model: pin.Model, q: np.ndarray, v: np.ndarray) -> MomentumAbout:
    """Return the momentum of all links at q (nq,), v (nv,), about the centre of mass."""
    data = model.createData()
    momentum = pin.computeCentroidalMomentum(model, data, q, v)
    return MomentumAbout(
        linear=momentum.linear.copy(), angular=momentum.angular.copy(), point=data.com[0].copy()
    )


def total_wrench(
    model: pin.Model, q: np.ndarray, contacts: ContactSet, wrenches: np.ndarray, point: ArrayLike
) -> MomentumAbout:
    """Return the sum of wrenches or impulses (n, 6) of ``contacts``, with the moment about ``point`` (3,)."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    centre = np.asarray(point, dtype=float)
    linear, angular = np.zeros(3), np.zeros(3)
    for frame, wrench in zip(contacts.frames, wrenches, strict=True):
        linear += wrench[:3]
        angular += wrench[3:] + np.cross(data.oMf[frame].translation - centre, wrench[:3])
    return MomentumAbout(linear=linear, angular=angular, point=centre)


def _kinetic_energy(lower: np.ndarray, v: np.ndarray) -> float:
    """Return 1/2 v^T L L^T v."""
    momentum_like = lower.T @ v
    return float(momentum_like @ momentum_like) / 2
