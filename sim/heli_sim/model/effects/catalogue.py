"""The catalogue of effects: all effects that modules of this folder define, and those of users' files.

A new module in this folder needs no registration.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import inspect
import pkgutil
import traceback
from collections.abc import Iterator, Sequence
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
from heli_sim.rig import load_rig


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
