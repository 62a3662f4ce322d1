"""Figures of docs/mathematics.md, from the library itself.

uv run python -m scripts.figures -o docs/figures
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import trajopt
from trajopt.motion import Solution
from trajopt.transcription import transcribe
from trajopt.transcription.compilation import compile_points, entry_key
from trajopt.transcription.nlp import assemble

# Text stays text, and the same figure is the same file.
STYLE = {"svg.fonttype": "none", "svg.hashsalt": "trajopt"}
STYLE |= {"axes.spines.top": False, "axes.spines.right": False}
# Among the actuated joints: the knee of the first leg.
JOINT = 2
# Intervals of the coarse jump, so that single ones can be seen.
COARSE = 12
ORDERS = {
    "semi-implicit-euler": (64, 128, 256, 512),
    "legendre:1": (8, 16, 32, 64),
    "radau:2": (4, 8, 16, 32),
    "legendre:2": (4, 8, 16, 32),
    "legendre:3": (2, 4, 8, 16),
}


def interval() -> Figure:
    """A joint's acceleration, velocity and position over a coarse jump, with nodes and points."""
    motion = trajopt.solve(trajopt.load("solo12-jump"), transcription="legendre:2", intervals=COARSE)
    first_v, first_q = (array.shape[1] - motion.tau.shape[1] for array in (motion.v, motion.q))
    figure, rows = plt.subplots(3, 1, figsize=(8, 5.5), sharex=True, layout="constrained")
    values = (motion.a[:, first_v + JOINT], motion.v[:, first_v + JOINT], motion.q[:, first_q + JOINT])
    labels = ("acceleration, rad/s²", "velocity, rad/s", "position, rad")
    for axes, value, label in zip(rows, values, labels, strict=True):
        _curve(axes, motion, value)
        axes.set_ylabel(label)
        for start in motion.interval_t[:, 0]:
            axes.axvline(start, color="0.85", linewidth=0.8, zorder=0)
    rows[-1].set_xlabel("time, s (grey lines: nodes)")
    return figure


def _curve(axes: plt.Axes, motion: Solution, value: np.ndarray) -> None:
    """Polynomials of a quantity, interval by interval, through its values at nodes and points."""
    for number, (start, end) in enumerate(motion.interval_t):
        own = motion.interval == number
        if end <= start or np.count_nonzero(own) < 2:
            continue
        fine = np.linspace(start, end, 30)
        degree = np.count_nonzero(own) - 1
        middle = (motion.t[own] - start) / (end - start)
        polynomial = np.polynomial.Polynomial.fit(middle, value[own], degree)
        axes.plot(fine, polynomial((fine - start) / (end - start)), color="C0", linewidth=1.5)
    points = motion.collocation
    axes.plot(motion.t[points], value[points], "o", color="C1", markersize=4)


def orders() -> Figure:
    """Open-loop error over the number of intervals."""
    problem = trajopt.load("ur5-reach")
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    for scheme, counts in ORDERS.items():
        motions = [trajopt.solve(problem, transcription=scheme, intervals=count) for count in counts]
        errors = [trajopt.check(motion).open_loop_joints for motion in motions]
        axes.loglog(counts, errors, "o-", label=scheme)
    axes.set_xlabel("intervals")
    axes.set_ylabel("open-loop error, rad")
    axes.legend(frameon=False)
    return figure


def stages() -> Figure:
    """Non-zeros of the Jacobian and the Hessian."""
    transcribed = transcribe(trajopt.load("solo12-jump"), "legendre:2", COARSE)
    compiled, _ = compile_points(transcribed.points.values(), "exact")
    nlp = assemble(transcribed, {key: compiled[entry_key(p)] for key, p in transcribed.points.items()})
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 4.2), layout="constrained")
    rows = np.concatenate([nlp.hessian_row, nlp.hessian_column])
    columns = np.concatenate([nlp.hessian_column, nlp.hessian_row])
    for axes, title, row, column in (
        (left, "Jacobian", nlp.row, nlp.column),
        (right, "Hessian", rows, columns),
    ):
        axes.plot(column, row, ",", color="C0", rasterized=True)
        axes.invert_yaxis()
        axes.set_title(title)
        axes.set_xlabel("variable")
    left.set_ylabel("constraint")
    right.set_ylabel("variable")
    return figure


FIGURES = (interval, orders, stages)


def main() -> None:
    """Write all figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/figures"), metavar="DIR")
    target = parser.parse_args().output
    target.mkdir(parents=True, exist_ok=True)
    plt.rcParams.update(STYLE)
    for draw in FIGURES:
        figure = draw()
        figure.savefig(target / f"{draw.__name__}.svg", dpi=150, metadata={"Date": None})
        plt.close(figure)


if __name__ == "__main__":
    main()
