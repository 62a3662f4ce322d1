"""Rows at moments of phases: in which interval each moment lies, and the groups of functions there."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trajopt.problem.problem import Problem
from trajopt.terms.moments import MomentConstraint
from trajopt.transcription.layout import Layout

# A moment this close to a node, as a fraction of an interval, is at the node.
AT_NODE = 1e-9
# Fractions of intervals that agree to this many digits share a function group.
DIGITS = 12


@dataclass(frozen=True)
class MomentPlace:
    """One moment of a term (by its number, and the moment's): the interval (stage) and the fraction of it."""

    term: int
    index: int
    stage: int
    fraction: float


def moments_by_stage(problem: Problem, layout: Layout) -> Mapping[int, list[MomentPlace]]:
    """Moments of a problem's terms by the interval in which they lie, in the order of terms.

    A node between two intervals of a phase belongs to the later one. Moments at a start that is fixed are
    left out: nothing moves there.
    """
    by_stage: defaultdict[int, list[MomentPlace]] = defaultdict(list)
    for number, term in enumerate(problem.moment_constraints):
        for index, (stage, fraction) in enumerate(_places(problem, layout, term)):
            if not (stage == 0 and fraction == 0.0 and problem.periodicity is None):
                by_stage[stage].append(MomentPlace(number, index, stage, fraction))
    return by_stage


def _places(problem: Problem, layout: Layout, term: MomentConstraint) -> list[tuple[int, float]]:
    phase = problem.schedule.names.index(term.during)
    edges, stages = np.array(layout.mesh.phases[phase].fractions), layout.intervals_of(phase)
    numbers = np.clip(np.searchsorted(edges, term.fractions + AT_NODE, side="right") - 1, 0, len(stages) - 1)
    local = (term.fractions - edges[numbers]) / (edges[numbers + 1] - edges[numbers])
    local[np.abs(local) < AT_NODE], local[np.abs(local - 1) < AT_NODE] = 0.0, 1.0
    return [(int(stages[n]), round(float(c), DIGITS)) for n, c in zip(numbers, local, strict=True)]


def alike(layout: Layout, moments: Mapping[int, list[MomentPlace]]) -> list[list[MomentPlace]]:
    """Moments of one term at the same fraction of intervals of the same width: they share their gather."""
    groups: defaultdict[tuple[int, float, float], list[MomentPlace]] = defaultdict(list)
    for stage, places in moments.items():
        for moment in places:
            groups[moment.term, moment.fraction, float(layout.steps[stage])].append(moment)
    return list(groups.values())
