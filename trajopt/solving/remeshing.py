"""Choose a mesh that meets an error target, by splitting intervals or raising the degree of a phase.

The local error of an interval of width h with s points is modelled as its quadrature error

    e = L c_s x^(p + 1),      x = h / l,      c_s: `Scheme.error_constant`

with the robot's length L and the local time scale l of the motion, which follows from the measured e. Split
into k parts with s' points each, the interval has the error k L c_s' (x / k)^(p' + 1). The error of a phase
is the sum of its local errors times the measured growth. Among the degrees and splits that meet the target by
this model, the one with the fewest variables is chosen. The number of parts grows with e^(1 / (p + 1)), which
distributes the error evenly (de Boor, "Good approximation by splines with variable knots", 1973).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajopt.transcription.mesh import Mesh, PhaseMesh
from trajopt.transcription.schemes import Scheme

# Fraction of the target that the model aims at, since its growth and time scale are estimates.
TARGET_SHARE = 0.5
# Largest number of parts per interval and round: errors on a coarse mesh predict a fine one only roughly.
MOST_PARTS = 4
# If a phase diverges, its growth is unknown; its local errors are then reduced to this fraction.
DIVERGED_SHARE = 1e-2
# Smallest local error above rounding, over the robot's length.
ROUNDING = 1e-15


@dataclass(frozen=True, kw_only=True)
class PhaseErrors:
    """Errors of a phase: ``local`` (n,) m of its intervals, ``phase`` of the whole over its tolerance.

    ``unknowns`` is the number of variables per node and per collocation point.
    """

    local: np.ndarray
    phase: float
    unknowns: tuple[int, int]


def remeshed(
    mesh: Mesh,
    errors: Sequence[PhaseErrors],
    broken: np.ndarray,
    length: float,
    raise_degree: bool = True,
) -> Mesh:
    """Return the mesh for the next round of a motion that exceeds its tolerances.

    Phases whose error is above one are remeshed by their local errors. ``broken`` (I,) is the largest ratio
    of a figure to its tolerance in each interval; intervals above one are split at least in two.
    """
    phases, ends = [], np.cumsum(mesh.counts)
    parts = np.where(broken > 1, np.clip(np.ceil(np.sqrt(broken)), 2, MOST_PARTS), 1).astype(int)
    for phase, error, split in zip(mesh.phases, errors, np.split(parts, ends[:-1]), strict=True):
        if error.phase <= 1:
            phases.append(phase.split(split.tolist()) if split.max() > 1 else phase)
        else:
            phases.append(_remeshed_phase(phase, error, split, length, raise_degree))
    return Mesh(phases=tuple(phases))


def _remeshed_phase(
    mesh: PhaseMesh, errors: PhaseErrors, least: np.ndarray, length: float, raise_degree: bool
) -> PhaseMesh:
    local = np.clip(errors.local, ROUNDING * length, length)
    wanted = TARGET_SHARE / errors.phase if math.isfinite(errors.phase) else DIVERGED_SHARE
    allowed = wanted * float(local.sum())
    node, point = errors.unknowns
    finer, candidates = mesh.method.finer if raise_degree else None, []
    for method in (mesh.method,) if finer is None else (mesh.method, finer):
        single = _errors_of(local, mesh.method, method, length)
        parts = np.maximum(_parts(single, method.order, allowed), least)
        met = float((single * parts ** -float(method.order)).sum()) <= allowed
        size = int(parts.sum()) * (node + method.s * point)
        candidates.append((not met, size, method.name, parts))
    _, _, name, parts = min(candidates, key=lambda candidate: candidate[:2])
    return mesh.with_scheme(name).split(parts.tolist())


def _errors_of(local: np.ndarray, old: Scheme, new: Scheme, length: float) -> np.ndarray:
    """Return the local errors of another scheme on the same intervals, m."""
    if old is new:
        return local
    x = (local / (length * old.error_constant)) ** (1 / (old.order + 1))
    return np.asarray(length * new.error_constant * x ** (new.order + 1))


def _parts(local: np.ndarray, order: int, allowed: float) -> np.ndarray:
    """Return the parts (n,) of intervals, at most `MOST_PARTS`, whose summed error is at most ``allowed``."""
    shape = local ** (1 / (order + 1))

    def total(scale: float) -> tuple[np.ndarray, float]:
        parts = np.clip(np.ceil(scale * shape), 1, MOST_PARTS).astype(int)
        return parts, float((local * parts ** -float(order)).sum())

    low, high = 1 / shape.max(), MOST_PARTS / shape.min()
    if total(high)[1] > allowed:
        return total(high)[0]
    for _ in range(60):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if total(middle)[1] > allowed else (low, middle)
    return total(high)[0]
