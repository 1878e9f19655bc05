"""Parts of the forecast error of simulated rigs, and the true ones: ``python -m tests.twin.unlisted``.

Each rig has gusts and an effect. The diagnosis does not get the listed effect, so that it is unknown, unless
the case says otherwise. The true part of the disturbances is the forecast error of the true rig.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_lab.diagnose import diagnose
from heli_lab.fit_inputs import model_of
from heli_lab.watch.error_shares import error_shares
from heli_lab.watch.saved_rig import Forecaster, JudgedFlight, at_horizon, forecast_flights
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import AXES
from heli_sim.model.effects import catalogue, parse_effects
from heli_sim.rig import load_rig

from tests.running.alone import one_thread_each
from tests.twin.rigs import NOMINAL_RIG, random_flights, true_rig


@dataclass(frozen=True)
class Case:
    """A simulated rig with an effect."""

    seed: int  # Seed of rig, gusts and flights
    effect: str  # Effect and size
    is_listed: bool  # Whether the diagnosis gets the effect


CASES: Final = (
    Case(302, "cable_spring.travel=0.15", is_listed=False),
    Case(304, "thrust_asymmetry=0.1", is_listed=False),
    Case(306, "coulomb_friction.travel=0.03", is_listed=False),
    Case(302, "rotor_lag=0.1", is_listed=True),
    Case(310, "axis_tilt=0.05", is_listed=False),
    Case(306, "travel_drag_quadratic=1", is_listed=False),
)


def parts_of(case: Case) -> list[str]:
    """Diagnose two flights of a rig; return a line for each axis with the parts and the true ones."""
    true, nominal = true_rig(case.seed), load_rig(NOMINAL_RIG)
    effects = (*true.disturbed_model.effects, *parse_effects([case.effect]))
    model = MultibodyModel(effects)
    first, second = random_flights(model, true.rig, 10_000 * case.seed, 2)
    id_ = case.effect.partition("=")[0]
    kinds = {key: kind for key, kind in catalogue().items() if case.is_listed or key != id_}
    result = diagnose(MultibodyModel(), nominal, [first], [second], labels=["a", "b"], kinds=kinds, refits=80)
    fitted, judged = (
        [JudgedFlight(label, flight, (None, None))] for label, flight in (("a", first), ("b", second))
    )
    shares = error_shares(result, Forecaster(judged, model_of, nominal), lambda: fitted)
    true_model = MultibodyModel(tuple(effect for effect in effects if not effect.noise_inputs))
    true_errors = at_horizon(forecast_flights(true_model, true.rig, judged), baseline=None)
    lines = [f"{case}: {result.label}, curves {', '.join(shares.curves) or 'none'}"]
    for axis in AXES:
        of_axis = shares.axes[axis]
        total_deg2 = of_axis.before_deg**2
        parts = ", ".join(
            f"{name} {100 * part / total_deg2:.0f} %" for name, part in of_axis.parts_deg2.items()
        )
        true_unknown = 100 * (of_axis.after_deg**2 - true_errors.with_causes[axis] ** 2) / total_deg2
        where = f", larger with {of_axis.larger_where.text}" if of_axis.larger_where else ""
        lines.append(
            f"  {axis} {of_axis.before_deg:.3g} deg: {parts}; truly unknown {true_unknown:.0f} %{where}"
        )
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the parts of some cases, by number; all by default."""
    parser = argparse.ArgumentParser(prog="python -m tests.twin.unlisted", description=__doc__)
    parser.add_argument("cases", nargs="*", type=int, help="numbers of the cases, from 0")
    options = parser.parse_args(arguments)
    one_thread_each()
    for number in options.cases or np.arange(len(CASES)):
        print("\n".join(parts_of(CASES[number])), flush=True)


if __name__ == "__main__":
    main()
