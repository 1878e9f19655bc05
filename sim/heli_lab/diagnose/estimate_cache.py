"""Estimates of a search, kept as they come, so that a search that ended early goes on where it was.

A search is deterministic: run again it asks for the same estimates in the same order. So what is kept is not
where it was but what it had worked out, by a digest of all that an estimate depends on; a search that is
resumed is the search that never stopped, with the first answers at hand.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_sim.model.base import Effect, Model
from heli_sim.rig import Rig

from heli_lab.code_digest import code_digest
from heli_lab.diagnose.candidate import Candidate
from heli_lab.errors import IdentifyError
from heli_lab.estimation import DisturbanceModel, Estimate, ModelFunctions, ReferenceTrajectory
from heli_lab.identify import Record
from heli_lab.identify.flight_model import RigParameters

_ESTIMATED_BY: Final = ("heli_sim.model", "heli_lab.identify", "heli_lab.estimation")
"""Packages whose code, compiled code included, an estimate depends on."""
_DISTURBANCES: Final = ("fast_std", "correlation_time_s", "slow_std", "quantisation", "curvature")


class EstimateCache:
    """Estimates by key, in memory and where a path is given in a file of one JSON object a line.

    Parameters
    ----------
    path : Path, optional
        File to read and to append to; it is made if it is missing.
    of : str
        Digest of what all estimates share, `fingerprint`; a file of another is refused.

    Raises
    ------
    IdentifyError
        When the file is of other flights, another rig, another model or another version of this program, or
        is no such file.
    """

    def __init__(self, path: Path | None = None, of: str = "") -> None:
        self._path = path
        self._known: dict[str, Mapping[str, Any]] = {}
        self.used_keys: set[str] = set()
        """Keys whose estimates this search has used."""
        self._writing = threading.Lock()
        if path is None:
            return
        if not path.exists() or not path.stat().st_size:
            path.write_text(json.dumps({"search_of": of}) + "\n", encoding="utf-8")
            return
        self._read(path, of)

    def _read(self, path: Path, of: str) -> None:
        try:
            first, *lines = path.read_text(encoding="utf-8").splitlines()
            head = json.loads(first)["search_of"]
        except (ValueError, KeyError, TypeError):
            raise IdentifyError(
                f"{path} is no file of a search", "give another name to --resume, and it is made"
            ) from None
        if head != of:
            raise IdentifyError(
                f"{path} is of a search in other flights, with another rig or model, or by another version",
                "give another name to --resume, or the same flights, rig, model and effects",
            )
        whole = 0
        for line in lines:
            try:
                entry = json.loads(line)
                self._known[entry["key"]] = entry
            except (ValueError, KeyError):
                break
            whole += 1
        # The line that an interrupted search was writing.
        if whole < len(lines):
            path.write_text("\n".join([first, *lines[:whole]]) + "\n", encoding="utf-8")

    def estimate(
        self,
        key: str,
        parameter_vector: RigParameters,
        references: Sequence[ReferenceTrajectory],
        functions: ModelFunctions,
        work_out: Callable[[], Estimate],
    ) -> Estimate:
        """Look up the estimate of a `key`, or `work_out` and keep it; several threads may, of other keys.

        Parameters
        ----------
        key : str
            Digest of all that it depends on, see `cache_key`.
        parameter_vector, references, functions
            The free parameters, the reference trajectories and the model functions of the estimate.
            Those of the estimate.
        work_out : callable
            Makes it.
        """
        self.used_keys.add(key)
        known = self._known.get(key)
        if known is not None:
            disturbances: dict[str, Any] = {
                name: None if value is None else np.array(value)
                for name, value in known["disturbances"].items()
            }
            return Estimate(
                parameter_vector,
                np.array(known["theta"]),
                np.array(known["covariance"]),
                known["log_likelihood"],
                DisturbanceModel(**disturbances),
                known["converged"],
                tuple(references),
                functions,
            )
        estimate = work_out()
        self._known[key] = kept = {
            "key": key,
            "theta": estimate.theta.tolist(),
            "covariance": estimate.covariance.tolist(),
            "log_likelihood": float(estimate.log_likelihood),
            "disturbances": {name: _listed(getattr(estimate.disturbances, name)) for name in _DISTURBANCES},
            "converged": bool(estimate.converged),
        }
        if self._path is not None:
            with self._writing, self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(kept) + "\n")
        return estimate


def _listed(value: Any) -> Any:
    return None if value is None else np.asarray(value).tolist()


def cache_key(
    what: str, candidates: Iterable[Candidate], start: Mapping[str, float], warm_start: Estimate | None
) -> str:
    """Digest of what an estimate depends on beside what all of a search share: `what` flights, `candidates`
    with all their values, values to `start` from, and the estimate to begin `warm_start`.
    """
    digest = hashlib.sha256(what.encode())
    for candidate in candidates:
        known = candidate.id, sorted(candidate.effect.values.items()), sorted(candidate.effect.priors.items())
        digest.update(repr((*known, _equations(candidate.effect))).encode())
    digest.update(repr(sorted((name, float(value)) for name, value in start.items())).encode())
    if warm_start is not None:
        digest.update(repr((warm_start.parameter_vector.names, warm_start.log_likelihood)).encode())
        digest.update(np.ascontiguousarray(warm_start.theta).tobytes())
        for name in _DISTURBANCES:
            value = getattr(warm_start.disturbances, name)
            digest.update(b"none" if value is None else np.ascontiguousarray(value).tobytes())
    return digest.hexdigest()


def _equations(effect: Effect) -> str:
    """Source of an effect, which may be a file of somebody's own."""
    try:
        return inspect.getsource(type(effect))
    except (OSError, TypeError):
        return type(effect).__qualname__


def fingerprint(model: Model, rig: Rig, records: Iterable[Record]) -> str:
    """Digest of what all of a search share: `model`, `rig`, flights (`records`), the code that estimates."""
    digest = hashlib.sha256(code_digest(packages=_ESTIMATED_BY).encode())
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
