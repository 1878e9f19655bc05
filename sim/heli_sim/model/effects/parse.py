"""Effects as text, on command lines and in rig files."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from heli_sim.errors import EffectError
from heli_sim.model.effect import Effect
from heli_sim.model.effects.catalogue import catalogue
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.rig import Number, Prior, Rig


def parse_effects(texts: Sequence[str], extra: Sequence[str | Path] = ()) -> tuple[Effect, ...]:
    """Read effects such as ``rotor_lag=0.1``, ``thrust_step.front=0.1@25``, ``axis_tilt=x_rad:0.02,y_rad:0``,
    in the order given.

    Parameters
    ----------
    texts : sequence of str
        ``ID`` alone has its typical size; ``ID=VALUE`` sets its first number, and others that are sizes too
        in the typical proportion; ``ID=VALUE@SECONDS`` also the moment ``at_s``; ``ID=NAME:VALUE,NAME:VALUE``
        any of them. The rest is typical. Units are those of the numbers.
    extra : sequence of str or Path
        Users' files with more effects.

    Raises
    ------
    EffectError
        When a text cannot be read, names an unknown effect or one twice, or a value is out of range.
    """
    kinds = catalogue(extra)
    return tuple(kind.make(values) for kind, values in _each(texts, kinds))


def effects_of(rig: Rig, extra: Sequence[str | Path] = ()) -> tuple[Effect, ...]:
    """Effects that a rig file states.

    Parameters
    ----------
    extra : sequence of str or Path
        Users' files with more effects.

    Raises
    ------
    EffectError
        When an effect or a number of it is unknown, in another unit, missing or out of range.
    """
    kinds = catalogue(extra)
    made = []
    for name, numbers in rig.effects.items():
        where = f"rig '{rig.name}'"
        kind = _known(kinds, name, where)
        units = {parameter.name: parameter.unit for parameter in kind.numbers}
        for what, number in numbers.items():
            if what not in units:
                raise EffectError(
                    f"{where}: effect '{name}' has no '{what}'", f"choose from {', '.join(units)}"
                )
            if number.unit != units[what]:
                raise EffectError(
                    f"{where}: {what} of '{name}' is in '{number.unit}'", f"give it in '{units[what]}'"
                )
        missing = [
            parameter.name
            for parameter in kind.numbers
            if parameter.prior is not None and parameter.name not in numbers
        ]
        if missing:
            raise EffectError(f"{where}: effect '{name}' lacks {', '.join(missing)}", "add each")
        effect = kind.make({kind.full(what): number.value for what, number in numbers.items()})
        made.append(replace(effect, priors={**effect.priors, **_stated_priors(kind, numbers)}))
    return tuple(made)


def effects_with(rig: Rig, texts: Sequence[str], extra: Sequence[str | Path] = ()) -> tuple[Effect, ...]:
    """Effects that a rig file states, then those of `texts`, which replace stated ones of the same name.

    Parameters
    ----------
    texts : sequence of str
        As `parse_effects` takes them.
    extra : sequence of str or Path
        Users' files with more effects.

    Raises
    ------
    EffectError
        When an effect of either is unknown or invalid.
    """
    given = parse_effects(texts, extra)
    names = {effect.name for effect in given}
    return *(effect for effect in effects_of(rig, extra) if effect.name not in names), *given


def _stated_priors(kind: EffectSpec, numbers: Mapping[str, Number]) -> dict[str, Prior]:
    """Priors, by full name, of the parameters whose tolerance a rig file states: normal within the effect's
    bounds, with half the tolerance as standard deviation, as for the rig's parameters.
    """
    return {
        name: replace(prior, mean=numbers[what].value, std=0.5 * numbers[what].tolerance)
        for what, name in ((parameter.name, kind.full(parameter.name)) for parameter in kind.numbers)
        for prior in [kind.priors.get(name)]
        if prior is not None and what in numbers and numbers[what].tolerance > 0.0
    }


def effect_numbers(
    kind: EffectSpec, values: Mapping[str, float], tolerances: Mapping[str, float], source: str
) -> dict[str, Number]:
    """Parameters of an effect by short name, as in ``rig.effects``.

    Parameters
    ----------
    values : Mapping[str, float]
        Values by full name; `EffectSpec.neutral` for those not given.
    tolerances : Mapping[str, float]
        Half widths of the 95 % intervals by full name; 0 for those not given.
    source : str
        Where they come from.
    """
    known = {**kind.neutral, **values}
    return {
        parameter.name: Number(
            known[kind.full(parameter.name)],
            parameter.unit,
            tolerances.get(kind.full(parameter.name), 0.0),
            source,
        )
        for parameter in kind.numbers
    }


def _each(texts: Sequence[str], kinds: Mapping[str, EffectSpec]) -> list[tuple[EffectSpec, dict[str, float]]]:
    """Read texts such as ``rotor_lag=0.1`` to effects with their parameters by full name."""
    result: list[tuple[EffectSpec, dict[str, float]]] = []
    for text in texts:
        name, equals, rest = text.partition("=")
        kind = _known(kinds, name.strip(), f"--effect {text}")
        if any(kind is other for other, _ in result):
            raise EffectError(f"--effect {text}: '{kind.id}' is given twice", "give it once")
        values = dict(kind.typical)
        if equals:
            values.update(_values(kind, rest, text))
        result.append((kind, values))
    return result


def _known(kinds: Mapping[str, EffectSpec], name: str, where: str) -> EffectSpec:
    if name in kinds:
        return kinds[name]
    near = [kind for kind in kinds if kind.startswith(f"{name}.")]
    near = near or difflib.get_close_matches(name, kinds, n=1)
    hint = f"did you mean {' or '.join(near)}?" if near else f"effects are: {', '.join(kinds)}"
    raise EffectError(f"{where}: unknown effect '{name}'", hint)


def _in_proportion(kind: EffectSpec, value: str) -> dict[str, str]:
    """Return the texts of the other sizes in proportion to the first one, if that is a number."""
    first, *others = (parameter for parameter in kind.numbers if parameter.size)
    try:
        factor = float(value) / first.typical
    except ValueError:
        return {}
    return {parameter.name: repr(factor * parameter.typical) for parameter in others}


def _values(kind: EffectSpec, rest: str, text: str) -> dict[str, float]:
    """Read what follows the equals sign: one value, with ``@`` and a time for an event, or pairs
    ``name:value`` between commas.
    """
    if ":" not in rest:
        value, at, moment = rest.partition("@")
        given = {kind.numbers[0].name: value, **_in_proportion(kind, value)}
        if at:
            given["at_s"] = moment
    else:
        pairs = [pair.partition(":") for pair in rest.split(",")]
        given = {what.strip(): value for what, _, value in pairs}
    names = [parameter.name for parameter in kind.numbers]
    values = {}
    for spelled, value in given.items():
        what = spelled.removeprefix(f"{kind.prefix}_")
        if what not in names:
            raise EffectError(
                f"--effect {text}: '{kind.id}' has no '{what}'", f"choose from {', '.join(names)}"
            )
        try:
            values[kind.full(what)] = float(value)
        except ValueError:
            raise EffectError(
                f"--effect {text}: {kind.full(what)} = '{value}' is not a number",
                "write it with a decimal point and without a unit",
            ) from None
    return values
