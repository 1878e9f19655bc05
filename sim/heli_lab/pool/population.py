"""A make of rigs: what its machines have in common, and what to expect of the next one."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from heli_sim.model.effects import catalogue, effect_numbers
from heli_sim.rig import Number, Rig

from heli_lab.errors import PoolError
from heli_lab.pool.machine import SURE, Machine, NumberEstimate
from heli_lab.pool.random_effects import RandomEffects, Share, der_simonian_laird, share

SPREAD: Final = 0.5
"""Standard deviation from machine to machine of one make before any was measured, over that of what the rig's
file says of a number; it counts as one machine. By judgement: a file's tolerance covers wrong measurements
too. Smaller: the second machine is believed to be the first. Larger: one machine says nothing of the next."""
_EFFECT_SPREAD: Final = 0.3
"""The same for an effect's number, over its pooled value: priors of the catalogue cover all makes."""
COMMON: Final = 0.5
"""Share of machines from which on an effect is taken to be the make's, and is part of the prior."""


@dataclass(frozen=True)
class RigPopulation:
    """Machines of one make, pooled.

    Parameters
    ----------
    machines : tuple of Machine
        What was pooled.
    numbers : Mapping of str to RandomEffects
        Numbers of the rig and of effects, those that flights tell something of.
    causes : Mapping of str to Share
        On how many machines each cause was found, of those whose flights could show it; the most frequent
        first.
    """

    machines: tuple[Machine, ...]
    numbers: Mapping[str, RandomEffects]
    causes: Mapping[str, Share]

    def expected(self, name: str, prior: NumberEstimate, spread: float) -> tuple[float, float]:
        """Tell what to expect of the number `name` of another machine, of which a file says `prior`: mean and
        standard deviation. `spread` is the standard deviation from machine to machine that is believed before
        any was measured.
        """
        measured = [measurement.numbers[name] for measurement in self.machines if name in measurement.numbers]
        if not measured:
            return prior.value, prior.std
        k = len(measured)
        tau2 = ((k - 1) * self.numbers[name].tau ** 2 + spread**2) / k
        weights = [1.0 / (measurement.std**2 + tau2) for measurement in measured]
        mean = sum(w * measurement.value for w, measurement in zip(weights, measured, strict=True)) / sum(
            weights
        )
        # Of the make's mean the file says something too.
        precision = sum(weights) + prior.std**-2.0
        centre = (mean * sum(weights) + prior.value * prior.std**-2.0) / precision
        return centre, (tau2 + 1.0 / precision) ** 0.5

    def prior(self, base: Rig, name: str) -> Rig:
        """Make the rig `name` that a new machine of the make begins with.

        Parameters
        ----------
        base : Rig
            The file that the machines were diagnosed with: numbers that no flight told anything of stay.
        name : str
            What the new rig is called, in its file and in messages.
        """
        source = f"pooled from {', '.join(machine.label for machine in self.machines)}"
        numbers = dict(base.numbers)
        for quantity, was in base.numbers.items():
            if quantity not in self.numbers or was.tolerance == 0.0:
                continue
            before = NumberEstimate(was.value, 0.5 * was.tolerance, was.unit)
            value, std = self.expected(quantity, before, SPREAD * before.std)
            text = f"{source}; before: {was.value:g} +- {was.tolerance:g}"
            numbers[quantity] = replace(was, value=value, tolerance=2.0 * std, source=text)
        effects: dict[str, Mapping[str, Number]] = dict(base.effects)
        kinds = catalogue()
        for id_, counted in self.causes.items():
            kind = kinds.get(id_)
            if kind is None or kind.baseline or counted.share < COMMON:
                continue
            names = [quantity.name for quantity in kind.parameters if quantity.name in self.numbers]
            priors = {n: machine.priors[n] for machine in self.machines for n in names if n in machine.priors}
            priors_ = {
                n: self.expected(n, priors[n], _EFFECT_SPREAD * abs(self.numbers[n].mean)) for n in names
            }
            bounds = kind.priors
            effects[id_] = effect_numbers(
                kind,
                {n: min(max(value, bounds[n].low), bounds[n].high) for n, (value, _) in priors_.items()},
                {n: 2.0 * std for n, (_, std) in priors_.items()},
                source,
            )
        text = f"{base.name}, as {len(self.machines)} machines of the make have it"
        return Rig(name, text, numbers, effects, base.model or self.machines[0].model)


def pool(machines: Sequence[Machine]) -> RigPopulation:
    """Pool the diagnoses of several machines.

    Raises
    ------
    PoolError
        When there is none, two have one name or say the same, or they were diagnosed with other rigs or
        models.
    """
    if not machines:
        raise PoolError("there is no diagnosis to pool", "give one for each machine")
    labels = [machine.label for machine in machines]
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        raise PoolError(f"two diagnoses are called {', '.join(twice)}", "rename their files")
    for first, other in itertools.combinations(machines, 2):
        if replace(first, label=other.label) == other:
            raise PoolError(
                f"{first.label} and {other.label} are the same diagnosis", "give one for each machine"
            )
    known = {(machine.rig, machine.model) for machine in machines}
    if len(known) > 1:
        list_ = "; ".join(
            f"{machine.label}: rig {machine.rig}, model {machine.model}" for machine in machines
        )
        raise PoolError(f"they are not of one make: {list_}", "diagnose all with the same --rig and --model")
    names = dict.fromkeys(name for machine in machines for name in machine.numbers)
    numbers = {}
    for name in names:
        measured = [machine.numbers[name] for machine in machines if name in machine.numbers]
        numbers[name] = der_simonian_laird(
            [measurement.value for measurement in measured], [measurement.std for measurement in measured]
        )
    causes = {}
    for id_ in dict.fromkeys(id_ for machine in machines for id_ in machine.causes):
        named = [machine for machine in machines if machine.causes.get(id_, 0.0) >= SURE]
        seen = [machine for machine in machines if machine in named or id_ not in machine.hidden]
        if seen:
            causes[id_] = share(len(named), len(seen))
    ordered = dict(sorted(causes.items(), key=lambda item: -item[1].share))
    return RigPopulation(tuple(machines), numbers, ordered)
