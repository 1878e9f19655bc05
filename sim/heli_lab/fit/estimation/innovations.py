"""Innovations of flights with their derivatives: they give likelihood, score and Fisher information."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from heli_host.data.arrays import Floats, Integers

from heli_lab.fit.estimation.arrowhead import per_flight_columns


@dataclass(frozen=True)
class Innovations:
    """Innovations of several flights: measured outputs minus the predictions of the Kalman filter.

    Parameters
    ----------
    flights : tuple of ndarray (b, 1 + k)
        One array per flight, in standard deviations. Column 0 holds the innovations. Each further column
        holds the reduction of the innovations per unit of one parameter. The m outputs of a block are in m
        consecutive rows.
    columns : tuple of ndarray (k,)
        For each flight, the indices of the k parameters that it depends on.
    size : int
        Number of parameters.
    log_variances : ndarray (m,)
        Sum of the logarithms of the variances of each output.
    """

    flights: tuple[Floats, ...]
    columns: tuple[Integers, ...]
    size: int
    log_variances: Floats

    @property
    def per_flight(self) -> Integers:
        """Parameters of one flight alone, shape (flights, k)."""
        return per_flight_columns(self.columns, self.size)

    def information(self) -> Floats:
        """Compute the Fisher information of the parameters, shape (f, f)."""
        information = np.zeros((self.size, self.size))
        for flight, columns in zip(self.flights, self.columns, strict=True):
            _, sensitivity = _innovations_and_reductions(flight)
            information[np.ix_(columns, columns)] += sensitivity.T @ sensitivity
        return information

    def score(self) -> Floats:
        """Compute the score, the derivatives of the log-likelihood by the parameters, shape (f,)."""
        score = np.zeros(self.size)
        for flight, columns in zip(self.flights, self.columns, strict=True):
            innovations, sensitivity = _innovations_and_reductions(flight)
            score[columns] += sensitivity.T @ innovations
        return score

    @cached_property
    def log_likelihoods(self) -> Floats:
        """Log-likelihood of each output's innovations [nats], without its constant, shape (m,).

        This is the prediction error decomposition (Harvey, section 3.4).
        """
        outputs = len(self.log_variances)
        squares = np.zeros(outputs)
        for flight in self.flights:
            innovations, _ = _innovations_and_reductions(flight)
            # One row per block, so that the sum is that of each output.
            squares = squares + np.square(innovations.reshape(-1, outputs)).sum(axis=0)
        return -0.5 * (squares + self.log_variances)

    def after(self, move: Floats) -> list[Floats]:
        """Predict, to first order, the innovations of each flight, shape (b,), after the parameters change by
        `move`, shape (f,).
        """
        moved = []
        for flight, columns in zip(self.flights, self.columns, strict=True):
            innovations, sensitivity = _innovations_and_reductions(flight)
            moved.append(innovations - sensitivity @ move[columns])
        return moved


def _innovations_and_reductions(flight: Floats) -> tuple[Floats, Floats]:
    """Return the innovations of a flight, shape (b,), and their reduction per unit of each parameter, shape
    (b, k).
    """
    return flight[:, 0], flight[:, 1:]
