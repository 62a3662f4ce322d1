"""One setting of a sweep: everything about how a problem is solved that trades speed for accuracy."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solvers.drivers import SOLVERS
from trajopt.solving.solving import DEFAULT_SOLVER
from trajopt.terms.friction import ContactConstraint, FrictionCone, FrictionPyramid
from trajopt.transcription.hessians import DEFAULT_HESSIAN, HESSIANS
from trajopt.transcription.schemes import FAMILIES, scheme

KINDS: dict[str, type[ContactConstraint]] = {"smooth": FrictionCone, "pyramid": FrictionPyramid}
# ``own``: the problem's friction terms, of both kinds or none.
CONES = ("own", *KINDS)
MODELS = ("full", "two-stage")
STARTS = ("cold", "warm")

# Finer grids take tens of gigabytes before anything is solved.
MOST_INTERVALS = 100_000

# Axis -> the words it takes; a word belongs to one axis only, so that a setting can be written in words.
WORDS = {
    "solver": tuple(SOLVERS),
    "hessian": HESSIANS,
    "cone": CONES,
    "model": MODELS,
    "start": STARTS,
}
WORD_FORM = (
    "allowed: SCHEME@INTERVALS, a tolerance, or one of "
    f"{', '.join(word for words in WORDS.values() for word in words)}"
)


@dataclass(frozen=True, kw_only=True)
class Setting:
    """How a problem is solved. Raises InputError for an invalid value.

    Args:
        intervals: over the whole schedule.
        cone: friction as the smooth cone or the inscribed pyramid; ``own``: as in the problem.
        model: ``full``, or ``two-stage``: motion and wrenches, then torques (`trajopt.reduced.two_stage`).
        start: ``cold`` from the problem's guess; ``warm`` from a solution on half the intervals, timed too.
    """

    transcription: str
    intervals: int
    solver: str = DEFAULT_SOLVER
    tolerance: float = 1e-6
    hessian: str = DEFAULT_HESSIAN
    cone: str = "own"
    model: str = "full"
    start: str = "cold"

    def __post_init__(self) -> None:
        scheme(self.transcription)
        if not 1 <= self.intervals <= MOST_INTERVALS:
            raise InputError(f"intervals is {self.intervals}", f"allowed: 1 to {MOST_INTERVALS}")
        if not (math.isfinite(self.tolerance) and 0 < self.tolerance < 1):
            raise InputError(f"tolerance is {self.tolerance:g}", "allowed: between 0 and 1")
        for axis, words in WORDS.items():
            if getattr(self, axis) not in words:
                raise InputError(f"unknown {axis} '{getattr(self, axis)}'", f"allowed: {', '.join(words)}")

    @property
    def points(self) -> int:
        """Collocation points over the whole schedule."""
        return self.intervals * scheme(self.transcription).s

    @property
    def functions(self) -> str:
        """The values that determine the compiled functions, in words: no scheme, step or interval count."""
        return " ".join((self.hessian, self.cone, self.model))

    def words(self) -> dict[str, str]:
        """Each axis as a word; the grid is one."""
        grid = f"{self.transcription}@{self.intervals}"
        words = {axis: getattr(self, axis) for axis in WORDS}
        tolerance = np.format_float_scientific(self.tolerance, trim="-", exp_digits=1)
        return {"grid": grid, "solver": words.pop("solver"), "tolerance": tolerance, **words}

    @property
    def name(self) -> str:
        """All values in words, the same for equal settings: the key of recorded results."""
        return " ".join(self.words().values())

    def label(self, base: Setting) -> str:
        """The grid, and the words in which it differs from ``base``."""
        others = base.words()
        return " ".join(word for axis, word in self.words().items() if axis == "grid" or word != others[axis])

    def slug(self) -> str:
        """The name as part of a file name."""
        return re.sub(r"[^A-Za-z0-9.]+", "-", self.name)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able values by axis."""
        return asdict(self)

    @classmethod
    def parse(cls, text: str, base: Setting) -> Setting:
        """Replace values of ``base`` by the words of ``text``, as in ``legendre:1@10 pyramid 1e-3``."""
        chosen: dict[str, Any] = {}
        for word in text.replace(",", " ").split():
            for axis, value in _meaning(word).items():
                if axis in chosen:
                    raise InputError(f"setting '{text}' gives its {axis} twice", "allowed: once")
                chosen[axis] = value
        return replace(base, **chosen)


def _meaning(word: str) -> dict[str, Any]:
    """Values by axis that a word of a setting means. Raises InputError."""
    for axis, words in WORDS.items():
        if word in words:
            return {axis: word}
    name, at, count = word.partition("@")
    grid: dict[str, Any] = {}
    if at:
        if not (count.isascii() and count.isdigit()):
            raise InputError(f"'{word}' is no grid", "allowed: SCHEME@INTERVALS, such as legendre:2@25")
        grid["intervals"] = int(count)
    if name.partition(":")[0] in FAMILIES:
        return {"transcription": name, **grid}
    if grid and not name:
        return grid
    try:
        return {"tolerance": float(word)}
    except ValueError:
        raise InputError(f"'{word}' is no word of a setting", WORD_FORM) from None


def cone_of(problem: Problem) -> str | None:
    """Kind of the friction terms for points: ``smooth``, ``pyramid``, ``own`` for both, None without any."""
    kinds = {
        kind for kind, term_type in KINDS.items() if any(type(term) is term_type for term in problem.terms)
    }
    if len(kinds) == 1:
        return kinds.pop()
    return "own" if kinds else None


def with_cone(problem: Problem, kind: str) -> Problem:
    """Convert all friction terms for point contacts to that kind; ``own`` leaves the problem unchanged.

    The pyramid is inscribed in the cone: where friction is active, the two problems have different optima.
    The cones of soles (`SoleCone`) are already pyramids and stay. Raises InputError if there is no friction
    term.
    """
    current = cone_of(problem)
    if kind in ("own", current):
        return problem
    if current is None:
        raise InputError(
            f"problem '{problem.name}' has no friction term of point contacts", "allowed: no `cone`"
        )
    chosen = KINDS[kind]
    terms = (
        chosen(**{entry.name: getattr(term, entry.name) for entry in fields(term) if entry.init})
        if type(term) in KINDS.values()
        else term
        for term in problem.terms
    )
    return replace(problem, terms=tuple(terms))
