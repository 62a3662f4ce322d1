"""Whether a periodic plan closes: its last state against the image of its first, by numeric Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import base_of
from trajopt.robot.mirror import signed
from trajopt.solution.solution import Solution


def periodicity_error(plan: Solution) -> float | None:
    """Largest difference (m, rad, m/s, rad/s) of the last state from the first's image; None if not periodic.

    The key ``periodicity`` of meta says what the image is: ``translation`` m or ``velocity`` m/s times the
    duration, ``turn`` rad about the vertical through ``origin``, ``mirror`` in the plane y = origin, and for
    each row of v the ``index`` and ``sign`` of the row that it comes from.
    """
    described = plan.meta.get("periodicity")
    if not described:
        return None
    q, v = periodic_image(plan.model, described, plan.q[0], plan.v[0], float(plan.t[-1] - plan.t[0]))
    apart = pin.difference(plan.model, q, plan.q[-1])
    return float(max(np.abs(apart).max(), np.abs(v - plan.v[-1]).max()))


def periodic_image(
    model: pin.Model, described: dict[str, Any], q: np.ndarray, v: np.ndarray, duration: float
) -> tuple[np.ndarray, np.ndarray]:
    """Image of a state (nq,), (nv,), or of n (n, nq), (n, nv), under a described periodicity."""
    index, sign = np.array(described["index"], dtype=int), np.array(described["sign"], dtype=float)
    moved = _translation(described, duration)
    turn, origin = float(described["turn"]), np.array(described["origin"], dtype=float)
    found = q.copy()
    for joint in list(model.joints)[1:]:
        if joint.nv == 1:
            other = next(own for own in list(model.joints)[1:] if own.idx_v == index[joint.idx_v])
            found[..., joint.idx_q : joint.idx_q + joint.nq] = signed(
                q[..., other.idx_q : other.idx_q + other.nq], sign[joint.idx_v]
            )
    base = base_of(model)
    if base == "freeflyer":
        rotation = pin.utils.rotate("z", turn)
        position = q[..., :3] * sign[:3] + (1 - sign[:3]) * origin
        found[..., :3] = origin + (position - origin) @ rotation.T + moved
        mirrored = q[..., 3:7] * ([-1.0, 1.0, -1.0, 1.0] if described["mirror"] else np.ones(4))
        found[..., 3:7] = mirrored @ _turning(turn).T
    elif base == "planar":
        found[..., :2] += moved[[0, 2]]
    elif base == "virtual":
        found[..., :3] += moved
    return found, sign * v[..., index]


def _turning(turn: float) -> np.ndarray:
    """Matrix (4, 4) that turns quaternions (x, y, z, w) by ``turn`` rad about the world's vertical."""
    c, s = np.cos(turn / 2), np.sin(turn / 2)
    return np.array([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, c, s], [0.0, 0.0, -s, c]])


def _translation(described: dict[str, Any], duration: float) -> np.ndarray:
    if described["velocity"] is not None:
        return np.array(described["velocity"], dtype=float) * duration
    given = described["translation"]
    return np.zeros(3) if given is None else np.array(given, dtype=float)
