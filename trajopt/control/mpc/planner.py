"""Plan a horizon from the measured state, with a few solver steps that start from the last plan.

Each pattern of contact modes has one `Horizon`, built before it is needed. Within a mode the last plan's
variables are shifted in time on the nodes of the present mode. After a mode has ended, the variables of the
other modes move up by one, and those of the new last mode start from a motion with joints at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from trajopt import _engine
from trajopt.arguments import NonNegative, Positive, PositiveCount, checked
from trajopt.control.mpc.clock import Mode, ModeClock, Stretch
from trajopt.control.mpc.horizon import Horizon, Pattern
from trajopt.control.mpc.motion import HorizonMotion
from trajopt.control.mpc.payload import PAYLOAD, LoadedBaseDynamics
from trajopt.control.mpc.plans import FRESH, ControllerReport, SolverSettings
from trajopt.control.mpc.reference import REFERENCE, HorizonWeights, Reference, leg_terms
from trajopt.control.mpc.shifting import IterateMap, resampled
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.errors import InputError
from trajopt.robot.robot import Robot

# Shortest duration of a mode in a plan, as a fraction of a period.
SHORTEST = 0.01
# Default weight of changes of durations, for robots with point feet.
TIMING = 1.0
# Feet land this far below the ground in plans, over the robot's length, and so arrive with some velocity.
LANDING_DEPTH = 0.01
# In this fraction of a period before a touchdown its rows soften: errors can no longer be corrected.
SOFT = 0.1


@checked
@dataclass(frozen=True, kw_only=True)
class PlannerSettings:
    """Settings of a planner.

    Args:
        scheme: transcription scheme, collocation of the acceleration ("legendre:2", "radau:3").
        intervals: number of intervals in a whole period of a gait.
        span: least duration of the modes after the present one, in periods.
        solver: solver steps at each tick.
        torque_rows: whether torque limits are rows, at every point.
        timing: weight of the squared change of the present mode's duration against the gait, over
            sqrt(l / g); 0 keeps the durations of the gait. Default: `TIMING`, and 0 for robots with soles.
        weights: weights of the cost.
    """

    scheme: str = "legendre:2"
    intervals: PositiveCount = 8
    span: Positive = 0.5
    solver: SolverSettings = field(default_factory=SolverSettings)
    torque_rows: bool = True
    timing: NonNegative | None = None
    weights: HorizonWeights = field(default_factory=HorizonWeights)


class HorizonPlanner:
    """Plans motions of a legged robot with a free base.

    Args:
        robot: the robot.
        clock: clock of its contact modes, which the planner reads.
        settings: settings of the plans.
        friction: Coulomb's coefficient in the plans.

    Attributes:
        friction: Coulomb's coefficient in later plans.
        payload: `payload_numbers` (4,) in later plans.
    """

    def __init__(
        self, robot: Robot, clock: ModeClock, settings: PlannerSettings, *, friction: float = 0.7
    ) -> None:
        if robot.base != "freeflyer":
            raise InputError(f"robot '{robot.name}' has no free base", "allowed: robots on legs")
        self.robot, self.clock, self.settings, self.friction = robot, clock, settings, friction
        self.payload = np.zeros(4)
        self.horizons: dict[Pattern, Horizon] = {}
        self.report = ControllerReport()
        self._last: tuple[Horizon, _engine.Iterate] | None = None
        self._maps: dict[tuple[Pattern, Pattern], IterateMap] = {}
        self.stretch = Stretch(-1, 0.0)
        soles = any(robot.contact(name).kind == "surface" for name in clock.contacts)
        usual = 0.0 if soles else TIMING
        self.timing = usual if settings.timing is None else settings.timing

    def pattern(self, modes: Sequence[Mode], whole: Sequence[Mode]) -> Pattern:
        """The pattern of modes; the durations of the ``whole`` modes set the numbers of intervals."""
        step = self.clock.period / self.settings.intervals
        counts = tuple(max(1, round(min(mode.duration, self._span) / step)) for mode in whole)
        return Pattern(tuple(mode.contacts for mode in modes), counts)

    @property
    def _span(self) -> float:
        return self.settings.span * self.clock.period

    def prepare(self) -> int:
        """Build the horizons of all commands that may come, at any time; returns their number."""
        own, seen, waiting = self.clock, set(), [self.clock]
        while waiting:
            self.clock = waiting.pop()
            key = self.clock.state, self.clock.remaining > self._span
            if key not in seen:
                seen.add(key)
                self.horizon()
                waiting += self.clock.branches()
        self.clock = own
        return len(self.horizons)

    def horizon(self) -> tuple[Horizon, tuple[Mode, ...]]:
        """The horizon for the present state of the clock, and its modes."""
        modes = self.clock.horizon(self._span)
        whole = (Mode(modes[0].contacts, self.clock.whole), *modes[1:])
        pattern = self.pattern(modes, whole)
        if pattern not in self.horizons:
            rows, weights = self.settings.torque_rows, self.settings.weights
            terms = leg_terms(self.robot, weights, pattern.contacts, torque_rows=rows)
            self.horizons[pattern] = Horizon(
                self.robot,
                pattern,
                terms,
                friction=self.friction,
                scheme=self.settings.scheme,
                balance=LoadedBaseDynamics(),
            )
        return self.horizons[pattern], modes

    def plan(
        self,
        time: float,
        q: np.ndarray,
        v: np.ndarray,
        reference: Reference,
        last: HorizonMotion | None = None,
    ) -> HorizonMotion:
        """The motion from the state (q, v) at ``time`` s on, which must be the clock's time.

        It follows ``reference``. If the new plan is lost, ``last``, the plan in use, is returned.
        """
        horizon, modes = self.horizon()
        least = SHORTEST * self.clock.period
        durations = np.array([max(mode.duration, least) for mode in modes])
        start = horizon.layout.coordinates.node_from_pinocchio(q, self._held(horizon, q, v))
        before, horizon.durations = float(horizon.durations[0]), durations
        iterate, steps = self._start(horizon, before)
        if iterate is not None:
            node = horizon.layout.node(0)
            last_start = iterate["x"][node] * horizon.transcription.scale[node]
            start = horizon.layout.coordinates.continued(start, last_start)
        horizon.set_start(start)
        horizon.set_heights(self._landing_heights(horizon, reference, durations))
        horizon.soften_landing(durations[0] / (SOFT * self.clock.period))
        horizon.set_numbers(REFERENCE, reference.rows(horizon.point_times(REFERENCE)))
        horizon.set_numbers(PAYLOAD, np.tile(self.payload, (len(horizon.point_times(PAYLOAD)), 1)))
        horizon.set_friction(self.friction)
        horizon.set_durations(durations)
        solver = self.settings.solver
        if iterate is None:
            iterate = solver.fresh(horizon, self._gliding(horizon, start, 0))
        iterate, lost = self.report.solved(solver, horizon, iterate, steps)
        self._last = None if lost else (horizon, iterate)
        if lost and last is not None:
            return last
        if self.timing and len(durations) > 1:
            wanted = -horizon.duration_gradient(iterate["x"], iterate["y"]) / (2 * self.timing)
            self.stretch = Stretch(self.clock.number, wanted * horizon.units.time**2)
        return HorizonMotion(horizon, iterate["x"], time)

    def _held(self, horizon: Horizon, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The velocity nearest to v, in kinetic energy, at which the standing contacts do not move."""
        contacts, levers = horizon.pattern.contacts[0], horizon.transcription.problem.levers[0]
        if not contacts:
            return v
        model = self.robot.model
        places = [(c.frame, c.rows) for c in map(self.robot.contact, contacts)]
        jacobian = contact_jacobian(model, q, places, [levers.get(name) for name in contacts])
        mass = pin.crba(model, model.createData(), q)
        spread = np.linalg.solve(mass, jacobian.T)
        inverse = np.linalg.lstsq(jacobian @ spread, jacobian @ v, rcond=1e-8)[0]
        return np.asarray(v - spread @ inverse)

    def _gliding(self, horizon: Horizon, start: np.ndarray, begin: int) -> np.ndarray:
        """Scaled variables from node ``begin`` on: the base keeps its linear velocity, joints are at rest."""
        x, nv = horizon.guess() * horizon.transcription.scale, self.robot.nv
        glide = start.copy()
        glide[-nv + 3 :] = 0.0
        times = horizon.node_times
        for k in range(horizon.layout.n_stages + 1):
            node = x[horizon.layout.node(k)]
            node[:] = glide
            node[4:7] += max(times[k] - times[begin], 0.0) * glide[-nv : -nv + 3]
        x[horizon.layout.node(begin)] = start
        return np.asarray(x / horizon.transcription.scale)

    def _start(self, horizon: Horizon, before: float) -> tuple[_engine.Iterate | None, int]:
        """The last iterate mapped to this horizon, None if there is none, and the largest number of steps.

        ``before`` is the duration of the first phase when the horizon was last planned, s.
        """
        solver = self.settings.solver
        if self._last is None:
            return None, FRESH * solver.changed_steps
        last, iterate = self._last
        if last is horizon:
            after = float(horizon.durations[0])
            if after >= before:
                return iterate, solver.most_steps
            parts = np.linspace(0.0, 1.0, horizon.pattern.intervals[0] + 1)
            x = resampled(horizon, iterate["x"], before * parts, before - after + after * parts)
            return {**iterate, "x": x}, solver.most_steps
        key = last.pattern, horizon.pattern
        if key not in self._maps:
            self._maps[key] = IterateMap.of(last, horizon)
        glide = self._gliding
        return self._maps[key].apply(last, horizon, iterate, solver, glide), solver.changed_steps

    def _landing_heights(
        self, horizon: Horizon, reference: Reference, durations: np.ndarray
    ) -> list[dict[str, float]]:
        """Heights at which frames of contacts land, m, by name for each landing: just below the ground."""
        begins, depth = np.cumsum(durations), LANDING_DEPTH * self.robot.length
        return [
            {
                name: reference.landing_height(name, float(begins[phase - 1])) - depth
                for name in horizon.new_contacts(phase)
            }
            for phase, _ in horizon.landings
        ]
