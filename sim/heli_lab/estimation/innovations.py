"""Innovations of flights with their derivatives by the parameters, and what follows from them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from heli_host.arrays import Floats, Integers

from heli_lab.estimation.arrowhead import per_flight_columns


@dataclass(frozen=True)
class Innovations:
    """Innovations of several flights.

    Parameters
    ----------
    flights : tuple of ndarray (b, 1 + k)
        One array per flight, in standard deviations. Column 0 holds the innovations. Each further column
        holds by how much a unit of one parameter of the flight reduces them. The m outputs of a block are in
        m consecutive rows.
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
        """Fisher information of the parameters, shape (f, f)."""
        information = np.zeros((self.size, self.size))
        for flight, columns in zip(self.flights, self.columns, strict=True):
            information[np.ix_(columns, columns)] += flight[:, 1:].T @ flight[:, 1:]
        return information

    def score(self) -> Floats:
        """Score: derivatives of the log-likelihood by the parameters, shape (f,)."""
        score = np.zeros(self.size)
        for flight, columns in zip(self.flights, self.columns, strict=True):
            score[columns] += flight[:, 1:].T @ flight[:, 0]
        return score

    @cached_property
    def log_likelihoods(self) -> Floats:
        """Log-likelihood of each output's innovations of the error, nats, without its constant, shape (m,):
        the prediction error decomposition (Harvey, section 3.4).
        """
        m = len(self.log_variances)
        squares = sum(
            (np.square(flight[:, 0]).reshape(-1, m).sum(axis=0) for flight in self.flights), start=np.zeros(m)
        )
        return -0.5 * (squares + self.log_variances)

    def after(self, move: Floats) -> list[Floats]:
        """Innovations of the error of each flight, shape (b,), when the parameters have moved by `move`,
        shape (f,), to first order.
        """
        return [
            flight[:, 0] - flight[:, 1:] @ move[columns]
            for flight, columns in zip(self.flights, self.columns, strict=True)
        ]
