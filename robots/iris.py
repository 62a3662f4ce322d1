"""The Iris quadrotor of 3D Robotics: four propellers on a free base, no joints.

Its propellers give k w^2 with k = 5.84e-6 N s^2/rad^2 up to w = 1100 rad/s, and a drag of 0.06 N m/N (Furrer,
Burri, Achtelik, Siegwart, "RotorS - a modular Gazebo MAV simulator framework", 2016, and PX4's model of it).
"""

from trajopt.robot import Robot, Thruster, robot_file

KIND = "multirotor"

MOST = 5.84e-6 * 1100.0**2  # N
DRAG = 0.06  # N m/N
# The first two rotors turn counter-clockwise, so their drag on the body is clockwise.
TURNS = (-1, -1, 1, 1)


def build() -> Robot:
    """Return the quadrotor, level at the world's origin."""
    body = Robot.from_urdf(robot_file("iris_description/robots/iris_simple.urdf"), name="iris")
    return body.with_thrusters(
        [
            Thruster(name=f"rotor_{k}", frame=f"iris__rotor_{k}", drag=turn * DRAG, most=MOST)
            for k, turn in enumerate(TURNS)
        ]
    )
