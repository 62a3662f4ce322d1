"""Derivatives of point functions, compiled to tapes once and kept in a disk cache.

A tape is a straight-line program that the engine evaluates at several points at once (docs/architecture.md,
"Tapes"). Each cache entry is named by a hash of the point function's graph and of the versions and code that
produced it, so stale entries are never read. Neither the graph nor the entry depends on the scheme, the step
or the number of intervals.
"""

import hashlib
import importlib.metadata
import time
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import casadi as ca

from trajopt import _engine
from trajopt.cache import read_entry, write_entry
from trajopt.errors import InputError
from trajopt.transcription import stage_functions
from trajopt.transcription.hessians import DEFAULT_HESSIAN, EXACT, GAUSS_NEWTON, HESSIANS, LIMITED_MEMORY
from trajopt.transcription.stage_functions import Derivatives, PointFunction

_FUNCTIONS = {
    EXACT: ("value", "first", "second"),
    GAUSS_NEWTON: ("value", "first", "gauss_newton"),
    LIMITED_MEMORY: ("value", "first"),
}


@dataclass(frozen=True)
class CompiledPoint:
    """Tapes of a point's value, first and second derivatives.

    ``second`` evaluates the chosen Hessian; it is zero where the solver approximates the Hessian itself.
    """

    value: _engine.Tape
    first: _engine.Tape
    second: _engine.Tape


@dataclass(frozen=True)
class CompilationReport:
    """Times in s for differentiation and compilation, and numbers of functions cached and built."""

    build_time: float
    compile_time: float
    cached: int
    built: int


@lru_cache(maxsize=1)
def _maker() -> str:
    """Everything besides the graph on which an entry depends: versions, and the code of the chain rule."""
    versions = [importlib.metadata.version(name) for name in ("casadi", "libpinocchio")]
    return "|".join([*versions, _engine.TAPE_VERSION, Path(stage_functions.__file__).read_text("utf-8")])


def entry_key(point: PointFunction) -> str:
    """Common prefix of the names of a point function's cache entries."""
    return hashlib.sha256("\n".join([point.text, _maker()]).encode()).hexdigest()[:32]


def compile_points(
    points: Iterable[PointFunction], hessian: str = DEFAULT_HESSIAN
) -> tuple[dict[str, CompiledPoint], CompilationReport]:
    """Compiled derivatives of all points, by `entry_key`. Raises InputError for an unknown Hessian."""
    if hessian not in HESSIANS:
        raise InputError(f"unknown Hessian '{hessian}'", f"allowed: {', '.join(HESSIANS)}")
    compiler = _Compiler()
    made: dict[str, CompiledPoint] = {}
    for point in points:
        key = entry_key(point)
        if key not in made:
            tapes = compiler.tapes(point, key, _FUNCTIONS[hessian])
            if len(tapes) == 2:
                tapes.append(_engine.Tape(_no_hessian(point)))
            made[key] = CompiledPoint(*tapes)
    return made, compiler.report()


class _Compiler:
    """Compiles the functions that are not in the cache, and counts and times them."""

    def __init__(self) -> None:
        self._cached = self._built = 0
        self._build_time = self._compile_time = 0.0

    def tapes(self, point: PointFunction, key: str, functions: Iterable[str]) -> list[_engine.Tape]:
        """Tapes of a point's functions; missing cache entries are written."""
        derivatives = Derivatives(point)
        return [self._tape(derivatives, name, f"{key}.{name}") for name in functions]

    def _tape(self, derivatives: Derivatives, function: str, entry: str) -> _engine.Tape:
        content = read_entry(entry)
        if content is not None:
            self._cached += 1
            return _engine.Tape.read(content)
        self._built += 1
        begun = time.perf_counter()
        graph = getattr(derivatives, function)
        differentiated = time.perf_counter()
        tape = _engine.Tape(graph)
        write_entry(entry, tape.bytes())
        self._build_time += differentiated - begun
        self._compile_time += time.perf_counter() - differentiated
        return tape

    def report(self) -> CompilationReport:
        """Report on the work done so far."""
        return CompilationReport(self._build_time, self._compile_time, self._cached, self._built)


def _no_hessian(point: PointFunction) -> ca.Function:
    """Zero placeholder for a Hessian that the solver does not use."""
    n_z, n_p = point.n_z, point.terms.numel_in(2)
    inputs = [ca.SX.sym("z", n_z), ca.SX.sym("p", n_p), ca.SX.sym("sigma"), ca.SX.sym("lam", point.n_rows)]
    return ca.Function("second", inputs, [ca.SX(n_z, n_z)])
