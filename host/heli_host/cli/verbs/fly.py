"""``heli-host fly``: fly plans, and leave a log, a summary and a figure."""

from __future__ import annotations

from typing import Annotated

import typer

from heli_host.cli import simulated
from heli_host.cli.flight_command import FlightOptions, fly_plans
from heli_host.cli.gains import GainsOption, ParamsFileOption
from heli_host.cli.options import ClearFaultOption, FigureOption, JsonOption, LogOption, PortOption
from heli_host.cli.twin_options import OnAlarmOption, TwinOption
from heli_host.cli.verb import Verb


def fly(
    plans: Annotated[
        list[str],
        typer.Argument(metavar="PLAN...", help="Fly these plans: built-in (hover, sine) or TOML files."),
    ],
    port: PortOption = None,
    sil: simulated.SilOption = False,
    board: simulated.BoardOption = None,
    elf: simulated.ElfOption = None,
    rig: simulated.RigOption = None,
    model: simulated.ModelOption = None,
    effect: simulated.EffectOption = None,
    effect_file: simulated.EffectFilesOption = None,
    speed: simulated.SpeedOption = "1",
    seed: simulated.FlightSeedOption = None,
    blind: simulated.BlindOption = False,
    clear_fault: ClearFaultOption = False,
    gains: GainsOption = None,
    params: ParamsFileOption = None,
    twin: TwinOption = None,
    on_alarm: OnAlarmOption = None,
    log: LogOption = None,
    json: JsonOption = None,
    figure: FigureOption = None,
) -> None:
    """Take off, fly plans one after the other, and land.

    Writes the log, a summary and a figure into a new folder, flights/TIME/. If you give --log, --json or
    --figure, it writes only those, and always a log. Ctrl-C lands. A second Ctrl-C stops the motors.

    --blind seals what flew by a salted digest. The truth goes to LOG.truth.json next to the log. Keep it, and
    share the other files. `heli-host info LOG --truth LOG.truth.json` compares the two.

    Example: `heli-host fly hover sine --sil --speed 5`
    """
    from heli_host.fly.plan import load_plan

    options = FlightOptions(
        port=port,
        sil=sil,
        board=board,
        elf=elf,
        rig=rig,
        model=model,
        effect=effect,
        effect_file=effect_file,
        speed=speed,
        seed=seed,
        blind=blind,
        clear_fault=clear_fault,
        gains=gains,
        params=params,
        twin=twin,
        on_alarm=on_alarm,
        log=log,
        json=json,
        figure=figure,
    )
    flown = fly_plans(options, [load_plan(plan) for plan in plans], plan_names=plans)
    flown.report()
    flown.write()
    flown.end()


VERB = Verb(fly, "Fly")
