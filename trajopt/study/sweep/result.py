"""The result of one run, as one row of ``runs.csv``."""

from dataclasses import dataclass

from trajopt.study.runner import REFUSED

# Status of a setting whose functions do not compile; others are the solver's, `REFUSED` and `LOST`.
NOT_COMPILED = "not_compiled"


@dataclass(frozen=True, kw_only=True)
class Job:
    """One run to make: a setting's name, the start (0: default guess, k: seed k), and the attempt."""

    setting: str
    start: int
    attempt: int = 0


@dataclass(frozen=True, kw_only=True)
class TimedRun(Job):
    """One solve and its times in s; unknown ones are None.

    Args:
        wall_time, function_time: the solver's; start_time: of the solve that made a warm start.
        stage_two_time, build_time, compile_time: of torques; of graphs and transcription; of compilation.
        iterations, objective: of all solves; the problem's own, even if a variant was solved.
        calibration: time of the load next to the run, s.
        cpu_share: fraction of the time, without compilation, in which the process had its core.
        disturbed: either is out of bounds. detail: why it was refused, lost or not solved.
    """

    status: str
    success: bool = False
    iterations: int | None = None
    wall_time: float | None = None
    start_time: float = 0.0
    stage_two_time: float = 0.0
    function_time: float | None = None
    build_time: float | None = None
    compile_time: float | None = None
    functions_compiled: int | None = None
    variables: int | None = None
    constraints: int | None = None
    objective: float | None = None
    max_violation: float | None = None
    calibration: float | None = None
    cpu_share: float | None = None
    disturbed: bool = False
    detail: str = ""

    @property
    def job(self) -> Job:
        """The job of this result."""
        return Job(setting=self.setting, start=self.start, attempt=self.attempt)

    @property
    def is_final(self) -> bool:
        """Whether repeating it is useless: the setting does not fit, or its functions do not compile."""
        return self.status in (REFUSED, NOT_COMPILED)

    @property
    def time(self) -> float:
        """Time that a user waits for a solve, s; infinite without a solution."""
        if not self.success or self.wall_time is None:
            return float("inf")
        return self.wall_time + self.start_time + self.stage_two_time
