"""Locomotion in two stages: motion and contact wrenches from the base rows alone, then torques.

Torques act on joint coordinates only. The base rows, Newton-Euler of the whole body, therefore contain only
motion and contact wrenches (Del Prete, Focchi: modelling of legged robots). The stages are

1. find motion and wrenches with  RNEA_base(q, v, a) - sum J_base^T f = 0, feet that do not slip, friction;
2. read off the torques          tau = RNEA_joints(q, v, a) - sum J_joints^T f.

Stage one is the problem without torque terms, `base_rows_problem`, whose compiled graph has only the base
rows. Stage two is `recover_torques`, which is numeric. Stage one ignores torque limits, so stage two can only
report violations or redistribute the wrenches (``wrench_distribution``).
"""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.model_quantities import contact_jacobian, joints_of_rows
from trajopt.errors import InputError
from trajopt.motion.samples import sample_quantities
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.reduced.term_reader import TermReader
from trajopt.robot.actuators.on_robot import drive_torque_values
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.context_symbols import Place
from trajopt.terms.costs import AccelerationCost, TorqueCost, WrenchCost
from trajopt.terms.interfaces import Cost, Term

# Weight of the acceleration cost that makes the motion unique, relative to the cost it replaces.
LEAST_ACCELERATION_SHARE = 1e-2
# Largest excess over a limit, as a fraction of it, within a solver's tolerance (as in ``report``).
ROUNDING = 1e-6


def torque_terms(problem: Problem) -> list[Term]:
    """Return the terms that depend on joint torques at collocation points, in the problem's order."""
    users = {
        id(instance.term)
        for instance in TermReader(problem).every()
        if instance.context.place is Place.POINT and instance.uses_torques
    }
    return [term for term in problem.terms if id(term) in users]


@checked
def base_rows_problem(problem: Problem, *, replacement: tuple[Cost, ...] | None = None) -> Problem:
    """Return stage one of a problem: other costs replace its terms on torques.

    Args:
        problem: The full problem.
        replacement: Costs that replace the torque terms. Default: for each `TorqueCost`, a `WrenchCost` with
            the same cost of standing still at the reference (`standing_share`); and an `AccelerationCost`, if
            none is left, to make the motion unique.

    Raises:
        InputError: Unless the control input is torque.
    """
    if problem.actuation != "torque":
        raise InputError(f"actuation of problem '{problem.name}' is {problem.actuation}", "allowed: torque")
    dropped = torque_terms(problem)
    kept = tuple(term for term in problem.terms if not any(term is other for other in dropped))
    if replacement is None:
        share = standing_share(problem.robot)
        torques = [term for term in dropped if isinstance(term, TorqueCost)] if share > 0 else []
        replacement = tuple(WrenchCost(weight=share * term.weight, during=term.during) for term in torques)
        if dropped and not any(isinstance(term, AccelerationCost) for term in kept):
            weight = max((term.weight for term in dropped if isinstance(term, Cost)), default=1.0)
            replacement += (AccelerationCost(weight=LEAST_ACCELERATION_SHARE * weight),)
    return replace(problem, name=f"{problem.name}-base", terms=(*kept, *replacement))


def standing_share(robot: Robot) -> float:
    """Return the mean square of torques over that of wrenches, natural units, standing at the reference.

    The wrenches that carry the weight have minimum norm over their units; 0 without contacts or joints.
    """
    if not robot.contacts or not robot.nu:
        return 0.0
    units, actuation, still = Units(robot), robot.actuation, np.zeros(robot.nv)
    sizes = [6 if contact.kind == "surface" else 3 for contact in robot.contacts]
    places = [(contact.frame, size) for contact, size in zip(robot.contacts, sizes, strict=True)]
    unit = np.concatenate([units.wrench[:size] for size in sizes])
    jacobian = contact_jacobian(robot.model, robot.reference, places)
    weight = pin.rnea(robot.model, robot.model.createData(), robot.reference, still, still)
    wrench = np.linalg.lstsq(actuation.balanced(jacobian).T * unit, actuation.balanced(weight), rcond=None)[0]
    torque = actuation.inputs(weight - jacobian.T @ (unit * wrench)) / units.torque
    return float(np.mean(torque**2) / np.mean(wrench**2))


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueBounds:
    """Bounds on the actuated rows at every sample, (K, nu) N m, infinite where unlimited.

    ``scale`` (nu,) N m is the unit of an excess: the joint's largest torque, or m g l where unlimited.
    """

    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray


def problem_torque_limit(problem: Problem) -> np.ndarray:
    """Return the effort limit (nu,), N m, joint side, of the terms or else the robot; inf where unlimited."""
    robot = problem.robot
    limits = {"effort_limit": np.full(robot.nu, np.inf) if robot.torque_limit is None else robot.torque_limit}
    for term in problem.point_constraints:
        limits |= term.limits(robot)
    return np.asarray(limits["effort_limit"], dtype=float)


def torque_bounds(problem: Problem, v: np.ndarray) -> TorqueBounds:
    """Return bounds on the actuated rows at velocities ``v`` (K, nv).

    They combine the problem's torque limits (or else the robot's) with the limits of its drives: current,
    voltage at the joint's rate, and the friction that the drive has to overcome.
    """
    robot, effort = problem.robot, problem_torque_limit(problem)
    rates = robot.actuation.rates(v)
    upper = np.tile(effort, (len(v), 1))
    lower, scale = np.tile(robot.least_torque(effort), (len(v), 1)), effort.copy()
    if robot.drives is not None:
        friction = drive_torque_values(robot.drives, np.zeros_like(rates), rates)
        for row, drive in enumerate(robot.drives):
            if drive is not None:
                low, high = drive.torque_range(rates[:, row])
                lower[:, row] = np.maximum(lower[:, row], low)
                upper[:, row] = np.minimum(upper[:, row], high)
                scale[row] = min(
                    scale[row], drive.joint_torque_limit, abs(drive.gear_ratio) * drive.stall_torque
                )
        lower, upper = lower - friction, upper - friction
    usable = np.isfinite(scale) & (scale > 0)
    return TorqueBounds(lower=lower, upper=upper, scale=np.where(usable, scale, Units(robot).torque))


@dataclass(frozen=True, kw_only=True)
class JointTorque:
    """Torque of one actuated row: its peak (N m), and its largest excess over the bound.

    ``excess`` is over the joint's largest torque: negative within the bound, -inf where unlimited. It occurs
    at ``time`` s in ``phase``. ``share_beyond`` is the fraction of collocation points beyond the bound.
    """

    joint: str
    peak: float
    excess: float
    time: float
    phase: str
    share_beyond: float


@dataclass(frozen=True, kw_only=True)
class TorqueReport:
    """Torques of a motion and their limits, at its collocation points.

    ``joints`` are in the order of the actuated rows. ``base_residual`` is the largest base row over the
    weight; unless it is small, the robot cannot make the motion. ``excess_between`` is the largest excess at
    the other samples, where torques follow interpolated wrenches.
    """

    joints: tuple[JointTorque, ...]
    base_residual: float
    excess_between: float

    @property
    def worst(self) -> JointTorque:
        """The joint with the largest excess over its limit, or closest to it."""
        return max(self.joints, key=lambda joint: joint.excess)

    @property
    def within_limits(self) -> bool:
        """Whether no torque exceeds its limit by more than a solver's tolerance."""
        return self.worst.excess <= ROUNDING

    def __str__(self) -> str:
        lines = [f"{'joint':24s} {'peak N m':>9s} {'beyond':>9s} {'at s':>7s}  {'phase':10s} points beyond"]
        for joint in self.joints:
            lines.append(
                f"{joint.joint:24s} {joint.peak:9.3f} {joint.excess:9.2%} {joint.time:7.3f}  "
                f"{joint.phase:10s} {joint.share_beyond:.1%}"
            )
        return "\n".join([*lines, f"base rows: {self.base_residual:.1e} of the weight"])


@checked
def recover_torques(problem: Problem, solution: Solution) -> tuple[np.ndarray, TorqueReport]:
    """Return stage two: torques (K, nu) of every sample from the actuated rows, and a report on their limits.

    Args:
        problem: The full problem with the limits.
        solution: A solution of its `base_rows_problem`.

    Returns:
        Torques on the joint side, N m or N, in the order of the actuated rows; and the report.

    Raises:
        InputError: If the solution is of another robot, or the robot has no joints.
    """
    robot = problem.robot
    if solution.v.shape[1] != robot.nv or solution.tau.shape[1] != robot.nu or robot.nu == 0:
        raise InputError(
            f"the solution has {solution.v.shape[1]} velocities and {solution.tau.shape[1]} torques",
            f"allowed: {robot.nv} and {robot.nu}, those of '{robot.name}', which has joints",
        )
    forces = sample_quantities(solution).generalized_force
    torque = robot.actuation.inputs(forces)
    base = np.abs((forces - robot.actuation.force(torque))[solution.collocation])
    bounds = torque_bounds(problem, solution.v)
    excess = np.maximum(torque - bounds.upper, bounds.lower - torque) / bounds.scale
    owners = joints_of_rows(robot.model)
    names = [owners[row] for row in robot.actuated_rows] + [thruster.name for thruster in robot.thrusters]
    joints = tuple(_joint(solution, names[row], torque[:, row], excess[:, row]) for row in range(robot.nu))
    between = excess[~solution.collocation]
    return torque, TorqueReport(
        joints=joints,
        base_residual=float(base.max() / robot.weight) if base.size else 0.0,
        excess_between=float(between.max()) if between.size else -np.inf,
    )


def _joint(solution: Solution, name: str, torque: np.ndarray, excess: np.ndarray) -> JointTorque:
    points = np.flatnonzero(solution.collocation)
    at = points[np.argmax(excess[points])]
    return JointTorque(
        joint=name,
        peak=float(np.abs(torque[points]).max()),
        excess=float(excess[at]),
        time=float(solution.t[at]),
        phase=str(solution.description.phase_names[solution.phase[at]]),
        share_beyond=float(np.mean(excess[points] > ROUNDING)),
    )
