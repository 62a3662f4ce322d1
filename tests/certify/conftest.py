"""Motions whose truth is known, for the checks to judge."""

import pytest

from tests.support.synthetic_motions import arm_motion, pushing_off, sampled, standing, tumbling_flight
from trajopt import Robot, Solution
from trajopt_library import robots

INTERVALS = 20


@pytest.fixture(scope="session")
def solo() -> Robot:
    return robots.load("solo12")


@pytest.fixture(scope="session")
def arm() -> Solution:
    robot = robots.load("ur5")
    return sampled(robot, [arm_motion(robot)], INTERVALS)


@pytest.fixture(scope="session")
def flight(solo: Robot) -> Solution:
    return sampled(solo, [tumbling_flight(solo)], INTERVALS)


@pytest.fixture(scope="session")
def stance(solo: Robot) -> Solution:
    return sampled(solo, [standing(solo)], INTERVALS)


@pytest.fixture(scope="session")
def push(solo: Robot) -> Solution:
    return sampled(solo, [pushing_off(solo)], INTERVALS)
