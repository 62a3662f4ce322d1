"""Motions of any robot whose outcome is known beforehand: standing, standing pushed, free floating, reaching."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pinocchio as pin

from problems import common, leaping
from trajopt.contact_terms import FrictionCone
from trajopt.model_quantities import contact_jacobian
from trajopt.node_terms import TerminalRest, TerminalState
from trajopt.objectives import effort_costs
from trajopt.problem import Problem
from trajopt.robot import Robot
from trajopt.schedule import FlatGround, Phase, Schedule
from trajopt.terms import EffortLimits, PositionLimits, Term, VelocityLimits


def stand(
    robot: Robot,
    *,
    duration: float | None = None,
    friction: float = 0.7,
    exact: bool = False,
    push: tuple[float, ...] = (0.0,) * 6,
    costs: tuple[Term, ...] | None = None,
) -> Problem:
    """Stand on all contacts at the reference; after a push of the base come back to it, to rest.

    duration: s, by default 3 sqrt(l / g). push: velocity (6,) of the base at the start, m/s and rad/s over
    their natural units, as far as the feet in place let it. exact: the smooth cone of friction, not the
    pyramid.
    """
    time = 3 * leaping.natural_time(robot) if duration is None else duration
    names = tuple(contact.name for contact in robot.contacts)
    unit = robot.length / leaping.natural_time(robot) * np.array([1.0] * 3 + [1 / robot.length] * 3)
    return Problem(
        name="stand",
        robot=robot,
        schedule=Schedule((Phase(name="stand", duration=time, contacts=names),)),
        terrain=FlatGround(friction=friction),
        initial_q=robot.reference,
        initial_v=feet_still(robot, unit * push),
        terms=(
            *(effort_costs() if costs is None else costs),
            EffortLimits(),
            PositionLimits(),
            VelocityLimits(),
            *((FrictionCone(),) if exact else common.contact_cones(robot)),
            TerminalState(q=robot.reference),
            TerminalRest(q=robot.reference),
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


def float_free(robot: Robot, *, turn: float, duration: float) -> Problem:
    """Without contacts joints swing there and back in flight; the base ends turned by what they give it.

    Joints go by ``turn`` rad in ``duration`` s, all that can: the base follows by conservation of momentum.
    """
    start, end = robot.reference, bent(robot, turn)
    return Problem(
        name="float",
        robot=robot,
        schedule=Schedule((Phase(name="float", duration=duration),)),
        terrain=FlatGround(),
        initial_q=start,
        initial_v=np.zeros(robot.nv),
        guess=_moving(robot.model, start, end, duration),
        default_intervals=10,
    )


def bent(robot: Robot, turn: float) -> np.ndarray:
    """The reference with every actuated joint turned, within its limits."""
    v = np.zeros(robot.nv)
    v[robot.n_unactuated :] = turn
    q = pin.integrate(robot.model, robot.reference, v)
    return np.clip(q, robot.position_lower, robot.position_upper)


def _moving(
    model: pin.Model, start: np.ndarray, end: np.ndarray, duration: float
) -> Callable[[float], np.ndarray]:
    return lambda t: np.asarray(pin.interpolate(model, start, end, min(max(t / duration, 0.0), 1.0)))
