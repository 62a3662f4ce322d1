"""A phase in coordinates of its own: the robot as it is while a contact holds, and the maps to the whole."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from trajopt.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Mode:
    """Minimal coordinates of a phase in which contacts are embedded instead of constrained.

    robot: the robot in the mode's coordinates; its own contacts are those that are not embedded.
    embedded: names of the whole robot's contacts that these coordinates hold in place.
    lift: (q, v, a) of the mode -> (q, v, a) of the whole robot.
    drop: (q, v, a) of the whole robot -> (q, v, a) of the mode.
    reaction: (q, v, a) of the mode -> forces (3 each, N, world axes) of the embedded contacts.
    """

    robot: Robot
    embedded: tuple[str, ...]
    lift: ca.Function
    drop: ca.Function
    reaction: ca.Function

    def lifted(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Numeric (q, v, a) of the whole robot and reactions, rows for rows (n, ...)."""
        moved = [np.array(part).T for part in self.lift(q.T, v.T, a.T)]
        force = np.array(self.reaction(q.T, v.T, a.T)).T
        return moved[0], moved[1], moved[2], force

    def dropped(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numeric (q, v, a) of the mode for one state of the whole robot."""
        moved = [np.array(part).ravel() for part in self.drop(q, v, a)]
        return moved[0], moved[1], moved[2]
