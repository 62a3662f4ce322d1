"""Plans in MuJoCo: the same robot, contacts of finite stiffness, and a controller that tracks the plan."""

from trajopt.simulation.report import Report
from trajopt.simulation.settings import Settings
from trajopt.simulation.simulate import Simulation, simulate

__all__ = ["Report", "Settings", "Simulation", "simulate"]
