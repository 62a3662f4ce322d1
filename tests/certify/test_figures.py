"""Figures of reports: of fields, of records and mappings in them, with limits, as text and as JSON."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from trajopt.certify.figures import FigureReport, MeasuredFigure, compared, figure


@dataclass(frozen=True, kw_only=True)
class Times:
    mean: float
    largest: float = figure("largest", "ms", scale=1e3)


@dataclass(frozen=True, kw_only=True)
class Landing(FigureReport):
    DERIVED: ClassVar[tuple[str, ...]] = ("half",)

    count: int = figure("landings")
    depth: float | None = figure("depth", "m", limit=lambda report: 0.1 * report.count)
    hidden: float = figure("hidden", applies=lambda report: report.count > 9)
    times: Times = figure("time")
    relaxed: Mapping[str, int | None] = figure("relaxed")
    errors: np.ndarray = figure("error", "m")
    notes: tuple[str, ...] = ()

    @property
    def half(self) -> float:
        return self.count / 2


def landing(**changes: object) -> Landing:
    usual = {
        "count": 2,
        "depth": 0.25,
        "hidden": 1.0,
        "times": Times(mean=1e-3, largest=2e-3),
        "relaxed": {"joint_limits": 3, "contacts": None},
        "errors": np.array([0.1, 0.3]),
        "notes": ("soft ground",),
    }
    return Landing(**{**usual, **changes})  # type: ignore[arg-type]


def test_records_and_mappings_give_a_figure_for_each_entry():
    found = {each.text: (each.value, each.unit) for each in landing().figures()}
    assert found == {
        "landings": (2, ""),
        "depth": (0.25, "m"),
        "time, largest": (2.0, "ms"),
        "relaxed, joint limits": (3, ""),
        "error": (0.3, "m"),
    }
    assert "hidden" in [each.text for each in landing(count=10).figures()]
    assert "depth" not in [each.text for each in landing(depth=None).figures()]


def test_a_figure_beyond_its_limit_is_marked_also_if_it_is_not_a_number():
    for depth, beyond in ((0.2, False), (0.25, True), (math.nan, True)):
        (judged,) = (each for each in landing(depth=depth).figures() if each.limit is not None)
        assert judged.limit == 0.2
        assert judged.beyond is beyond


def test_text_and_json_have_the_same_figures():
    lines = landing().table().splitlines()
    assert lines[0].split() == ["value", "unit", "limit"]
    assert lines[2].split() == ["depth", "0.25", "m", "0.2", "beyond"]
    assert lines[-1] == "note: soft ground"
    assert landing().to_dict() == {
        "half": 1.0,
        "count": 2,
        "depth": 0.25,
        "hidden": 1.0,
        "times": {"mean": 1e-3, "largest": 2e-3},
        "relaxed": {"joint_limits": 3, "contacts": None},
        "errors": [0.1, 0.3],
        "notes": ["soft ground"],
    }


def test_figures_with_the_same_texts_are_compared_in_columns():
    first = MeasuredFigure(text="push", value=80.0, unit="N s", natural=2.0, open_ended=True)
    lines = compared(["left"], {"a": [first], "ratio": [MeasuredFigure(text="ratio", value=math.nan)]})
    assert lines[0].split() == ["a", "ratio"]
    assert lines[1].split() == ["left", ">=", "80", "(2.000)", "-"]
