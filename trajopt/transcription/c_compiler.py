"""The C compiler: which one there is, its flags at each level, and a function's library by it."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path

import casadi as ca

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
# Functions whose intermediate values are C array entries instead of local variables: gcc's register
# allocation then takes half the time on a Jacobian, at the same speed of the code. On a Hessian it
# is the other way round.
_IN_MEMORY = ("first",)


@lru_cache(maxsize=1)
def compiler() -> tuple[str, str] | None:
    """Path and version line of the C compiler ($CC, cc, gcc or clang), or None."""
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        path = shutil.which(name) if name else None
        if path:
            return path, version_line(path)
    return None


def version_line(path: str) -> str:
    """What a compiler says about its version, in its first line; raises OSError where it cannot be run."""
    text = subprocess.run([path, "--version"], capture_output=True, text=True, check=False).stdout
    return text.splitlines()[0] if text else ""


@lru_cache(maxsize=1)
def _processor() -> str:
    """Instruction sets of this processor: code made for it alone may not run on another."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.processor())


def made_by(level: str, found: tuple[str, str] | None) -> str:
    """What code at a level depends on besides the graph: flags, compiler (path and version), machine."""
    flags = FLAGS[level]
    if flags is None:
        return ""
    text = "|".join([*flags, *_IN_MEMORY, *(found or ()), platform.machine()])
    return text + _processor() if "-march=native" in flags else text


def each_once(function: ca.Function) -> ca.Function:
    """The same function with each expression evaluated once: a fifth of a Hessian's instructions less."""
    inputs = function.sx_in()
    return ca.Function(function.name(), inputs, function.call(inputs), {"cse": True})


def generate(name: str, function: ca.Function, folder: Path) -> Path:
    """Write a function's C into a folder."""
    generator = ca.CodeGenerator(f"{name}.c", {"with_header": False, "avoid_stack": name in _IN_MEMORY})
    generator.add(each_once(function))
    generator.generate(f"{folder}{os.sep}")
    return folder / f"{name}.c"


def command(path: str, level: str, source: Path) -> list[str]:
    """The command that compiles a source to a library beside it."""
    library = str(source.with_suffix(".so"))
    return [path, *(FLAGS[level] or ()), "-fPIC", "-shared", "-w", str(source), "-o", library, "-lm"]


def complaint(errors: bytes, status: int) -> str:
    """The last line of what a compiler that failed has written."""
    lines = errors.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else f"exit status {status}"
