"""Disturbances: random changes of a machine's parameters, as Gauss-Markov states of the filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

SLOW_CORRELATION_TIME_s: Final = 15.0
"""Correlation time of the slow disturbance. It is set, not estimated, because a recording of a minute
does not show it: a quarter of a minute. Longer: a constant torque of each flight has the same effect.
Shorter: the fast disturbance has the same effect."""

START_CORRELATION_TIME_s: Final = 0.5
START_QUANTISATION: Final = 0.6
"""Start of a search, set by judgement: the middle of the values of recorded flights."""


@dataclass(frozen=True)
class GainDisturbance:
    """A first-order Gauss-Markov disturbance that varies a gain by a share of it.

    The defaults are the start of a search: within the range of supplies and rotor wash.

    Parameters
    ----------
    std : float
        Stationary standard deviation, as a share of the gain.
    correlation_time_s : float
        Time over which the autocorrelation falls to 1/e.
    """

    std: float = 0.02
    correlation_time_s: float = 1.0


@dataclass(frozen=True)
class DisturbanceModel:
    """Random disturbances of a machine with m outputs and g gains, and the noise of its sensors.

    A fast and a slow first-order Gauss-Markov disturbance act on each output, and one on each gain.

    Parameters
    ----------
    fast_std : ndarray (m,)
        Stationary standard deviation of the fast disturbance, in the unit of the disturbed parameter.
    correlation_time_s : ndarray (m,)
        Time over which the autocorrelation of the fast disturbance falls to 1/e.
    slow_std : ndarray (m,)
        Stationary standard deviation of the slow disturbance, whose correlation time is
        `SLOW_CORRELATION_TIME_s`.
    quantisation : ndarray (m,)
        Variance of the errors of each output, divided by that of independent, uniform rounding errors.
    gains : tuple of GainDisturbance
        Disturbances of the gains, in the order of the model's inputs.
    curvature : ndarray (4 m + 2 g, 4 m + 2 g) or None
        Negative second derivatives of the log-likelihood to the property `logarithms`, at the estimate; 0
        between different disturbances. None if they are unknown.
    """

    fast_std: Floats
    correlation_time_s: Floats
    slow_std: Floats
    quantisation: Floats
    gains: tuple[GainDisturbance, ...] = ()
    curvature: Floats | None = None

    @classmethod
    def start(cls, fast_std: Sequence[float], slow_std: Sequence[float]) -> DisturbanceModel:
        """Return the disturbances from which a search starts.

        Parameters
        ----------
        fast_std, slow_std : sequence of float
            Standard deviations of the m disturbances, in the unit of the disturbed parameters.
        """
        size = len(fast_std)
        return cls(
            np.array(fast_std, float),
            np.full(size, START_CORRELATION_TIME_s),
            np.array(slow_std, float),
            np.full(size, START_QUANTISATION),
        )

    def with_gains(self, gains: int) -> DisturbanceModel:
        """Return the same disturbances with those of `gains` gains at the start of a search."""
        return replace(self, curvature=None, gains=(GainDisturbance(),) * gains)

    @property
    def logarithms(self) -> Floats:
        """Logarithms of all parameters: four for each output, then two for each gain."""
        outputs = np.stack((self.fast_std, self.correlation_time_s, self.slow_std, self.quantisation), axis=1)
        gains = [value for gain in self.gains for value in (gain.std, gain.correlation_time_s)]
        return np.log(np.concatenate((outputs.ravel(), gains)))

    def with_logarithms(self, logarithms: Floats, curvature: Floats | None = None) -> DisturbanceModel:
        """Return disturbances of the same outputs and gains with other parameters.

        Parameters
        ----------
        logarithms : ndarray (4 m + 2 g,)
            Logarithms of the parameters, in the order of the property `logarithms`.
        curvature : ndarray (4 m + 2 g, 4 m + 2 g), optional
            Curvature of the log-likelihood at these parameters.
        """
        values = np.exp(logarithms)
        outputs, gains = np.split(values, [4 * len(self.fast_std)])
        fast_std, correlation_time_s, slow_std, quantisation = outputs.reshape(-1, 4).T
        return DisturbanceModel(
            fast_std,
            correlation_time_s,
            slow_std,
            quantisation,
            tuple(GainDisturbance(*gain) for gain in gains.reshape(-1, 2).tolist()),
            curvature,
        )

    def autocorrelation(self, step_s: float) -> Floats:
        """Return the autocorrelation of each disturbance over a step of `step_s` [s].

        Returns
        -------
        ndarray (2 (m + g),)
            First the fast disturbances of the outputs and those of the gains, then the slow disturbances of
            the outputs. The filter has a slow disturbance of each gain, too, whose variance is 0.
        """
        gains_s = [gain.correlation_time_s for gain in self.gains]
        slow_s = np.full(len(self.fast_std) + len(gains_s), SLOW_CORRELATION_TIME_s)
        return np.exp(-step_s / np.concatenate((self.correlation_time_s, gains_s, slow_s)))

    @property
    def variance(self) -> Floats:
        """Stationary variance of each disturbance, in the order of `autocorrelation`."""
        gains = [gain.std for gain in self.gains]
        return np.concatenate((self.fast_std, gains, self.slow_std, np.zeros(len(gains)))) ** 2
