"""Quadrupeds with the same construction: those of Unitree and ANYbotics in example-robot-data."""

from trajopt.robot import Contact, Robot, robot_file

UNITREE_LEGS = ("FL", "FR", "RL", "RR")
ANYMAL_LEGS = ("LF", "RF", "LH", "RH")


def unitree(
    name: str,
    path: str,
    *,
    radius: float,
    centre: tuple[float, float, float] | None = None,
    thigh: float,
    calf: float,
    hip: float = 0.0,
) -> Robot:
    """Return a robot of Unitree on four point feet ``FL``, ``FR``, ``RL``, ``RR``, standing.

    path: of the URDF within example-robot-data. radius: of the feet's balls, m. centre: of each in its foot
    frame, m, where this adds a frame ``FL_ball``, ...; None: the foot frame. hip, thigh, calf: angles of
    every leg, rad; a positive hip spreads the legs, a calf is bent when negative.
    """
    reference = {}
    for leg in UNITREE_LEGS:
        outwards = hip if leg.endswith("L") else -hip
        for joint, angle in (("hip", outwards), ("thigh", thigh), ("calf", calf)):
            reference[f"{leg}_{joint}_joint"] = angle
    feet = {leg: f"{leg}_foot" for leg in UNITREE_LEGS}
    return _on_balls(name, path, feet, radius, centre, reference)


def anymal(name: str, path: str, *, radius: float, rise: float) -> Robot:
    """Return an ANYmal on four point feet ``LF``, ``RF``, ``LH``, ``RH``, in its SRDF's "standing".

    Knees point to each other: those in front are bent backwards. Contacts are in frames ``LF_BALL``, ...,
    which this adds: centres of the feet's balls of ``radius`` m, ``rise`` m above the foot frames along z.
    """
    reference = {}
    for leg in ANYMAL_LEGS:
        front, left = leg.endswith("F"), leg.startswith("L")
        reference[f"{leg}_HAA"] = -0.1 if left else 0.1
        reference[f"{leg}_HFE"] = 0.7 if front else -0.7
        reference[f"{leg}_KFE"] = -1.0 if front else 1.0
    feet = {leg: f"{leg}_FOOT" for leg in ANYMAL_LEGS}
    return _on_balls(name, path, feet, radius, (0.0, 0.0, rise), reference)


def _on_balls(
    name: str,
    path: str,
    feet: dict[str, str],
    radius: float,
    centre: tuple[float, float, float] | None,
    reference: dict[str, float],
) -> Robot:
    """Return the robot on point contacts at foot frames, by name, or at centres (3,) m in them."""
    balls = {} if centre is None else {_ball(foot): (foot, centre, (0.0, 0.0, 0.0)) for foot in feet.values()}
    frames = feet if centre is None else {leg: _ball(foot) for leg, foot in feet.items()}
    return Robot.from_urdf(
        robot_file(path),
        name=name,
        base="freeflyer",
        frames=balls,
        contacts=[Contact(frame=frame, name=leg, radius=radius) for leg, frame in frames.items()],
        reference=reference,
    )


def _ball(foot: str) -> str:
    """Return the name of the frame at the centre of a foot's ball."""
    return foot.replace("FOOT", "BALL").replace("foot", "ball")
