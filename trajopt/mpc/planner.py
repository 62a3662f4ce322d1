"""Plans a horizon at each of its ticks: from the measured state, with a few steps from the last plan.

Each pattern of contact modes has one `Horizon`, made before it is needed. The variables of the last plan are
moved on by the time that has passed, on the nodes of the present mode; where a mode has ended, those of the
others move up by one, and the mode that is new at the end stands still at first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from trajopt import _engine
from trajopt.arguments import NonNegative, Positive, PositiveCount, checked
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.errors import InputError
from trajopt.mpc.clock import Mode, ModeClock, Stretch
from trajopt.mpc.horizon import Horizon, Pattern
from trajopt.mpc.motion import HorizonMotion
from trajopt.mpc.payload import PAYLOAD, LoadedBaseDynamics
from trajopt.mpc.plans import FRESH, ControllerReport, SolverSettings
from trajopt.mpc.reference import REFERENCE, HorizonWeights, Reference, leg_terms
from trajopt.mpc.shifting import IterateMap, resampled
from trajopt.robot.robot import Robot

# A mode that lasts less than this part of a period is planned as if it lasted that long.
SHORTEST = 0.01
# Weight of changes of durations, of point feet.
TIMING = 1.0
# Feet land at this part of the robot's length below the ground: they arrive with some velocity.
SUNK = 0.01
# In this part of a period before a touchdown its rows become softer: what is left cannot be braked.
SOFT = 0.1


@checked
@dataclass(frozen=True, kw_only=True)
class PlannerSettings:
    """Settings of a planner.

    Args:
        scheme: of the transcription, collocation of the acceleration ("legendre:2", "radau:3").
        intervals: of a whole period of a gait.
        span: the least length of what follows the present mode, in periods.
        solver: its steps at each tick.
        torque_rows: limits of torques are rows, at every point.
        timing: weight of the square of what the present mode lasts longer than the gait says, over
            sqrt(l / g), in the cost; 0: durations are those of the gait. Default: `TIMING`, on soles 0.
        weights: of the cost.
    """

    scheme: str = "legendre:2"
    intervals: PositiveCount = 8
    span: Positive = 0.5
    solver: SolverSettings = field(default_factory=SolverSettings)
    torque_rows: bool = True
    timing: NonNegative | None = None
    weights: HorizonWeights = field(default_factory=HorizonWeights)


class HorizonPlanner:
    """Plans motions of a robot on legs with a free base.

    Args:
        robot: the robot.
        clock: of its gaits; the planner reads it.
        settings: of the plans.
        friction: Coulomb's coefficient that plans count on.

    Attributes:
        friction: as given; the next plan takes it as it is then.
        payload: numbers (4,) of what the base carries, likewise.
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
        """Contacts and intervals of modes; ``whole``: those of the gait, not what remains of them."""
        step = self.clock.period / self.settings.intervals
        counts = tuple(max(1, round(min(mode.duration, self._span) / step)) for mode in whole)
        return Pattern(tuple(mode.contacts for mode in modes), counts)

    @property
    def _span(self) -> float:
        return self.settings.span * self.clock.period

    def prepare(self) -> int:
        """Make the horizons of all that may be asked for, whenever; returns their number."""
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
        """The horizon of the clock as it is now, and its modes."""
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
        """The motion from a state at ``time`` s on; the clock is at that time.

        reference: what it follows. last: the plan in use, for where this one fails.
        """
        horizon, modes = self.horizon()
        least = SHORTEST * self.clock.period
        durations = np.array([max(mode.duration, least) for mode in modes])
        start = horizon.layout.coordinates.node_from_pinocchio(q, self._held(horizon, q, v))
        before, horizon.durations = float(horizon.durations[0]), durations
        iterate, steps = self._start(horizon, before)
        if iterate is not None:
            quaternion = iterate["x"][:4]
            start[:4] *= 1.0 if start[:4] @ quaternion >= 0 else -1.0
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
        """The velocity nearest to v, by kinetic energy, with which the contacts that stand do not move."""
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
        """Scaled variables that go on from node ``begin`` at the base's velocity, with joints at rest."""
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
        """The last iterate moved on to this horizon, if there is one, and how many steps to take at most.

        before: duration of the first phase when the horizon was last planned, s.
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
        """Heights at which frames of contacts land, m, by name: a little below the ground."""
        begins, sunk = np.cumsum(durations), SUNK * self.robot.length
        return [
            {
                name: reference.landing_height(name, float(begins[phase - 1])) - sunk
                for name in horizon.new_contacts(phase)
            }
            for phase, _ in horizon.landings
        ]
