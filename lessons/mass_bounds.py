"""Bounds of the mass matrix, lowest I <= M(q) <= highest I, over given postures and over all postures.

Eigenvalues of M mix kg, kg m and kg m^2 if joints both translate and rotate, or with a floating base. They
are the bounds of ``v^T M v`` for unit v in SI units.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import position_limits
from trajopt.dynamics.model_content import joint_kind
from trajopt.dynamics.model_quantities import mass_matrix_at
from trajopt.errors import InputError

# Numbers of translational and rotational directions by kind of joint, by the beginning of its name.
_DIRECTIONS = {
    "FreeFlyer": (3, 3),
    "Planar": (2, 1),
    "Spherical": (0, 3),  # and SphericalZYX
    "Translation": (3, 0),
    "R": (0, 1),  # every revolute and continuous joint
    "P": (1, 0),  # every prismatic joint
}


@dataclass(frozen=True, kw_only=True)
class EigenvalueRange:
    """Extreme eigenvalues of M over postures, and the postures (nq,) at which they occur."""

    lowest: float
    highest: float
    lowest_posture: np.ndarray
    highest_posture: np.ndarray


@dataclass(frozen=True, kw_only=True)
class MassBounds:
    """Bounds ``lower <= every eigenvalue of M(q) <= upper`` for every posture."""

    lower: float
    upper: float


def eigenvalue_range(model: pin.Model, postures: np.ndarray) -> EigenvalueRange:
    """Return extreme eigenvalues of M over ``postures`` (n, nq), n > 0; else raises `InputError`."""
    postures = np.asarray(postures, dtype=float)
    if postures.ndim != 2 or postures.shape[1] != model.nq or not len(postures):
        raise InputError(f"postures have shape {postures.shape}", f"shape (n, {model.nq}), n > 0")
    values = np.array([np.linalg.eigvalsh(mass_matrix_at(model, q)) for q in postures])
    low, high = int(values[:, 0].argmin()), int(values[:, -1].argmax())
    return EigenvalueRange(
        lowest=float(values[low, 0]),
        highest=float(values[high, -1]),
        lowest_posture=postures[low].copy(),
        highest_posture=postures[high].copy(),
    )


def random_postures(model: pin.Model, count: int, seed: int) -> np.ndarray:
    """Return postures within the position limits, uniform in coordinates.

    Rotations without limits are drawn within half a turn of neutral. A base that translates without limits
    stays at neutral, since M does not depend on its pose.

    Args:
        model: Model of any robot.
        count: Number of postures.
        seed: Seed of the random numbers.

    Returns:
        (count, nq).

    Raises:
        InputError: If an unlimited prismatic joint is behind a rotating one, since no interval is natural.
    """
    generator = np.random.default_rng(seed)
    lowest, highest = np.full(model.nv, -np.pi), np.full(model.nv, np.pi)
    lower, upper = position_limits(model)
    neutral = pin.neutral(model)
    for index in range(1, model.njoints):
        joint, (sliding, _) = model.joints[index], _directions(model, index)
        rows, entries = slice(joint.idx_v, joint.idx_v + joint.nv), slice(joint.idx_q, joint.idx_q + joint.nq)
        if joint.nq == joint.nv and np.isfinite([lower[entries], upper[entries]]).all():
            lowest[rows], highest[rows] = lower[entries] - neutral[entries], upper[entries] - neutral[entries]
        elif sliding and _is_turned(model, index):
            raise _unlimited(model, index)
        elif sliding:  # including its angles: M does not depend on the base's pose
            lowest[rows], highest[rows] = 0.0, 0.0
    steps = generator.uniform(lowest, highest, (count, model.nv))
    return np.array([pin.integrate(model, neutral, step) for step in steps]).reshape(count, model.nq)


def a_priori_bounds(model: pin.Model) -> MassBounds:
    """Return bounds of M's eigenvalues for all postures, from masses, lever arms and inertias alone.

    Let ``r_jL`` be the longest possible distance from joint j to the centre of mass of link L (the sum of the
    lengths and of the travel of prismatic joints between them). Since the largest eigenvalue is at most the
    trace, the upper bound is

        lambda_max <= sum_L [ m_L sum_j (sliding_j + turning_j r_jL^2) + lambda_max(I_L) sum_j turning_j ]
                      + max armature

    over the joints j that carry L. The pivots of M are at least each link's own inertia in its joint, since
    articulated inertias only add, so that ``lambda_min >= det M ((n - 1) / tr M)^(n - 1)``. The smallest
    armature is another lower bound. A link without armature and without inertia about its own joint gives 0.
    Constant bounds exist for revolute joints; a prismatic joint behind a rotating one needs position limits.
    Raises `InputError` without these, and for a model without joints.
    """
    if not model.nv:
        raise InputError(f"the model '{model.name}' has no joints", "at least one")
    links = _largest_trace(model)
    trace, n = links + float(model.armature.sum()), model.nv
    pivots = [_own_inertia(model, index) for index in range(1, model.njoints)]
    signs, logarithms = zip(*(np.linalg.slogdet(pivot) for pivot in pivots), strict=True)
    spread = (n - 1) * np.log((n - 1) / trace) if n > 1 else 0.0
    from_pivots = float(np.exp(sum(logarithms) + spread)) if min(signs) > 0 else 0.0
    return MassBounds(
        lower=max(from_pivots, float(model.armature.min())), upper=links + float(model.armature.max())
    )


def _largest_trace(model: pin.Model) -> float:
    """Return an upper bound of the trace of M without armature."""
    total = 0.0
    for link in range(1, model.njoints):
        inertia = model.inertias[link]
        distance = float(np.linalg.norm(inertia.lever))
        moment = float(np.linalg.eigvalsh(inertia.inertia)[-1])
        for joint in reversed(list(model.supports[link])[1:]):
            sliding, turning = _directions(model, joint)
            total += inertia.mass * (sliding + turning * distance**2) + moment * turning
            distance += float(np.linalg.norm(model.jointPlacements[joint].translation))
            distance += _travel(model, joint) if sliding and _is_turned(model, joint) else 0.0
    return total


def _own_inertia(model: pin.Model, index: int) -> np.ndarray:
    """Return the inertia of a joint's own link in its directions, with armature: at most the pivot of M."""
    joint = model.joints[index]
    armature = np.diag(model.armature[joint.idx_v : joint.idx_v + joint.nv])
    if joint_kind(model, index) == "SphericalZYX":  # its axes depend on the posture and may align
        return armature
    data = joint.createData()
    joint.calc(data, pin.neutral(model)[joint.idx_q : joint.idx_q + joint.nq])
    subspace = np.reshape(np.asarray(data.S), (6, -1), order="F")
    return subspace.T @ model.inertias[index].matrix() @ subspace + armature


def _directions(model: pin.Model, index: int) -> tuple[int, int]:
    kind = joint_kind(model, index)
    return next(directions for name, directions in _DIRECTIONS.items() if kind.startswith(name))


def _is_turned(model: pin.Model, index: int) -> bool:
    """Return whether a joint before this one rotates, so that M depends on this one's displacement."""
    return any(_directions(model, before)[1] for before in list(model.supports[index])[1:-1])


def _travel(model: pin.Model, index: int) -> float:
    """Return the largest distance from zero within a prismatic joint's limits, m."""
    joint, (lower, upper) = model.joints[index], position_limits(model)
    entries = slice(joint.idx_q, joint.idx_q + joint.nq)
    farthest = np.maximum(np.abs(lower[entries]), np.abs(upper[entries]))
    if not np.isfinite(farthest).all():
        raise _unlimited(model, index)
    return float(np.linalg.norm(farthest))


def _unlimited(model: pin.Model, index: int) -> InputError:
    return InputError(
        f"joint '{model.names[index]}' slides without position limits, so M has no bound",
        "finite position limits, or lock the joint",
    )
