"""Sliding contacts in the check: friction law and open-loop dynamics."""

from functools import cached_property

import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt import _numeric
from trajopt.certify.contact.contact_dynamics import ContactDynamics
from trajopt.certify.contact.contact_set import ContactSet, contact_kinematics
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.traces import Trace
from trajopt.terrain.surface import Surface


def sliding_error(motion: MotionQuantities) -> Trace:
    """Return the largest difference between forces of sliding contacts and Coulomb's law, over the weight.

    The law is that of `trajopt.terms.dynamics`: f_t = -mu f_n u / sqrt(|u|^2 + s^2), with u the velocity
    within the surface and s the slip speed.
    """
    plan, surfaces = motion.solution, motion.surfaces
    rows = plan.active & surfaces.slides
    error = np.zeros(rows.shape)
    normal, force, velocity = surfaces.normal[rows], plan.f[rows][:, :3], motion.places.velocity[rows][:, :3]
    pressure, approach = (np.sum(normal * part, axis=1)[:, None] for part in (force, velocity))
    along = velocity - approach * normal
    speed = np.sqrt(np.sum(along**2, axis=1) + surfaces.slip[rows] ** 2)[:, None]
    law = pressure * (normal - surfaces.friction[rows][:, None] * along / speed)
    error[rows] = np.abs(force - law).max(axis=1, initial=0.0) / motion.weight
    return Trace.of(error, rows, plan.contact_frames)


class SlidingDynamics(ContactDynamics):
    """Forward dynamics if some contacts slide; computes only the acceleration.

        M a + h = tau + J_h^T f_h + D^T f_n        J_h a + .. = 0        n^T (J_s a + ..) = 0

    with held contacts h and sliding contacts s. D = (n - mu t)^T J_s is the generalised force per unit normal
    force, t the regularised direction of sliding. As D differs from n^T J_s, the matrix is not symmetric.
    """

    def __init__(self, model: pin.Model, contacts: ContactSet, surfaces: dict[int, Surface]) -> None:
        super().__init__(model, contacts)
        self.surfaces = surfaces

    @cached_property
    @override
    def compiled(self) -> _numeric.Dynamics | None:
        made = super().compiled
        if made is not None:
            for index, surface in self.surfaces.items():
                made.slide(index, surface.normal, surface.friction, float(surface.slip_speed or 0.0))
        return made

    @override
    def acceleration(self, q: np.ndarray, v: np.ndarray, generalized_force: np.ndarray) -> np.ndarray:
        """Return the acceleration (nv,) under ``generalized_force`` (nv,) and the contact forces."""
        model, data, nv = self.model, self._data, self.model.nv
        kinematics = contact_kinematics(model, data, q, v, self.contacts)
        held, pushed, drift = [], [], []
        for index, rows in enumerate(self.contacts.slices):
            jacobian, surface = kinematics.jacobian[rows], self.surfaces.get(index)
            if surface is None:
                held.append(jacobian)
                pushed.append(jacobian)
                drift.append(kinematics.drift[rows])
                continue
            normal, velocity = surface.normal, kinematics.velocity[rows]
            along = velocity - (normal @ velocity) * normal
            speed = np.sqrt(along @ along + float(surface.slip_speed or 0.0) ** 2)
            held.append(normal[None] @ jacobian)
            pushed.append((normal - surface.friction * along / speed)[None] @ jacobian)
            drift.append(normal[None] @ kinematics.drift[rows])
        constraint, push = np.vstack(held), np.vstack(pushed)
        matrix = np.zeros((nv + len(constraint), nv + len(constraint)))
        matrix[:nv, :nv], matrix[:nv, nv:], matrix[nv:, :nv] = pin.crba(model, data, q), -push.T, constraint
        right = np.concatenate([generalized_force - pin.nle(model, data, q, v), -np.concatenate(drift)])
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0][:nv])
