"""The option ``--gains``: published gains, for simulated boards."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

import typer

if TYPE_CHECKING:
    from heli_host.heli import Heli

SETS: Final = {"paper": "corrected", "paper-printed": "printed"}
"""Table 6 of the paper under the names that ``--gains`` takes."""

GainsOption = Annotated[
    str | None,
    typer.Option(
        "--gains",
        metavar="paper|paper-printed",
        help="Table 6 of the paper, P and I of travel exchanged or as printed; simulated boards only.",
        show_default=False,
    ),
]


def check_gains(gains: str | None, sil: bool) -> None:
    """Refuse gains that there are not, or that a real rig should not be flown with.

    Parameters
    ----------
    gains : str or None
        What was asked for.
    sil : bool
        Whether the board is simulated.

    Raises
    ------
    typer.BadParameter
        If the set is unknown, or the board is real.
    """
    if gains is None:
        return
    if gains not in SETS:
        raise typer.BadParameter(f"--gains {gains} is unknown; give {' or '.join(SETS)}")
    if not sil:
        raise typer.BadParameter(
            f"--gains {gains} does not stand the thrust lag of real rotors: add --sil, "
            "or set the gains one by one with heli-host params"
        )


def load_gains(heli: Heli, gains: str | None) -> None:
    """Set published gains in the board's memory; nothing is saved.

    Parameters
    ----------
    heli : Heli
        A connected board, idle.
    gains : str or None
        A name of `SETS`; None leaves the board's own.
    """
    if gains is None:
        return
    from heli_sim.tune.gains import paper_gains

    for name, value in paper_gains(SETS[gains]).items():
        heli.params[name] = value
