"""Tracking of a plan: its motion as tasks, measured contacts, and a quadratic program at each tick."""

from __future__ import annotations

import copy
import time

import numpy as np
import pinocchio as pin

from trajopt.arguments import Positive, PositiveCount, checked
from trajopt.control.gains import TrackerGains
from trajopt.control.inverse_dynamics import RELAXED, TaskSpaceInverseDynamics, TickResult
from trajopt.control.limits import RobotLimits, torque_limits
from trajopt.control.measured_contacts import MeasuredContacts
from trajopt.control.plan_targets import PlanTargets, plan_targets, tracking_models
from trajopt.control.plan_tasks import PlanTasks
from trajopt.control.quadratic_programs import QpSolverName
from trajopt.control.recovery import Recovery
from trajopt.control.reference import ReferenceTrajectory, reference_of
from trajopt.control.robot_state import RobotState
from trajopt.control.tick_request import TickCounts, TickRequest
from trajopt.errors import InputError
from trajopt.motion.input import SolutionOrFile, require_motion, solution_of
from trajopt.robot.robot import Robot

# Number of ticks over which joints brake before their limits.
HORIZON = 10
# Rate in natural units above which a robot has long fallen, and its joints are held.
TOO_FAST = 1e3


class Tracker:
    """A controller that tracks a plan, with any robot, contacts and phases of the library.

    At each tick `torque` returns torques of the drives for the measured state and the touching contacts. The
    tracker knows neither the simulator nor disturbances of the robot. ``request`` holds the forces and goals
    of the last tick, ``counts`` the counts and times of all ticks.

    Args:
        solution: the plan, or the path of its file.
        robot: the controlled robot; its joints must be those of the plan, whose model is used.
        rate: rate of the ticks, Hz.
        cycles: number of cycles of a periodic plan.
        gains: gains of the feedback.
        solver: solver of the quadratic programs, "piqp", "proxqp" or "osqp".

    Raises:
        InputError: for a plan that cannot be sampled or is of another robot, or if a tick is longer than a
            phase of the plan.
    """

    @checked
    def __init__(
        self,
        solution: SolutionOrFile,
        *,
        robot: Robot | None = None,
        rate: Positive = 1000.0,
        cycles: PositiveCount = 1,
        gains: TrackerGains = TrackerGains(),
        solver: QpSolverName = "piqp",
    ) -> None:
        plan = require_motion(solution_of(solution))
        if robot is not None:
            _require_robot(plan.model, robot)
        self._track(reference_of(plan, rate, cycles), rate, gains, solver)

    @classmethod
    def of_reference(
        cls, reference: ReferenceTrajectory, rate: float, gains: TrackerGains, solver: QpSolverName
    ) -> Tracker:
        """A tracker of a plan that is already sampled at ``rate`` Hz. Raises `InputError`."""
        tracker = cls.__new__(cls)
        tracker._track(reference, rate, gains, solver)
        return tracker

    def _track(
        self, reference: ReferenceTrajectory, rate: float, gains: TrackerGains, solver: QpSolverName
    ) -> None:
        if rate * reference.shortest < 1:
            raise InputError(
                f"a tick of {1 / rate:g} s is longer than a phase of {reference.shortest:g} s",
                f"allowed: a rate of {1 / reference.shortest:g} Hz or more",
            )
        self.reference, self.gains, self.solver, self.units = reference, gains, solver, reference.units
        self._models = tracking_models(reference)
        self.targets: PlanTargets = plan_targets(reference, self._models)
        self.counts = TickCounts()
        self.last: TickResult | None = None
        self.request = TickRequest.none(len(reference.contact_frames))
        self._programs: dict[int, TaskSpaceInverseDynamics] = {}
        about, horizon = reference.description, HORIZON * reference.period
        torque = torque_limits(about, reference.tau.shape[1])
        self._limits = RobotLimits(
            reference.model, reference.actuation, reference.drives, torque, about.velocity_limit, horizon
        )
        self._contacts = MeasuredContacts(reference, self.targets)
        self._tasks = PlanTasks(reference, self.targets, gains)
        self._recovery = Recovery(reference, self.targets)

    def copy(self) -> Tracker:
        """An independent copy of the tracker, which shares the counts of ticks."""
        twin = copy.copy(self)
        twin._contacts, twin._tasks = self._contacts.copy(), self._tasks.copy()
        twin._recovery = self._recovery.copy()
        return twin

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques of the drives (nu,) for the tick at ``t`` s.

        Args:
            t: time since the start of the plan, s.
            q: measured configuration (nq,), Pinocchio's.
            v: measured velocity (nv,).
            touching: which contacts touch (nc,).

        Raises:
            InputError: for a state that is not finite or has the wrong shape.
        """
        begin = time.perf_counter()
        k = int(np.clip(round(t / self.reference.period), 0, len(self.reference.t) - 1))
        contacts, frames = np.asarray(touching, dtype=bool), self._contacts.frames
        if contacts.shape != (len(frames),):
            raise InputError(
                f"touching has shape {contacts.shape}",
                f"allowed: ({len(frames)},), one for each contact",
            )
        program = self._program(int(self.reference.source[k]))
        state = program.state
        state.update(q, v, self.reference.t[k])
        self.counts.ticks += 1
        self.request = TickRequest.none(len(frames))
        if np.abs(v).max() * self.units.time > TOO_FAST:
            self.counts.relaxed[RELAXED.index("everything")] += 1
            return self._held(k, program)
        step = self._recovery.step(k, t, state, contacts)
        active = self._contacts.active(k, contacts) if step is None else step.active
        self._tasks.stand(k, active, state)
        taken = [self._contacts.of(int(i), k) for i in np.flatnonzero(active)]
        if step is None:
            tasks = self._tasks.of(k, active, self._contacts, state)
        else:
            tasks = self._tasks.of_recovery(k, step, state)
        result = program.solve(taken, tasks, self._limits.at(q, v))
        self.request = TickRequest.of(result.forces, taken, tasks, self.targets.com[k, 0], frames)
        self.counts.relaxed[result.relaxed] += 1
        self.counts.iterations += result.iterations
        self.counts.slack = max(self.counts.slack, result.slack)
        self.counts.times.append(time.perf_counter() - begin)
        self.last = result
        if RELAXED[result.relaxed] == "everything":
            return self._held(k, program)
        return result.torque

    def _program(self, phase: int) -> TaskSpaceInverseDynamics:
        if phase not in self._programs:
            about = self.reference.description
            state = RobotState(self._models[phase], about.joint_forces, about.wrenches)
            self._programs[phase] = TaskSpaceInverseDynamics.of(
                state, self.reference.actuation, self.units, damping=self.gains.contact, solver=self.solver
            )
        return self._programs[phase]

    def _held(self, k: int, program: TaskSpaceInverseDynamics) -> np.ndarray:
        """Planned torques with joint feedback, for ticks whose program has no solution."""
        reference, bandwidth = self.reference, self.gains.joint / self.units.time
        held = program.held(bandwidth, reference.q[k], reference.v[k], reference.drive_torque[k])
        return np.asarray(np.clip(held, *self._limits.torque))


def _require_robot(own: pin.Model, robot: Robot) -> None:
    """Raise `InputError` if the joints of a plan's model are not those of a robot."""
    planned, robots = (
        [(name, joint.shortname()) for name, joint in zip(model.names, model.joints, strict=True)]
        for model in (own, robot.model)
    )
    if planned != robots:
        missing = next((name for name, _ in planned if name not in robot.model.names), None)
        cause = f"it has no joint '{missing}'" if missing else "its joints have another order or other kinds"
        raise InputError(
            f"the plan is of '{own.name}', not of '{robot.name}': {cause}",
            f"allowed: a plan with the joints {', '.join(list(robot.model.names)[1:])}",
        )
