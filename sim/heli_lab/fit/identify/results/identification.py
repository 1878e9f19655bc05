"""The result of an identification: as JSON, and as a rig that can be flown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from heli_sim.model.parts import AXES
from heli_sim.rig import Number, Rig

from heli_lab.fit.identify.estimation_problem import Combination, Fit, combinations, uninformed_parameters
from heli_lab.fit.identify.free import PER_FLIGHT
from heli_lab.fit.identify.results.check import FreeRunErrors, Trace
from heli_lab.fit.identify.thresholds import STRONG_CORRELATION


@dataclass(frozen=True)
class Identification:
    """Result of an identification: a fit with its free runs."""

    fit: Fit  # Estimates from the training flights
    training: tuple[FreeRunErrors, ...]
    """training, validation: Errors of the free runs, one per fitted and per validation flight."""
    validation: tuple[FreeRunErrors, ...]
    training_traces: tuple[Trace, ...]
    """training_traces, validation_traces: Measured and predicted angles of the same flights."""
    validation_traces: tuple[Trace, ...]
    validation_converged: bool = True
    """Whether the initial states and zeros of the validation flights are those with the smallest error."""

    @property
    def converged(self) -> bool:
        """Whether the fit has converged, and the initial states of the validation flights too."""
        return self.fit.converged and self.validation_converged

    @property
    def combinations(self) -> list[Combination]:
        """Combinations of parameters that the flights inform less than the priors."""
        problem = self.fit.problem
        return combinations(problem.names, self.fit.information, problem.parameter_vector.std)

    @property
    def uninformed_parameters(self) -> list[str]:
        """Parameters that the flights do not inform."""
        problem = self.fit.problem
        return uninformed_parameters(problem.names, self.fit.covariance, problem.parameter_vector.std)

    def remark(self, name: str) -> str:
        """Remark on the free parameter `name`: "on its bound" or "uninformed"; empty if neither."""
        if name in self.fit.at_bound:
            return "on its bound"
        return "uninformed" if name in self.uninformed_parameters else ""

    @property
    def strong_correlations(self) -> list[tuple[str, str, float]]:
        """Pairs of parameters whose correlation exceeds `STRONG_CORRELATION`: both names and the correlation,
        strongest first.
        """
        names, correlation = self.fit.problem.names, self.fit.correlation
        pairs = [
            (names[i], names[j], float(correlation[i, j]))
            for i in range(len(names))
            for j in range(i)
            if abs(correlation[i, j]) > STRONG_CORRELATION
        ]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))

    def rig(self, name: str) -> Rig:
        """Return the identified rig, called `name`.

        Identified parameters have twice their standard error as tolerance; everything else stays unchanged.
        The source of a parameter states if the flights do not inform it. The rig has the name and the effects
        of the fitted model. If a torque was estimated for each flight separately, the rig has the mean of
        these torques, and their scatter in the tolerance. If encoder zeros were estimated for each flight,
        the rig keeps its old zeros.
        """
        fitted_rig = self.fit.problem.rig
        labels = ", ".join(record.label for record in self.fit.problem.records)
        numbers = dict(fitted_rig.numbers)
        uninformed = set(self.uninformed_parameters)
        for quantity, estimates in self._estimates_by_quantity().items():
            prior_number = numbers[quantity]
            values, errors = np.array(estimates).T
            scatter = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
            tolerance = 2.0 * math.hypot(float(np.sqrt(np.mean(errors**2))), scatter)
            origin = "not informed by" if quantity in uninformed else "identified from"
            source = f"{origin} {labels}; before: {prior_number.value:g} +- {prior_number.tolerance:g}"
            numbers[quantity] = Number(float(np.mean(values)), prior_number.unit, tolerance, source)
        description = f"{fitted_rig.name} as identified from {labels}"
        return Rig(name, description, numbers, self._effect_numbers(), self.fit.problem.model.name)

    def _estimates_by_quantity(self) -> dict[str, list[tuple[float, float]]]:
        """Collect estimate and standard error of each rig parameter: one pair, or one per flight if flights
        differ in the parameter.
        """
        fit, problem = self.fit, self.fit.problem
        several_flights = len(problem.records) > 1
        estimates: dict[str, list[tuple[float, float]]] = {}
        for parameter, value, std in zip(problem.free, fit.theta, fit.std.values(), strict=True):
            of_one_flight = several_flights and parameter.quantity in PER_FLIGHT
            if parameter.quantity in problem.rig.numbers and not of_one_flight:
                estimates.setdefault(parameter.quantity, []).append((float(value), std))
        return estimates

    def _effect_numbers(self) -> dict[str, dict[str, Number]]:
        """Return the parameters of the model's effects as a rig file has them: by effect, then by short
        name.
        """
        problem = self.fit.problem
        values = problem.parameter_vector.values_by_name
        estimates, std = self.fit.values, self.fit.std
        labels = ", ".join(record.label for record in problem.records)
        effects: dict[str, dict[str, Number]] = {}
        for effect in problem.model.effects:
            numbers = effects.setdefault(effect.name, {})
            for parameter in effect.parameters:
                name = parameter.name
                if name in estimates:
                    value, tolerance, source = estimates[name], 2.0 * std[name], f"identified from {labels}"
                else:
                    value, tolerance, source = values[name], 0.0, "not estimated"
                short_name = name.removeprefix(f"{effect.name.replace('.', '_')}_")
                numbers[short_name] = Number(float(value), parameter.unit, tolerance, source)
        return effects

    def json(self) -> dict[str, Any]:
        """Return the result as the object that result.json contains.

        Its keys are parameters{NAME: {value, std, prior: {value, std}, unit}},
        normalised_residual{train, validation}, free_run_rms_deg{axis: ...}, correlations{NAME: {NAME: ...}},
        seconds_used, and more.
        """
        fit, problem = self.fit, self.fit.problem
        evaluated = self.validation or self.training
        return {
            "model": problem.model.name,
            "effects": [effect.name for effect in problem.model.effects],
            "rig": problem.rig.name,
            "parameters": {
                parameter.name: {
                    "value": float(value),
                    "std": std,
                    "unit": parameter.unit,
                    "prior": {"value": parameter.prior.mean, "std": parameter.prior.std},
                    "at_bound": parameter.name in fit.at_bound,
                }
                for parameter, value, std in zip(problem.free, fit.theta, fit.std.values(), strict=True)
            },
            "normalised_residual": {
                "train": _rms_normalised(self.training),
                "validation": _rms_normalised(self.validation) if self.validation else None,
            },
            "free_run_rms_deg": {
                axis: _rms_over_flights(evaluated, [errors.rms_deg[axis] for errors in evaluated])
                for axis in AXES
            },
            "free_run_s": problem.grids.window_s,
            "free_run_of": "validation" if self.validation else "train",
            "correlations": {
                name: {other: round(float(value), 4) for other, value in zip(problem.names, row, strict=True)}
                for name, row in zip(problem.names, fit.correlation, strict=True)
            },
            "unidentified_combinations": [
                {"change": combination.change, "std_over_prior": combination.std_over_prior}
                for combination in self.combinations
            ],
            "uninformed_parameters": self.uninformed_parameters,
            "flights": [self._flight_json(check, "train") for check in self.training]
            + [self._flight_json(check, "validation") for check in self.validation],
            "seconds_used": sum(check.seconds_used for check in self.training),
            "seconds_taken": fit.elapsed_s,
            "converged": self.converged,
        }

    def _flight_json(self, check: FreeRunErrors, role: str) -> dict[str, Any]:
        """Entry of one flight in the JSON."""
        records = {record.label: record for record in self.fit.problem.records}
        entry: dict[str, Any] = {
            "flight": check.label,
            "role": role,
            "seconds_used": check.seconds_used,
            "normalised_residual": check.normalised,
            "normalised_residual_axis": check.axis_normalised,
            "free_run_rms_deg": check.rms_deg,
            "white": check.white,
            "autocorrelation_0.1_s": check.correlation,
        }
        if role == "train":
            record = records[check.label]
            entry["left_out"] = [
                {"from_s": cut.start_s, "to_s": cut.stop_s, "why": cut.why} for cut in record.cuts
            ]
            entry["notes"] = list(record.notes)
        return entry


def short_names(paths: Sequence[Path]) -> list[str]:
    """Name flights for reports by the `paths` of their files, with as many folders as make the names
    unique.
    """
    depth = 1
    while True:
        names = ["/".join(path.parts[-depth:]) for path in paths]
        if len(set(names)) == len(set(paths)) or depth > max(len(path.parts) for path in paths):
            return names
        depth += 1


def _rms_normalised(flights: Sequence[FreeRunErrors]) -> float:
    """Combine the normalised errors of all flights into one."""
    return _rms_over_flights(flights, [errors.normalised for errors in flights])


def _rms_over_flights(flights: Sequence[FreeRunErrors], values: Sequence[float]) -> float:
    """Return the root mean square of one value per flight, weighted by the length of the flights."""
    weights = np.array([errors.seconds_used for errors in flights])
    return float(np.sqrt(np.average(np.square(values), weights=weights)))


def rounded(number: float, std: float) -> str:
    """Format a `number` to two significant digits of its standard error `std`."""
    if not std > 0.0 or not np.isfinite(std):
        return f"{number:.6g}"
    digits = max(0, 1 - int(np.floor(np.log10(std))))
    return f"{number:.{digits}f}"
