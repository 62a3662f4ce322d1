"""A Go2 jumps onto a box of 0.25 m and makes half a turn on the way."""

import numpy as np
import pinocchio as pin

import trajopt
from trajopt import Phase, Problem, Schedule
from trajopt.guesses import BaseWaypoint, legged_guess
from trajopt.schedule import footholds_at
from trajopt.terms import (
    EffortLimits,
    FramesAbove,
    FrictionPyramid,
    PositionLimits,
    TerminalRest,
    TerminalState,
    VelocityLimits,
    effort_costs,
    swing_clearance,
)
from trajopt.terrain import PiecewiseTerrain

HEIGHT, AHEAD, TURN = 0.25, 0.70, np.pi  # of the box, of the goal: m, rad
PUSH, FLIGHT, LANDING = 0.5, 0.34, 0.6  # s
CLEARANCE = 0.03  # of the feet over ground and edges, m

robot = trajopt.robot("go2")
box = PiecewiseTerrain.box(HEIGHT, 0.8, 1.0, at=(AHEAD + 0.08, 0.0), friction=0.8)
start, goal = robot.reference, robot.reference.copy()
goal[:3] += [AHEAD, 0.0, HEIGHT]
goal[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, TURN)).coeffs()

feet = tuple(contact.name for contact in robot.contacts)
schedule = Schedule(
    (
        Phase(name="push", duration=PUSH, contacts=feet),
        Phase(name="flight", duration=FLIGHT, contacts=()),
        Phase(name="landing", duration=LANDING, contacts=feet, footholds=footholds_at(robot, goal, box)),
    )
)
# Where the base goes: down, up to the take-off, through the air, down on bent legs, up again.
path = [
    (0.0, (0.0, 0.0, 0.0), 0.0),
    (PUSH - 0.2, (0.0, 0.0, -0.08), 0.0),
    (PUSH, (0.05, 0.0, 0.02), 0.1 * TURN),
    (PUSH + FLIGHT, (AHEAD - 0.05, 0.0, HEIGHT - 0.06), 0.8 * TURN),
    (PUSH + FLIGHT + 0.2, (AHEAD, 0.0, HEIGHT - 0.12), 0.1 * TURN),
    (PUSH + FLIGHT + LANDING, (AHEAD, 0.0, HEIGHT), 0.0),
]
base = [BaseWaypoint(time=t, position=start[:3] + p, turn=(0.0, 0.0, turn)) for t, p, turn in path]
guess = legged_guess(robot, schedule, base, terrain=box, clearance=CLEARANCE)

limits = (EffortLimits(), PositionLimits(), VelocityLimits(), FrictionPyramid())
knees = tuple(f"{leg}_calf_joint" for leg in ("FL", "FR", "RL", "RR"))
low, high = (FramesAbove(frames=knees, height=z, phases=(p,)) for z, p in ((0.08, "push"), (HEIGHT + 0.08, "landing")))
swings = swing_clearance(robot, schedule, box, height=CLEARANCE, guess=guess)
problem = Problem(
    name="box-jump",
    robot=robot,
    schedule=schedule,
    terrain=box,
    initial_q=start,
    initial_v=np.zeros(robot.nv),
    terms=(*effort_costs(acceleration=2e-2), *limits, *swings, low, high, TerminalState(q=goal), TerminalRest(q=goal)),
    guess=guess,
)

if __name__ == "__main__":
    solution = trajopt.solve(problem)
    print(solution.meta["status"], solution.meta["iterations"], trajopt.check(solution).failures())
    solution.save("box-jump.npz")
