"""Arms that follow a target, on inverse and forward dynamics of numeric Pinocchio."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from trajopt.collision import CapsuleObstacle
from trajopt.control.mpc.arm import ArmController, ArmSettings, ToolTarget
from trajopt.control.mpc.follow import HORIZON
from trajopt.errors import InputError
from trajopt.robot import Robot, frame_pose
from trajopt_library import robots

TICK = 1e-3
# Ratio of a rate to its limit that is rounding of the quadratic programs.
ROUNDING = 1e-6
TOOLS = {"panda": "panda_hand_tcp", "ur5": "tool0"}


def followed(robot: Robot, controller: ArmController, target, duration: float) -> np.ndarray:
    """Configurations (n, nq) at ticks, from rest."""
    return moved(robot, controller, target, duration, robot.reference, np.zeros(robot.nv))[0]


def moved(robot: Robot, controller: ArmController, target, duration: float, q, v) -> list[np.ndarray]:
    """Configurations (n, nq) and velocities (n, nv) at ticks, from a state."""
    model, rows = robot.model, []
    data = model.createData()
    for k in range(round(duration / TICK)):
        torque = controller.step(k * TICK, q, v, target(k * TICK))
        v = v + TICK * pin.aba(model, data, q, v, torque)
        q = pin.integrate(model, q, TICK * v)
        rows.append((q, v))
    return [np.array(part) for part in zip(*rows, strict=True)]


def random_start(robot: Robot, tool: str, seed: int) -> tuple[np.ndarray, np.ndarray, ToolTarget]:
    """A state with rates within their limits, and a target at random."""
    rng = np.random.default_rng(seed)
    low, high = np.maximum(robot.position_lower, -2.0), np.minimum(robot.position_upper, 2.0)
    q, there = (low + (high - low) * rng.uniform(0.2, 0.8, robot.nq) for _ in range(2))
    goal = frame_pose(robot, there, tool)
    v = rng.uniform(-0.95, 0.95, robot.nv) * robot.velocity_limit
    return q, v, ToolTarget(position=goal.translation, rotation=goal.rotation)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(TOOLS))
def test_a_tool_follows_a_target_past_an_obstacle(name: str) -> None:
    """A post stands between start and goal; the arm ends at the goal and has kept its distance on the way."""
    robot = robots.load(name)
    place = frame_pose(robot, robot.reference, TOOLS[name])
    turned = pin.utils.rotate("z", 1.2) @ place.translation
    middle = pin.utils.rotate("z", 0.6) @ place.translation * np.array([1.0, 1.0, 0.0])
    post = CapsuleObstacle(
        name="post",
        start=middle + np.array([0.0, 0.0, 0.02]),
        end=middle + np.array([0.0, 0.0, 0.6 * place.translation[2]]),
        radius=0.03,
    )
    controller = ArmController(robot, TOOLS[name], (post,))

    def target(time: float) -> ToolTarget:
        share = min(time / 2.0, 1.0)
        return ToolTarget(position=(1 - share) * place.translation + share * turned)

    q = followed(robot, controller, target, 4.0)
    end = frame_pose(robot, q[-1], TOOLS[name]).translation
    assert np.linalg.norm(end - turned) < 5e-3
    distances = controller.scene.distances(q[::20])[:, : controller.scene.n_outer]
    assert distances.min() > 0.0
    assert controller.report.anew == 0
    low, high = robot.position_lower, robot.position_upper
    assert (q >= low - 1e-6).all()
    assert (q <= high + 1e-6).all()


@pytest.mark.long
def test_a_tool_turns_where_a_rotation_is_asked_for() -> None:
    robot = robots.load("ur5")
    place = frame_pose(robot, robot.reference, "tool0")
    goal = place.rotation @ pin.utils.rotate("x", 0.4)
    controller = ArmController(robot, "tool0")
    q = followed(robot, controller, lambda _: ToolTarget(position=place.translation, rotation=goal), 1.5)
    away = pin.log3(goal.T @ frame_pose(robot, q[-1], "tool0").rotation)
    assert np.linalg.norm(away) < 0.02


@pytest.mark.long
@pytest.mark.parametrize("name", ["z1", *TOOLS])
def test_rates_stay_within_their_limits_and_return_from_beyond(name: str) -> None:
    """From a limit, no rate exceeds it; from 1.2 of one, it returns with the time constant `HORIZON`."""
    robot = robots.load(name)
    made = ArmController(robot, TOOLS.get(name))
    for seed in range(2):
        q, v, target = random_start(robot, made.tool, seed)
        joint = seed % robot.nv
        for most in (1.0, 1.2):
            v[joint] = most * robot.velocity_limit[joint]
            controller = made.fresh()
            _, rates = moved(robot, controller, lambda _, to=target: to, 0.3, q, v)
            allowed = 1 + (most - 1) * (1 - TICK / HORIZON) ** np.arange(1, len(rates) + 1)
            assert (np.abs(rates / robot.velocity_limit).max(axis=1) <= allowed + ROUNDING).all()
            assert controller.report.ticks == [300, 0, 0, 0]


@pytest.mark.long
def test_ticks_that_cannot_keep_rates_within_limits_are_counted() -> None:
    robot = robots.load("panda")
    weak = replace(robot, torque_limit=0.1 * robot.torque_limit)
    controller, target = ArmController(weak), random_start(robot, TOOLS["panda"], 0)[2]
    _, rates = moved(weak, controller, lambda _: target, 0.6, weak.reference, np.zeros(weak.nv))
    exceeds = np.abs(rates / weak.velocity_limit).max(axis=1) > 1 + ROUNDING
    _, dropped, *others = controller.report.ticks
    assert exceeds.any()
    assert dropped >= exceeds.sum()
    assert others == [0, 0]
    assert controller.report.slack > 0


@pytest.mark.long
def test_a_pose_is_a_target_at_rest() -> None:
    robot = robots.load("ur5")
    pose = frame_pose(robot, robot.reference, "tool0") * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))
    state = 0.0, robot.reference, np.zeros(robot.nv)
    asked = ToolTarget(position=pose.translation, rotation=pose.rotation)
    torques = [ArmController(robot, "tool0").step(*state, target) for target in (pose, asked)]
    np.testing.assert_array_equal(*torques)
    with pytest.raises(InputError, match=r"target of the tool is .*; allowed: a ToolTarget"):
        ArmController(robot, "tool0").step(*state, pose.translation)  # type: ignore[arg-type]


def test_targets_frames_and_bases_that_are_none_are_refused() -> None:
    robot = robots.load("ur5")
    with pytest.raises(InputError, match="fixed base"):
        ArmController(robots.load("go2"))
    with pytest.raises(InputError, match="tool"):
        ArmController(robot, "nothing")
    with pytest.raises(InputError, match="position"):
        ToolTarget(position=np.array([0.0, np.nan, 0.0]))
    with pytest.raises(InputError, match="rotation"):
        ToolTarget(position=np.zeros(3), rotation=np.ones((3, 3)))
    with pytest.raises(InputError, match="span"):
        ArmSettings(span=-1.0)
