"""Format the paper's tables with our estimates, for a terminal and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from heli_sim.model.parts import AXES

if TYPE_CHECKING:
    from heli_sim.bench.thrust_curve import Line
    from heli_sim.plant import Plant

    from heli_lab.apps.paper.compare import ModelError
    from heli_lab.apps.paper.rig_table import RigTable
    from heli_lab.apps.paper.table6 import LoopVerdict
    from heli_lab.apps.paper.tables import Table


def table_lines(line: Line, by_rig: RigTable, tables: Sequence[Table]) -> list[str]:
    """Format Tables 2 to 5 for a terminal."""
    lines = [
        f"Fig. 15: F = {line.gain_N_per_V:.4f} within {line.gain_half:.4f} N/V "
        f"(V - {line.dead_zone_V:.3f} within {line.dead_zone_half:.3f} V); printed: 0.5839 (V - 1)",
        "",
        "'within': the printed tolerance, or half of an estimate's 95 % interval",
        "",
        "Table 2 (the multibody model is fitted to the bench tests)",
        f"  {'':19} {'printed':>8} {'rig file':>22} {'bench tests':>27}",
    ]
    for row in by_rig.rows:
        estimate = _estimate_text(row.estimate, row.half)
        printed = "-" if row.printed is None else f"{row.printed:g}"
        rig_file = f"{row.value:.4g} within {row.tolerance:g}" if row.tolerance else f"{row.value:.4f}"
        lines.append(
            f"  {row.name:19} {printed:>8} {rig_file:>22} {estimate:>27} {row.unit:9} {row.note}".rstrip()
        )
    for table in tables:
        multibody_error = by_rig.normalised[table.number]
        lines += [
            "",
            f"Table {table.number} (by masses: the formulas below (30), drag and P_18 corrected; "
            "bench tests: by (30))",
            f"  {'':22} {'printed':>22} {'by masses':>10} {'bench tests':>27}",
        ]
        for term in table.rows:
            tolerance = "" if term.tolerance is None else f" within {term.tolerance:.3g}"
            printed = "-" if term.printed is None else f"{term.printed:.5g}{tolerance}"
            estimate = _estimate_text(term.estimate, term.half)
            numbers = f"{printed:>22} {term.analytic:>10.4g} {estimate:>27}"
            lines.append(f"  {term.name:22} {numbers} {term.unit:14} {term.note}".rstrip())
        lines.append(
            f"  error of a 4 s prediction over the encoder's quantisation: (30) {table.normalised:.2f}, "
            f"multibody {multibody_error:.2f}"
        )
    return lines


def model_lines(model_errors: Sequence[ModelError]) -> list[str]:
    """Format the open-loop errors of the models for a terminal."""
    lines = [
        "Open-loop RMS error over 2 s, on sines of a multibody rig, with the parameters of the rig file",
        f"  {'model':14} {' '.join(f'{axis:>10}' for axis in AXES)}      over the encoder's quantisation",
    ]
    for model_error in model_errors:
        axis_errors_deg = " ".join(f"{model_error.rms_deg[axis]:>10.3f}" for axis in AXES)
        lines.append(f"  {model_error.model:14} {axis_errors_deg} deg  {model_error.normalised:.2f}")
    return lines


def gain_lines(verdicts: dict[str, list[LoopVerdict]]) -> list[str]:
    """Format the stability of each interpretation of Table 6 for a terminal, by name of the model."""
    reading = {"degrees": "pitch in deg", "u3": "u3 in V"}
    lines = ["Table 6 on the linearised rig: are pitch and travel stable, and up to which lag (399 ms: any)?"]
    for model, model_verdicts in verdicts.items():
        lines += ["", f"model {model}"]
        for verdict in model_verdicts:
            if verdict.growth_1_per_s < 0.0:
                step = (
                    f"15 deg step peaks at {verdict.peak_deg:.1f}, settles in {verdict.settling_time_s:.0f} s"
                )
                lag = f"to {1e3 * verdict.lag_s:3.0f} ms of thrust lag"
                text = f"stable,   decays at {-verdict.growth_1_per_s:.3f} 1/s, {lag}; {step}"
            else:
                text = (
                    f"unstable, grows at {verdict.growth_1_per_s:5.3f} 1/s, period {verdict.period_s:.2f} s"
                )
            law = f"{verdict.gains:10} {reading[verdict.reading]:13} derivative of {verdict.derivative:12}"
            lines.append(f"  {law} {text}")
    return lines


def tables_json(plant: Plant, line: Line, by_rig: RigTable, tables: Sequence[Table]) -> dict[str, Any]:
    """Return Tables 2 to 5 with their errors as a JSON object.

    Its keys are rig, model, thrust, table_2, table_3, table_4 and table_5.
    """
    return {
        "rig": plant.rig.name,
        "model": plant.model.name,
        "thrust": asdict(line),
        "table_2": {"rows": [asdict(row) for row in by_rig.rows]},
        **{
            f"table_{table.number}": {
                "rows": [asdict(row) for row in table.rows],
                "normalised_residual": {
                    "lumped": table.normalised,
                    "multibody": by_rig.normalised[table.number],
                },
            }
            for table in tables
        },
    }


def _estimate_text(value: float | None, half: float | None) -> str:
    """Format an estimate with half its interval, to two significant digits of the latter; a dash if there is
    no estimate.
    """
    if value is None or half is None:
        return "-"
    digits = max(0, 1 - math.floor(math.log10(half))) if half > 0.0 else 4
    return f"{value:.{digits}f} within {half:.{digits}f}"
