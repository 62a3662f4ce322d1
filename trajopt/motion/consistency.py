"""The arrays of a solution: names and types, and whether they are consistent with its description."""

import itertools
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.motion.description import PlanDescription
from trajopt.motion.statistics import SolveStatistics
from trajopt.robot.actuators.joint_limits import require_joint_limits
from trajopt.robot.actuators.mimic import require_mimics

_Record = TypeVar("_Record")
_Arrays = Mapping[str, np.ndarray]
# Type of each array with one row per sample.
SAMPLED: dict[str, type] = {
    "t": float,
    "phase": int,
    "interval": int,
    "collocation": bool,
    "q": float,
    "v": float,
    "a": float,
    "tau": float,
    "f": float,
    "active": bool,
}
# Requests of a whole-body controller in a simulation, one row per sample.
REQUESTS: dict[str, type] = {"asked_force": float, "com_goal": float, "foot_goal": float}
OTHERS: dict[str, type] = {
    "interval_t": float,
    "impulse": float,
    "impact_index": int,
    "row_multiplier": float,
    "row_place": int,
    "bound_multiplier": float,
    "gain": float,
    **REQUESTS,
}
# Arrays that may be absent from a solution.
OPTIONAL = (*REQUESTS, "impulse", "impact_index", "row_multiplier", "row_place", "bound_multiplier", "gain")
# Arrays of points that are NaN where there is no point.
GOALS = ("com_goal", "foot_goal")

# Times are sums of steps, so they are equal only up to rounding, relative to the duration.
SAME_TIME = 1e-9


def read_only(given: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return read-only copies of a solution's arrays with their types, without absent optional arrays.

    Raises `InputError` if a value is not an array of its type, or does not have one row per sample.
    """
    arrays: dict[str, np.ndarray] = {}
    for name, dtype in {**SAMPLED, **OTHERS}.items():
        if given.get(name) is None and name in OPTIONAL:
            continue
        try:
            arrays[name] = np.array(given.get(name), dtype=dtype)
        except (TypeError, ValueError):
            raise InputError(f"'{name}' of the solution is not an array of {dtype.__name__}") from None
        arrays[name].setflags(write=False)
    samples = arrays["t"].shape
    for name in SAMPLED:
        shape = arrays[name].shape
        if len(samples) != 1 or shape[:1] != samples:
            raise InputError(
                f"'{name}' of the solution has shape {shape}", f"first dimension as t: {samples}"
            )
    return arrays


def rows_of(record: _Record, rows: slice | int | list[int] | np.ndarray) -> _Record:
    """Return the record with only the given rows of each array."""
    return type(record)(**{name: array[rows] for name, array in vars(record).items()})


def runs(index: np.ndarray) -> tuple[range, ...]:
    """Return the ranges of equal consecutive values."""
    edges = [0, *(np.flatnonzero(np.diff(index)) + 1).tolist(), len(index)]
    return tuple(range(start, stop) for start, stop in itertools.pairwise(edges) if stop > start)


def inconsistency(
    arrays: _Arrays, model: pin.Model, plan: PlanDescription, statistics: SolveStatistics
) -> str:
    """Return the first inconsistency of a solution's arrays and description, or an empty string."""
    return (
        _wrong_shape(arrays, model, plan, statistics)
        or wrong_number(arrays)
        or _wrong_time(arrays)
        or _wrong_scenes(model, plan)
        or _wrong_phases(arrays, plan)
    )


def _wrong_scenes(model: pin.Model, plan: PlanDescription) -> str:
    """Return which scene of bodies does not fit the model, or an empty string."""
    for key, scene in (("bodies", plan.body_scene), ("collision", plan.capsule_scene)):
        try:
            scene(model)
        except InputError as error:
            return f"{key} of meta: {error}"
    if plan.margins is not None and (
        plan.bodies is None or len(plan.margins.pairs) != len(plan.bodies.pairs)
    ):
        return "margins of bodies of meta are not those of its pairs"
    return ""


def _wrong_phases(arrays: _Arrays, plan: PlanDescription) -> str:
    """Return which names, surfaces or patches do not fit the phases of the arrays, or an empty string."""
    count = int(arrays["phase"][-1]) + 1
    if len(plan.phase_names) != count:
        return f"phase_names of meta is not a list of {count} texts, one for each phase"
    described: dict[str, tuple[Mapping[str, Any], ...]] = {"surfaces": plan.surfaces, "patches": plan.patches}
    for key, phases in described.items():
        if phases and len(phases) != count:
            return f"{key} of meta has {len(phases)} entries for {count} phases"
        for rows in runs(arrays["phase"]) if phases else ():
            active = {plan.frames[i] for i in np.flatnonzero(arrays["active"][rows.start])}
            unknown = set(phases[int(arrays["phase"][rows.start])]) - active
            if unknown:
                return f"{key} of meta names {', '.join(sorted(unknown))}, not in contact in that phase"
    return ""


def _wrong_shape(
    arrays: _Arrays, model: pin.Model, plan: PlanDescription, statistics: SolveStatistics
) -> str:
    contacts, samples = len(plan.contacts), len(arrays["t"])
    actuated = arrays["tau"].shape[-1] if arrays["tau"].ndim == 2 else 0
    expected = {
        **dict.fromkeys(("phase", "interval", "collocation"), (samples,)),
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
    most = model.nv + len(plan.thrusters)
    if not len(plan.thrusters) <= actuated <= most:
        return f"'tau' has {actuated} columns, not {len(plan.thrusters)} to {most}"
    try:
        for thruster in plan.thrusters:
            thruster.column(model)
        for force in plan.joint_forces:
            force.entries(model)
        for wrench in plan.wrenches:
            wrench.place(model)
        require_mimics(plan.robot, model, plan.mimics)
        require_joint_limits(model, plan.joint_limits)
    except InputError as error:
        return str(error)
    for key, limit, size in (
        ("effort_limit", plan.effort_limit, actuated),
        ("velocity_limit", plan.velocity_limit, model.nv),
        ("actuated_rows", plan.actuated_rows, actuated - len(plan.thrusters)),
        ("drives", plan.drives or None, actuated),
        ("index of periodicity", None if plan.periodicity is None else plan.periodicity.index, model.nv),
    ):
        if limit is not None and len(limit) != size:
            return f"{key} of meta has {len(limit)} entries, expected {size}"
    single = [joint.nv == 1 for joint in list(model.joints)[1:] for _ in range(joint.nv)]
    if plan.periodicity is not None and single != [single[row] for row in plan.periodicity.index]:
        return "index of periodicity of meta does not take joints to joints"
    if plan.actuated_rows is not None and (plan.actuated_rows >= model.nv).any():
        return f"actuated_rows of meta are {plan.actuated_rows.tolist()}, of {model.nv} rows of v"
    for frame in plan.frames:
        if not isinstance(frame, str) or not model.existFrame(frame):
            return f"contact frame {frame!r} is not in the model"
    return (
        _wrong_impacts(arrays, contacts)
        or _wrong_multipliers(arrays, statistics.row_names)
        or _wrong_requests(arrays, contacts)
        or _wrong_gain(arrays, model)
    )


def _wrong_multipliers(arrays: _Arrays, names: tuple[str, ...]) -> str:
    rows, place, bounds = map(arrays.get, ("row_multiplier", "row_place", "bound_multiplier"))
    if rows is None and place is None and bounds is None:
        return ""
    if rows is None or place is None or bounds is None:
        return "'row_multiplier', 'row_place' and 'bound_multiplier' must come together"
    if rows.ndim != 1 or bounds.ndim != 1 or place.shape != (len(rows), 3):
        return f"'row_place' has shape {place.shape}, expected (R, 3) with R as 'row_multiplier'"
    if not np.isin(place[:, 0], np.arange(len(names))).all():
        return f"'row_place' names blocks that are not within 0 to {len(names) - 1}"
    return ""


def _wrong_gain(arrays: _Arrays, model: pin.Model) -> str:
    gain, expected = arrays.get("gain"), (len(arrays["interval_t"]), arrays["tau"].shape[-1], 2 * model.nv)
    if gain is not None and gain.shape != expected:
        return f"'gain' has shape {gain.shape}, expected {expected}"
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
    """Return what is wrong with a controller's requests: all are given with one row per sample, or none."""
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
    """Return the first array with a number that is not finite, or an empty string."""
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
