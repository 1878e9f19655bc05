"""Names that loggers give to their columns, in several languages and styles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

MOTORS: Final = ("front", "back")
SUMS: Final = ("sum", "difference")


@dataclass(frozen=True)
class Vocabulary:
    """Words of one style; `{}` in a pattern is the name of the angle or motor."""

    time: str
    angles: tuple[str, str, str]  # Elevation, pitch, travel
    motors: tuple[str, str]  # Front and back, without the quantity
    voltage: str  # Pattern of a motor's voltage
    sums: tuple[str, str]  # Total and difference of the voltages
    setpoint: str
    filtered: str
    rate: str
    current: str
    duty: str
    supply: str
    temperature: str
    counter: str


_TABLE: Final = """
plain: time | elevation, pitch, travel | front, back | {} voltage
  | voltage sum, voltage difference | {} setpoint | {} filtered | {} rate | {} current
  | {} duty cycle | supply voltage | board temperature | sample
snake: timestamp | elevation_angle, pitch_angle, travel_angle | front, rear | {}_motor
  | motor_sum, motor_diff | {}_ref | {}_filt | {}_vel | {}_motor_current | {}_motor_duty
  | v_supply | temp | seq
short: t | elev, pit, trav | f, b | V{}
  | Vs, Vd | {}_ref | {}_f | d_{} | I{} | D{} | Vbat | T | n
camel: Time | elevationMeasured, pitchMeasured, travelMeasured | Front, Back | voltage{}
  | voltageSum, voltageDiff | {}Target | {}LowPass | {}Dot | current{} | duty{} | batteryVoltage
  | cpuTemp | loopCount
greek: t | epsilon, rho, lambda | f, b | U_{}
  | U_sum, U_diff | {}_d | {}_hat | {}_dot | I_{} | d_{} | U_bat | theta_amb | k
german: Zeit | Höhenwinkel, Nickwinkel, Drehwinkel | vorne, hinten | Spannung {}
  | Spannung Summe, Spannung Differenz | {} Soll | {} gefiltert | {} Geschwindigkeit | Strom {}
  | Tastgrad {} | Versorgungsspannung | Temperatur | Nr
german short: Zeit | Elevation_ist, Nick_ist, Gier_ist | v, h | U_{}
  | U_Summe, U_Diff | {}_soll | {}_filt | {}_punkt | I_{} | PWM_{} | U_Akku | Temp | Zaehler
norwegian: Tid | Elevasjon, Helling, Vandring | foran, bak | Spenning {}
  | Spenning sum, Spenning differanse | {} ref | {} filtrert | {} hastighet | Strøm {}
  | Pådrag {} | Batterispenning | Temperatur | Teller
numbered: time | elevation, pitch, travel | 1, 2 | motor{}
  | u_sum, u_diff | {}_cmd | {}_lp | {}_rate | i{} | duty{} | vbus | temp | index
"""


def _parsed_table() -> dict[str, Vocabulary]:
    """Read `_TABLE`: per style the fields of a vocabulary, and last a style without names."""
    vocabularies = {}
    for entry in _TABLE.replace("\n  |", " |").strip().splitlines():
        style, _, text = entry.partition(":")
        time, angles, motors, voltage, sums, *others = (cell.strip() for cell in text.split(" | "))
        elevation, pitch, travel = angles.split(", ")
        front, back = motors.split(", ")
        total, difference = sums.split(", ")
        vocabularies[style] = Vocabulary(
            time, (elevation, pitch, travel), (front, back), voltage, (total, difference), *others
        )
    nameless = Vocabulary("", ("", "", ""), ("", ""), "", ("", ""), "", "", "", "", "", "", "", "")
    return {**vocabularies, "none": nameless}


VOCABULARIES: Final = _parsed_table()
"""Styles by name. `none` is a table without a header."""

UNIT_WORDS: Final = {
    "rad": ("rad",),
    "deg": ("deg", "°", "degrees"),
    "count": ("counts", "ticks", "count"),
    "mrad": ("mrad",),
    "V": ("V", "volt"),
    "mV": ("mV",),
    "percent": ("%", "percent"),
    "duty": ("1", "-"),
    "pwm": ("PWM",),
    "s": ("s", "sec"),
    "ms": ("ms",),
    "us": ("us", "µs"),
    "ns": ("ns",),
    "min": ("min",),
    "A": ("A",),
    "C": ("°C",),
}


def with_unit(name: str, unit: str, style: str) -> str:
    """Write a column's name with its unit in a `style`: brackets, parentheses, tail, slash, or none."""
    if not unit or style in ("none", "row"):
        return name
    patterns = {"brackets": "{} [{}]", "parentheses": "{} ({})", "tail": "{}_{}", "slash": "{} / {}"}
    return patterns[style].format(name, unit)
