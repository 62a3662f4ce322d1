"""Drives with what the controller does not know of: disturbances, masses, rough ground (docs/mpc.md)."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import click
import numpy as np

from scripts.measure.robustness import DISTURBANCES
from scripts.measure.shared import head, row
from scripts.measure.steering import (
    START,
    TITLES,
    cells,
    names_option,
    random_pushes,
    random_walk,
    seeds_option,
    straight,
)
from trajopt.control.mpc import Controller, ControllerSettings, PlannerSettings, boxes_ahead, slope_ahead
from trajopt.control.mpc.payload import carrying, payload_numbers
from trajopt.dynamics import gravity_of
from trajopt.simulation import drive
from trajopt_library import robots


@click.command("disturbed")
@names_option
@click.option("--seconds", default=10.0, show_default=True, help="Of each drive.")
@click.option("--push", default=0.3, show_default=True, help="Impulse each 3 s, natural units.")
def disturbed(names: str, seconds: float, push: float) -> None:
    """Random commands and pushes under disturbances that the controller does not know of.

    With plans from the measured state, and with plans that go on from the last one: falls, errors of speed.
    """
    titles = [f"{name}: {what}" for name in names.split(",") for what in ("re-planned", "without")]
    head("disturbance", *titles)
    for title, given in DISTURBANCES.items():
        row(title, *(cell for name in names.split(",") for cell in _disturbed(name, given, seconds, push)))


def _disturbed(name: str, given: dict[str, Any], seconds: float, push: float) -> Iterator[str]:
    robot = robots.load(name)
    own = {key: value for key, value in given.items() if key != "front_left"}
    if "front_left" in given:
        own["ground_offsets"] = {robot.contacts[0].frame: given["front_left"]}
    script, pushes = random_walk(robot, "trot", seconds, 0), random_pushes(robot, push, seconds, 0)
    for measured in (True, False):
        settings = ControllerSettings(measured=measured)
        fell, *speeds = cells(drive(robot, script, duration=seconds, settings=settings, pushes=pushes, **own))
        yield fell if fell != "no" else f"{speeds[0]}, {speeds[1]}"


@click.command("carried")
@names_option
@click.option("--seconds", default=10.0, show_default=True, help="Of each drive.")
def carried(names: str, seconds: float) -> None:
    """Random commands with a mass on the base, that the controller does not know, or knows.

    It is 0.3 and 0.5 of the robot's, at 0.1, 0.1, 0.3 of its length from the base.
    """
    head("robot", "mass", "known", *TITLES[:4], "sags by, mm")
    for name in names.split(","):
        robot = robots.load(name)
        script, place = random_walk(robot, "trot", seconds, 0), robot.length * np.array([0.1, 0.1, 0.3])
        usual = drive(robot, script, duration=seconds).record.qpos[:, 2].mean()
        for part in (0.3, 0.5):
            mass = part * robot.weight / gravity_of(robot.model)
            loaded = replace(robot, model=carrying(robot.model, payload_numbers(mass, place)))
            for known in (False, True):
                controller = Controller(robot)
                if known:
                    controller.carry(mass, place)
                run = drive(loaded, script, duration=seconds, controller=controller)
                sags = 1e3 * (usual - run.record.qpos[:, 2].mean())
                row(name, str(part), "yes" if known else "no", *cells(run)[:4], f"{sags:.1f}")


@click.command("rough")
@names_option
@seeds_option
@click.option("--fixed", is_flag=True, help="Durations are those of the gait.")
def rough(names: str, seeds: int, fixed: bool) -> None:
    """Way in m over ground that the planner does not know; swings are 0.4 of the leg high."""
    settings = ControllerSettings(lift=0.4, planner=PlannerSettings(timing=0.0 if fixed else None))
    head("robot", "gait", "slope 10 degrees", *(f"boxes, seed {seed}" for seed in range(seeds)))
    for name in names.split(","):
        robot = robots.load(name)
        for gait in ("walk", "trot"):
            speed = (0.2 if gait == "walk" else 0.3) * math.sqrt(gravity_of(robot.model) * robot.length)
            grounds = [slope_ahead(10.0), *(boxes_ahead(robot, 0.1, seed) for seed in range(seeds))]
            script, duration = straight(gait, speed), START + 4.0 / speed
            runs = [
                drive(robot, script, duration=duration, ground=ground, settings=settings)
                for ground in grounds
            ]
            row(name, gait, *(f"{run.record.qpos[-1, 0]:.1f}{', fell' * run.report.fell}" for run in runs))
