"""Full problems against the smallest ones: sizes, iterations, times and optima."""

from collections.abc import Iterator
from dataclasses import replace

import click
import numpy as np
import pinocchio as pin

from scripts.measure.shared import head, row, solver_option, verdict
from trajopt import Contact, Phase, Problem, Robot, Schedule, check, solve
from trajopt.reduced.scenes import smallest
from trajopt.reduced.scenes.goals import scene
from trajopt.reduced.scenes.smallest_scene import SmallestScene
from trajopt.robot.building import reference_posture
from trajopt.robot.data import VisualSource, package_directories, robot_file
from trajopt.robot.reading import read_urdf
from trajopt_library import problems, robots
from trajopt_library.robots import talos

DISTANCE = 0.2  # m, of the jump from upright legs
STANCE, FLIGHT, LANDING = 0.4, 0.3, 0.5  # s
SQUAT, SQUAT_TIME = 0.1, 0.8  # m, s
REACH_TIME = 1.0  # s
# Elbow bent, hand pointing down, far from straight arms and joint limits, rad.
PANDA = {"panda_joint2": -0.5, "panda_joint4": -2.2, "panda_joint6": 1.8, "panda_joint7": 0.8}
PANDA_GOAL = (0.4, 0.3, 0.5)  # m
TALOS_ARMS = {"2": 0.25, "4": -1.0}  # rad; of the right arm the second is mirrored
JUMP_INTERVALS, QUADRUPED_INTERVALS, REACH_INTERVALS, SQUAT_INTERVALS = 50, 30, 30, 8

# Joints that spread a quadruped's legs; at zero the legs are in vertical planes.
HIPS = ("HAA", "hip")

# Variant, its problem, and the scene that lifts its solution to the whole robot.
Variant = tuple[str, Problem, SmallestScene | None]


def upright_jump(name: str = "solo12") -> SmallestScene:
    """A quadruped with its legs in vertical planes jumps forward: what a planar model can do."""
    robot = robots.load(name)
    model, standing = robot.model, robot.reference
    angles = {model.names[i]: standing[model.joints[i].idx_q] for i in range(2, model.njoints)}
    angles |= dict.fromkeys(hips(robot), 0.0)
    robot = replace(robot, reference=reference_posture(model, "freeflyer", robot.contacts, angles))
    end = robot.reference.copy()
    end[0] += DISTANCE
    legs = tuple(contact.name for contact in robot.contacts)
    schedule = Schedule(
        (
            Phase(name="stance", duration=STANCE, contacts=legs),
            Phase(name="flight", duration=FLIGHT),
            Phase(name="landing", duration=LANDING, contacts=legs),
        )
    )
    return scene(robot, schedule, end, name=f"{name}, upright legs")


def hips(robot: Robot) -> list[str]:
    """Joints that spread the legs."""
    return [name for name in robot.model.names if any(part in name for part in HIPS)]


def panda_reach() -> SmallestScene:
    """Panda brings its hand to a position: its fingers are not needed."""
    path = robot_file("panda_description/urdf/panda.urdf")
    visual = VisualSource(urdf=path, package_dirs=package_directories(path))
    model = read_urdf(path, "fixed")  # its second finger mimics the first: as independent joints
    robot = Robot.from_model(model, base="fixed", name="panda", reference=PANDA, visual=visual)
    schedule = Schedule((Phase(name="reach", duration=REACH_TIME),))
    return scene(robot, schedule, {"panda_hand": np.array(PANDA_GOAL)}, name="panda-reach")


def talos_squat() -> SmallestScene:
    """Talos with all its joints lowers its waist by a tenth of a metre."""
    size = {"half_length": talos.HALF_LENGTH, "half_width": talos.HALF_WIDTH}
    soles = [Contact(frame=f, name=side, kind="surface", **size) for side, f in talos.SOLES.items()]
    legs = {f"leg_{side}_{j}_joint": q for side in talos.SIDES for j, q in talos.HALF_SITTING.items()}
    left = {f"arm_left_{j}_joint": q for j, q in TALOS_ARMS.items()}
    right = {f"arm_right_{j}_joint": -q if j == "2" else q for j, q in TALOS_ARMS.items()}
    path = robot_file("talos_data/robots/talos_reduced.urdf")
    robot = Robot.from_urdf(path, name="talos", contacts=soles, reference=legs | left | right)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    waist = data.oMf[robot.model.getFrameId("base_link")].copy()
    waist.translation[2] -= SQUAT
    schedule = Schedule((Phase(name="squat", duration=SQUAT_TIME, contacts=talos.SIDES),))
    return scene(robot, schedule, {"base_link": waist}, name="talos-squat")


def sideways() -> list[str]:
    """Joints of Talos' legs that leave the plane: hip yaw and roll, ankle roll."""
    return [f"leg_{side}_{joint}_joint" for side in talos.SIDES for joint in (1, 2, 6)]


def variants() -> Iterator[tuple[str, int, list[Variant]]]:
    """Scenes by name, each with the grid and the problems to compare."""
    jump = problems.load("solo12-jump")
    yield "solo12-jump", JUMP_INTERVALS, [_built(jump), _made("half", smallest(jump))]
    made = upright_jump()
    spread = hips(made.original.robot)
    yield made.original.name, JUMP_INTERVALS, [
        _built(made.original),
        _made("abduction locked", smallest(made.original, lock=spread, plane=False)),
        _made("half", smallest(made.original, keep=spread)),
        _made("half, abduction locked: in the plane", made),
    ]  # fmt: skip
    for name in ("a1", "go2", "anymal_c"):
        made = upright_jump(name)
        members = [_built(made.original), _made("half in the plane", made)]
        yield made.original.name, QUADRUPED_INTERVALS, members
    made = panda_reach()
    yield "panda-reach", REACH_INTERVALS, [_built(made.original), _made("fingers locked", made)]
    made = talos_squat()
    yield "talos-squat", SQUAT_INTERVALS, [
        _built(made.original),
        _made("upper body locked", smallest(made.original, plane=False)),
        _made("half of it", smallest(made.original, keep=sideways())),
        _made("half of it in the plane", made),
    ]  # fmt: skip


def _built(problem: Problem) -> Variant:
    return "as built", problem, None


def _made(what: str, made: SmallestScene) -> Variant:
    return what, made.problem, made


@click.command()
@solver_option
def scenes(solver: str) -> None:
    """Problems as built and what the scene requires of them: size, iterations, time, optimum, check."""
    titles = ("variables", "rows", "iterations", "time s", "optimum", "status", "base residual", "check")
    head("scene", "variant", *titles)
    for name, intervals, members in variants():
        for what, problem, made in members:
            found = solve(problem, intervals=intervals, solver=solver)
            whole = found if made is None else made.lift(found)
            statistics, report = found.statistics, check(whole)
            row(name, what, statistics.variables, statistics.constraints, statistics.iterations,
                f"{statistics.wall_time_s:.2f}", f"{statistics.objective:.8f}", statistics.status,
                f"{report.base_residual or 0.0:.0e}", verdict(whole))  # fmt: skip
