"""A drive from the browser: a session, its page, and the loop that runs until Ctrl-C."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from trajopt.collision import Obstacle
from trajopt.control.mpc.arm import ArmSettings
from trajopt.control.mpc.receding import ControllerSettings
from trajopt.errors import InputError
from trajopt.motion.output import check_solution_output
from trajopt.robot.robot import Robot
from trajopt.view.driving.drawing import SOURCE, Painter, scene_of
from trajopt.view.driving.drivers import ArmDriver, LegsDriver, PageController
from trajopt.view.driving.server import DriveServer
from trajopt.view.driving.session import DriveSession
from trajopt.view.replay.page import live_page
from trajopt.view.replay.show import open_address, server_address_text

# Turns of the loop per picture, and per drawing of the plan.
PICTURE, PLAN = 2, 6
# Tolerance for rounding of times, s.
LEAST = 1e-9


def driver_of(
    robot: Robot,
    *,
    target: bool = False,
    gaits: Sequence[str] | None = None,
    settings: ControllerSettings | ArmSettings | None = None,
    obstacles: Sequence[Obstacle] = (),
) -> PageController[Any]:
    """Return the driver of a robot: a `LegsDriver`, or with ``target`` an `ArmDriver`.

    Raises:
        InputError: for a base that does not fit, or a gait that the robot does not have.
    """
    if target:
        chosen = settings if isinstance(settings, ArmSettings) else None
        return ArmDriver(robot, settings=chosen, obstacles=obstacles)
    if robot.base == "fixed":
        raise InputError(
            f"robot '{robot.name}' has a fixed base", "allowed: with a target, which an arm's tool follows"
        )
    return LegsDriver(robot, gaits, settings if isinstance(settings, ControllerSettings) else None)


class LiveDrive:
    """A session and its page, whose address is printed; leaving its context closes both.

    Args:
        robot: legged, with a free base; with ``target`` an arm with a fixed base.
        port: of the page; default: the first free one from 7000 on.
        open_browser: open the page, if there is a display.
        target: let the page set the position of a target that the tool follows.
        gaits: to prepare; default: `USUAL_GAITS`.
        settings: of the controller.
        obstacles: avoided by the arm.
        options: passed to `DriveSession`.

    Raises:
        InputError: for a port that is taken, or a robot or gait that does not fit.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        port: int | None = None,
        open_browser: bool = True,
        target: bool = False,
        gaits: Sequence[str] | None = None,
        settings: ControllerSettings | ArmSettings | None = None,
        obstacles: Sequence[Obstacle] = (),
        **options: Any,
    ) -> None:
        server = DriveServer(port)
        try:
            driver = driver_of(robot, target=target, gaits=gaits, settings=settings, obstacles=obstacles)
            self.session = DriveSession(driver, **options)
            scene, facts = scene_of(self.session.stand, self.session.driver)
            self._painter = Painter(self.session)
            server.tell("state", self._painter.state())
            server.tell("drawn", True)
            server.show(live_page(facts, SOURCE), scene, self.session.obey)
        except BaseException:
            server.close()
            raise
        self._server, self.url = server, server.url
        print(server_address_text(self.url, "drive"), flush=True)
        if open_browser:
            open_address(self.url)

    def run(
        self,
        *,
        seconds: float | None = None,
        exit_with_page: bool = False,
        leaving: Callable[[], bool] | None = None,
    ) -> None:
        """Drive until ``leaving()``, which is checked every 20 ms, or for ``seconds`` of simulated time.

        With ``seconds``, a fall also ends the drive; an error of the controller counts as one. With
        ``exit_with_page``, it ends `SILENCE` s after the last message of the page.
        """
        session, driven, turns = self.session, self.session.driven, 0
        while not ((leaving is not None and leaving()) or (exit_with_page and session.silent)):
            if seconds is not None and (driven.passed >= seconds - LEAST or driven.fall is not None):
                return
            session.turn()
            turns += 1
            if turns % PICTURE == 0:
                self._server.tell("state", self._painter.state(plan=turns % PLAN == 0))
            session.wait()

    def close(self) -> None:
        """Stop the server and the planning thread."""
        self._server.close()
        self.session.close()

    def __enter__(self) -> LiveDrive:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def drive_live(
    robot: Robot,
    *,
    seconds: float | None = None,
    exit_with_page: bool = False,
    output: Path | None = None,
    **options: Any,
) -> DriveSession:
    """Drive a robot from a page in the browser until Ctrl-C; returns the closed session.

    Args:
        robot: legged, with a free base; with ``target=True`` an arm with a fixed base.
        seconds: see `LiveDrive.run`.
        exit_with_page: end `SILENCE` s after the page was closed.
        output: solution file of the motion since the last begin, at most of the last minute.
        options: passed to `LiveDrive`.

    Raises:
        InputError: see `LiveDrive`; also for a file that cannot be written, or an output without any motion.
    """
    if output is not None:
        check_solution_output(output)
    with LiveDrive(robot, **options) as live:
        with contextlib.suppress(KeyboardInterrupt):
            live.run(seconds=seconds, exit_with_page=exit_with_page)
        if output is not None:
            live.session.as_drive().as_solution().save(output)
    return live.session
