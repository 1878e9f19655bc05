"""Shorter flights and less work, for the parts of documents and notebooks that are marked ``long``.

Each command and each cell still runs whole, from its inputs to its files and its asserts. `make long` runs
them at full length.
"""

from __future__ import annotations

import functools
import hashlib
import pickle
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

PLANS: Final = "plans"
"""Fly only the first seconds of a plan."""
WORK: Final = "work"
"""Use less of each flight, fewer refits, fewer iterations, coarser figures; analyse equal flights once."""
SEGMENTS_s: Final = 20.0
"""Duration of a plan's segments, s: at 16 s the sine of the plan `identify` is refused as too short."""
USED_s: Final = 16.0
"""Used part of each flight that a notebook diagnoses, s: at 11 s, hidden effects are not named."""
REFITS: Final = 2
"""Refits of a search for causes: with 1 no cause is named."""
ITERATIONS: Final = 20
"""Iterations of an optimizer, which the design of gains starts four times."""
DPI: Final = 20
"""Resolution of written figures, dots per inch."""


def shorten(parts: Iterable[str]) -> None:
    """Shorten `parts`, `PLANS` or `WORK`, of what this process does from now on."""
    import heli_host.fly.plan
    import heli_lab.explain
    import heli_lab.explain.run
    import heli_lab.fit.identify.run
    import scipy.optimize
    from matplotlib.figure import Figure

    if PLANS in parts:
        _wrap(heli_host.fly.plan, "parse_toml", _short_plan)
    if WORK in parts:
        _wrap(heli_lab.explain, "diagnose", _computed_once)
        _wrap(heli_lab.fit.identify.run, "identify", _computed_once)
        _wrap(heli_lab.explain.run, "prepare", _short_record)
        _wrap(heli_lab.explain.run, "search", _small_search)
        _wrap(scipy.optimize, "minimize", _few_iterations)
        _wrap(Figure, "savefig", _coarse_figure)


def _wrap(holder: Any, name: str, how: Callable[..., Any]) -> None:
    original = getattr(holder, name)

    @functools.wraps(original)
    def wrapped(*arguments: Any, **options: Any) -> Any:
        return how(original, *arguments, **options)

    setattr(holder, name, wrapped)


def _short_plan(parse: Callable[[str], dict[str, Any]], text: str) -> dict[str, Any]:
    """Read TOML, and leave out of a plan what comes after so many seconds."""
    values = parse(text)
    rows, left_s = values.get("segment"), SEGMENTS_s
    if not isinstance(rows, list):
        return values
    kept: list[Any] = []
    for row in rows:
        duration_s = row.get("duration_s", 0.0)
        if kept and duration_s > left_s:
            break
        # A first segment may be longer than all that is left; waypoints have their times in their points.
        kept.append({**row, "duration_s": left_s} if duration_s > left_s and "points" not in row else row)
        left_s -= duration_s
    return {**values, "segment": kept}


def _computed_once(compute: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Return the result of an earlier call with equal arguments, which a second run of a notebook makes."""
    if not all(isinstance(value, int | float | str) for value in options.values()):
        return compute(*arguments, **options)
    model, rig, *roles = arguments
    given = [[(f.t_s, f.angles_rad, f.voltages_V, f.parameters) for f in role] for role in roles]
    effects = [(effect.name, sorted(effect.values.items())) for effect in model.effects]
    named = (compute.__name__, model.name, effects, rig, given, options)
    key = hashlib.sha256(pickle.dumps(named)).hexdigest()
    # Next to the folder of the document, in which a test looks for what the document writes.
    kept = Path.cwd().with_name(f"result-{key}.pickle")
    if not kept.exists():
        kept.write_bytes(pickle.dumps(compute(*arguments, **options)))
    return pickle.loads(kept.read_bytes())


def _short_record(prepare: Callable[..., Any], flight: Any, *arguments: Any, **options: Any) -> Any:
    return prepare(flight.between(flight.t_s[0], flight.t_s[0] + USED_s), *arguments, **options)


def _small_search(search: Callable[..., Any], *arguments: Any, refits: float, **options: Any) -> Any:
    return search(*arguments, refits=min(refits, REFITS), **options)


def _few_iterations(
    minimize: Callable[..., Any], *arguments: Any, options: dict[str, Any] | None = None, **more: Any
) -> Any:
    return minimize(*arguments, options={**(options or {}), "maxiter": ITERATIONS}, **more)


def _coarse_figure(savefig: Callable[..., None], *arguments: Any, **options: Any) -> None:
    savefig(*arguments, **{**options, "dpi": DPI})
