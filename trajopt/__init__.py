"""Trajectory optimisation for robots with contacts."""

from trajopt.versions import check_installation

check_installation()

from trajopt.certify.check import check  # noqa: E402
from trajopt.errors import InputError, TrajoptError  # noqa: E402
from trajopt.problem.problem import Problem  # noqa: E402
from trajopt.robot.contact import Contact  # noqa: E402
from trajopt.robot.robot import Robot  # noqa: E402
from trajopt.schedule.schedule import Phase, Schedule  # noqa: E402
from trajopt.solution.motion import motion_of  # noqa: E402
from trajopt.solution.solution import Solution  # noqa: E402
from trajopt.solving.continuation import continuation  # noqa: E402
from trajopt.solving.ladder import solve_ladder  # noqa: E402
from trajopt.solving.solving import solve  # noqa: E402
from trajopt.study.diagnosis.diagnose import diagnose  # noqa: E402
from trajopt.terrain.flat import FlatGround  # noqa: E402

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
