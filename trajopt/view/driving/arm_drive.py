"""The recorded drive of an arm, and its report."""

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

# Interval at which distances between links are computed, s.
STRIDE = 0.02


@dataclass(frozen=True, kw_only=True)
class ArmDriveReport(PlanFigures):
    """Figures of an arm's drive; those of plans include the part of the motion that was not kept.

    Args:
        tool: frame that follows the target.
        error_mean, error_95, error_max: distance of the tool from the moving target, m.
        nearest: least distance between links and to obstacles, m; None without such pairs.
        beyond: largest violation of a joint's position limits, rad or m.
        rate: largest ratio of a joint's velocity to its limit.
        targets: times, s, and positions, m, to which the target was sent.
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
        """Figures as text, one per line."""
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
    """The recorded drive of an arm, and its report.

    ``stand`` is the robot at rest at the start, ``reference`` has the ticks, ``target`` (n, 3) m is the
    target's position at them.
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
    """Return the recorded drive with its report.

    Args:
        driver: after the drive, with its figures; its ``offset`` is the time at which the record begins.
        stand: the robot at rest at the start.
        reference: with the ticks.
        world: that was simulated.
        record: samples at the ticks.
        fall: how the drive ended, if it failed.
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
