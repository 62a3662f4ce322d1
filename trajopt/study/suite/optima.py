"""Number of optima that the solved runs of one problem have found, by objective and by motion.

A run's motion is its configuration at `SAMPLES` equally spaced times, in coordinates whose differences are
distances: base positions in robot lengths, rotations as the entries of their matrices, cosine and sine of
joints without limits, other joints in rad. The distance of two motions is their largest difference.

Two runs have *one optimum* unless their objectives differ by more than `SAME_OBJECTIVE` and their motions by
more than `SAME_MOTION`: objectives alone would count the noise of a flat minimum, motions alone would count
mirror images and motions that the costs do not determine. They have *one motion* if both agree; there are at
least as many motions as optima. Chains of such pairs form the groups.
"""

import base64
from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from scipy import sparse
from scipy.spatial.transform import Rotation

from trajopt.dynamics.manifold import Coordinates
from trajopt.motion.configurations import geodesic_configurations
from trajopt.motion.solution import Solution
from trajopt.robot.building import reach

SAMPLES = 11
# Relative to the larger objective. With a tolerance of 1e-6 on optimality, differences are 1e-7 and less.
SAME_OBJECTIVE = 1e-4
# Lengths, rad: two solves of one optimum at a tolerance of 1e-6 differ by a thousandth of this.
SAME_MOTION = 1e-2
# Objectives nearer to zero than this count as zero: those of pure feasibility problems.
NOTHING = 1e-9


def described(solution: Solution) -> str:
    """Encode a motion as text for a record; empty if it is not finite."""
    times = np.linspace(float(solution.t[0]), float(solution.t[-1]), SAMPLES)
    if not np.isfinite(solution.q).all():
        return ""
    values = np.array([embedded(solution.model, q) for q in geodesic_configurations(solution, times)])
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")


def embedded(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """A configuration (nq,) in coordinates whose differences are distances, see the module."""
    length, parts = reach(model) or 1.0, []
    for joint in Coordinates(model).joints:
        values = q[joint.q]
        if joint.kind == "freeflyer":
            parts += [values[:3] / length, Rotation.from_quat(values[3:]).as_matrix().ravel()]
        elif joint.kind == "spherical":
            parts.append(Rotation.from_quat(values).as_matrix().ravel())
        elif joint.kind == "planar":
            parts += [values[:2] / length, values[2:]]
        else:
            parts.append(values)
    return np.concatenate(parts)


def distances(motions: Sequence[str]) -> np.ndarray:
    """Distances (n, n) of motions from `described`; NaN where one is unknown, or of another robot."""
    values = [np.frombuffer(base64.b64decode(motion), dtype="<f4") for motion in motions]
    matrix = np.full((len(values), len(values)), np.nan)
    for i, one in enumerate(values):
        for j, other in enumerate(values[: i + 1]):
            if len(one) and len(one) == len(other):
                matrix[i, j] = matrix[j, i] = float(np.abs(one - other).max())
    return matrix


def counted(objectives: Sequence[float], motions: Sequence[str]) -> tuple[int, int]:
    """Numbers of optima and motions of solved runs; runs without a motion are grouped by objective."""
    if not objectives:
        return 0, 0
    value = np.asarray(objectives, dtype=float)
    scale = np.maximum(np.abs(value)[:, None], np.abs(value)[None, :])
    same_objective = np.abs(value[:, None] - value[None, :]) <= np.maximum(SAME_OBJECTIVE * scale, NOTHING)
    apart = distances(motions)
    same_motion = np.where(np.isnan(apart), same_objective, apart <= SAME_MOTION)
    return _groups(same_objective | same_motion), _groups(same_objective & same_motion)


def _groups(linked: np.ndarray) -> int:
    return int(sparse.csgraph.connected_components(sparse.csr_matrix(linked), directed=False)[0])
