"""Options of a simulated board, their form in a `sil://` address, and the plant that they describe."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import parse_qsl, urlsplit

from heli_host.declaration import AXES

from heli_sim.errors import OptionError
from heli_sim.model import model_named
from heli_sim.model.effects import effects_with
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig
from heli_sim.sil.faults import FaultPlan, Interval, RigFaults, Span

_KEYS: Final = (
    *("board", "elf", "rig", "seed", "speed", "slice_ms", "flash", "reset_on_open"),
    *("process", "model", "effect", "effects"),
    *("flip", "drop", "double", "stall", "unplug"),
    *("encoder_out", "encoder_scale", "stop_switch", "supply_out"),
    *("motor_sign", "motors_swapped"),
)

NATIVE: Final = "native"
DUE: Final = "due"
AUTO: Final = "auto"
BOARDS: Final = (NATIVE, DUE, AUTO)


@dataclass(frozen=True)
class SilOptions:
    """Options of a simulation.

    Parameters
    ----------
    rig : str
        Name or file of the rig.
    seed : int
        Seed of everything random: where the encoders start, and the faults.
    speed : float or None
        Simulated seconds per second; None is as fast as the host keeps up.
    slice_ms : int
        In process: longest stretch of simulated time in one read, ms. The host's bytes reach the line at the
        beginning of a stretch.
    flash_file : str
        File that keeps the board's flash pages; if empty, they are not kept.
    board : str
        ``native``: the flight code compiled for this machine. ``due``: its ELF on an emulated Due. ``auto``:
        ``due`` when there is such an ELF.
    elf : str
        ELF for ``due``; empty for the newest that speaks this host's link.
    reset_on_open : bool or None
        Whether a rising DTR resets the board, as it does on a Due. None: behind a port it does so on ``due``;
        in process, where no port is opened, it does not.
    model : str
        Name of the model; empty for the one that the rig's file names, or ``multibody``.
    effects : tuple of str
        Effects beyond the model, such as ``rotor_lag=0.1``; they come before those of the rig's file.
    effect_files : tuple of str
        Python files with more effects.
    process : bool
        Whether a transport starts the board in a process of its own, behind a pseudo-terminal.

    Raises
    ------
    OptionError
        When a number is out of range.
    """

    rig: str = "makki2024"
    seed: int = 1
    speed: float | None = None
    slice_ms: int = 20
    flash_file: str = ""
    board: str = NATIVE
    elf: str = ""
    reset_on_open: bool | None = None
    faults: FaultPlan = field(default_factory=FaultPlan)
    rig_faults: RigFaults = field(default_factory=RigFaults)
    model: str = ""
    effects: tuple[str, ...] = ()
    effect_files: tuple[str, ...] = ()
    process: bool = False

    def __post_init__(self) -> None:
        if self.board not in BOARDS:
            raise OptionError(f"unknown board={self.board}", f"choose from {', '.join(BOARDS)}")
        if self.elf and self.board == NATIVE:
            raise OptionError("an ELF runs on board=due only", "add board=due, or leave elf out")
        if self.seed < 0:
            raise OptionError(f"seed={self.seed} must not be negative", "give 0 or more")
        if self.speed is not None and not (math.isfinite(self.speed) and self.speed > 0.0):
            raise OptionError(f"speed={self.speed} is invalid", "give a number above 0, or max")
        if not 1 <= self.slice_ms <= 1000:
            raise OptionError(f"slice_ms={self.slice_ms} is out of range", "give 1 to 1000")


def parse_url(url: str) -> SilOptions:
    """Read the options of an address such as ``sil://?rig=makki2024&seed=1&speed=max&flip=1e-4&stall=5:0.5``.
    Options that the address does not contain have their defaults.
    """
    parts = urlsplit(url)
    if parts.netloc or parts.path.strip("/"):
        raise OptionError(
            f"'{url}' names a host or path", "write sil://?rig=NAME&seed=1 for a simulated board"
        )
    try:
        pairs = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
    except ValueError:
        raise OptionError(
            f"'{url}' has no key=value after the question mark", "write sil://?rig=NAME&seed=1"
        ) from None
    keys = [key for key, _ in pairs]
    if repeated_keys := [key for key in dict(pairs) if keys.count(key) > 1]:
        raise OptionError(
            f"'{url}' has {', '.join(repeated_keys)} more than once", "separate values with commas"
        )
    return parse_options(dict(pairs))


def parse_options(values: dict[str, str]) -> SilOptions:
    """Read options from `values`, texts by key as in a ``sil://`` address. Options without a value have their
    defaults. An OptionError is raised for an unknown key or an unreadable value.
    """
    unknown = sorted(set(values) - set(_KEYS))
    if unknown:
        raise OptionError(f"unknown option {', '.join(unknown)}", f"choose from {', '.join(_KEYS)}")
    speed = values.get("speed", "max")
    return SilOptions(
        rig=values.get("rig", "makki2024"),
        seed=int(_number_of_option("seed", values.get("seed", "1"), whole=True)),
        speed=None if speed == "max" else _number_of_option("speed", speed),
        slice_ms=int(_number_of_option("slice_ms", values.get("slice_ms", "20"), whole=True)),
        flash_file=values.get("flash", ""),
        board=values.get("board", NATIVE),
        elf=values.get("elf", ""),
        # Without a value, None, which leaves the choice to the kind of board.
        reset_on_open=(
            _flag_of_option("reset_on_open", values["reset_on_open"]) if "reset_on_open" in values else None
        ),
        process=_flag_of_option("process", values.get("process", "0")),
        model=values.get("model", ""),
        # In an address, `effect` lists effects, and `effects` the Python files that declare more of them.
        effects=tuple(filter(None, values.get("effect", "").split(";"))),
        effect_files=tuple(filter(None, values.get("effects", "").split(";"))),
        faults=FaultPlan(
            flip=_number_of_option("flip", values.get("flip", "0")),
            drop=_number_of_option("drop", values.get("drop", "0")),
            double=_number_of_option("double", values.get("double", "0")),
            stalls=_intervals_of_option("stall", values.get("stall", "")),
            unplugs=_intervals_of_option("unplug", values.get("unplug", "")),
        ),
        rig_faults=RigFaults(
            encoders_out=parse_encoders_out("encoder_out", _texts_of_option(values, "encoder_out")),
            stop_switch=parse_times("stop_switch", _texts_of_option(values, "stop_switch")),
            supply_out=parse_times("supply_out", _texts_of_option(values, "supply_out")),
            encoder_scales=_encoder_scales("encoder_scale", _texts_of_option(values, "encoder_scale")),
            motor_signs=_motor_signs("motor_sign", _texts_of_option(values, "motor_sign")),
            motors_swapped=_flag_of_option("motors_swapped", values.get("motors_swapped", "0")),
        ),
    )


def _encoder_scales(key: str, texts: Sequence[str]) -> tuple[float, float, float]:
    """Read the scales of the encoders, 1 for those that are not named."""
    scales = dict.fromkeys(AXES, 1.0)
    for text in texts:
        axis, _, scale = text.partition(":")
        if axis not in scales:
            raise OptionError(f"unknown encoder '{axis}'", f"choose {', '.join(AXES)}")
        scales[axis] = _number_of_option(key, scale)
    return scales["elevation"], scales["pitch"], scales["travel"]


def _motor_signs(key: str, texts: Sequence[str]) -> tuple[int, int]:
    """Read the directions of the motors, 1 for those that are not named."""
    signs = {"front": 1, "back": 1}
    for text in texts:
        motor, _, sign = text.partition(":")
        if motor not in signs:
            raise OptionError(f"unknown motor '{motor}'", "choose front or back")
        signs[motor] = int(_number_of_option(key, sign, whole=True))
    return signs["front"], signs["back"]


def _texts_of_option(values: dict[str, str], key: str) -> list[str]:
    return list(filter(None, values.get(key, "").split(",")))


def _number_of_option(key: str, text: str, *, whole: bool = False) -> float:
    """Return the number of an option; an OptionError if the text is something else."""
    try:
        return int(text) if whole else float(text)
    except ValueError:
        kind = "whole number" if whole else "number"
        raise OptionError(f"{key}={text} is not a number", f"give a {kind}") from None


def _flag_of_option(key: str, text: str) -> bool:
    if text not in ("0", "1"):
        raise OptionError(f"{key}={text} is invalid", "give 0 or 1")
    return text == "1"


def _intervals_of_option(key: str, text: str) -> tuple[Span, ...]:
    """Read intervals such as ``5:1,20:3``: start and duration in s."""
    spans = []
    for part in filter(None, text.split(",")):
        start, _, duration = part.partition(":")
        spans.append(Span(_number_of_option(key, start), _number_of_option(key, duration)))
    return tuple(spans)


def parse_times(key: str, texts: Sequence[str]) -> tuple[Interval, ...]:
    """Read intervals of time that may have no end."""
    intervals = []
    for text in texts:
        start, _, duration = text.partition(":")
        start_s, duration_s = (
            _number_of_option(key, start),
            _number_of_option(key, duration) if duration else math.inf,
        )
        try:
            intervals.append(Interval(start_s, duration_s))
        except OptionError as error:
            raise OptionError(f"{key}={text}: {error.cause}", error.remedy) from None
    return tuple(intervals)


def parse_encoders_out(key: str, texts: Sequence[str]) -> tuple[tuple[str, Interval], ...]:
    """Read which encoders are unplugged, and when."""
    unplugged = []
    for text in texts:
        axis, _, times = text.partition(":")
        (interval,) = parse_times(key, [times or "0"])
        unplugged.append((axis, interval))
    return tuple(unplugged)


def plant_of(options: SilOptions) -> Plant:
    """Make a plant of rig, model and effects; its random numbers are drawn from the seed of the options."""
    # The rig's file may name the model whose parameters it holds, and effects; options come before both. A
    # RigError, EffectError or PlantError when one of the three is unknown, unreadable or has an invalid
    # value.
    rig = load_rig(options.rig)
    effects = effects_with(rig, options.effects, options.effect_files)
    model = model_named(options.model or rig.model or MultibodyModel.name, effects)
    return Plant(model, rig, options.seed)
