"""CoM trajectories from footsteps: a quadratic program that keeps the ZMP inside the feet, solved by OSQP.

For each of N intervals of length h, the variables are a state x_k and an input u_k of the linear inverted
pendulum c'' = omega^2 (c - p) of ``lip``, with the exact step x_(k+1) = A x_k + B u_k for both axes:

- control "zmp_rate": x = (c, c', p), u = p'. Within an interval the ZMP is linear and the CoM hyperbolic, in
  closed form. A ZMP that is inside a convex polygon at both ends of an interval stays inside.
- control "jerk": x = (c, c', c''), u the jerk (Kajita et al. 2003; Wieber 2006). The CoM and the ZMP
  p = c - c'' / omega^2 are cubic. The polygon contains the ZMP's four Bernstein coefficients, and so the
  whole curve. A ZMP that must be constant (point feet) is not possible.

The polygon is the convex hull of support vertices s_i: each ZMP value is sum_i w_i s_i with w >= 0 and
sum w = 1. This also covers points and segments (point feet). Between consecutive supports without a common
foot, the third state may jump.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
import osqp
from scipy import sparse
from scipy.linalg import expm

from trajopt.arguments import Positive, checked
from trajopt.errors import InputError
from trajopt.kinds import ArrayShape
from trajopt.reduced.footsteps import FootstepPlan, support_vertices
from trajopt.reduced.lip import ComMotion, CubicMotion, Pendulum, PendulumMotion
from trajopt.robot.robot import Robot

PendulumInput = Literal["zmp_rate", "jerk"]
EndCondition = Literal["rest", "captured"]

# OSQP's tolerance in m: far below the accuracy of foot placement, and cheap to reach.
QP_TOLERANCE = 1e-9
QP_ITERATIONS = 100_000
# Largest violation of the program's rows, m, that is accepted as a solution.
TRUSTED = 1e-6
# Rounding error allowed in the number of intervals.
COUNT_SLACK = 1e-9


@checked
@dataclass(frozen=True, kw_only=True)
class CenterOfMassProgram:
    """The quadratic program of a walk; ``solve()`` returns the motion.

    Args:
        robot: The robot whose feet stand on the plan's footholds.
        plan: The supports.
        pendulum: The pendulum at the height of the centre of mass.
        com_start: Initial horizontal position of the centre of mass (2,), m, world.
        velocity_start: Its initial velocity (2,), m/s, world.
        control: "zmp_rate" or "jerk", see the module.
        terminal: "rest" ends at rest above the ZMP; "captured" ends with the capture point on the ZMP, so
            that the pendulum comes to rest if the ZMP stays.
        step: Longest interval, s.
        smoothing: Time tau in s that weighs the input in the cost, the mean over time of
            |p - middle of the support|^2 + tau^2 |p'|^2 (with control "jerk", p' is jerk / omega^2).
        shrink: Fraction of a sole's size kept as a margin, in [0, 1).

    Raises:
        InputError: If a word is unknown or a number is out of range.
    """

    robot: Robot
    plan: FootstepPlan
    pendulum: Pendulum
    com_start: Annotated[np.ndarray, ArrayShape((2,))]
    velocity_start: Annotated[np.ndarray, ArrayShape((2,))] = field(default_factory=lambda: np.zeros(2))
    control: PendulumInput = "zmp_rate"
    terminal: EndCondition = "rest"
    step: Positive = 0.05
    smoothing: Positive = 0.05
    shrink: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.shrink < 1:
            raise InputError(f"shrink is {self.shrink:g}", "allowed: 0 <= shrink < 1")

    def solve(self) -> ComMotion:
        """Return the optimal motion. Raises InputError if OSQP finds none with the ZMP in the supports."""
        assembled = _Assembly(self)
        rows, lower, upper = assembled.rows()
        solver = osqp.OSQP()
        solver.setup(
            *assembled.cost(), rows, lower, upper, verbose=False, polishing=True,
            eps_abs=QP_TOLERANCE, eps_rel=QP_TOLERANCE, max_iter=QP_ITERATIONS,
        )  # fmt: skip
        result = solver.solve(raise_error=False)
        excess = math.nan
        if result.x is not None and np.isfinite(result.x).all():
            reached = rows @ result.x
            excess = float(np.maximum(lower - reached, reached - upper).max())
        if not excess <= TRUSTED:
            raise InputError(
                f"no CoM motion keeps the ZMP in the supports (OSQP: {result.info.status})",
                "try longer supports, shorter steps, less shrink or control='zmp_rate'",
            )
        return assembled.motion(result.x)


@dataclass(frozen=True, kw_only=True)
class _Model:
    """One interval: x_next = A x + B u, and points Zx x + Zu u whose convex hull contains the ZMP."""

    A: np.ndarray  # (3, 3)
    B: np.ndarray  # (3, 1)
    Zx: np.ndarray  # (n, 3)
    Zu: np.ndarray  # (n, 1)
    terminal: Mapping[EndCondition, np.ndarray]  # rows over x that must vanish at the end


def _zmp_rate_model(omega: float, h: float) -> _Model:
    system = np.zeros((4, 4))
    system[0, 1], system[1, 0], system[1, 2], system[2, 3] = 1.0, omega**2, -(omega**2), 1.0
    flow = expm(system * h)
    return _Model(
        A=flow[:3, :3],
        B=flow[:3, 3:],
        Zx=np.array([[0.0, 0, 1], [0, 0, 1]]),
        Zu=np.array([[0.0], [h]]),
        terminal={"rest": np.array([[0.0, 1, 0], [1, 0, -1]]), "captured": np.array([[1.0, 1 / omega, -1]])},
    )


def _jerk_model(omega: float, h: float) -> _Model:
    down = 1 / omega**2
    # Powers of s in p(s) = c(s) - c''(s) / omega^2, then conversion to cubic Bernstein coefficients.
    powers_x = np.array([[1.0, 0, -down], [0, h, 0], [0, 0, h**2 / 2], [0, 0, 0]])
    powers_u = np.array([[0.0], [-down * h], [0], [h**3 / 6]])
    bernstein = np.array([[1.0, 0, 0, 0], [1, 1 / 3, 0, 0], [1, 2 / 3, 1 / 3, 0], [1, 1, 1, 1]])
    return _Model(
        A=np.array([[1, h, h**2 / 2], [0, 1, h], [0, 0, 1]]),
        B=np.array([[h**3 / 6], [h**2 / 2], [h]]),
        Zx=bernstein @ powers_x,
        Zu=bernstein @ powers_u,
        terminal={"rest": np.array([[0.0, 1, 0], [0, 0, 1]]), "captured": np.array([[0.0, 1 / omega, down]])},
    )


_MODELS = {"zmp_rate": _zmp_rate_model, "jerk": _jerk_model}


class _Unknowns:
    """Named blocks of one vector of variables; ``pick`` returns the sparse matrix that selects a block."""

    def __init__(self, sizes: Mapping[str, Sequence[int]]) -> None:
        keys = [(name, k) for name, each in sizes.items() for k in range(len(each))]
        lengths = [size for each in sizes.values() for size in each]
        starts = np.concatenate([[0], np.cumsum(lengths)])
        self._columns = {
            key: np.arange(a, b) for key, a, b in zip(keys, starts[:-1], starts[1:], strict=True)
        }
        self._identity = sparse.eye_array(int(starts[-1]), format="csr")

    def pick(self, name: str, k: int) -> sparse.csr_array:
        """Return the rows of the identity that select block k of that name."""
        return self._identity[self._columns[name, k]]


class _Assembly:
    """Rows, cost and motion of a program; Kronecker products treat both axes at once."""

    def __init__(self, program: CenterOfMassProgram) -> None:
        self.program, plan = program, program.plan
        counts = [
            max(1, math.ceil(support.duration / program.step - COUNT_SLACK)) for support in plan.supports
        ]
        self.support_of = np.repeat(np.arange(len(counts)), counts)
        self.steps = np.repeat([s.duration / n for s, n in zip(plan.supports, counts, strict=True)], counts)
        self.n = len(self.steps)
        self.vertices = [support_vertices(program.robot, s, program.shrink) for s in plan.supports]
        apart = [not a.feet.keys() & b.feet.keys() for a, b in pairwise(plan.supports)]
        jumps = np.cumsum(counts)[:-1][apart]
        self.jump_at = {int(k): i for i, k in enumerate(jumps)}
        model = _MODELS[program.control]
        made = {h: model(program.pendulum.omega, float(h)) for h in np.unique(self.steps)}
        self.models = [made[h] for h in self.steps]
        corners = [len(self.models[0].Zu) * len(self.vertices[i]) for i in self.support_of]
        self.unknowns = _Unknowns(
            {"x": [6] * (self.n + 1), "u": [2] * self.n, "jump": [2] * len(jumps), "w": corners}
        )

    def _zmp(self, k: int) -> sparse.csr_array:
        """Return the matrix (2 n, variables) of the ZMP coefficients of interval k."""
        model, pick = self.models[k], self.unknowns.pick
        return _both(model.Zx) @ pick("x", k) + _both(model.Zu) @ pick("u", k)

    def rows(self) -> tuple[sparse.csc_matrix, np.ndarray, np.ndarray]:
        """Return rows and their bounds: dynamics, ZMP in the convex hull, start and end."""
        pick, program = self.unknowns.pick, self.program
        blocks, lower, upper = [], [], []

        def add(block: sparse.csr_array, low: np.ndarray | float, high: np.ndarray | float) -> None:
            blocks.append(block)
            lower.append(np.broadcast_to(low, block.shape[0]))
            upper.append(np.broadcast_to(high, block.shape[0]))

        start = np.concatenate([program.com_start, program.velocity_start])
        add(pick("x", 0)[:4], start, start)
        for k, model in enumerate(self.models):
            following = pick("x", k + 1) - _both(model.A) @ pick("x", k) - _both(model.B) @ pick("u", k)
            if k + 1 in self.jump_at:
                following -= _both(np.eye(3)[:, 2:]) @ pick("jump", self.jump_at[k + 1])
            add(following, 0.0, 0.0)
            vertices, points = self.vertices[self.support_of[k]], len(model.Zu)
            weights, each = pick("w", k), sparse.eye_array(points)
            add(self._zmp(k) - sparse.kron(each, vertices.T) @ weights, 0.0, 0.0)
            add(sparse.kron(each, np.ones((1, len(vertices)))) @ weights, 1.0, 1.0)
            add(weights, 0.0, np.inf)
        add(_both(self.models[-1].terminal[program.terminal]) @ pick("x", self.n), 0.0, 0.0)
        return sparse.csc_matrix(sparse.vstack(blocks)), np.concatenate(lower), np.concatenate(upper)

    def cost(self) -> tuple[sparse.csc_matrix, np.ndarray]:
        """Return the Hessian (upper triangle) and gradient of the cost."""
        pick, program = self.unknowns.pick, self.program
        scale = 1.0 if program.control == "zmp_rate" else 1 / program.pendulum.omega**4
        hessian, gradient = 0.0, 0.0
        for k, h in enumerate(self.steps):
            zmp, share = self._zmp(k), h / self.steps.sum()
            points = len(self.models[k].Zu)
            middle = np.tile(self.vertices[self.support_of[k]].mean(axis=0), points)
            hessian += 2 * share / points * (zmp.T @ zmp)
            hessian += 2 * share * scale * program.smoothing**2 * (pick("u", k).T @ pick("u", k))
            gradient -= 2 * share / points * (zmp.T @ middle)
        return sparse.csc_matrix(sparse.triu(hessian)), np.asarray(gradient)

    def motion(self, z: np.ndarray) -> ComMotion:
        """Return the motion for the variables z."""
        times = np.concatenate([[0.0], np.cumsum(self.steps)])
        states = np.array([self.unknowns.pick("x", k) @ z for k in range(self.n + 1)]).reshape(-1, 3, 2)
        inputs = np.array([self.unknowns.pick("u", k) @ z for k in range(self.n)])
        pendulum = self.program.pendulum
        if self.program.control == "jerk":
            return CubicMotion(pendulum=pendulum, times=times, states=states[:-1], jerk=inputs)
        first = states[:-1, 2]
        return PendulumMotion(
            pendulum=pendulum,
            times=times,
            zmp=np.stack([first, first + self.steps[:, None] * inputs], axis=1),
            com_start=self.program.com_start,
            dcm_end=pendulum.capture_point(states[-1, 0], states[-1, 1]),
        )


def _both(matrix: np.ndarray) -> sparse.csr_array:
    """Apply a matrix to both horizontal axes, which alternate in every vector."""
    return sparse.csr_array(sparse.kron(matrix, np.eye(2)))
