"""The largest push that a plan survives, for each direction and each controller.

A push is a horizontal impulse at the centre of mass of the base: a constant force for `DURATION` natural
times sqrt(l / g), with the robot's reach l. It is survived if the robot does not fall (`figures.FallTest`)
within `AFTER` natural times from its start, or by the end of a motion that ends earlier. The natural unit of
impulses is weight * sqrt(l / g): the momentum of the robot at the speed sqrt(g l).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, get_args

import numpy as np
from typing_extensions import override

from trajopt.arguments import NonNegative, Positive, PositiveCount, checked
from trajopt.certify.figures import FigureReport, MeasuredFigure, compared
from trajopt.control.reference import ReferenceTrajectory, reference_of
from trajopt.errors import InputError
from trajopt.motion.input import SolutionOrFile, require_motion, solution_of
from trajopt.motion.solution import Solution
from trajopt.robot.mujoco_package import muted_mujoco
from trajopt.simulation.events import LEAST_LEVEL
from trajopt.simulation.figures import FallTest
from trajopt.simulation.record import SimulationRecord
from trajopt.simulation.scene import Scene, build_scene
from trajopt.simulation.settings import Controller, Impulse, SimulationSettings
from trajopt.simulation.simulate import plan_run
from trajopt.simulation.site import Site

# Duration of a push, and of the simulation from its start, in natural times: within six of them, the error of
# an inverted pendulum grows four-hundredfold.
DURATION, AFTER = 0.1, 6.0
# Impulses in natural units: the first one tried, the largest, and the least that is distinguished from none.
FIRST, MOST, LEAST = 0.05, 2.0, 0.003
# Default number of directions around the robot, and of those in a plane.
DIRECTIONS, IN_A_PLANE = 8, 2
# Natural times between two tests for a fall.
STRETCH = 0.25
COMPARED: tuple[Controller, ...] = ("joints", "whole-body")
# Names of directions, by angle in degrees.
NAMES = {0.0: "forward", 90.0: "left", 180.0: "backward", 270.0: "right"}


@dataclass(frozen=True, kw_only=True)
class PushReport(FigureReport):
    """Largest impulses that a plan survives.

    Args:
        time: start of the push, s from the start of the plan.
        duration: of the push, s.
        after: time simulated from the start of the push, s.
        cycles: of a periodic plan.
        unit: weight * sqrt(l / g), N s.
        most: largest impulse that was tried, N s; the limit may be larger where the result equals it.
        directions: (n,) degrees counter-clockwise from the base's forward axis.
        impulses: (n,) N s by controller; zero where even the smallest push, or none, makes it fall.
        notes: further remarks.
    """

    DERIVED: ClassVar[tuple[str, ...]] = ("natural", "ratios")

    problem: str
    robot: str
    time: float
    duration: float
    after: float
    cycles: int
    unit: float
    most: float
    directions: tuple[float, ...]
    impulses: dict[Controller, tuple[float, ...]]
    notes: tuple[str, ...]

    @property
    def ratios(self) -> tuple[float, ...]:
        """Impulses (n,) of the whole body over those of the joints; empty unless both were measured."""
        pairs = zip(*(self.impulses.get(name, ()) for name in COMPARED), strict=False)
        return tuple(whole / joints if joints else math.nan for joints, whole in pairs)

    @property
    def natural(self) -> dict[Controller, list[float]]:
        """Impulses in natural units."""
        return {name: [size / self.unit for size in sizes] for name, sizes in self.impulses.items()}

    @property
    def columns(self) -> dict[str, list[MeasuredFigure]]:
        """Figures by controller, one for each direction, and their ratios."""
        columns: dict[str, list[MeasuredFigure]] = {
            name: [
                MeasuredFigure(
                    text=f"{name}, {angle:g} degrees",
                    value=size,
                    unit="N s",
                    natural=size / self.unit,
                    open_ended=size >= self.most,
                )
                for angle, size in zip(self.directions, sizes, strict=True)
            ]
            for name, sizes in self.impulses.items()
        }
        ratios = [MeasuredFigure(text="ratio", value=ratio) for ratio in self.ratios]
        return {**columns, "ratio": ratios} if ratios else columns

    @override
    def figures(self) -> list[MeasuredFigure]:
        return [each for column in self.columns.values() for each in column]

    @override
    def table(self) -> str:
        """One line per direction: impulses in N s and in natural units, and their ratio."""
        head = (
            f"push at {self.time:.3f} s for {1e3 * self.duration:.0f} ms, {self.after:.2f} s simulated from "
            f"it; largest impulse survived, N s (over weight * sqrt(l / g) = {self.unit:.3g} N s)"
        )
        rows = [f"{angle:g} {NAMES.get(angle, '')}" for angle in self.directions]
        return "\n".join([head, *compared(rows, self.columns), *(f"note: {note}" for note in self.notes)])


@checked
def largest_pushes(
    solution: SolutionOrFile,
    *,
    controllers: Sequence[Controller] | None = None,
    directions: PositiveCount | None = None,
    time: NonNegative | None = None,
    cycles: PositiveCount | None = None,
    accuracy: Positive = 0.05,
) -> PushReport:
    """Measure the largest push that a plan survives in MuJoCo, for each direction and controller.

    Impulses are doubled (or halved) from `FIRST` until one is survived and the next is not; then the interval
    is bisected. All impulses that were tried below the result were survived.

    Args:
        solution: the plan, or the path of its file.
        controllers: of "joints", "gains" and "whole-body". None: all, without "gains" if the plan has none.
        directions: number of directions, evenly spaced from the front, counter-clockwise. None: eight, or two
            in a plane, front and back, where no other number is allowed.
        time: of the push, s from the start of the plan. None: the middle of a periodic plan's cycles; the end
            of a plan that ends at rest, where the robot stands; otherwise the middle of the plan.
        cycles: of a periodic plan. None: enough for `AFTER` natural times after the push.
        accuracy: relative accuracy of the impulses.

    Raises:
        InputError: for a robot on a fixed base, a time outside the motion or at which the base's forward axis
            is vertical, other than two directions in a plane, or a plan that cannot be simulated.
    """
    plan = require_motion(solution_of(solution))
    every = [name for name in get_args(Controller) if name != "gains" or plan.gain is not None]
    kind, wanted = plan.base, tuple(dict.fromkeys(every if controllers is None else controllers))
    if kind == "fixed":
        raise InputError("a push on the base, which is fixed", "allowed: robots with a moving base")
    if not wanted:
        raise InputError("controllers of largest_pushes is empty", f"allowed: {', '.join(every)}")
    if kind == "planar" and directions not in (None, IN_A_PLANE):
        raise InputError(
            f"directions of largest_pushes is {directions}, of a robot in a plane", f"allowed: {IN_A_PLANE}"
        )
    count = directions or (IN_A_PLANE if kind == "planar" else DIRECTIONS)
    angles = tuple(360.0 * number / count for number in range(count))
    impulses: dict[Controller, tuple[float, ...]] = {}
    notes: list[str] = []
    with muted_mujoco():
        trials = PushTrials.of(plan, time, cycles)
        for controller in wanted:
            survives = trials.with_controller(controller)
            if not survives(0.0, 0.0):
                notes.append(f"it falls without a push with the controller {controller}")
                impulses[controller] = (0.0,) * count
                continue
            sizes = [largest_survived(partial(survives, angle), accuracy) for angle in angles]
            impulses[controller] = tuple(size * trials.unit for size in sizes)
    return PushReport(
        problem=str(plan.description.problem),
        robot=str(plan.description.robot),
        time=trials.time,
        duration=trials.duration,
        after=(trials.end - trials.begin) * trials.reference.period,
        cycles=trials.cycles,
        unit=trials.unit,
        most=MOST * trials.unit,
        directions=angles,
        impulses=impulses,
        notes=tuple(notes),
    )


def largest_survived(survives: Callable[[float], bool], accuracy: float) -> float:
    """Largest impulse that is survived, natural units: 0 below `LEAST`, at most `MOST`."""
    low, high = 0.0, math.inf
    size = FIRST
    while size < high and low < MOST:  # upwards until one is too large
        low, high = (size, high) if survives(size) else (low, size)
        size = min(2 * size, MOST)
    while not low and high > LEAST:  # downwards until one is survived
        low, high = (high / 2, high) if survives(high / 2) else (0.0, high / 2)
    while low and high < math.inf and high > (1 + accuracy) * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if survives(middle) else (low, middle)
    return low


@dataclass(frozen=True, kw_only=True)
class PushTrials:
    """Simulations of one plan that differ only in their push; what they share is built once.

    begin, end: period of the push, and one past the last period that is simulated.
    """

    reference: ReferenceTrajectory
    scene: Scene
    cycles: int
    begin: int
    end: int

    @classmethod
    def of(cls, plan: Solution, time: float | None, cycles: int | None) -> PushTrials:
        """Trials with a push at ``time`` s, see `largest_pushes`. Raises `InputError`."""
        settings = SimulationSettings()
        scene = build_scene(Site.of_plan(plan), settings)
        follows = AFTER * scene.units.time
        described = plan.description.periodicity
        if cycles is None:
            once = float(plan.interval_t[-1, 1] - plan.interval_t[0, 0])
            once *= 2 if described and described.mirror else 1
            needed = 2 * follows if time is None else time + follows
            cycles = math.ceil(needed / once) if described else 1
        reference = reference_of(plan, settings.control_rate, cycles, hold=AFTER)
        if time is None:
            time = reference.period * reference.planned * (1.0 if reference.held else 0.5)
        last = reference.planned - (not reference.held)
        begin = round(time / reference.period)
        if not 0 <= begin <= last:
            raise InputError(
                f"a push at {time:g} s is outside of the motion",
                f"allowed: 0 to {last * reference.period:g} s",
            )
        end = min(len(reference.t), begin + math.ceil(follows / reference.period))
        return cls(reference=reference, scene=scene, cycles=cycles, begin=begin, end=end)

    @property
    def unit(self) -> float:
        """Natural unit of impulses, N s."""
        return self.scene.units.weight * self.scene.units.time

    @property
    def time(self) -> float:
        """Time of the push, s from the start of the plan."""
        return self.begin * self.reference.period

    @property
    def duration(self) -> float:
        """Duration of the push, s: whole periods of the controller, one or more."""
        period = self.reference.period
        return period * max(1, round(DURATION * self.scene.units.time / period))

    def with_controller(self, controller: Controller) -> Callable[[float, float], bool]:
        """Simulate up to the push; returns a test of survival by angle (degrees) and size (natural units).

        Raises `InputError` if the base's forward axis is vertical then.
        """
        settings = SimulationSettings(controller=controller, cycles=self.cycles)
        run = plan_run(self.scene, self.reference, settings)
        record = run.start()
        standing = run.advance(record, 0, self.begin) == self.begin
        if standing and float(np.linalg.norm(run.events.forward(run.data))) < LEAST_LEVEL:
            raise InputError(
                f"at {self.time:g} s the base's forward axis points up or down", "allowed: another time"
            )
        standing = standing and not self._falls(record, 0, self.begin)
        stretch = max(1, round(STRETCH * self.scene.units.time / self.reference.period))

        def survives(angle: float, size: float) -> bool:
            if not standing:
                return False
            pushed = run.branch()
            push = Impulse(
                direction=math.radians(angle),
                size=size * self.unit,
                time=self.time,
                duration=self.duration,
            )
            pushed.events.impulses = (push,)
            for first in range(self.begin, self.end, stretch):
                last = min(first + stretch, self.end)
                if pushed.advance(record, first, last) < last or self._falls(record, first, last):
                    return False
            return True

        return survives

    def _falls(self, record: SimulationRecord, first: int, last: int) -> bool:
        """Whether the robot falls in the periods from ``first`` to before ``last``."""
        rows = slice(first, last)
        return FallTest(self.scene).first(record, self.reference, rows, self.reference.q[rows]) is not None
