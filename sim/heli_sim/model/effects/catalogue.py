"""The catalogue of effects, and effects as texts: on command lines and in rig files.

The catalogue has all effects that modules of this folder define, and those of users' files. A new module in
this folder needs no registration.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import importlib.util
import inspect
import pkgutil
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import casadi as ca
import numpy as np
from heli_host.data.files import decode_text

from heli_sim.errors import EffectError
from heli_sim.model.base import Model
from heli_sim.model.effect import Effect
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.paper import PaperModel
from heli_sim.rig import Number, Prior, Rig, load_rig


def catalogue(extra: Sequence[str | Path] = ()) -> dict[str, EffectSpec]:
    """Return all effects by their ids.

    The effects of the package come first, sorted by `EffectSpec.rank`, then those of users' files.

    Parameters
    ----------
    extra : sequence of str or Path
        Users' files, each a Python module with `EffectSpec` objects at its top level.

    Raises
    ------
    EffectError
        If a file cannot be read or contains no effect, or if an effect fails its check or has an id in use.
    """
    kinds = {kind.id: kind for kind in _built_in_effects()}
    for path in extra:
        for kind in _effects_in_file(Path(path)):
            if kind.id in kinds:
                raise EffectError(f"effect file {path}: '{kind.id}' exists already", "give it another id")
            kinds[kind.id] = kind
    return kinds


@functools.cache
def _built_in_effects() -> tuple[EffectSpec, ...]:
    """Return the effects of all modules of this folder; those of equal rank keep their order in the file."""
    package = importlib.import_module(__name__.rpartition(".")[0])
    names = sorted(f"{package.__name__}.{info.name}" for info in pkgutil.iter_modules(package.__path__))
    modules = [importlib.import_module(name) for name in names if name != __name__]
    kinds = [kind for module in modules for kind in _effects_in_module(module)]
    return tuple(sorted(kinds, key=lambda kind: kind.rank))


def _effects_in_file(path: Path) -> list[EffectSpec]:
    """Return the effects that a user's file defines, each checked in a model."""
    module = _import_file(path)
    kinds = list(_effects_in_module(module))
    if not kinds:
        raise EffectError(
            f"effect file {path} has no EffectSpec at its top level", "see docs/reference/effects.md"
        )
    for kind in kinds:
        _check_in_model(path, kind)
    return kinds


def _import_file(path: Path) -> ModuleType:
    """Import a user's effect file; an EffectError names the line that fails."""
    name = f"heli_sim_user_effects_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise EffectError(f"effect file {path} cannot be read", "give a Python file, FILE.py")
    module = importlib.util.module_from_spec(spec)
    try:
        # Not by the loader, which reads UTF-8 only.
        exec(compile(decode_text(path.read_bytes()), str(path), "exec"), module.__dict__)
    except SyntaxError as error:
        raise EffectError(
            f"effect file {path}, line {error.lineno}: {error.msg}", "correct this line"
        ) from None
    except Exception as error:  # noqa: BLE001 - a user's file may raise anything
        raise EffectError(
            f"effect file {path}: {_error_with_line(path, error)}", "correct this line"
        ) from None
    return module


def _effects_in_module(module: ModuleType) -> Iterator[EffectSpec]:
    """Yield the effects at the top level of a module, alone or in a tuple or list, each once."""
    found_ids = set()
    for value in vars(module).values():
        for kind in value if isinstance(value, tuple | list) else (value,):
            if isinstance(kind, EffectSpec) and id(kind) not in found_ids:
                found_ids.add(id(kind))
                yield kind


def _check_in_model(path: Path, kind: EffectSpec) -> None:
    """Evaluate a model with the effect, so that its errors appear here and not during a fit."""
    prefix = f"effect file {path}: '{kind.id}'"
    if not (inspect.isclass(kind.effect) and issubclass(kind.effect, Effect)):
        raise EffectError(
            f"{prefix}: effect must be a class derived from Effect", "see docs/reference/effects.md"
        )
    if not kind.numbers or not kind.size:
        raise EffectError(
            f"{prefix} has no number with size=True",
            "set size=True for the parameter that measures the effect",
        )
    models = [model for model in (MultibodyModel, PaperModel) if kind.suits(model())]
    if not models:
        raise EffectError(
            f"{prefix} needs {', '.join({*kind.needs, *kind.override})}, which no model has",
            "name what a model has; see docs/reference/effects.md",
        )
    try:
        kind.describe(kind.typical)
        for values in (kind.neutral, kind.typical):
            problem = _names_of_non_finite(models[0]((kind.make(values),)))
            if problem:
                raise EffectError(
                    f"{prefix}: {problem} is not a finite number at {values}", "make it finite there"
                )
    except EffectError:
        raise
    except Exception as error:  # noqa: BLE001 - a user's file may raise anything
        raise EffectError(f"{prefix}: {_error_with_line(path, error)}", "correct this line") from None


def _names_of_non_finite(model: Model) -> str:
    """Name the values of a model with an effect that are not finite; empty if all are finite."""
    x, u, t = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2), ca.SX.sym("t")
    p = ca.SX.sym("p", len(model.parameters))
    results = {
        "the rate of a state": model.dynamics(x, u, p, t),
        "a measured angle": model.measurement(x, u, p, t),
        "a state after a step": model.reset_map(x, u, p, t),
        "the noise of a state": model.diffusion(x, u, p, t, 1e-3, ca.SX.ones(model.noise_inputs)),
    }
    values = ca.Function(
        "values", [x, u, p, t], [ca.vertcat(r, ca.vec(ca.jacobian(r, p))) for r in results.values()]
    )
    state = np.full(len(model.states), 0.1)
    numbers = model.parameter_values(load_rig("makki2024"))
    for description, result in zip(results, values(state, [2.0, 2.1], numbers, 1.0), strict=True):
        if not np.isfinite(np.asarray(result)).all():
            return description + " or its derivative"
    return ""


def _error_with_line(path: Path, error: Exception) -> str:
    """Return an error in one line, with the line of the user's file that caused it."""
    lines = str(error).strip().splitlines() or [""]
    line_numbers = [f.lineno for f in traceback.extract_tb(error.__traceback__) if Path(f.filename) == path]
    prefix = f"line {line_numbers[-1]}: " if line_numbers else ""
    return f"{prefix}{type(error).__name__} {lines[0]}".strip()


def parse_effects(texts: Sequence[str], extra: Sequence[str | Path] = ()) -> tuple[Effect, ...]:
    """Read effects such as ``rotor_lag=0.1``, ``thrust_step.front=0.1@25``, ``axis_tilt=x_rad:0.02,y_rad:0``,
    in the order given.

    Parameters
    ----------
    texts : sequence of str
        ``ID`` alone gives all parameters their typical values. ``ID=VALUE`` sets the first parameter, and
        scales other sizes in proportion. ``ID=VALUE@SECONDS`` also sets the moment ``at_s``.
        ``ID=NAME:VALUE,NAME:VALUE`` sets parameters by name. Parameters that are not set keep their typical
        values. Units are those of the parameters.
    extra : sequence of str or Path
        Users' files with more effects.

    Raises
    ------
    EffectError
        When a text cannot be read, names an unknown effect or one twice, or a value is out of range.
    """
    kinds = catalogue(extra)
    return tuple(kind.make(values) for kind, values in _parse_texts(texts, kinds))


def effects_of(rig: Rig, extra: Sequence[str | Path] = ()) -> tuple[Effect, ...]:
    """Return the effects that a rig file states, with priors from its tolerances.

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
    effects = []
    for name, numbers in rig.effects.items():
        source_name = f"rig '{rig.name}'"
        kind = _find_effect(kinds, name, source_name)
        units = {parameter.name: parameter.unit for parameter in kind.numbers}
        for short_name, number in numbers.items():
            if short_name not in units:
                raise EffectError(
                    f"{source_name}: effect '{name}' has no '{short_name}'", f"choose from {', '.join(units)}"
                )
            if number.unit != units[short_name]:
                raise EffectError(
                    f"{source_name}: {short_name} of '{name}' is in '{number.unit}'",
                    f"give it in '{units[short_name]}'",
                )
        missing = [
            parameter.name
            for parameter in kind.numbers
            if parameter.prior is not None and parameter.name not in numbers
        ]
        if missing:
            raise EffectError(f"{source_name}: effect '{name}' lacks {', '.join(missing)}", "add each")
        effect = kind.make({kind.full(short_name): number.value for short_name, number in numbers.items()})
        effects.append(replace(effect, priors={**effect.priors, **_stated_priors(kind, numbers)}))
    return tuple(effects)


def effects_with(rig: Rig, texts: Sequence[str], extra: Sequence[str | Path] = ()) -> tuple[Effect, ...]:
    """Return the effects of a rig file and of `texts`; an effect in `texts` replaces that of the rig file.

    Parameters
    ----------
    texts : sequence of str
        Effects in the form that `parse_effects` reads.
    extra : sequence of str or Path
        Users' files with more effects.

    Raises
    ------
    EffectError
        When an effect of either is unknown or invalid.
    """
    from_texts = parse_effects(texts, extra)
    replaced = {effect.name for effect in from_texts}
    return *(effect for effect in effects_of(rig, extra) if effect.name not in replaced), *from_texts


def _stated_priors(kind: EffectSpec, numbers: Mapping[str, Number]) -> dict[str, Prior]:
    """Return priors, by full name, for the parameters whose tolerance a rig file states."""
    # A prior is normal within the effect's bounds. Its standard deviation is half the tolerance, as for the
    # parameters of the rig.
    priors = {}
    for parameter in kind.numbers:
        name, number = kind.full(parameter.name), numbers.get(parameter.name)
        prior = kind.priors.get(name)
        if prior is not None and number is not None and number.tolerance > 0.0:
            priors[name] = replace(prior, mean=number.value, std=0.5 * number.tolerance)
    return priors


def effect_numbers(
    kind: EffectSpec, values: Mapping[str, float], tolerances: Mapping[str, float], source: str
) -> dict[str, Number]:
    """Return the parameters of an effect by short name, in the form of ``rig.effects``.

    Parameters
    ----------
    values : Mapping[str, float]
        Values by full name; a missing one is that of `EffectSpec.neutral`.
    tolerances : Mapping[str, float]
        Half widths of the 95 % intervals by full name; a missing one is 0.
    source : str
        Origin of the numbers, for readers of the rig file.
    """
    all_values = {**kind.neutral, **values}
    return {
        parameter.name: Number(
            all_values[kind.full(parameter.name)],
            parameter.unit,
            tolerances.get(kind.full(parameter.name), 0.0),
            source,
        )
        for parameter in kind.numbers
    }


def _parse_texts(
    texts: Sequence[str], kinds: Mapping[str, EffectSpec]
) -> list[tuple[EffectSpec, dict[str, float]]]:
    """Read texts such as ``rotor_lag=0.1`` to effects with their parameters by full name."""
    result: list[tuple[EffectSpec, dict[str, float]]] = []
    for text in texts:
        name, equals_sign, values_text = text.partition("=")
        kind = _find_effect(kinds, name.strip(), f"--effect {text}")
        if any(kind is other for other, _ in result):
            raise EffectError(f"--effect {text}: '{kind.id}' is given twice", "give it once")
        values = dict(kind.typical)
        if equals_sign:
            values.update(_parse_values(kind, values_text, text))
        result.append((kind, values))
    return result


def _find_effect(kinds: Mapping[str, EffectSpec], name: str, source_name: str) -> EffectSpec:
    """Return an effect by its id; an EffectError that begins with `source_name` lists similar ids."""
    if name in kinds:
        return kinds[name]
    similar = [kind for kind in kinds if kind.startswith(f"{name}.")]
    similar = similar or difflib.get_close_matches(name, kinds, n=1)
    hint = f"did you mean {' or '.join(similar)}?" if similar else f"effects are: {', '.join(kinds)}"
    raise EffectError(f"{source_name}: unknown effect '{name}'", hint)


def _proportional_sizes(kind: EffectSpec, value: str) -> dict[str, str]:
    """Scale the other sizes of an effect like its first one, `value`; empty if that is not a number."""
    first, *others = (parameter for parameter in kind.numbers if parameter.size)
    try:
        factor = float(value) / first.typical
    except ValueError:
        return {}
    return {parameter.name: repr(factor * parameter.typical) for parameter in others}


def _parse_values(kind: EffectSpec, values_text: str, text: str) -> dict[str, float]:
    """Read the text after the equals sign, `values_text`; `text` is the whole text, for messages."""
    # The text is one value, with ``@`` and a time for an event, or pairs ``name:value`` separated by commas.
    if ":" not in values_text:
        value, at_sign, moment = values_text.partition("@")
        texts_by_name = {kind.numbers[0].name: value, **_proportional_sizes(kind, value)}
        if at_sign:
            texts_by_name["at_s"] = moment
    else:
        pairs = [pair.partition(":") for pair in values_text.split(",")]
        texts_by_name = {short_name.strip(): value for short_name, _, value in pairs}
    names = [parameter.name for parameter in kind.numbers]
    values = {}
    for spelled, value in texts_by_name.items():
        short_name = spelled.removeprefix(f"{kind.prefix}_")
        if short_name not in names:
            raise EffectError(
                f"--effect {text}: '{kind.id}' has no '{short_name}'", f"choose from {', '.join(names)}"
            )
        try:
            values[kind.full(short_name)] = float(value)
        except ValueError:
            raise EffectError(
                f"--effect {text}: {kind.full(short_name)} = '{value}' is not a number",
                "write it with a decimal point and without a unit",
            ) from None
    return values
