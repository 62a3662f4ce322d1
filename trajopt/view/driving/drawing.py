"""Data for the page of a drive: the scene once, then joints, contact forces and the plan as plain numbers."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.control.mpc.motion import HorizonMotion
from trajopt.motion.solution import Solution
from trajopt.robot.kinematics import contact_positions, frame_pose
from trajopt.simulation.driven_scene import DrivenScene
from trajopt.view.driving.drivers import ArmDriver, LegsDriver, PageController
from trajopt.view.driving.session import DriveSession
from trajopt.view.replay.commands import ViewerCommand
from trajopt.view.replay.ground import BOLD_EVERY, grid_cell
from trajopt.view.replay.page import REPLAY, WEB, PageSource
from trajopt.view.replay.robot import joint_path
from trajopt.view.watching.drawing import still_scene

# Points per line of a plan; plans in the timing figures; window for speeds, s; pace below which it warns.
POINTS, RECENT, WINDOW, SLOW = 16, 500, 0.5, 0.9
OWN_WEB = Path(__file__).parent / "web"
SOURCE = PageSource(
    body=OWN_WEB / "drive.html",
    styles=(*REPLAY.styles, OWN_WEB / "drive.css"),
    scripts=(
        *(WEB / name for name in ("meshes.js", "scene.js")),
        *(OWN_WEB / name for name in ("view.js", "target.js", "drive.js")),
    ),
)


def scene_of(stand: Solution, driver: PageController[Any]) -> tuple[list[ViewerCommand], dict[str, Any]]:
    """Commands that draw robot and ground, and the page's facts: sliders, gaits, joints, sizes in m."""
    commands, facts = still_scene(stand)
    model, moves = stand.model, driver.robot.base != "fixed"
    box = np.array(facts["box"])
    return commands, {
        "title": f"drive – {driver.robot.name}",
        "size": facts["size"],
        "box": facts["box"],
        "joints": [joint_path(model, joint) for joint in range(1, model.njoints)],
        # The ground moves with a robot that walks away, in whole periods of its grid.
        "ground": BOLD_EVERY * grid_cell(box, facts["size"]) if moves else 0.0,
        "travels": moves,
        "sliders": [asdict(slider) for slider in driver.sliders],
        "gaits": list(driver.gaits),
        "target": driver.target is not None,
    }


class Painter:
    """Converts the state of a session to what web/view.js and web/drive.js draw."""

    def __init__(self, session: DriveSession) -> None:
        self._session, self._robot = session, session.driver.robot
        self._model, self._data = session.stand.model, session.stand.model.createData()
        self._plan: dict[str, Any] = {}

    def state(self, *, plan: bool = True) -> dict[str, Any]:
        """The current state, JSON-able; with ``plan`` the lines of the plan are computed again."""
        session, driver = self._session, self._session.driver
        driven = session.driven
        record, row = driven.record, max(driven.row - 1, 0)
        q = driven.scene.coordinates.from_mujoco(driven.run.data.qpos[None])[0]
        pin.forwardKinematics(self._model, self._data, q)
        poses = [pin.SE3ToXYZQUAT(self._data.oMi[joint]) for joint in range(1, self._model.njoints)]
        forces = record.force[row, :, :3] / driven.scene.units.weight
        if plan:
            motion = driver.plans.motion
            self._plan = {} if motion is None else self._lines(motion)
        return {
            "joints": [pose.tolist() for pose in poses],
            "forces": np.hstack([record.feet[row], forces]).tolist(),
            "target": None if driver.target is None else driver.target.tolist(),
            **self._plan,
            "values": dict(driver.values),
            "gait": driver.gait,
            "fallen": "" if driven.fall is None else driven.fall.why,
            "figures": figures_of(session, q),
        }

    def _lines(self, motion: HorizonMotion) -> dict[str, Any]:
        """The remaining plan: lines (n, 3), m, of base and contacts, or of the tool; dots at footholds."""
        robot, driver = self._robot, self._session.driver
        times = np.linspace(
            max(self._session.driven.passed, motion.begin), motion.begin + motion.duration, POINTS
        )
        if isinstance(driver, ArmDriver):
            postures = [motion.configuration(float(time)) for time in times]
            tools = [frame_pose(robot, q, driver.tool).translation.tolist() for q in postures]
            return {"lines": [tools], "dots": []}
        samples = [motion.sample(float(time)) for time in times]
        feet = np.array([list(contact_positions(robot, sample.q).values()) for sample in samples])
        lands = np.diff(np.array([sample.active for sample in samples]).astype(int), axis=0) > 0
        return {
            "lines": [[sample.q[:3].tolist() for sample in samples], *feet.swapaxes(0, 1).tolist()],
            "dots": feet[1:][lands].tolist(),
        }


def figures_of(session: DriveSession, q: np.ndarray) -> list[dict[str, Any]]:
    """Figures of the page's panel: times, speeds or the error of the tool at ``q`` (nq,), plans."""
    plans = session.driver.plans
    median, high = np.percentile(1e3 * np.array(plans.report.planning[-RECENT:] or [0.0]), [50, 99])
    relaxed = ", ".join(f"{name} {count}" for name, count in plans.report.relaxed.items() if count)
    pace = session.clock.pace
    missed, made, anew = plans.report.missed, len(plans.report.planning), plans.report.anew
    return [
        _figure("simulated", f"{session.driven.passed:.1f} s"),
        _figure("pace", f"{pace:.2f}, {session.clock.behind:.1f} s behind", pace < SLOW),
        *_motion_figures(session, q),
        _figure("plans", f"{median:.1f} ms median, {high:.1f} at 99 %", high > 1e3 * plans.delay),
        _figure("late plans", f"{missed} of {made}", missed > 0),
        _figure("begun anew", str(anew), anew > 0),
        _figure("relaxed rows", relaxed or "none", bool(relaxed)),
    ]


def _motion_figures(session: DriveSession, q: np.ndarray) -> list[dict[str, Any]]:
    driver = session.driver
    if isinstance(driver, ArmDriver):
        away = frame_pose(driver.robot, q, driver.tool).translation - driver.target
        return [_figure("tool from target", f"{1e3 * np.linalg.norm(away):.0f} mm")]
    if not isinstance(driver, LegsDriver):
        return []
    command = driver.command
    names = (("forward", "m/s"), ("to the left", "m/s"), ("turn", "rad/s"))
    asked = (command.speed, command.lateral, command.turn_rate)
    return [
        _figure(name, f"{now:+.2f} of {wanted:+.2f} {unit}")
        for (name, unit), now, wanted in zip(names, _speeds(session.driven), asked, strict=True)
    ]


def _speeds(driven: DrivenScene) -> tuple[float, float, float]:
    """Mean speed forward and to the left, m/s, and turn rate, rad/s, over the last `WINDOW` s."""
    period = driven.timeline.period
    count = min(driven.row, round(WINDOW / period))
    if count < 2:
        return 0.0, 0.0, 0.0
    qpos, lasts = driven.record.qpos[[driven.row - count, driven.row - 1]], (count - 1) * period
    before, after = driven.scene.coordinates.from_mujoco(qpos)
    first, last = (
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) for x, y, z, w in (before[3:7], after[3:7])
    )
    turned, (dx, dy) = math.remainder(last - first, 2 * math.pi), (after[:2] - before[:2]) / lasts
    cosine, sine = math.cos(first + turned / 2), math.sin(first + turned / 2)
    return cosine * dx + sine * dy, cosine * dy - sine * dx, turned / lasts


def _figure(label: str, value: str, warned: bool = False) -> dict[str, Any]:
    return {"label": label, "value": value, "warned": bool(warned)}
