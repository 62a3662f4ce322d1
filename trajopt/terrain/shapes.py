"""Analytic shapes of smooth ground: heights over (x, y) and their gradients, numeric and symbolic."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from typing import Any

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import Positive, checked
from trajopt.errors import InputError, shown

ParameterOf = Callable[[np.ndarray], ca.SX]


@dataclass(frozen=True, kw_only=True)
class Shape(ABC):
    """A smooth height z(x, y) in m; heights of shapes add up. Raises `InputError`."""

    @property
    def kind(self) -> str:
        """Name of the shape in a description."""
        return type(self).__name__.lower()

    @abstractmethod
    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Height (...) in m at x, y (...) m."""

    @abstractmethod
    def gradient(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slopes dz/dx and dz/dy (...) at x, y (...) m."""

    @abstractmethod
    def symbolic(self, x: ca.SX, y: ca.SX, parameter: ParameterOf) -> ca.SX:
        """Symbolic height; the shape's numbers enter through ``parameter``."""

    def describe(self) -> dict[str, Any]:
        """JSON-able description."""
        numbers = {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(self).items()}
        return {"shape": self.kind, **numbers}


@checked
@dataclass(frozen=True, kw_only=True)
class Incline(Shape):
    """A tilted plane, z = level + slope_x x + slope_y y.

    Args:
        level: height at the origin, m.
        slope_x: tangent of the angle along x.
        slope_y: tangent of the angle along y.
    """

    level: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0

    @override
    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return self.level + self.slope_x * x + self.slope_y * y

    @override
    def gradient(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.slope_x + 0 * x, self.slope_y + 0 * y

    @override
    def symbolic(self, x: ca.SX, y: ca.SX, parameter: ParameterOf) -> ca.SX:
        p = parameter(np.array([self.level, self.slope_x, self.slope_y]))
        return p[0] + p[1] * x + p[2] * y


@checked
@dataclass(frozen=True, kw_only=True)
class Bump(Shape):
    """A Gaussian hill (or hollow), z = rise exp(-r^2 / (2 radius^2)), r the distance from the centre.

    Args:
        rise: height of the hill, m; negative for a hollow.
        radius: distance from the centre to the steepest slope, m.
        centre: centre (x, y), m.
    """

    rise: float
    radius: Positive
    centre: tuple[float, float] = (0.0, 0.0)

    @override
    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        squared = (x - self.centre[0]) ** 2 + (y - self.centre[1]) ** 2
        return np.asarray(self.rise * np.exp(-squared / (2 * self.radius**2)))

    @override
    def gradient(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        part = -self.height(x, y) / self.radius**2
        return part * (x - self.centre[0]), part * (y - self.centre[1])

    @override
    def symbolic(self, x: ca.SX, y: ca.SX, parameter: ParameterOf) -> ca.SX:
        p = parameter(np.array([self.rise, self.radius, *self.centre]))
        return p[0] * ca.exp(-((x - p[2]) ** 2 + (y - p[3]) ** 2) / (2 * p[1] ** 2))


@dataclass(frozen=True, kw_only=True)
class _Along(Shape):
    """A shape that varies along one direction, ``yaw`` rad, measured from ``at`` (2,) m."""

    at: tuple[float, float] = (0.0, 0.0)
    yaw: float = 0.0

    def _along(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return math.cos(self.yaw) * (x - self.at[0]) + math.sin(self.yaw) * (y - self.at[1])

    def _turned(self, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return slope * math.cos(self.yaw), slope * math.sin(self.yaw)

    def _along_symbols(self, x: ca.SX, y: ca.SX, parameter: ParameterOf) -> ca.SX:
        p = parameter(np.array([math.cos(self.yaw), math.sin(self.yaw), *self.at]))
        return p[0] * (x - p[2]) + p[1] * (y - p[3])


@checked
@dataclass(frozen=True, kw_only=True)
class Ramp(_Along):
    """A smooth rise, z = rise / 2 (1 + tanh(2 s / length)), with slopes up to rise / length.

    Args:
        rise: total rise, m.
        length: length scale, m.
        at: where s is zero (x, y), m.
        yaw: direction of s, rad.
    """

    rise: float
    length: Positive

    @override
    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.asarray(self.rise / 2 * (1 + np.tanh(2 * self._along(x, y) / self.length)))

    @override
    def gradient(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._turned(self.rise / self.length / np.cosh(2 * self._along(x, y) / self.length) ** 2)

    @override
    def symbolic(self, x: ca.SX, y: ca.SX, parameter: ParameterOf) -> ca.SX:
        p = parameter(np.array([self.rise, self.length]))
        return p[0] / 2 * (1 + ca.tanh(2 * self._along_symbols(x, y, parameter) / p[1]))


@checked
@dataclass(frozen=True, kw_only=True)
class Wave(_Along):
    """Waves along one direction, z = amplitude sin(2 pi s / wavelength).

    Args:
        amplitude: m.
        wavelength: m.
        at: where s is zero (x, y), m.
        yaw: direction of s, rad.
    """

    amplitude: float
    wavelength: Positive

    @override
    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.asarray(self.amplitude * np.sin(math.tau * self._along(x, y) / self.wavelength))

    @override
    def gradient(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        number = math.tau / self.wavelength
        return self._turned(self.amplitude * number * np.cos(number * self._along(x, y)))

    @override
    def symbolic(self, x: ca.SX, y: ca.SX, parameter: ParameterOf) -> ca.SX:
        p = parameter(np.array([self.amplitude, self.wavelength]))
        return p[0] * ca.sin(math.tau * self._along_symbols(x, y, parameter) / p[1])


SHAPES: dict[str, type[Shape]] = {shape.__name__.lower(): shape for shape in (Incline, Bump, Ramp, Wave)}


def shape_from_description(described: Any) -> Shape:
    """The shape that ``describe`` wrote. Raises `InputError`."""
    made = SHAPES.get(str(described.get("shape"))) if isinstance(described, dict) else None
    if made is None:
        raise InputError(
            f"a shape of the ground is described by {shown(described)}", f"allowed: {', '.join(SHAPES)}"
        )
    numbers = {key: value for key, value in described.items() if key != "shape"}
    if set(numbers) != {entry.name for entry in fields(made)}:
        raise InputError(
            f"a {described['shape']} is described by {', '.join(numbers)}",
            f"allowed: {', '.join(entry.name for entry in fields(made))}",
        )
    return made(**numbers)
