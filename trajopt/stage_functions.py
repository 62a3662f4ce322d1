"""Values and derivatives of all terms at one point, by a chain rule that keeps the graph small.

With z the inputs of the point, o = R(z) the robot's functions that terms ask for, and the terms
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
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from trajopt.context import Context
from trajopt.robot_layers import robot_layers


@dataclass(frozen=True)
class PointFunction:
    """Terms of one point as a graph in layers, not yet differentiated.

    ``layers`` map z to o, one after the other; ``terms`` maps (z, o, p) to (L, phi). All are small to
    build, so their serialised text names the derivatives in the cache.
    """

    name: str
    layers: tuple[ca.Function, ...]
    terms: ca.Function

    @property
    def n_rows(self) -> int:
        """Number of rows phi."""
        return self.terms.numel_out(1)

    @property
    def n_z(self) -> int:
        """Number of inputs z."""
        return self.terms.numel_in(0)

    @cached_property
    def text(self) -> str:
        """Serialised graph, equal for equal graphs."""
        return "\n".join(function.serialize() for function in (*self.layers, self.terms))


def point_function(name: str, context: Context, cost: ca.SX, rows: Sequence[ca.SX]) -> PointFunction:
    """Join terms written over a context's symbols with the robot's functions."""
    phi = ca.vertcat(*rows) if rows else ca.SX(0, 1)
    o, layers = robot_layers(context, ca.vertcat(cost, phi))
    terms = ca.Function("terms", [context.z, o, context.parameters], [cost, ca.densify(phi)])
    return PointFunction(name, layers, terms)


@dataclass(frozen=True)
class Derivatives:
    """Functions of one point that the engine evaluates.

    ``value``: (z, p) -> (L, phi); ``first``: (z, p) -> (L, phi, dL/dz, dphi/dz);
    ``second``: (z, p, sigma, lambda) -> lower triangle of d2 gamma / dz2.
    """

    value: ca.Function
    first: ca.Function
    second: ca.Function


class _Chain:
    """Values s_k and Jacobians D_k of a chain of layers at z, as expressions."""

    def __init__(self, layers: Sequence[ca.Function], z: ca.SX) -> None:
        self.layers, self.values, self.jacobians = layers, [z], []
        for layer in layers:
            s = ca.SX.sym("s", layer.numel_in(0))
            jacobian = ca.Function("jacobian", [s], [ca.jacobian(layer(s), s)])
            self.jacobians.append(jacobian(self.values[-1]))
            self.values.append(layer(self.values[-1]))

    @property
    def output(self) -> ca.SX:
        """The last layer's value, o; empty without layers."""
        return self.values[-1] if self.layers else ca.SX(0, 1)

    def total_jacobian(self) -> ca.SX:
        """Jacobian of the whole chain, do/dz."""
        n_z = self.values[0].numel()
        total = ca.SX.eye(n_z) if self.layers else ca.SX(0, n_z)
        for jacobian in self.jacobians:
            total = ca.mtimes(jacobian, total)
        return total

    def curvature(self, multiplier: ca.SX, hessian: ca.SX) -> ca.SX:
        """Second derivative in z of multiplier^T o + 1/2 o^T hessian o (both constant)."""
        if not self.layers:
            return ca.SX(self.values[0].numel(), self.values[0].numel())
        for layer, value, jacobian in zip(
            reversed(self.layers), reversed(self.values[:-1]), reversed(self.jacobians), strict=True
        ):
            s, mu = ca.SX.sym("s", value.numel()), ca.SX.sym("mu", multiplier.numel())
            own, _ = ca.hessian(ca.dot(mu, layer(s)), s)
            own = ca.Function("curvature", [s, mu], [own])(value, multiplier)
            hessian = _mirrored(ca.mtimes(ca.mtimes(jacobian.T, hessian), jacobian) + own)
            multiplier = ca.mtimes(jacobian.T, multiplier)
        return hessian


def _mirrored(symmetric: ca.SX) -> ca.SX:
    """The same matrix with its upper triangle taken from the lower: the upper's graph is dropped."""
    return ca.tril2symm(ca.tril(symmetric))


def derivatives(point: PointFunction) -> Derivatives:
    """Differentiate a point function by the chain rule of this module."""
    z, o = ca.SX.sym("z", point.n_z), ca.SX.sym("o", point.terms.numel_in(1))
    p = ca.SX.sym("p", point.terms.numel_in(2))
    sigma, lam = ca.SX.sym("sigma"), ca.SX.sym("lam", point.n_rows)
    chain = _Chain(point.layers, z)
    jacobian = chain.total_jacobian()

    cost, phi = point.terms(z, o, p)
    terms_first = ca.Function(
        "terms_first",
        [z, o, p],
        [ca.gradient(cost, z), ca.gradient(cost, o), ca.jacobian(phi, z), ca.jacobian(phi, o)],
    )
    cost_z, cost_o, phi_z, phi_o = terms_first(z, chain.output, p)
    cost_value, phi_value = point.terms(z, chain.output, p)
    gradient = ca.densify(cost_z + ca.mtimes(jacobian.T, cost_o))
    rows = phi_z + ca.mtimes(phi_o, jacobian)
    hessian = _lagrangian_hessian(sigma * cost + ca.dot(lam, phi), (z, o, p, sigma, lam), chain, jacobian)
    cse = {"cse": True}
    return Derivatives(
        ca.Function("value", [z, p], [cost_value, phi_value], cse),
        ca.Function("first", [z, p], [cost_value, phi_value, gradient, rows], cse),
        ca.Function("second", [z, p, sigma, lam], [ca.tril(hessian)], cse),
    )


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
