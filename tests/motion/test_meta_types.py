"""Every field of the JSON of a file with a value of each type: used, or refused in one line."""

import copy
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import trajopt
from tests.support.command_lines import assert_refused, invoke
from tests.support.damaged_files import arrays_of, saved
from tests.support.ground import HILLS
from tests.support.synthetic_motions import arm_motion, at_rest, sampled, standing, with_meta
from trajopt.collision.description import robot_shapes
from trajopt.collision.shapes import BoxObstacle, LinkShape, SphereObstacle
from trajopt.errors import InputError, TrajoptError
from trajopt.export.exported_motion import sample_cycles
from trajopt.motion.consistency import inconsistency
from trajopt.motion.meta import DESCRIBED, description_of, jsonable, require_keys, statistics_of
from trajopt.motion.solution import Solution
from trajopt.robot import LinkWrench
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.actuators.joint_force import JointForce
from trajopt.robot.actuators.mimic import MimicJoint
from trajopt.schedule.moment import Target
from trajopt.simulation.mjcf import mjcf_of
from trajopt.terrain import Patch, PiecewiseTerrain, Surface
from trajopt_library import robots

VALUES: dict[str, Any] = {
    "a whole number": 7,
    "a number": -0.5,
    "a text": "text",
    "a list": [1, "a", None],
    "lists": [[0.0, 1.0, 2.0]] * 3,
    "null": None,
    "true": True,
    "an object": {"a": 1},
    "nested": {"a": [{"b": [None]}]},
}
USES: dict[str, Callable[[Solution], object]] = {
    "check": lambda plan: trajopt.check(plan, integrate=False).table(),
    "simulate": mjcf_of,
    "export": sample_cycles,
}


def quadruped() -> Solution:
    """Solo12 on its feet, with an entry of every kind that a plan in contact may have."""
    robot = robots.load("solo12")
    feet = [contact.frame for contact in robot.contacts]
    every = robot_shapes(robot).describe()
    shapes = every["shapes"][:2]
    pair = [shape["name"] for shape in shapes]
    bodies = every | {"shapes": shapes, "pairs": [pair], "left_out": [], "missing": []}
    ball = SphereObstacle(name="ball", centre=np.array([1.0, 0.0, 0.0]), radius=0.1)
    box = BoxObstacle(name="box", sides=np.full(3, 0.2), position=np.array([0.0, 1.0, 0.0]))
    capsules = [
        LinkShape(name=foot, frame=foot, points=np.array([[0.0] * 3, [0.0, 0.0, 0.1]]), radius=0.01)
        for foot in feet[:2]
    ]
    carried = {bodies["shapes"][-1]["name"]: {"phases": [0], "rests_on": ["ball"]}}
    level = Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]))
    block = {"block": "defect", "phase": "stance", "node": 1, "point": 1, "time": 0.1, "violation": 1e-9}
    solve = {"transcription": "legendre:2", "intervals": [2], "variables": 9, "iterations": 3}
    return sampled(
        robot,
        [standing(robot, 0.2)],
        2,
        contact_names=feet,
        contact_sizes=[None] * 4,
        contact_rolling=[False] * 4,
        phase_names=["stance"],
        terrain=PiecewiseTerrain.stairs(0.1, 0.3, 2, at=(1.0, 0.0)).describe(),
        bodies=bodies | {"margins": {"obstacles": 0.01, "pairs": [0.0]}, "carried": carried},
        collision={
            "capsules": [shape.describe() for shape in capsules],
            "obstacles": [ball.describe(), box.describe()],
            "self_pairs": [feet[:2]],
        },
        joint_forces=[JointForce(joint="FL_HAA", damping=0.1).to_meta()],
        payloads=[
            {"frame": feet[0], "mass": 0.5, "centre": [0.0] * 3, "inertia": np.eye(3) / 100, "phases": [0]}
        ],
        wrenches=[vars(LinkWrench(frame=feet[0], force=[[0.0] * 3, [1.0] * 3], times=(0.0, 0.1)))],
        periodicity={
            "index": [*range(18)],
            "sign": [1] * 18,
            "origin": [0.0] * 3,
            "translation": [0.0] * 3,
            "velocity": None,
            "turn": 0.0,
            "mirror": False,
        },
        surfaces=[{feet[1]: level.describe()}],
        patches=[{feet[0]: Patch.rectangle((0.2, 0.15, 0.0), (0.2, 0.2), name="face").describe()}],
        goals=[Target(q=robot.reference).describe()],
        visual=None if robot.visual is None else robot.visual.to_meta(),
        mesh=[{"scheme": "legendre:2", "intervals": 2}],
        graded={
            "reached": True,
            "why": "met",
            "spent_s": 1.0,
            "examined_s": 0.5,
            "target_m": 0.1,
            "rounds": [solve | {"wall_time_s": 0.1, "status": "solved", "errors_m": [0.1]}],
        },
        worst_blocks=[block],
        row_names=["defect"],
        failures=["slip"],
        redundant_contact_rows={"stance": 2},
        hessian="exact",
        advice="solved to tolerance",
        seed=0,
    )


def arm() -> Solution:
    """A UR5 with motors, a joint that follows, limits, a goal, and a report of its simulation."""
    robot = robots.load("ur5")
    motor, goal = Drive(gear_ratio=9.0, torque_limit=40.0), Target(frame="tool0", position=np.zeros(3))
    return sampled(
        robot,
        [arm_motion(robot)],
        2,
        actuation="torque",
        actuated_rows=[*range(6)],
        drives=[motor.to_meta(), *[None] * 5],
        mimics=[MimicJoint(joint="wrist_2_joint", mimics="wrist_1_joint").to_meta()],
        joint_limits=[limit.to_meta() for limit in robot.joint_limits],
        goals=[goal.describe()],
        simulation={"tracked": True},
    )


def multirotor() -> Solution:
    """Iris above hills with its thrusters, still."""
    robot = robots.load("iris")
    thrusters = [thruster.to_meta() for thruster in robot.thrusters]
    return sampled(robot, [at_rest(robot, 0.2)], 2, terrain=HILLS.describe(), thrusters=thrusters)


CONTENTS = {"a quadruped": quadruped, "an arm": arm, "a multirotor": multirotor}


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all values, of lists only the first entry."""
    entries = [*value.items()] if isinstance(value, dict) else [*enumerate(value)][:1]
    for key, entry in entries:
        yield (*path, key)
        if isinstance(entry, dict | list):
            yield from places(entry, (*path, key))


def changed(meta: dict[str, Any], path: tuple[Any, ...], value: Any) -> dict[str, Any]:
    """A copy of the JSON with another value at a path."""
    copied = copy.deepcopy(meta)
    holder = copied
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    return copied


@pytest.fixture(scope="module", params=CONTENTS)
def solution(request: pytest.FixtureRequest) -> Solution:
    return CONTENTS[request.param]()


@pytest.mark.slow
@pytest.mark.parametrize("word", VALUES)
def test_a_field_of_any_type_is_used_or_refused_in_one_line(word: str, solution: Solution) -> None:
    meta = jsonable(solution.meta)
    arrays, model = solution.arrays, solution.model
    for path in places(meta):
        other = changed(meta, path, VALUES[word])
        try:
            require_keys(other)
            description, statistics = description_of(other, 1), statistics_of(other)
            if inconsistency(arrays, model, description, statistics):
                continue
            plan = replace(solution, description=description, statistics=statistics)
            for use in USES.values() if path[0] in DESCRIBED else ():
                use(plan)
        except Exception as error:
            one_line = isinstance(error, TrajoptError) and len(str(error).splitlines()) == 1
            if not one_line:
                raise AssertionError(f"{path} as {word} raises {error!r}") from error


@pytest.mark.long
@pytest.mark.parametrize("command", [["check"], ["simulate"], ["export", "--format", "mjcf", "-o", "x.xml"]])
@pytest.mark.parametrize(
    ("path", "said"),
    [
        (("contact_frames", 0), "frame of PlannedContact 'FL_FOOT' is 7; allowed: a string"),
        (
            ("payloads", 0, "inertia", 0, 1),
            "inertia of a payload is not that of a rigid body",
        ),
        (("friction",), "friction of meta is not a list with an entry for each of the 4 contact_frames"),
    ],
)
def test_commands_refuse_a_field_of_a_wrong_type(
    command: list[str], path: tuple[Any, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arrays = arrays_of(quadruped().to_bytes())
    meta = changed(json.loads(str(arrays["meta"])), path, 7)
    Path("x.npz").write_bytes(saved(arrays | {"meta": np.array(json.dumps(meta))}))
    assert_refused(invoke(command[0], "x.npz", *command[1:]), said)


def test_a_periodicity_takes_joints_to_joints() -> None:
    meta = jsonable(quadruped().meta)
    swapped = [6, *range(1, 6), 0, *range(7, 18)]
    solution = with_meta(quadruped(), periodicity=meta["periodicity"] | {"index": swapped})
    with pytest.raises(InputError, match="index of periodicity of meta does not take joints to joints"):
        solution.to_bytes()
