"""Several contacts on one link: their dependent rows leave programs solvable, without anything relaxed."""

import numpy as np

from trajopt.control.contact_forces import ActiveContact
from trajopt.control.inverse_dynamics import RELAXED, TaskSpaceInverseDynamics
from trajopt.control.limits import TickLimits
from trajopt.control.robot_state import RobotState
from trajopt.robot import with_edges
from trajopt.robot.natural_units import NaturalUnits
from trajopt_library.problems import bipeds

DAMPING = 20.0  # 1/s
WIDE = 1e3  # rad/s^2, far beyond what standing takes
# Velocities that no foot of four points has exactly: measured states are not on the contacts, m/s and rad/s.
OFF = 1e-3


def test_corners_of_soles_stand_without_relaxing_their_rows():
    robot = with_edges(bipeds.biped("g1"))
    state, units = RobotState(robot.model), NaturalUnits.of(robot.model)
    state.update(robot.reference, np.full(robot.nv, OFF))
    up = np.array([0.0, 0.0, 1.0])
    contacts = [
        ActiveContact(number=i, frame=contact.frame, dimension=3, normal=up, friction=0.7)
        for i, contact in enumerate(robot.contacts)
    ]
    program = TaskSpaceInverseDynamics(
        state=state,
        actuation=robot.actuation,
        acceleration_unit=units.acceleration(robot.model),
        force_units=(units.weight, units.weight * units.length),
        torque_unit=units.generalized_force(robot.model),
        damping=DAMPING,
    )
    torque, wide = robot.torque_limit, np.full(robot.nu, WIDE)
    limits = TickLimits(torque=(-torque, torque), acceleration=(-wide, wide), friction=np.zeros(robot.nu))
    result = program.solve(contacts, [], limits)
    assert RELAXED[result.relaxed] == "nothing"
    for contact in contacts:
        frame = state.frame(contact.frame)
        motion = frame.jacobian[:3] @ result.acceleration + frame.drift[:3] + DAMPING * frame.velocity[:3]
        assert np.abs(motion).max() < OFF
