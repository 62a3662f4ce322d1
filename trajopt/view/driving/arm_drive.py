"""An arm that was driven: what was recorded, and its figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajopt.control.reference import ReferenceTrajectory
from trajopt.mpc.drive_report import PlanFigures, plan_figures
from trajopt.robot.kinematics import frame_pose
from trajopt.simulation.figures import Fall
from trajopt.simulation.record import SimulationRecord
from trajopt.simulation.simulated import simulated_solution
from trajopt.simulation.world import World
from trajopt.solution.solution import Solution
from trajopt.view.driving.drivers import ArmDriver, since

# Distances of links are computed at times so far apart, s.
STRIDE = 0.02


@dataclass(frozen=True, kw_only=True)
class ArmDriveReport(PlanFigures):
    """Figures of an arm's drive in simulated time, and times of this machine.

    tool: the frame that follows. error_mean, error_95, error_max: distance of the tool from the target, which
    moves at a bounded speed, m. nearest: least distance of links from each other and from obstacles, m; None
    without such pairs. beyond: farthest of a joint beyond its limits, rad or m. rate: largest of a joint over
    its limit. targets: where the target was sent, s and m.

    Figures of plans count from the begin also where the first part of the motion was not kept.
    """

    tool: str
    error_mean: float
    error_95: float
    error_max: float
    nearest: float | None
    beyond: float
    rate: float
    targets: tuple[tuple[float, tuple[float, ...]], ...]

    def table(self) -> str:
        """Figures for people, one a line."""
        mean, high, most = (1e3 * error for error in (self.error_mean, self.error_95, self.error_max))
        lines = [
            ("driven", f"{self.simulated:.3f} s"),
            ("tool from target", f"{mean:.1f} mm mean, {high:.1f} at 95 %, {most:.1f} largest"),
            ("nearest bodies", "-" if self.nearest is None else f"{1e3 * self.nearest:.0f} mm"),
            ("joints", f"{self.beyond:.2g} rad beyond limits, rates {100 * self.rate:.0f} % of theirs"),
            *self._lines,
        ]
        text = [f"{name:27} {value}" for name, value in lines]
        end = [f"it failed at {self.fall_time:.3f} s: {self.fall_reason}"] if self.fell else []
        return "\n".join([*text, *end])


@dataclass(frozen=True, kw_only=True)
class ArmDrive:
    """An arm that was driven: report, and everything that was recorded.

    stand: the robot at rest at the start. reference: ticks. target: where it was at ticks (n, 3), m.
    """

    stand: Solution
    reference: ReferenceTrajectory
    world: World
    record: SimulationRecord
    target: np.ndarray
    report: ArmDriveReport

    def as_solution(self) -> Solution:
        """The motion as a solution of the same model; ``statistics.simulated`` is true."""
        return simulated_solution(self.stand, self.reference, self.record, self.world, self.report)


def arm_drive(
    driver: ArmDriver,
    stand: Solution,
    reference: ReferenceTrajectory,
    world: World,
    record: SimulationRecord,
    fall: Fall | None,
) -> ArmDrive:
    """What was recorded, with its report.

    Args:
        driver: what drove, with what it counted; its offset is the begin of the record.
        stand: the robot at rest at the start.
        reference: ticks.
        world: that was simulated.
        record: of the ticks.
        fall: how it ended, if it failed.
    """
    times = driver.offset + reference.t[: len(record.feet)]
    target = np.array([driver.path.at(time)[0] for time in times.tolist()])
    report = _report(driver, world, reference.period, record, fall, target)
    return ArmDrive(
        stand=stand, reference=reference, world=world, record=record, target=target, report=report
    )


def _report(
    driver: ArmDriver,
    world: World,
    period: float,
    record: SimulationRecord,
    fall: Fall | None,
    target: np.ndarray,
) -> ArmDriveReport:
    robot, controller = driver.robot, driver.controller
    qpos, qvel = (rows[: len(target)] for rows in (record.qpos, record.qvel))
    q, v = world.coordinates.from_mujoco(qpos), world.coordinates.rates_from_mujoco(qpos, qvel)
    tool = np.array([frame_pose(robot, each, driver.tool).translation for each in q])
    error = np.linalg.norm(tool - target, axis=1)
    distances = controller.scene.distances(q[:: max(1, round(STRIDE / period))])
    beyond = np.maximum(robot.position_lower - q, q - robot.position_upper)
    return ArmDriveReport(
        **plan_figures(controller, record, period, fall),
        tool=driver.tool,
        error_mean=float(error.mean()),
        error_95=float(np.percentile(error, 95)),
        error_max=float(error.max()),
        nearest=float(distances.min()) if distances.size else None,
        beyond=max(float(beyond.max()), 0.0),
        rate=float((np.abs(v) / robot.velocity_limit).max()),
        targets=tuple(
            (time, tuple(place.tolist())) for time, place in since(driver.path.goals, driver.offset)
        ),
    )
