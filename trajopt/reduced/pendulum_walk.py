"""A walk without optimal control: footsteps, pendulum CoM motion, postures and torques.

Footsteps (`Walk`) define the supports. A quadratic program of the linear inverted pendulum gives the centre
of mass at constant height (Kajita et al., ICRA 2003; Wieber, Humanoids 2006). Inverse kinematics give the
posture at every sample, with foot swings. Inverse dynamics (`trajopt.control`) give the contact forces and
torques. The result is a plan like any other, which a whole-body controller can track.
"""

import math
from dataclasses import asdict

import numpy as np
import pinocchio as pin

from trajopt.arguments import NonNegative, Positive, PositiveCount, checked
from trajopt.control.contact_forces import ActiveContact
from trajopt.control.inverse_dynamics import TaskSpaceInverseDynamics
from trajopt.control.limits import TickLimits
from trajopt.control.robot_state import RobotState
from trajopt.control.tasks import ContactForceTask, PostureTask
from trajopt.dynamics.model_quantities import joints_of_rows
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.motion.statistics import SolveStatistics
from trajopt.problem.contact_paths import ContactPaths
from trajopt.problem.problem import Problem
from trajopt.reduced.body_guess import guess_from_lip
from trajopt.reduced.footsteps import Walk, feet_of
from trajopt.robot.kinematics import contact_poses, contact_targets, inverse_kinematics
from trajopt.robot.legs import biped_legs, require_soles
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.robot import Robot
from trajopt.solving.extraction import contact_activity, described
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.surface import UP
from trajopt.versions import VERSIONED, installed_version

# Durations of the parts of a walk over the natural time sqrt(l / g), and swing height over l.
STEP_TIME, DOUBLE_SUPPORT, SHIFT_TIME, SETTLE_TIME, CLEARANCE = 1.9, 0.45, 1.6, 1.9, 0.06
# Crouches to try, over l: straighter legs reach farther, and bend their ankles less.
CROUCHES = (0.0, -0.02, 0.02, -0.04, 0.04, 0.08)
# Intervals per natural time: standing feet then drift by less than a millimetre between samples.
INTERVALS = 12
# Step of the finite differences for velocity and acceleration, over the natural time.
DIFFERENCE = 3e-3
# Feet farther from their paths than this fraction of l are out of the legs' reach.
REACHED = 1e-3
# Largest error of the accelerations that the torques produce, in natural units, in a feasible motion.
FEASIBLE = 1e-2
# Remedy if the legs cannot follow.
SHORTER = "slower or shorter steps, or another crouch"
# Weight of the motion relative to the contact forces in their distribution.
MOTION_WEIGHT = 1e6


@checked
def commanded_walk(
    robot: Robot,
    *,
    steps: PositiveCount = 20,
    speed: float = 0.3,
    side_speed: float = 0.0,
    turn_rate: float = 0.0,
    step_time: Positive | None = None,
    double_support: Positive | None = None,
) -> Walk:
    """Return the steps of a biped that walks at a commanded velocity, from rest to rest.

    Args:
        robot: A robot on two soles.
        steps: Number of steps.
        speed: Forward velocity, m/s; negative walks backwards.
        side_speed: Velocity to the left, m/s.
        turn_rate: Rate of turning left, rad/s.
        step_time: Duration of single support, s; default 1.9 sqrt(l / g), with l the robot's reach.
        double_support: Duration of double support between steps, s; default 0.45 sqrt(l / g).

    Raises:
        InputError: If the robot does not stand on two soles, or a number is out of range.
    """
    require_soles(robot)
    left, right = biped_legs(robot)
    time = NaturalUnits.of(robot.model).time
    single = STEP_TIME * time if step_time is None else step_time
    double = DOUBLE_SUPPORT * time if double_support is None else double_support
    return Walk(
        steps=steps,
        length=speed * (single + double),
        side=side_speed * (single + double),
        turn=turn_rate * (single + double),
        step_time=single,
        double_support=double,
        shift_time=SHIFT_TIME * time,
        settle_time=SETTLE_TIME * time,
        first=right if side_speed < 0 else left,
    )


@checked
def walk_plan(
    robot: Robot,
    walk: Walk,
    *,
    crouch: float | None = None,
    clearance: NonNegative | None = None,
    friction: Positive = 0.7,
) -> Solution:
    """Return the plan of a walk of the linear inverted pendulum on level ground.

    ``success`` says whether torques and contact forces within their limits produce the motion at every
    sample. The pendulum ignores the angular momentum of the swinging legs.

    Args:
        robot: A robot on two soles.
        walk: The steps.
        crouch: Initial height of the base below its reference, m; default: the first of `CROUCHES` with
            which the legs can follow.
        clearance: Height of the swings, m; default 0.06 of the robot's reach.
        friction: Friction coefficient of the ground.

    Raises:
        InputError: If the robot does not stand on two soles, its legs do not reach the steps, or its joints
            are too slow.
    """
    require_soles(robot)
    units = NaturalUnits.of(robot.model)
    height = CLEARANCE * units.length if clearance is None else clearance
    first: _OutOfReachError | None = None
    for depth in [part * units.length for part in CROUCHES] if crouch is None else [crouch]:
        try:
            return _walk_plan(robot, walk, depth, height, friction)
        except _OutOfReachError as error:
            first = first or error
    assert first is not None
    raise InputError(str(first.args[0]), f"allowed: {first.args[1]}")


class _OutOfReachError(Exception):
    """The legs cannot follow; the arguments say what fails and what is allowed."""


def _walk_plan(robot: Robot, walk: Walk, crouch: float, clearance: float, friction: float) -> Solution:
    start = _crouched(robot, crouch)
    plan, feet = walk.plan(robot, start), feet_of(robot, start)
    problem = Problem(
        name="walk",
        robot=robot,
        schedule=plan.schedule(robot),
        terrain=FlatGround(friction=friction),
        initial_q=start,
        guess=guess_from_lip(robot, plan, q=start, clearance=clearance),
        terms=(),
        parameters={**asdict(walk), "crouch": crouch, "clearance": clearance, "friction": friction},
    )
    return _Samples(problem, plan.contact_paths(feet, clearance)).solution()


def _crouched(robot: Robot, crouch: float) -> np.ndarray:
    """Return the reference posture with the base lowered and the feet in place."""
    start = np.array(robot.reference, dtype=float)
    if not crouch:
        return start
    feet = contact_targets(robot, contact_poses(robot, start))
    start[2] -= crouch
    posture = inverse_kinematics(robot, start, feet)
    if posture.error > REACHED * robot.length:
        raise _OutOfReachError(
            f"the legs of '{robot.name}' do not bend by a crouch of {crouch:g} m", "a smaller one"
        )
    return posture.q


class _Samples:
    """Samples of a walk, phase by phase: each interval has two nodes and a midpoint."""

    def __init__(self, problem: Problem, feet: ContactPaths) -> None:
        self.problem, self.robot, self.feet = problem, problem.robot, feet
        self.units = units = NaturalUnits.of(self.robot.model)
        self.step = DIFFERENCE * units.time
        self.unit = units.acceleration(self.robot.model)
        state = RobotState(self.robot.model)
        self.dynamics = TaskSpaceInverseDynamics.of(state, self.robot.actuation, units, damping=0.0)

    def solution(self) -> Solution:
        """Return the sampled motion as a solution. Raises `_OutOfReachError`."""
        schedule = self.problem.schedule
        starts = np.cumsum([0.0, *(phase.duration for phase in schedule.phases)])
        counts = [
            max(1, math.ceil(INTERVALS * phase.duration / self.units.time)) for phase in schedule.phases
        ]
        phase = np.repeat(np.arange(len(counts)), counts)
        edges = np.concatenate(
            [
                np.column_stack([(g := np.linspace(a, b, n + 1))[:-1], g[1:]])
                for a, b, n in zip(starts[:-1], starts[1:], counts, strict=True)
            ]
        )
        t = np.column_stack([edges[:, 0], edges.mean(axis=1), edges[:, 1]]).ravel()
        rows = np.repeat(phase, 3)
        motion = [
            self._motion(float(time), starts[i], starts[i + 1]) for time, i in zip(t, rows, strict=True)
        ]
        q, v, a = (np.array(column) for column in zip(*motion, strict=True))
        v[0] = v[-1] = 0.0
        active = contact_activity(self.robot, schedule)[rows]
        tau, f, feasible = self._torques(q, v, a, active)
        return Solution(
            description=described(self.problem),
            statistics=self._statistics(feasible),
            model=self.robot.limited_model(),
            t=t,
            phase=rows,
            interval=np.repeat(np.arange(len(phase)), 3),
            collocation=np.tile([False, True, False], len(phase)),
            interval_t=edges,
            q=q,
            v=v,
            a=a,
            tau=tau,
            f=f,
            active=active,
        )

    def _motion(self, t: float, start: float, end: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return q, v and a at ``t`` by finite differences within the phase from ``start`` to ``end``."""
        guess, model, step = self.problem.guess, self.robot.model, self.step
        q = guess(t)
        self._require_reached(t, q)
        middle = min(max(t, start + step), end - step)
        centre = guess(middle)
        before, after = (pin.difference(model, centre, guess(middle + way)) for way in (-step, step))
        a = (before + after) / step**2
        v = (after - before) / (2 * step) + (t - middle) * a
        self._require_slow(t, v)
        return q, v, a

    def _torques(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, active: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        """Return torques (K, nu), contact forces (K, nc, 6), and whether they produce the whole motion."""
        robot, units = self.robot, self.units
        contacts = [self._contact(i) for i in range(len(robot.contacts))]
        tau, f = np.zeros((len(q), robot.nu)), np.zeros((len(q), len(contacts), 6))
        free = np.full(robot.nu, np.inf)
        given = robot.actuated_row_limit(robot.torque_limit)
        limit = free if given is None else given
        limits = TickLimits(torque=(-limit, limit), acceleration=(-free, free), friction=np.zeros_like(limit))
        feasible = True
        for k in range(len(q)):
            standing = [contact for contact in contacts if active[k, contact.number]]
            share = np.where(active[k], units.weight / len(standing), 0.0)
            wanted = np.zeros((len(contacts), 6))
            wanted[:, 2] = share
            tasks = (
                PostureTask(
                    weight=MOTION_WEIGHT,
                    q=q[k],
                    v=v[k],
                    a=a[k],
                    bandwidth=0.0,
                    rows_of_v=np.arange(robot.nv),
                    weights=np.ones(robot.nv),
                    unit=self.unit,
                ),
                ContactForceTask(wanted=wanted, units=self.dynamics.force_units),
            )
            self.dynamics.state.update(q[k], v[k])
            result = self.dynamics.solve(standing, tasks, limits)
            tau[k], f[k, active[k]] = result.torque, result.forces
            missed = float(np.abs((result.acceleration - a[k]) / self.unit).max())
            feasible = feasible and result.relaxed == 0 and missed <= FEASIBLE
        return tau, f, feasible

    def _contact(self, number: int) -> ActiveContact:
        contact = self.robot.contacts[number]
        return ActiveContact(
            number=number,
            frame=self.robot.model.getFrameId(contact.frame),
            dimension=6,
            normal=np.array(UP),
            friction=self.problem.terrain.friction,
            half_size=(contact.half_length, contact.half_width),
        )

    def _require_reached(self, t: float, q: np.ndarray) -> None:
        for name, pose in contact_poses(self.robot, q).items():
            away = float(np.linalg.norm(pose.translation - self.feet.pose(name, t).translation))
            if away > REACHED * self.units.length:
                robot, model = self.robot, self.robot.model
                off = f"at {t:.2f} s foot '{name}' of '{robot.name}' is {1e3 * away:.3g} mm off its path"
                ends = np.isclose(q, robot.position_lower) | np.isclose(q, robot.position_upper)
                names = [model.names[j] for j in range(2, model.njoints) if ends[model.idx_qs[j]]]
                if names:
                    off += f", with {', '.join(names)} at the end of its range"
                raise _OutOfReachError(off, SHORTER)

    def _require_slow(self, t: float, v: np.ndarray) -> None:
        rows, model, most = self.robot.actuated_rows, self.robot.model, self.robot.velocity_limit
        row = rows[np.argmax(np.abs(v[rows]) - most[rows])]
        if abs(v[row]) > most[row]:
            joint = f"joint '{joints_of_rows(model)[row]}' of '{self.robot.name}'"
            turns = f"{joint} turns at {abs(v[row]):.3g} rad/s"
            raise _OutOfReachError(f"at {t:.2f} s {turns}", f"{most[row]:.3g} rad/s; {SHORTER}")

    def _statistics(self, feasible: bool) -> SolveStatistics:
        return SolveStatistics(
            transcription="walk of the pendulum",
            solver="inverse kinematics",
            status="planned" if feasible else "beyond the limits of the robot",
            success=feasible,
            converged=feasible,
            objective=None,
            iterations=0,
            tolerance=FEASIBLE,
            wall_time_s=0.0,
            versions={name: installed_version(name) for name in VERSIONED},
        )
