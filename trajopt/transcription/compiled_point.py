"""A point's functions as entries of the cache hold them: where they are, and their patterns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from trajopt.transcription.cache_entries import c_bytes

FUNCTION_NAMES = ("value", "first", "second")


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
class Stored:
    """A function, and where the engine finds it: its text, or a library and the name in it."""

    source: str | tuple[str, str]
    function: ca.Function


def load(
    key: str, entries: Sequence[Path], made: Mapping[Path, Mapping[str, Stored]] | None = None
) -> CompiledPoint:
    """A point's functions from its entries: the last one's Hessian, or none where none has one.

    made: functions of entries that this process has just written, which need not be read again. Raises
    FileNotFoundError where an entry was removed meanwhile.
    """
    found: dict[str, Stored] = {}
    for entry in entries:
        found |= (made or {}).get(entry) or _read(entry)
    # After reading: an entry that is still there was read whole.
    size = sum(c_bytes(entry) for entry in entries)
    sources = {name: own.source for name, own in found.items()}
    functions = {name: own.function for name, own in found.items()}
    hessian = "gauss_newton" if "gauss_newton" in sources else "second"
    if hessian not in sources:
        functions[hessian] = _no_hessian(functions["first"])
        sources[hessian] = functions[hessian].serialize()
    return CompiledPoint(
        key,
        {"value": sources["value"], "first": sources["first"], "second": sources[hessian]},
        functions["first"].sparsity_out(3),
        functions[hessian].sparsity_out(0),
        size,
    )


def _read(entry: Path) -> dict[str, Stored]:
    found = {}
    for name in (*FUNCTION_NAMES, "gauss_newton"):
        library, file = entry / f"{name}.so", entry / f"{name}.casadi"
        if library.is_file():
            found[name] = Stored((str(library), name), ca.external(name, str(library)))
        elif file.is_file():
            text = file.read_text(encoding="utf-8")
            found[name] = Stored(text, ca.Function.deserialize(text))
    return found


def _no_hessian(first: ca.Function) -> ca.Function:
    """Zero in place of a Hessian that no solver uses."""
    n_z, n_p, n_rows = first.numel_in(0), first.numel_in(1), first.numel_out(1)
    inputs = [ca.SX.sym("z", n_z), ca.SX.sym("p", n_p), ca.SX.sym("sigma"), ca.SX.sym("lam", n_rows)]
    return ca.Function("second", inputs, [ca.SX(n_z, n_z)])
