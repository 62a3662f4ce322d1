"""Track a plan: its motion as tasks, its contacts as they are measured, a quadratic program a tick."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pinocchio as pin

from trajopt.arguments import NonNegative, Positive, PositiveCount, checked
from trajopt.certify.accuracy.natural_units import NaturalUnits, turning_rows
from trajopt.control.contact_forces import ActiveContact, cross
from trajopt.control.footholds import FootholdOffsets, capture_error
from trajopt.control.inverse_dynamics import RELAXED, InverseDynamics, TickLimits, TickResult
from trajopt.control.limits import JointRange, limits_with_drives, torque_limits
from trajopt.control.plan_targets import PlanTargets, base_frame, plan_targets, tracking_model
from trajopt.control.quadratic_programs import QpSolverName
from trajopt.control.recovery import Recovery
from trajopt.control.recovery_tasks import RecoveryTasks
from trajopt.control.reference import ReferenceTrajectory, moving_rows, reference_of
from trajopt.control.robot_state import RobotState
from trajopt.control.support import Support, next_narrow, support_of, thin_axes
from trajopt.control.tasks import CenterOfMassTask, ContactForceTask, FrameTask, PostureTask, Task
from trajopt.control.tick_request import TickRequest
from trajopt.dynamics.base_joint import base_of
from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt.solution.descriptions import terrain_of
from trajopt.solution.input import SolutionOrFile, require_motion, solution_of
from trajopt.solution.solution import Solution
from trajopt.terrain.surface import UP, Surface

# Joints are braked towards their limits over so many ticks.
HORIZON = 10
# A contact that is early by less than this part of its swing takes load at once.
EARLY = 1 / 3
# A stance goes on if the contact is lost for less than this part of the natural time: soft contacts chatter.
LOST = 0.05
# A foot that is late is pressed down with this part of sqrt(g l), for at most this part of l.
PRESSED, DEEPEST = 0.1, 0.1
# Feedback of the centre of mass is at most so many g: more would only leave the friction cones.
MOST_FEEDBACK = 1.0
# The robot balances on lines and points that are its support for at least so many sqrt(l / g).
LASTING = 1.0
# The pendulum over a support is at least this part of l high.
LOWEST = 0.1
# Rate of the pendulum that a flight lands on, in natural units: legs half as long as the reach.
FLYING = 2.0**0.5
# Supports narrower than this part of l balance by motion alone; rotations about them weigh this part.
THIN, TILT_PART = 1e-2, 0.03
# Surfaces whose normals differ from up by less than this are level: feet may land elsewhere on them.
LEVEL = 1e-3
# Joints weigh this part while a robot recovers: its feet are far from the posture.
RECOVERING = 0.1
# A robot that moves faster than this in natural units fell long ago: its joints are held.
TOO_FAST = 1e3


@checked
@dataclass(frozen=True, kw_only=True)
class TrackerGains:
    """Bandwidths of feedback in 1 / sqrt(l / g), l the robot's reach, and weights of tasks in natural units.

    Args:
        body: bandwidth of centre of mass and base.
        foot: of swinging feet.
        joint: of joints.
        contact: rate at which the velocity of a contact is taken out.
        com_weight: of the centre of mass, while contacts stand.
        thin_com_weight: likewise on a line or a point, in plans that are not periodic.
        base_weight: of the base's orientation, likewise.
        foot_weight: of swinging feet.
        joint_weight: of joints while contacts stand.
        leg_weight: likewise of joints that the pose of a foot in the air determines.
        force_weight: of contact forces.
        flight_joint_weight: of joints while no contact stands, in plans that are not periodic.
        balance: bandwidth on a line or a point.
        balance_joint_weight: of joints there.
        placement: how far feet land beside footholds: times the error of the capture point at touchdown.
    """

    body: NonNegative = 8.0
    foot: NonNegative = 15.0
    joint: NonNegative = 20.0
    contact: NonNegative = 20.0
    com_weight: NonNegative = 10.0
    thin_com_weight: NonNegative = 1.0
    base_weight: NonNegative = 1.0
    foot_weight: NonNegative = 1.0
    joint_weight: NonNegative = 1e-2
    leg_weight: NonNegative = 1e-4
    force_weight: NonNegative = 1e-3
    flight_joint_weight: Positive = 1.0
    balance: NonNegative = 10.0
    balance_joint_weight: NonNegative = 1e-4
    placement: NonNegative = 1.3


@dataclass
class TickCounts:
    """What happened so far: ticks, their programs by what was relaxed (see `RELAXED`), and times, s.

    slack: the largest of a `TickResult`.
    """

    ticks: int = 0
    relaxed: list[int] = field(default_factory=lambda: [0] * len(RELAXED))
    iterations: int = 0
    slack: float = 0.0
    times: list[float] = field(default_factory=list)


class Tracker:
    """A controller that tracks a plan with any robot, contacts and phases of the library.

    At each tick `torque` takes the measured state and which contacts touch, and gives torques of the drives.
    The tracker knows neither the simulator nor what happens to the robot. ``request`` is what its last tick
    asked for, ``counts`` what happened in all ticks.

    Args:
        solution: the plan, or the path of its file.
        robot: what is controlled; its joints must be those of the plan, whose model is used.
        rate: of its ticks, Hz.
        cycles: of a periodic plan.
        gains: of the feedback.
        solver: of the quadratic programs, "piqp", "proxqp" or "osqp".

    Raises:
        InputError: for a plan that cannot be sampled or is of another robot, and ticks that are longer than
            one of its phases.
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
            _require_robot(plan, robot)
        shortest = min(float(np.ptp(plan.t[list(rows)])) for rows in plan.phases)
        if rate * shortest < 1:
            raise InputError(
                f"a tick of {1 / rate:g} s is longer than a phase of {shortest:g} s",
                f"allowed: a rate of {1 / shortest:g} Hz or more",
            )
        self.plan, self.gains, self.solver = plan, gains, solver
        self.reference: ReferenceTrajectory = reference_of(plan, rate, cycles)
        self.targets: PlanTargets = plan_targets(plan, self.reference)
        self.units = NaturalUnits.of(plan.model)
        self.counts = TickCounts()
        self.last: TickResult | None = None
        self.request = TickRequest.none(len(plan.contact_frames))
        self._programs: dict[int, InverseDynamics] = {}
        self._low, self._high = torque_limits(plan)
        self._range = JointRange(plan, HORIZON * self.reference.period)
        self._frames = [plan.model.getFrameId(name) for name in plan.contact_frames]
        self._sizes = plan.meta.get("contact_sizes") or [None] * len(self._frames)
        self._touched_at = np.full(len(self._frames), -np.inf)
        self._moving = base_of(plan.model) != "fixed"
        self._base = base_frame(tracking_model(plan, 0)) if self._moving else 0
        turning = turning_rows(plan.model)
        gravity, length = self.units.gravity, self.units.length
        self._acceleration = np.where(turning, gravity / length, gravity)
        self._force = np.where(turning, self.units.weight * length, self.units.weight)
        self._offsets = FootholdOffsets(
            len(self._frames), period=self.reference.period, length=length, time=self.units.time
        )
        self._walks = bool(plan.meta.get("periodicity"))
        self._stands = self.reference.active.any(axis=0)
        self._legs = self._determined_joints()
        self._wide = np.array([self._is_wide(k) for k in range(len(self.reference.t))])
        self._balances = self._balanced_ticks()
        # In gaits feet land where they catch the centre of mass instead.
        ahead = next_narrow(self.reference.active, self._wide)
        self._next_narrow = ahead & (not self._walks)
        # Feet may land beside their footholds where the ground has no edges.
        smooth = not plan.meta.get("surfaces") and isinstance(terrain_of(plan.meta["terrain"]), Surface)
        level = np.abs(self.targets.surfaces.normal - UP).max(axis=2) < LEVEL
        self._level = np.asarray(level & smooth)
        self._recovery = Recovery(plan, self.reference, self.targets, self._level)
        self._recovering = self._recovery_tasks()

    def tick_of(self, t: float) -> int:
        """The tick at ``t`` s from the start of the plan, within its ticks."""
        return int(np.clip(round(t / self.reference.period), 0, len(self.reference.t) - 1))

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques of the drives (nu,) for the tick at ``t`` s.

        Args:
            t: since the start of the plan, s.
            q: measured configuration (nq,), Pinocchio's.
            v: measured velocity (nv,).
            touching: which contacts touch (nc,).

        Raises:
            InputError: for a state that is not finite or has another shape.
        """
        begin = time.perf_counter()
        contacts = np.asarray(touching, dtype=bool)
        k = self.tick_of(t)
        if contacts.shape != (len(self._frames),):
            raise InputError(
                f"touching has shape {contacts.shape}",
                f"allowed: ({len(self._frames)},), one for each contact",
            )
        program = self._program(int(self.reference.source[k]))
        program.state.update(q, v)
        self._recovery = self._recovery.copy()  # another tracker may go on from the one before
        step = self._recovery.step(k, t, program.state, contacts)
        active = self._active(k, contacts) if step is None else step.active
        self.request = TickRequest.none(len(self._frames))
        if np.abs(v).max() * self.units.time > TOO_FAST:
            self.counts.ticks += 1
            self.counts.relaxed[RELAXED.index("everything")] += 1
            return self._held(k, program.state)
        self._offsets = self._offsets.copy()  # another tracker may go on from the one before
        for i in np.flatnonzero(active):
            here = program.state.frame(self._frames[i]).placement.translation
            self._offsets.stand(int(i), (here - self.targets.position[k, i])[:2])
        taken = [self._contact(int(i), k) for i in np.flatnonzero(active)]
        state = program.state
        tasks = self._tasks(k, active, state) if step is None else self._recovering.of(k, step, state)
        found = program.solve(taken, tasks, self._limits(q, v))
        self.request = TickRequest.of(found.forces, taken, tasks, self.targets.com[k, 0], self._frames)
        self.counts.ticks += 1
        self.counts.relaxed[found.relaxed] += 1
        self.counts.iterations += found.iterations
        self.counts.slack = max(self.counts.slack, found.slack)
        self.counts.times.append(time.perf_counter() - begin)
        self.last = found
        if RELAXED[found.relaxed] == "everything":
            return self._held(k, program.state)
        return found.torque

    def _program(self, phase: int) -> InverseDynamics:
        if phase not in self._programs:
            self._programs[phase] = InverseDynamics(
                state=RobotState(tracking_model(self.plan, phase)),
                n_unactuated=self.plan.n_unactuated,
                acceleration_unit=self._acceleration,
                force_units=(self.units.weight, self.units.weight * self.units.length),
                torque_unit=self._force,
                damping=self.gains.contact / self.units.time,
                solver=self.solver,
            )
        return self._programs[phase]

    def _active(self, k: int, touching: np.ndarray) -> np.ndarray:
        """Contacts (nc,) that transmit forces: planned and touching, or early; held ones as planned."""
        planned, targets = self.reference.active[k], self.targets
        now = k * self.reference.period
        self._touched_at = np.where(touching, now, self._touched_at)
        lately = now - self._touched_at <= LOST * self.units.time
        swing = targets.next_stance[k] + targets.last_stance[k]
        early = touching & ~planned & (targets.next_stance[k] <= EARLY * swing)
        early &= targets.next_stance[k] < len(self.reference.t)
        held = planned & targets.surfaces.bilateral[k]
        started = planned & (k == 0)
        return np.asarray((planned & lately) | early | held | started)

    def _contact(self, i: int, k: int) -> ActiveContact:
        surfaces, size = self.targets.surfaces, self._sizes[i]
        sole = self.plan.meta["contact_kinds"][i] == "surface"
        sliding = None
        normal = surfaces.normal[k, i]
        if surfaces.slides[k, i]:
            velocity = self.targets.velocity[k, i, :3]
            along = velocity - normal * (normal @ velocity)
            speed = float(np.linalg.norm(along))
            sliding = along / speed if speed > 0 else None
        return ActiveContact(
            number=i,
            frame=self._frames[i],
            dimension=6 if sole else 3,
            normal=normal,
            friction=float(surfaces.friction[k, i]),
            half_size=(0.0, 0.0) if not size else (float(size[0]), float(size[1])),
            bilateral=bool(surfaces.bilateral[k, i]),
            sliding=sliding,
        )

    def _limits(self, q: np.ndarray, v: np.ndarray) -> TickLimits:
        rate, drives = v[self.plan.n_unactuated :], self.plan.drives
        low, high, friction = self._low, self._high, np.zeros(len(rate))
        if any(drive is not None for drive in drives):
            low, high = limits_with_drives(drives, rate, low, high)
            own = [
                0.0 if d is None else float(d.friction_torque(r)) for d, r in zip(drives, rate, strict=True)
            ]
            friction = np.array(own)
        return TickLimits(torque=(low, high), acceleration=self._range.bounds(q, rate), friction=friction)

    def _recovery_tasks(self) -> RecoveryTasks:
        gains, time = self.gains, self.units.time
        return RecoveryTasks(
            reference=self.reference,
            targets=self.targets,
            units=self.units,
            frames=self._frames,
            base=self._base,
            rows=np.arange(self.plan.n_unactuated, self.plan.model.nv),
            unit=self._acceleration,
            body=gains.body / time,
            foot=gains.foot / time,
            joint=gains.joint / time,
            weights={
                "com": gains.com_weight,
                "base": gains.base_weight,
                "foot": gains.foot_weight,
                "force": gains.force_weight,
                "joint": RECOVERING * gains.joint_weight,
            },
        )

    def _tasks(self, k: int, active: np.ndarray, state: RobotState) -> list[Task]:
        gains, units, reference = self.gains, self.units, self.reference
        planned = reference.active[k]
        first, flying = self.plan.n_unactuated, not (planned.any() and active.any())
        rotation, fixed = units.gravity / units.length, not self._moving
        rows = np.arange(first, self.plan.model.nv)
        support = None if flying or fixed else self._support(k, active | planned, state)
        tilting = support.lines if support and self._balances[k] else np.zeros((0, 3))
        tasks: list[Task] = [
            PostureTask(
                q=reference.q[k],
                v=reference.v[k],
                a=reference.a[k],
                bandwidth=gains.joint / units.time,
                rows_of_v=rows,
                weights=self._joint_weights(active, flying, balances=bool(len(tilting))),
                unit=self._acceleration[rows],
            )
        ]
        if active.any():
            tasks.append(
                ContactForceTask(
                    weight=gains.force_weight,
                    wanted=reference.f[k],
                    units=(units.weight, units.weight * units.length),
                )
            )
        if fixed:
            return tasks
        if support:
            tasks.append(self._balance(k, support, state))
            tasks.append(
                FrameTask(
                    weight=gains.base_weight,
                    frame=self._base,
                    pose=pin.SE3(self.targets.base_rotation[k], np.zeros(3)),
                    velocity=self.targets.base_velocity[k],
                    acceleration=self.targets.base_acceleration[k],
                    bandwidth=gains.body / units.time,
                    selection=np.hstack([np.zeros((3, 3)), _without(tilting)]),
                    units=(units.gravity, rotation),
                )
            )
        tasks += [self._swing(int(i), k, support, state) for i in np.flatnonzero(self._stands & ~active)]
        return tasks

    def _joint_weights(self, active: np.ndarray, flying: bool, balances: bool) -> np.ndarray:
        """Weights (nu,) of the planned posture.

        Joints that the pose of a foot in the air determines would only hold it back: where the base is off
        the plan, posture and foot are at odds.
        """
        gains, legs = self.gains, self._legs
        size = legs.shape[1]
        if not self._moving:
            return np.ones(size)
        if balances:
            return np.full(size, gains.balance_joint_weight)
        if flying and not self._walks:
            return np.full(size, gains.flight_joint_weight)
        swinging = legs[self._stands & ~active].any(axis=0)
        return np.where(swinging, gains.leg_weight, gains.joint_weight)

    def _support(self, k: int, standing: np.ndarray, state: RobotState) -> Support:
        """What the robot stands on; narrow only where the plan is too, not where a foot is late."""
        picked = np.flatnonzero(standing)
        places = np.array([state.frame(self._frames[i]).placement.translation for i in picked])
        return support_of(
            places,
            self.targets.position[k, picked],
            np.zeros((0, 3)) if self._wide[k] else thin_axes(places, THIN * self.units.length),
            state.centre_of_mass()[0],
            self.units.gravity,
            LOWEST * self.units.length,
        )

    def _determined_joints(self) -> np.ndarray:
        """Joints (nc, nu) of legs that have no more than the pose of their foot has components."""
        first = self.plan.n_unactuated
        found = np.zeros((len(self._frames), self.plan.model.nv - first), dtype=bool)
        for i in np.flatnonzero(self._stands):
            rows = sorted(moving_rows(self.plan.model, self.plan.contact_frames[i]))
            own = [row - first for row in rows if row >= first]
            found[i, own] = len(own) <= (6 if self.plan.meta["contact_kinds"][i] == "surface" else 3)
        return found

    def _balanced_ticks(self) -> np.ndarray:
        """Ticks (n,) of stances on one line or point that last: shorter ones follow the plan as it is."""
        active = self.reference.active
        found = np.zeros(len(active), dtype=bool)
        if self._walks or self._wide[active.any(axis=1)].any():
            return found  # the next steps, or a wider support, balance the robot
        changes = np.flatnonzero((active[1:] != active[:-1]).any(axis=1)) + 1
        for begin, end in pairwise([0, *changes.tolist(), len(active)]):
            lasts = (end - begin) * self.reference.period >= LASTING * self.units.time
            found[begin:end] = lasts and bool(active[begin].any()) and not self._wide[begin]
        return found

    def _is_wide(self, k: int) -> bool:
        """Whether the planned contacts of a tick hold the body in all directions: a sole, or no line."""
        picked = np.flatnonzero(self.reference.active[k])
        kinds = [self.plan.meta["contact_kinds"][i] for i in picked]
        if "surface" in kinds or self.targets.surfaces.bilateral[k, picked].any():
            return True
        return len(picked) > 2 and not len(
            thin_axes(self.targets.position[k, picked], THIN * self.units.length)
        )

    def _balance(self, k: int, support: Support, state: RobotState) -> CenterOfMassTask:
        """The centre of mass follows the plan, as far as its support lets it.

        In directions in which that has no extent, and which last, so does the angular momentum. Of a
        support p without extent along u only gravity changes the angular momentum L about its line, whose
        level part is z x u: dL = m g (c - p) u. A triple pole of that chain of integrators (Azad and
        Featherstone, IEEE Trans. Robotics 32, 2016) gives with e for errors and w the bandwidth
            dd c = dd c_d - 3 w de - 3 w^2 e - w^3 e_L / (m g)
        Where they do not last it falls as the pendulum does, until the next feet stand. Before that, while
        the robot still stands wide, it follows the feet that will hold it: from where they are off the plan
        it would be thrown off.
        """
        gains, units, targets = self.gains, self.units, self.targets
        w, tilt = gains.body / units.time, gains.balance / units.time
        position, velocity, _, _ = state.centre_of_mass()
        wanted, rate, acceleration = targets.com[k]
        error, change = position - wanted, velocity - rate
        if self._next_narrow[k].any():
            error -= self._support(k, self._next_narrow[k], state).offset
        feedback = -2 * w * change - w**2 * error
        across = support.axes.T @ support.axes
        if len(support.axes) and self._balances[k]:
            mass = units.weight / units.gravity
            here, planned = support.places.mean(axis=0), support.planned.mean(axis=0)
            own = state.angular_momentum()[0] + mass * cross(position - here, velocity)
            asked = targets.momentum[k] + mass * cross(wanted - planned, rate)
            turned = support.axes.T @ (support.lines @ (own - asked)) / units.weight
            poles = 3 * tilt * change + 3 * tilt**2 * (error - support.offset)
            feedback -= across @ (poles + feedback) + tilt**3 * turned
        elif len(support.axes):
            feedback += across @ (support.falling(error) - feedback)
            feedback = support.reachable(position, acceleration + feedback) - acceleration
        most = MOST_FEEDBACK * units.gravity
        feedback *= min(1.0, most / max(float(np.linalg.norm(feedback)), most))
        return CenterOfMassTask(
            weight=gains.thin_com_weight if len(support.axes) and not self._walks else gains.com_weight,
            position=position,
            velocity=velocity,
            acceleration=acceleration + feedback,
            bandwidth=0.0,
            unit=units.gravity,
        )

    def _swing(self, i: int, k: int, support: Support | None, state: RobotState) -> FrameTask:
        """A contact in the air follows the plan; one that is late is pressed down along its normal."""
        targets, units = self.targets, self.units
        position, velocity = targets.position[k, i].copy(), targets.velocity[k, i].copy()
        acceleration = targets.acceleration[k, i].copy()
        normal = targets.surfaces.normal[k, i]
        if self.reference.active[k, i]:
            late = float(k * self.reference.period - max(self._touched_at[i], self._start_of(i, k)))
            speed = PRESSED * np.sqrt(units.gravity * units.length)
            position -= normal * min(speed * late, DEEPEST * units.length)
            velocity[:3] -= normal * speed
        if self.gains.placement and self._level[k, i]:
            acceleration[:2] += self._beside(i, k, support, state)
            position[:2] += self._offsets.offset[i]
            velocity[:2] += self._offsets.rate[i]
        sole = self.plan.meta["contact_kinds"][i] == "surface"
        return FrameTask(
            weight=self.gains.foot_weight,
            frame=self._frames[i],
            pose=pin.SE3(targets.rotation[k, i], position),
            velocity=velocity,
            acceleration=acceleration,
            bandwidth=self.gains.foot / units.time,
            selection=np.eye(6)[: 6 if sole else 3],
            units=(units.gravity, units.gravity / units.length),
        )

    def _start_of(self, i: int, k: int) -> float:
        """Time since when contact ``i`` should stand at tick ``k``, s."""
        before = np.flatnonzero(~self.reference.active[:k, i])
        return (before[-1] + 1) * self.reference.period if len(before) else 0.0

    def _beside(self, i: int, k: int, support: Support | None, state: RobotState) -> np.ndarray:
        """Move a foot on beside its planned motion; returns the acceleration (2,) of its offset, m/s^2."""
        position, velocity, _, _ = state.centre_of_mass()
        error, change = position - self.targets.com[k, 0], velocity - self.targets.com[k, 1]
        left = float(self.targets.next_stance[k, i]) * self.reference.period
        capture = capture_error(error, change, support, left, FLYING / self.units.time)
        return self._offsets.swing(i, error, self.gains.placement * capture, left)

    def _held(self, k: int, state: RobotState) -> np.ndarray:
        """Planned torques with feedback of single joints: where no program has a solution."""
        first, w = self.plan.n_unactuated, self.gains.joint / self.units.time
        inertia = np.diagonal(state.mass)[first:]
        error = pin.difference(state.model, state.q, self.reference.q[k])[first:]
        rate = (self.reference.v[k] - state.v)[first:]
        wanted = self.reference.torque[k] + inertia * (w**2 * error + 2 * w * rate)
        return np.asarray(np.clip(wanted, self._low, self._high))


def _require_robot(plan: Solution, robot: Robot) -> None:
    """Raise `InputError` if the joints of a plan are not those of a robot."""
    planned, own = (
        [(name, joint.shortname()) for name, joint in zip(model.names, model.joints, strict=True)]
        for model in (plan.model, robot.model)
    )
    if planned != own:
        missing = next((name for name, _ in planned if name not in robot.model.names), None)
        cause = f"it has no joint '{missing}'" if missing else "its joints have another order or other kinds"
        raise InputError(
            f"the plan is of '{plan.model.name}', not of '{robot.name}': {cause}",
            f"allowed: a plan with the joints {', '.join(list(robot.model.names)[1:])}",
        )


def _without(axes: np.ndarray) -> np.ndarray:
    """Rows (3, 3) of rotations without those about some orthogonal axes (r, 3), but for a small part."""
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    return np.asarray(np.eye(3) - (1.0 - TILT_PART) * axes.T @ axes)
