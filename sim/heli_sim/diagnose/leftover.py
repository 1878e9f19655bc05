"""What remains when nothing of the catalogue explains it: structure that repeats, or chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_sim.diagnose.hypothesis import Hypothesis
from heli_sim.diagnose.pattern import QUANTITIES, bumps, quantity_values, span_of
from heli_sim.diagnose.screening import Scored, Screening
from heli_sim.diagnose.tangent import Tangent
from heli_sim.diagnose.torque import missing_torque
from heli_sim.identify.functions import Floats
from heli_sim.identify.record import AXES

_RIDGE: Final = 1e-3
_CORRELATE_SHARE: Final = 0.3
"""A quantity is named when its pattern gains this share of the best one's."""
_MOST_CORRELATES: Final = 4


@dataclass(frozen=True)
class Leftover:
    """Torque that the final model lacks about one axis.

    Parameters
    ----------
    axis : str
        The axis on which it is plainest.
    size_Nm : float
        Its standard deviation.
    over_error : float
        The same over what the estimate is unsure by.
    memory_s : float
        Time over which its autocorrelation falls to 1/e.
    bursts : float
        Excess kurtosis: 0 for steady chance, large where it comes in bursts, as what belongs to manoeuvres
        does.
    repeats : float
        Share of its variance on a flight not seen that its dependence on states, voltages and time, learned
        on the flights fitted, predicts. Around 0 and below for chance.
    """

    axis: str
    size_Nm: float
    over_error: float
    memory_s: float
    bursts: float
    repeats: float


def leftover(final: Hypothesis, screening: Screening) -> Leftover:
    """Describe the torque that the final model lacks.

    Parameters
    ----------
    final : Hypothesis
        The final model.
    screening : Screening
        Screening around it.

    Returns
    -------
    Leftover
        On the axis where it is largest against its error.
    """
    tangents = screening.ground.tangents
    value = np.concatenate([torque.value_Nm for torque in screening.torques])
    std = np.concatenate([torque.std_Nm for torque in screening.torques])
    # A predicted angle far off on one axis shows there first: the excess of its own errors breaks ties.
    over = value.std(axis=0) / np.maximum(std.mean(axis=0), 1e-12)
    index = int(np.argmax(over))
    repeats = _repeats(final, tangents, [torque.value_Nm[:, index] for torque in screening.torques], index)
    return Leftover(
        AXES[index],
        float(np.sqrt(np.mean(value[:, index] ** 2 + std[:, index] ** 2))),
        float(over[index]),
        _memory_s(screening.torques[0].value_Nm[:, index], tangents[0].path.step_s),
        _kurtosis(value[:, index]),
        repeats,
    )


def _kurtosis(value: Floats) -> float:
    off = value - value.mean()
    return float(np.mean(off**4) / max(float(np.mean(off**2)) ** 2, 1e-30) - 3.0)


def _memory_s(value: Floats, step_s: float) -> float:
    value = value - value.mean()
    size = 1 << int(2 * len(value) - 1).bit_length()
    products = np.fft.irfft(np.abs(np.fft.rfft(value, size)) ** 2, size)[: len(value)]
    below = np.flatnonzero(products < products[0] / np.e)
    return float(below[0] * step_s) if len(below) else float(len(value) * step_s)


def _repeats(final: Hypothesis, tangents: Sequence[Tangent], torque: Sequence[Floats], index: int) -> float:
    """Learn the torque as a sum of curves on the flights fitted, and predict it on the others."""
    if final.held_fit is None:
        return 0.0
    model = final.fit.problem.model
    held = [Tangent(final.held_fit, i) for i in range(len(final.held_fit.problem.records))]
    learned = [quantity_values(model, tangent.path) for tangent in tangents]
    asked = [quantity_values(model, tangent.path) for tangent in held]
    truth = np.concatenate([missing_torque(tangent).value_Nm[:, index] for tangent in held])
    known = np.concatenate(torque)
    rows, others = [], []
    for name in QUANTITIES:
        values = np.concatenate([one[name] for one in learned])
        low, step = span_of(values)
        rows.append(bumps(values, low, step))
        others.append(bumps(np.concatenate([one[name] for one in asked]), low, step))
    left, right = np.hstack(rows), np.hstack(others)
    matrix = left.T @ left + _RIDGE * len(left) * np.eye(left.shape[1])
    guess = right @ np.linalg.solve(matrix, left.T @ known)
    return float(1.0 - np.mean((truth - guess) ** 2) / max(float(np.mean(truth**2)), 1e-30))


def correlates(patterns: Sequence[Scored]) -> list[str]:
    """Name what the missing part depends on.

    Parameters
    ----------
    patterns : sequence of Scored
        Scores of the patterns, best first.

    Returns
    -------
    list of str
        ``CHANNEL on QUANTITY``, strongest first.
    """
    best = patterns[0].answer.gain if patterns else 0.0
    return [
        " on ".join(one.trial.id.split(":")[1:])
        for one in patterns[:_MOST_CORRELATES]
        if one.answer.gain > max(_CORRELATE_SHARE * best, 5.0)
    ]
