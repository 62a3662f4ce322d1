"""A phase in coordinates of its own: the robot as it is while a contact holds, and the maps to the whole."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.robot.contact import Contact
from trajopt.robot.robot import Robot
from trajopt.robot.stance.minimal_coordinates import stance_mode
from trajopt.robot.stance.stance_maps import symbols


@dataclass(frozen=True, kw_only=True, eq=False)
class Mode:
    """Minimal coordinates of a phase in which a contact is embedded instead of constrained.

    whole: the robot whose phase it is. robot: that robot in the mode's coordinates; its own contacts are
    those that are not embedded.
    embedded: the whole robot's contact that these coordinates hold in place, at ``anchor`` (3,) m.
    lift: (q, v, a) of the mode -> (q, v, a) of the whole robot.
    drop: (q, v, a) of the whole robot -> (q, v, a) of the mode.
    reaction: (q, v, a) of the mode -> force (3,) N, world axes, that all contacts together give; what other
    contacts do not is the embedded one's.
    torque_rows: (nu,) rows of the whole robot's torques in the order of the mode's.
    """

    whole: Robot
    robot: Robot
    embedded: Contact
    anchor: np.ndarray
    lift: ca.Function
    drop: ca.Function
    reaction: ca.Function
    torque_rows: np.ndarray

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
            whole=robot,
            robot=stance.robot,
            embedded=robot.contact(contact),
            anchor=stance.anchor,
            lift=lift,
            drop=drop,
            reaction=stance.reaction,
            torque_rows=stance.torque_rows,
        )

    def lifted(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Numeric (q, v, a) of the whole robot and reactions, of rows (n, ...) of states of the mode."""
        moved = [np.array(part).T for part in self.lift(q.T, v.T, a.T)]
        return moved[0], moved[1], moved[2], np.array(self.reaction(q.T, v.T, a.T)).T

    def loses(self, q: np.ndarray, v: np.ndarray) -> float:
        """Largest entry (m, rad; m/s, rad/s) of what of a state of the whole robot the mode cannot hold."""
        own = self.dropped(q, v, np.zeros(self.whole.nv))
        back = self.lifted(own[0][None], own[1][None], own[2][None])
        apart = pin.difference(self.whole.model, q, back[0][0])
        return float(max(np.abs(apart).max(), np.abs(back[1][0] - v).max()))

    def dropped(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numeric (q, v, a) of the mode for one state of the whole robot."""
        moved = [np.array(part).ravel() for part in self.drop(q, v, a)]
        return moved[0], moved[1], moved[2]
