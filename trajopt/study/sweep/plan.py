"""The settings of a sweep: a grid of schemes and intervals, one factor at a time, or a product."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.study.sweep.setting import STARTS, WORDS, Setting, cone_of, with_cone
from trajopt.transcription.hessians import HESSIANS

# Multiples of the problem's own number of intervals.
SHARES = (0.2, 0.5, 1.0, 2.0)
GRID_SCHEMES = ("legendre:1", "legendre:2", "legendre:3")
# Tried only with the problem's own number of intervals.
OTHER_SCHEMES = ("radau:2", "trapezoidal", "hermite-simpson", "legendre:4")
TOLERANCES = (1e-4, 1e-8)
# The ends of the front combine several factors: fast ones on coarse grids, accurate ones on fine grids. Share
# of the intervals, and words of a setting.
JOINED = (
    (0.1, "legendre:3 1e-2"),
    (0.1, "legendre:4 1e-3"),
    (0.1, "legendre:4 1e-2"),
    (0.2, "legendre:3 1e-2"),
    (0.2, "legendre:3 1e-3"),
    (0.2, "legendre:2 1e-3 gauss-newton"),
    (0.25, "legendre:4"),
    (0.5, "legendre:3 1e-4"),
    (0.5, "legendre:4"),
    (1.0, "legendre:4 1e-8"),
)
GRID = ("transcription", "intervals")
AXES = (*GRID, "tolerance", *WORDS)
# A product of more settings is a mistake, or takes a week.
MOST_SETTINGS = 2000


@dataclass(frozen=True, kw_only=True)
class SweepPlan:
    """The settings of a sweep, base first; ``left_out``: those that do not apply to the problem."""

    base: Setting
    settings: tuple[Setting, ...]
    left_out: tuple[str, ...] = ()


def make_plan(
    problem: Problem,
    named: Mapping[str, Sequence[Any]] | None = None,
    *,
    also: Sequence[str] = (),
    full: bool = False,
) -> SweepPlan:
    """Choose the settings to run.

    named: values by axis (`AXES`). One value holds for all settings; several are tried. If no axis has
    several values, the default plan is used: the grid of schemes and shares of the problem's intervals, then
    each other factor alone, then a few combinations. also: more settings, in words. full: use the product of
    all named values instead of one factor at a time. Raises InputError for values that are not allowed or do
    not apply to the problem.
    """
    values = {axis: tuple(dict.fromkeys(given)) for axis, given in (named or {}).items() if given}
    fixed = {axis: given[0] for axis, given in values.items() if len(given) == 1}
    varied = {axis: given for axis, given in values.items() if len(given) > 1}
    default = own_setting(problem)
    base = replace(default, **fixed)
    for axis, given in values.items():
        for value in given:
            _require(problem, replace(default, **{axis: value}))
    notes: list[str] = []
    if full:
        settings: Iterable[Setting] = _product(base, varied)
    elif varied:
        settings = [*_grid(base, varied), *_one_by_one(base, varied)]
    else:
        settings = _default(problem, base, fixed, notes)
    extra = [Setting.parse(text, base) for text in also]
    for setting in extra:
        _require(problem, setting)
    chosen = tuple(dict.fromkeys([base, *settings, *extra]))
    if len(chosen) > MOST_SETTINGS:
        raise InputError(f"the plan has {len(chosen)} settings", f"allowed: at most {MOST_SETTINGS}")
    return SweepPlan(base=base, settings=chosen, left_out=tuple(notes))


def own_setting(problem: Problem) -> Setting:
    """The problem's own setting."""
    return Setting(
        transcription=problem.default_transcription,
        intervals=problem.default_intervals,
        cone=cone_of(problem) or "own",
    )


def _product(base: Setting, varied: Mapping[str, Sequence[Any]]) -> list[Setting]:
    if math.prod(len(values) for values in varied.values()) > MOST_SETTINGS:
        raise InputError("the product of all named values is too large", f"allowed: {MOST_SETTINGS} settings")
    return [
        replace(base, **dict(zip(varied, values, strict=True)))
        for values in itertools.product(*varied.values())
    ]


def _grid(base: Setting, varied: Mapping[str, Sequence[Any]]) -> list[Setting]:
    return _product(base, {axis: varied[axis] for axis in GRID if axis in varied})


def _one_by_one(base: Setting, varied: Mapping[str, Sequence[Any]]) -> list[Setting]:
    return [
        replace(base, **{axis: value})
        for axis, values in varied.items()
        if axis not in GRID
        for value in values
    ]


def _default(
    problem: Problem, base: Setting, fixed: Mapping[str, Any], notes: list[str]
) -> Iterable[Setting]:
    """The default plan, for named values that are all fixed."""
    least = len(problem.schedule.phases)
    counts = tuple(max(least, round(share * base.intervals)) for share in SHARES)
    schemes = (*GRID_SCHEMES, base.transcription)
    free = {axis: values for axis, values in _alternatives(problem, base, notes).items() if axis not in fixed}
    grid = {"transcription": schemes, "intervals": counts}
    yield from _grid(base, {axis: values for axis, values in grid.items() if axis not in fixed})
    if "transcription" not in fixed:
        yield from (replace(base, transcription=name) for name in OTHER_SCHEMES)
    yield from _one_by_one(base, free)
    if not fixed:
        for share, text in JOINED:
            yield Setting.parse(f"@{max(least, round(share * base.intervals))} {text}", base)


def _alternatives(problem: Problem, base: Setting, notes: list[str]) -> dict[str, tuple[Any, ...]]:
    """Alternatives to the base in each factor; ``notes`` receives those that do not apply to the problem."""
    alternatives: dict[str, tuple[Any, ...]] = {
        "solver": WORDS["solver"],
        "tolerance": TOLERANCES,
        "hessian": HESSIANS,
        "start": STARTS,
    }
    special: dict[str, tuple[str, ...]] = {"cone": ("smooth", "pyramid"), "model": ("two-stage",)}
    for axis, values in special.items():
        try:
            _require(problem, Setting.parse(values[0], base))
        except InputError as error:
            notes.append(f"{axis} {', '.join(values)}: {error.what}")
        else:
            alternatives[axis] = values
    return alternatives


def _require(problem: Problem, setting: Setting) -> None:
    """Refuse settings that do not apply to the problem; a solver refuses its own when it is called."""
    problem.schedule.intervals(setting.intervals)
    with_cone(problem, setting.cone)
    if setting.model == "two-stage" and (problem.actuation != "torque" or problem.robot.base == "fixed"):
        raise InputError(
            f"problem '{problem.name}' has no base rows that could be solved before its torques",
            "allowed: `model=full`",
        )
