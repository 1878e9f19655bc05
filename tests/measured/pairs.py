"""The measured pairs, and models with given effects."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_lab.explain.prediction import (
    HORIZONS,
    ErrorReduction,
    FreeRun,
    compare_free_runs,
    error_reduction,
    free_run,
    free_runs,
)
from heli_lab.fit.identification import trace
from heli_lab.fit.problem import Fit, Problem, flight_constants
from heli_lab.fit.records import Record, prepare
from heli_lab.fit.shooting import solve
from heli_lab.fit.thresholds import BLOCK_S
from heli_lab.fit.uncertainty import floor_axes
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

MEASURED: Final = Path(__file__).resolve().parents[3] / "shared" / "data" / "measured"
PAIRS: Final = {
    "kristianhope": ("kristianhope_d4r2_t3", "kristianhope_d4r1_t3"),
    "ksteinsland": ("ksteinsland_d1_m25_ang45", "ksteinsland_d1_n25_00i"),
    "rendellc": ("rendellc_P4p2_noint_pf5", "rendellc_P2p1"),
    "nicolaiadil": ("nicolaiadil_d4_n40", "nicolaiadil_d4_n60_q10"),
}
"""The flight to fit and the one to predict, as the data's own description pairs them."""
FROM_s: Final = 5.0
"""The data's description asks for the take-off to be cut, up to here."""
LANDS_s: Final = {
    "ksteinsland_d1_m25_ang45": 33.0,
    "ksteinsland_d1_n25_00i": 31.9,
    "rendellc_P4p2_noint_pf5": 69.0,
    "rendellc_P2p1": 46.5,
}
"""And the landing: from here on the voltages are taken back. The other flights end in the air."""
RIG: Final = "quanser-course"
STEP_s: Final = 0.004
"""Longest step of the fits, as `diagnose` takes it."""
_MIN_VARIANCE: Final = 0.05
"""Least mean square that quantisation leaves, in its variances: an axis at rest would decide alone."""
MODELS: Final = (
    (),
    ("rotor_lag",),
    ("rotor_lag", "gyroscopic_torque"),
    ("rotor_lag", "gyroscopic_torque", "edgewise_flow"),
)
"""One model after the other, the same on every machine."""


@dataclass(frozen=True)
class PairFit:
    """A pair, fitted with given effects."""

    # `effects`: Their ids.
    # `fit`: Fit of the first flight.
    # `judges`: The other flight.
    # `run`: Its zeros and torques from its first 8 s, the rest predicted.
    # `gain`: Against the refitted baseline, on the other flight, by horizon and axis.

    effects: tuple[str, ...]
    fit: Fit
    judges: Record
    run: FreeRun
    gain: Mapping[str, Mapping[str, ErrorReduction]]


def add_pairs(parser: argparse.ArgumentParser) -> None:
    """Let a command take some of the pairs; its `pairs` are empty when none is given."""
    # `choices` would refuse the empty list that argparse makes of no pair.
    parser.add_argument("pairs", nargs="*", type=_pair, help=f"some of {', '.join(PAIRS)}; all without")


def _pair(name: str) -> str:
    if name not in PAIRS:
        raise argparse.ArgumentTypeError(f"there is no pair '{name}'; choose from {', '.join(PAIRS)}")
    return name


def flights(
    pair: str, back: bool = False, *, change: Callable[[Flight, str], Flight] | None = None
) -> tuple[Record, Record]:
    """Read a pair."""
    # `pair`: Key of `PAIRS`.
    # `back`: Whether to fit the second and predict the first.
    # `change`: Changes a whole flight of a given name before its part is cut out.
    # Returns: The flight to fit and the one to predict.
    rig = load_rig(RIG)
    names = PAIRS[pair][::-1] if back else PAIRS[pair]

    def record(name: str) -> Record:
        flight = read_flight(MEASURED / f"{name}.csv.gz")
        flight = change(flight, name) if change else flight
        return prepare(flight, rig, name, start_s=FROM_s, stop_s=LANDS_s.get(name))

    first, second = map(record, names)
    return first, second


def fit_pair(
    pair: str, models: Sequence[tuple[str, ...]] = MODELS, back: bool = False, *, once: bool = False
) -> list[PairFit]:
    """Fit models with given effects, each from the rig's parameters and from the model before it."""
    # `pair`: Key of `PAIRS`.
    # `models`: Ids of each model's effects; the first is what the others are compared with.
    # `back`: Whether to fit the second flight and predict the first.
    # `once`: Whether to start from the rig's parameters alone.
    # Returns: One fit per model.
    teaches, judges = flights(pair, back)
    fits: list[PairFit] = []
    for effects in models:
        starts = [None, fits[-1].fit.params] if fits and not once else [None]
        fit = fitted(effects, teaches, starts)
        (run,) = free_runs(fit, [judges])
        before = fits[0].run if fits else run
        fits.append(PairFit(effects, fit, judges, run, compare_free_runs([before], [run]).horizons))
    return fits


def fitted(
    effects: Sequence[str], record: Record, starts: Sequence[Mapping[str, float] | None] = (None,)
) -> Fit:
    """Fit a model to a flight."""
    # `effects`: Ids of the model's effects.
    # `record`: The flight.
    # `starts`: Values to start from; None for the rig's and the effects' typical ones.
    # Returns: The most likely on this flight; the first flight chooses among several maxima.
    kinds, rig = catalogue(), load_rig(RIG)
    model = MultibodyModel(tuple(kinds[id_].make(kinds[id_].typical) for id_ in effects))
    problem = Problem(model, rig, [record], step_s=STEP_s, priors=flight_constants(model, rig))
    return min((solve(problem, start=start) for start in starts), key=_unlikely)


def cross_validated(pair: PairFit) -> dict[str, dict[str, ErrorReduction]]:
    """Compare a model taught by the other flight with the same model taught by the judging flight itself."""
    # The judged part is halved, and each half is predicted by a fit to the other half and to the first 8 s;
    # this also gives zeros and torques of the flight.
    # `pair`: Estimate from the other flight.
    # Returns: By horizon and axis: `before` cross-validated, `after` taught by the other flight.
    windows = pair.run.fit.problem.windows(0)
    free = _rows(pair.judges, [(start, stop - start) for start, stop in pair.judges.segments])
    errors = []
    for part in (windows[: len(windows) // 2], windows[len(windows) // 2 :]):
        half = _rows(pair.judges, part)
        fit = fitted(pair.effects, _only(pair.judges, free & ~half), [None, pair.fit.params])
        problem = fit.problem
        errors.append(free_run(problem.model, problem.rig, fit.params, _only(pair.judges, half), 0.0).errors)
    return {key: error_reduction([half[key] for half in errors], [pair.run.errors[key]]) for key in HORIZONS}


def _rows(record: Record, windows: Sequence[tuple[int, int]]) -> npt.NDArray[np.bool_]:
    """Return the first row and the number of rows of each window."""
    inside = np.zeros(len(record.t_s), bool)
    for first, count in windows:
        inside[first : first + count] = True
    return inside


def _only(record: Record, rows: npt.NDArray[np.bool_]) -> Record:
    """The record with these rows as its free flight."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], rows.astype(int), [0]))))
    kept = zip(map(int, edges[::2]), map(int, edges[1::2]), strict=True)
    least = round(BLOCK_S / record.step_s)
    return replace(record, segments=tuple((start, stop) for start, stop in kept if stop - start > least))


def _unlikely(fit: Fit) -> float:
    """Minus the logarithm of the likelihood; a fit's own cost is in units of its own errors."""
    seen, problem = trace(fit), fit.problem
    mean_square = np.mean(seen.residual**2, axis=0)
    variance = floor_axes(np.maximum(mean_square, _MIN_VARIANCE), mean_square, seen.sigma_rad)
    blocks = problem.records[0].used_s / BLOCK_S
    effect_parameters = {name for effect in problem.model.effects for name in effect.priors}
    off = ((fit.theta - problem.parameter_vector.mean) / problem.parameter_vector.std)[
        [name not in effect_parameters for name in problem.names]
    ]
    return float(0.5 * (blocks * np.sum(np.log(variance) + mean_square / variance) + off @ off))
