"""Full problems against the smallest ones: sizes, iterations, times and optima.

uv run python -m scripts.compare_scenes
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import click
import numpy as np
import pinocchio as pin

import trajopt
from trajopt import Contact, Phase, Problem, Robot, Schedule
from trajopt.reduced.scenes.goals import scene
from trajopt.reduced.scenes.smallest import Scene, smallest
from trajopt.robot.building import reference_posture
from trajopt.robot.data import robot_file
from trajopt.solvers.drivers import SOLVERS
from trajopt.transcription.compilation import LEVELS
from trajopt_library import problems, robots
from trajopt_library.robots import solo12, talos

DISTANCE = 0.2  # m, of the jump from upright legs
STANCE, FLIGHT, LANDING = 0.4, 0.3, 0.5  # s
SQUAT, SQUAT_TIME = 0.1, 0.8  # m, s
REACH_TIME = 1.0  # s
# Elbow bent, hand pointing down, far from straight arms and joint limits, rad.
PANDA = {"panda_joint2": -0.5, "panda_joint4": -2.2, "panda_joint6": 1.8, "panda_joint7": 0.8}
PANDA_GOAL = (0.4, 0.3, 0.5)  # m
TALOS_ARMS = {"2": 0.25, "4": -1.0}  # rad; of the right arm the second is mirrored
JUMP_INTERVALS, QUADRUPED_INTERVALS, REACH_INTERVALS, SQUAT_INTERVALS = 50, 30, 30, 8

# File, frames of the feet, and joints of a leg with their angles, rad; ANYmal's hind legs bend the other way.
BENT = {"{}_thigh_joint": 0.8, "{}_calf_joint": -1.6}
QUADRUPEDS = {
    "a1": ("a1_description/urdf/a1.urdf", "{}_foot", BENT),
    "go2": ("go2_description/urdf/go2.urdf", "{}_foot", BENT),
    "anymal": (
        "anymal_c_simple_description/urdf/anymal.urdf",
        "{}_FOOT",
        {"{}_HFE": 0.7, "{}_KFE": -1.4},
    ),
}

Variant = tuple[str, Problem, Scene | None]


def upright_jump() -> Scene:
    """Solo12 with its legs in vertical planes jumps forward: what a planar model can do."""
    robot = robots.load("solo12")
    angles = {name: 0.0 if name.endswith("HAA") else angle for name, angle in solo12.STANDING.items()}
    posture = reference_posture(robot.model, "freeflyer", solo12.FEET, angles)
    robot = replace(robot, reference=posture)
    end = posture.copy()
    end[0] += DISTANCE
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, end)
    feet = {name: data.oMf[robot.model.getFrameId(name)].translation.copy() for name in solo12.FEET}
    schedule = Schedule(
        (
            Phase(name="stance", duration=STANCE, contacts=solo12.FEET),
            Phase(name="flight", duration=FLIGHT),
            Phase(name="landing", duration=LANDING, contacts=solo12.FEET, footholds=feet),
        )
    )
    return scene(robot, schedule, end, name="upright-jump")


def quadruped_jump(name: str) -> Scene:
    """A quadruped of ``QUADRUPEDS`` jumps forward onto the feet of the goal posture."""
    path, foot, angles = QUADRUPEDS[name]
    feet = [foot.format(leg) for leg in ("LF", "RF", "LH", "RH")] if name == "anymal" else []
    feet = feet or [foot.format(leg) for leg in ("FL", "FR", "RL", "RR")]
    posture = {
        joint.format(foot[:2]): angle * (-1 if name == "anymal" and foot[1] == "H" else 1)
        for foot in feet
        for joint, angle in angles.items()
    }
    robot = Robot.from_urdf(robot_file(path), name=name, contacts=feet, reference=posture)
    end = robot.reference.copy()
    end[0] += DISTANCE
    legs = tuple(feet)
    schedule = Schedule(
        (
            Phase(name="stance", duration=STANCE, contacts=legs),
            Phase(name="flight", duration=FLIGHT),
            Phase(name="landing", duration=LANDING, contacts=legs),
        )
    )
    return scene(robot, schedule, end, name=f"{name}-jump")


def panda_reach() -> Scene:
    """Panda brings its hand to a place: its fingers have nothing to do."""
    robot = Robot.from_urdf(
        robot_file("panda_description/urdf/panda.urdf"), base="fixed", name="panda", reference=PANDA
    )
    schedule = Schedule((Phase(name="reach", duration=REACH_TIME),))
    return scene(robot, schedule, {"panda_hand": np.array(PANDA_GOAL)}, name="panda-reach")


def talos_squat() -> Scene:
    """Talos with all its joints lowers its waist by a tenth of a metre."""
    size = {"half_length": talos.HALF_LENGTH, "half_width": talos.HALF_WIDTH}
    soles = [Contact(frame=f, name=side, kind="surface", **size) for side, f in talos.SOLES.items()]
    legs = {f"leg_{side}_{j}_joint": q for side in talos.SIDES for j, q in talos.HALF_SITTING.items()}
    left = {f"arm_left_{j}_joint": q for j, q in TALOS_ARMS.items()}
    right = {f"arm_right_{j}_joint": -q if j == "2" else q for j, q in TALOS_ARMS.items()}
    robot = Robot.from_urdf(
        robot_file("talos_data/robots/talos_reduced.urdf"),
        name="talos",
        contacts=soles,
        reference=legs | left | right,
    )
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    waist = data.oMf[robot.model.getFrameId("base_link")].copy()
    waist.translation[2] -= SQUAT
    schedule = Schedule((Phase(name="squat", duration=SQUAT_TIME, contacts=talos.SIDES),))
    return scene(robot, schedule, {"base_link": waist}, name="talos-squat")


def variants() -> Iterator[tuple[str, int, list[Variant]]]:
    """Scenes by name, with the grid and the problems to compare."""
    jump = problems.load("solo12-jump")
    half = smallest(jump)
    yield "solo12-jump", JUMP_INTERVALS, [("as built", jump, None), ("half", half.problem, half)]
    made = upright_jump()
    legs = [name for name in made.original.robot.model.names if name.endswith("HAA")]
    half, locked = smallest(made.original, keep=legs), smallest(made.original, lock=legs, plane=False)
    yield (
        made.original.name,
        JUMP_INTERVALS,
        [
            ("as built", made.original, None),
            ("abduction locked", locked.problem, locked),
            ("half", half.problem, half),
            ("half, abduction locked: in the plane", made.problem, made),
        ],
    )
    for name in QUADRUPEDS:
        made = quadruped_jump(name)
        yield (
            made.original.name,
            QUADRUPED_INTERVALS,
            [("as built", made.original, None), ("half in the plane", made.problem, made)],
        )
    made = panda_reach()
    yield (
        "panda-reach",
        REACH_INTERVALS,
        [("as built", made.original, None), ("fingers locked", made.problem, made)],
    )
    made = talos_squat()
    locked, half = (smallest(made.original, plane=False), smallest(made.original, keep=sideways()))
    yield (
        "talos-squat",
        SQUAT_INTERVALS,
        [
            ("as built", made.original, None),
            ("upper body locked", locked.problem, locked),
            ("half of it", half.problem, half),
            ("half of it in the plane", made.problem, made),
        ],
    )


def sideways() -> list[str]:
    """Joints of Talos' legs that leave the plane: hip yaw and roll, ankle roll."""
    return [f"leg_{side}_{joint}_joint" for side in talos.SIDES for joint in (1, 2, 6)]


@click.command()
@click.option("--solver", type=click.Choice(list(SOLVERS)), default="ipopt")
@click.option("--compile", "level", type=click.Choice(list(LEVELS)), default="quick")
def main(solver: str, level: str) -> None:
    """Print a line for every variant of every scene."""
    click.echo(
        "scene         variant                               variables  rows  iterations  time s     optimum"
    )
    for name, intervals, problems_ in variants():
        for label, problem, made in problems_:
            solution = trajopt.solve(problem, intervals=intervals, solver=solver, compile=level)
            meta = solution.meta
            whole = solution if made is None else made.lift(solution)
            report = trajopt.check(whole)
            click.echo(
                f"{name:13} {label:37} {meta['variables']:9d} {meta['constraints']:5d} "
                f"{meta['iterations']:11d} {meta['wall_time_s']:7.2f}  {meta['objective']:.8f}  "
                f"{meta['status']}, base residual {report.base_residual or 0.0:.0e}"
                + ("" if report.ok else f", beyond a check: {', '.join(report.failures())}")
            )


if __name__ == "__main__":
    main()
