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

from heli_lab.identify.estimation_problem import Combination, Fit, combinations, uninformed_parameters
from heli_lab.identify.free import PER_FLIGHT
from heli_lab.identify.results.check import Check, Trace
from heli_lab.identify.thresholds import STRONG_CORRELATION


@dataclass(frozen=True)
class Identification:
    """A fit with its checks; `validation` holds those on other flights, none when none were given."""

    fit: Fit
    training: tuple[Check, ...]
    validation: tuple[Check, ...]
    training_traces: tuple[Trace, ...]
    validation_traces: tuple[Trace, ...]

    @property
    def combinations(self) -> list[Combination]:
        """Combinations of parameters that the flights inform less than the priors."""
        problem = self.fit.problem
        return combinations(problem.names, self.fit.information, problem.parameter_vector.std)

    @property
    def uninformed_parameters(self) -> list[str]:
        """Parameters that the flights do not inform."""
        return uninformed_parameters(
            self.fit.problem.names, self.fit.covariance, self.fit.problem.parameter_vector.std
        )

    def remark(self, name: str) -> str:
        """Say of the free parameter `name` that it is on its bound or uninformed; empty if neither."""
        if name in self.fit.at_bound:
            return "on its bound"
        return "uninformed" if name in self.uninformed_parameters else ""

    @property
    def strong_correlations(self) -> list[tuple[str, str, float]]:
        """Strongly correlated pairs of parameters, strongest first."""
        names, correlation = self.fit.problem.names, self.fit.correlation
        pairs = [
            (names[i], names[j], float(correlation[i, j]))
            for i in range(len(names))
            for j in range(i)
            if abs(correlation[i, j]) > STRONG_CORRELATION
        ]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))

    def rig(self, name: str) -> Rig:
        """Make the rig that was found, called `name`: the identified numbers with twice their standard errors
        as tolerances; everything else as it was. The source of a number states if the flights do not inform
        it. It names the model that was fitted, and has that model's
        effects. If several flights have separate values of a torque, the rig has their mean, with their
        scatter in the tolerance. Zeros with separate values stay unchanged: another flight has others.
        """
        old = self.fit.problem.rig
        labels = ", ".join(record.label for record in self.fit.problem.records)
        numbers = dict(old.numbers)
        several = len(self.fit.problem.records) > 1
        uninformed = set(self.uninformed_parameters)
        by_quantity: dict[str, list[tuple[float, float]]] = {}
        for parameter, value, std in zip(
            self.fit.problem.free, self.fit.theta, self.fit.std.values(), strict=True
        ):
            if parameter.quantity not in numbers or (several and parameter.quantity in PER_FLIGHT):
                continue
            by_quantity.setdefault(parameter.quantity, []).append((float(value), std))
        for quantity, estimates in by_quantity.items():
            was = numbers[quantity]
            values, errors = np.array(estimates).T
            scatter = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
            tolerance = 2.0 * math.hypot(float(np.sqrt(np.mean(errors**2))), scatter)
            how = "not informed by" if quantity in uninformed else "identified from"
            source = f"{how} {labels}; before: {was.value:g} +- {was.tolerance:g}"
            numbers[quantity] = Number(float(np.mean(values)), was.unit, tolerance, source)
        return Rig(
            name,
            f"{old.name} as identified from {labels}",
            numbers,
            self._effects(),
            self.fit.problem.model.name,
        )

    def _effects(self) -> dict[str, dict[str, Number]]:
        """Effects of the model with the numbers found, as a rig holds them."""
        problem = self.fit.problem
        values = dict(
            zip((q.name for q in problem.model.parameters), problem.parameter_vector.values, strict=True)
        )
        estimates = self.fit.values
        labels = ", ".join(record.label for record in problem.records)
        effects: dict[str, dict[str, Number]] = {}
        for effect in problem.model.effects:
            numbers = effects.setdefault(effect.name, {})
            for parameter in effect.parameters:
                what = parameter.name.removeprefix(f"{effect.name.replace('.', '_')}_")
                value = float(estimates.get(parameter.name, values[parameter.name]))
                free = parameter.name in estimates
                source = f"identified from {labels}" if free else "not estimated"
                numbers[what] = Number(
                    value, parameter.unit, 2.0 * self.fit.std[parameter.name] if free else 0.0, source
                )
        return effects

    def json(self) -> dict[str, Any]:
        """The result as JSON has it: parameters{NAME: {value, std, prior: {value, std}, unit}},
        normalised_residual{train, validation}, free_run_rms_deg{axis: ...}, correlations{NAME: {NAME: ...}},
        seconds_used, and more.
        """
        fit, problem = self.fit, self.fit.problem
        judged = self.validation or self.training
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
                "train": _together([check.normalised for check in self.training], self.training),
                "validation": _together([check.normalised for check in self.validation], self.validation)
                if self.validation
                else None,
            },
            "free_run_rms_deg": {
                axis: _together([check.rms_deg[axis] for check in judged], judged) for axis in AXES
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
            "flights": [self._flight(check, "train") for check in self.training]
            + [self._flight(check, "validation") for check in self.validation],
            "seconds_used": sum(check.seconds_used for check in self.training),
            "seconds_taken": fit.seconds,
            "converged": fit.converged,
        }

    def _flight(self, check: Check, role: str) -> dict[str, Any]:
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
            entry["left_out"] = [{"from_s": c.start_s, "to_s": c.stop_s, "why": c.why} for c in record.cuts]
            entry["notes"] = list(record.notes)
        return entry


def short_names(paths: Sequence[Path]) -> list[str]:
    """Names of flights for reports: the file names of `paths`, with as many folders before them as keep them
    apart.
    """
    depth = 1
    while True:
        names = ["/".join(path.parts[-depth:]) for path in paths]
        if len(set(names)) == len(set(paths)) or depth > max(len(path.parts) for path in paths):
            return names
        depth += 1


def _together(values: Sequence[float], checks: Sequence[Check]) -> float:
    """Root mean square over flights, by their length."""
    weight = np.array([check.seconds_used for check in checks])
    return float(np.sqrt(np.average(np.square(values), weights=weight)))


def rounded(number: float, std: float) -> str:
    """Spell a `number` to two digits of its standard error `std`, as a person would write it."""
    if not std > 0.0 or not np.isfinite(std):
        return f"{number:.6g}"
    digits = max(0, 1 - int(np.floor(np.log10(std))))
    return f"{number:.{digits}f}"
