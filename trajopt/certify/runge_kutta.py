"""DOP853: Dormand and Prince's explicit Runge-Kutta method of order 8 with error estimates of order 5 and 3.

Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", 2nd edition, section II.5. The
coefficients are those of their code. Steps are chosen as in section II.4 and in `scipy.integrate.DOP853`,
which takes longer to import than everything that a solve needs.
"""

from collections.abc import Callable

import numpy as np

from trajopt import _numeric

Rate = Callable[[float, np.ndarray], np.ndarray]

# fmt: off
_NODES = np.array([
    0.0, 0.05260015195876773, 0.0789002279381516, 0.1183503419072274, 0.2816496580927726,
    0.3333333333333333, 0.25, 0.3076923076923077, 0.6512820512820513, 0.6, 0.8571428571428571, 1.0,
])
_MATRIX = tuple(np.array(row) for row in (
    [0.05260015195876773],
    [0.0197250569845379, 0.0591751709536137],
    [0.02958758547680685, 0.0, 0.08876275643042054],
    [0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792],
    [0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242],
    [0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125],
    [0.03709200011850479, 0.0, 0.0, 0.17038392571223998, 0.10726203044637328, -0.015319437748624402,
     0.008273789163814023],
    [0.6241109587160757, 0.0, 0.0, -3.3608926294469414, -0.868219346841726, 27.59209969944671,
     20.154067550477894, -43.48988418106996],
    [0.47766253643826434, 0.0, 0.0, -2.4881146199716677, -0.590290826836843, 21.230051448181193,
     15.279233632882423, -33.28821096898486, -0.020331201708508627],
    [-0.9371424300859873, 0.0, 0.0, 5.186372428844064, 1.0914373489967295, -8.149787010746927,
     -18.52006565999696, 22.739487099350505, 2.4936055526796523, -3.0467644718982196],
    [2.273310147516538, 0.0, 0.0, -10.53449546673725, -2.0008720582248625, -17.9589318631188,
     27.94888452941996, -2.8589982771350235, -8.87285693353063, 12.360567175794303, 0.6433927460157636],
))
_WEIGHTS = np.array([
    0.054293734116568765, 0.0, 0.0, 0.0, 0.0, 4.450312892752409, 1.8915178993145003, -5.801203960010585,
    0.3111643669578199, -0.1521609496625161, 0.20136540080403034, 0.04471061572777259,
])
_ERROR_5 = np.array([
    0.01312004499419488, 0.0, 0.0, 0.0, 0.0, -1.2251564463762044, -0.4957589496572502, 1.6643771824549864,
    -0.35032884874997366, 0.3341791187130175, 0.08192320648511571, -0.022355307863886294,
])
_ERROR_3 = np.array([
    -0.18980075407240762, 0.0, 0.0, 0.0, 0.0, 4.450312892752409, 1.8915178993145003, -5.801203960010585,
    -0.4226823213237919, -0.1521609496625161, 0.20136540080403034, 0.02265179219836082,
])
# fmt: on

# The same method for compiled dynamics.
METHOD = _numeric.Method(
    _NODES,
    np.array([np.pad(row, (0, len(_NODES) - len(row))) for row in (np.zeros(0), *_MATRIX)]),
    _WEIGHTS,
    _ERROR_5,
    _ERROR_3,
)

# Step control: safety factor, and smallest and largest ratio of successive steps.
_SAFETY, _LEAST_RATIO, _MOST_RATIO = 0.9, 0.2, 10.0
_EXPONENT = 1 / 8


def integrate(
    rate: Rate, state: np.ndarray, *, relative: float, absolute: float, length: float = 1.0
) -> np.ndarray | None:
    """Integrate ``rate(t, state)`` from ``state`` at t = 0 to t = ``length``.

    ``relative`` and ``absolute`` bound the local error of each entry. Returns None if the step size falls
    below rounding, or the state is not finite.
    """
    t, slope = 0.0, rate(0.0, state)
    step = _first_step(rate, state, slope, relative, absolute, length)
    while t < length:
        if not step >= 10 * np.spacing(t):  # also if it is NaN
            return None
        rejected = False
        while True:
            end = min(t + step, length)
            taken = end - t
            following, stages = _step(rate, t, state, slope, taken)
            last = rate(end, following)
            scale = absolute + np.maximum(np.abs(state), np.abs(following)) * relative
            error = _error(stages, taken, scale)
            if error < 1:
                factor = _MOST_RATIO if error == 0 else min(_MOST_RATIO, _SAFETY * error**-_EXPONENT)
                step = taken * (min(1.0, factor) if rejected else factor)
                break
            step = taken * max(_LEAST_RATIO, _SAFETY * error**-_EXPONENT)
            rejected = True
            if not step >= 10 * np.spacing(t):
                return None
        t, state, slope = end, following, last
    return state if np.isfinite(state).all() else None


def _step(
    rate: Rate, t: float, state: np.ndarray, slope: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Take one step; return the state at its end and the slopes of all stages."""
    stages = np.empty((len(_NODES), len(state)))
    stages[0] = slope
    for number, (node, row) in enumerate(zip(_NODES[1:], _MATRIX, strict=True), start=1):
        stages[number] = rate(t + node * step, state + step * (row @ stages[:number]))
    return state + step * (_WEIGHTS @ stages), stages


def _error(stages: np.ndarray, step: float, scale: np.ndarray) -> float:
    """Return the local error over the allowed error, from the estimates of order 5 and 3 combined."""
    fifth, third = _ERROR_5 @ stages / scale, _ERROR_3 @ stages / scale
    large, small = float(fifth @ fifth), float(third @ third)
    if large == 0 and small == 0:
        return 0.0
    return step * large / float(np.sqrt((large + 0.01 * small) * len(scale)))


def _first_step(
    rate: Rate, state: np.ndarray, slope: np.ndarray, relative: float, absolute: float, length: float
) -> float:
    """Return a first step with about the allowed error, estimated from the second derivative."""
    scale = absolute + np.abs(state) * relative
    size, first = _norm(state / scale), _norm(slope / scale)
    trial = 1e-6 if size < 1e-5 or first < 1e-5 else min(0.01 * size / first, length)
    second = _norm((rate(trial, state + trial * slope) - slope) / scale) / trial
    if max(first, second) <= 1e-15:
        guess = max(1e-6, 1e-3 * trial)
    else:
        guess = (0.01 / max(first, second)) ** _EXPONENT
    return min(100 * trial, guess, length)


def _norm(values: np.ndarray) -> float:
    return float(np.linalg.norm(values)) / float(np.sqrt(len(values)))
