"""Cache of the estimates of a search, in a file, so that an interrupted search can be resumed.

A search is deterministic: it needs the same estimates in the same order every time. The file therefore
contains estimates only, each with a digest of everything that it depends on. A resumed search starts again,
and finds its earlier estimates in the file.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_sim.model.base import Effect, Model
from heli_sim.rig import Rig

from heli_lab.code_digest import code_digest
from heli_lab.errors import IdentifyError
from heli_lab.explain.search.candidate import Candidate
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.flight_model import RigParameters, model_functions
from heli_lab.fit.grey_box import DisturbanceModel, GainDisturbance
from heli_lab.fit.model_functions import ModelFunctions
from heli_lab.fit.records import Record
from heli_lab.fit.reference_trajectory import ReferenceTrajectory

_PACKAGES: Final = ("heli_sim.model", "heli_lab.fit")
"""Packages whose code, compiled code included, an estimate depends on."""
_DISTURBANCES: Final = ("fast_std", "correlation_time_s", "slow_std", "quantisation", "curvature")
"""Arrays of a disturbance model."""


class EstimateCache:
    """Estimates by key, in memory and optionally in a file of one JSON object per line."""

    def __init__(self, path: Path | None = None, search_fingerprint: str = "") -> None:
        self._path = path
        self._entries: dict[str, Mapping[str, Any]] = {}
        self.used_keys: set[str] = set()
        """Keys that this search has used."""
        self._write_lock = threading.Lock()
        if path is None:
            return
        if not path.exists() or not path.stat().st_size:
            path.write_text(json.dumps({"search_of": search_fingerprint}) + "\n", encoding="utf-8")
            return
        self._read(path, search_fingerprint)

    def _read(self, path: Path, search_fingerprint: str) -> None:
        """Read the entries of a file, and remove an incomplete last line."""
        try:
            first, *lines = path.read_text(encoding="utf-8").splitlines()
            file_fingerprint = json.loads(first)["search_of"]
        except (ValueError, KeyError, TypeError):
            raise IdentifyError(f"{path} is not a --resume file", "give --resume a new file name") from None
        if file_fingerprint != search_fingerprint:
            raise IdentifyError(
                f"{path} is from a search with other flights, another rig, model or program version",
                "give another name to --resume, or the same flights, rig, model and effects",
            )
        complete_lines = 0
        for line in lines:
            try:
                entry = json.loads(line)
                self._entries[entry["key"]] = entry
            except (ValueError, KeyError):
                break
            complete_lines += 1
        # An interrupted search may have written a part of its last line.
        if complete_lines < len(lines):
            path.write_text("\n".join([first, *lines[:complete_lines]]) + "\n", encoding="utf-8")

    def estimate(
        self,
        key: str,
        parameter_vector: RigParameters,
        references: Sequence[ReferenceTrajectory],
        compute: Callable[[ModelFunctions], Estimate],
    ) -> Estimate:
        """Look up an estimate, or compute and store it. Threads may compute different keys together."""
        functions = model_functions(parameter_vector.model, parameter_vector.quantities)
        self.used_keys.add(key)
        cached = self._entries.get(key)
        if cached is not None:
            return Estimate(
                parameter_vector=parameter_vector,
                theta=np.array(cached["theta"]),
                covariance=np.array(cached["covariance"]),
                log_likelihood=cached["log_likelihood"],
                disturbances=_disturbances_of(cached["disturbances"]),
                converged=cached["converged"],
                references=tuple(references),
                functions=functions,
            )
        estimate = compute(functions)
        entry = {
            "key": key,
            "theta": estimate.theta.tolist(),
            "covariance": estimate.covariance.tolist(),
            "log_likelihood": float(estimate.log_likelihood),
            "disturbances": _disturbances_json(estimate.disturbances),
            "converged": bool(estimate.converged),
        }
        self._entries[key] = entry
        if self._path is not None:
            with self._write_lock, self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")
        return estimate


def _disturbances_json(disturbances: DisturbanceModel) -> dict[str, Any]:
    """Return a disturbance model as JSON object."""
    arrays = {name: getattr(disturbances, name) for name in _DISTURBANCES}
    return {
        **{name: None if array is None else array.tolist() for name, array in arrays.items()},
        "gains": [astuple(gain) for gain in disturbances.gains],
    }


def _disturbances_of(content: Mapping[str, Any]) -> DisturbanceModel:
    """Return the disturbance model of a JSON object of `_disturbances_json`."""
    arrays: dict[str, Any] = {
        name: None if content[name] is None else np.array(content[name]) for name in _DISTURBANCES
    }
    return DisturbanceModel(**arrays, gains=tuple(GainDisturbance(*gain) for gain in content["gains"]))


def cache_key(
    flights: str,
    candidates: Iterable[Candidate],
    start: Mapping[str, float],
    warm_start: Estimate | None,
    disturbances: DisturbanceModel | None = None,
) -> str:
    """Return a digest of everything that an estimate depends on in addition to the `fingerprint`."""
    digest = hashlib.sha256(flights.encode())
    for candidate in candidates:
        candidate_values = (
            candidate.id,
            sorted(candidate.effect.values.items()),
            sorted(candidate.effect.priors.items()),
        )
        moments = candidate.effect.flight, sorted(candidate.effect.other_moments_s.items())
        digest.update(repr((*candidate_values, *moments, _effect_source(candidate.effect))).encode())
    digest.update(repr(sorted((name, float(value)) for name, value in start.items())).encode())
    if warm_start is not None:
        digest.update(repr((warm_start.parameter_vector.names, warm_start.log_likelihood)).encode())
        digest.update(np.ascontiguousarray(warm_start.theta).tobytes())
        disturbances = warm_start.disturbances
    if disturbances is not None:
        digest.update(json.dumps(_disturbances_json(disturbances)).encode())
    return digest.hexdigest()


def _effect_source(effect: Effect) -> str:
    """Return the source code of an effect, because a user may change it in an effect file.

    An effect without a source file has its name instead.
    """
    try:
        return inspect.getsource(type(effect))
    except (OSError, TypeError):
        return type(effect).__qualname__


def fingerprint(model: Model, rig: Rig, records: Iterable[Record]) -> str:
    """Return a digest of everything that all estimates of a search depend on.

    This is the `model`, the `rig`, the flights (`records`), and the code of the estimation.
    """
    digest = hashlib.sha256(code_digest(packages=_PACKAGES).encode())
    effects = [(effect.name, sorted(effect.values.items())) for effect in model.effects]
    digest.update(repr((model.name, effects)).encode())
    numbers = [
        (name, quantity.value, quantity.tolerance, quantity.unit) for name, quantity in sorted(rig.items())
    ]
    digest.update(repr(numbers).encode())
    for record in records:
        digest.update(repr((record.label, record.segments)).encode())
        for array in (record.t_s, record.angles_rad, record.voltages_V):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
