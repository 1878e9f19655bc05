"""Which rig file a log fits: the shipped ones beside the one that was given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from heli_host.errors import HeliError
from heli_host.tables import Table, profile_text
from heli_sim.rig import Rig, load_rig, rig_names

from heli_lab.guess import thresholds
from heli_lab.guess.result import Ambiguity, Guess
from heli_lab.guess.run import flown, proposed


@dataclass(frozen=True)
class RigMatch:
    """Files, guessed by the rig that fits them.

    Parameters
    ----------
    rig : Rig
        The rig that they are held against.
    guesses : tuple of Guess
        In the files' order.
    """

    rig: Rig
    guesses: tuple[Guess, ...]


def guess_by_rigs(
    tables: Sequence[Table],
    rig: Rig | None = None,
    rate_Hz: float | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> RigMatch:
    """Guess files of one make by the rig given, and say where a shipped one fits them better. Where none is
    given, guess by the shipped one that fits best, and say which, or between which it is unsure.

    Parameters
    ----------
    tables : sequence of Table
        The files.
    rig : Rig, optional
        What is known of the rig.
    rate_Hz : float, optional
        Rows a second, for tables without times.
    progress : callable
        Called with the share of the work that is done.

    Raises
    ------
    FlightDataError
        When no rig makes sense of a table.
    """
    known = {name: load_rig(name) for name in rig_names() if rig is None or name != rig.name}
    if rig is not None:
        known[rig.name] = rig
    count = len(known) + 1
    by_rig: dict[str, list[tuple[Guess, Table]]] = {}
    refusals: dict[str, HeliError] = {}
    for number, (name, known_rig) in enumerate(known.items()):
        progress(number / count)
        try:
            by_rig[name] = [proposed(table, known_rig, rate_Hz) for table in tables]
        except HeliError as error:
            refusals[name] = error
    if not by_rig or (rig is not None and rig.name not in by_rig):
        raise refusals[rig.name if rig is not None else next(iter(refusals))]
    nats = {name: sum(guess.nats for guess, _ in guesses) for name, guesses in by_rig.items()}
    best = max(nats, key=lambda name: nats[name])
    chosen = rig.name if rig is not None else best
    progress(1.0 - 1.0 / count)
    guesses = [flown(guessed, part, known[chosen]) for guessed, part in by_rig[chosen]]
    others = [name for name in nats if name != chosen]
    # Rigs by which the same profile comes out are no two possibilities; that one of them fits better is told.
    differing = [name for name in others if _differs(by_rig[name], by_rig[chosen])]
    second = max(differing or others, key=lambda name: nats[name], default=None)
    if second is None:
        return RigMatch(known[chosen], tuple(guesses))
    ahead = nats[chosen] - nats[second]
    sentence = f"rig: held against {chosen}; {second}'s numbers fit by {abs(ahead):.0f} nats {_than(ahead)}"
    guesses = [replace(guess, evidence=(sentence, *guess.evidence)) for guess in guesses]
    # A rig that was given is believed until another one is clearly nearer; a choice of ours must be sure.
    enough = -thresholds.SURE_NATS if rig is not None else thresholds.SURE_NATS
    if differing and ahead < enough:
        doubt = Ambiguity(
            "the rig",
            chosen,
            second,
            f"its numbers fit by {abs(ahead):.0f} nats {_than(ahead)}, with other units or columns; "
            f"give --rig {second} if it is that",
        )
        guesses = [replace(guess, doubts=(doubt, *guess.doubts)) for guess in guesses]
    return RigMatch(known[chosen], tuple(guesses))


def _than(ahead: float) -> str:
    return "worse" if ahead >= 0.0 else "better"


def _differs(first: Sequence[tuple[Guess, Table]], second: Sequence[tuple[Guess, Table]]) -> bool:
    pairs = zip(first, second, strict=True)
    return any(profile_text(guess.profile) != profile_text(other.profile) for (guess, _), (other, _) in pairs)
