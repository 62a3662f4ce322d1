"""A drive from the browser: a session, its page, and the loop that runs until Ctrl-C."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

from trajopt.collision import Obstacle
from trajopt.robot.robot import Robot
from trajopt.simulation.driven_scene import DrivenScene
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.view.driving.drawing import SOURCE, Painter, scene_of
from trajopt.view.driving.drivers import ArmDriver, LegsDriver
from trajopt.view.driving.server import DriveServer
from trajopt.view.driving.session import DriveSession
from trajopt.view.replay.page import live_page
from trajopt.view.replay.show import open_address, server_address_text

# Turns of the loop per picture, and per drawing of the plan.
PICTURE, PLAN = 2, 6
# Tolerance for rounding of times, s.
LEAST = 1e-9


class LiveDrive:
    """A session and its page, whose address is printed; leaving its context closes both.

    Args:
        robot: legged, with a free base; with ``target`` an arm with a fixed base.
        port: of the page; default: the first free one from 7000 on.
        open_browser: open the page, if there is a display.
        target: let the page set the position of a target that the tool follows.
        gaits: to prepare; default: `USUAL_GAITS`.
        settings: of the controller, with ``target`` `ArmSettings`, otherwise `ControllerSettings`.
        obstacles: avoided by the arm.
        terrain: known ground under a robot on legs; default: level ground.
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
        settings: Any = None,
        obstacles: Sequence[Obstacle] = (),
        terrain: PiecewiseTerrain | None = None,
        **options: Any,
    ) -> None:
        server = DriveServer(port, f"{robot.name}: its shapes and its first plans are computed")
        try:
            arm = ArmDriver(robot, settings=settings, obstacles=obstacles) if target else None
            self.session = DriveSession(arm or LegsDriver(robot, gaits, settings, terrain), **options)
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
        session, turns = self.session, itertools.count()

        def ticks(driven: DrivenScene) -> int:
            turn = next(turns)
            if turn and turn % PICTURE == 0:
                self._server.tell("state", self._painter.state(plan=turn % PLAN == 0))
            over = (leaving is not None and leaving()) or (exit_with_page and session.silent)
            if seconds is not None:
                over = over or driven.passed - driven.rises >= seconds - LEAST or driven.fall is not None
            return 0 if over else session.ticks(driven)

        session.driven.simulate(ticks)

    def close(self) -> None:
        """Stop the server and the planning thread."""
        self._server.close()
        self.session.close()

    def __enter__(self) -> LiveDrive:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
