"""Times of robots' shapes, and of their distances along a motion."""

import time

import click
import numpy as np
import pinocchio as pin

from scripts.measure.shared import head, row
from trajopt.collision.description import robot_shapes, sampled_postures
from trajopt.robot.robot import Robot
from trajopt.terrain import FlatGround
from trajopt_library import robots

CONFIGURATIONS, WITHIN, REPEATS = 1000, 0.05, 5


@click.command()
@click.option(
    "--robot", "names", multiple=True, default=("solo12", "go2", "anymal_c", "talos", "g1", "panda")
)
def shapes(names: tuple[str, ...]) -> None:
    """CPU time to read descriptions, and of all distances within 5 cm at 1000 postures."""
    import scipy.spatial  # noqa: F401  any program loads it once: not a cost of the shapes

    head("robot", "shapes", "corners", "judged pairs", "read [s]", "distances [ms]")
    for name in names:
        robot = robots.load(name)
        start = time.process_time()
        found = robot_shapes(robot)
        read = time.process_time() - start
        corners = sum(len(shape.points) for shape in found.shapes)
        spent = 1e3 * distance_time(robot)
        row(name, len(found.shapes), corners, len(found.pairs), f"{read:.2f}", f"{spent:.0f}")


def distance_time(robot: Robot) -> float:
    """Best CPU time, s, of all distances over level ground, half way to a sampled posture."""
    posture = sampled_postures(robot, 1)[0]
    along = np.linspace(0.0, 0.5, CONFIGURATIONS)
    q = np.array([pin.interpolate(robot.model, robot.reference, posture, float(s)) for s in along])
    scene, times = robot_shapes(robot).scene(robot.model, FlatGround()), []
    for _ in range(REPEATS):
        start = time.process_time()
        scene.distances(q, WITHIN)
        times.append(time.process_time() - start)
    return min(times)
