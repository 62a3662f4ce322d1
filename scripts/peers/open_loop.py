"""What planned torques do, by one model for all sides: numeric Pinocchio from a URDF, or a closed form."""

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from scripts.peers.plans import numbers

GRAVITY = 9.81
CART, POLE, LENGTH = 1.0, 0.3, 0.5
RELATIVE, ABSOLUTE = 1e-11, 1e-13
# Plans of these start anew from their own state after so long, s, at the next time where it is told: upright,
# the acrobot multiplies an error by a million in 0.7 s.
SEGMENTS = {"acrobot": 0.1}
# Points in an interval for integrals of squared torques, which are exact, and for their largest values.
GAUSS, DENSE = 8, 20

Acceleration = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def acceleration_of(task: dict[str, Any]) -> Acceleration:
    """Accelerations (nv,) of positions and rates (nv,) and torques (nu,), of a task as described."""
    if task["name"] == "pendulum":
        return lambda q, _v, u: u - GRAVITY * np.cos(q)
    return _cart_pole if task["name"] == "cart-pole" else _bodies(task)


def _cart_pole(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Kelly, "An introduction to trajectory optimization", 2017, eq. 6.1 and 6.2."""
    sine, cosine = np.sin(q[1]), np.cos(q[1])
    push, mass = u[0] + POLE * LENGTH * sine * v[1] ** 2, CART + POLE * sine**2
    cart = (push + POLE * GRAVITY * cosine * sine) / mass
    pole = -(push * cosine + (CART + POLE) * GRAVITY * sine) / (LENGTH * mass)
    return np.array([cart, pole])


def _bodies(task: dict[str, Any]) -> Acceleration:
    model = pin.buildModelFromXML(task["urdf"].replace('"continuous"', '"revolute"'))
    data, select = model.createData(), np.zeros((model.nv, len(task["actuated"])))
    for column, name in enumerate(task["actuated"]):
        select[model.joints[model.getJointId(name)].idx_v, column] = 1.0
    return lambda q, v, u: np.array(pin.aba(model, data, q, v, select @ u))


def measure(task: dict[str, Any], plan: dict[str, Any]) -> dict[str, float]:
    """Integrate the torques of a plan from its first state, without correction unless `SEGMENTS` says so.

    Returns:
        ``along``, the largest error of any position or rate at the times where states are told, and at the
        ``end``, SI units; ``objective``, the integral of squared torques; ``beyond``, by how much torques at
        any time, or rates where they are told, exceed their limits at most, over the limit.
    """
    torque, rate = numbers(task["torque"], np.inf), numbers(task["rate"], np.inf)
    states, fractions = np.array(plan["states"]), np.linspace(0.0, 1.0, DENSE + 1)
    points, weights = np.polynomial.legendre.leggauss(GAUSS)
    objective, worst = 0.0, float((np.abs(states[:, len(rate) :]) / rate).max())
    for step, rows in zip(np.diff(plan["breaks"]), plan["inputs"], strict=True):
        objective += step / 2 * float(weights @ (_polynomial(rows, (points + 1) / 2) ** 2).sum(axis=1))
        worst = max(worst, float((np.abs(_polynomial(rows, fractions)) / torque).max()))
    errors = list(_errors(task, plan, states))
    return {"along": max(errors), "end": errors[-1], "objective": objective, "beyond": max(worst - 1, 0.0)}


def _polynomial(rows: list[list[float]], fractions: np.ndarray) -> np.ndarray:
    return np.vander(fractions, len(rows), increasing=True) @ np.array(rows)


def _errors(task: dict[str, Any], plan: dict[str, Any], states: np.ndarray) -> Iterator[float]:
    acceleration, segment = acceleration_of(task), SEGMENTS.get(task["name"], np.inf)
    breaks, times = np.array(plan["breaks"]), np.array(plan["times"])
    x, begun, n = states[0], times[0], states.shape[1] // 2
    for k, (begin, end) in enumerate(itertools.pairwise(times), 1):
        number = int(np.searchsorted(breaks, (begin + end) / 2)) - 1
        low, high = breaks[number : number + 2]
        rows = np.array(plan["inputs"][number])
        parts = (begin - low) / (high - low), (end - low) / (high - low)

        def slope(part: float, x: np.ndarray, step: float = high - low, rows: Any = rows) -> np.ndarray:
            torque = part ** np.arange(len(rows)) @ rows
            return step * np.concatenate([x[n:], acceleration(x[:n], x[n:], torque)])

        x = solve_ivp(slope, parts, x, method="DOP853", rtol=RELATIVE, atol=ABSOLUTE).y[:, -1]
        yield float(np.abs(x - states[k]).max())
        if end - begun >= segment:
            x, begun = states[k], end
