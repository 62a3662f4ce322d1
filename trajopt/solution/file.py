"""The solution file of version 1: an ``.npz`` without pickles, written atomically and checked on reading."""

from __future__ import annotations

import io
import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError, SolutionFileError, expanded
from trajopt.solution.arrays import OTHERS, SAMPLED, model_from_text, read_only, runs
from trajopt.solution.consistency import inconsistency
from trajopt.solution.description import PlanDescription
from trajopt.solution.meta import description_of, meta_of, require_keys, statistics_of
from trajopt.solution.output import replacing
from trajopt.solution.statistics import SolveStatistics

FORMAT = "trajopt-solution"
VERSION = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class FileContent:
    """What a solution file holds."""

    description: PlanDescription
    statistics: SolveStatistics
    model: pin.Model
    arrays: dict[str, np.ndarray]

    @property
    def meta(self) -> dict[str, Any]:
        """The key ``meta`` of the file, JSON-able."""
        phase, edges = self.arrays["phase"], self.arrays["interval_t"]
        first = [phase[rows.start] for rows in runs(self.arrays["interval"])]
        times = [edges[rows.start : rows.stop] for rows in runs(np.array(first))]
        return {
            "format": FORMAT,
            "version": VERSION,
            **meta_of(self.description, self.statistics),
            "intervals": [len(part) for part in times],
            "durations": [float(part[-1, 1] - part[0, 0]) for part in times],
        }

    def require_consistent(self) -> None:
        """Raise `InputError` if the parts do not fit each other."""
        wrong = inconsistency(self.arrays, self.model, self.description, self.statistics)
        if wrong:
            raise InputError(f"the solution is inconsistent: {wrong}")

    def to_bytes(self) -> bytes:
        """The content of the file. Raises `InputError` if it is inconsistent, or has no JSON."""
        self.require_consistent()
        try:
            meta = json.dumps(self.meta, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InputError(f"meta of the solution cannot be written as JSON: {error}") from None
        texts = {"meta": np.array(meta), "model": np.array(self.model.saveToString())}
        file = io.BytesIO()
        np.savez_compressed(file, allow_pickle=False, **texts, **self.arrays)
        return file.getvalue()


def write_bytes(target: Path, content: bytes) -> None:
    """Write a file completely, to the disk, or not at all. Raises a one-line `InputError`."""
    with replacing(target) as unfinished, unfinished.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def read_solution_file(path: str | Path) -> FileContent:
    """Read a file; raises a one-line `SolutionFileError`; see `Solution.load`."""
    source = expanded(path)
    return parse_solution(_content(source), source)


def parse_solution(content: bytes, source: Path) -> FileContent:
    """As `read_solution_file`, of the content of a file that messages call ``source``."""
    arrays = _arrays(content, source)
    meta = _meta(source, arrays)
    missing = [name for name in (*SAMPLED, "interval_t", "model") if name not in arrays]
    if missing:
        raise SolutionFileError(f"{source}: missing key {', '.join(repr(name) for name in missing)}")
    for name, kind in {**SAMPLED, **OTHERS}.items():
        allowed = {float: "fiu", int: "iu", bool: "b"}[kind]
        if name in arrays and arrays[name].dtype.kind not in allowed:
            raise SolutionFileError(f"{source}: '{name}' is of type {arrays[name].dtype}", kind.__name__)
    if arrays["model"].dtype.kind != "U" or arrays["model"].ndim != 0:
        raise SolutionFileError(f"{source}: 'model' is not a text")
    try:
        require_keys(meta)
        values = read_only(arrays)
        n_phases = min(int(values["phase"].max(initial=-1)) + 1, len(values["phase"]))
        parts = FileContent(
            description=description_of(meta, n_phases),
            statistics=statistics_of(meta),
            model=model_from_text(str(arrays["model"])),
            arrays=values,
        )
    except InputError as error:
        raise SolutionFileError(f"{source}: {error.what}", error.allowed) from None
    wrong = inconsistency(values, parts.model, parts.description, parts.statistics)
    if wrong:
        raise SolutionFileError(f"{source}: {wrong}")
    values["f"] = _forces_of_contacts(parts.description, values)
    return parts


def _forces_of_contacts(plan: PlanDescription, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Wrenches (K, nc, 6) without those of payloads, which earlier files have as inactive contacts."""
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


def _arrays(content: bytes, source: Path) -> dict[str, np.ndarray]:
    if not content.startswith(b"PK\x03\x04"):
        raise SolutionFileError(f"{source} is not a {FORMAT} file", "an .npz archive")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (zipfile.BadZipFile, zlib.error, EOFError, KeyError):
        raise SolutionFileError(f"{source} is truncated or damaged") from None
    except (ValueError, NotImplementedError, RuntimeError) as error:
        raise SolutionFileError(f"{source} cannot be read: {str(error).splitlines()[0]}") from None


def _meta(source: Path, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    if "meta" not in arrays or arrays["meta"].dtype.kind != "U" or arrays["meta"].ndim != 0:
        raise SolutionFileError(f"{source} is not a {FORMAT} file: it has no text 'meta'")
    try:
        meta = json.loads(str(arrays["meta"]))
    except json.JSONDecodeError as error:
        raise SolutionFileError(f"{source}: 'meta' is not JSON: {error.msg}") from None
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise SolutionFileError(f"{source} is not a {FORMAT} file")
    if meta.get("version") != VERSION or isinstance(meta.get("version"), bool):
        raise SolutionFileError(f"{source} is of version {meta.get('version')!r}", f"version {VERSION}")
    return meta
