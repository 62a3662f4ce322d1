"""The mesh of a solution, its schemes, and interpolation between collocation points."""

import numpy as np

from trajopt.motion.solution import Solution
from trajopt.transcription.mesh import Mesh, PhaseMesh
from trajopt.transcription.schemes import Scheme

# Widths computed from a file's times are equal up to rounding.
SAME_WIDTH = 1e-9


def mesh_of(solution: Solution) -> Mesh:
    """Return the mesh of a solution; raises `InputError` if it names an unknown scheme.

    Files without a mesh have a single scheme, and their times give the widths.
    """
    if solution.statistics.mesh is not None:
        return solution.statistics.mesh
    name, widths = solution.statistics.transcription, [_widths(solution, rows) for rows in solution.phases]
    return Mesh(phases=tuple(PhaseMesh(scheme=name, widths=phase) for phase in widths))


def interval_schemes(solution: Solution) -> tuple[Scheme, ...]:
    """Return the scheme of every interval of a solution."""
    return tuple(phase.method for phase in mesh_of(solution).phases for _ in phase.widths)


def interpolated(solution: Solution, values: np.ndarray) -> np.ndarray:
    """Extrapolate values (K, ...) from the collocation points to both ends of every interval."""
    extended = values.copy()
    for rows, method in zip(solution.intervals, interval_schemes(solution), strict=True):
        inner = [k for k in rows if solution.collocation[k]]
        ends = method.interpolation(np.array([0.0, 1.0]))
        extended[[rows[0], rows[-1]]] = np.tensordot(ends, values[inner], axes=1)
    return extended


def _widths(solution: Solution, rows: range) -> tuple[float, ...]:
    first, last = solution.interval[rows.start], solution.interval[rows.stop - 1]
    steps = np.diff(solution.interval_t[first : last + 1], axis=1)[:, 0]
    if np.ptp(steps) <= SAME_WIDTH * steps.sum():
        return (1.0 / len(steps),) * len(steps)
    return tuple((steps / steps.sum()).tolist())
