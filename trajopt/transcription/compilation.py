"""Derivatives of point functions, compiled to C once and kept in a disk cache.

Three levels trade compile time for evaluation time: ``none`` (CasADi's virtual machine, no
compiler), ``quick`` and ``fast`` (the C compiler's -O1, and -O3 with -ffast-math). An entry is named
by a hash of the point function's graph, the versions of what made it, the level and the compiler, so that
nothing stale is ever read; entries are written to a temporary folder and renamed, so that processes may share
the cache. An entry whose files are not those that were written (a full disk, a crash) is built again: a
truncated library would crash the process that loads it. The graph does not depend on the scheme, the step or
the number of intervals, so neither does the entry.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import json
import os
import platform
import shutil
import subprocess
import tempfile
import time
import uuid
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import casadi as ca
import platformdirs

from trajopt.errors import InputError, TrajoptError
from trajopt.transcription import stage_functions
from trajopt.transcription.stage_functions import PointFunction, derivatives

# Two of gcc's passes take most of the compile time on straight-line code of this size (8 s become
# 2 s on a stage Jacobian) and gain nothing there.
_SKIPPED_PASSES = ("-fno-tree-dominator-opts", "-fno-tree-ter")
FLAGS = {
    "none": None,
    "quick": ("-O1", "-march=native", *_SKIPPED_PASSES),
    # Without gcc's start files, which are not needed here: those of -ffast-math let the whole process that
    # loads the library flush subnormal numbers (SciPy's k-d tree then never ends).
    "fast": ("-O3", "-march=native", "-ffast-math", "-nostartfiles"),
}
LEVELS = tuple(FLAGS)
DEFAULT_LEVEL = "quick"
FUNCTION_NAMES = ("value", "first", "second")
# Hessians to choose from; a solver approximates the last one from gradients.
HESSIANS = ("exact", "gauss-newton", "limited-memory")
DEFAULT_HESSIAN = "exact"
# Functions of an entry, by its kind. With another Hessian than the exact one value and first are taken from
# the exact one's entry if present: nothing is compiled needlessly or twice.
ENTRIES = {"exact": FUNCTION_NAMES, "first-order": ("value", "first"), "gauss-newton": ("gauss_newton",)}
# Functions whose intermediate values are C array entries instead of local variables: gcc's register
# allocation then takes half the time on a Jacobian, at the same speed of the code. On a Hessian it
# is the other way round.
_IN_MEMORY = ("first",)
CACHE_VARIABLE = "TRAJOPT_CACHE_DIR"
ENTRY = "entry.json"


@dataclass(frozen=True)
class CompiledPoint:
    """Where the three functions of a point are stored, and the patterns of their derivatives.

    The second is of the chosen Hessian; zero where the solver approximates its own.

    ``sources`` maps value, first, second to serialised text (virtual machine) or to
    (library, name); ``c_bytes`` is the size of the generated C, 0 without.
    """

    key: str
    sources: Mapping[str, str | tuple[str, str]]
    jacobian: ca.Sparsity
    hessian: ca.Sparsity
    c_bytes: int


@dataclass(frozen=True)
class CompilationReport:
    """Cost of a call: seconds for building graphs and for the C compiler, and cache hits."""

    level: str
    build_time: float
    compile_time: float
    cached: int
    built: int


def cache_directory() -> Path:
    """The cache's folder: $TRAJOPT_CACHE_DIR, or the user's cache folder of this platform."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_dir("trajopt", appauthor=False))


@lru_cache(maxsize=1)
def compiler() -> tuple[str, str] | None:
    """Path and version line of the C compiler ($CC, cc, gcc or clang), or None."""
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        path = shutil.which(name) if name else None
        if path:
            version = subprocess.run([path, "--version"], capture_output=True, text=True, check=False).stdout
            return path, version.splitlines()[0] if version else ""
    return None


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


@lru_cache(maxsize=1)
def _processor() -> str:
    """Instruction sets of this processor: code made for it alone may not run on another."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.processor())


def entry_key(point: PointFunction, level: str, kind: str = "exact") -> str:
    """Name of a point function's cache entry of a kind (see ``ENTRIES``) at a level."""
    flags = FLAGS[level]
    made_by = (
        "" if flags is None else "|".join([*flags, *_IN_MEMORY, *(compiler() or ()), platform.machine()])
    )
    if flags is not None and "-march=native" in flags:
        made_by += _processor()
    text = "\n".join([point.text, _maker(), level, made_by, *([] if kind == "exact" else [kind])])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def compile_points(
    points: Iterable[PointFunction], level: str = DEFAULT_LEVEL, hessian: str = DEFAULT_HESSIAN
) -> tuple[dict[str, CompiledPoint], CompilationReport]:
    """Derivatives of all points, by the entry key of the exact Hessian, from the cache or compiled now.

    Raises InputError for an unknown level or Hessian.
    """
    level, folder = effective_level(level), cache_directory()
    if hessian not in HESSIANS:
        raise InputError(f"unknown Hessian '{hessian}'", f"allowed: {', '.join(HESSIANS)}")
    entries: dict[str, tuple[str, ...]] = {}
    wanted: dict[str, tuple[PointFunction, str]] = {}
    for point in points:
        kinds = _kinds(point, level, hessian)
        keys = {entry_key(point, level, kind): (point, kind) for kind in kinds}
        entries[entry_key(point, level)] = tuple(keys)
        wanted |= keys
    missing = {key: made for key, made in wanted.items() if not _intact(folder / key)}
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
    done = time.perf_counter()
    report = CompilationReport(level, built - start, done - built, len(wanted) - len(missing), len(missing))
    return {key: _load(key, [folder / name for name in names]) for key, names in entries.items()}, report


def in_cache(points: Iterable[PointFunction], level: str) -> bool:
    """Whether the exact derivatives of all points are in the cache at a level. Raises InputError."""
    level, folder = effective_level(level), cache_directory()
    return all(_intact(folder / entry_key(point, level)) for point in points)


def _kinds(point: PointFunction, level: str, hessian: str) -> tuple[str, ...]:
    """Kinds of the entries that hold a point's functions for a Hessian."""
    if hessian == "exact":
        return ("exact",)
    known = _intact(cache_directory() / entry_key(point, level))
    first_order = "exact" if known else "first-order"
    return (first_order, "gauss-newton") if hessian == "gauss-newton" else (first_order,)


class _Job:
    """An entry being built: start() builds graphs and starts C compilers, which finish() joins."""

    def __init__(self, key: str, point: PointFunction, kind: str, level: str, folder: Path) -> None:
        self.point, self.kind, self.level = point, kind, level
        self.temporary, self.final = folder / f".{key}.{uuid.uuid4().hex}", folder / key
        self.entry: dict[str, object] = {"point": point.name, "level": level}
        self.c_bytes = 0
        self.processes: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        """Build the graphs, and start the compilers one after the other."""
        try:
            self.temporary.mkdir(mode=0o700, parents=True)
        except OSError as error:
            raise InputError(
                f"cannot write the cache folder {self.temporary.parent} ({error.strerror})",
                f"set {CACHE_VARIABLE} to a folder that can be written",
            ) from None
        made, level = derivatives(self.point), self.level
        for name in reversed(ENTRIES[self.kind]):
            function = getattr(made, name)
            if level == "none":
                (self.temporary / f"{name}.casadi").write_text(function.serialize(), encoding="utf-8")
            else:
                self._compile(name, function, FLAGS[level] or ())

    def _compile(self, name: str, function: ca.Function, flags: tuple[str, ...]) -> None:
        generator = ca.CodeGenerator(f"{name}.c", {"with_header": False, "avoid_stack": name in _IN_MEMORY})
        generator.add(function)
        generator.generate(f"{self.temporary}{os.sep}")
        source = self.temporary / f"{name}.c"
        self.c_bytes += source.stat().st_size
        found = compiler()
        assert found is not None
        command = [
            found[0],
            *flags,
            "-fPIC",
            "-shared",
            "-w",
            str(source),
            "-o",
            str(source.with_suffix(".so")),
            "-lm",
        ]
        self.processes.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE))

    def finish(self) -> None:
        """Wait for the compilers and move the entry into place."""
        for process in self.processes:
            _, text = process.communicate()
            if process.returncode != 0:
                last = text.decode(errors="replace").strip().splitlines()[-1:] or [
                    f"exit status {process.returncode}"
                ]
                raise TrajoptError(
                    f"the C compiler failed on a stage function: {last[0]}; try --compile none"
                )
        for source in self.temporary.glob("*.c"):
            source.unlink()
        self.entry["c_bytes"] = self.c_bytes
        self.entry["files"] = {file.name: _digest(file) for file in self.temporary.iterdir()}
        (self.temporary / ENTRY).write_text(json.dumps(self.entry), encoding="utf-8")
        if self.final.exists() and not _intact(self.final):
            self._set_aside()
        with contextlib.suppress(OSError):  # another process was first: its entry serves as well
            self.temporary.rename(self.final)

    def discard(self) -> None:
        """Stop compilers that still run and remove files that were not moved into place."""
        for process in self.processes:
            if process.poll() is None:
                process.kill()
                process.communicate()
        shutil.rmtree(self.temporary, ignore_errors=True)

    def _set_aside(self) -> None:
        """Move a damaged entry aside; a process that has loaded it keeps its own view of the files."""
        aside = Path(tempfile.mkdtemp(prefix=f".{self.final.name}.", dir=self.final.parent))
        with contextlib.suppress(OSError):  # another process moved it
            self.final.rename(aside / "damaged")
        shutil.rmtree(aside, ignore_errors=True)


def _digest(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _intact(entry: Path) -> bool:
    """Whether an entry exists, with exactly the files that were written."""
    try:
        files = json.loads((entry / ENTRY).read_text(encoding="utf-8"))["files"]
        return all(_digest(entry / name) == digest for name, digest in files.items())
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return False


def _load(key: str, entries: Sequence[Path]) -> CompiledPoint:
    """A point's functions from its entries: the last one's Hessian, or none where none has one."""
    sources: dict[str, str | tuple[str, str]] = {}
    functions: dict[str, ca.Function] = {}
    c_bytes = 0
    for entry in entries:
        c_bytes += int(json.loads((entry / ENTRY).read_text(encoding="utf-8"))["c_bytes"])
        for name in (*FUNCTION_NAMES, "gauss_newton"):
            library, text = entry / f"{name}.so", entry / f"{name}.casadi"
            if library.is_file():
                sources[name], functions[name] = (str(library), name), ca.external(name, str(library))
            elif text.is_file():
                sources[name] = text.read_text(encoding="utf-8")
                functions[name] = ca.Function.deserialize(sources[name])
    hessian = "gauss_newton" if "gauss_newton" in sources else "second"
    if hessian not in sources:
        functions[hessian] = _no_hessian(functions["first"])
        sources[hessian] = functions[hessian].serialize()
    return CompiledPoint(
        key,
        {"value": sources["value"], "first": sources["first"], "second": sources[hessian]},
        functions["first"].sparsity_out(3),
        functions[hessian].sparsity_out(0),
        c_bytes,
    )


def _no_hessian(first: ca.Function) -> ca.Function:
    """Zero in place of a Hessian that no solver uses."""
    n_z, n_p, n_rows = first.numel_in(0), first.numel_in(1), first.numel_out(1)
    inputs = [ca.SX.sym("z", n_z), ca.SX.sym("p", n_p), ca.SX.sym("sigma"), ca.SX.sym("lam", n_rows)]
    return ca.Function("second", inputs, [ca.SX(n_z, n_z)])
