"""Trajectory optimisation for robots with contacts."""

from trajopt.versions import check_installation

check_installation()

from trajopt.check import check  # noqa: E402
from trajopt.continuation import continuation  # noqa: E402
from trajopt.diagnose import diagnose  # noqa: E402
from trajopt.errors import InputError, TrajoptError  # noqa: E402
from trajopt.ladder import solve_ladder  # noqa: E402
from trajopt.problem import Problem  # noqa: E402
from trajopt.robot import Contact, Robot  # noqa: E402
from trajopt.schedule import FlatGround, Phase, Schedule  # noqa: E402
from trajopt.solution import Solution  # noqa: E402
from trajopt.solution_motion import motion_of  # noqa: E402
from trajopt.solving import solve  # noqa: E402

__version__ = "0.1.0"

__all__ = [
    "Contact",
    "FlatGround",
    "InputError",
    "Phase",
    "Problem",
    "Robot",
    "Schedule",
    "Solution",
    "TrajoptError",
    "check",
    "continuation",
    "diagnose",
    "motion_of",
    "solve",
    "solve_ladder",
]
