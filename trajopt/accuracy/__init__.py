"""How accurate a solution is, measured by independent means, and references to compare it with."""

from trajopt.accuracy.comparison import Comparison, compare
from trajopt.accuracy.measures import Accuracy, PhaseAccuracy, interval_errors, measure
from trajopt.accuracy.optima import in_other_optimum
from trajopt.accuracy.reference import (
    Agreement,
    NoReferenceError,
    Reference,
    Rung,
    reference,
)
from trajopt.accuracy.table import table

__all__ = [
    "Accuracy",
    "Agreement",
    "Comparison",
    "NoReferenceError",
    "PhaseAccuracy",
    "Reference",
    "Rung",
    "compare",
    "in_other_optimum",
    "interval_errors",
    "measure",
    "reference",
    "table",
]
