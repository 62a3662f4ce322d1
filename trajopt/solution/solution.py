"""A solution: the planned motion, sampled, with all that is needed to check and replay it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.robot.actuators.drive import Drive
from trajopt.robot.actuators.on_robot import drive_torque_values
from trajopt.solution import file
from trajopt.solution.arrays import OTHERS, SAMPLED, model_from_text, read_only, runs


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """Samples of a motion, grouped by interval in time order: start node, collocation points, end node.

    A node shared by two intervals appears twice (limit from the left and from the right). ``a``,
    ``tau`` and ``f`` at a sample that is not a collocation point are values of the interval's
    interpolating polynomials through its collocation points. SI units; arrays are copied and
    read-only. K samples, I intervals, nc contacts, J impacts.

    meta: JSON-able facts: names, limits, terrain, solver, versions (see `trajopt.solution.file`).
    model_text: ``pin.Model.saveToString()`` of the model that was optimised.
    t: (K,) s. phase, interval: (K,) index. interval_t: (I, 2) start and end.
    collocation: (K,) the dynamics are imposed here.
    q, v, a: (K, nq), (K, nv), (K, nv) in Pinocchio's convention.
    tau: (K, nu) torques of the actuated rows, which come last in v.
    f: (K, nc, 6) force N and moment N m of the surroundings on the robot, world-aligned axes at
        the contact frame's origin; zero when inactive. What a robot carries is in ``payloads`` of meta.
    active: (K, nc) the contact is active.
    impulse, impact_index: (J, nc, 6) N s and N m s, (J,) sample just after; None without impacts.
    row_multiplier, row_place, bound_multiplier: multipliers of the NLP's rows (R,), for each row its block
        (a name in ``row_names`` of meta), stage and point (R, 3), and multipliers of the bounds of variables
        (X,), in the solver's scaled units; a warm start uses them. None where there are none.

    Raises `InputError` for an array of another type or number of rows. The full test of consistency,
    `consistency.inconsistency`, runs when a file is written or read.
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
        given = {name: getattr(self, name) for name in (*SAMPLED, *OTHERS)}
        for name, array in read_only(given).items():
            object.__setattr__(self, name, array)

    @cached_property
    def model(self) -> pin.Model:
        """The model that was optimised; raises `InputError` if its text is damaged."""
        return model_from_text(self.model_text)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays by name, without those that are None."""
        named = {name: getattr(self, name) for name in (*SAMPLED, *OTHERS)}
        return {name: array for name, array in named.items() if array is not None}

    @property
    def contact_frames(self) -> tuple[str, ...]:
        """Frame of each contact, in the order of ``f`` and ``active``."""
        return tuple(self.meta["contact_frames"])

    @property
    def success(self) -> bool:
        """The verdict: the solver converged, and the motion is within the tolerances it was judged by."""
        return bool(self.meta["success"])

    @property
    def converged(self) -> bool:
        """The solver met its tolerance: all rows hold at the points; ``success`` in files without the key."""
        return bool(self.meta.get("converged", self.meta["success"]))

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
    def drives(self) -> tuple[Drive | None, ...]:
        """Drive of each actuated row (nu,), None without."""
        described = self.meta.get("drives") or [None] * self.tau.shape[1]
        return tuple(None if entry is None else Drive.from_meta(entry) for entry in described)

    @property
    def drive_torque(self) -> np.ndarray:
        """Torques (K, nu) that the drives deliver, joint side: ``tau`` and the joints' friction."""
        return drive_torque_values(self.drives, self.tau, self.v[:, self.n_unactuated :])

    @cached_property
    def intervals(self) -> tuple[range, ...]:
        """Samples of each interval."""
        return runs(self.interval)

    @cached_property
    def phases(self) -> tuple[range, ...]:
        """Samples of each phase."""
        return runs(self.phase)

    def intervals_of(self, phase: int) -> range:
        """Return the numbers of a phase's intervals."""
        rows = self.phases[phase]
        return range(int(self.interval[rows.start]), int(self.interval[rows.stop - 1]) + 1)

    def interval_at(self, t: ArrayLike) -> np.ndarray:
        """Return the numbers of the intervals at ``t`` (s): the later one at a node, the nearest outside."""
        found = np.searchsorted(self.interval_t[:, 0], t, side="right") - 1
        return np.clip(found, 0, self.n_intervals - 1)

    def with_arrays(self, **arrays: np.ndarray | None) -> Solution:
        """Return the same solution with other arrays; the model is not read from its text again."""
        return replace(self, **arrays).with_model(self.model)  # type: ignore[arg-type]

    def with_model(self, model: pin.Model) -> Solution:
        """Return this solution, which then does not read its model from its text."""
        self.__dict__["model"] = model
        return self

    def normalized(self) -> Solution:
        """Return the same solution with rotations of unit norm."""
        return self.with_arrays(q=np.array([pin.normalize(self.model, row) for row in self.q]))

    def interpolate(self, t: ArrayLike) -> np.ndarray:
        """Return the configuration at time ``t`` (s), for display: geodesics between samples.

        A scalar gives (nq,), an array (n,) gives (n, nq). Times outside the motion give its ends;
        a node shared by two intervals belongs to the later one.
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
        """Write the file (version 1) completely or not at all; return its path.

        Raises `InputError` if the place cannot be written or the solution is inconsistent.
        """
        return file.write_solution_file(path, self.meta, self.model_text, self.arrays)

    @classmethod
    def load(cls, path: str | Path) -> Solution:
        """Read a file; raises a one-line `SolutionFileError` if anything in it is wrong."""
        meta, model_text, arrays = file.read_solution_file(path)
        return cls(meta=meta, model_text=model_text, **arrays)
