"""A phase in coordinates of its own: the robot as it is while a contact holds, and the maps to the whole."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from trajopt.minimal_coordinates import stance_mode
from trajopt.robot import Contact, Robot
from trajopt.stance_maps import symbols


@dataclass(frozen=True, kw_only=True, eq=False)
class Mode:
    """Minimal coordinates of a phase in which contacts are embedded instead of constrained.

    robot: the robot in the mode's coordinates; its own contacts are those that are not embedded.
    embedded: the whole robot's contacts that these coordinates hold in place, at ``anchor`` (3,) m.
    lift: (q, v, a) of the mode -> (q, v, a) of the whole robot.
    drop: (q, v, a) of the whole robot -> (q, v, a) of the mode.
    reaction: (q, v, a) of the mode -> forces (3 each, N, world axes) on the embedded contacts.
    """

    robot: Robot
    embedded: tuple[Contact, ...]
    anchor: np.ndarray
    lift: ca.Function
    drop: ca.Function
    reaction: ca.Function

    @classmethod
    def standing(cls, robot: Robot, contact: str, foothold: ArrayLike | None = None) -> Mode:
        """The mode of a floating or planar ``robot`` that stands on one point contact at ``foothold`` (3,) m.

        The foothold defaults to the contact's place in the reference posture. Raises `InputError` as
        `minimal_coordinates.stance_mode` does.
        """
        stance = stance_mode(robot, contact, anchor=foothold)
        q, v, a = symbols(stance.robot.model)
        lift = ca.Function("lift", [q, v, a], list(stance.lift(q, v, a, ca.DM(stance.anchor))))
        q, v, a = symbols(robot.model)
        drop = ca.Function("drop", [q, v, a], list(stance.drop(q, v, a)[:3]))
        return cls(
            robot=replace(stance.robot, contacts=()),
            embedded=(robot.contact(contact),),
            anchor=stance.anchor,
            lift=lift,
            drop=drop,
            reaction=stance.reaction,
        )

    @property
    def embedded_names(self) -> tuple[str, ...]:
        """Names of the embedded contacts."""
        return tuple(contact.name for contact in self.embedded)

    def lifted(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Numeric (q, v, a) of the whole robot and reactions, of rows (n, ...) of states of the mode."""
        moved = [np.array(part).T for part in self.lift(q.T, v.T, a.T)]
        return moved[0], moved[1], moved[2], np.array(self.reaction(q.T, v.T, a.T)).T

    def dropped(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numeric (q, v, a) of the mode for one state of the whole robot."""
        moved = [np.array(part).ravel() for part in self.drop(q, v, a)]
        return moved[0], moved[1], moved[2]
