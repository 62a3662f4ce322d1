"""What is wrong with an optimisation problem at an iterate, in words, and what to try."""

from trajopt.diagnose.diagnosis import Diagnosis, diagnose
from trajopt.diagnose.sources import problem_of

__all__ = ["Diagnosis", "diagnose", "problem_of"]
