"""HyQ, the hydraulic quadruped of the Istituto Italiano di Tecnologia, 87 kg."""

from trajopt.robot import Contact, Robot, robot_file

KIND = "quadruped"
LEGS = ("lf", "rf", "lh", "rh")
RADIUS = 0.02175  # m, of the collision sphere at a foot frame


def build() -> Robot:
    """Return HyQ on four point feet ``lf``, ``rf``, ``lh``, ``rh``, standing as its SRDF says.

    Knees point to each other. A foot frame is the centre of a ball of 22 mm radius. Limits are those of
    the URDF (150 N m and 12 rad/s at every joint).
    """
    reference = {}
    for leg in LEGS:
        side = 1.0 if leg.endswith("f") else -1.0
        for joint, angle in (("haa", -0.2), ("hfe", 0.75 * side), ("kfe", -1.5 * side)):
            reference[f"{leg}_{joint}_joint"] = angle
    return Robot.from_urdf(
        robot_file("hyq_description/robots/hyq_no_sensors.urdf"),
        name="hyq",
        base="freeflyer",
        contacts=[Contact(frame=f"{leg}_foot", name=leg, radius=RADIUS) for leg in LEGS],
        reference=reference,
    )
