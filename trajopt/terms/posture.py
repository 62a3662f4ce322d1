"""Ends of motions that may be anywhere on the ground: a posture over the place where a foot has landed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajopt.errors import InputError
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Rows
from trajopt.terms.node_interfaces import NodeConstraint, NodePlace
from trajopt.terms.terminal import configuration_difference, free_rows

# Rows of v that are the base's translation along the world's x and y, by kind of base; -1 has none.
HORIZONTAL = {"planar": (0, -1), "freeflyer": (0, 1)}


@dataclass(frozen=True, kw_only=True)
class TerminalPosture(NodeConstraint):
    """The final configuration is ``q`` (nq,), moved level to where the contact ``over`` stands.

    In the directions that active contacts leave free, as `TerminalState`; the robot does not turn. The base
    is a free-flyer or planar, in axes that the world's x and y are among. Raises InputError.
    """

    q: np.ndarray
    over: str

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        robot, q = context.robot, context.posture(self.q)
        foot = context.contact(self.over)
        goal = contact_positions(robot, q)[self.over]
        error = configuration_difference(context, q)
        for axis, row in enumerate(_horizontal(robot)):
            if row >= 0:
                error[row] -= context.frame(foot.frame).position[axis] - context.parameter(goal[axis])
        return free_rows(context, place, q, error / units.position)


def _horizontal(robot: Robot) -> tuple[int, int]:
    if robot.base not in HORIZONTAL:
        raise InputError(
            f"robot '{robot.name}' has a {robot.base} base", "allowed: freeflyer or planar for a free place"
        )
    return HORIZONTAL[robot.base]
