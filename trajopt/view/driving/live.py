"""A drive from the browser: a session, its page, and the loop that runs until Ctrl-C."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from trajopt.collision import Obstacle
from trajopt.errors import InputError
from trajopt.mpc.arm import ArmSettings
from trajopt.mpc.receding import ControllerSettings
from trajopt.robot.robot import Robot
from trajopt.solution.output import check_solution_output
from trajopt.view.driving.drawing import SOURCE, Painter, scene_of
from trajopt.view.driving.drivers import ArmDriver, LegsDriver, PageController
from trajopt.view.driving.server import DriveServer
from trajopt.view.driving.session import DriveSession
from trajopt.view.replay.page import live_page
from trajopt.view.replay.show import open_address, server_address_text

# Turns between two pictures, and between two drawings of the plan.
PICTURE, PLAN = 2, 6
# Rounding of times, s.
LEAST = 1e-9


def driver_of(
    robot: Robot,
    *,
    target: bool = False,
    gaits: Sequence[str] | None = None,
    settings: ControllerSettings | ArmSettings | None = None,
    obstacles: Sequence[Obstacle] = (),
) -> PageController:
    """What steers a robot: its legs by a command, or with ``target`` the tool of an arm.

    Raises:
        InputError: for a base that does not fit, and a gait that the robot does not have.
    """
    if target:
        chosen = settings if isinstance(settings, ArmSettings) else None
        return ArmDriver(robot, settings=chosen, obstacles=obstacles)
    if robot.base == "fixed":
        raise InputError(
            f"robot '{robot.name}' has a fixed base", "allowed: with --target, an arm's tool follows"
        )
    return LegsDriver(robot, gaits, settings if isinstance(settings, ControllerSettings) else None)


class LiveDrive:
    """A session and its page, whose address is printed; a context manager, at whose end both end.

    Args:
        robot: on legs, with a free base, or with ``target`` on a fixed base.
        port: of the page; default: the first that is free from 7000 on.
        open_browser: open the page, if there is a screen.
        target: the page sets the place of a target that the tool follows.
        gaits: that are prepared; default `USUAL_GAITS`.
        settings: of the controller.
        obstacles: of which the arm keeps clear.
        options: of `DriveSession`.

    Raises:
        InputError: for a port that is taken, and a robot or gait that does not fit.
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
        leaving: Callable[[], bool] = bool,
    ) -> None:
        """Drive until ``leaving()``, which is asked every 20 ms, or after ``seconds`` of simulated time.

        With ``seconds`` a fall ends it too; with ``exit_with_page`` `SILENCE` s without the page. Raises
        `TrajoptError` for what goes wrong in a plan.
        """
        session, turns = self.session, 0
        while not (leaving() or (exit_with_page and session.silent)):
            if seconds is not None and (session.passed >= seconds - LEAST or session.fall is not None):
                return
            session.turn()
            turns += 1
            if turns % PICTURE == 0:
                self._server.tell("state", self._painter.state(plan=turns % PLAN == 0))
            session.wait()

    def close(self) -> None:
        """End the server and the thread of plans."""
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
    """Drive a robot from a page in the browser until Ctrl-C; returns the session, which has ended.

    Args:
        robot: on legs, with a free base, or with ``target=True`` on a fixed base.
        seconds: as of `LiveDrive.run`.
        exit_with_page: end `SILENCE` s after the page was closed.
        output: file of the last minute at most, since the last begin.
        options: of `LiveDrive`.

    Raises:
        InputError: as of `LiveDrive`, and for a file that cannot be written.
        TrajoptError: for what goes wrong in a plan.
    """
    if output is not None:
        check_solution_output(output)
    with LiveDrive(robot, **options) as live:
        with contextlib.suppress(KeyboardInterrupt):
            live.run(seconds=seconds, exit_with_page=exit_with_page)
        if output is not None:
            live.session.as_drive().as_solution().save(output)
    return live.session
