"""Motions of any robot whose outcome is known beforehand: standing, standing pushed, floating."""

from functools import partial

import numpy as np

from trajopt import FlatGround, Phase, Problem, Robot, Schedule, terms
from trajopt.dynamics import contact_jacobian
from trajopt.robot import Units
from trajopt_library.problems import common

# A robot that floats is this many lengths higher than it stands, so that no leg meets the ground.
FLOATING = 4.0


def stand(
    robot: Robot,
    *,
    duration: float | None = None,
    friction: float = 0.7,
    exact: bool = False,
    push: tuple[float, ...] = (0.0,) * 6,
    costs: tuple[terms.Term, ...] | None = None,
) -> Problem:
    """Stand on all contacts at the reference; after a push of the base come back to it, to rest.

    duration: s, by default 3 sqrt(l / g). push: velocity (6,) of the base at the start, m/s and rad/s over
    their natural units, as far as the feet in place let it. exact: the smooth cone of friction, not the
    pyramid.
    """
    time = 3 * Units(robot).time if duration is None else duration
    names = tuple(contact.name for contact in robot.contacts)
    return Problem(
        name="stand",
        robot=robot,
        schedule=Schedule((Phase(name="stand", duration=time, contacts=names),)),
        terrain=FlatGround(friction=friction),
        initial_v=feet_still(robot, Units(robot).twist * push),
        terms=(
            *(terms.effort_costs() if costs is None else costs),
            terms.TorqueLimits(),
            terms.PositionLimits(),
            terms.VelocityLimits(),
            *((terms.FrictionCone(),) if exact else terms.contact_cones(robot.contacts)),
            terms.TerminalState(q=robot.reference),
            terms.TerminalRest(q=robot.reference),
        ),
        guess=partial(_still, robot.reference),
        default_intervals=10,
    )


def feet_still(robot: Robot, base: np.ndarray) -> np.ndarray:
    """Rates (nv,) with these of the base (6,) and joints that keep all contacts in place."""
    contacts = [(contact.frame, contact.rows) for contact in robot.contacts]
    jacobian = contact_jacobian(robot.model, robot.reference, contacts)
    joints = -np.linalg.lstsq(jacobian[:, 6:], jacobian[:, :6] @ base, rcond=None)[0]
    return np.concatenate([base, joints])


def _still(q: np.ndarray, t: float) -> np.ndarray:
    return q


def turn_over(robot: Robot, *, yaw: float, duration: float) -> Problem:
    """Float without contacts and turn about the vertical by moving the legs alone, from rest to rest.

    yaw: rad. As a cat does: no momentum, and yet another orientation with the same posture.
    """
    up = (0.0, 0.0, FLOATING * robot.length)
    start, end = common.displaced(robot, up), common.displaced(robot, up, yaw)
    return Problem(
        name="turn-over",
        robot=robot,
        schedule=Schedule((Phase(name="float", duration=duration),)),
        initial_q=start,
        terms=(
            *terms.effort_costs(),
            terms.TorqueLimits(),
            terms.VelocityLimits(),
            terms.TerminalState(q=end),
            terms.TerminalRest(q=end),
        ),
        guess=partial(_turning, robot, yaw, duration),
        default_intervals=12,
    )


def _turning(robot: Robot, yaw: float, duration: float, t: float) -> np.ndarray:
    up = (0.0, 0.0, FLOATING * robot.length)
    return common.displaced(robot, up, yaw * min(max(t / duration, 0.0), 1.0))
