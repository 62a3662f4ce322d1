"""A UR5 moves its tool through three waypoints in least time."""

import numpy as np

import trajopt
from trajopt import Phase, Problem, Schedule, terms
from trajopt.schedule import start_of

TOOL = "tool0"
# Where the tool has to be, m in the world: two places to pass, one to stop at.
WAYPOINTS = np.array([[0.45, 0.25, 0.55], [0.55, -0.05, 0.35], [0.35, -0.40, 0.50]])
GUESSED, SHORTEST, LONGEST = 0.6, 0.05, 3.0  # s, from one waypoint to the next

robot = trajopt.robot("ur5")

# One phase to each waypoint, of free duration.
legs = [
    Phase(name=name, duration=GUESSED, contacts=(), duration_bounds=(SHORTEST, LONGEST))
    for name in ("first", "second", "third")
]
problem = Problem(
    name="arm-waypoints",
    robot=robot,
    schedule=Schedule(tuple(legs)),
    terms=(
        terms.TimeCost(weight=1.0),
        terms.AccelerationCost(weight=1e-4),  # smooth where time alone leaves a choice
        *(terms.TorqueLimits(), terms.VelocityLimits(), terms.PositionLimits()),
        terms.FramePose(frame=TOOL, position=WAYPOINTS[0], at=start_of("second")),
        terms.FramePose(frame=TOOL, position=WAYPOINTS[1], at=start_of("third")),
        terms.FramePose(frame=TOOL, position=WAYPOINTS[2]),  # at the end
        terms.TerminalRest(),
    ),
)

if __name__ == "__main__":
    solution = trajopt.solve(problem)
    print(solution.statistics.status, f"in {solution.t[-1]:.2f} s", trajopt.check(solution).failures())
    solution.save("arm-waypoints.npz")
