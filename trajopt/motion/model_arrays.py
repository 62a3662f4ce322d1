"""A Pinocchio model as plain arrays, which are checked before the model is rebuilt through Pinocchio's API.

Older files have Pinocchio's text. Its reader trusts counts and indices, so a damaged text can crash it: it
runs in a separate process, which returns these arrays. Imports are few for its sake.

`_FORMS` lists the arrays, named ``model_KEY``; rows are in Pinocchio's order, the universe first:

- joint_kind: without "JointModel", empty for the universe. joint_axis: axis of kinds with a free one, else 0.
- placement: rotation (3, 3) beside translation (m), in the axes of the parent joint or the frame's joint.
- inertia: mass, centre of mass, and xx, xy, xz, yy, yz, zz about it.
- frame_joint, frame_parent: indices of the frame's joint and of its parent frame.
- bodies: the count `pin.Model.nbodies`.
"""

import io
import math
import os
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError, first_line
from trajopt.motion.archive import read_members

# Sizes of position and velocity by kind of joint, for all kinds that trajopt.dynamics supports.
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
# More than any robot has: memory and time of Pinocchio's algorithms grow quadratically.
MOST_JOINTS, MOST_FRAMES = 1000, 10_000
LONGEST_NAME = 500
# Largest length (m), mass (kg), inertia (kg m^2), friction, damping or gravity, so that products stay finite.
LARGEST_VALUE = 1e9
# Rounding error of decimal rotation entries, and of the length of an axis.
ROTATION_ERROR = 1e-6
# Control characters and lone surrogates, which cannot be displayed.
UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]")

# Key without "model_" -> field of `pin.Model`, its size, and its largest allowed value.
_FIELDS: dict[str, tuple[str, str, float]] = {
    "effort_lower": ("lowerEffortLimit", "nv", math.inf),
    "effort_upper": ("upperEffortLimit", "nv", math.inf),
    "velocity_lower": ("lowerVelocityLimit", "nv", math.inf),
    "velocity_upper": ("upperVelocityLimit", "nv", math.inf),
    "friction_lower": ("lowerDryFrictionLimit", "nv", LARGEST_VALUE),
    "friction_upper": ("upperDryFrictionLimit", "nv", LARGEST_VALUE),
    "damping": ("damping", "nv", LARGEST_VALUE),
    "armature": ("armature", "nv", LARGEST_VALUE),
    "rotor_inertia": ("rotorInertia", "nv", LARGEST_VALUE),
    "rotor_gear_ratio": ("rotorGearRatio", "nv", LARGEST_VALUE),
    "position_lower": ("lowerPositionLimit", "nq", math.inf),
    "position_upper": ("upperPositionLimit", "nq", math.inf),
    "position_margin": ("positionLimitMargin", "nq", LARGEST_VALUE),
}
# Key without "model_" -> allowed number kinds, as in `numpy.dtype.kind`, and shape.
_FORMS: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "name": ("U", ()),
    "bodies": ("iu", ()),
    "gravity": ("f", (6,)),
    "joint_name": ("U", ("joints",)),
    "joint_kind": ("U", ("joints",)),
    "joint_parent": ("iu", ("joints",)),
    "joint_axis": ("f", ("joints", 3)),
    "joint_placement": ("f", ("joints", 3, 4)),
    "joint_inertia": ("f", ("joints", 10)),
    "frame_name": ("U", ("frames",)),
    "frame_type": ("U", ("frames",)),
    "frame_joint": ("iu", ("frames",)),
    "frame_parent": ("iu", ("frames",)),
    "frame_placement": ("f", ("frames", 3, 4)),
    "frame_inertia": ("f", ("frames", 10)),
    "reference_name": ("U", ("references",)),
    "reference": ("f", ("references", "nq")),
    **{key: ("f", (size,)) for key, (_, size, _) in _FIELDS.items()},
}
MODEL_KINDS: dict[str, str] = {f"model_{key}": kinds for key, (kinds, _) in _FORMS.items()}
_WITH_AXIS = ("RevoluteUnaligned", "RevoluteUnboundedUnaligned", "PrismaticUnaligned")
_UPPER = np.triu_indices(3)
_Arrays = Mapping[str, np.ndarray]


def model_to_arrays(model: pin.Model) -> dict[str, np.ndarray]:
    """Return the arrays of a model for `model_from_arrays`; raises `InputError` if it would refuse them."""
    frames = list(model.frames)
    references = {entry.key(): np.array(entry.data()) for entry in model.referenceConfigurations}
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
        **{f"model_{key}": np.array(getattr(model, field)) for key, (field, _, _) in _FIELDS.items()},
    }
    _require_valid(arrays)
    return arrays


def model_from_arrays(arrays: _Arrays) -> pin.Model:
    """Return a model equal in every field to the one given to `model_to_arrays`.

    Every count, index, name and number is checked first: Pinocchio trusts its input. Raises `InputError`.
    """
    _require_valid(arrays)
    try:
        return _built({key.removeprefix("model_"): arrays[key] for key in MODEL_KINDS})
    except (ValueError, RuntimeError) as error:  # raised by Pinocchio
        raise InputError(f"the model cannot be built: {first_line(error)}") from None


def _built(given: _Arrays) -> pin.Model:
    model = pin.Model()
    model.name = str(given["name"])
    kinds, names = given["joint_kind"].tolist(), given["joint_name"].tolist()
    placements = [_se3(entry) for entry in given["joint_placement"]]
    for index in range(1, len(names)):
        joint = _joint(kinds[index], given["joint_axis"][index])
        model.addJoint(int(given["joint_parent"][index]), joint, placements[index], names[index])
    for _ in range(int(given["bodies"]) - model.nbodies):  # only for the count; inertias are set below
        model.appendBodyToJoint(0, pin.Inertia.Zero(), pin.SE3.Identity())
    for index, entry in enumerate(given["joint_inertia"]):
        model.inertias[index] = _inertia(entry)
    model.gravity = pin.Motion(np.array(given["gravity"], dtype=float))
    for key, (field, _, _) in _FIELDS.items():
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
    """Raise `InputError` for the first value that Pinocchio must not receive."""
    missing = [key for key in MODEL_KINDS if key not in arrays]
    if missing:
        raise InputError(f"the model lacks {', '.join(missing)}")
    given = {key: arrays[f"model_{key}"] for key in _FORMS}
    _require_forms(given)
    _require_names(given)
    _require_tree(given)
    _require_rotations(given)
    if not 1 <= int(given["bodies"]) <= MOST_FRAMES:
        raise InputError(f"the model has {given['bodies']} bodies", f"allowed: 1 to {MOST_FRAMES}")
    for key, (kinds, _) in _FORMS.items():
        if kinds == "f":
            largest = _FIELDS[key][2] if key in _FIELDS else LARGEST_VALUE
            wrong = given[key][~(np.abs(given[key]) <= largest)]
            if len(wrong):
                raise InputError(f"'model_{key}' holds {wrong[0]:g}", f"allowed: up to {largest:g}, not NaN")


def _require_forms(given: _Arrays) -> None:
    """Check kinds and shapes of all arrays; the kinds of joints determine the other sizes."""
    sizes = {}
    for what, least, most in (
        ("joint", 1, MOST_JOINTS),
        ("frame", 1, MOST_FRAMES),
        ("reference", 0, MOST_JOINTS),
    ):
        shape = given[f"{what}_name"].shape
        if len(shape) != 1 or not least <= shape[0] <= most:
            raise InputError(f"'model_{what}_name' has shape {shape}", f"allowed: ({least} to {most},)")
        sizes[f"{what}s"] = shape[0]
    kinds = given["joint_kind"].ravel().tolist()[1:]
    for kind in kinds:
        if kind not in JOINT_SIZES:
            raise InputError(f"a joint is of kind {kind!r:.60}", f"allowed: {', '.join(JOINT_SIZES)}")
    sizes |= {name: sum(JOINT_SIZES[kind][part] for kind in kinds) for part, name in enumerate(("nq", "nv"))}
    for key, (allowed, form) in _FORMS.items():
        if given[key].dtype.kind not in allowed:
            raise InputError(
                f"'model_{key}' is of type {given[key].dtype}", f"allowed: kinds {', '.join(allowed)}"
            )
        expected = tuple(sizes[size] if isinstance(size, str) else size for size in form)
        if given[key].shape != expected:
            raise InputError(f"'model_{key}' has shape {given[key].shape}", f"expected {expected}")


def _require_names(given: _Arrays) -> None:
    for key in ("name", "joint_name", "frame_name", "reference_name"):
        for name in given[key].ravel().tolist():
            if len(name) > LONGEST_NAME or UNPRINTABLE.search(name):
                raise InputError(
                    f"'model_{key}' holds {name!r:.60}",
                    f"allowed: up to {LONGEST_NAME} characters, none of them a control character",
                )
    types, joints = given["frame_type"].tolist(), given["joint_name"].tolist()
    unknown = sorted(set(types) - set(FRAME_TYPES))
    if unknown:
        raise InputError(f"a frame is of type {unknown[0]!r:.60}", f"allowed: {', '.join(FRAME_TYPES)}")
    frames = list(zip(given["frame_name"].tolist(), types, strict=True))
    for what, names in (
        ("joints", joints),
        ("frames", frames),
        ("references", given["reference_name"].tolist()),
    ):
        if len(set(names)) != len(names):
            raise InputError(f"two {what} of the model have one name", "allowed: different names")
    if joints[0] != UNIVERSE:
        raise InputError(f"the first joint of the model is {joints[0]!r:.60}", f"allowed: {UNIVERSE}")


def _require_tree(given: _Arrays) -> None:
    """Check that joints follow their parents, depth first, and that frames refer to existing ones."""
    parents, branch = given["joint_parent"].tolist(), [0]
    for index, parent in enumerate(parents):
        if not 0 <= parent < max(index, 1):
            raise InputError(f"the parent of joint {index} is joint {parent}", "allowed: one before it")
        while branch[-1] != parent:
            if len(branch) == 1:
                raise InputError(f"joint {index} comes after another branch", "allowed: depth first")
            branch.pop()
        if index:
            branch.append(index)
    for key, count in (("frame_joint", len(parents)), ("frame_parent", len(given["frame_name"]))):
        wrong = [each for each in given[key].tolist() if not 0 <= each < count]
        if wrong:
            raise InputError(f"'model_{key}' holds {wrong[0]}", f"allowed: 0 to {count - 1}")


def _require_rotations(given: _Arrays) -> None:
    """Check that axes have unit length and placements have rotation matrices."""
    with_axis = np.isin(given["joint_kind"], _WITH_AXIS)
    lengths = np.linalg.norm(given["joint_axis"][with_axis], axis=1)
    if not (np.abs(lengths - 1.0) <= ROTATION_ERROR).all():
        raise InputError(
            "an axis of the model is no unit vector", f"allowed: of length 1 to {ROTATION_ERROR:g}"
        )
    for key in ("joint_placement", "frame_placement"):
        rotations = given[key][:, :, :3].astype(float)
        with np.errstate(all="ignore"):  # non-finite numbers fail the test
            errors = np.abs(rotations @ np.swapaxes(rotations, 1, 2) - np.eye(3)).max(axis=(1, 2))
            wrong = np.flatnonzero(~(errors <= ROTATION_ERROR) | ~(np.linalg.det(rotations) > 0))
        if len(wrong):
            raise InputError(
                f"'model_{key}' has no rotation at {wrong[0]}", "allowed: orthonormal, right-handed"
            )


def _texts(names: Sequence[str]) -> np.ndarray:
    return np.array(list(names), dtype=str)


def _kind(joint: pin.JointModel) -> str:
    return str(joint.shortname().removeprefix("JointModel"))


def _axis(model: pin.Model, index: int) -> list[float]:
    """Return the axis of a joint whose kind leaves it free, else zeros."""
    joint = model.joints[index]
    if not index or _kind(joint) not in _WITH_AXIS:
        return [0.0, 0.0, 0.0]
    data = joint.createData()
    joint.calc(data, pin.neutral(model))
    subspace = np.ravel(data.S)  # the bindings do not expose the axis of every kind
    return (subspace[:3] + subspace[3:]).tolist()


def _joint(kind: str, axis: np.ndarray) -> pin.JointModel:
    if kind == "RevoluteUnboundedUnaligned":  # the bindings cannot construct one, so it is read from a text
        text, known = _continuous()
        model = pin.Model()
        model.loadFromString(text.replace(known, _words(axis)))
        return model.joints[1].extract()
    joint = getattr(pin, f"JointModel{kind}")()
    if kind in _WITH_AXIS:
        joint.axis = np.array(axis, dtype=float)
    return joint


@lru_cache(maxsize=1)
def _continuous() -> tuple[str, str]:
    """Return the text of a model with one continuous joint, and its substring for the axis."""
    model = pin.buildModelFromXML(
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous">'
        '<parent link="a"/><child link="b"/><axis xyz="0.48 0.6 0.64"/></joint></robot>'
    )
    return model.saveToString(), _words(_axis(model, 1))


def _words(axis: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{entry:.17e}" for entry in axis)


def _placements(values: Sequence[pin.SE3]) -> np.ndarray:
    return np.array([np.column_stack([each.rotation, each.translation]) for each in values])


def _se3(entry: np.ndarray) -> pin.SE3:
    return pin.SE3(np.array(entry[:, :3], dtype=float), np.array(entry[:, 3], dtype=float))


def _inertias(values: Sequence[pin.Inertia]) -> np.ndarray:
    return np.array([[each.mass, *each.lever, *each.inertia[_UPPER]] for each in values])


def _inertia(entry: np.ndarray) -> pin.Inertia:
    """Set an inertia field by field: the constructor rejects some values found in robot descriptions."""
    matrix = np.zeros((3, 3))
    matrix[_UPPER] = matrix.T[_UPPER] = entry[4:]
    inertia = pin.Inertia.Zero()
    inertia.mass, inertia.lever, inertia.inertia = float(entry[0]), np.array(entry[1:4], dtype=float), matrix
    return inertia


# Limits of the process: time, s, and memory, bytes. A robot's text takes 0.4 s, mostly to start.
READER_TIME, READER_MEMORY = 60.0, 4 * 2**30
# Number of texts whose arrays are cached: files of one robot are often read in sequence.
MOST_TEXTS = 16
# The process has the same import path as this one, regardless of its working directory.
_CODE = "import sys; sys.path[:] = sys.argv[1:]; from trajopt.motion.model_arrays import _answer; _answer()"


def model_from_untrusted_text(text: str) -> pin.Model:
    """Return the model from an untrusted ``pin.Model.saveToString()``; raises `InputError`."""
    wrong = InputError("the model in the solution is damaged or of another Pinocchio version")
    try:
        return model_from_arrays(read_members(_arrays(text), "the model", MODEL_KINDS))
    except (InputError, OSError, subprocess.SubprocessError, UnicodeEncodeError):
        raise wrong from None


@lru_cache(maxsize=MOST_TEXTS)
def _arrays(text: str) -> bytes:
    """Return the output of the process: an archive of `model_to_arrays`."""
    command = [sys.executable, "-I", "-c", _CODE, *filter(None, sys.path)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    given = text.encode()
    return subprocess.run(
        command, input=given, capture_output=True, check=True, timeout=READER_TIME, env=environment
    ).stdout


def _answer() -> None:
    """Read a text from stdin and write the arrays of its model to stdout; runs in the process."""
    import resource  # not available on every system

    resource.setrlimit(resource.RLIMIT_AS, (READER_MEMORY, READER_MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    model, answer = pin.Model(), io.BytesIO()
    model.loadFromString(sys.stdin.buffer.read().decode())
    np.savez(answer, allow_pickle=False, **model_to_arrays(model))
    sys.stdout.buffer.write(answer.getvalue())
    sys.stdout.buffer.flush()
    os._exit(0)  # skip the cleanup of memory that a damaged text may have corrupted
