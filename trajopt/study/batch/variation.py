"""Parameter values that vary over a batch: grids, random samples, and their combinations."""

import itertools
import math
import re
import sys
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from trajopt.arguments import Count, checked
from trajopt.errors import InputError, not_among
from trajopt.problem.catalogue import families
from trajopt.problem.family import Family, Parameter, choose

# Most cases of one batch; larger ones belong in several folders.
MOST_CASES = 10_000_000
# Most draws for a value within a parameter's range.
MOST_DRAWS = 1000
LARGEST = sys.float_info.max
GRID_FORM = "allowed: NAME=FIRST:LAST:COUNT or NAME=A,B,..."
SAMPLE_FORM = "allowed: NAME=DISTRIBUTION(A,B)"

Draw = Callable[[np.random.Generator, Sequence[float]], float]
# A parameter, and the values that it takes.
Grid = tuple[str, tuple[float | str, ...]]


def _loguniform(random: np.random.Generator, given: Sequence[float]) -> float:
    return math.exp(random.uniform(math.log(given[0]), math.log(given[1])))


# Distribution -> names of its arguments, and a draw.
DISTRIBUTIONS: dict[str, tuple[tuple[str, str], Draw]] = {
    "uniform": (("low", "high"), lambda random, given: random.uniform(given[0], given[1])),
    "loguniform": (("low", "high"), _loguniform),
    "normal": (("mean", "deviation"), lambda random, given: random.normal(given[0], given[1])),
}


@checked
@dataclass(frozen=True, kw_only=True)
class BatchCase:
    """One case: a problem by name and values of its parameters, numbers or words."""

    problem: str
    values: Mapping[str, float | str]

    @property
    def name(self) -> str:
        """The problem and its values in one line."""
        return " ".join([self.problem, *(f"{name}={_shown(value)}" for name, value in self.values.items())])


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """A parameter drawn from one of `DISTRIBUTIONS` with these arguments."""

    parameter: Parameter
    kind: str
    given: tuple[float, ...]

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.parameter.name

    def draw(self, random: np.random.Generator) -> float:
        """Draw a value within the parameter's range; raises `InputError` if `MOST_DRAWS` draws give none."""
        lower, upper = self.parameter.lower, self.parameter.upper
        for _ in range(MOST_DRAWS):
            value = float(DISTRIBUTIONS[self.kind][1](random, self.given))
            if lower <= value <= upper:
                return value
        text = f"{self.kind}({', '.join(f'{value:g}' for value in self.given)})"
        raise InputError(
            f"`sample` {self.name}={text} gives no value in {MOST_DRAWS} draws that is allowed",
            f"allowed: {lower:g} to {upper:g} {self.parameter.unit}".rstrip(),
        )


@checked
def batch_cases(
    problem: str,
    *,
    values: Mapping[str, str] | None = None,
    robots: Sequence[str] = (),
    vary: Sequence[str] = (),
    sample: Sequence[str] = (),
    count: Count = 0,
    seed: Count = 0,
) -> list[BatchCase]:
    """Every combination of robots and grids, each with ``count`` samples if parameters are sampled.

    A sample's values depend only on ``seed``, the parameter's name and the sample's number: they are the same
    for all robots and grid points, and do not change when others are added.

    Args:
        problem: a family of the catalogue.
        values: parameters that hold for all cases, as text.
        robots: names, for families that take one.
        vary: grids as text, ``speed=0.2:1.2:50`` (first, last, count) or ``speed=0.2,0.5``.
        sample: distributions as text, ``distance=uniform(0,0.6)``; also loguniform(low,high) and
            normal(mean,deviation); draws outside the parameter's range are repeated.
        count: number of samples.
        seed: of the samples.

    Raises:
        InputError: for names, values or forms that are not allowed.
    """
    family = choose(families(), problem)
    fixed = {name: family.parameter(name).parse(text) for name, text in (values or {}).items()}
    grids = [_grid(family, text) for text in vary]
    if robots:
        words = ",".join(robots)
        grids.insert(0, _listed(family, "robot", words, f"`robots` {words}"))
    drawn = [_distribution(family, text) for text in sample]
    names = [name for name, _ in grids]
    for name, times in Counter([*fixed, *names, *(one.name for one in drawn)]).items():
        if times > 1:
            raise InputError(f"parameter '{name}' is given twice", "allowed: once, fixed, varied or sampled")
    if bool(drawn) != (count > 0):
        raise InputError(
            f"`count` is {count} with {len(drawn)} parameters to sample",
            "allowed: `sample` and `count` together",
        )
    total = math.prod(len(values) for _, values in grids) * (count or 1)
    if total > MOST_CASES:
        raise InputError(f"the batch has {total} cases", f"allowed: up to {MOST_CASES}")
    samples = list(_samples(drawn, count, seed)) if drawn else [{}]
    return [
        BatchCase(problem=problem, values={**fixed, **dict(zip(names, point, strict=True)), **drawn_values})
        for point in itertools.product(*(values for _, values in grids))
        for drawn_values in samples
    ]


def checked_cases(cases: Iterable[BatchCase]) -> list[BatchCase]:
    """Cases with parsed values; raises `InputError` for an unknown problem, parameter or value."""
    known, parsed = families(), []
    for case in cases:
        family = choose(known, case.problem)
        values = {name: family.parameter(name).parse(value) for name, value in case.values.items()}
        parsed.append(BatchCase(problem=case.problem, values=values))
    if not parsed:
        raise InputError("a batch has no case", "allowed: one or more")
    return parsed


def _samples(drawn: Sequence[Distribution], count: int, seed: int) -> Iterator[dict[str, float]]:
    streams = [
        np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(one.name.encode())])) for one in drawn
    ]
    for _ in range(count):
        yield {one.name: one.draw(random) for one, random in zip(drawn, streams, strict=True)}


def _grid(family: Family, text: str) -> Grid:
    where = f"`vary` '{text}'"
    name, _, rest = (part.strip() for part in text.partition("="))
    parts = rest.split(":")
    if name and rest and len(parts) == 1:
        return _listed(family, name, rest, where)
    counted = len(parts) == 3 and re.fullmatch(r"\s*[0-9]{1,9}\s*", parts[2])
    if not (name and counted and 1 <= int(parts[2]) <= MOST_CASES):
        raise InputError(f"{where} has the wrong form", GRID_FORM)
    _require_number(family, name, where, "allowed: NAME=A,B,...")
    first, last = (float(family.parameter(name).parse(part)) for part in parts[:2])
    spaced = np.linspace(first, last, int(parts[2])).tolist()
    if len(spaced) == 1 and first != last:
        raise InputError(f"{where} has one value, and two ends", "allowed: COUNT of two or more")
    if len(set(spaced)) < len(spaced):
        raise InputError(f"{where} has a value twice", "allowed: FIRST and LAST apart")
    return name, tuple(spaced)


def _listed(family: Family, name: str, words: str, where: str) -> Grid:
    values = tuple(family.parameter(name).parse(word.strip()) for word in words.split(","))
    if len(set(values)) < len(values):
        raise InputError(f"{where} has a value twice", "allowed: different values")
    return name, values


def _distribution(family: Family, text: str) -> Distribution:
    where = f"`sample` '{text}'"
    match = re.fullmatch(r"\s*(\w+)\s*=\s*(\w+)\s*\(([^()]*)\)\s*", text)
    if not match:
        raise InputError(f"{where} has the wrong form", SAMPLE_FORM)
    name, kind, rest = match.groups()
    if kind not in DISTRIBUTIONS:
        raise not_among(DISTRIBUTIONS, kind, f"{where} has no distribution '{kind}'")
    parameter = _require_number(family, name, where, "allowed: a parameter that is a number")
    wanted = DISTRIBUTIONS[kind][0]
    # A mean or deviation may be outside the parameter's range; draws may not.
    free = replace(parameter, lower=-LARGEST, upper=LARGEST)
    given: tuple[float, ...] = ()
    with suppress(InputError):
        given = tuple(free.parse(word) for word in rest.split(","))
    if len(given) != len(wanted):
        raise InputError(f"{where} has the wrong form", f"allowed: {kind}({','.join(wanted)})")
    if kind == "normal" and given[1] <= 0:
        raise InputError(f"the deviation of {where} is {given[1]:g}", "allowed: > 0")
    if kind != "normal":
        low, high = (float(parameter.parse(value)) for value in given)
        if not low < high or (kind == "loguniform" and low <= 0):
            least = "0 < low < high" if kind == "loguniform" else "low < high"
            raise InputError(f"the range of {where} is empty", f"allowed: {least}")
    return Distribution(parameter=parameter, kind=kind, given=given)


def _require_number(family: Family, name: str, where: str, allowed: str) -> Parameter:
    parameter = family.parameter(name)
    if not isinstance(parameter, Parameter):
        raise InputError(f"{where}: parameter {name} is no number", allowed)
    return parameter


def _shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"
