"""Result of a solution in physics: the plan of a legged robot in MuJoCo (`trajopt.simulation`)."""

from dataclasses import dataclass

from trajopt.errors import TrajoptError
from trajopt.simulation.settings import Controller
from trajopt.solution.solution import Solution

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


def simulated(solution: Solution, controller: Controller = "joints") -> tuple[Physics, Solution | None]:
    """Simulate a plan; returns the result and the motion, or why there is none."""
    from trajopt.simulation.simulate import simulate

    try:
        simulation = simulate(solution, controller=controller)
        motion = simulation.as_solution()
    except (TrajoptError, ArithmeticError, ValueError) as error:
        return Physics(detail=f"cannot be simulated: {' '.join(str(error).split())}"), None
    report = simulation.report
    physics = Physics(
        word=FELL if report.fell else TRACKED if report.passed else OFF,
        base_error_end=report.base_error_end,
        base_error_max=report.base_error_max,
        slips=report.slips,
        missed=report.missed,
        detail="; ".join(report.failures),
    )
    return physics, motion


def in_words(physics: Physics) -> str:
    """A simulation result in a few words."""
    if not physics.word:
        return physics.detail
    off = physics.base_error_end
    end = "" if off is None else f", base {1e3 * off:.0f} mm off at the end"
    return f"{physics.word} in physics{end}" + (f" ({physics.detail})" if physics.detail else "")
