"""A solution: the planned motion, sampled, with all that is needed to check and replay it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.errors import InputError

# Field -> dtype of every array that has one row a sample.
SAMPLED: dict[str, type] = {
    "t": float,
    "phase": int,
    "interval": int,
    "collocation": bool,
    "q": float,
    "v": float,
    "a": float,
    "tau": float,
    "f": float,
    "active": bool,
}
OTHERS: dict[str, type] = {
    "interval_t": float,
    "impulse": float,
    "impact_index": int,
    "row_multiplier": float,
    "row_place": int,
    "bound_multiplier": float,
}
# What a solution may lack.
OPTIONAL = ("impulse", "impact_index", "row_multiplier", "row_place", "bound_multiplier")


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """Samples of a motion, grouped by interval in time order: start node, collocation points, end node.

    A node shared by two intervals appears twice (limit from the left and from the right). ``a``,
    ``tau`` and ``f`` at a sample that is no collocation point are values of the interval's
    interpolating polynomials through its collocation points. SI units; arrays are copied and
    read-only. K samples, I intervals, nc contacts, J impacts.

    meta: JSON-able facts: names, limits, terrain, solver, versions (see `solution_file`).
    model_text: ``pin.Model.saveToString()`` of the model that was optimised.
    t: (K,) s. phase, interval: (K,) index. interval_t: (I, 2) start and end.
    collocation: (K,) the rows of the dynamics hold here.
    q, v, a: (K, nq), (K, nv), (K, nv) in Pinocchio's convention.
    tau: (K, nu) torques of the actuated rows, which come last in v.
    f: (K, nc, 6) force N and moment N m of the surroundings on the robot, world-aligned axes at
        the contact frame's origin; zero when inactive, but for the wrench of a payload that it carries.
    active: (K, nc) the contact is active.
    impulse, impact_index: (J, nc, 6) N s and N m s, (J,) sample just after; None without impacts.
    row_multiplier, row_place, bound_multiplier: multipliers of the NLP's rows (R,), for each row its block
        (a name in ``row_names`` of meta), stage and point (R, 3), and multipliers of the bounds of unknowns
        (X,), in the solver's scaled units; a warm start uses them. None where there are none.

    Raises `InputError` for an array that is not of these numbers or dimensions. The full test
    of consistency is `solution_consistency.inconsistency`, made when a file is written and read.
    """

    meta: dict[str, Any]
    model_text: str = field(repr=False)
    t: np.ndarray
    phase: np.ndarray
    interval: np.ndarray
    collocation: np.ndarray
    interval_t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    f: np.ndarray
    active: np.ndarray
    impulse: np.ndarray | None = None
    impact_index: np.ndarray | None = None
    row_multiplier: np.ndarray | None = None
    row_place: np.ndarray | None = None
    bound_multiplier: np.ndarray | None = None

    def __post_init__(self) -> None:
        for name, dtype in {**SAMPLED, **OTHERS}.items():
            value = getattr(self, name)
            if value is None and name in OPTIONAL:
                continue
            try:
                array: np.ndarray = np.array(value, dtype=dtype)
            except (TypeError, ValueError):
                raise InputError(f"'{name}' of the solution is not an array of {dtype.__name__}") from None
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        samples = self.t.shape
        for name in SAMPLED:
            shape = getattr(self, name).shape
            if len(samples) != 1 or shape[:1] != samples:
                raise InputError(
                    f"'{name}' of the solution has shape {shape}", f"first dimension as t: {samples}"
                )

    @cached_property
    def model(self) -> pin.Model:
        """The model that was optimised; raises `InputError` if its text is damaged."""
        model = pin.Model()
        try:
            model.loadFromString(self.model_text)
        except (RuntimeError, ValueError, MemoryError):
            raise InputError("the model in the solution is damaged or of another Pinocchio version") from None
        return model

    @property
    def contact_frames(self) -> tuple[str, ...]:
        """Frame of each contact, in the order of ``f`` and ``active``."""
        return tuple(self.meta["contact_frames"])

    @property
    def success(self) -> bool:
        """The solver met its tolerance."""
        return bool(self.meta["success"])

    @property
    def n_samples(self) -> int:
        """Number of samples K."""
        return len(self.t)

    @property
    def n_intervals(self) -> int:
        """Number of intervals I."""
        return len(self.interval_t)

    @property
    def n_unactuated(self) -> int:
        """Number of base rows, which come first in v and have no torque."""
        return self.v.shape[1] - self.tau.shape[1]

    @cached_property
    def intervals(self) -> tuple[range, ...]:
        """Samples of each interval."""
        return _runs(self.interval)

    @cached_property
    def phases(self) -> tuple[range, ...]:
        """Samples of each phase."""
        return _runs(self.phase)

    def interpolate(self, t: ArrayLike) -> np.ndarray:
        """Return the configuration at time ``t`` (s), for display: geodesics between samples.

        A scalar gives (nq,), an array (n,) gives (n, nq). Times outside the motion give its ends;
        at a node shared by two intervals the later one counts.
        """
        times = np.asarray(t, dtype=float)
        last = np.clip(np.searchsorted(self.t, times.ravel(), side="right") - 1, 0, self.n_samples - 2)
        rows = [self._between(int(index), time) for index, time in zip(last, times.ravel(), strict=True)]
        return np.array(rows).reshape(*times.shape, self.q.shape[1])

    def _between(self, index: int, time: float) -> np.ndarray:
        span = self.t[index + 1] - self.t[index]
        fraction = np.clip((time - self.t[index]) / span, 0.0, 1.0) if span > 0 else 1.0
        configuration: np.ndarray = pin.interpolate(
            self.model, self.q[index], self.q[index + 1], float(fraction)
        )
        return configuration

    def save(self, path: str | Path) -> Path:
        """Write the file (version 1) at once or not at all; return its path.

        Raises `InputError` if the place cannot be written or the solution is inconsistent.
        """
        from trajopt import solution_file

        return solution_file.write(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Solution:
        """Read a file; raises `SolutionFileError`, one line, if anything about it is wrong."""
        from trajopt import solution_file

        return solution_file.read(path)


def _runs(index: np.ndarray) -> tuple[range, ...]:
    """Ranges of equal consecutive values."""
    edges = [0, *(np.flatnonzero(np.diff(index)) + 1).tolist(), len(index)]
    return tuple(range(start, stop) for start, stop in itertools.pairwise(edges) if stop > start)
