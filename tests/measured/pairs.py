"""The measured pairs, and models that are told which effects they have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from heli_host.log.flight_file import read_flight
from heli_lab.diagnose.candidate import Candidate
from heli_lab.diagnose.error_reduction import ErrorReduction, error_reduction
from heli_lab.diagnose.model_comparison import Comparison, Hypothesis
from heli_lab.identify import Record, prepare
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
TOLD: Final = (
    (),
    ("rotor_lag",),
    ("rotor_lag", "gyroscopic_torque"),
    ("rotor_lag", "gyroscopic_torque", "edgewise_flow"),
)
"""One model after the other, the same on every machine."""


@dataclass(frozen=True)
class Told:
    """A pair, fitted with given effects.

    Parameters
    ----------
    effects : tuple of str
        Their ids.
    hypothesis : Hypothesis
        The fit, and its prediction of the other flight.
    gain : dict of ErrorReduction
        Against the refitted baseline, on the other flight, by axis.
    """

    effects: tuple[str, ...]
    hypothesis: Hypothesis
    gain: dict[str, ErrorReduction]


def flights(pair: str, back: bool = False) -> tuple[Record, Record]:
    """Read a pair.

    Parameters
    ----------
    pair : str
        Key of `PAIRS`.
    back : bool
        Whether to fit the second and predict the first.

    Returns
    -------
    tuple of Record
        The flight to fit and the one to predict.
    """
    rig = load_rig(RIG)
    names = PAIRS[pair][::-1] if back else PAIRS[pair]
    first, second = (
        prepare(read_flight(MEASURED / f"{name}.csv.gz"), rig, name, start_s=FROM_s, stop_s=LANDS_s.get(name))
        for name in names
    )
    return first, second


def told(
    pair: str, models: Sequence[tuple[str, ...]] = TOLD, back: bool = False, *, once: bool = False
) -> list[Told]:
    """Fit models with given effects, each from the rig's parameters and from the model before it.

    Parameters
    ----------
    pair : str
        Key of `PAIRS`.
    models : sequence of tuple of str
        Ids of each model's effects; the first is what the others are compared with.
    back : bool
        Whether to fit the second flight and predict the first.
    once : bool
        Whether to start from the rig's parameters alone.

    Returns
    -------
    list of Told
        One a model.
    """
    train, held_out = flights(pair, back)
    comparison = Comparison(MultibodyModel(), load_rig(RIG), [train], [held_out])
    kinds = catalogue()
    found: list[Told] = []
    for effects in models:
        candidates = [Candidate(id_, kinds[id_].make(kinds[id_].typical), kinds[id_].size) for id_ in effects]
        starts = [None, found[-1].hypothesis.fit] if found and not once else [None]
        # A valley is chosen by the flight that is fitted; the other one is only looked at.
        best = min((comparison.refit(candidates, start) for start in starts), key=_unlikely)
        baseline = found[0].hypothesis if found else best
        found.append(Told(effects, best, error_reduction(baseline, best)))
    return found


def _unlikely(one: Hypothesis) -> float:
    """Minus the logarithm of the likelihood; a fit's own cost is in units of its own errors."""
    return float(0.5 * one.train.rows.sum() * one.train.neg2_log_likelihood.sum() + one.train.prior_penalty)
