"""Tasks of all pairs: one for each solve and each simulation, with results recorded as they arrive."""

from collections import Counter, deque
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from trajopt.study.cluster import Cluster
from trajopt.study.runner import DONE, NOT_RUN, REFUSED, TIME_LIMIT, Ended, NotRunError, TimedCall, run_tasks
from trajopt.study.suite.cases import Case
from trajopt.study.suite.failure import ERROR, TIME
from trajopt.study.suite.outcome import Attempt, Ledger, Outcome
from trajopt.study.suite.physics import Physics
from trajopt.study.suite.records import SuiteRecords
from trajopt.study.suite.run import simulate_plan, solve_start
from trajopt.study.suite.settings import SuiteSettings

# After this many lost processes, a pair's remaining starts count as failed without being run.
MOST_LOST = 3
# Tasks of a pair other than the seeds of its perturbed starts.
OWN, PHYSICS = "own", "physics"


def run_all(
    cases: Sequence[Case],
    settings: SuiteSettings,
    *,
    cluster: Cluster,
    records: SuiteRecords,
    check: Callable[[], object] = bool,
    show: Callable[[Collection[str]], object] = len,
) -> Generator[Outcome, None, None]:
    """Yield the outcome of each pair as it ends.

    records: recorded parts of interrupted pairs are not run again; results are added as they arrive. check,
    show: see `run_tasks`.
    """
    known = records.unfinished()
    pairs = {case: _PairRun(case, settings, records, known.get(case.name, ())) for case in cases}
    yield from (pair.outcome() for pair in pairs.values() if not pair.left)
    waiting = deque((case, part) for case in _interleaved(cases) for part in pairs[case].first())

    def make(key: tuple[Case, str | int]) -> TimedCall:
        return pairs[key[0]].task(key[1])

    def check_both() -> None:
        check()
        cluster.check()

    tasks = run_tasks(waiting, make, cluster.executor, window=cluster.window, check=check_both, show=show)
    for ended in tasks:
        case, part = ended.key
        waiting.extendleft((case, other) for other in reversed(pairs[case].end(part, ended)))
        if not pairs[case].left:
            yield pairs[case].outcome()


def _interleaved(cases: Sequence[Case]) -> list[Case]:
    """The cases in turns of robots: two on one robot at a time would compile the same functions."""
    turns: Counter[str] = Counter()

    def turn(case: Case) -> int:
        turns[case.robot] += 1
        return turns[case.robot]

    return sorted(cases, key=turn)


class _PairRun:
    """One pair: its results so far, and the parts ``left`` to run: `OWN`, `PHYSICS`, seeds of starts."""

    def __init__(
        self, case: Case, settings: SuiteSettings, records: SuiteRecords, known: Iterable[Mapping[str, Any]]
    ) -> None:
        self._case, self._settings, self._records = case, settings, records
        self._ledger = Ledger(case)
        for event in known:
            self._ledger.add(event)
        parts = [OWN, PHYSICS] if settings.simulate else [OWN]
        solved = all(part in self._ledger.parts for part in parts)
        seeds = [seed for seed in settings.seeds if seed not in self._ledger.starts]
        self.left: list[str | int] = [*([] if solved else parts), *seeds]
        self._plan: bytes | None = None
        self._lost, self._reason, self._seconds = 0, "", 0.0

    def first(self) -> list[str | int]:
        """Parts to run first: the default guess, or all that are left if its result is known."""
        return [OWN] if OWN in self.left else self.left

    def task(self, part: str | int) -> TimedCall:
        """The task of a part. Raises `NotRunError` for one that is not started because of others."""
        case, settings = self._case, self._settings
        if self._reason:
            raise NotRunError(f"not run: {self._reason}")
        if part == PHYSICS:
            if self._plan is None:
                raise NotRunError("no motion to simulate")
            args = (self._plan, settings.controller)
            name = f"{case.name} simulating"
            return TimedCall(name=name, limit=settings.longest, function=simulate_plan, args=args)
        seed = None if part == OWN else part
        name = case.name if seed is None else f"{case.name} start {seed}"
        return TimedCall(name=name, limit=settings.longest, function=solve_start, args=(case, settings, seed))

    def end(self, part: str | int, ended: Ended[Any]) -> list[str | int]:
        """Take the outcome of a part; returns the parts that can run now."""
        self.left.remove(part)
        if ended.kind != DONE:
            self._fail(part, ended)
        else:
            result, content, seconds = ended.value
            self._seconds += seconds
            kind = part if isinstance(part, str) else "start"
            event = {"event": kind, "values": asdict(result)}
            self._records.told(self._case.name, event)
            self._ledger.add(event)
            if kind != "start":
                self._records.save(self._case, content, simulated=kind == PHYSICS)
            if kind == OWN:
                self._plan = content if result.legged else None
        return list(self.left) if part == OWN else []

    def _fail(self, part: str | int, ended: Ended[Any]) -> None:
        text = f"bad input: {ended.detail}" if ended.kind == REFUSED else ended.detail
        mode = TIME if ended.kind == TIME_LIMIT else ERROR
        self._lost += ended.kind != NOT_RUN
        if part == PHYSICS:
            self._ledger.parts[PHYSICS] = Physics(detail="" if ended.kind == NOT_RUN else f"lost: {text}")
        elif part == OWN:
            self._ledger.parts |= {"error": text, "error_mode": mode}
        else:
            status = "not_run" if ended.kind == NOT_RUN else "lost"
            self._ledger.starts[int(part)] = Attempt(seed=int(part), mode=mode, status=status, detail=text)
        if ended.kind != NOT_RUN and (ended.kind == REFUSED or self._lost == MOST_LOST):
            self._reason = text

    def outcome(self) -> Outcome:
        return self._ledger.outcome(self._seconds)
