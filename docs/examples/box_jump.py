"""A Go2 leaps sideways onto a box of 0.25 m and makes half a turn on the way."""

import numpy as np
import pinocchio as pin

import trajopt
from trajopt import Phase, Problem, Schedule, terms
from trajopt.reduced import BaseWaypoint, legged_guess
from trajopt.schedule import footholds_at
from trajopt.terrain import PiecewiseTerrain

HEIGHT, LEFT, TURN = 0.25, 0.45, np.pi  # of the box; of the goal, m and rad
PUSH, FLIGHT, LANDING, CLEARANCE = 0.5, 0.34, 0.6, 0.03  # s; of the feet over edges, m

robot = trajopt.robot("go2")
box = PiecewiseTerrain.box(HEIGHT, 1.2, 0.8, at=(0.0, LEFT + 0.22), friction=0.8)
start, goal = robot.reference, robot.reference.copy()
goal[:3] += [0.0, LEFT, HEIGHT]
goal[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, TURN)).coeffs()

# Who stands when: four feet, none, four feet where they are in the goal.
feet = tuple(contact.name for contact in robot.contacts)
push = Phase(name="push", duration=PUSH, contacts=feet)
flight = Phase(name="flight", duration=FLIGHT, contacts=())
landing = Phase(name="landing", duration=LANDING, contacts=feet, footholds=footholds_at(robot, goal, box))
schedule = Schedule((push, flight, landing))

# The guess: the base goes down, up to the take-off, onto bent legs, further down and up again.
times = np.cumsum([0.0, PUSH - 0.2, 0.2, FLIGHT, 0.2, LANDING - 0.2])
left = [0.0, 0.0, 0.06, LEFT - 0.06, LEFT, LEFT]
up = [0.0, -0.08, 0.02, HEIGHT - 0.06, HEIGHT - 0.12, HEIGHT]
turns = TURN * np.array([0.0, 0.0, 0.2, 0.6, 0.2, 0.0])  # since the waypoint before
base = [
    BaseWaypoint(time=t, position=start[:3] + np.array([0.0, y, z]), turn=(0.0, 0.0, turn))
    for t, y, z, turn in zip(times, left, up, turns, strict=True)
]
guess = legged_guess(robot, schedule, base, terrain=box, clearance=CLEARANCE)

joints = tuple(f"{leg}_{joint}_joint" for leg in feet for joint in ("hip", "calf"))
problem = Problem(
    name="box-jump",
    robot=robot,
    schedule=schedule,
    terrain=box,
    guess=guess,
    terms=(
        *(*terms.effort_costs(acceleration=2e-2), terms.TrackingCost(weight=3.0, reference=guess)),
        *(terms.TorqueLimits(), terms.PositionLimits(), terms.VelocityLimits(), terms.FrictionPyramid()),
        *terms.swing_clearance(robot, schedule, box, height=CLEARANCE, guess=guess),
        terms.FramesAbove(frames=joints, height=0.07, during=("push", "flight")),
        terms.FramesAbove(frames=joints, height=HEIGHT + 0.07, during="landing"),
        *(terms.TerminalState(q=goal), terms.TerminalRest(q=goal)),
    ),
)

if __name__ == "__main__":
    solution = trajopt.solve(problem)
    print(solution.statistics.status, trajopt.check(solution).failures())
    solution.save("box-jump.npz")
