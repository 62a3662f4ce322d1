"""Status of a solve: what it means, and what to try."""

from enum import Enum


class Status(Enum):
    """Status of a solve; its value says what it means and, after a colon, what to try."""

    SOLVED = "solved to tolerance"
    INFEASIBLE = (
        "no feasible point was found near the last iterate: look at the worst blocks; relax the goal, "
        "lengthen a phase or raise a limit"
    )
    ITERATION_LIMIT = "the iteration limit was reached: raise `max_iterations`, or start from a better guess"
    TIME_LIMIT = "the time limit was reached: raise `max_time`, or use fewer intervals"
    INTERRUPTED = "stopped by the user: the iterate at that moment is kept, it is not a solution"
    NOT_FINITE = (
        "a function value or derivative is not finite: try another guess; trajopt diagnose names the first"
    )
    STEP_FAILED = "no step makes progress: try a finer grid or a perturbed start"
    INACCURATE = "the solver reports success but rows are violated beyond tolerance: tighten `tolerance`"
    COARSE_GRID = (
        "the rows hold at the points, but the motion between them does not: use more intervals or a higher "
        "degree"
    )
    SINGULAR_BASE = (
        "the virtual joints of the base pass gimbal lock, where their rates have no bound: use "
        "base='freeflyer', or another order of the angles' axes"
    )
    UNBOUNDED = "iterates diverge: a cost or limit that bounds the motion or the forces is missing"
    INVALID = (
        "the problem has more equality constraints than variables, or the solver refused it: look for a goal "
        "stated twice"
    )
    FAILED = "the solver stopped for another reason: see the solver's own status"

    def explain(self, where: str = "") -> str:
        """Return advice in short lines: what the status means, where, if known, and what to try."""
        what, _, remedy = self.value.partition(": ")
        return "\n".join(filter(None, (what, where, remedy)))

    @property
    def word(self) -> str:
        """The status as one lower-case word, as used in files and JSON."""
        return self.name.lower()
