"""Linear rows over the whole schedule: closure of a periodic motion, bounds on the total duration."""

from collections.abc import Iterator

import numpy as np

from trajopt.problem.periodicity import closing_map
from trajopt.problem.problem import Problem
from trajopt.transcription.collocation import Collocation
from trajopt.transcription.layout import Layout
from trajopt.transcription.row_collection import LinearRows, over_unknowns


def schedule_rows(problem: Problem, layout: Layout, collocation: Collocation) -> Iterator[LinearRows]:
    """Rows of a problem's periodicity and of the bounds on its total duration, if it has them."""
    if problem.periodicity is not None:
        yield _closing(problem, layout, collocation)
    if problem.duration_bounds is not None and layout.forms[0].n_time_scales:
        yield _duration(problem, layout, collocation)


def _closing(problem: Problem, layout: Layout, collocation: Collocation) -> LinearRows:
    """Rows left z_N - right z_0 - velocity * duration = constant, each in the unit of its entries."""
    assert problem.periodicity is not None
    made = closing_map(problem.robot, problem.periodicity, problem.initial_q)
    form, last = layout.forms[0], layout.forms[-1]
    scale = collocation.node_scale(form)
    state = np.setdiff1d(np.arange(form.size), form.time_scales)
    rotations = len(made.left) - (len(state) - len(form.rotations))
    unit = np.concatenate([np.ones(rotations), scale[state[len(form.rotations) :]]])
    first = np.zeros((len(unit), form.size))
    first[:, state] = -made.right
    fixed = made.constant + made.translated @ problem.periodicity.moved(_fixed_duration(layout))
    if problem.periodicity.velocity is not None:
        speed = made.translated @ np.array(problem.periodicity.velocity)
        first[:, form.time_scales] = -np.outer(speed, _free_durations(layout))
    final = np.zeros((len(unit), last.size))
    final[:, state] = made.left
    blocks = [(0, first * scale), (layout.n_stages, final * collocation.node_scale(last))]
    rows = over_unknowns(layout, [(node, block / unit[:, None]) for node, block in blocks])
    return LinearRows("periodicity", layout.n_stages, rows, fixed / unit, fixed / unit)


def _duration(problem: Problem, layout: Layout, collocation: Collocation) -> LinearRows:
    """Sum of the free durations over the time unit; the bounds are reduced by the fixed durations."""
    assert problem.duration_bounds is not None
    form = layout.forms[0]
    unit = collocation.units_of(form).time
    row = np.zeros((1, form.size))
    row[:, form.time_scales] = _free_durations(layout)
    lower, upper = (np.array([bound - _fixed_duration(layout)]) / unit for bound in problem.duration_bounds)
    return LinearRows("duration", 0, over_unknowns(layout, [(0, row / unit)]), lower, upper)


def _free_durations(layout: Layout) -> np.ndarray:
    """Nominal duration of every free phase, in the order of the time scales, s."""
    return np.array([phase.duration for phase in layout.schedule.phases if phase.duration_bounds is not None])


def _fixed_duration(layout: Layout) -> float:
    """Sum of the durations that are not free, s."""
    return float(sum(p.duration for p in layout.schedule.phases if p.duration_bounds is None))
