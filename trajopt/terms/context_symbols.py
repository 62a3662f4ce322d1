"""Places where terms are evaluated, kinds of control input, and symbols of frames and parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Literal, get_args

import casadi as ca
import numpy as np

from trajopt.errors import InputError


class Place(Enum):
    """Where a term is evaluated."""

    POINT = "collocation point"
    NODE = "node"
    IMPACT = "impact"


def without_rolling(motion: ca.SX, lever: ca.SX | ca.DM) -> ca.SX:
    """Twist or acceleration (6,) of a ball's centre minus that of rolling, in the axes of its lever (3,).

    It vanishes for a ball that rolls without slip on a plane: v = omega x lever, a = omega' x lever.
    """
    return ca.vertcat(motion[:3] - ca.cross(motion[3:], lever), motion[3:])


Actuation = Literal["torque", "acceleration", "velocity", "jerk"]
# Highest derivative of the configuration among the variables.
ORDERS: dict[Actuation, int] = {"torque": 2, "acceleration": 2, "velocity": 1, "jerk": 3}
ACTUATIONS: tuple[Actuation, ...] = get_args(Actuation)


@dataclass(frozen=True)
class FrameSymbols:
    """Symbols of one frame in world axes: placement (m), velocity and classical acceleration.

    Velocity and acceleration have 6 entries: linear, then angular.
    """

    rotation: ca.SX  # (3, 3)
    position: ca.SX  # (3,)
    velocity: ca.SX  # (6,)
    acceleration: ca.SX  # (6,)

    @classmethod
    def create(cls, frame: str) -> FrameSymbols:
        """Fresh symbols for ``frame``."""
        return cls(
            ca.SX.sym(f"R_{frame}", 3, 3),
            ca.SX.sym(f"p_{frame}", 3),
            ca.SX.sym(f"v_{frame}", 6),
            ca.SX.sym(f"a_{frame}", 6),
        )

    def stacked(self) -> ca.SX:
        """All entries in one column (24,), columns of the rotation first."""
        return ca.vertcat(ca.vec(self.rotation), self.position, self.velocity, self.acceleration)


class Parameters:
    """Symbols of parameters in the order in which terms created them, and their numeric values."""

    def __init__(self) -> None:
        self._parameters: list[ca.SX] = []
        self._values: list[np.ndarray | Callable[[float], np.ndarray]] = []

    def parameter(self, value: np.ndarray | float) -> ca.SX:
        """A symbol whose numeric ``value`` may change without recompilation."""
        array = np.atleast_1d(np.asarray(value, dtype=float))
        if not np.all(np.isfinite(array)):
            raise InputError(f"a term's parameter is {array}", "allowed: finite numbers")
        symbol = ca.SX.sym(
            f"p{len(self._parameters)}", *(array.shape if array.ndim == 2 else (array.size, 1))
        )
        self._parameters.append(ca.vec(symbol))
        self._values.append(array.flatten(order="F"))
        return symbol

    def varying(self, value: Callable[[float], np.ndarray], size: int) -> ca.SX:
        """A parameter (size,) whose value is a function of nominal time, s, from the schedule's start."""
        symbol = ca.SX.sym(f"p{len(self._parameters)}", size)
        self._parameters.append(symbol)
        self._values.append(value)
        return symbol

    @property
    def parameters(self) -> ca.SX:
        """All parameters in one column."""
        return ca.vertcat(*self._parameters) if self._parameters else ca.SX(0, 1)

    @property
    def varying_columns(self) -> tuple[tuple[Callable[[float], np.ndarray], slice], ...]:
        """Functions of time among the parameters, and the columns of their values."""
        ends = np.cumsum([0, *[symbol.numel() for symbol in self._parameters]]).tolist()
        spans = zip(self._values, ends[:-1], ends[1:], strict=True)
        return tuple((value, slice(begin, end)) for value, begin, end in spans if callable(value))

    @property
    def parameter_values(self) -> np.ndarray:
        """Numeric values of all parameters; for varying ones, those at the schedule's start."""
        return self.parameter_values_at(0.0)

    def parameter_values_at(self, t: float) -> np.ndarray:
        """Numeric values at nominal time ``t`` in s. Raises InputError for another size or if not finite."""
        parts = [np.ravel(value(t)) if callable(value) else value for value in self._values]
        for part, symbol in zip(parts, self._parameters, strict=True):
            if part.size != symbol.numel():
                raise InputError(
                    f"a term's reference has {part.size} values at t = {t:g} s", f"allowed: {symbol.numel()}"
                )
        values = np.concatenate([np.zeros(0), *parts])
        if not np.all(np.isfinite(values)):
            raise InputError(f"a term's reference is not finite at t = {t:g} s", "allowed: finite numbers")
        return values
