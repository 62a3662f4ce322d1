"""Guesses from reduced models: their base or CoM motion, feet on footholds or swings, inverse kinematics."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.model_quantities import gravity_of
from trajopt.errors import InputError
from trajopt.motion.configurations import SolutionMotion
from trajopt.motion.solution import Solution
from trajopt.problem.contact_paths import ContactPaths, RememberedMotion
from trajopt.problem.problem import Problem
from trajopt.reduced.base_path import flights, turn_to_heading
from trajopt.reduced.com_program import CenterOfMassProgram
from trajopt.reduced.footsteps import FootstepPlan, feet_of
from trajopt.reduced.legged import LeggedPosture
from trajopt.reduced.lip import ComPath, Pendulum
from trajopt.reduced.single_rigid_body import footholds_of
from trajopt.robot.kinematics import contact_targets, inverse_kinematics
from trajopt.robot.legs import require_free_flyer
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Motion

# Default height in m of a swing above the straight line between its footholds.
DEFAULT_CLEARANCE = 0.05
# Fixed-point steps that move the CoM to its target. Each leaves the fraction of mass that does not follow the
# base. A fixed number from a fixed start keeps the posture smooth in time, as finite differences need.
COM_STEPS = 4
# Fraction of the soles kept as a margin for the pendulum's ZMP: the robot is not a pendulum.
MARGIN = 0.5


class BasePath:
    """Free-flyer placement of a solution over time.

    The path is stretched to the phase ``durations`` in s, by default the solution's.
    """

    def __init__(self, solution: Solution, durations: Sequence[float] | None = None) -> None:
        self._motion = SolutionMotion(solution)
        self._durations = np.diff(self._motion.spans)[:, 0] if durations is None else np.array(durations)
        self._ends = np.cumsum(self._durations)

    def __call__(self, t: float) -> pin.SE3:
        """Return the placement at ``t`` in s, clipped; at a phase boundary, that of the later phase."""
        phase = int(np.searchsorted(self._ends[:-1], t, side="right"))
        fraction = 1 + (t - self._ends[phase]) / self._durations[phase]
        place = np.array([phase]), np.clip([fraction], 0.0, 1.0)
        return pin.XYZQUATToSE3(self._motion.in_phase(*place, towards=0.5).q[0, :7])


@checked
def guess_from_srb(problem: Problem, solution: Solution, *, clearance: float = DEFAULT_CLEARANCE) -> Motion:
    """Return a guess ``t -> q`` (nq,) for a problem from the solution of its `body_problem`.

    Args:
        problem: The problem of the whole robot.
        solution: The solution of a single free-flyer body with the problem's phases.
        clearance: Height of swings while other feet stand, m.

    Raises:
        InputError: If the solution has other coordinates or phases.
    """
    names = [phase.name for phase in problem.schedule.phases]
    phases = list(solution.phase_names)
    if solution.q.shape[1] != 7 or phases != names:
        raise InputError(
            f"the solution has {solution.q.shape[1]} coordinates and phases {phases}",
            f"allowed: a free-flyer, 7, and phases {names}",
        )
    durations = [phase.duration for phase in problem.schedule.phases]
    robot, feet = problem.robot, feet_of(problem.robot, problem.initial_q)
    return RememberedMotion(
        LeggedPosture(
            robot=robot,
            base=BasePath(solution, durations),
            contacts=footholds_of(problem).contact_paths(feet, clearance),
            flights=flights(problem.schedule),
            terrain=problem.terrain,
        )
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class WalkPosture:
    """Postures of a walk: base level along the feet's heading, feet and CoM on their paths.

    The CoM keeps the height it has in the initial posture ``q`` (nq,).
    """

    robot: Robot
    feet: ContactPaths
    motion: ComPath
    q: np.ndarray
    data: pin.Data = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "data", self.robot.model.createData())

    @cached_property
    def _start(self) -> np.ndarray:
        return np.array(pin.centerOfMass(self.robot.model, self.data, self.q))

    def __call__(self, t: float) -> np.ndarray:
        """Return the configuration (nq,) at time ``t`` in s."""
        feet = {name: self.feet.pose(name, t) for name in self.feet.stances}
        turns = [
            feet[name].rotation @ stances[0].pose.rotation.T for name, stances in self.feet.stances.items()
        ]
        targets = contact_targets(self.robot, feet)
        goal = np.append(self.motion.com(t), self._start[2])
        q = self.q.copy()
        turn = pin.Quaternion(turn_to_heading(np.sum(turns, axis=0)))
        q[3:7] = (turn * pin.Quaternion(*q[[6, 3, 4, 5]])).coeffs()
        q[:3] += goal - self._start
        for _ in range(COM_STEPS):
            q = inverse_kinematics(self.robot, q, targets).q
            q[:3] += goal - pin.centerOfMass(self.robot.model, self.data, q)
        return inverse_kinematics(self.robot, q, targets).q


@checked
def guess_from_lip(
    robot: Robot,
    plan: FootstepPlan,
    motion: ComPath | None = None,
    *,
    q: np.ndarray | None = None,
    clearance: float = DEFAULT_CLEARANCE,
) -> Motion:
    """Return a guess ``t -> q`` (nq,) for the full robot with a level base.

    Args:
        robot: A robot on a free-flyer in world axes.
        plan: Footholds and their timing.
        motion: Horizontal path of the centre of mass; default: that of the `CenterOfMassProgram`, with half
            of the soles as a margin.
        q: Initial posture (nq,); default: the reference. The height of its centre of mass is kept.
        clearance: Height of the swings, m.

    Raises:
        InputError: If the base is not a free-flyer in world axes, or the pendulum cannot follow the plan.
    """
    require_free_flyer(robot)
    start = np.array(robot.reference if q is None else q, dtype=float)
    if motion is None:
        com = pin.centerOfMass(robot.model, robot.model.createData(), start)
        motion = CenterOfMassProgram(
            robot=robot,
            plan=plan,
            pendulum=Pendulum(height=com[2], gravity=gravity_of(robot.model)),
            com_start=com[:2],
            shrink=MARGIN,
        ).solve()
    feet = plan.contact_paths(feet_of(robot, start), clearance)
    posture = WalkPosture(robot=robot, feet=feet, motion=motion, q=start)
    return RememberedMotion(posture)
