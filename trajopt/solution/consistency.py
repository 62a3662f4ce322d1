"""Consistency of a solution: keys, shapes, finite numbers, times in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError, SolutionFileError, is_number
from trajopt.robot.actuators.drive import Drive
from trajopt.solution.arrays import OTHERS, REQUESTS, SAMPLED, model_from_text, runs
from trajopt.solution.descriptions import body_scene_of, patches_of, surfaces_of

META_KEYS = (
    "format",
    "version",
    "problem",
    "parameters",
    "robot",
    "contact_frames",
    "contact_kinds",
    "friction",
    "effort_limit",
    "velocity_limit",
    "terrain",
    "transcription",
    "solver",
    "status",
    "success",
    "iterations",
    "objective",
    "tolerance",
    "wall_time_s",
    "gravity",
    "versions",
)

_Arrays = Mapping[str, np.ndarray]
# Arrays of points that are NaN where there is none.
GOALS = ("com_goal", "foot_goal")

# Times are sums of steps: equal up to rounding, relative to the duration.
SAME_TIME = 1e-9


def inconsistency(arrays: _Arrays, model_text: str, meta: dict[str, Any]) -> str:
    """Return the first thing wrong with a solution's arrays and its JSON ``meta``, or an empty text.

    Raises `InputError` where the model's text is damaged.
    """
    wrong = _wrong_meta(meta)
    if wrong:
        return wrong
    model = model_from_text(model_text)
    return (
        _wrong_shape(arrays, model, meta)
        or wrong_number(arrays)
        or _wrong_time(arrays)
        or _wrong_descriptions(arrays, model, meta)
        or _wrong_phases(arrays, meta)
    )


def _wrong_meta(meta: dict[str, Any]) -> str:
    missing = [key for key in META_KEYS if key not in meta]
    if missing:
        return "meta lacks " + ", ".join(repr(key) for key in missing)
    frames, kinds, friction = meta["contact_frames"], meta["contact_kinds"], meta["friction"]
    if not all(isinstance(entry, list) for entry in (frames, kinds, friction)):
        return "contact_frames, contact_kinds and friction of meta must be lists"
    if not len(frames) == len(kinds) == len(friction):
        return f"meta has {len(frames)} contact_frames, {len(kinds)} contact_kinds, {len(friction)} friction"
    names = meta.get("contact_names", frames)
    if not isinstance(names, list) or len(names) != len(frames) or not all(isinstance(n, str) for n in names):
        return f"contact_names {names} are not a name for each of the {len(frames)} contact_frames"
    if not all(kind in ("point", "surface") for kind in kinds):
        return f"contact_kinds {kinds} are not all 'point' or 'surface'"
    if not all(is_number(mu) and mu >= 0 for mu in friction):
        return f"friction {friction} is not a list of numbers >= 0"
    for key in ("effort_limit", "velocity_limit"):
        limit = meta[key]
        if limit is not None and not (
            isinstance(limit, list)
            and all(entry is None or (is_number(entry) and entry >= 0) for entry in limit)
        ):
            return f"{key} of meta is not null or a list of numbers >= 0"
    if not isinstance(meta["success"], bool):
        return "success of meta is not true or false"
    for key in ("parameters", "versions"):
        if not isinstance(meta[key], dict):
            return f"{key} of meta is not an object"
    if not is_number(meta["tolerance"]):
        return f"tolerance {meta['tolerance']!r} of meta is not a number"
    return (
        _wrong_sizes(meta.get("contact_sizes"), kinds)
        or _wrong_radii(meta.get("contact_radius"), kinds)
        or _wrong_drives(meta.get("drives"))
    )


def _wrong_sizes(sizes: Any, kinds: list[str]) -> str:
    """Optional key of meta: [half_length, half_width] (m) of each sole, null for a point."""
    if sizes is None:
        return ""
    pairs = isinstance(sizes, list) and all(
        size is None or (isinstance(size, list) and len(size) == 2 and all(is_number(x) for x in size))
        for size in sizes
    )
    if not pairs or len(sizes) != len(kinds):
        return "contact_sizes of meta is not a list of null or [half_length, half_width] for each contact"
    return ""


def _wrong_radii(radii: Any, kinds: list[str]) -> str:
    """Optional key of meta: the radius (m) of each contact's ball, zero for a point and a sole."""
    if radii is None:
        return ""
    numbers = isinstance(radii, list) and all(is_number(radius) and radius >= 0 for radius in radii)
    if not numbers or len(radii) != len(kinds):
        return "contact_radius of meta is not a list of a number >= 0 for each contact"
    if any(radius and kind == "surface" for radius, kind in zip(radii, kinds, strict=True)):
        return "contact_radius of meta is not 0 for a sole"
    return ""


def _wrong_drives(drives: Any) -> str:
    """Optional key of meta: the drive of each actuated row as an object of its fields, null without."""
    if drives is None:
        return ""
    if not isinstance(drives, list):
        return "drives of meta is not a list"
    try:
        for entry in drives:
            if entry is not None:
                Drive.from_meta(entry)
    except InputError as error:
        return f"drives of meta: {error}"
    return ""


def _wrong_descriptions(arrays: _Arrays, model: pin.Model, meta: dict[str, Any]) -> str:
    """Optional keys of meta: the scene of collisions; surfaces and patches by phase and contact frame."""
    try:
        body_scene_of(model, meta)
        read: dict[str, Sequence[Mapping[str, object]]] = {
            "surfaces": surfaces_of(meta.get("surfaces")),
            "patches": patches_of(meta.get("patches")),
        }
    except SolutionFileError as error:
        return str(error)
    count = int(arrays["phase"][-1]) + 1
    for key, phases in read.items():
        if phases and len(phases) != count:
            return f"{key} of meta has {len(phases)} entries for {arrays['phase'][-1] + 1} phases"
        for rows in runs(arrays["phase"]) if phases else ():
            active = {meta["contact_frames"][i] for i in np.flatnonzero(arrays["active"][rows.start])}
            unknown = set(phases[int(arrays["phase"][rows.start])]) - active
            if unknown:
                return f"{key} of meta names {', '.join(sorted(unknown))}, not in contact in that phase"
    return ""


def _wrong_phases(arrays: _Arrays, meta: dict[str, Any]) -> str:
    """Optional keys of meta: the name of each phase, and the payloads with their phases."""
    names, count = meta.get("phase_names"), int(arrays["phase"][-1]) + 1
    if names is not None and not (
        isinstance(names, list) and len(names) == count and all(isinstance(name, str) for name in names)
    ):
        return f"phase_names of meta is not a list of {count} texts, one for each phase"
    payloads = meta.get("payloads")
    if payloads is None:
        return ""
    if not isinstance(payloads, list):
        return "payloads of meta is not a list"
    for entry in payloads:
        if not _is_payload(entry, meta["contact_frames"]):
            return f"payloads of meta holds {entry!r}, allowed: frame, mass, centre, inertia, phases"
    return ""


def _is_payload(entry: Any, frames: list[str]) -> bool:
    if not isinstance(entry, dict) or entry.get("frame") not in frames:
        return False
    phases, mass = entry.get("phases"), entry.get("mass")
    try:
        shapes = [np.shape(np.array(entry[key], dtype=float)) for key in ("centre", "inertia")]
    except (KeyError, TypeError, ValueError):
        return False
    indices = isinstance(phases, list) and all(type(phase) is int for phase in phases)
    return indices and is_number(mass) and shapes == [(3,), (3, 3)]


def _wrong_shape(arrays: _Arrays, model: pin.Model, meta: dict[str, Any]) -> str:
    contacts, samples = len(meta["contact_frames"]), len(arrays["t"])
    actuated = arrays["tau"].shape[-1] if arrays["tau"].ndim == 2 else 0
    expected = {
        "q": (samples, model.nq),
        "v": (samples, model.nv),
        "a": (samples, model.nv),
        "f": (samples, contacts, 6),
        "active": (samples, contacts),
        "tau": (samples, actuated),
        "interval_t": (len(arrays["interval_t"]), 2),
    }
    for name, shape in expected.items():
        if arrays[name].shape != shape:
            return f"'{name}' has shape {arrays[name].shape}, expected {shape}"
    if actuated > model.nv:
        return f"'tau' has {actuated} columns, more than nv = {model.nv}"
    for key, size in (("effort_limit", actuated), ("velocity_limit", model.nv)):
        if meta[key] is not None and len(meta[key]) != size:
            return f"{key} of meta has {len(meta[key])} entries, expected {size}"
    if meta.get("drives") is not None and len(meta["drives"]) != actuated:
        return f"drives of meta has {len(meta['drives'])} entries, expected {actuated}"
    for frame in meta["contact_frames"]:
        if not isinstance(frame, str) or not model.existFrame(frame):
            return f"contact frame {frame!r} is not in the model"
    return (
        _wrong_impacts(arrays, contacts)
        or _wrong_multipliers(arrays, meta)
        or _wrong_requests(arrays, contacts)
    )


def _wrong_multipliers(arrays: _Arrays, meta: dict[str, Any]) -> str:
    rows, place, bounds = (
        arrays.get("row_multiplier"),
        arrays.get("row_place"),
        arrays.get("bound_multiplier"),
    )
    given = [array is not None for array in (rows, place, bounds)]
    if not any(given):
        return ""
    if rows is None or place is None or bounds is None:
        return "'row_multiplier', 'row_place' and 'bound_multiplier' must come together"
    if rows.ndim != 1 or bounds.ndim != 1 or place.shape != (len(rows), 3):
        return f"'row_place' has shape {place.shape}, expected (R, 3) with R as 'row_multiplier'"
    names = meta.get("row_names")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return "row_names of meta must be a list of texts where there are multipliers"
    if not np.isin(place[:, 0], np.arange(len(names))).all():
        return f"'row_place' names blocks that are not within 0 to {len(names) - 1}"
    return ""


def _wrong_impacts(arrays: _Arrays, contacts: int) -> str:
    impulse, index = arrays.get("impulse"), arrays.get("impact_index")
    if impulse is None and index is None:
        return ""
    if impulse is None or index is None:
        return "'impulse' and 'impact_index' must come together"
    if index.ndim != 1 or impulse.shape != (len(index), contacts, 6):
        return f"'impulse' has shape {impulse.shape}, expected (J, {contacts}, 6) with J as 'impact_index'"
    if not np.isin(index, np.arange(len(arrays["t"]))).all():
        return f"'impact_index' is not within 0 to {len(arrays['t']) - 1}"
    starts = [rows.start for rows in runs(arrays["interval"])[1:]]
    for row in index:
        if row not in starts:
            return f"'impact_index' holds {row}, which is not the first sample of an interval after another"
    return ""


def _wrong_requests(arrays: _Arrays, contacts: int) -> str:
    """What a controller asked for comes together, one row per sample; goals are whole points or none."""
    samples, given = len(arrays["t"]), [name for name in REQUESTS if arrays.get(name) is not None]
    if not given:
        return ""
    if len(given) < len(REQUESTS):
        return f"{', '.join(map(repr, REQUESTS))} must come together"
    expected = {"asked_force": (contacts, 6), "com_goal": (3,), "foot_goal": (contacts, 3)}
    for name, shape in expected.items():
        array = arrays[name]
        if array.shape != (samples, *shape):
            return f"'{name}' has shape {array.shape}, expected {(samples, *shape)}"
        known = ~np.isnan(array)
        if name in GOALS and (known.any(axis=-1) != known.all(axis=-1)).any():
            return f"'{name}' holds points that are NaN in part"
    return ""


def wrong_number(arrays: _Arrays) -> str:
    """Return the first array with a number that is not finite, or an empty text."""
    for name, kind in {**SAMPLED, **OTHERS}.items():
        array = arrays.get(name)
        if array is None or kind is not float:
            continue
        wrong = np.isinf(array) if name in GOALS else ~np.isfinite(array)
        if wrong.any():
            first = tuple(np.argwhere(wrong)[0].tolist())
            return f"'{name}' holds NaN or infinity, first at {first}"
    return ""


def _wrong_time(arrays: _Arrays) -> str:
    if len(arrays["t"]) < 2:
        return f"{len(arrays['t'])} samples, at least 2 are needed"
    for name in ("interval", "phase"):
        index = arrays[name]
        if index[0] != 0 or not np.isin(np.diff(index), (0, 1)).all():
            return f"'{name}' does not count up from 0 in steps of one"
    edges = arrays["interval_t"]
    if len(edges) != arrays["interval"][-1] + 1:
        return f"'interval_t' has {len(edges)} rows for {arrays['interval'][-1] + 1} intervals"
    same = SAME_TIME * max(abs(float(edges[-1, 1] - edges[0, 0])), 1e-3)
    if not (edges[:, 1] > edges[:, 0]).all() or (np.abs(edges[1:, 0] - edges[:-1, 1]) > same).any():
        return "'interval_t' is not increasing and without gaps"
    for number, rows in enumerate(runs(arrays["interval"])):
        wrong = _wrong_interval(arrays, rows, edges[number], same)
        if wrong:
            return f"interval {number}: {wrong}"
    return ""


def _wrong_interval(arrays: _Arrays, rows: range, edges: np.ndarray, same: float) -> str:
    t, points = arrays["t"][rows.start : rows.stop], arrays["collocation"][rows.start : rows.stop]
    if len(rows) < 2 or abs(t[0] - edges[0]) > same or abs(t[-1] - edges[1]) > same:
        return "its samples do not start and end with its nodes"
    if (np.diff(t) < 0).any():
        return "'t' decreases"
    if not points.any() or (np.diff(t[points]) <= 0).any():
        return "it has no collocation points, or two at one time"
    if len(np.unique(arrays["phase"][rows.start : rows.stop])) > 1:
        return "'phase' changes within it"
    if len(np.unique(arrays["active"][rows.start : rows.stop], axis=0)) > 1:
        return "'active' changes within it"
    return ""
