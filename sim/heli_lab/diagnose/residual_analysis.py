"""What remains when nothing of the catalogue explains it: chance, or what depends on things before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_sim.model.parts import AXES

from heli_lab.diagnose.model_comparison import Hypothesis
from heli_lab.diagnose.noise_model import DisturbanceModel, InnovationsFilter
from heli_lab.diagnose.screening import Scored, Screening
from heli_lab.diagnose.whiteness import Dependence, dependences, one_axis
from heli_lab.identify.functions import Floats

_CORRELATE_SHARE: Final = 0.3
"""A quantity is named when its pattern gains this share of the best one's."""
_MOST_CORRELATES: Final = 4


@dataclass(frozen=True)
class ResidualAnalysis:
    """Torque that the final model lacks about one axis.

    Parameters
    ----------
    axis : str
        The axis on which it is plainest.
    sigma_Nm : float
        Its standard deviation.
    over_error : float
        The same over what the estimate is unsure by.
    correlation_time_s : float
        Time over which its autocorrelation falls to 1/e.
    gained : float
        Logarithm of the likelihood ratio of a random torque about this axis alone over none.
    lost : float
        The same of random torques about all axes over one about this axis alone.
    depends : tuple of Dependence
        What foretells more of it than chance would, most first; empty where nothing is missing.
    """

    axis: str
    sigma_Nm: float
    over_error: float
    correlation_time_s: float
    gained: float
    lost: float
    depends: tuple[Dependence, ...]


def residual_analysis(
    final: Hypothesis, screening: Screening, chance: tuple[DisturbanceModel, InnovationsFilter] | None = None
) -> ResidualAnalysis:
    """Describe the torque that the final model lacks.

    Parameters
    ----------
    final : Hypothesis
        The final model.
    screening : Screening
        Screening around it.
    chance : tuple of (DisturbanceModel, Filter), optional
        Random torques in its place; without them nothing is said about what it depends on.

    Returns
    -------
    ResidualAnalysis
        On the axis where it is largest against its error.
    """
    value = np.concatenate([torque.value_Nm for torque in screening.torques])
    std = np.concatenate([torque.std_Nm for torque in screening.torques])
    # A predicted angle far off on one axis shows there first: the excess of its own errors breaks ties.
    over = value.std(axis=0) / np.maximum(std.mean(axis=0), 1e-12)
    if chance is None:
        index = int(np.argmax(over))
        sigma_Nm = float(np.sqrt(np.mean(value[:, index] ** 2 + std[:, index] ** 2)))
        correlation_time_s = _memory_s(
            screening.torques[0].value_Nm[:, index], screening.ground.tangents[0].path.step_s
        )
        return ResidualAnalysis(AXES[index], sigma_Nm, float(over[index]), correlation_time_s, 0.0, 0.0, ())
    disturbance, innovations_filter = chance
    axis, lost, gained = one_axis(innovations_filter, disturbance)
    index = AXES.index(axis)
    depends = tuple(one for one in dependences(innovations_filter, disturbance) if one.gain > one.penalty)[
        :_MOST_CORRELATES
    ]
    return ResidualAnalysis(
        axis,
        float(disturbance.sigma_Nm[index]),
        float(over[index]),
        disturbance.correlation_time_s,
        gained,
        lost,
        depends,
    )


def _memory_s(value: Floats, step_s: float) -> float:
    value = value - value.mean()
    size = 1 << int(2 * len(value) - 1).bit_length()
    products = np.fft.irfft(np.abs(np.fft.rfft(value, size)) ** 2, size)[: len(value)]
    below = np.flatnonzero(products < products[0] / np.e)
    return float(below[0] * step_s) if len(below) else float(len(value) * step_s)


def correlates(splines: Sequence[Scored]) -> list[str]:
    """Name what the missing part depends on.

    Parameters
    ----------
    splines : sequence of Scored
        Scores of the patterns, best first.

    Returns
    -------
    list of str
        ``CHANNEL on QUANTITY``, strongest first.
    """
    best = splines[0].answer.gain if splines else 0.0
    return [
        " on ".join(one.candidate.id.split(":")[1:])
        for one in splines[:_MOST_CORRELATES]
        if one.answer.gain > max(_CORRELATE_SHARE * best, 5.0)
    ]
