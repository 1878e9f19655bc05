"""Meanings of the symbols in the equations of causes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

_NAMES: Final = r"(?:\\[A-Za-z]+|[A-Za-z])(?:_(?:\{[^}]*\}|\\[a-z]+|[A-Za-z0-9]))?"
_SYMBOL: Final = re.compile(_NAMES)
_BOLD: Final = re.compile(r"\\boldsymbol\{(\w)\}")
_NO_SYMBOLS: Final = re.compile(
    r"\\mathrm\{[^}]*\}|e\^|\\[,; ]|"
    r"\\(?:frac|quad|dot|sin|cos|tanh|sqrt|min|max|to|cdot|approx|sum|pi|exp)(?![A-Za-z])"
)
"""Functions, units, spaces and relations of the equations."""
_GREEK: Final = {
    "theta": "\u03b8",
    "phi": "\u03c6",
    "psi": "\u03c8",
    "tau": "\u03c4",
    "omega": "\u03c9",
    "sigma": "\u03c3",
    "kappa": "\u03ba",
    "Delta": "\u0394",
}
_MEANINGS: Final[Mapping[str, str]] = {
    r"\theta": "elevation",
    r"\phi": "pitch",
    r"\psi": "travel",
    r"\tau": "torque that is added (of three: about elevation, pitch and travel)",
    r"\tau_\theta": "torque about elevation that is added",
    r"\tau_\phi": "torque about pitch that is added",
    r"\tau_\psi": "torque about travel that is added",
    r"\tau_n": "torque about the normal of the short arm",
    r"\omega": "angular rate of the axis",
    r"\omega_0": "angular rate of the axis without this friction",
    "A": "area that meets the air",
    "C_D": "drag coefficient",
    "F": "thrust by the baseline's thrust curve",
    "F_b": "thrust of the back rotor",
    "F_f": "thrust of the front rotor",
    "F_i": "thrust of rotor i, front (f) or back (b)",
    "H": "angular momentum of the rotors along the normal of the short arm",
    "J": "moment of inertia about the axis",
    r"L_\phi": "distance from the pitch axis down to the short arm",
    r"L_\theta": "distance from the elevation axis down to the long arm",
    "L_a": "distance from the elevation axis to the pitch axis",
    "L_b": "distance from the elevation axis to the counterweight",
    "L_h": "distance from the pitch axis to a propeller",
    "P_{18}": "equation (18) of the paper",
    "V_0": "voltage below which a rotor gives no thrust",
    "V_b": "voltage of the back motor",
    "V_f": "voltage of the front motor",
    "V_i": "voltage of motor i, front (f) or back (b)",
    "d": "random torque",
    "e_i": "voltage of motor i above the dead zone",
    "f": "viscous friction",
    "g": "gravity",
    "h_i": "height of rotor i above the table",
    "k": "thrust per volt above the dead zone",
    "m_j": "masses of the rig",
    "q": "angle of the axis",
    "r_j": "positions of the masses",
    "t": "time",
    "v": "speed of the rotors across their axes",
    "v_i": "speed of rotor i along its axis",
    "w_i": "speed of rotor i, as the voltage that holds it",
    "y": "angle that the encoder measures",
}
"""Meanings of symbols that are no parameters of an effect."""
_MEANINGS_BY_EFFECT: Final[Mapping[str, Mapping[str, str]]] = {
    "axis_tilt": {"U": "potential energy", "n": "unit vector along the travel axis"},
    "flywheel": {"w": "speed of both rotors, as the sum of the voltages that hold it"},
    "inflow_damping": {
        "i": "number of the rotor, front or back",
        "l": "1 if the loss is proportional to the thrust, 0 if it is the same at any thrust",
        "n": "unit vector along the rotors' axes",
        "r": "position of a rotor",
    },
    "random_torque": {"w": "white noise"},
    "supply_sag": {"l": "0 if each driver loses a share of its voltage, 1 if both lose the same voltage"},
}
"""Meanings of symbols that differ in the equation of an effect, by effect id without its axis."""


@dataclass(frozen=True)
class Meaning:
    """A symbol for a page, and its meaning."""

    letter: str  # letter, index: The symbol and its subscript, which may be empty
    index: str
    text: str  # The meaning in words


def symbols_of(equation: str) -> list[str]:
    """List the symbols of an `equation` in LaTeX, each once, in their order."""
    return list(dict.fromkeys(_SYMBOL.findall(_NO_SYMBOLS.sub(" ", _BOLD.sub(r"\1", equation)))))


def legend(effect: str, equation: str, parameters: Sequence[str] = ()) -> list[Meaning]:
    """Explain the symbols of an `equation` that no parameter of the `effect` explains."""
    meanings = {**_MEANINGS, **_MEANINGS_BY_EFFECT.get(effect.partition(".")[0], {})}
    return [
        Meaning(*_letter_and_index(symbol), meanings[symbol])
        for symbol in symbols_of(equation)
        if symbol in meanings and not explained_by(symbol, parameters)
    ]


def explained_by(symbol: str, meanings: Sequence[str]) -> bool:
    """Whether one of the `meanings` of parameters contains a `symbol`."""
    without_backslash = symbol.removeprefix("\\")
    word = re.compile(rf"(?<!\w){re.escape(without_backslash)}(?![\w'])")
    return any(word.search(meaning) for meaning in meanings)


def _letter_and_index(symbol: str) -> tuple[str, str]:
    """Return the letter and the subscript of a symbol, with Greek letters."""
    letter, _, index = symbol.partition("_")
    return _with_greek(letter), _with_greek(index.strip("{}"))


def _with_greek(text: str) -> str:
    """Replace a LaTeX name of a Greek letter by the letter."""
    return _GREEK.get(text.removeprefix("\\"), text)
