"""The solution file, version 1: an ``.npz`` without pickles, written atomically and checked when read."""

import io
import json
import math
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError, SolutionFileError, expanded, first_line, is_number
from trajopt.motion.archive import read_members
from trajopt.motion.consistency import OTHERS, SAMPLED, inconsistency, read_only, runs
from trajopt.motion.description import PlanDescription
from trajopt.motion.meta import description_of, meta_of, require_keys, statistics_of
from trajopt.motion.model_arrays import (
    LARGEST_VALUE,
    MODEL_KINDS,
    model_from_arrays,
    model_from_untrusted_text,
    model_to_arrays,
)
from trajopt.motion.output import replacing
from trajopt.motion.statistics import SolveStatistics
from trajopt.robot.natural_units import NaturalUnits

FORMAT = "trajopt-solution"
VERSION = 1
# Largest number of values in ``meta``, and their largest nesting depth.
MOST_VALUES, MOST_DEPTH = 2_000_000, 50
# Relative difference up to which units of a model are equal.
SAME_UNITS = 1e-6
LARGEST_FLOAT = sys.float_info.max
# Entries of ``meta`` whose numbers are used without further checks.
BOUNDED = (
    *("gravity", "contact_sizes", "contact_radius", "terrain", "surfaces", "patches", "goals", "payloads"),
    *("periodicity", "bodies", "collision", "wrenches"),
)
# Number kinds of the members of a file.
_KINDS = {float: "fiu", int: "iu", bool: "b"}
ENTRY_KINDS = {
    "meta": "U",
    "model": "U",
    **{name: _KINDS[kind] for name, kind in {**SAMPLED, **OTHERS}.items()},
    **MODEL_KINDS,
}


@dataclass(frozen=True, kw_only=True, eq=False)
class FileContent:
    """Content of a solution file."""

    description: PlanDescription
    statistics: SolveStatistics
    model: pin.Model
    arrays: dict[str, np.ndarray]

    @property
    def meta(self) -> dict[str, Any]:
        """The entry ``meta`` of the file, JSON-able."""
        phase, edges = self.arrays["phase"], self.arrays["interval_t"]
        first = [phase[rows.start] for rows in runs(self.arrays["interval"])]
        times = [edges[rows.start : rows.stop] for rows in runs(np.array(first))]
        return {
            "format": FORMAT,
            "version": VERSION,
            **meta_of(self.description, self.statistics),
            "units": NaturalUnits.of(self.model).describe(),
            "intervals": [len(part) for part in times],
            "durations": [float(part[-1, 1] - part[0, 0]) for part in times],
        }

    def require_consistent(self) -> None:
        """Raise `InputError` if the parts are inconsistent."""
        wrong = inconsistency(self.arrays, self.model, self.description, self.statistics)
        if wrong:
            raise InputError(f"the solution is inconsistent: {wrong}")

    def to_bytes(self) -> bytes:
        """Return the content of the file; raises `InputError` if it is inconsistent or not JSON-able."""
        self.require_consistent()
        try:
            meta = json.dumps(self.meta, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InputError(f"meta of the solution cannot be written as JSON: {error}") from None
        texts = {"meta": np.array(meta), "model": np.array(self.model.saveToString())}
        file = io.BytesIO()
        np.savez_compressed(file, allow_pickle=False, **texts, **model_to_arrays(self.model), **self.arrays)
        return file.getvalue()


def write_bytes(target: Path, content: bytes) -> None:
    """Write a file to disk completely or not at all; raises a one-line `InputError`."""
    with replacing(target) as unfinished, unfinished.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def read_solution_file(path: str | Path) -> FileContent:
    """Read a file; raises a one-line `SolutionFileError`. See `Solution.load`."""
    source = expanded(path)
    return parse_solution(_content(source), source)


def parse_solution(content: bytes, source: Path) -> FileContent:
    """Read the content of a file, as `read_solution_file` does; messages call it ``source``."""
    arrays = read_members(content, source, ENTRY_KINDS)
    meta = _meta(source, arrays)
    missing = [name for name in (*SAMPLED, "interval_t", "model") if name not in arrays]
    if missing:
        raise SolutionFileError(f"{source}: missing key {', '.join(repr(name) for name in missing)}")
    if arrays["model"].ndim != 0:
        raise SolutionFileError(f"{source}: 'model' is not a text")
    try:
        require_keys(meta)
        values = read_only(arrays)
        n_phases = min(int(values["phase"].max(initial=-1)) + 1, len(values["phase"]))
        parts = FileContent(
            description=description_of(meta, n_phases),
            statistics=statistics_of(meta),
            model=_model(arrays),
            arrays=values,
        )
    except InputError as error:
        raise SolutionFileError(f"{source}: {error.what}", error.allowed) from None
    _require_units(source, meta, parts.model)
    wrong = inconsistency(values, parts.model, parts.description, parts.statistics)
    if wrong:
        raise SolutionFileError(f"{source}: {wrong}")
    values["f"] = _forces_of_contacts(parts.description, values)
    return parts


def _require_units(source: Path, meta: Mapping[str, Any], model: pin.Model) -> None:
    """Raise `SolutionFileError` if the natural units differ from the model's; older files have none."""
    stated, allowed = meta.get("units"), NaturalUnits.of(model).describe()
    same = isinstance(stated, dict) and all(
        is_number(stated.get(name)) and math.isclose(stated[name], value, rel_tol=SAME_UNITS)
        for name, value in allowed.items()
    )
    if stated is not None and not same:
        shown = ", ".join(f"{name} {value:.6g}" for name, value in allowed.items())
        raise SolutionFileError(f"{source}: units of meta are {stated!r:.80}", f"those of its model: {shown}")


def _forces_of_contacts(plan: PlanDescription, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the wrenches (K, nc, 6) without payloads, which older files have as inactive contacts."""
    f = arrays["f"].copy()
    for body in plan.payloads:
        column = plan.frames.index(body.frame)
        carried = np.isin(arrays["phase"], body.phases) & ~arrays["active"][:, column]
        f[carried, column] = 0.0
    return f


def _content(source: Path) -> bytes:
    if not source.is_file():
        raise SolutionFileError(
            f"{source} does not exist" if not source.exists() else f"{source} is not a file"
        )
    try:
        return source.read_bytes()
    except OSError as error:
        raise SolutionFileError(f"{source} cannot be read: {error.strerror or error}") from None


def _model(arrays: Mapping[str, np.ndarray]) -> pin.Model:
    """Return the model from a file's arrays; older files have only its text."""
    if MODEL_KINDS.keys() & arrays.keys():
        return model_from_arrays(arrays)
    return model_from_untrusted_text(str(arrays["model"]))


def _meta(source: Path, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    if "meta" not in arrays or arrays["meta"].ndim != 0:
        raise SolutionFileError(f"{source} is not a {FORMAT} file: it has no text 'meta'")
    try:
        meta = json.loads(str(arrays["meta"]))
    except (ValueError, RecursionError) as error:  # also for endless digits and deeply nested lists
        raise SolutionFileError(f"{source}: 'meta' is not JSON: {first_line(error)}") from None
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise SolutionFileError(f"{source} is not a {FORMAT} file")
    if meta.get("version") != VERSION or isinstance(meta.get("version"), bool):
        raise SolutionFileError(f"{source} is of version {meta.get('version')!r}", f"version {VERSION}")
    _require_bounded(source, meta)
    return meta


def _require_bounded(source: Path, meta: dict[str, Any]) -> None:
    """Raise `SolutionFileError` for values that no scene has, deep nesting, or too many values.

    Limits and statistics may hold any floating-point number.
    """
    level, counted, depth = list(meta.items()), 0, 0
    while level:
        counted, depth = counted + len(level), depth + 1
        if counted > MOST_VALUES or depth > MOST_DEPTH:
            raise SolutionFileError(
                f"{source}: 'meta' has too many values",
                f"up to {MOST_VALUES}, {MOST_DEPTH} within each other",
            )
        following: list[tuple[str, Any]] = []
        for key, value in level:
            if isinstance(value, dict | list):
                entries = value.values() if isinstance(value, dict) else value
                following += [(key, entry) for entry in entries]
            elif isinstance(value, float | int):
                largest = LARGEST_VALUE if key in BOUNDED else LARGEST_FLOAT
                if not abs(value) <= largest and (key in BOUNDED or isinstance(value, int)):
                    raise SolutionFileError(
                        f"{source}: {key} of meta holds {value!s:.20}",
                        f"allowed: up to {largest:g}, not NaN",
                    )
        level = following
