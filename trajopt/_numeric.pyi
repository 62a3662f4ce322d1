"""Numeric Pinocchio and Coal, compiled: sources of `_numeric` in CMakeLists.txt."""

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Reals = NDArray[np.float64]

def sampled(
    model: pin.Model, frames: list[int], q: Reals, v: Reals, a: Reals, wrenches: Reals
) -> tuple[Reals, Reals]:
    """Generalised forces (K, nv), RNEA(q, v, a) - sum J^T f, and the motion (K n, 24) of n frames.

    Rotation, row by row, place, velocity and classical acceleration, as ``wrenches`` (K, 6 n) in world axes
    at the frames' origins, linear rows first.
    """

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

    def load(self, number: int, frame: int, point: Reals, fractions: Reals, wrenches: Reals) -> None:
        """Wrench ``number`` of later integrations, (n, 6) at n fractions of them, at a point of a frame."""

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

class Bodies:
    """Convex bodies on frames of a model, or in the world, and half-spaces."""

    def __init__(self, model: pin.Model) -> None: ...
    def add(self, solid: Any, frame: int, place: Reals, points: Reals, radius: float, planes: Reals) -> int:
        """Add all within ``radius`` m of the hull of ``points`` (n, 3) m on a frame, -1: world; its number.

        solid: Coal's body, at ``place`` (3, 4) in the frame; None for a half-space. planes: (m, 4) outward
        unit normals and offsets of its faces, world, where it is ground; else (0, 4).
        """

    def placements(self, q: Reals) -> Reals:
        """Rotations, row by row, and origins (K n, 12) of the frames of n bodies at ``q`` (K, nq)."""

    def distances(self, q: Reals, pairs: list[tuple[int, int]], within: Reals) -> Reals:
        """Signed distances (K, p) m of pairs of bodies; lower bounds of those > ``within`` (p,) m.

        Neighbours in time have almost the same normal, and how far apart bodies are along it is a bound.
        """

    def witnesses(self, q: Reals, rows: list[int], pairs: list[tuple[int, int]]) -> Reals:
        """Distance, normal and nearest points (w, 10) of pairs, each at a row of ``q``; see `Witness`."""
