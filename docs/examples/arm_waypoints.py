"""A UR5 moves its tool through three waypoints in least time."""

import numpy as np

import trajopt
from trajopt import Phase, Problem, Schedule, terms
from trajopt.robot import inverse_kinematics
from trajopt.schedule import start_of

TOOL = "tool0"
# Where the tool has to be, m in the world: two places to pass, one to stop at.
WAYPOINTS = np.array([[0.45, 0.25, 0.55], [0.55, -0.05, 0.35], [0.35, -0.40, 0.50]])
GUESSED, SHORTEST, LONGEST = 0.6, 0.05, 3.0  # s, from one waypoint to the next

robot = trajopt.robot("ur5")

# Postures at the waypoints, each from the one before: for the guess.
postures = [robot.reference]
for place in WAYPOINTS:
    found = inverse_kinematics(robot, postures[-1], {TOOL: place})
    assert found.error < 1e-6, f"{place} m is out of reach by {found.error:.2g} m"
    postures.append(found.q)


def guess(t: float) -> np.ndarray:
    """Straight from posture to posture (nq,)."""
    i = int(np.clip(t / GUESSED, 0, len(WAYPOINTS) - 1))
    return postures[i] + (t / GUESSED - i) * (postures[i + 1] - postures[i])


# One phase to each waypoint, of free duration.
legs = [
    Phase(name=name, duration=GUESSED, contacts=(), duration_bounds=(SHORTEST, LONGEST))
    for name in ("first", "second", "third")
]
problem = Problem(
    name="arm-waypoints",
    robot=robot,
    schedule=Schedule(tuple(legs)),
    guess=guess,
    terms=(
        terms.TimeCost(weight=1.0),
        terms.AccelerationCost(weight=1e-4),  # smooth where time alone leaves a choice
        *(terms.TorqueLimits(), terms.VelocityLimits(), terms.PositionLimits()),
        terms.FramePose(frame=TOOL, position=WAYPOINTS[0], at=start_of("second")),
        terms.FramePose(frame=TOOL, position=WAYPOINTS[1], at=start_of("third")),
        terms.FramePose(frame=TOOL, position=WAYPOINTS[2]),  # at the end
        terms.TerminalRest(q=postures[-1]),
    ),
)

if __name__ == "__main__":
    solution = trajopt.solve(problem)
    print(solution.meta["status"], f"in {solution.t[-1]:.2f} s", trajopt.check(solution).failures())
    solution.save("arm-waypoints.npz")
