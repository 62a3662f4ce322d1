"""Numeric Pinocchio, compiled: dynamics/numeric.cpp, certify/integrator.cpp, robot/inverse_kinematics.cpp."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Reals = NDArray[np.float64]

class Method:
    """Coefficients of an explicit Runge-Kutta method of n stages: (n, n) below the diagonal, else (n,)."""

    def __init__(
        self, nodes: Reals, matrix: Reals, weights: Reals, error_5: Reals, error_3: Reals
    ) -> None: ...

class Dynamics:
    """Forward dynamics of a model whose frames hold their place, slide or roll: see `contact_response`.

    dimensions: rows of each frame, 3 or 6. arm: m, by which rotations are compared with positions.
    """

    def __init__(self, model: pin.Model, frames: list[int], dimensions: list[int], arm: float) -> None: ...
    @property
    def redundant(self) -> list[int]:
        """Rows that depend on others at the last state; a sliding contact has one row, of its normal."""

    def slide(self, number: int, normal: Reals, friction: float, slip: float) -> None:
        """Contact ``number``, a point, slides: see `trajopt.certify.sliding.SlidingDynamics`."""

    def roll(self, number: int, lever: Reals) -> None:
        """Contact ``number``, a point, is the centre of a ball that rolls, ``lever`` (3,) m off its plane."""

    def accelerations(self, q: Reals, v: Reals, force: Reals) -> Reals:
        """Accelerations (n, nv) at n states under forces (n, nv); NaN where the mass matrix is singular."""

    def integrate(
        self,
        method: Method,
        q: Reals,
        v: Reals,
        coefficients: Reals,
        actuation: Reals,
        duration: float,
        relative: float,
        absolute: float,
        evaluations: int,
    ) -> tuple[bool, tuple[Reals, Reals]]:
        """Whether it stays finite, and the state (q, v) at the end.

        From (q, v) under the generalised force (nv,) ``actuation @ coefficients.T @ [1, t, t^2, ...]``, t
        from 0 to 1 over ``duration`` s. Local errors are bounded as in `runge_kutta.integrate`, evaluations
        of the dynamics by ``evaluations``.
        """

class InverseKinematics:
    """Search of postures by damped Gauss-Newton within position limits.

    lower, upper: (nq,). projection: (nv, nv) onto rates with which joints follow others, (0, 0) for none;
    followers: (n, 4) rows of q of the one that follows and of the one it follows, ratio and offset.
    """

    def __init__(
        self, model: pin.Model, lower: Reals, upper: Reals, projection: Reals, followers: Reals
    ) -> None: ...
    def search(
        self,
        q: Reals,
        frames: list[int],
        poses: Reals,
        sizes: list[int],
        movable: list[int],
        tolerance: float,
    ) -> tuple[Reals, float]:
        """Posture near ``q`` (nq,) and the norm of its errors, m and rad.

        poses: (n, 12) rotation, row by row, and place of each frame's target. sizes: 6, or 3 for the place
        alone. movable: rows of v.
        """
