"""Settings with which all pairs of a suite are solved."""

import math
from dataclasses import dataclass

from trajopt.errors import InputError
from trajopt.simulation.settings import Controller
from trajopt.solving.solving import check_settings
from trajopt.solving.time_limits import GRACE, OVERHEAD_TIME

# Noise on the guess: a tenth of the natural units, that is of a leg's length or half a dozen degrees.
DEFAULT_SIGMA = 0.1
# Most starts of a pair: more add no information and take a day.
MOST_STARTS = 10_000
# Time limit of a solve, s: several times the library's longest solve on one core.
DEFAULT_MAX_TIME = 300.0
# Seconds of a task besides its solve: building, and functions that are not in the cache yet.
BUILD_TIME = 300.0
# Longest time, s, that the timers of all kernels take.
MOST_TIME = 1e9


@dataclass(frozen=True, kw_only=True)
class SuiteSettings:
    """One choice for all pairs.

    Args:
        perturbed, sigma: perturbed starts, seeds from 0; standard deviation of their noise, scaled units.
        max_time: for a solve with all its meshes, s.
        simulate, controller: also run solved plans of legged robots in MuJoCo, with this controller.
        fixed_mesh: solve once, on the problem's mesh.
    """

    perturbed: int = 0
    sigma: float = DEFAULT_SIGMA
    solver: str = "ipopt"
    tolerance: float = 1e-6
    max_iterations: int = 500
    max_time: float = DEFAULT_MAX_TIME
    simulate: bool = False
    fixed_mesh: bool = False
    controller: Controller = "joints"

    def __post_init__(self) -> None:
        if not 0 <= self.perturbed <= MOST_STARTS:
            raise InputError(f"perturbed is {self.perturbed}", f"allowed: 0 to {MOST_STARTS}")
        if not (math.isfinite(self.sigma) and self.sigma > 0):
            raise InputError(f"sigma is {self.sigma:g}", "allowed: > 0")
        if self.controller != "joints" and not self.simulate:
            raise InputError("--controller has no effect here", "allowed: with --simulate")
        check_settings(self.solver, self.tolerance, self.max_iterations, self.max_time, self.sigma, 0)

    @property
    def longest(self) -> float:
        """Time limit of the process of a solve or a simulation, s."""
        return min(BUILD_TIME + self.max_time + OVERHEAD_TIME + GRACE, MOST_TIME)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the perturbed starts."""
        return tuple(range(self.perturbed))
