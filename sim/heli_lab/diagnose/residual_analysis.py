"""Describes what the final model leaves: a disturbance, or torques that depend on states and inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_sim.model.parts import AXES

from heli_lab.diagnose.noise_model import DisturbanceFit
from heli_lab.diagnose.screening import Scored, Screening
from heli_lab.diagnose.thresholds import CORRELATE_MIN, CORRELATE_SHARE
from heli_lab.diagnose.whiteness import Dependence, best_single_axis, score_dependences
from heli_lab.identify.functions import Floats

_MAX_CORRELATES: Final = 4
"""Length of a list for people."""


@dataclass(frozen=True)
class ResidualAnalysis:
    """Torque that the final model lacks about one axis.

    Parameters
    ----------
    axis : str
        The axis on which it is most significant.
    sigma_Nm : float
        Its standard deviation.
    sigma_over_std : float
        Standard deviation of its estimate over the estimate's standard error.
    correlation_time_s : float
        Time over which its autocorrelation falls to 1/e.
    gain_over_none : float
        Log-likelihood ratio of a disturbance about this axis alone over none, nats.
    loss_to_all_axes : float
        Log-likelihood ratio of disturbances about all axes over one about this axis alone, nats.
    dependences : tuple of Dependence
        What predicts the innovations significantly, strongest first; empty where they are white.
    """

    axis: str
    sigma_Nm: float
    sigma_over_std: float
    correlation_time_s: float
    gain_over_none: float
    loss_to_all_axes: float
    dependences: tuple[Dependence, ...]


def residual_analysis(screening: Screening, disturbance: DisturbanceFit | None = None) -> ResidualAnalysis:
    """Describe the torque that the final model of a `screening` lacks, on the axis of the largest torque
    against its error; without the coloured-noise model `disturbance` nothing is tested.
    """
    value = np.concatenate([torque.value_Nm for torque in screening.torques])
    std = np.concatenate([torque.std_Nm for torque in screening.torques])
    sigma_over_std = value.std(axis=0) / np.maximum(std.mean(axis=0), 1e-12)
    if disturbance is None:
        index = int(np.argmax(sigma_over_std))
        sigma_Nm = float(np.sqrt(np.mean(value[:, index] ** 2 + std[:, index] ** 2)))
        correlation_time_s = _correlation_time_s(
            screening.torques[0].value_Nm[:, index],
            screening.score_test.linearisations[0].trajectory.step_s,
        )
        return ResidualAnalysis(
            AXES[index], sigma_Nm, float(sigma_over_std[index]), correlation_time_s, 0.0, 0.0, ()
        )
    axis, loss, gain = best_single_axis(disturbance)
    index = AXES.index(axis)
    significant = [one for one in score_dependences(disturbance) if one.log_likelihood_gain > one.penalty]
    return ResidualAnalysis(
        axis,
        float(disturbance.model.sigma_Nm[index]),
        float(sigma_over_std[index]),
        disturbance.model.correlation_time_s,
        gain,
        loss,
        tuple(significant[:_MAX_CORRELATES]),
    )


def _correlation_time_s(value: Floats, step_s: float) -> float:
    value = value - value.mean()
    size = 1 << int(2 * len(value) - 1).bit_length()
    products = np.fft.irfft(np.abs(np.fft.rfft(value, size)) ** 2, size)[: len(value)]
    below = np.flatnonzero(products < products[0] / np.e)
    return float(below[0] * step_s) if len(below) else float(len(value) * step_s)


def correlates(splines: Sequence[Scored]) -> list[str]:
    """Name the quantities on which the missing part depends by the scores of the spline terms `splines`, best
    first, as ``CHANNEL on QUANTITY``.
    """
    best = splines[0].result.log_likelihood_gain if splines else 0.0
    least = max(CORRELATE_SHARE * best, CORRELATE_MIN)
    return [
        " on ".join(one.candidate.id.split(":")[1:])
        for one in splines[:_MAX_CORRELATES]
        if one.result.log_likelihood_gain > least
    ]
