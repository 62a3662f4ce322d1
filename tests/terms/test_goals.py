"""End-effector goals at the end of a motion, measured with numeric Pinocchio."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.testing import assert_allclose

from trajopt.solving.solving import solve
from trajopt.terms import FramePose, FrameVelocity, TerminalRest
from trajopt_library import problems
from trajopt_library.robots.ur5 import TOOL

# Ten times the solver's default tolerance on rows of about a metre and a metre per second.
SOLVED = 1e-5


def test_tool_passes_its_goal_with_the_velocity_asked():
    velocity = np.array([0.2, -0.1, 0.05, 0.0, 0.3, 0.0])
    reach = problems.load("ur5-reach")
    kept = tuple(term for term in reach.terms if not isinstance(term, TerminalRest))
    solution = solve(
        replace(reach, terms=(*kept, FrameVelocity(frame=TOOL, velocity=velocity))),
        intervals=15,
    )
    assert solution.converged
    model, data = reach.robot.model, reach.robot.model.createData()
    pin.forwardKinematics(model, data, solution.q[-1], solution.v[-1])
    frame = model.getFrameId(TOOL)
    reached = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
    assert_allclose(reached, velocity, atol=SOLVED)
    (goal,) = [term for term in reach.terms if isinstance(term, FramePose)]
    pose = pin.updateFramePlacement(model, data, frame)
    assert_allclose(pose.translation, goal.position, atol=SOLVED)
    assert_allclose(pin.log3(goal.rotation.T @ pose.rotation), np.zeros(3), atol=SOLVED)
