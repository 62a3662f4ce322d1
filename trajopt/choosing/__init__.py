"""Settings chosen from measured fronts for an accuracy or a time, verified, refined where they fall short."""

from trajopt.choosing.choice import Choice, choose_for_accuracy, choose_for_budget
from trajopt.choosing.solve_to import Aimed, solve_to_accuracy, solve_within

__all__ = ["Aimed", "Choice", "choose_for_accuracy", "choose_for_budget", "solve_to_accuracy", "solve_within"]
