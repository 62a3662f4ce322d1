"""Convert a problem of a free-flyer robot to the same problem on virtual joints.

Only the base differs: three angles replace its rotation. Configurations in the problem are mapped to the
angles that continue those of the guess. Velocity and acceleration costs keep their meaning: they use the
base's linear velocity in world axes and its angular velocity in its own axes, not the rates of the angles.
Both problems therefore have the same optimum up to discretisation error.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property

import casadi as ca
import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import AXES, virtual_order
from trajopt.dynamics.virtual_base import DEFAULT_ORDER, LEAST_MARGIN, angles_of, from_free_flyer, margin_of
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.costs import AccelerationCost, VelocityCost
from trajopt.terms.interfaces import Term

# Samples at which the guess's angles are made continuous: a base that turns once in the whole motion turns by
# three degrees between samples.
SAMPLES = 120


@checked
def with_virtual_base(problem: Problem, order: str = DEFAULT_ORDER) -> Problem:
    """Return the problem on the robot `Robot.with_virtual_base`.

    The start, the guess and every configuration ``q`` (nq,) in a term are mapped. `VelocityCost` and
    `AccelerationCost` become `BaseVelocityCost` and `BaseAccelerationCost`.

    Args:
        problem: A problem of a robot on a free-flyer.
        order: Order of the axes of rotation.

    Raises:
        InputError: If the robot has another base, or the problem has phases in minimal coordinates, a
            periodic motion, or a start in gimbal lock.
    """
    robot = problem.robot.with_virtual_base(order)
    if problem.modes:
        raise InputError(f"problem '{problem.name}' has phases in minimal coordinates", "none of them")
    if problem.periodicity is not None:
        raise InputError(f"problem '{problem.name}' is periodic", "allowed: a fixed start")
    still = np.zeros(robot.nv)
    initial_q, initial_v, _ = from_free_flyer(order, problem.initial_q, problem.initial_v, still)
    margin = float(margin_of(initial_q[4]))
    if margin < LEAST_MARGIN:
        raise InputError(
            f"problem '{problem.name}' starts in gimbal lock: margin {margin:.3f} < {LEAST_MARGIN}",
            "another order of the virtual joints, or base='freeflyer'",
        )
    guess = _ContinuedGuess(order, problem.guess, problem.schedule.duration, initial_q[3:6])

    def mapped(q: np.ndarray) -> np.ndarray:
        return from_free_flyer(order, q, still, still, guess.angles[-1])[0]

    return replace(
        problem,
        robot=robot,
        initial_q=initial_q,
        initial_v=initial_v,
        terms=tuple(_converted(term, problem.robot, mapped) for term in problem.terms),
        guess=guess,
    )


def _converted(term: Term, robot: Robot, mapped: Callable[[np.ndarray], np.ndarray]) -> Term:
    for plain, spatial in ((VelocityCost, BaseVelocityCost), (AccelerationCost, BaseAccelerationCost)):
        if type(term) is plain and not term.joints_only:
            return spatial(weight=term.weight, during=term.during)
    q = getattr(term, "q", None)
    if q is None or "q" not in {field.name for field in fields(term)} or np.shape(q) != (robot.nq,):
        return term
    return replace(term, q=mapped(np.asarray(q)))  # type: ignore[call-arg]


@dataclass(frozen=True)
class _ContinuedGuess:
    """A guess in base angles, without jumps of half a turn at gimbal lock."""

    order: str
    motion: Callable[[float], np.ndarray]
    duration: float
    start: np.ndarray

    @cached_property
    def angles(self) -> np.ndarray:
        """Angles (SAMPLES + 1, 3) along the motion, each nearest to the previous ones."""
        angles = [self.start]
        for t in np.linspace(0.0, self.duration, SAMPLES + 1):
            quaternion = pin.Quaternion(*self.motion(float(t))[[6, 3, 4, 5]])
            angles.append(angles_of(self.order, np.array(quaternion.toRotationMatrix()), angles[-1]))
        return np.array(angles[1:])

    def __call__(self, t: float) -> np.ndarray:
        q = self.motion(t)
        sample = round(np.clip(t / self.duration, 0.0, 1.0) * SAMPLES)
        still = np.zeros(len(q) - 1)
        return from_free_flyer(self.order, q, still, still, self.angles[int(sample)])[0]


@dataclass(frozen=True, kw_only=True)
class BaseVelocityCost(VelocityCost):
    """`VelocityCost` of a virtual base: linear velocity in world axes, angular in body axes, joint rates."""

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        omega, _ = _body_rates(context)
        return ca.vertcat(context.dxi[:3], omega, context.dxi[6:]) / units.velocity


@dataclass(frozen=True, kw_only=True)
class BaseAccelerationCost(AccelerationCost):
    """`AccelerationCost` of a virtual base: the time derivatives of the velocities of `BaseVelocityCost`."""

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        _, change = _body_rates(context)
        return ca.vertcat(context.ddxi[:3], change, context.ddxi[6:]) / units.acceleration


def _body_rates(context: Context) -> tuple[ca.SX, ca.SX]:
    """Return angular velocity and acceleration (3,) of a virtual base in its own axes."""
    order = virtual_order(context.robot.model)
    if order is None:
        raise InputError(f"robot '{context.robot.name}' has base={context.robot.base!r}", "'virtual'")
    angles, rates, second = (ca.SX.sym(name, 3) for name in ("angles", "rates", "second"))
    omega = ca.SX.zeros(3)
    # omega = R_k^T (R_j^T (e_i a') + e_j b') + e_k c', from the outermost axis inwards.
    for axis, angle, rate in zip(order, ca.vertsplit(angles), ca.vertsplit(rates), strict=True):
        omega = ca.mtimes(_turn(axis, angle).T, omega) + ca.DM(np.eye(3)[AXES.index(axis)]) * rate
    change = ca.jtimes(omega, angles, rates) + ca.jtimes(omega, rates, second)
    motion = ca.Function("body_rates", [angles, rates, second], [omega, change])
    turning, turned = motion(context.xi[3:6], context.dxi[3:6], context.ddxi[3:6])
    return turning, turned


def _turn(axis: str, angle: ca.SX) -> ca.SX:
    """Return the rotation matrix about one of the axes by Rodrigues' formula."""
    cross = ca.skew(ca.SX(np.eye(3)[AXES.index(axis)]))
    return ca.SX.eye(3) + ca.sin(angle) * cross + (1 - ca.cos(angle)) * ca.mtimes(cross, cross)
