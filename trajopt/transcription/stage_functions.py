"""Values and derivatives of all terms at one point, by a chain rule that keeps the graph small.

With z the inputs of the point, o = R(z) the robot's functions that terms use, and the terms
L(z, o, p), phi(z, o, p), let gamma = sigma L + lambda^T phi and J = dR/dz. Then

    d phi / dz = phi_z + phi_o J
    d2 gamma / dz2 = sum_i gamma_oi R_i'' + gamma_zz + gamma_zo J + J^T gamma_oz + J^T gamma_oo J

so the robot's graph is differentiated once, with gamma_o as its multipliers, whatever the terms. A
squared torque costs a sparse outer product of rows of J instead of a second derivative of a
square of the whole inverse dynamics.

R itself is a chain of layers, R = R_n o ... o R_1 (local coordinates to body rates, world to body
axes, rigid-body algorithm), differentiated one by one: with D_k the Jacobian of layer k, going
back from H = gamma_oo and mu = gamma_o,

    H <- D_k^T H D_k + sum_i mu_i R_k,i'',      mu <- D_k^T mu

Gauss-Newton's Hessian of costs that are weighted squares, sum_i w_i r_i(z, o)^2, keeps only the slopes of the
residuals, whatever the rows: 2 sigma (r_z + r_o J)^T diag(w) (r_z + r_o J), which is positive semidefinite.

Expressions that occur several times are left as they are: CasADi takes four times as long to find them as for
all the rest, the engine's tapes a few milliseconds.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca

from trajopt.terms.context import Context
from trajopt.transcription.robot_layers import robot_layers

KEPT_LAYERS = 32  # whose derivatives are kept: those of all points of a problem, which share most of them


@dataclass(frozen=True)
class PointFunction:
    """Terms of one point as a graph in layers, not yet differentiated.

    ``layers`` map `robot_inputs` to o, one after the other; ``terms`` maps (z, o, p) to (L, phi). All are
    small to build, so their serialised text names the derivatives in the cache. ``squares`` maps (z, o, p)
    to the residuals r and weights w of the costs that are squares; None where there are no costs.
    """

    name: str
    layers: tuple[ca.Function, ...]
    terms: ca.Function
    squares: ca.Function | None = None

    @property
    def n_rows(self) -> int:
        """Number of rows phi."""
        return self.terms.numel_out(1)

    @property
    def n_z(self) -> int:
        """Number of inputs z."""
        return self.terms.numel_in(0)

    def robot_inputs(self, z: Any, p: Any) -> Any:
        """Inputs of the first layer: z, and the parameters that are known wrenches, which come first."""
        n_given = self.layers[0].numel_in(0) - self.n_z if self.layers else 0
        return ca.vertcat(z, p[:n_given, :])  # p[:0] of one entry would be (1, 0)

    @cached_property
    def text(self) -> str:
        """Serialised graph, equal for equal graphs."""
        rest = [self.terms, *([] if self.squares is None else [self.squares])]
        return "\n".join([*map(_text, self.layers), *(function.serialize() for function in rest)])


def point_function(name: str, context: Context, cost: ca.SX, rows: Sequence[ca.SX]) -> PointFunction:
    """Join terms written over a context's symbols with the robot's functions."""
    phi = ca.vertcat(*rows) if rows else ca.SX(0, 1)
    o, layers = robot_layers(context, ca.vertcat(cost, phi))
    inputs = [context.z, o, context.parameters]
    terms = ca.Function("terms", inputs, [cost, ca.densify(phi)])
    return PointFunction(name, layers, terms, ca.Function("squares", inputs, list(context.squares)))


@lru_cache(maxsize=KEPT_LAYERS)
def _text(layer: ca.Function) -> str:
    return str(layer.serialize())


@lru_cache(maxsize=KEPT_LAYERS)
def _jacobian(layer: str) -> ca.Function:
    """Jacobian of a serialised layer, s -> dR/ds."""
    function = ca.Function.deserialize(layer)
    s = ca.SX.sym("s", function.numel_in(0))
    return ca.Function("jacobian", [s], [ca.jacobian(function(s), s)])


@lru_cache(maxsize=KEPT_LAYERS)
def _curvature(layer: str) -> ca.Function:
    """Second derivative of a serialised layer, (s, mu) -> sum_i mu_i R_i''."""
    function = ca.Function.deserialize(layer)
    s, mu = ca.SX.sym("s", function.numel_in(0)), ca.SX.sym("mu", function.numel_out(0))
    return ca.Function("curvature", [s, mu], [ca.hessian(ca.dot(mu, function(s)), s)[0]])


class _Chain:
    """Values s_k and Jacobians D_k of layers, as expressions; ``inputs`` are z (n_z,) and constants."""

    def __init__(self, layers: Sequence[ca.Function], inputs: ca.SX, n_z: int) -> None:
        self.layers, self.n_z, self.values, self.jacobians = layers, n_z, [inputs], []
        for layer in layers:
            self.jacobians.append(ca.sparsify(_jacobian(_text(layer))(self.values[-1])))
            self.values.append(layer(self.values[-1]))

    @property
    def output(self) -> ca.SX:
        """The last layer's value, o; empty without layers."""
        return self.values[-1] if self.layers else ca.SX(0, 1)

    def total_jacobian(self) -> ca.SX:
        """Jacobian of the whole chain, do/dz."""
        total = ca.SX.eye(self.values[0].numel())[:, : self.n_z] if self.layers else ca.SX(0, self.n_z)
        for jacobian in self.jacobians:
            total = ca.mtimes(jacobian, total)
        return total

    def curvature(self, multiplier: ca.SX, hessian: ca.SX) -> ca.SX:
        """Second derivative in z of multiplier^T o + 1/2 o^T hessian o (both constant)."""
        if not self.layers:
            return ca.SX(self.n_z, self.n_z)
        for layer, value, jacobian in zip(
            reversed(self.layers), reversed(self.values[:-1]), reversed(self.jacobians), strict=True
        ):
            second = ca.sparsify(_curvature(_text(layer))(value, multiplier))
            hessian = ca.mtimes(ca.mtimes(jacobian.T, hessian), jacobian) + second
            hessian = ca.tril2symm(ca.tril(hessian))  # the graph of its upper triangle is dropped
            multiplier = ca.mtimes(jacobian.T, multiplier)
        return hessian[: self.n_z, : self.n_z]


class Derivatives:
    """Functions of one point that the engine evaluates, each built on first use."""

    def __init__(self, point: PointFunction) -> None:
        self._point = point
        self._z, self._o = ca.SX.sym("z", point.n_z), ca.SX.sym("o", point.terms.numel_in(1))
        self._p = ca.SX.sym("p", point.terms.numel_in(2))
        self._sigma, self._lam = ca.SX.sym("sigma"), ca.SX.sym("lam", point.n_rows)

    @cached_property
    def value(self) -> ca.Function:
        """(z, p) -> (L, phi)."""
        cost, phi = self._point.terms(self._z, self._chain.output, self._p)
        return ca.Function("value", [self._z, self._p], [cost, phi])

    @cached_property
    def first(self) -> ca.Function:
        """(z, p) -> (L, phi, dL/dz, dphi/dz)."""
        z, o, p, output = self._z, self._o, self._p, self._chain.output
        cost, phi = self._point.terms(z, o, p)
        slopes = [ca.gradient(cost, z), ca.gradient(cost, o), ca.jacobian(phi, z), ca.jacobian(phi, o)]
        cost_z, cost_o, phi_z, phi_o = ca.Function("terms_first", [z, o, p], slopes)(z, output, p)
        values = self._point.terms(z, output, p)
        gradient = ca.densify(cost_z + ca.mtimes(self._jacobian.T, cost_o))
        rows = phi_z + ca.mtimes(phi_o, self._jacobian)
        return ca.Function("first", [z, p], [*values, gradient, rows])

    @cached_property
    def second(self) -> ca.Function:
        """(z, p, sigma, lambda) -> lower triangle of d2 gamma / dz2."""
        z, p, sigma, lam = self._z, self._p, self._sigma, self._lam
        cost, phi = self._point.terms(z, self._o, p)
        gamma, symbols = sigma * cost + ca.dot(lam, phi), (z, self._o, p, sigma, lam)
        hessian = _lagrangian_hessian(gamma, symbols, self._chain, self._jacobian)
        return ca.Function("second", [z, p, sigma, lam], [ca.tril(hessian)])

    @cached_property
    def gauss_newton(self) -> ca.Function:
        """(z, p, sigma, lambda) -> lower triangle of Gauss-Newton's Hessian, the same for all lambda."""
        z, o, p = self._z, self._o, self._p
        hessian = ca.SX(z.numel(), z.numel())
        if self._point.squares is not None and self._point.squares.numel_out(0):
            residuals, weights = self._point.squares(z, o, p)
            parts = [ca.jacobian(residuals, z), ca.jacobian(residuals, o), weights]
            r_z, r_o, w = ca.Function("squares_first", [z, o, p], parts)(z, self._chain.output, p)
            slope = r_z + ca.mtimes(r_o, self._jacobian)
            hessian = ca.mtimes(slope.T, ca.mtimes(ca.diag(2 * self._sigma * w), slope))
        inputs = [z, p, self._sigma, self._lam]
        return ca.Function("gauss_newton", inputs, [ca.tril(hessian)])

    @cached_property
    def _chain(self) -> _Chain:
        point = self._point
        return _Chain(point.layers, point.robot_inputs(self._z, self._p), point.n_z)

    @cached_property
    def _jacobian(self) -> ca.SX:
        return self._chain.total_jacobian()


def _lagrangian_hessian(gamma: ca.SX, symbols: tuple[ca.SX, ...], chain: _Chain, jacobian: ca.SX) -> ca.SX:
    z, o, p, sigma, lam = symbols
    n_z = z.numel()
    second, _ = ca.hessian(gamma, ca.vertcat(z, o))
    blocks = [ca.gradient(gamma, o), second[:n_z, :n_z], second[:n_z, n_z:], second[n_z:, n_z:]]
    multiplier, h_zz, h_zo, h_oo = ca.Function("terms_second", list(symbols), blocks)(
        z, chain.output, p, sigma, lam
    )
    cross = ca.mtimes(h_zo, jacobian)
    return chain.curvature(multiplier, h_oo) + h_zz + cross + cross.T
