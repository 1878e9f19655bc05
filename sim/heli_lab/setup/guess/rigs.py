"""Find the rig file that fits a log best: a shipped one, or the one that the user gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from heli_host.data.tables import Table, profile_text
from heli_host.errors import HeliError
from heli_sim.rig import Rig, load_rig, rig_names

from heli_lab.setup.guess import thresholds
from heli_lab.setup.guess.known import NOTHING_KNOWN, KnownEntries
from heli_lab.setup.guess.result import Ambiguity, Guess
from heli_lab.setup.guess.run import check_by_simulation, propose


@dataclass(frozen=True)
class RigMatch:
    """Guesses of several files of one rig, with the rig that fits them.

    Parameters
    ----------
    rig : Rig
        The rig file that units and zeros come from.
    guesses : tuple of Guess
        One per file, in the order of the files; all have the same profile.
    """

    rig: Rig
    guesses: tuple[Guess, ...]


def guess_by_rigs(
    tables: Sequence[Table],
    rig: Rig | None = None,
    rate_Hz: float | None = None,
    known: KnownEntries = NOTHING_KNOWN,
    progress: Callable[[float], None] = lambda share: None,
) -> RigMatch:
    """Guess the profile of files of one rig, with a given rig file or with the shipped one that fits best.

    The guess reports which rig file it used. It is ambiguous if another rig file fits much better than the
    given one, or if two shipped ones fit about equally well and give different profiles.

    Parameters
    ----------
    tables : sequence of Table
        Logs of one rig, from one program.
    rig : Rig, optional
        Rig file to use.
    rate_Hz : float, optional
        Sampling rate [Hz], for tables without times.
    known : KnownEntries
        Entries of the profile that the user knows.
    progress : callable
        Called with the completed share of the work, 0 to 1.

    Raises
    ------
    FlightDataError
        When a table cannot be interpreted with any rig.
    """
    rigs = {name: load_rig(name) for name in rig_names() if rig is None or name != rig.name}
    if rig is not None:
        rigs[rig.name] = rig
    work_steps = len(rigs) + 1
    proposals: dict[str, Guess] = {}
    longest_parts: dict[str, list[Table]] = {}
    refusals: dict[str, HeliError] = {}
    for number, (name, candidate) in enumerate(rigs.items()):
        progress(number / work_steps)
        try:
            proposals[name], longest_parts[name] = propose(tables, candidate, rate_Hz, known)
        except HeliError as error:
            refusals[name] = error
    if not proposals or (rig is not None and rig.name not in proposals):
        raise refusals[rig.name if rig is not None else next(iter(refusals))]
    best = max(proposals, key=lambda name: proposals[name].log_likelihood)
    chosen = rig.name if rig is not None else best
    progress(1.0 - 1.0 / work_steps)
    guesses = check_by_simulation(proposals[chosen], longest_parts[chosen], rigs[chosen])
    evidence, ambiguities = _compare_with_second(proposals, chosen, is_given=rig is not None)
    guesses = [
        replace(
            guess,
            evidence=(*evidence, *guess.evidence),
            ambiguities=(*ambiguities, *guess.ambiguities),
        )
        for guess in guesses
    ]
    return RigMatch(rigs[chosen], tuple(guesses))


def _compare_with_second(
    proposals: Mapping[str, Guess], chosen: str, *, is_given: bool
) -> tuple[list[str], list[Ambiguity]]:
    """Compare the chosen rig file with the best of all others. Returns `evidence`, `ambiguities`."""
    others = [name for name in proposals if name != chosen]
    # Rigs that give the same profile are not an ambiguity, but the better fit is reported.
    profile = profile_text(proposals[chosen].profile)
    differing = [name for name in others if profile_text(proposals[name].profile) != profile]
    second = max(differing or others, key=lambda name: proposals[name].log_likelihood, default=None)
    if second is None:
        return [], []
    lead_nats = proposals[chosen].log_likelihood - proposals[second].log_likelihood
    comparison = f"{abs(lead_nats):.0f} nats {'worse' if lead_nats >= 0.0 else 'better'}"
    evidence = [f"rig: compared with {chosen}; {second} fits {comparison}"]
    # A given rig is used unless another one fits clearly better; an automatic choice must win clearly.
    required_nats = -thresholds.DECISIVE_NATS if is_given else thresholds.DECISIVE_NATS
    if not differing or lead_nats >= required_nats:
        return evidence, []
    reason = f"it fits {comparison}, with other units or columns; if it is your rig, give --rig {second}"
    return evidence, [Ambiguity("the rig", chosen, second, reason)]
