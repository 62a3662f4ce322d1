"""The tasks: five of ANYmal B from Crocoddyl's examples, and a jump of Solo12.

Only the standard library is needed.

Numbers of the first five are those of `crocoddyl.examples.quadrupedal_gaits_fwddyn`.
"""

from dataclasses import dataclass

# Time of a knot in Crocoddyl's examples, s.
KNOT = 0.01
ANYMAL_FEET = ("LF", "RF", "LH", "RH")


@dataclass(frozen=True, kw_only=True)
class Gait:
    """Steps from standing at rest: ``blocks`` of support on all feet followed by steps, each of some feet.

    length: of a step, m; ``first``: factor of it in the first block. height: of a swing, m. step, support: s.
    """

    name: str
    length: float
    height: float
    blocks: tuple[tuple[tuple[str, ...], ...], ...]
    support: float
    step: float = 25 * KNOT
    first: float = 0.5


@dataclass(frozen=True, kw_only=True)
class Jump:
    """A jump from standing at rest: ``ground`` s of push, ``flight`` s, landing and ``ground`` s on all feet.

    height: rise in mid flight, m. distance: displacement (3,) of all feet, m. torque_limit: of all torques,
    N m; None: the robot's own.
    """

    name: str
    robot: str = "anymal_b"
    height: float
    distance: tuple[float, float, float]
    ground: float
    flight: float
    torque_limit: float | None = None


Task = Gait | Jump

WALK, BOUND = ((("RH",), ("RF",)), (("LH",), ("LF",))), ((("LF", "RF"),), (("LH", "RH"),))
GAITS = (
    Gait(name="walk", length=0.25, height=0.15, blocks=WALK, support=2 * KNOT),
    Gait(name="trot", length=0.15, height=0.1, blocks=((("RF", "LH"),), (("LF", "RH"),)), support=2 * KNOT),
    Gait(name="pace", length=0.15, height=0.1, blocks=((("RF", "RH"),), (("LF", "LH"),)), support=5 * KNOT),
    Gait(name="bound", length=0.15, height=0.1, blocks=BOUND, support=5 * KNOT, first=1.0),
)
ANYMAL_JUMP = Jump(name="jump", height=0.15, distance=(0.0, 0.3, 0.0), ground=10 * KNOT, flight=40 * KNOT)
# The rise is that of a ballistic flight; 2.7 N m is what the actuators can do (Grimminger et al., "An open
# torque-controlled modular robot architecture for legged locomotion research", 2020), not the URDF's 1000.
SOLO_JUMP = Jump(
    name="solo12-jump",
    robot="solo12",
    height=0.11,
    distance=(0.3, 0.0, 0.0),
    ground=40 * KNOT,
    flight=30 * KNOT,
    torque_limit=2.7,
)
TASKS: dict[str, Task] = {task.name: task for task in (*GAITS, ANYMAL_JUMP, SOLO_JUMP)}
