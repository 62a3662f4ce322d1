"""Rows that keep bodies apart at all times: added where a motion breaks them, until it does not.

A robot's links make hundreds of pairs that could meet, and hardly any of them does. So a motion is solved
without them and looked at along all of it, between points too; pairs that come too near get rows (see
`trajopt.robot.collision.planes`) at the moments where they are near, and it is solved again from there, until
it is clear. This is the exchange method for semi-infinite programs (Blankenship and Falk, "Infinitely
constrained optimization problems", 1976). No pair enters that never matters.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from trajopt.problem.bodies import TOO_NEAR, ProblemBodies, bodies_of
from trajopt.problem.problem import Problem
from trajopt.robot.collision.near import ShapePair
from trajopt.robot.collision.planes import SeparatingPlane
from trajopt.robot.units import Units
from trajopt.solution.interpolation import collocation_fractions, interval_interpolant
from trajopt.solution.motion import SolutionMotion
from trajopt.solution.solution import Solution
from trajopt.terms.moments import PlaneSide

# Pairs that are too near somewhere get rows wherever they are nearer than their margin plus this part of the
# robot's length: a motion that gives way there may come near here.
BAND = 0.06
# Between its nodes an interval is looked at this many times, evenly, and at its points; more often where a
# coordinate changes by more than this from look to look, in natural units (rad, lengths of the robot).
LOOKS, LOOK_STEP = 5, 0.03

# Phase, fraction of its duration; and a motion over these.
Moment = tuple[int, float]
PhaseMotion = Callable[[int, float], np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """Distances (K, n_pairs) m along a motion at K moments; ``regular`` (K,) are its nodes and points."""

    distances: np.ndarray
    moments: tuple[Moment, ...]
    regular: np.ndarray


@dataclass
class Exchange:
    """Which pairs of bodies have rows, when, and for which corners: they grow from look to look."""

    problem: Problem
    moments: defaultdict[ShapePair, set[Moment]] = field(default_factory=lambda: defaultdict(set))
    corners: dict[tuple[ShapePair, Moment, str | None, str | None], np.ndarray] = field(default_factory=dict)

    @cached_property
    def bodies(self) -> ProblemBodies:
        """Bodies of the problem. Raises `InputError` where its start has them in each other."""
        return bodies_of(self.problem)

    @property
    def band(self) -> float:
        """Distance beyond its margin within which a pair has rows, m."""
        return BAND * self.problem.robot.length

    @property
    def outer_pairs(self) -> tuple[ShapePair, ...]:
        """Pairs with obstacles."""
        return self.bodies.pairs[self.bodies.scene.n_ground : self.bodies.scene.n_outer]

    def look(self, solution: Solution) -> Look:
        """Distances of all pairs along a solution, exact where they are within the band."""
        plan = solution.normalized()
        units = Units(self.problem.robot).position
        seen = [_seen(plan, number, units) for number in range(plan.n_intervals)]
        q = np.concatenate([configurations for configurations, _, _ in seen])
        return Look(
            distances=self.bodies.scene.distances(q, self.band + self.bodies.widest),
            moments=tuple(moment for _, moments, _ in seen for moment in moments),
            regular=np.concatenate([regular for _, _, regular in seen]),
        )

    def missing(self, look: Look) -> tuple[ShapePair, ...]:
        """Pairs that are too near somewhere."""
        short = (look.distances - self.bodies.margins).min(axis=0, initial=np.inf)
        return tuple(pair for pair, own in zip(self.bodies.pairs, short, strict=True) if own < -TOO_NEAR)

    def add(self, look: Look) -> bool:
        """Add the moments where pairs that are, or were, too near are near; whether there are new ones."""
        before = sum(map(len, self.moments.values()))
        wanted = {*self.missing(look), *self.moments}
        short = look.distances - self.bodies.margins
        for column, pair in enumerate(self.bodies.pairs):
            if pair in wanted:
                own = short[:, column]
                near = (own < self.band) & look.regular | (own < -TOO_NEAR) & _least_around(own)
                self.moments[pair] |= {look.moments[row] for row in np.flatnonzero(near)}
        return sum(map(len, self.moments.values())) > before

    def constrained(self, motion: PhaseMotion) -> Problem:
        """The problem with rows at all moments so far, their planes laid along a motion.

        Args:
            motion: phase, fraction of its duration -> configuration (nq,), as `along` or `guess` give it.
        """
        groups: defaultdict[tuple[int, str | None, str | None], list[tuple[float, SeparatingPlane]]]
        groups = defaultdict(list)
        for (phase, fraction), plane in self._laid(motion):
            groups[phase, plane.frame, plane.body].append((fraction, plane))
        terms = [
            PlaneSide(
                phase=self.problem.schedule.names[phase],
                frame=frame,
                body=body,
                fractions=np.repeat([f for f, _ in own], [len(plane.corners) for _, plane in own]),
                parameters=np.concatenate([plane.parameters for _, plane in own]),
            )
            for (phase, frame, body), own in groups.items()
        ]
        return replace(self.problem, terms=(*self.problem.terms, *terms))

    def guess(self, phase: int, fraction: float) -> np.ndarray:
        """The problem's guess (nq,) at a fraction of a phase."""
        durations = [entry.duration for entry in self.problem.schedule.phases]
        return self.problem.guess_at(sum(durations[:phase]) + fraction * durations[phase])

    def guess_is_clear(self) -> bool:
        """Whether pairs are apart along the guess wherever they have rows."""
        every = sorted({moment for moments in self.moments.values() for moment in moments})
        if not every:
            return True
        q = np.array([self.guess(*moment) for moment in every])
        short = self.bodies.scene.distances(q, self.band + self.bodies.widest) - self.bodies.margins
        columns = [column for column, pair in enumerate(self.bodies.pairs) if pair in self.moments]
        return bool((short[:, columns] >= -TOO_NEAR).all())

    def _laid(self, motion: PhaseMotion) -> Iterator[tuple[Moment, SeparatingPlane]]:
        every = sorted({moment for moments in self.moments.values() for moment in moments})
        if not every:
            return
        numbers = {moment: k for k, moment in enumerate(every)}
        q = np.array([motion(*moment) for moment in every])
        pairs = [(pair, moment) for pair, moments in self.moments.items() for moment in sorted(moments)]
        wanted = [(numbers[moment], pair) for pair, moment in pairs]
        for (pair, moment), planes in zip(pairs, self.bodies.planes(q, wanted, self.band), strict=True):
            for plane in planes:
                key = (pair, moment, plane.frame, plane.body)
                kept = plane.with_corners(self.corners.get(key, plane.corners))
                self.corners[key] = kept.corners
                yield moment, kept


def along(solution: Solution) -> PhaseMotion:
    """The motion of a solution by phase and fraction."""
    motion = SolutionMotion(solution)
    return lambda phase, fraction: motion.in_phase(phase, fraction, 0.5).q


def _seen(plan: Solution, number: int, units: np.ndarray) -> tuple[np.ndarray, list[Moment], np.ndarray]:
    """Configurations (k, nq) in an interval, their moments, and which of them are its nodes and points.

    Its end is the start of the next one, where that is looked at; only the last has an end of its own.
    """
    _, points = collocation_fractions(plan, number)
    regular = np.unique(np.round([0.0, *points, 1.0], 12))
    own = plan.interval_t[number]
    travel = (own[1] - own[0]) * float((np.abs(plan.v[plan.intervals[number]]) / units).max())
    looks = max(LOOKS, math.ceil(travel / LOOK_STEP))
    fractions = np.unique(np.round(np.concatenate([regular, np.linspace(0.0, 1.0, looks + 2)]), 12))
    if number < plan.n_intervals - 1:
        fractions = fractions[fractions < 1.0]
    phase = int(plan.phase[plan.intervals[number].start])
    start, end = plan.interval_t[plan.intervals_of(phase)][[0, -1], [0, 1]]
    times = own[0] + fractions * (own[1] - own[0])
    shares = np.clip((times - start) / (end - start), 0.0, 1.0)
    moments = [(phase, round(float(share), 12)) for share in shares]
    return interval_interpolant(plan, number).at(fractions).q, moments, np.isin(fractions, regular)


def _least_around(values: np.ndarray) -> np.ndarray:
    """Which of the values (K,) are not above their neighbours."""
    padded = np.concatenate([[np.inf], values, [np.inf]])
    return np.asarray((values <= padded[:-2]) & (values <= padded[2:]))
