"""Settings chosen from measured fronts for an accuracy or a time, verified, refined where they fall short."""

from trajopt.choosing.choice import ChosenSetting, choices_by_time, choose_for_accuracy
from trajopt.choosing.solve_to import Aimed, solve_to_accuracy, solve_within

__all__ = [
    "Aimed",
    "ChosenSetting",
    "choices_by_time",
    "choose_for_accuracy",
    "solve_to_accuracy",
    "solve_within",
]
