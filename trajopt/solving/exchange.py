"""Rows that keep bodies apart at all times: added where a motion breaks them, until it does not.

A robot's links make hundreds of pairs that could meet, and hardly any of them does. So a motion is solved
without them and looked at along all of it, between points too; pairs that come too near get rows (see
`trajopt.collision.planes`) at the moments where they are near, and it is solved again from there, until
it is clear. This is the exchange method for semi-infinite programs (Blankenship and Falk, "Infinitely
constrained optimization problems", 1976). No pair enters that never matters.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt.certify.report import PENETRATION
from trajopt.collision.joint_distance import JointDistances
from trajopt.collision.near import ShapePair
from trajopt.collision.planes import PlacedBody, SeparatingPlane
from trajopt.motion.configurations import SolutionMotion
from trajopt.problem.bodies import TOO_NEAR, ProblemBodies, bodies_of, contacts_by_shape
from trajopt.problem.problem import Problem
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_poses
from trajopt.robot.units import Units
from trajopt.solution.interpolation import collocation_fractions
from trajopt.solution.solution import Solution
from trajopt.terms.moments import LinkDistance, MomentConstraint, PlaneSide, joint_row, plane_row

# Pairs that are too near somewhere get rows wherever they are nearer than their margin plus a multiple of
# what they lacked at most, within these parts of the length: a motion that gives way there may come near
# here.
REACH, LEAST_BAND, BAND = 4.0, 0.005, 0.04
# Rows are met to this, m.
LEAST_SLACK = 2e-5
# Between its nodes an interval is looked at this many times, evenly, and at its points; more often where a
# coordinate changes by more than this from look to look, in natural units (rad, lengths of the robot).
LOOKS, LOOK_STEP = 5, 0.03
# After so many looks in which a pair with rows is too near its distance is no longer fitted, and it gets rows
# wherever it is too near instead of where it is nearest: a motion slips through between them.
MOST_MISSES, MOST_SLIPS = 3, 4
# Moments that agree to this many digits are the same.
DIGITS = 12

# Phase, fraction of its duration; and a motion (K, nq) over K of these.
PhaseMoment = tuple[int, float]
PhaseMotion = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """Distances (K, n_pairs) m along a motion at K moments; ``regular`` (K,) are its nodes and points."""

    distances: np.ndarray
    moments: tuple[PhaseMoment, ...]
    regular: np.ndarray


@dataclass
class Exchange:
    """Which pairs of bodies have rows, when, and for which corners: they grow from look to look.

    lacking: by how much each of them came nearer than its margin at most, m.

    Raises `InputError` for a problem whose bodies are in each other at its start or at a goal.
    """

    problem: Problem
    moments: defaultdict[ShapePair, set[PhaseMoment]] = field(default_factory=lambda: defaultdict(set))
    corners: dict[tuple[ShapePair, PhaseMoment, str | None, str | None], np.ndarray] = field(
        default_factory=dict
    )
    lacking: defaultdict[ShapePair, float] = field(default_factory=lambda: defaultdict(float))
    misses: defaultdict[ShapePair, int] = field(default_factory=lambda: defaultdict(int))
    beyond_feet: bool = False

    def __post_init__(self) -> None:
        self.bodies: ProblemBodies = bodies_of(self.problem)
        self.fits = JointDistances(self.bodies.scene)

    @property
    def band(self) -> float:
        """Largest distance beyond its margin within which a pair has rows, m."""
        return BAND * self.problem.robot.length

    @cached_property
    def _least(self) -> np.ndarray:
        """Least distance (n_pairs,) m at which a pair is not too near: rows keep margins to `TOO_NEAR`.

        Feet that stand in the ground may not get deeper than the check allows.
        """
        margins = self.bodies.margins
        return np.minimum(np.maximum(margins - TOO_NEAR, -PENETRATION), margins - LEAST_SLACK)

    def moved_to(self, problem: Problem) -> Exchange:
        """The same pairs, moments and corners of links for a problem with other parameters."""
        made = Exchange(problem, beyond_feet=self.beyond_feet)
        known = set(made.bodies.pairs)
        made.moments.update({pair: set(moments) for pair, moments in self.moments.items() if pair in known})
        made.corners |= {
            (pair, moment, frame, body): corners
            for (pair, moment, frame, body), corners in self.corners.items()
            if pair in known and frame is not None
        }
        return made

    def look(self, solution: Solution, times: Sequence[float] = ()) -> Look:
        """Distances of all pairs along a solution, and at ``times`` s, exact where they are within the band.

        Those of a foot from the ground that its active contact touches count as infinite: the contact holds
        it there, and rows beside the contact's own would depend on them.
        """
        plan = solution.normalized()
        units = Units(self.problem.robot).position
        numbers, fractions, regular = _moments_to_look_at(plan, units, times)
        q = plan.polynomials.at(numbers, fractions).q
        distances = self.bodies.scene.distances(q, self.band + self.bodies.widest)
        moments = _in_phases(plan, numbers, fractions)
        standing = self._standing[[phase for phase, _ in moments]]
        return Look(distances=np.where(standing, np.inf, distances), moments=moments, regular=regular)

    def missing(self, look: Look) -> tuple[ShapePair, ...]:
        """Pairs that are too near somewhere."""
        short = (look.distances - self._least).min(axis=0, initial=np.inf)
        return tuple(pair for pair, distance in zip(self.bodies.pairs, short, strict=True) if distance < 0)

    def depth(self, look: Look) -> float:
        """By how much the worst pair is too near, m; zero if none is."""
        return float((self._least - look.distances).max(initial=0.0))

    def sideless_depth(self, look: Look, known: bool) -> float:
        """As `depth`, of pairs whose bodies may pass each other on several sides.

        They are not with the ground, nor links whose distance is fitted. known: also those that have rows.
        """
        n, pairs = self.bodies.scene.n_ground, self.bodies.pairs
        sided = [
            k for k, p in enumerate(pairs[n:], n) if (known or p not in self.moments) and not self._fitted(p)
        ]
        return float((self._least - look.distances)[:, sided].max(initial=0.0))

    def add(self, look: Look, kept: Sequence[ShapePair] = ()) -> bool:
        """Add the moments where pairs that are, or were, too near are near; whether there are new ones.

        kept: pairs that get rows where they are near, too.
        """
        before, length = sum(map(len, self.moments.values())), self.problem.robot.length
        missing = self.missing(look)
        wanted = {*missing, *self.moments, *kept}
        short = look.distances - self.bodies.margins
        for column, pair in enumerate(self.bodies.pairs):
            if pair in wanted:
                self.misses[pair] += pair in self.moments and pair in missing
                distances = short[:, column]
                missed = look.distances[:, column] < self._least[column]
                self.lacking[pair] = max(self.lacking[pair], -float(distances.min()))
                band = np.clip(REACH * self.lacking[pair], LEAST_BAND * length, self.band)
                deepest = missed if self.misses[pair] > MOST_SLIPS else missed & _least_around(distances)
                near = (distances < band) & look.regular | deepest
                if near.any():
                    self.moments[pair] |= {look.moments[row] for row in np.flatnonzero(near)}
        return sum(map(len, self.moments.values())) > before

    def take_up(self, solution: Solution) -> None:
        """Give rows to the pairs that had some in a solution of such a problem, where they are near there."""
        known = set(solution.statistics.row_names)
        held = [pair for pair in self.bodies.pairs if known & self._row_names(pair)]
        if held:
            self.add(self.look(solution), held)

    def _row_names(self, pair: ShapePair) -> set[str]:
        model = self.problem.robot.model
        frames = {shape.name: shape.frame for shape in self.bodies.scene.shapes}
        one, other = (frames.get(name) for name in pair)
        joints = tuple(model.names[joint] for joint in self.fits.joints(pair))
        return {plane_row(one, other), plane_row(other, one)} | ({joint_row(joints)} if joints else set())

    def constrained(self, motion: PhaseMotion, last: PhaseMotion | None = None) -> Problem:
        """The problem with rows at all moments so far, their planes laid along a motion.

        Args:
            motion: phases, fractions (K,) -> configurations (K, nq), as `along` or `guess` give it.
            last: the motion that was too near, if that is another: its nearest corners get rows, too.
        """
        if last is not None:
            for _ in self._laid(last):
                pass
        groups: defaultdict[tuple[int, str | None, str | None], list[tuple[float, SeparatingPlane]]]
        groups = defaultdict(list)
        for (phase, fraction), plane in self._laid(motion):
            groups[phase, plane.frame, plane.body].append((fraction, plane))
        terms: list[MomentConstraint] = [
            PlaneSide(
                during=self.problem.schedule.names[phase],
                frame=frame,
                body=body,
                fractions=np.repeat([f for f, _ in members], [len(plane.corners) for _, plane in members]),
                parameters=np.concatenate([plane.parameters for _, plane in members]),
            )
            for (phase, frame, body), members in groups.items()
        ]
        return replace(self.problem, terms=(*self.problem.terms, *terms, *self._distances(motion)))

    def _distances(self, motion: PhaseMotion) -> Iterator[LinkDistance]:
        """Rows of the links whose distances are fitted, around a motion."""
        model, names = self.problem.robot.model, self.problem.schedule.names
        for pair in filter(self._fitted, self.moments):
            moments = sorted(self.moments[pair])
            phases, fractions = (np.array(each) for each in zip(*moments, strict=True))
            rows = self.fits.rows(pair, motion(phases, fractions), self.bodies.margin_of[pair])
            for phase in np.unique(phases):
                yield LinkDistance(
                    during=names[phase],
                    joints=tuple(model.names[joint] for joint in self.fits.joints(pair)),
                    fractions=fractions[phases == phase],
                    parameters=rows[phases == phase],
                )

    def _fitted(self, pair: ShapePair) -> bool:
        """Whether a pair's distance is a polynomial, which is no bound: not where that does not help."""
        return self.misses[pair] < MOST_MISSES and bool(self.fits.joints(pair))

    def starts(
        self, solution: Solution, guess_first: bool = False
    ) -> Iterator[tuple[Problem, Solution | None]]:
        """Problems with rows, and from where to solve them: the last motion, then the guess, or in turn.

        Then the same with planes beyond feet, and from then on only those: see `planes.beyond_foot`.
        """
        if not self.moments:
            yield from ((self.problem, solution), (self.problem, None))
            return
        last = along(solution)
        for beyond_feet in (True,) if self.beyond_feet else (False, True):
            self.beyond_feet = beyond_feet
            for from_guess in (guess_first, not guess_first):
                if from_guess:
                    yield self.constrained(self.guess, last), None
                else:
                    yield self.constrained(last), solution

    def guess(self, phases: np.ndarray, fractions: np.ndarray) -> np.ndarray:
        """The problem's guess (K, nq) at fractions of phases (K,)."""
        durations = np.array([entry.duration for entry in self.problem.schedule.phases])
        times = (np.cumsum(durations) - durations)[phases] + fractions * durations[phases]
        return np.array([self.problem.guess_at(time) for time in times.tolist()])

    def guess_is_clear(self) -> bool:
        """Whether pairs are apart along the guess wherever they have rows."""
        every = sorted({moment for moments in self.moments.values() for moment in moments})
        if not every:
            return True
        q = self.guess(*(np.array(each) for each in zip(*every, strict=True)))
        short = self.bodies.scene.distances(q, self.band + self.bodies.widest) - self._least
        columns = [column for column, pair in enumerate(self.bodies.pairs) if pair in self.moments]
        return bool((short[:, columns] >= 0).all())

    def _laid(self, motion: PhaseMotion) -> Iterator[tuple[PhaseMoment, SeparatingPlane]]:
        separated = {pair: moments for pair, moments in self.moments.items() if not self._fitted(pair)}
        every = sorted({moment for moments in separated.values() for moment in moments})
        if not every:
            return
        numbers = {moment: k for k, moment in enumerate(every)}
        q = motion(*(np.array(each) for each in zip(*every, strict=True)))
        pairs = [(pair, moment) for pair, moments in separated.items() for moment in sorted(moments)]
        wanted = [(numbers[moment], pair) for pair, moment in pairs]
        feet: list[PlacedBody | None] = [None] * len(wanted)
        if self.beyond_feet:
            poses = [contact_poses(self.problem.robot, row) for row in q]
            feet = [self._feet(pair, poses[number]) for number, pair in wanted]
        laid = self.bodies.planes(q, wanted, self.band, feet)
        for (pair, moment), planes in zip(pairs, laid, strict=True):
            for plane in planes:
                key = (pair, moment, plane.frame, plane.body)
                kept = plane.with_corners(self.corners.get(key, plane.corners))
                self.corners[key] = kept.corners
                yield moment, kept

    @cached_property
    def _contacts(self) -> dict[str, list[Contact]]:
        return contacts_by_shape(self.problem.robot, self.bodies.scene.shapes)

    @cached_property
    def _standing(self) -> np.ndarray:
        """Which pairs (n_phases, n_pairs) are of a foot with the ground on which its contact holds it."""
        bodies, phases = self.bodies, self.problem.schedule.phases
        standing = np.zeros((len(phases), len(bodies.pairs)), dtype=bool)
        shapes = {shape.name: shape for shape in bodies.scene.shapes}
        for column, (first, _) in enumerate(bodies.pairs[: bodies.scene.n_ground]):
            names = {c.name for c in self._contacts[first] if bodies.is_foot(shapes[first], c)}
            standing[:, column] = [not names.isdisjoint(phase.contacts) for phase in phases]
        return standing

    def _feet(self, pair: ShapePair, poses: Mapping[str, pin.SE3]) -> PlacedBody | None:
        """The contacts of the first link of a pair, as points in the world."""
        contacts = self._contacts[pair[0]]
        if not contacts:
            return None
        corners = [poses[c.name].act(np.array([*corner, 0.0])) for c in contacts for corner in c.corners]
        return PlacedBody(points=np.array(corners), radius=min(contact.radius for contact in contacts))


def along(solution: Solution) -> PhaseMotion:
    """The motion of a solution by phase and fraction."""
    motion = SolutionMotion(solution)
    return lambda phases, fractions: motion.in_phases(phases, fractions, np.full(len(phases), 0.5)).q


def _moments_to_look_at(
    plan: Solution, units: np.ndarray, times: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers and fractions (K,) of intervals, and which of them are nodes and points.

    The end of an interval is the start of the next one, where that is looked at; only the last has its own.
    """
    numbers, fractions, regular = [], [], []
    for number in range(plan.n_intervals):
        looked_at = np.unique(np.round([0.0, *collocation_fractions(plan.arrays, number)[1], 1.0], DIGITS))
        start, end = plan.interval_t[number]
        travel = (end - start) * float((np.abs(plan.v[plan.intervals[number]]) / units).max())
        looks = max(LOOKS, math.ceil(travel / LOOK_STEP))
        further = [(time - start) / (end - start) for time in times if start < time < end]
        evenly = np.linspace(0.0, 1.0, looks + 2)
        every = np.unique(np.round(np.concatenate([looked_at, evenly, further]), DIGITS))
        if number < plan.n_intervals - 1:
            every = every[every < 1.0]
        numbers.append(np.full(len(every), number))
        fractions.append(every)
        regular.append(np.isin(every, looked_at))
    return np.concatenate(numbers), np.concatenate(fractions), np.concatenate(regular)


def _in_phases(plan: Solution, numbers: np.ndarray, fractions: np.ndarray) -> tuple[PhaseMoment, ...]:
    """Phase and fraction of it at fractions of intervals."""
    start, end = plan.interval_t[numbers].T
    times = start + fractions * (end - start)
    phases = plan.phase[[rows.start for rows in plan.intervals]][numbers]
    spans = np.array(
        [plan.interval_t[plan.intervals_of(phase)][[0, -1], [0, 1]] for phase in range(len(plan.phases))]
    )
    begin, length = spans[phases, 0], np.diff(spans, axis=1)[phases, 0]
    shares = np.clip((times - begin) / length, 0.0, 1.0).round(DIGITS)
    return tuple(zip(phases.tolist(), shares.tolist(), strict=True))


def _least_around(values: np.ndarray) -> np.ndarray:
    """Which of the values (K,) are not above their neighbours."""
    padded = np.concatenate([[np.inf], values, [np.inf]])
    return np.asarray((values <= padded[:-2]) & (values <= padded[2:]))
