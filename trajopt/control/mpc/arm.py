"""Receding-horizon control of manipulators: the tool follows a moving target, without collisions.

The target moves at constant velocity over the horizon. With the tool's position error e_p and rotation error
e_r, the running cost in natural units is

    w_p |e_p / l|^2 + w_r |e_r|^2 + w_v |q' sqrt(l / g)|^2 + w_q |q - q_ref|^2

plus costs of torques and accelerations. Limits of positions, rates and torques are rows.

Rows n . (x_i(q) - x_j(q)) >= margin keep pairs of bodies apart at all points of the horizon. The points x_i
and x_j are where the pair comes closest in the last plan, and n is the normal between them (Schulman et al.,
Int. J. Robotics Research 33, 2014, sec. V).

At a tick, torques are those of the accelerations nearest to what the feedback wants, within limits of torques
and of joints; a rate beyond its limit returns with the time constant `HORIZON`. Ticks without such
accelerations are counted as relaxed (`ControllerReport.ticks`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt import _engine
from trajopt.arguments import NonNegative, Positive, PositiveCount, checked
from trajopt.collision.description import robot_shapes
from trajopt.collision.near import CollisionScene, ShapePair
from trajopt.collision.shapes import Obstacle
from trajopt.control.inverse_dynamics import RELAXED, TaskSpaceInverseDynamics
from trajopt.control.limits import RobotLimits
from trajopt.control.mpc.follow import HORIZON
from trajopt.control.mpc.horizon import Horizon, Numbers, Pattern
from trajopt.control.mpc.motion import FollowedSample, HorizonMotion, predicted, require_state
from trajopt.control.mpc.plans import FRESH, Plans, SolverSettings
from trajopt.control.mpc.receding import RecedingHorizon
from trajopt.control.mpc.shifting import resampled
from trajopt.control.robot_state import RobotState
from trajopt.control.tasks import PostureTask
from trajopt.errors import InputError, finite_array, shown
from trajopt.robot.contact import require_frame
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.costs import AccelerationCost, TorqueCost
from trajopt.terms.interfaces import Cost, PointConstraint, Rows
from trajopt.terms.limits import PositionLimits, TorqueLimits, VelocityLimits

TARGET, NEAR = "target", "near"
# Numbers of a pair at one point: normal (3), closest point of each body in its frame (3 + 3), least distance.
PAIR = 10
# At a tick only pairs closer than this fraction of the robot's length are constrained.
WITHIN = 0.1


@checked
@dataclass(frozen=True, kw_only=True)
class ArmSettings:
    """Settings of an arm's controller.

    Args:
        period: time between plans, s.
        delay: time after which a plan is ready, s.
        span: duration of the horizon, s.
        intervals: number of intervals of the horizon.
        scheme: scheme of the transcription.
        solver: solver steps at each tick.
        live: whether a thread makes the plans, as in `ControllerSettings`.
        margin: least distance of links from each other and from obstacles, m.
        position: weight of the tool's position error.
        rotation: weight of the tool's rotation error.
        rates: weight of joint rates.
        posture: weight of the joints' distance from the reference posture.
        torque: weight of torques.
        acceleration: weight of accelerations.
        bandwidth: bandwidth of the joint feedback, 1/s.
    """

    period: Positive = 0.01
    delay: NonNegative = 0.01
    span: Positive = 0.6
    intervals: PositiveCount = 6
    scheme: str = "legendre:2"
    solver: SolverSettings = field(default_factory=SolverSettings)
    live: bool = False
    margin: NonNegative = 0.02
    position: NonNegative = 200.0
    rotation: NonNegative = 5.0
    rates: NonNegative = 0.1
    posture: NonNegative = 0.01
    torque: NonNegative = 0.01
    acceleration: NonNegative = 0.002
    bandwidth: Positive = 40.0


@dataclass(frozen=True, kw_only=True)
class ToolTarget:
    """Target of the tool, world axes.

    Args:
        position: (3,), m.
        rotation: (3, 3); None leaves the orientation free.
        velocity: (3,), m/s; None is a target at rest.
    """

    position: np.ndarray
    rotation: np.ndarray | None = None
    velocity: np.ndarray | None = None

    def __post_init__(self) -> None:
        finite_array("position of a target", self.position, unit="m")
        if self.velocity is not None:
            finite_array("velocity of a target", self.velocity, unit="m/s")
        turn = np.eye(3) if self.rotation is None else np.asarray(self.rotation, dtype=float)
        if turn.shape != (3, 3) or not np.allclose(turn.T @ turn, np.eye(3), rtol=0, atol=1e-6):
            raise InputError("rotation of a target is no rotation matrix", "allowed: (3, 3), orthonormal")


@dataclass(frozen=True, kw_only=True)
class TargetCost(Cost):
    """The module's cost of a frame; its `Numbers` are p (3,), R (9,) column by column and a factor on e_r."""

    frame: str
    settings: ArmSettings
    posture: np.ndarray

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        given, w = context.varying(Numbers(TARGET, 13), 13), self.settings
        frame, goal = context.frame(self.frame), ca.reshape(given[3:12], 3, 3)
        turn = ca.mtimes(goal.T, frame.rotation)
        twist = ca.vertcat(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]) / 2
        parts = [
            (w.position, (frame.position - given[:3]) / units.length),
            (w.rotation, given[12] * twist),
            (w.rates, context.dxi * units.time),
            (w.posture, context.xi - context.parameter(self.posture)),
        ]
        weights = context.parameter(np.concatenate([np.full(part.numel(), each) for each, part in parts]))
        return ca.sqrt(weights) * ca.vertcat(*[part for _, part in parts])

    @override
    def value(self, context: Context, units: Units) -> ca.SX:
        residual = self.residual(context, units)
        context.square(residual, ca.SX(self.weight))
        return self.weight * ca.sumsqr(residual)


@dataclass(frozen=True, kw_only=True)
class NearLinks(PointConstraint):
    """Distance rows of body pairs, see the module.

    Args:
        carriers: the frames that carry the two bodies of each pair; None for a body that does not move.
    """

    carriers: tuple[tuple[str | None, str | None], ...]

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        size = PAIR * len(self.carriers)
        given = context.varying(Numbers(NEAR, size), size)
        apart = []
        for pair, (first, second) in zip(ca.vertsplit(given, PAIR), self.carriers, strict=True):
            normal, least = pair[:3], pair[9]
            places = [
                at
                if name is None
                else context.frame(name).position + ca.mtimes(context.frame(name).rotation, at)
                for name, at in ((first, pair[3:6]), (second, pair[6:9]))
            ]
            apart.append(ca.dot(normal, places[0] - places[1]) - least)
        return Rows.create(ca.vertcat(*apart), 0.0, np.inf, units.length) if apart else None


def _tool_target(given: object) -> ToolTarget:
    if isinstance(given, pin.SE3):
        return ToolTarget(position=given.translation, rotation=given.rotation)
    if not isinstance(given, ToolTarget):
        raise InputError(f"target of the tool is {shown(given)}", "allowed: a ToolTarget, or a pinocchio.SE3")
    return given


class ArmController(RecedingHorizon):
    """Receding-horizon control of a fixed-base robot whose tool follows a target.

    Args:
        robot: a robot with a fixed base.
        tool: name of the frame that follows the target; default: the last frame of the model.
        obstacles: obstacles, placed in the world.
        settings: settings of the plans and of the feedback.

    Raises:
        InputError: if the base is not fixed, or the frame is unknown.
    """

    def __init__(
        self,
        robot: Robot,
        tool: str | None = None,
        obstacles: Sequence[Obstacle] = (),
        settings: ArmSettings | None = None,
    ) -> None:
        if robot.base != "fixed":
            raise InputError(f"robot '{robot.name}' has a {robot.base} base", "allowed: a fixed base, an arm")
        self.settings = w = settings or ArmSettings()
        super().__init__(robot, Plans(w.period, w.delay, live=w.live))
        self.tool = tool or robot.model.frames[robot.model.nframes - 1].name
        require_frame(robot.model, self.tool, "the tool")
        self.scene: CollisionScene = robot_shapes(robot).scene(robot.model, None, obstacles)
        moving = {shape.name: shape.frame for shape in self.scene.moving}
        self.pairs: tuple[ShapePair, ...] = self.scene.pairs
        frames = tuple((moving.get(a), moving.get(b)) for a, b in self.pairs)
        self._least = self._margins()
        terms = (
            TargetCost(weight=1.0, frame=self.tool, settings=w, posture=robot.reference),
            TorqueCost(weight=w.torque),
            AccelerationCost(weight=w.acceleration),
            TorqueLimits(),
            VelocityLimits(),
            PositionLimits(),
            *([NearLinks(carriers=frames)] if frames else []),
        )
        pattern = Pattern(((),), (w.intervals,))
        self.horizon = Horizon(robot, pattern, terms, scheme=w.scheme, nominal=w.span)
        self._frames = frames
        self._iterate: _engine.Iterate | None = None
        self._begin = 0.0
        self._data = robot.model.createData()
        self._limits, state = RobotLimits.of(robot, HORIZON), RobotState(robot.model, robot.joint_forces)
        units = NaturalUnits.of(robot.model)
        self._program = TaskSpaceInverseDynamics.of(state, robot.actuation, units)

    def _margins(self) -> np.ndarray:
        """Least distance (n,) of each pair, m; of two links at most that in the reference posture."""
        usual = np.full(len(self.pairs), self.settings.margin)
        own = slice(self.scene.n_outer, None)
        usual[own] = np.minimum(usual[own], self.scene.distances(self.robot.reference)[0, own])
        return usual

    def step(self, time: float, q: np.ndarray, v: np.ndarray, target: ToolTarget | pin.SE3) -> np.ndarray:
        """Torques (nu,) of the tick at ``time`` s in the measured state (nq,), (nv,).

        ``target`` may be a pose at rest. Raises `InputError`.
        """
        require_state(self.robot, time, q, v)
        target = _tool_target(target)
        motion = self.plans.motion

        def make(begin: float) -> HorizonMotion:
            state = q, v
            if motion is not None and begin > time:
                state = predicted(motion, time, begin - time, state, self.settings.bandwidth)
            return self._plan(begin, *state, target, motion)

        return self._tick(time, lambda: make, lambda wanted: self._torque(wanted, q, v))

    def _torque(self, wanted: FollowedSample, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Torques (nu,) of the accelerations within limits that are nearest to those of the feedback."""
        w, limits, program = self.settings.bandwidth, self._limits.at(q, v), self._program
        acceleration, rows = wanted.a.copy(), self.robot.actuated_rows
        acceleration += w**2 * pin.difference(self.robot.model, q, wanted.q) + 2 * w * (wanted.v - v)
        # Clipped here, too, for ticks whose program drops the limits of joints.
        acceleration[rows] = np.clip(acceleration[rows], *limits.acceleration)
        program.state.update(q, v)
        task = PostureTask(q=q, v=v, a=acceleration, bandwidth=0.0, unit=program.acceleration_unit)
        result = program.solve([], [task], limits)
        self.report.followed(result)
        if RELAXED[result.relaxed] != "everything":
            return result.torque
        return np.asarray(np.clip(program.held(w, wanted.q, wanted.v, wanted.torque), *limits.torque))

    def _plan(
        self, begin: float, q: np.ndarray, v: np.ndarray, target: ToolTarget, last: HorizonMotion | None
    ) -> HorizonMotion:
        horizon, solver = self.horizon, self.settings.solver
        horizon.set_start(horizon.layout.coordinates.node_from_pinocchio(q, v))
        horizon.set_numbers(TARGET, self._targets(target, horizon.point_times(TARGET)))
        if self.pairs:
            horizon.set_numbers(NEAR, self._near(horizon.point_times(NEAR), begin, q, last))
        horizon.set_durations(horizon.durations)
        if self._iterate is None:
            x, node = horizon.guess(), horizon.layout.node(0)
            for k in range(1, horizon.layout.n_stages + 1):
                x[horizon.layout.node(k)][: len(q)] = horizon.lower_x[node][: len(q)]
            iterate, most = solver.fresh(horizon, x), FRESH * solver.changed_steps
        else:
            old = horizon.node_times
            x = resampled(horizon, self._iterate["x"], old, old + begin - self._begin)
            iterate, most = {**self._iterate, "x": x}, solver.most_steps
        iterate, lost = self.report.solved(solver, horizon, iterate, most)
        self._iterate, self._begin = (None if lost else iterate), begin
        if lost and last is not None:
            return last
        return HorizonMotion(horizon, iterate["x"], begin)

    def _targets(self, target: ToolTarget, times: np.ndarray) -> np.ndarray:
        rows = np.zeros((len(times), 13))
        velocity = np.zeros(3) if target.velocity is None else target.velocity
        rows[:, :3] = target.position + times[:, None] * velocity
        rows[:, 3:12] = (np.eye(3) if target.rotation is None else target.rotation).T.ravel()
        rows[:, 12] = target.rotation is not None
        return rows

    def _near(self, times: np.ndarray, begin: float, q: np.ndarray, last: HorizonMotion | None) -> np.ndarray:
        """`Numbers` of all pairs (n, PAIR times pairs) at times (n,) of the next plan, from the last plan."""
        if last is None:
            configurations = np.tile(q, (len(times), 1))
        else:
            configurations = np.array([last.configuration(begin + time) for time in times])
        rows = np.zeros((len(times), len(self.pairs), PAIR))
        rows[:, :, 9] = -self.robot.length
        within = WITHIN * self.robot.length
        distances = self.scene.distances(configurations, within)
        model, data = self.robot.model, self._data
        for pair in np.flatnonzero((distances < within).any(axis=0)):
            nearest = int(distances[:, pair].argmin())
            witness = self.scene.witness(configurations[nearest], self.pairs[pair])
            pin.framesForwardKinematics(model, data, configurations[nearest])
            entry = np.append(witness.normal, np.zeros(PAIR - 3))
            entry[9] = self._least[pair]
            places = ((3, witness.first_point), (6, witness.second_point))
            for (first, place), name in zip(places, self._frames[pair], strict=True):
                frame = None if name is None else data.oMf[model.getFrameId(name)]
                entry[first : first + 3] = place if frame is None else frame.actInv(place)
            rows[:, pair] = entry
        return rows.reshape(len(times), -1)
