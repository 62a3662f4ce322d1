"""Rigid inelastic impact: contacts close within no time and stay closed.

    M (v+ - v-) = J^T Lambda,      J v+ = 0

for the contacts that hold after the impact: those that land and those that stay. q does not change, and
non-impulsive forces have no effect (Featherstone 2008, sec. 11.7; Hurmuzlu and Marghitu
1994). v+ is the projection of v- onto J v = 0 in the metric of M, so kinetic energy falls by
1/2 (v+ - v-)^T M (v+ - v-). The contacts are bilateral in it: an impulse that pulls, or leaves its
friction cone (`friction.cone_margins`), says that the contact lifts or slides instead.
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

    Of the links alone: spinning rotors (armature) change joint rows of M, not these.
    """

    linear: np.ndarray
    angular: np.ndarray
    point: np.ndarray

    def about(self, point: ArrayLike) -> MomentumAbout:
        """Return the same momentum with the angular part about another point (3,) of the world."""
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
    """What an impact does.

    velocity: v+ (nv,). impulses: (n, 6) N s and N m s, of the surroundings on the robot, world axes,
    at the frames' origins. rank: which rows depend on each other; if it is redundant, the impulses have
    minimum norm (`ContactSet.moment_arm`). energy_before, energy_after, energy_loss: 1/2 v^T M v in J, the
    loss from the velocity jump. jump: change of momentum, about the centre of mass. impulse: sum of the
    contacts' impulses as a momentum about the centre of mass. dynamics_residual: (nv,) of the first row;
    contact_velocity: (n, 6) J v+, m/s and rad/s.
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
        """Impulse of the world on the root joint: jump - impulse, zero for a free-flyer."""
        return self.jump - self.impulse


@checked
def impact(model: pin.Model, q: np.ndarray, v_minus: np.ndarray, contacts: ContactSet) -> Impact:
    """Return velocity and impulses after the impact of ``contacts``, all that hold afterwards.

    q (nq,), v_minus (nv,) just before. Raises `InputError` for wrong shapes, numbers that are not finite,
    or a mass matrix that is not positive definite.
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
    """1/2 v^T L L^T v."""
    momentum_like = lower.T @ v
    return float(momentum_like @ momentum_like) / 2
