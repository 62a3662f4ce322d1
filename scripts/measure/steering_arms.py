"""Arms that follow a target which moves, past an obstacle (docs/mpc.md)."""

import click
import numpy as np
import pinocchio as pin

from scripts.measure.shared import head, row
from scripts.measure.steering import seeds_option
from trajopt.collision import CapsuleObstacle
from trajopt.control.mpc import ArmController, ToolTarget
from trajopt.robot import Robot, frame_pose
from trajopt_library import robots


@click.command("targets")
@click.option("--robots", "names", default="panda,ur5", metavar="A,B", show_default=True)
@click.option("--seconds", default=20.0, show_default=True)
@seeds_option
def targets(names: str, seconds: float, seeds: int) -> None:
    """Arms that follow a target on a random walk around a post, on Pinocchio's forward dynamics."""
    head("robot", "seed", "error, mm", "95 %, mm", "nearest, mm", "plan, ms", "99 %, ms", "limits")
    tools = {"panda": "panda_hand_tcp", "ur5": "tool0"}
    for name in names.split(","):
        robot = robots.load(name)
        for seed in range(seeds):
            row(name, str(seed), *_followed(robot, tools[name], seconds, seed))


def _followed(robot: Robot, tool: str, seconds: float, seed: int) -> list[str]:
    place = frame_pose(robot, robot.reference, tool).translation
    foot = pin.utils.rotate("z", 0.7) @ (place * [1.0, 1.0, 0.0])
    post = CapsuleObstacle(
        name="post",
        start=foot + np.array([0.0, 0.0, 0.04]),
        end=foot + np.array([0.0, 0.0, 0.8 * place[2]]),
        radius=0.03,
    )
    controller = ArmController(robot, tool, (post,))
    model, data, q, v = robot.model, robot.model.createData(), robot.reference.copy(), np.zeros(robot.nv)
    generator, way, rate = np.random.default_rng(seed), np.zeros(3), np.zeros(3)
    errors, states, rates = [], [], []
    for k in range(round(seconds * 1e3)):
        if k % 100 == 0:
            rate = 0.8 * rate + generator.standard_normal(3) * [0.25, 0.1, 0.1]
        before, way = way, np.clip(way + 1e-3 * rate, [-1.2, -0.15, -0.15], [1.2, 0.15, 0.15])
        last, goal = (_around(place, each) for each in (before, way))
        torque = controller.step(1e-3 * k, q, v, ToolTarget(position=goal, velocity=(goal - last) / 1e-3))
        v = v + 1e-3 * pin.aba(model, data, q, v, torque)
        q = pin.integrate(model, q, 1e-3 * v)
        pin.framesForwardKinematics(model, data, q)
        errors.append(float(np.linalg.norm(data.oMf[model.getFrameId(tool)].translation - goal)))
        states.append(q)
        rates.append(v)
    distances = controller.scene.distances(np.array(states[::20])).min()
    q_, v_ = np.array(states), np.array(rates)
    kept = ((q_ >= robot.position_lower) & (q_ <= robot.position_upper)).all()
    kept &= (np.abs(v_) <= 1.001 * robot.velocity_limit).all()
    plans = controller.report.planning[1:]
    return [
        f"{1e3 * np.mean(errors):.1f}",
        f"{1e3 * np.percentile(errors, 95):.1f}",
        f"{1e3 * distances:.0f}",
        f"{1e3 * np.median(plans):.1f}",
        f"{1e3 * np.percentile(plans, 99):.1f}",
        "kept" if kept else "missed",
    ]


def _around(place: np.ndarray, way: np.ndarray) -> np.ndarray:
    """A place turned about the vertical axis, farther out and higher by parts of it."""
    moved = place * [1 + way[1], 1 + way[1], 1 + way[2]]
    return np.asarray(pin.utils.rotate("z", float(way[0])) @ moved)
