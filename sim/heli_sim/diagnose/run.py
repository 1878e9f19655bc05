"""Diagnosis from beginning to end: flights in; causes, an extended model and its gain out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from heli_host.flight import Flight

from heli_sim.diagnose.gain import gain
from heli_sim.diagnose.hypothesis import Bench, Hypothesis
from heli_sim.diagnose.leftover import leftover
from heli_sim.diagnose.next_flight import NextFlight, next_flight, part_for
from heli_sim.diagnose.removed import removed_terms
from heli_sim.diagnose.result import Diagnosis
from heli_sim.diagnose.screening import Scored
from heli_sim.diagnose.search import Search, search
from heli_sim.diagnose.verdict import Verdict, ambiguous_with, judge
from heli_sim.errors import IdentifyError
from heli_sim.identify import Record, prepare
from heli_sim.model.base import Model
from heli_sim.model.effects import EffectKind, catalogue
from heli_sim.rig import Rig

_STANDS_OUT: Final = 5.0
"""Standard errors that an effect must measure to be seen among all that are tried."""
_SHORT_s: Final = 15.0
_MANY_UNSEEN: Final = 12


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
    tried = {id_: kind for id_, kind in every.items() if _candidate(kind, model, known)}
    left_s = seconds - (time.perf_counter() - started_s)
    found = search(bench, tried, removable=tuple(every.values()), say=tell, seconds=left_s)
    tell("looking at what remains", 0.9)
    left = leftover(found.final, found.last)
    extended = _extended(bench, found)
    removed = removed_terms(extended.fit, rig, every)
    verdict = judge(found, left, bool(removed))
    unseen = _unseen(found.rounds[-1].screened, every)
    return Diagnosis(
        found,
        verdict,
        left,
        extended,
        gain(found.baseline, extended, seed),
        removed,
        every,
        unseen,
        _next(verdict, found, every, unseen),
        time.perf_counter() - started_s,
    )


def _candidate(kind: EffectKind, model: Model, known: set[str]) -> bool:
    """Whether an effect is searched for; numbers of the rig that vanish are seen in the fit itself."""
    if not kind.suits(model) or kind.id in known or kind.shaken:
        return False
    return not kind.baseline or (not kind.held and model.name != "multibody")


def _unseen(screened: Sequence[Scored], kinds: Mapping[str, EffectKind]) -> tuple[str, ...]:
    """Effects that would not stand out of their standard error at a typical size."""
    unseen = []
    for one in screened:
        kind = kinds[one.trial.id]
        # Without columns for each size, the unit of the only coefficient is the size tried.
        name = kind.size[0]
        unit = 1.0 if one.trial.size else one.trial.effect.values[name]
        if one.answer.std[0] * abs(unit) * _STANDS_OUT > abs(kind.typical[name]):
            unseen.append(kind.id)
    return tuple(sorted(unseen))


def _next(
    verdict: Verdict, found: Search, kinds: Mapping[str, EffectKind], unseen: Sequence[str]
) -> NextFlight | None:
    """The flight that would tell more, where these left something open."""
    if verdict.word == "ambiguous":
        pairs = [(one.trial.id, rival) for one in verdict.causes for rival in ambiguous_with(one)]
        names = "; ".join(f"{one} or {other}" for one, other in pairs)
        parts = {part_for(kinds[id_]) for pair in pairs for id_ in pair}
        return next_flight(f"These flights do not tell apart: {names}.", parts)
    if verdict.word == "unexplained":
        on = {one.trial.id.rpartition(":")[2] for one in verdict.off_list}
        parts = {part for part in ("travel", "elevation", "time") if any(part in name for name in on)}
        parts |= {"motors"} if any("thrust" in name for name in on) or not on else set()
        return next_flight("What is missing should be seen over a wider range.", parts)
    seconds = sum(record.used_s for record in found.baseline.fit.problem.records)
    if seconds < _SHORT_s or len(unseen) > _MANY_UNSEEN:
        which = ", ".join(unseen[:6]) or "small effects"
        return next_flight(
            f"{seconds:.0f} s of free flight show too little to tell about {which}.",
            {part_for(kinds[id_]) for id_ in unseen},
        )
    return None


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
