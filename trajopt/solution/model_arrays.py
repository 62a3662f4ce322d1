"""A Pinocchio model as plain arrays: tested before Pinocchio sees them, and built again through its API.

Loaded in a process of its own for the text of older files (see `model_text`): it imports little.

One row a joint, the universe first as in Pinocchio (n joints), one a frame (F), one a reference configuration:

| key | shape | content |
|---|---|---|
| `model_name`, `model_bodies` | () | the latter counts bodies, as `pin.Model.nbodies` |
| `model_joint_name`, `model_joint_kind` | (n,) | kind without "JointModel", empty for the universe |
| `model_joint_parent` | (n,) | index of the parent, below the joint's own |
| `model_joint_axis` | (n, 3) | unit axis of kinds that have one of their own, else 0 |
| `model_joint_placement` | (n, 3, 4) | rotation and translation (m) in the parent's axes |
| `model_joint_inertia` | (n, 10) | mass, centre of mass, xx, xy, xz, yy, yz, zz about it |
| `model_` + one of `_PER_VELOCITY` | (nv,) | limits, friction, damping, armature, rotors |
| `model_` + one of `_PER_POSITION` | (nq,) | limits of positions, and their margin |
| `model_gravity` | (6,) | linear and angular |
| `model_frame_name`, `model_frame_type` | (F,) | name and type together are unique |
| `model_frame_joint`, `model_frame_parent` | (F,) | index of the joint, and of the frame before it |
| `model_frame_placement`, `model_frame_inertia` | (F, 3, 4), (F, 10) | in the joint's axes |
| `model_reference_name`, `model_reference` | (r,), (r, nq) | reference configurations |
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError, first_line

# Joints by kind, with the sizes of their positions and velocities: those that trajopt.dynamics supports.
JOINT_SIZES: dict[str, tuple[int, int]] = {
    "FreeFlyer": (7, 6),
    "Planar": (4, 3),
    **dict.fromkeys(("RX", "RY", "RZ", "RevoluteUnaligned"), (1, 1)),
    **dict.fromkeys(("RUBX", "RUBY", "RUBZ", "RevoluteUnboundedUnaligned"), (2, 1)),
    **dict.fromkeys(("PX", "PY", "PZ", "PrismaticUnaligned"), (1, 1)),
    "Spherical": (4, 3),
    "SphericalZYX": (3, 3),
    "Translation": (3, 3),
}
FRAME_TYPES = ("OP_FRAME", "JOINT", "FIXED_JOINT", "BODY", "SENSOR")
UNIVERSE = "universe"
# More than any robot has: memory and time of Pinocchio's algorithms grow with their squares.
MOST_JOINTS, MOST_FRAMES, MOST_REFERENCES = 1000, 10_000, 1000
LONGEST_NAME = 500
# Largest length (m), mass (kg), inertia (kg m^2), friction, damping or gravity: squares and cubes stay finite.
LARGEST = 1e9
# Rounding of a rotation's numbers written as decimals, and of the length of an axis.
ROTATION_ERROR = 1e-6
# Control characters and halves of surrogate pairs, which are no text that could be shown.
UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]")

# Key without "model_" -> field of `pin.Model`, and whether it may be infinite.
_PER_VELOCITY: dict[str, tuple[str, bool]] = {
    "effort_lower": ("lowerEffortLimit", True),
    "effort_upper": ("upperEffortLimit", True),
    "velocity_lower": ("lowerVelocityLimit", True),
    "velocity_upper": ("upperVelocityLimit", True),
    "friction_lower": ("lowerDryFrictionLimit", False),
    "friction_upper": ("upperDryFrictionLimit", False),
    "damping": ("damping", False),
    "armature": ("armature", False),
    "rotor_inertia": ("rotorInertia", False),
    "rotor_gear_ratio": ("rotorGearRatio", False),
}
_PER_POSITION: dict[str, tuple[str, bool]] = {
    "position_lower": ("lowerPositionLimit", True),
    "position_upper": ("upperPositionLimit", True),
    "position_margin": ("positionLimitMargin", False),
}
_LIMITS = _PER_VELOCITY | _PER_POSITION
# Key -> kind of its numbers, as `numpy.dtype.kind` has them.
MODEL_KINDS: dict[str, str] = {
    **dict.fromkeys(("model_name", "model_joint_name", "model_joint_kind", "model_frame_name"), "U"),
    **dict.fromkeys(("model_frame_type", "model_reference_name"), "U"),
    **dict.fromkeys(("model_bodies", "model_joint_parent", "model_frame_joint", "model_frame_parent"), "iu"),
    **dict.fromkeys(("model_joint_axis", "model_joint_placement", "model_joint_inertia"), "f"),
    **dict.fromkeys(("model_frame_placement", "model_frame_inertia", "model_gravity", "model_reference"), "f"),
    **dict.fromkeys((f"model_{key}" for key in _LIMITS), "f"),
}
_WITH_AXIS = ("RevoluteUnaligned", "RevoluteUnboundedUnaligned", "PrismaticUnaligned")
_UPPER = np.triu_indices(3)
# An axis whose numbers are found again in a model's text, see `_continuous`.
_KNOWN_AXIS = (0.48, 0.6, 0.64)

_Arrays = Mapping[str, np.ndarray]


def model_to_arrays(model: pin.Model) -> dict[str, np.ndarray]:
    """The arrays of a model, which `model_from_arrays` takes. Raises `InputError` for one that it refuses."""
    frames, references = list(model.frames), dict(_references(model))
    arrays = {
        "model_name": np.array(model.name),
        "model_bodies": np.array(model.nbodies, dtype=np.int64),
        "model_joint_name": _texts(model.names),
        "model_joint_kind": _texts(["", *(_kind(joint) for joint in list(model.joints)[1:])]),
        "model_joint_parent": np.array(list(model.parents), dtype=np.int64),
        "model_joint_axis": np.array([_axis(model, index) for index in range(model.njoints)]),
        "model_joint_placement": _placements(model.jointPlacements),
        "model_joint_inertia": _inertias(model.inertias),
        "model_gravity": np.array(model.gravity.vector),
        "model_frame_name": _texts([frame.name for frame in frames]),
        "model_frame_type": _texts([frame.type.name for frame in frames]),
        "model_frame_joint": np.array([frame.parentJoint for frame in frames], dtype=np.int64),
        "model_frame_parent": np.array([frame.parentFrame for frame in frames], dtype=np.int64),
        "model_frame_placement": _placements([frame.placement for frame in frames]),
        "model_frame_inertia": _inertias([frame.inertia for frame in frames]),
        "model_reference_name": _texts(list(references)),
        "model_reference": np.array(list(references.values())).reshape(len(references), model.nq),
        **{f"model_{key}": np.array(getattr(model, field)) for key, (field, _) in _LIMITS.items()},
    }
    _require_valid(arrays)
    return arrays


def model_from_arrays(arrays: _Arrays) -> pin.Model:
    """The model of `model_to_arrays`, equal in every field.

    Every count, index, name and number is tested first: Pinocchio trusts its input. Raises `InputError`.
    """
    _require_valid(arrays)
    try:
        return _built({key.removeprefix("model_"): arrays[key] for key in MODEL_KINDS})
    except (ValueError, RuntimeError) as error:  # what Pinocchio itself refuses
        raise InputError(f"the model cannot be built: {first_line(error)}") from None


def _built(given: _Arrays) -> pin.Model:
    model = pin.Model()
    model.name = str(given["name"])
    kinds, names = given["joint_kind"].tolist(), given["joint_name"].tolist()
    placements = [_se3(entry) for entry in given["joint_placement"]]
    for index in range(1, len(names)):
        joint = _joint(kinds[index], given["joint_axis"][index])
        model.addJoint(int(given["joint_parent"][index]), joint, placements[index], names[index])
    for _ in range(int(given["bodies"]) - model.nbodies):  # counts; the inertias themselves come next
        model.appendBodyToJoint(0, pin.Inertia.Zero(), pin.SE3.Identity())
    for index, entry in enumerate(given["joint_inertia"]):
        model.inertias[index] = _inertia(entry)
    model.gravity = pin.Motion(np.array(given["gravity"], dtype=float))
    for key, (field, _) in _LIMITS.items():
        setattr(model, field, np.array(given[key], dtype=float))
    for index, name in enumerate(given["frame_name"].tolist()):
        frame = pin.Frame(
            name,
            int(given["frame_joint"][index]),
            int(given["frame_parent"][index]),
            _se3(given["frame_placement"][index]),
            pin.FrameType.names[str(given["frame_type"][index])],
            _inertia(given["frame_inertia"][index]),
        )
        if index == 0:
            model.frames[0] = frame
        else:
            model.addFrame(frame, False)
    for name, row in zip(given["reference_name"].tolist(), given["reference"], strict=True):
        model.referenceConfigurations[name] = np.array(row, dtype=float)
    return model


def _require_valid(arrays: _Arrays) -> None:
    """Raise `InputError` for the first thing that Pinocchio must not see."""
    missing = [key for key in MODEL_KINDS if key not in arrays]
    if missing:
        raise InputError(f"the model lacks {', '.join(missing)}")
    for key, kind in MODEL_KINDS.items():
        if arrays[key].dtype.kind not in kind:
            raise InputError(f"'{key}' is of type {arrays[key].dtype}", {"U": "texts", "f": "floats"}.get(kind, "ints"))
    _require_sizes(arrays)
    _require_names(arrays)
    _require_tree(arrays)
    for key in ("model_joint_placement", "model_frame_placement"):
        _require_placements(key, arrays[key])
    for key in ("model_joint_inertia", "model_frame_inertia", "model_reference", "model_gravity"):
        _require_bounded(key, arrays[key])
    for key, (_, infinite) in _LIMITS.items():
        values = arrays[f"model_{key}"]
        if infinite and np.isnan(values).any():
            raise InputError(f"'model_{key}' holds NaN", "allowed: numbers, inf where there is no limit")
        if not infinite:
            _require_bounded(f"model_{key}", values)


def _require_sizes(arrays: _Arrays) -> None:
    counts = {}
    for key, most in (("joint_name", MOST_JOINTS), ("frame_name", MOST_FRAMES), ("reference_name", MOST_REFERENCES)):
        shape, least = arrays[f"model_{key}"].shape, 0 if key == "reference_name" else 1
        if len(shape) != 1 or not least <= shape[0] <= most:
            raise InputError(f"'model_{key}' has shape {shape}", f"allowed: ({least} to {most},)")
        counts[key] = shape[0]
    n, frames = counts["joint_name"], counts["frame_name"]
    _require_shape(arrays, "model_joint_kind", (n,))
    kinds = arrays["model_joint_kind"].tolist()
    for name, kind in zip(arrays["model_joint_name"].tolist()[1:], kinds[1:], strict=True):
        if kind not in JOINT_SIZES:
            raise InputError(f"joint {name!r:.60} is of kind {kind!r:.60}", f"allowed: {', '.join(JOINT_SIZES)}")
    nq, nv = (sum(JOINT_SIZES[kind][part] for kind in kinds[1:]) for part in (0, 1))
    for key in ("model_joint_parent", "model_joint_inertia", "model_joint_placement", "model_joint_axis"):
        _require_shape(arrays, key, (n, *_ENTRY.get(key.removeprefix("model_joint_"), ())))
    for key in ("type", "joint", "parent", "inertia", "placement"):
        _require_shape(arrays, f"model_frame_{key}", (frames, *_ENTRY.get(key, ())))
    for key in _PER_VELOCITY:
        _require_shape(arrays, f"model_{key}", (nv,))
    for key in _PER_POSITION:
        _require_shape(arrays, f"model_{key}", (nq,))
    _require_shape(arrays, "model_reference", (counts["reference_name"], nq))
    _require_shape(arrays, "model_gravity", (6,))
    for key in ("model_name", "model_bodies"):
        _require_shape(arrays, key, ())
    if not 1 <= int(arrays["model_bodies"]) <= MOST_FRAMES:
        raise InputError(f"the model has {arrays['model_bodies']} bodies", f"allowed: 1 to {MOST_FRAMES}")


_ENTRY: dict[str, tuple[int, ...]] = {"inertia": (10,), "placement": (3, 4), "axis": (3,)}


def _require_shape(arrays: _Arrays, key: str, shape: tuple[int, ...]) -> None:
    if arrays[key].shape != shape:
        raise InputError(f"'{key}' has shape {arrays[key].shape}", f"expected {shape}")


def _require_names(arrays: _Arrays) -> None:
    for key in ("model_name", "model_joint_name", "model_frame_name", "model_reference_name"):
        for name in arrays[key].ravel().tolist():
            if len(name) > LONGEST_NAME or UNPRINTABLE.search(name):
                raise InputError(
                    f"'{key}' holds {name!r:.60}",
                    f"allowed: up to {LONGEST_NAME} characters, none of them a control character",
                )
    types = arrays["model_frame_type"].tolist()
    if not set(types) <= set(FRAME_TYPES):
        unknown = next(each for each in types if each not in FRAME_TYPES)
        raise InputError(f"a frame is of type {unknown!r:.60}", f"allowed: {', '.join(FRAME_TYPES)}")
    joints, references = arrays["model_joint_name"].tolist(), arrays["model_reference_name"].tolist()
    frames = [f"{name} ({kind})" for name, kind in zip(arrays["model_frame_name"].tolist(), types, strict=True)]
    for what, names in (("joints", joints), ("frames", frames), ("reference configurations", references)):
        if len(set(names)) != len(names):
            double = next(name for name in names if names.count(name) > 1)
            raise InputError(f"two {what} of the model are named '{double}'", "allowed: different names")
    if joints[0] != UNIVERSE:
        raise InputError(f"the first joint of the model is '{joints[0]}'", f"allowed: {UNIVERSE}")


def _require_tree(arrays: _Arrays) -> None:
    """Joints come after their parents, depth first; axes are unit vectors; frames are on joints that exist."""
    parents = arrays["model_joint_parent"].tolist()
    branch = [0]
    for index, parent in enumerate(parents):
        if not 0 <= parent < max(index, 1):
            raise InputError(f"the parent of joint {index} is joint {parent}", "allowed: one of those before it")
        while index and branch[-1] != parent:
            branch.pop()
            if not branch:
                raise InputError(f"joint {index} comes after another branch of its parent", "allowed: depth first")
        if index:
            branch.append(index)
    for kind, axis in zip(arrays["model_joint_kind"].tolist(), arrays["model_joint_axis"], strict=True):
        if not np.isfinite(axis).all():
            raise InputError("'model_joint_axis' holds NaN or infinity", "allowed: unit vectors")
        if kind in _WITH_AXIS and not abs(float(np.linalg.norm(axis)) - 1.0) <= ROTATION_ERROR:
            raise InputError(f"an axis of the model is {axis.tolist()}", "allowed: unit vectors")
    for key, count in (("model_frame_joint", len(parents)), ("model_frame_parent", len(arrays["model_frame_name"]))):
        wrong = [each for each in arrays[key].tolist() if not 0 <= each < count]
        if wrong:
            raise InputError(f"'{key}' holds {wrong[0]}", f"allowed: 0 to {count - 1}")


def _require_placements(key: str, values: np.ndarray) -> None:
    _require_bounded(key, values)
    rotations = values[:, :, :3].astype(float)
    errors = np.abs(rotations @ np.swapaxes(rotations, 1, 2) - np.eye(3)).max(axis=(1, 2))
    wrong = np.flatnonzero(~(errors <= ROTATION_ERROR) | ~(np.linalg.det(rotations) > 0))
    if len(wrong):
        raise InputError(
            f"'{key}' is no rotation at {wrong[0]}", f"allowed: orthonormal to {ROTATION_ERROR:g}, right-handed"
        )


def _require_bounded(key: str, values: np.ndarray) -> None:
    if not (np.abs(values) <= LARGEST).all():
        worst = values.ravel()[np.flatnonzero(~(np.abs(values.ravel()) <= LARGEST))[0]]
        raise InputError(f"'{key}' holds {worst:g}", f"allowed: finite, at most {LARGEST:g}")


def _texts(names: Sequence[str]) -> np.ndarray:
    return np.array(list(names), dtype=str)


def _references(model: pin.Model) -> list[tuple[str, np.ndarray]]:
    return [(entry.key(), np.array(entry.data())) for entry in model.referenceConfigurations]


def _kind(joint: pin.JointModel) -> str:
    return str(joint.shortname().removeprefix("JointModel"))


def _axis(model: pin.Model, index: int) -> list[float]:
    """Axis of a joint whose kind leaves it open; of the others zero."""
    joint = model.joints[index]
    if not index or _kind(joint) not in _WITH_AXIS:
        return [0.0, 0.0, 0.0]
    data = joint.createData()
    joint.calc(data, pin.neutral(model))
    subspace = np.ravel(data.S)  # the bindings do not show the axis of every kind
    return (subspace[:3] + subspace[3:]).tolist()


def _joint(kind: str, axis: np.ndarray) -> pin.JointModel:
    if kind == "RevoluteUnboundedUnaligned":
        return _continuous(*axis.tolist())
    joint = getattr(pin, f"JointModel{kind}")()
    if kind in _WITH_AXIS:
        joint.axis = np.array(axis, dtype=float)
    return joint


def _continuous(x: float, y: float, z: float) -> pin.JointModel:
    """A continuous joint about any axis, which the bindings cannot make: from a text of our own making."""
    tokens, start = _continuous_text()
    model = pin.Model()
    model.loadFromString(" ".join([*tokens[:start], repr(x), repr(y), repr(z), *tokens[start + 3 :]]))
    return model.joints[1].extract()


@lru_cache(maxsize=1)
def _continuous_text() -> tuple[tuple[str, ...], int]:
    """The words of the text of a model with one continuous joint, and where the axis is among them."""
    axis = " ".join(map(repr, _KNOWN_AXIS))
    model = pin.buildModelFromXML(
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous">'
        f'<parent link="a"/><child link="b"/><axis xyz="{axis}"/></joint></robot>'
    )
    words = model.saveToString().split(" ")
    values = np.array([_number(word) for word in words])
    start = next(i for i in range(len(words)) if np.allclose(values[i : i + 3], _KNOWN_AXIS, rtol=0, atol=1e-12))
    return tuple(words), start


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return np.nan


def _placements(values: Sequence[pin.SE3]) -> np.ndarray:
    return np.array([np.column_stack([each.rotation, each.translation]) for each in values])


def _se3(entry: np.ndarray) -> pin.SE3:
    return pin.SE3(np.array(entry[:, :3], dtype=float), np.array(entry[:, 3], dtype=float))


def _inertias(values: Sequence[pin.Inertia]) -> np.ndarray:
    return np.array([[each.mass, *each.lever, *each.inertia[_UPPER]] for each in values])


def _inertia(entry: np.ndarray) -> pin.Inertia:
    """An inertia by its fields: the constructor refuses some that descriptions of robots have."""
    matrix = np.zeros((3, 3))
    matrix[_UPPER] = matrix.T[_UPPER] = entry[4:]
    inertia = pin.Inertia.Zero()
    inertia.mass, inertia.lever, inertia.inertia = float(entry[0]), np.array(entry[1:4], dtype=float), matrix
    return inertia
