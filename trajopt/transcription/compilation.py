"""Derivatives of point functions, compiled to C once and kept in a disk cache.

Three levels trade compile time for evaluation time: ``none`` (CasADi's virtual machine, no
compiler), ``quick`` and ``fast`` (the C compiler's -O1, and -O3 with -ffast-math). ``background`` waits for
no compiler: what is in the cache at ``quick`` is used, the rest is evaluated on the virtual machine and
compiled by a process of its own for the next time (`background`).

An entry of the cache is named by a hash of the point function's graph, the versions of what made it, the
level and the compiler, so that nothing stale is ever read. The graph does not depend on the scheme, the step
or the number of intervals, so neither does the entry. The background removes an entry of the virtual machine
when it is compiled: it is ten times as large, and is read in about the time in which it is built.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import subprocess
import time
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import casadi as ca

from trajopt.errors import InputError, TrajoptError
from trajopt.transcription import stage_functions
from trajopt.transcription.background import Request, ask, stand_ins
from trajopt.transcription.c_compiler import FLAGS, command, compiler, complaint, generate, made_by
from trajopt.transcription.cache_entries import CACHE_VARIABLE, EntryWriter, cache_directory, intact
from trajopt.transcription.compiled_point import FUNCTION_NAMES, CompiledPoint, Stored, load
from trajopt.transcription.stage_functions import PointFunction, derivatives

BACKGROUND = "background"
# What the background compiles, and batches of solves wait for.
WAITING_LEVEL = "quick"
LEVELS = (BACKGROUND, *FLAGS)
DEFAULT_LEVEL = BACKGROUND
# Hessians to choose from; a solver approximates the last one from gradients.
HESSIANS = ("exact", "gauss-newton", "limited-memory")
DEFAULT_HESSIAN = "exact"
# Functions of an entry, by its kind. With another Hessian than the exact one value and first are taken from
# the exact one's entry if present: nothing is compiled needlessly or twice.
ENTRIES = {"exact": FUNCTION_NAMES, "first-order": ("value", "first"), "gauss-newton": ("gauss_newton",)}


@dataclass(frozen=True)
class CompilationReport:
    """Cost of a call: seconds for building graphs and for the C compiler, and cache hits.

    level: at which the functions are evaluated; of several the slowest. pending: entries that are not waited
    for, and compiled in the background. failure: why that failed the last time.
    """

    level: str
    build_time: float
    compile_time: float
    cached: int
    built: int
    pending: int = 0
    failure: str | None = None


def effective_level(level: str) -> str:
    """The level available here: ``none`` where there is no C compiler. Raises InputError."""
    if level not in LEVELS:
        raise InputError(f"unknown compile level '{level}'", f"allowed: {', '.join(LEVELS)}")
    if level != "none" and compiler() is None:
        warnings.warn(
            "no C compiler found (cc, gcc, clang): evaluating on CasADi's virtual machine", stacklevel=2
        )
        return "none"
    return level


@lru_cache(maxsize=1)
def _maker() -> str:
    """What an entry depends on besides the graph: versions, and the code of the chain rule."""
    versions = [importlib.metadata.version(name) for name in ("casadi", "libpinocchio")]
    return "|".join([*versions, Path(stage_functions.__file__).read_text(encoding="utf-8")])


def entry_key(point: PointFunction, level: str, kind: str = "exact") -> str:
    """Name of a point function's cache entry of a kind (see ``ENTRIES``) at a level."""
    by = made_by(level, compiler())
    text = "\n".join([point.text, _maker(), level, by, *([] if kind == "exact" else [kind])])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def compile_points(
    points: Iterable[PointFunction], level: str = DEFAULT_LEVEL, hessian: str = DEFAULT_HESSIAN
) -> tuple[dict[str, CompiledPoint], CompilationReport]:
    """Derivatives of all points, by the entry key of the exact Hessian at the report's level.

    They come from the cache or are made now. Raises InputError for an unknown level or Hessian.
    """
    level = effective_level(level)
    if hessian not in HESSIANS:
        raise InputError(f"unknown Hessian '{hessian}'", f"allowed: {', '.join(HESSIANS)}")
    make = _without_waiting if level == BACKGROUND else partial(_made, level=level)
    return make(list(points), hessian=hessian)


def in_cache(points: Iterable[PointFunction], level: str) -> bool:
    """Whether the exact derivatives of all points are in the cache at a level. Raises InputError."""
    level, folder = effective_level(level), cache_directory()
    return all(intact(folder / entry_key(point, level)) for point in points)


def _without_waiting(
    points: Sequence[PointFunction], hessian: str
) -> tuple[dict[str, CompiledPoint], CompilationReport]:
    """Compiled functions where they are cached; for other points the virtual machine, and a request."""
    begun = time.perf_counter()
    folder, stood_in = cache_directory(), stand_ins()
    missing: dict[str, tuple[PointFunction, str]] = {}
    ready: list[PointFunction] = []
    late: list[PointFunction] = []
    for point in points:
        keys = {entry_key(point, WAITING_LEVEL, kind): kind for kind in _kinds(point, WAITING_LEVEL, hessian)}
        wanted = {
            key: (point, kind)
            for key, kind in keys.items()
            if key in (stood_in or ()) or not intact(folder / key)
        }
        (late if wanted else ready).append(point)
        missing |= wanted
    found, compiled = _made(ready, WAITING_LEVEL, hessian)
    if not late:
        return found, replace(compiled, build_time=time.perf_counter() - begun)
    if stood_in is not None:
        stood_in.update(missing)
    machine, report = _made(late, "none", hessian)
    failure = ask(folder, [_request(key, *made, hessian) for key, made in missing.items()])
    by_none = {entry_key(point, "none"): found[entry_key(point, WAITING_LEVEL)] for point in ready}
    return machine | by_none, replace(
        report,
        build_time=time.perf_counter() - begun,
        cached=report.cached + compiled.cached,
        pending=len(missing),
        failure=failure,
    )


def _request(key: str, point: PointFunction, kind: str, hessian: str) -> Request:
    """Where the background finds the functions of a compiled entry."""
    entries = [entry_key(point, "none", known) for known in _kinds(point, "none", hessian)]
    found = compiler()
    assert found is not None
    return Request(
        key=key,
        point=point.name,
        level=WAITING_LEVEL,
        compiler=found[0],
        made_by=made_by(WAITING_LEVEL, found),
        names=ENTRIES[kind],
        entries=tuple(entries),
    )


def _made(
    points: Sequence[PointFunction], level: str, hessian: str
) -> tuple[dict[str, CompiledPoint], CompilationReport]:
    """As `compile_points`, at a level that is there and waited for."""
    try:
        return _made_once(points, level, hessian)
    except FileNotFoundError:  # the background has removed an entry since it was looked at
        return _made_once(points, level, hessian)


def _made_once(
    points: Sequence[PointFunction], level: str, hessian: str
) -> tuple[dict[str, CompiledPoint], CompilationReport]:
    folder = cache_directory()
    entries: dict[str, tuple[str, ...]] = {}
    wanted: dict[str, tuple[PointFunction, str]] = {}
    for point in points:
        kinds = _kinds(point, level, hessian)
        keys = {entry_key(point, level, kind): (point, kind) for kind in kinds}
        entries[entry_key(point, level)] = tuple(keys)
        wanted |= keys
    missing = {key: made for key, made in wanted.items() if not intact(folder / key)}
    start = time.perf_counter()
    jobs = [_Job(key, point, kind, level, folder) for key, (point, kind) in missing.items()]
    try:
        for job in jobs:
            job.start()
        built = time.perf_counter()
        for job in jobs:
            job.finish()
    finally:
        for job in jobs:
            job.discard()
    compile_time = 0.0 if level == "none" else time.perf_counter() - built
    report = CompilationReport(level, built - start, compile_time, len(wanted) - len(missing), len(missing))
    made = {job.writer.final: job.functions for job in jobs}
    return {key: load(key, [folder / name for name in names], made) for key, names in entries.items()}, report


def _kinds(point: PointFunction, level: str, hessian: str) -> tuple[str, ...]:
    """Kinds of the entries that hold a point's functions for a Hessian."""
    if hessian == "exact":
        return ("exact",)
    known = intact(cache_directory() / entry_key(point, level))
    first_order = "exact" if known else "first-order"
    return (first_order, "gauss-newton") if hessian == "gauss-newton" else (first_order,)


class _Job:
    """An entry being built: start() builds graphs and starts C compilers, which finish() joins."""

    def __init__(self, key: str, point: PointFunction, kind: str, level: str, folder: Path) -> None:
        self.point, self.kind, self.level = point, kind, level
        self.writer = EntryWriter(folder / key, point.name, level)
        self.c_bytes = 0
        self.functions: dict[str, Stored] = {}
        self.processes: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        """Build the graphs, and start the compilers one after the other."""
        folder = self.writer.temporary
        try:
            self.writer.open()
        except OSError as error:
            raise InputError(
                f"cannot write the cache folder {folder.parent} ({error.strerror})",
                f"set {CACHE_VARIABLE} to a folder that can be written",
            ) from None
        made, stored = derivatives(self.point), self._stored()
        for name in reversed(ENTRIES[self.kind]):
            file = stored.get(name)
            function = getattr(made, name) if file is None else ca.Function.deserialize(file.read_text())
            if self.level == "none":
                text = function.serialize()
                (folder / f"{name}.casadi").write_text(text, encoding="utf-8")
                self.functions[name] = Stored(text, function)
            else:
                self._compile(generate(name, function, folder))

    def _stored(self) -> dict[str, Path]:
        """Files of functions that the virtual machine has already: no graph is built twice."""
        if self.level == "none":
            return {}
        folder, files = self.writer.final.parent, dict[str, Path]()
        for kind in ENTRIES:
            entry = folder / entry_key(self.point, "none", kind)
            if intact(entry):
                files |= {file.stem: file for file in entry.glob("*.casadi")}
        return files

    def _compile(self, source: Path) -> None:
        self.c_bytes += source.stat().st_size
        found = compiler()
        assert found is not None
        line = command(found[0], self.level, source)
        self.processes.append(subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE))

    def finish(self) -> None:
        """Wait for the compilers and move the entry into place."""
        for process in self.processes:
            _, text = process.communicate()
            if process.returncode != 0:
                why = complaint(text, process.returncode)
                raise TrajoptError(f"the C compiler failed on a stage function: {why}; try --compile none")
        self.writer.move_into_place(self.c_bytes)

    def discard(self) -> None:
        """Stop compilers that still run and remove files that were not moved into place."""
        for process in self.processes:
            if process.poll() is None:
                process.kill()
                process.communicate()
        self.writer.discard()
