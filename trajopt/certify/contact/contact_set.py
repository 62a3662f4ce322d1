"""Simultaneous contacts as bilateral constraints on the motion of a model.

A contact with frame C fixes the origin of C (3 rows) or its whole pose (6 rows, linear first). In world axes,
with J the stacked frame Jacobians,

    J v = 0,        J a + Jdot v = 0                                      (classical acceleration)

For a ball that rolls on a plane the rows are v - omega x s and a - omega' x s of its centre, with its lever s
from the contact point to the centre; a force f on it has the moment f x s about the centre.
While contacts are active these rows do not depend on surfaces: the normal and the friction coefficient
limit the wrenches, not the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.model_quantities import without_rolling
from trajopt.errors import InputError
from trajopt.robot.building import reach
from trajopt.robot.contact import Contact, require_frame

DIMENSIONS = (3, 6)
AXES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, kw_only=True)
class ContactSet:
    """Contacts of a model by name, frame id and dimension, 3 (point) or 6 (surface).

    ``moment_arm`` (m) makes moments and forces, angles and lengths comparable: wrenches are measured
    by |f|^2 + |m|^2 / arm^2, accelerations by |linear|^2 + arm^2 |angular|^2. Both are independent of the
    axes, and matter only for redundant contacts. ``levers`` are the levers (3,) m of rolling points, None for
    other contacts; empty if none rolls.
    """

    names: tuple[str, ...]
    frames: tuple[int, ...]
    dimensions: tuple[int, ...]
    moment_arm: float
    levers: tuple[tuple[float, ...] | None, ...] = ()

    @classmethod
    @checked
    def of(
        cls,
        model: pin.Model,
        contacts: Sequence[Contact | tuple[str, int]],
        *,
        moment_arm: float | None = None,
        levers: Sequence[np.ndarray | None] = (),
    ) -> ContactSet:
        """Return the set of ``contacts``, each a `Contact` or (frame name, dimension).

        ``levers`` has the lever (3,) m of each rolling ball, None or zero for other contacts; default: none
        rolls. ``moment_arm`` defaults to the reach of the model, or 1 m if it has none. Raises `InputError`
        for an unknown frame, a dimension other than 3 and 6, an arm that is not positive, or invalid levers.
        """
        entries = [
            (c.name, c.frame, 3 if c.kind == "point" else 6) if isinstance(c, Contact) else (c[0], *c)
            for c in contacts
        ]
        for name, frame, dimension in entries:
            require_frame(model, frame, f"contact '{name}'")
            if dimension not in DIMENSIONS:
                raise InputError(f"contact '{name}' has dimension {dimension}", "3 (point) or 6 (surface)")
        arm = (reach(model) or 1.0) if moment_arm is None else float(moment_arm)
        if not 0 < arm < np.inf:
            raise InputError(f"moment_arm is {moment_arm}", "a positive length in m")
        arms = tuple(tuple(lever.tolist()) if lever is not None and lever.any() else None for lever in levers)
        wrong = [
            len(lever) != 3 or entry[2] != 3 for lever, entry in zip(arms, entries, strict=False) if lever
        ]
        if any(wrong) or (arms and len(arms) != len(entries)):
            raise InputError(
                f"levers are {arms}", "None or three numbers for each contact, None for a surface"
            )
        return cls(
            names=tuple(entry[0] for entry in entries),
            frames=tuple(model.getFrameId(entry[1]) for entry in entries),
            dimensions=tuple(entry[2] for entry in entries),
            moment_arm=arm,
            levers=arms if any(arms) else (),
        )

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Slice of the rows of each contact."""
        ends = np.cumsum(self.dimensions, dtype=int)
        pairs = zip(ends.tolist(), self.dimensions, strict=True)
        return tuple(slice(end - size, end) for end, size in pairs)

    @property
    def n_rows(self) -> int:
        """Number of rows of all contacts."""
        return sum(self.dimensions)

    @cached_property
    def row_names(self) -> tuple[str, ...]:
        """Name of each row: contact and world axis, as in ``'left_foot rx'``."""
        pairs = zip(self.names, self.dimensions, strict=True)
        return tuple(f"{name} {axis}" for name, size in pairs for axis in AXES[:size])

    @cached_property
    def scale(self) -> np.ndarray:
        """Factor (n_rows,) that converts rows of motion to m: 1 for linear rows, the arm for angular ones."""
        full = np.array([1.0] * 3 + [self.moment_arm] * 3)
        return np.concatenate([np.zeros(0), *(full[:size] for size in self.dimensions)])

    def table(self, stacked: np.ndarray) -> np.ndarray:
        """Return stacked rows (n_rows,) as a table (n, 6); the angular entries of points are zero."""
        entries = np.zeros((len(self.names), 6))
        for index, (rows, size) in enumerate(zip(self.slices, self.dimensions, strict=True)):
            entries[index, :size] = stacked[rows]
        return entries

    def wrenches(self, stacked: np.ndarray) -> np.ndarray:
        """Return stacked wrenches (n_rows,) as a table (n, 6), with the moments of rolling balls."""
        entries = self.table(stacked)
        for entry, lever in zip(entries, self.levers, strict=False):
            if lever is not None:
                entry[3:] = np.cross(entry[:3], lever)
        return entries

    def stacked(self, table: np.ndarray) -> np.ndarray:
        """Return the stacked rows (n_rows,) of a table (n, 6)."""
        parts = zip(table, self.dimensions, strict=True)
        return np.concatenate([np.zeros(0), *(entry[:size] for entry, size in parts)])


@dataclass(frozen=True, kw_only=True)
class ContactKinematics:
    """Rows of a contact set at (q, v), in world axes.

    ``jacobian`` is J (n_rows, nv), ``drift`` Jdot v and ``velocity`` J v (n_rows,), in m, rad and s.
    """

    jacobian: np.ndarray
    drift: np.ndarray
    velocity: np.ndarray


def contact_kinematics(
    model: pin.Model, data: pin.Data, q: np.ndarray, v: np.ndarray, contacts: ContactSet
) -> ContactKinematics:
    """Return Jacobian, drift and velocity of ``contacts`` at q (nq,), v (nv,).

    The drift is the classical acceleration of the frames at a = 0, without gravity.
    """
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    pin.computeJointJacobians(model, data)
    jacobian, drift = np.zeros((contacts.n_rows, model.nv)), np.zeros(contacts.n_rows)
    levers = contacts.levers or (None,) * len(contacts.names)
    entries = zip(contacts.frames, contacts.slices, contacts.dimensions, levers, strict=True)
    for frame, rows, size, lever in entries:
        block = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, model.nv)
        motion = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
        jacobian[rows], drift[rows] = (
            each[:size] if lever is None else without_rolling(each, lever) for each in (block, motion)
        )
    return ContactKinematics(jacobian=jacobian, drift=drift, velocity=jacobian @ v)
