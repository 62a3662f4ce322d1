"""The solution file of version 1: an ``.npz`` without pickles, written atomically and checked on reading."""

from __future__ import annotations

import io
import json
import math
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.errors import InputError, SolutionFileError, expanded
from trajopt.solution.arrays import OTHERS, SAMPLED, read_only
from trajopt.solution.consistency import inconsistency
from trajopt.solution.output import replacing

FORMAT = "trajopt-solution"
VERSION = 1


def write_solution_file(
    path: str | Path, meta: Mapping[str, Any], model_text: str, arrays: Mapping[str, np.ndarray]
) -> Path:
    """Write a solution to a temporary file beside ``path`` and rename it; see `Solution.save`."""
    target = expanded(path)
    content = solution_bytes(meta, model_text, arrays)
    write_bytes(target, content)
    return target


def solution_bytes(meta: Mapping[str, Any], model_text: str, arrays: Mapping[str, np.ndarray]) -> bytes:
    """The content of a solution's file. Raises `InputError` if the solution is inconsistent."""
    text = consistent_meta(meta, model_text, arrays)
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, meta=np.array(text), model=np.array(model_text), **arrays)
    return file.getvalue()


def write_bytes(target: Path, content: bytes) -> None:
    """Write a file completely, to the disk, or not at all. Raises a one-line `InputError`."""
    with replacing(target) as unfinished, unfinished.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def consistent_meta(meta: Mapping[str, Any], model_text: str, arrays: Mapping[str, np.ndarray]) -> str:
    """Return meta as JSON; raises `InputError` if it cannot be JSON or the solution is inconsistent."""
    try:
        text = json.dumps(_jsonable({**meta, "format": FORMAT, "version": VERSION}), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"meta of the solution cannot be written as JSON: {error}") from None
    problem = inconsistency(arrays, model_text, json.loads(text))
    if problem:
        raise InputError(f"the solution is inconsistent: {problem}")
    return text


def _jsonable(value: Any) -> Any:
    """Plain Python for JSON: arrays become lists, infinite limits null."""
    if isinstance(value, dict):
        return {str(key): _jsonable(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_jsonable(entry) for entry in value]
    return None if isinstance(value, float) and math.isinf(value) else value


def read_solution_file(path: str | Path) -> tuple[dict[str, Any], str, dict[str, np.ndarray]]:
    """Read meta, the model's text and arrays; raises a one-line `SolutionFileError`; see `Solution.load`."""
    source = expanded(path)
    return parse_solution(_content(source), source)


def parse_solution(content: bytes, source: Path) -> tuple[dict[str, Any], str, dict[str, np.ndarray]]:
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
    text = str(arrays["model"])
    try:
        values = read_only(arrays)
        problem = inconsistency(values, text, meta)
    except InputError as error:
        problem = str(error)
    if problem:
        raise SolutionFileError(f"{source}: {problem}")
    values["f"] = _forces_of_contacts(meta, values)
    return meta, text, values


def _forces_of_contacts(meta: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Wrenches (K, nc, 6) without those of payloads, which earlier files have as inactive contacts."""
    f = arrays["f"].copy()
    for entry in meta.get("payloads") or []:
        column = meta["contact_frames"].index(entry["frame"])
        carried = np.isin(arrays["phase"], entry["phases"]) & ~arrays["active"][:, column]
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
