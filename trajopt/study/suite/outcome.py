"""Results of one pair: solves, and statistics of the perturbed starts; to JSON and back."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from trajopt.study.solves import ERROR, SOLVED
from trajopt.study.suite.cases import Pair
from trajopt.study.suite.optima import counted


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One solve to the grade; ``seed`` is None for the default guess.

    Args:
        mode, status, detail: failure mode, empty if solved; the solver's status; what is violated.
        scheme, intervals, variables, constraints: of the best motion's mesh.
        meshes, iterations, wall_time: number of meshes, and the solver's totals on them; s.
        figure, used: the check's worst figure, and its value over what is allowed.
        motion: of a solved run, see `trajopt.study.suite.optima`.
    """

    seed: int | None
    mode: str
    status: str = ""
    legged: bool = False
    scheme: str = ""
    intervals: int = 0
    meshes: int = 1
    variables: int = 0
    constraints: int = 0
    iterations: int = 0
    wall_time: float = 0.0
    objective: float | None = None
    primal: float | None = None
    dual: float | None = None
    complementarity: float | None = None
    detail: str = ""
    figure: str = ""
    used: float | None = None
    motion: str = ""

    @property
    def solved(self) -> bool:
        """Whether the motion has the grade."""
        return self.mode == SOLVED


# From worst to best; a plan that was not simulated has no word.
FELL, OFF, TRACKED = "fell", "off", "tracked"
WORDS = (FELL, OFF, TRACKED)


@dataclass(frozen=True, kw_only=True)
class Physics:
    """A simulated plan: ``tracked``, ``off`` (it stands, but not where it should) or ``fell``; else empty.

    base_error_end, base_error_max: m. slips: stances that slid; missed: touchdowns that never came. detail:
    exceeded thresholds, or why there is no simulation.
    """

    word: str = ""
    base_error_end: float | None = None
    base_error_max: float | None = None
    slips: int | None = None
    missed: int | None = None
    detail: str = ""


def in_words(physics: Physics) -> str:
    """A simulation result in a few words."""
    if not physics.word:
        return physics.detail
    off = physics.base_error_end
    end = "" if off is None else f", base {1e3 * off:.0f} mm off at the end"
    return f"{physics.word} in physics{end}" + (f" ({physics.detail})" if physics.detail else "")


# Parts of a pair's result other than its perturbed starts, by the event that reports them.
PARTS: dict[str, Callable[..., Any]] = {"own": Attempt, "physics": Physics}


@dataclass(frozen=True, kw_only=True)
class Starts:
    """Figures over the perturbed starts; iterations, optima and motions over the solved ones.

    optima, motions: see `trajopt.study.suite.optima`. median_time: s, of the solver.
    """

    count: int
    solved: int
    median_iterations: float | None
    iterations_90: int | None
    optima: int
    motions: int = 0
    most_iterations: int | None = None
    median_time: float | None = None


@dataclass(frozen=True, kw_only=True)
class Outcome(Pair):
    """All results of one pair; parts not reached are None. ``error``: what ended it early.

    physics: result of the unperturbed solution in MuJoCo, if requested.
    """

    own: Attempt | None = None
    physics: Physics | None = None
    starts: tuple[Attempt, ...] = ()
    error: str = ""
    error_mode: str = ERROR
    total_time: float = 0.0

    @property
    def mode(self) -> str:
        """Failure mode; empty if solved."""
        return self.error_mode if self.own is None else self.own.mode

    @property
    def ok(self) -> bool:
        """Whether it is solved from the default guess, by the verdict of the check."""
        return self.mode == SOLVED

    @property
    def detail(self) -> str:
        """The failure in words."""
        return self.error if self.own is None else self.own.detail

    def with_event(self, event: Mapping[str, Any]) -> Outcome:
        """The result with a part that has ended: ``own``, ``physics`` or a ``start``; others are ignored."""
        kind = event["event"]
        if kind == "start":
            return self.with_start(Attempt(**event["values"]))
        return replace(self, **{kind: PARTS[kind](**event["values"])}) if kind in PARTS else self

    def with_start(self, start: Attempt) -> Outcome:
        """The result with a perturbed start, in the order of seeds."""
        others = [other for other in self.starts if other.seed != start.seed]
        return replace(self, starts=tuple(sorted([*others, start], key=lambda one: one.seed or 0)))

    def perturbed(self) -> Starts:
        """Figures over the perturbed starts."""
        solved = [attempt for attempt in self.starts if attempt.solved]
        iterations = sorted(attempt.iterations for attempt in solved)
        known = [attempt for attempt in solved if attempt.objective is not None]
        objectives = [attempt.objective for attempt in known if attempt.objective is not None]
        optima, motions = counted(objectives, [attempt.motion for attempt in known])
        return Starts(
            count=len(self.starts),
            solved=len(solved),
            median_iterations=statistics.median(iterations) if iterations else None,
            iterations_90=quantile(iterations, 0.9) if iterations else None,
            optima=optima,
            motions=motions,
            most_iterations=iterations[-1] if iterations else None,
            median_time=statistics.median(attempt.wall_time for attempt in solved) if solved else None,
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-able fields and derived verdicts."""
        verdict = {"ok": self.ok, "mode": self.mode, "detail": self.detail}
        return {**asdict(self), **verdict, "perturbed": asdict(self.perturbed()) if self.starts else None}

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> Outcome:
        """The inverse of `to_dict`. Raises KeyError, TypeError or ValueError for anything else."""
        values = {field.name: entry[field.name] for field in fields(cls)}
        values |= {name: kind(**values[name]) for name, kind in PARTS.items() if values[name] is not None}
        values["starts"] = tuple(Attempt(**start) for start in values["starts"])
        return cls(**values)


def quantile(ordered: Sequence[int], part: float) -> int:
    """The least of ``ordered`` that at least a fraction ``part`` of them does not exceed."""
    return ordered[max(0, math.ceil(part * len(ordered)) - 1)]
