"""A solution: the sampled motion, with all that is needed to check and replay it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.arguments import checked
from trajopt.errors import InputError, expanded
from trajopt.motion import file
from trajopt.motion.consistency import OTHERS, SAMPLED, read_only, runs, wrong_number
from trajopt.motion.interpolation import InterpolatedMotion
from trajopt.motion.robot_motion import BaseAxes, QuaternionOrder, RobotMotion, require_convention
from trajopt.motion.sampled_motion import (
    SampledMotion,
    Side,
    angles_of,
    in_convention,
    is_extrapolated,
    located,
    sample_times,
)
from trajopt.motion.statistics import SolveStatistics
from trajopt.robot.actuators.on_robot import drive_torque_values


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution(RobotMotion):
    """Samples of a motion, grouped by interval in time order: start node, collocation points, end node.

    A node shared by two intervals appears twice (limits from the left and from the right). At samples that
    are not collocation points, ``a``, ``tau`` and ``f`` are values of the interval's polynomials through its
    collocation points. `sample` gives one value per time, at any rate. SI units; arrays are copied and
    read-only. K samples, I intervals, nc contacts, J impacts.

    description, model, t, phase, q, v, a, tau, f, active: see `RobotMotion`.
    statistics: how it was found: solver, status, size, times, residuals.
    interval: (K,) index. interval_t: (I, 2) start and end, s.
    collocation: (K,) whether the dynamics are imposed at the sample.
    impulse, impact_index: (J, nc, 6) N s and N m s, (J,) sample just after; None without impacts.
    row_multiplier, row_place, bound_multiplier: (R,) multipliers of the NLP's rows, (R, 3) each row's block
        (index in ``statistics.row_names``), stage and point, (X,) multipliers of variable bounds, in the
        solver's scaled units, for warm starts. None without multipliers.
    gain: (I, nu, 2 nv) feedback gains at the start of each interval, see `gains`; None without gains.
    asked_force, com_goal, foot_goal: (K, nc, 6), (K, 3), (K, nc, 3) requests of a whole-body controller in a
        simulation (`trajopt.control.TickRequest`): contact forces as ``f``, and goals for the centre of mass
        and for contact frames in the air, m, NaN without a request. None without a controller.

    Raises `InputError` if an array has the wrong type or number of rows. `consistency.inconsistency`
    is checked in full when a file is written or read.
    """

    statistics: SolveStatistics
    interval: np.ndarray
    collocation: np.ndarray
    interval_t: np.ndarray
    impulse: np.ndarray | None = None
    impact_index: np.ndarray | None = None
    row_multiplier: np.ndarray | None = None
    row_place: np.ndarray | None = None
    bound_multiplier: np.ndarray | None = None
    gain: np.ndarray | None = None
    asked_force: np.ndarray | None = None
    com_goal: np.ndarray | None = None
    foot_goal: np.ndarray | None = None

    def __post_init__(self) -> None:
        given = {name: getattr(self, name) for name in (*SAMPLED, *OTHERS)}
        for name, array in read_only(given).items():
            object.__setattr__(self, name, array)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays by name, without absent ones."""
        named = {name: getattr(self, name) for name in (*SAMPLED, *OTHERS)}
        return {name: array for name, array in named.items() if array is not None}

    @property
    def phase_names(self) -> tuple[str, ...]:
        """Names of the phases; for files without names, their numbers."""
        return self.description.phase_names

    @property
    def success(self) -> bool:
        """Whether the solver converged and the motion meets the tolerances of the check."""
        return self.statistics.success

    @property
    def converged(self) -> bool:
        """Whether the solver met its tolerance: all rows hold at the points."""
        return self.statistics.converged

    @property
    def meta(self) -> dict[str, Any]:
        """The entry ``meta`` of the file, JSON-able, from `description` and `statistics`."""
        return self._content.meta

    @property
    def n_samples(self) -> int:
        """Number of samples K."""
        return len(self.t)

    @property
    def n_intervals(self) -> int:
        """Number of intervals I."""
        return len(self.interval_t)

    @property
    def order(self) -> int:
        """Highest derivative of positions among the variables: 2, 3 for jerks, or 1 for velocity input."""
        return {"velocity": 1, "jerk": 3}.get(self.description.actuation, 2)

    @cached_property
    def polynomials(self) -> InterpolatedMotion:
        """The motion at any time by the intervals' polynomials, with unit quaternions."""
        arrays = self.arrays | {"q": np.array([pin.normalize(self.model, row) for row in self.q])}
        return InterpolatedMotion.of(self.model, arrays, self.order)

    @property
    def drive_torque(self) -> np.ndarray:
        """Torques (K, nu) delivered by the drives, joint side: ``tau`` plus joint friction."""
        return drive_torque_values(self.drives, self.tau, self.actuation.rates(self.v))

    @cached_property
    def intervals(self) -> tuple[range, ...]:
        """Sample ranges of the intervals."""
        return runs(self.interval)

    @cached_property
    def phases(self) -> tuple[range, ...]:
        """Sample ranges of the phases."""
        return runs(self.phase)

    @property
    def phase_durations(self) -> tuple[float, ...]:
        """Durations of the phases, s."""
        return tuple(float(self.t[rows.stop - 1] - self.t[rows.start]) for rows in self.phases)

    def intervals_of(self, phase: int) -> range:
        """Return the indices of a phase's intervals."""
        rows = self.phases[phase]
        return range(int(self.interval[rows.start]), int(self.interval[rows.stop - 1]) + 1)

    def interval_at(self, t: ArrayLike) -> np.ndarray:
        """Return the indices of the intervals at ``t`` (s), clipped; at a node, the later interval."""
        numbers = np.searchsorted(self.interval_t[:, 0], t, side="right") - 1
        return np.clip(numbers, 0, self.n_intervals - 1)

    def with_arrays(self, **arrays: np.ndarray | None) -> Solution:
        """Return the solution with some arrays replaced."""
        return replace(self, **arrays)  # type: ignore[arg-type]

    def with_description(self, **changes: Any) -> Solution:
        """Return the solution with some entries of its description replaced."""
        return replace(self, description=replace(self.description, **changes))

    def with_statistics(self, **changes: Any) -> Solution:
        """Return the solution with some entries of its statistics replaced."""
        return replace(self, statistics=replace(self.statistics, **changes))

    def normalized(self) -> Solution:
        """Return the solution with unit quaternions."""
        return replace(self, q=np.array([pin.normalize(self.model, row) for row in self.q]))

    def gains(self, times: ArrayLike | None = None, *, side: Side = "after") -> np.ndarray:
        """Return feedback gains (n, nu, 2 nv): the derivative of the optimal torques in the state.

        ``tau + K @ [pin.difference(model, q, q_measured), v_measured - v]`` are to first order the torques
        with which the best motion from a measured state to the plan's goals begins. Units are N m (N) per rad
        (m), and per rad/s (m/s).

        Args:
            times: (n,) s, within the motion; default: the K samples. Gains are linear between the starts of
                a phase's intervals, and constant after the last.
            side: "after" or "before" a node, as in `sample`.

        Raises:
            InputError: For a plan without gains, and for times outside the motion.
        """
        if self.gain is None:
            raise InputError(
                "the plan has no gains",
                "allowed: plans of trajopt solve --gains, or of solve(problem, gains=True)",
            )
        start, end = self.interval_t.T
        if times is None:
            number = self.interval
            fraction = (self.t - start[number]) / (end - start)[number]
        else:
            number, fraction = located(
                self.interval_t, sample_times(self.interval_t, self.t, None, times), side
            )
        phase = self.phase[np.searchsorted(self.interval, np.arange(self.n_intervals))]
        after = np.minimum(number + 1, self.n_intervals - 1)
        after = np.where(phase[after] == phase[number], after, number)
        weight = np.asarray(fraction)[:, None, None]
        return np.asarray((1 - weight) * self.gain[number] + weight * self.gain[after])

    def sample(
        self,
        rate: float | None = None,
        *,
        times: ArrayLike | None = None,
        side: Side = "after",
        quaternion: QuaternionOrder = "xyzw",
        base_velocity: BaseAxes = "body",
    ) -> SampledMotion:
        """Return the motion at given times from the polynomials of its intervals.

        Args:
            rate: Sampling rate, Hz, from the start, plus a sample at the end; the last step is shorter if
                the duration is not a multiple of the others.
            times: (n,) s, within the motion, in any order. Without rate and times: those of ``t``, each once.
            side: "after" or "before" a node, where torques, forces and, at impacts, velocities jump.
            quaternion: Order of quaternion entries, "xyzw" (Pinocchio) or "wxyz".
            base_velocity: Axes of a moving base's velocity and acceleration, "body" (Pinocchio) or "world".

        Raises:
            InputError: If the rate is not positive or gives over 200,000 samples, times are outside the
                motion, a word is unknown, or the solution has NaN or infinity.
        """
        require_convention(quaternion, base_velocity)
        wrong = wrong_number({name: self.arrays[name] for name in (*SAMPLED, "interval_t")})
        if wrong:
            raise InputError(f"the solution cannot be sampled: {wrong}", "allowed: finite numbers")
        t = sample_times(self.interval_t, self.t, rate, times)
        numbers, fractions = located(self.interval_t, t, side)
        state = self.polynomials.at(numbers, fractions)
        motion = in_convention(self.model, state, quaternion, base_velocity)
        first = np.array([rows.start for rows in self.intervals])[numbers]
        jerk, torque_rate = self.polynomials.rates(numbers, fractions)
        jerk[:, [joint.nv > 1 for joint in list(self.model.joints)[1:] for _ in range(joint.nv)]] = np.nan
        return SampledMotion(
            description=self.description,
            model=self.model,
            success=self.success,
            t=t,
            **vars(motion),
            jerk=jerk,
            torque_rate=torque_rate,
            drive_torque=drive_torque_values(self.drives, state.tau, self.actuation.rates(state.v)),
            angle=angles_of(self.model, self, t, state.q),
            active=self.active[first],
            phase=self.phase[first],
            source=self.phase[first],
            extrapolated=is_extrapolated(self.arrays, numbers, t),
            phase_names=self.phase_names,
            quaternion=quaternion,
            base_velocity=base_velocity,
        )

    def to_pandas(self, rate: float | None = None, **sampling: Any) -> Any:
        """Return `sample` with these arguments as a ``pandas.DataFrame``; see `SampledMotion.to_pandas`."""
        return self.sample(rate, **sampling).to_pandas()

    @property
    def _content(self) -> file.FileContent:
        return file.FileContent(
            description=self.description, statistics=self.statistics, model=self.model, arrays=self.arrays
        )

    def require_consistent(self) -> Solution:
        """Return this solution; raises `InputError` if arrays, model and description are inconsistent."""
        self._content.require_consistent()
        return self

    def save(self, path: str | Path) -> Path:
        """Write the file (version 1) completely or not at all; return its path.

        Raises `InputError` if the path cannot be written or the solution is inconsistent.
        """
        target = expanded(path)
        file.write_bytes(target, self.to_bytes())
        return target

    @classmethod
    def load(cls, path: str | Path) -> Solution:
        """Read a file; raises a one-line `SolutionFileError` if anything in it is wrong."""
        return cls._of(file.read_solution_file(path))

    def to_bytes(self) -> bytes:
        """Return the content of the file that `save` writes; raises `InputError` if inconsistent."""
        return self._content.to_bytes()

    @classmethod
    @checked
    def from_bytes(cls, content: bytes, name: str = "solution") -> Solution:
        """Return the solution of `to_bytes`; raises a `SolutionFileError` that calls it ``name``."""
        return cls._of(file.parse_solution(content, Path(name)))

    @classmethod
    def _of(cls, content: file.FileContent) -> Solution:
        parts: dict[str, Any] = vars(content) | content.arrays
        parts.pop("arrays")
        return cls(**parts)
