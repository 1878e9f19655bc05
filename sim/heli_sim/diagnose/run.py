"""Diagnosis from beginning to end: flights in; causes, an extended model and its gain out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

from heli_host.flight import Flight

from heli_sim.diagnose.gain import gain
from heli_sim.diagnose.hypothesis import Bench, Hypothesis
from heli_sim.diagnose.leftover import leftover
from heli_sim.diagnose.result import Diagnosis
from heli_sim.diagnose.search import Search, search
from heli_sim.diagnose.verdict import judge
from heli_sim.errors import IdentifyError
from heli_sim.identify import Record, prepare
from heli_sim.model.base import Model
from heli_sim.model.effects import EffectKind, catalogue
from heli_sim.rig import Rig


def diagnose(
    model: Model,
    rig: Rig,
    flights: Sequence[Flight | Record],
    validation: Sequence[Flight | Record] = (),
    *,
    kinds: Mapping[str, EffectKind] | None = None,
    labels: Sequence[str] | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    seed: int = 0,
    seconds: float = float("inf"),
    say: Callable[[str, float], None] | None = None,
) -> Diagnosis:
    """Find what a model lacks.

    Parameters
    ----------
    model : Model
        The model, with effects that are known beforehand.
    rig : Rig
        Start values and priors of its numbers.
    flights, validation : sequence of Flight or Record
        Flights to fit, and flights to judge on.
    kinds : Mapping[str, EffectKind], optional
        The catalogue; the package's own where not given.
    labels : sequence of str, optional
        Names of all flights, those to fit first.
    start_s, stop_s : float, optional
        Use only this part of the flights to fit.
    seed : int
        Seed of the resampling behind the intervals.
    seconds : float
        Most time; what could not be tried is said.
    say : callable, optional
        Told what is being done, and which share of the work is.

    Returns
    -------
    Diagnosis
        The result.

    Raises
    ------
    IdentifyError
        When nothing can be learned from the flights.
    """
    started_s = time.perf_counter()
    tell = say or (lambda _what, _share: None)
    every = catalogue() if kinds is None else dict(kinds)
    names = list(labels or [f"flight {i + 1}" for i in range(len(flights) + len(validation))])
    if len(set(names)) < len(names):
        raise IdentifyError("a flight is both fitted and validated on; give another to --validate")
    train = [_ready(f, rig, name, start_s, stop_s) for f, name in zip(flights, names, strict=False)]
    held = [_ready(f, rig, n, None, None) for f, n in zip(validation, names[len(flights) :], strict=True)]
    bench = Bench(model, rig, train, held, seed=seed)
    known = {effect.name for effect in model.effects}
    tried = {
        id_: kind
        for id_, kind in every.items()
        if kind.suits(model) and id_ not in known and not kind.baseline and not kind.shaken
    }
    found = search(bench, tried, say=tell, seconds=seconds - (time.perf_counter() - started_s))
    tell("looking at what remains", 0.9)
    left = leftover(found.final, found.last)
    verdict = judge(found, left)
    extended = _extended(bench, found)
    return Diagnosis(
        found,
        verdict,
        left,
        extended,
        gain(found.baseline, extended, seed),
        {},
        every,
        None,
        time.perf_counter() - started_s,
    )


def _extended(bench: Bench, found: Search) -> Hypothesis:
    """The final model without patterns, which no simulator flies."""
    named = [trial for trial in found.final.trials if not trial.is_pattern]
    if len(named) == len(found.final.trials):
        return found.final
    if not named:
        return found.baseline
    return bench.try_out(named, found.final.fit.values)


def _ready(
    flight: Flight | Record, rig: Rig, label: str, start_s: float | None, stop_s: float | None
) -> Record:
    if isinstance(flight, Record):
        return flight
    return prepare(flight, rig, label, start_s=start_s, stop_s=stop_s)
