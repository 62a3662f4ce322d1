"""How accurate a solution is, measured by independent means, and references to compare it with."""

from trajopt.accuracy.comparison import Comparison, compare
from trajopt.accuracy.measures import Accuracy, PhaseAccuracy, interval_errors, measure

__all__ = ["Accuracy", "Comparison", "PhaseAccuracy", "compare", "interval_errors", "measure"]
