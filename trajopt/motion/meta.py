"""Conversion between the JSON entry ``meta`` of a solution file and records."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any, TypeVar, cast, get_args

import numpy as np

from trajopt.arguments import kinds_of_fields
from trajopt.collision.description import RobotShapes
from trajopt.collision.shapes import LinkShape, obstacle_from_description
from trajopt.errors import InputError, SolutionFileError, is_number, shown
from trajopt.kinds import RefusedError
from trajopt.motion.description import (
    BodyMargins,
    CarriedBody,
    DynamicsKind,
    PeriodicImage,
    PlanDescription,
    PlannedContact,
)
from trajopt.motion.statistics import GradedStatistics, RoundStatistics, SolveStatistics, TermExcess
from trajopt.robot.actuators.actuation import Thruster
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.actuators.joint_force import JointForce
from trajopt.robot.actuators.joint_limits import JointLimits
from trajopt.robot.actuators.mimic import MimicJoint
from trajopt.robot.data import VisualSource
from trajopt.robot.link_wrench import LinkWrench
from trajopt.schedule.moment import Target
from trajopt.terrain.patch import Patch
from trajopt.terrain.surface import Surface
from trajopt.terrain.terrain import terrain_from_description
from trajopt.transcription.mesh import Mesh, PhaseMesh

_Read = TypeVar("_Read")
_Json = dict[str, Any]

# Keys in every file.
REQUIRED = (
    *("format", "version", "problem", "parameters", "robot", "contact_frames", "contact_kinds", "friction"),
    *("effort_limit", "velocity_limit", "terrain", "transcription", "solver", "status", "success"),
    *("iterations", "objective", "tolerance", "wall_time_s", "gravity", "versions"),
)
# Keys of descriptions, then keys derived from arrays; all others belong to statistics.
DESCRIBED = (
    *("problem", "parameters", "robot", "actuation", "dynamics", "gravity"),
    *("effort_limit", "velocity_limit", "actuated_rows", "thrusters", "joint_forces", "mimics"),
    "joint_limits",
    *("contact_frames", "contact_names", "contact_kinds", "contact_sizes", "contact_radius", "friction"),
    *("contact_rolling", "wrenches"),
    *("terrain", "surfaces", "patches", "goals", "payloads", "periodicity", "drives", "bodies", "collision"),
    *("visual", "phase_names"),
)
DERIVED_ENTRIES = ("format", "version", "durations", "intervals", "units", "simulated")
# Statistics that are never null.
REQUIRED_STATISTICS = ("transcription", "solver", "status", "success", "tolerance", "wall_time_s")
# Lists with an entry for each contact, by the field of `PlannedContact`.
CONTACT_KEYS = {
    "name": "contact_names",
    "kind": "contact_kinds",
    "friction": "friction",
    "half_size": "contact_sizes",
    "radius": "contact_radius",
    "rolling": "contact_rolling",
}
PERIODIC = ("index", "sign", "origin", "translation", "velocity", "turn", "mirror")


def description_of(meta: Mapping[str, Any], n_phases: int) -> PlanDescription:
    """Read a plan's description; raises `SolutionFileError` for an invalid entry."""
    contacts = tuple(_contacts(meta))
    frames = [contact.frame for contact in contacts]
    bodies = _optional(meta, "bodies", RobotShapes.from_description)
    scene = _optional(meta, "collision", _collision) or {}
    _require(isinstance(meta["parameters"], dict), "parameters", "an object")
    return PlanDescription(
        problem=str(meta["problem"]),
        robot=str(meta["robot"]),
        parameters=dict(meta["parameters"]),
        contacts=contacts,
        actuation=str(meta.get("actuation") or "torque"),
        dynamics=_optional(meta, "dynamics", _dynamics) or "held",
        gravity=_optional(meta, "gravity", lambda given: tuple(_numbers(given, (3,)).tolist())),
        effort_limit=_limit(meta, "effort_limit"),
        velocity_limit=_limit(meta, "velocity_limit"),
        actuated_rows=_optional(meta, "actuated_rows", _rows),
        thrusters=tuple(_each(meta, "thrusters", Thruster.from_meta)),
        joint_forces=tuple(_each(meta, "joint_forces", JointForce.from_meta)),
        mimics=tuple(_each(meta, "mimics", MimicJoint.from_meta)),
        wrenches=tuple(_each(meta, "wrenches", lambda entry: LinkWrench(**entry))),
        joint_limits=tuple(_each(meta, "joint_limits", JointLimits.from_meta)),
        terrain=_optional(meta, "terrain", terrain_from_description),
        surfaces=_by_phase(meta, "surfaces", "surface", Surface.from_description),
        patches=_by_phase(meta, "patches", "patch", Patch.from_description),
        goals=tuple(_each(meta, "goals", Target.from_description)),
        payloads=tuple(_each(meta, "payloads", lambda entry: _payload(entry, frames))),
        periodicity=_optional(meta, "periodicity", _periodicity),
        drives=tuple(_each(meta, "drives", lambda e: None if e is None else Drive.from_meta(e))),
        bodies=bodies,
        margins=None if bodies is None else _margins(meta["bodies"].get("margins"), bodies),
        visual=_optional(meta, "visual", VisualSource.from_meta),
        phase_names=_phase_names(meta, n_phases),
        **scene,
    )


def statistics_of(meta: Mapping[str, Any]) -> SolveStatistics:
    """Read how a solution was found; raises `SolutionFileError` for an invalid entry."""
    kinds = kinds_of_fields(SolveStatistics)
    readers: dict[str, Callable[[Any], object]] = {
        "mesh": _mesh,
        "graded": _graded,
        "terms_between": lambda given: tuple(TermExcess(**entry) for entry in given),
    }
    typed = set(kinds) - {"more"}
    values: _Json = {}
    for name in sorted(typed & set(meta)):
        if name in readers:
            values[name] = _optional(meta, name, readers[name])
        elif meta[name] is not None:
            try:
                values[name] = kinds[name](meta[name], name)
            except RefusedError as wrong:
                what = f"{wrong.place} of meta is {shown(wrong.value)}"
                raise SolutionFileError(what, wrong.allowed) from None
    for name in REQUIRED_STATISTICS:
        _require(name in values, name, "stated")
    known = typed | {*DESCRIBED, *DERIVED_ENTRIES}
    return SolveStatistics(
        **{"objective": None, "converged": meta["success"], "iterations": 0, **values},
        more={name: value for name, value in meta.items() if name not in known},
    )


def require_keys(meta: Mapping[str, Any]) -> None:
    """Raise `SolutionFileError` if a key that every file has is missing."""
    missing = [key for key in REQUIRED if key not in meta]
    if missing:
        raise SolutionFileError("meta lacks " + ", ".join(repr(key) for key in missing))


def meta_of(description: PlanDescription, statistics: SolveStatistics) -> _Json:
    """Return the JSON-able entries of both records, without those derived from arrays."""
    plan, contacts = description, description.contacts
    described: _Json = {
        "problem": plan.problem,
        "parameters": dict(plan.parameters),
        "robot": plan.robot,
        "actuation": plan.actuation,
        "gravity": plan.gravity,
        "effort_limit": plan.effort_limit,
        "velocity_limit": plan.velocity_limit,
        "contact_frames": [contact.frame for contact in contacts],
        "contact_names": [contact.name for contact in contacts],
        "contact_kinds": [contact.kind for contact in contacts],
        "contact_sizes": [contact.half_size for contact in contacts],
        "contact_radius": [contact.radius for contact in contacts],
        "friction": [contact.friction for contact in contacts],
        "terrain": None if plan.terrain is None else plan.terrain.describe(),
        "surfaces": _described_by_phase(plan.surfaces),
        "patches": _described_by_phase(plan.patches),
        "goals": [target.describe() for target in plan.goals],
        "phase_names": plan.phase_names,
        **_described_options(plan),
    }
    stated = {field.name: getattr(statistics, field.name) for field in fields(SolveStatistics)}
    more = stated.pop("more")
    if statistics.mesh is not None:
        stated["mesh"] = statistics.mesh.describe()
    if statistics.graded is not None:
        graded = asdict(statistics.graded)
        stated["graded"] = {name: value for name, value in graded.items() if value is not None}
    stated["terms_between"] = [asdict(entry) for entry in statistics.terms_between]
    required = {"objective"}
    known = {name: value for name, value in stated.items() if value is not None or name in required}
    simulated = {"simulated": True} if statistics.simulated else {}
    return jsonable({**described, **known, **simulated, **more})


def _described_options(plan: PlanDescription) -> _Json:
    """Return the entries that are only in files with something to describe."""
    options: _Json = {} if plan.dynamics == "held" else {"dynamics": plan.dynamics}
    if plan.rolling.any():
        options["contact_rolling"] = plan.rolling
    if plan.actuated_rows is not None:
        options["actuated_rows"] = plan.actuated_rows
    for name in ("thrusters", "joint_forces", "mimics", "joint_limits"):
        if getattr(plan, name):
            options[name] = [entry.to_meta() for entry in getattr(plan, name)]
    for name in ("payloads", "wrenches"):
        if getattr(plan, name):
            options[name] = [vars(entry) for entry in getattr(plan, name)]
    if plan.periodicity is not None:
        options["periodicity"] = vars(plan.periodicity)
    if plan.drives:
        options["drives"] = [None if drive is None else drive.to_meta() for drive in plan.drives]
    if plan.bodies is not None:
        margins = {} if plan.margins is None else {"margins": vars(plan.margins)}
        options["bodies"] = {**plan.bodies.describe(), **margins}
    if plan.obstacles or plan.capsules:
        options["collision"] = {
            "capsules": [shape.describe() for shape in plan.capsules],
            "obstacles": [obstacle.describe() for obstacle in plan.obstacles],
            "self_pairs": plan.capsule_pairs,
        }
    if plan.visual is not None:
        options["visual"] = plan.visual.to_meta()
    return options


def _described_by_phase(phases: Sequence[Mapping[str, Surface]] | Sequence[Mapping[str, Patch]]) -> Any:
    described = [{frame: shape.describe() for frame, shape in phase.items()} for phase in phases]
    return described or None


def jsonable(value: Any) -> Any:
    """Convert to plain Python for JSON: tuples and arrays to lists, non-finite numbers to None."""
    if isinstance(value, Mapping):
        return {str(key): jsonable(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [jsonable(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _contacts(meta: Mapping[str, Any]) -> Iterator[PlannedContact]:
    frames = meta["contact_frames"]
    _require(isinstance(frames, list), "contact_frames", "a list")
    columns = {field: meta.get(key) for field, key in CONTACT_KEYS.items()}
    given = {field: column for field, column in columns.items() if column or field in ("kind", "friction")}
    for field, column in given.items():
        fits = isinstance(column, list) and len(column) == len(frames)
        _require(
            fits, CONTACT_KEYS[field], f"a list with an entry for each of the {len(frames)} contact_frames"
        )
    for frame, row in zip(frames, zip(*given.values(), strict=True), strict=True):
        entry = {"name": frame, "frame": frame, **dict(zip(given, row, strict=True))}
        yield _entry("contacts", lambda values: PlannedContact(**values), entry)


def _limit(meta: Mapping[str, Any], key: str) -> np.ndarray | None:
    limit = meta[key]
    if limit is None:
        return None
    entries = isinstance(limit, list) and all(e is None or (is_number(e) and e >= 0) for e in limit)
    _require(entries, key, "null or a list of numbers >= 0")
    return np.array([np.inf if entry is None else entry for entry in limit], dtype=float)


def _rows(given: Any) -> np.ndarray:
    rows = all(type(row) is int and row >= 0 for row in given) and given == sorted(set(given))
    if not rows:
        raise InputError(f"{shown(given)} are no rows of v", "ascending, each once")
    return np.array(given, dtype=int)


def _phase_names(meta: Mapping[str, Any], n_phases: int) -> tuple[str, ...]:
    names = meta.get("phase_names")
    if names is None:
        return tuple(f"phase {number}" for number in range(n_phases))
    _require(_is_list(names, str), "phase_names", "a list of texts, one for each phase")
    return tuple(names)


def _by_phase(
    meta: Mapping[str, Any], key: str, entry: str, read: Callable[[Any], _Read]
) -> tuple[Mapping[str, _Read], ...]:
    described = meta.get(key)
    if described is None:
        return ()
    _require(_is_list(described, dict), key, f"null or a list of {{contact frame: {entry}}}")
    return tuple({frame: _entry(key, read, shape) for frame, shape in phase.items()} for phase in described)


def _payload(entry: Any, frames: Sequence[str]) -> CarriedBody:
    if not isinstance(entry, dict) or entry.get("frame") not in frames:
        raise InputError(f"it holds {shown(entry)}", "frame, mass, centre, inertia, phases")
    return CarriedBody(**entry)


def _periodicity(given: Any) -> PeriodicImage:
    if not isinstance(given, dict) or set(given) != set(PERIODIC):
        raise InputError("it is not an object of its keys", ", ".join(PERIODIC))
    n = len(given["index"]) if isinstance(given["index"], list) else 0
    index, sign = _numbers(given["index"], (n,)), _numbers(given["sign"], (n,))
    if sorted(index.tolist()) != [*range(n)] or (abs(sign) != 1).any():
        raise InputError("index and sign are no rows with signs", "rows of v, and 1 or -1")
    moved = {
        key: None if given[key] is None else tuple(_numbers(given[key], (3,)).tolist())
        for key in ("translation", "velocity")
    }
    return PeriodicImage(
        index=index.astype(int),
        sign=sign,
        origin=_numbers(given["origin"], (3,)),
        turn=float(_numbers(given["turn"], ())),
        mirror=bool(given["mirror"]),
        **moved,
    )


def _collision(given: Any) -> _Json:
    keys = ("capsules", "obstacles", "self_pairs")
    if not isinstance(given, dict) or not all(isinstance(given.get(key), list) for key in keys):
        raise InputError("it is not an object of lists", f"keys: {', '.join(keys)}")
    pairs = given["self_pairs"]
    if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
        raise InputError("self_pairs are not pairs", "allowed: [capsule, capsule] by name")
    return {
        "capsules": tuple(LinkShape.from_description(entry) for entry in given["capsules"]),
        "obstacles": tuple(obstacle_from_description(entry) for entry in given["obstacles"]),
        "capsule_pairs": tuple((str(first), str(second)) for first, second in pairs),
    }


def _margins(given: Any, bodies: RobotShapes) -> BodyMargins | None:
    if given is None:
        return None
    try:
        obstacles, pairs = (
            float(_numbers(given["obstacles"], ())),
            _numbers(given["pairs"], (len(bodies.pairs),)),
        )
    except (KeyError, TypeError, InputError):
        obstacles, pairs = math.nan, np.zeros(0)
    if not (obstacles >= 0 and (pairs >= 0).all()):
        raise SolutionFileError(
            "margins of bodies of meta are not those of its pairs",
            "allowed: {obstacles: m, pairs: [m, ...]}, not negative, one for each of pairs",
        )
    return BodyMargins(obstacles=obstacles, pairs=pairs)


def _dynamics(given: Any) -> DynamicsKind:
    if given not in get_args(DynamicsKind):
        allowed = f"allowed: {', '.join(get_args(DynamicsKind))}"
        raise SolutionFileError(f"dynamics of meta is {shown(given)}", allowed)
    return cast(DynamicsKind, given)


def _mesh(given: Any) -> Mesh:
    return Mesh(phases=tuple(PhaseMesh.from_description(phase) for phase in given))


def _graded(given: Any) -> GradedStatistics:
    return GradedStatistics(**{**given, "rounds": [RoundStatistics(**entry) for entry in given["rounds"]]})


def _numbers(given: Any, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = np.full(1, np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{shown(given)} is not of shape {shape}", "finite numbers")
    return array


def _is_list(value: Any, kind: type) -> bool:
    return isinstance(value, list) and all(isinstance(entry, kind) for entry in value)


def _require(holds: bool, key: str, allowed: str) -> None:
    if not holds:
        raise SolutionFileError(f"{key} of meta is not {allowed}")


def _entry(key: str, read: Callable[[Any], _Read], value: Any) -> _Read:
    """Read one entry; errors name its key."""
    try:
        return read(value)
    except SolutionFileError:
        raise
    except InputError as error:
        raise SolutionFileError(f"{key} of meta: {error.what}", error.allowed) from None
    except (TypeError, KeyError, ValueError, AttributeError, OverflowError):
        raise SolutionFileError(f"{key} of meta is damaged") from None


def _optional(meta: Mapping[str, Any], key: str, read: Callable[[Any], _Read]) -> _Read | None:
    value = meta.get(key)
    return None if value is None else _entry(key, read, value)


def _each(meta: Mapping[str, Any], key: str, read: Callable[[Any], _Read]) -> list[_Read]:
    entries = meta.get(key)
    _require(entries is None or isinstance(entries, list), key, "null or a list")
    return [_entry(key, read, entry) for entry in entries or []]
