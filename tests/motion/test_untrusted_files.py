"""Files of strangers: sizes before bytes, arrays before Pinocchio, names looked up and never run."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from tests.support.damaged_files import arrays_of, saved
from tests.support.models import JOINT_KINDS, ROBOTS, hand_built, robot
from tests.support.refusals import assert_refused_in_one_line
from tests.support.synthetic_motions import arm_motion, sampled
from trajopt.collision.shapes import LinkShape, SphereObstacle
from trajopt.motion.archive import read_members
from trajopt.motion.model_arrays import (
    MODEL_KINDS,
    model_from_arrays,
    model_from_untrusted_text,
    model_to_arrays,
)
from trajopt.motion.solution import Solution
from trajopt.solving.diagnosis.diagnose import diagnose
from trajopt.terrain import Patch
from trajopt_library import robots

MODELS = {
    **{name: lambda name=name: robots.load(name).limited_model() for name in robots.names()},
    **{f"description {name}": lambda name=name: robot(name)[0] for name in ROBOTS},
    **{f"joint {kind}": lambda kind=kind: hand_built(kind)[0] for kind in JOINT_KINDS},
}


@pytest.fixture(scope="module")
def content() -> bytes:
    arm = robots.load("ur5")
    return sampled(arm, [arm_motion(arm)], 4).to_bytes()


def with_member(content: bytes, name: str, data: bytes) -> bytes:
    """The archive with one member's bytes replaced, or added."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as new:
        for info in old.infolist():
            if info.filename != name:
                new.writestr(info.filename, old.read(info))
        new.writestr(name, data)
    return file.getvalue()


def headed(kind: str, shape: str) -> bytes:
    """An array's file with a header alone."""
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}}}"
    return b"\x93NUMPY\x01\x00" + (len(header) + 1).to_bytes(2, "little") + header.encode() + b"\n"


@pytest.mark.parametrize("name", MODELS)
def test_a_model_is_built_again_bit_by_bit(name):
    model = MODELS[name]()
    rebuilt = model_from_arrays(model_to_arrays(model))
    assert rebuilt == model
    assert rebuilt.saveToString() == model.saveToString()
    for field in ("supports", "subtrees"):
        assert [[*row] for row in getattr(rebuilt, field)] == [[*row] for row in getattr(model, field)]
    for field in ("idx_qs", "idx_vs", "nqs", "nvs"):
        assert [*getattr(rebuilt, field)] == [*getattr(model, field)]


def test_models_with_locked_joints_mjcf_and_references_are_built_again(tmp_path):
    full = robot("panda")[0]
    full.referenceConfigurations["middle"] = pin.neutral(full)
    locked = pin.buildReducedModel(full, [2, 4], pin.neutral(full))
    mjcf = tmp_path / "two.xml"
    mjcf.write_text(
        '<mujoco model="two"><worldbody><body name="a"><freejoint/><geom size="0.1" mass="1"/>'
        '<body name="b" pos="0 0 1"><joint name="j" axis="0 0.6 0.8"/><geom size="0.1" mass="1"/></body>'
        "</body></worldbody></mujoco>"
    )
    for model in (full, locked, pin.buildModelFromMJCF(str(mjcf))):
        rebuilt = model_from_arrays(model_to_arrays(model))
        assert rebuilt == model
        assert rebuilt.saveToString() == model.saveToString()
        references = {entry.key(): [*entry.data()] for entry in model.referenceConfigurations}
        assert {entry.key(): [*entry.data()] for entry in rebuilt.referenceConfigurations} == references


@pytest.mark.parametrize(
    ("key", "row", "value", "words"),
    [
        ("joint_parent", 2, 2, "the parent of joint 2 is joint 2; allowed: one before it"),
        ("joint_parent", 2, 2**62, "the parent of joint 2"),
        ("frame_joint", 3, 4294967295, "'model_frame_joint' holds 4294967295; allowed: 0 to 6"),
        ("frame_parent", 3, -1, "'model_frame_parent' holds -1"),
        ("joint_kind", 1, "PQ", "a joint is of kind 'PQ'"),
        ("joint_name", 2, "universe", "two joints of the model have one name"),
        ("frame_name", 2, "\x1b[31m", "'model_frame_name' holds"),
        ("frame_type", 1, "OTHER", "a frame is of type 'OTHER'"),
        ("joint_inertia", (1, 0), np.nan, "'model_joint_inertia' holds nan; allowed: up to 1e+09, not NaN"),
        ("joint_placement", (1, 0, 3), 1e30, "'model_joint_placement' holds 1e+30"),
        ("joint_placement", (1, 0, 0), 2.0, "'model_joint_placement' has no rotation at 1"),
        ("effort_upper", 0, np.nan, "'model_effort_upper' holds nan"),
        ("damping", 0, np.inf, "'model_damping' holds inf"),
        ("bodies", (), 2**40, "the model has 1099511627776 bodies"),
    ],
)
def test_what_pinocchio_must_not_see_is_refused(key, row, value, words):
    arrays = model_to_arrays(robots.load("ur5").model)
    arrays[f"model_{key}"][row] = value
    assert_refused_in_one_line(lambda: model_from_arrays(arrays), words)


def test_branches_and_shapes_that_do_not_fit_are_refused():
    arrays = model_to_arrays(hand_built("RX")[0])
    branch = arrays["model_joint_parent"] * 0
    branch[3] = 1  # below the first joint, after the second branch
    assert_refused_in_one_line(
        lambda: model_from_arrays({**arrays, "model_joint_parent": branch}), "joint 3 comes after another"
    )
    short = {**arrays, "model_damping": np.zeros(1)}
    assert_refused_in_one_line(
        lambda: model_from_arrays(short), "'model_damping' has shape (1,); expected (3,)"
    )
    arrays.pop("model_gravity")
    assert_refused_in_one_line(lambda: model_from_arrays(arrays), "the model lacks model_gravity")


def test_older_files_with_text_alone_are_read(content):
    older = {name: array for name, array in arrays_of(content).items() if name not in MODEL_KINDS}
    assert Solution.from_bytes(saved(older)).model == Solution.from_bytes(content).model


@pytest.mark.parametrize("word", ["4294967295", "-1", "nonsense"])
def test_text_that_ends_its_reader_is_refused(word, content):
    words = str(arrays_of(content)["model"]).split(" ")
    words[10:] = [word if each.isdigit() else each for each in words[10:]]  # counts and indices
    assert_refused_in_one_line(
        lambda: model_from_untrusted_text(" ".join(words)), "damaged or of another Pinocchio version"
    )


def test_text_is_not_read_where_there_are_arrays(content):
    changed = saved(arrays_of(content) | {"model": np.array("22 serialization::archive")})
    assert Solution.from_bytes(changed).model == Solution.from_bytes(content).model


@pytest.mark.parametrize(
    ("member", "data", "words"),
    [
        ("t.npy", b"no array", "is truncated or damaged"),
        ("t.npy", headed("<f8", "(2251799813685248,)"), "holds 0 bytes"),
        ("t.npy", headed("|O", "(3,)"), "'t' is of type object"),
        ("t.npy", headed("<f8", "("), "is truncated or damaged"),
        ("t.npy", headed("<f8", "(" * 900), "is truncated or damaged"),
        ("meta.npy", headed("<U1", "()") + b"\xff" * 4, "not a text"),
    ],
)
def test_members_that_are_no_arrays_are_refused(member, data, words, content):
    assert_refused_in_one_line(lambda: Solution.from_bytes(with_member(content, member, data)), words)


def test_members_of_other_names_are_not_read(content):
    unknown = with_member(content, "junk.npy", headed("<f8", "(9,)"))
    assert Solution.from_bytes(unknown).n_samples == Solution.from_bytes(content).n_samples


@pytest.mark.long
def test_a_small_file_does_not_become_a_large_one():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("t.npy", "w") as member:
        for _ in range(300):
            member.write(bytes(2**20))
    assert_refused_in_one_line(
        lambda: read_members(file.getvalue(), "x.npz", {"t": "f"}), "holds 315 MB in 0.3 MB"
    )


def test_a_member_that_is_there_twice_is_refused(content):
    file = io.BytesIO(content)
    with zipfile.ZipFile(file, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("t.npy", b"")
    assert_refused_in_one_line(lambda: Solution.from_bytes(file.getvalue()), "'t' is there twice")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"gravity": [0, 0, 1e30]}, "gravity of meta holds 1e+30; allowed: up to 1e+09"),
        ({"iterations": 10**400}, "iterations of meta holds 1000"),
        ({"more": [[[[[]]]]]}, ""),
        ({"bodies": {"shapes": [{"points": [[1e30, 0, 0]]}]}}, "bodies of meta holds 1e+30"),
    ],
)
def test_values_of_meta_are_bounded(changes, words, content):
    arrays = arrays_of(content)
    meta = json.loads(str(arrays["meta"])) | changes
    changed = saved(arrays | {"meta": np.array(json.dumps(meta))})
    if not words:
        assert Solution.from_bytes(changed).statistics.more["more"] == [[[[[]]]]]
        return
    assert_refused_in_one_line(lambda: Solution.from_bytes(changed), words)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a": ' + "9" * 5000 + "}", '{"a": ' + "[" * 900 + "]" * 900 + "}"]
)
def test_json_without_end_is_refused(text, content):
    changed = saved(arrays_of(content) | {"meta": np.array(text)})
    assert_refused_in_one_line(lambda: Solution.from_bytes(changed), "solution")


@pytest.mark.parametrize(
    "make",
    [
        lambda: LinkShape(name="a", frame="b", points=np.eye(3) * 1e30, radius=0.0),
        lambda: SphereObstacle(name="a", centre=np.zeros(3), radius=1e5),
        lambda: Patch.rectangle((0.0, 0.0, 0.0), (1e9, 1.0), name="a"),
    ],
)
def test_shapes_beyond_what_geometry_can_tell_apart_are_refused(make):
    assert_refused_in_one_line(make, "beyond 10000 m")


def test_a_robot_file_that_a_solution_names_is_not_run(content, tmp_path: Path):
    ran, file = tmp_path / "ran", tmp_path / "mine.py"
    file.write_text(f"open({str(ran)!r}, 'w')\nfrom trajopt_library.robots.ur5 import *\n")
    arrays = arrays_of(content)
    meta = json.loads(str(arrays["meta"])) | {"problem": "arm-reach", "parameters": {"robot": str(file)}}
    solution = Solution.from_bytes(saved(arrays | {"meta": np.array(json.dumps(meta))}))
    assert_refused_in_one_line(
        lambda: diagnose(solution), "files that solutions name are not run; allowed: a robot"
    )
    assert not ran.exists()
    diagnose(solution, robot=str(file))
    assert ran.exists()
