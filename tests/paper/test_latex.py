"""The LaTeX of a model says what the model computes, and can be drawn."""

import math
import re
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from heli_lab.apps.paper.lumped import Coefficients, LumpedModel, analytic
from heli_sim.model import Model, MultibodyModel, PaperModel, PaperPrintedModel
from heli_sim.model.effects import RotorLag, parse_effects
from heli_sim.model.latex import Equation, equations, symbol
from heli_sim.rig import load_rig

RIG = load_rig("makki2024").replace(torque_elevation=0.02, torque_pitch=-0.01, torque_travel=0.03)
STATE = np.array([0.2, -0.3, 0.4, 0.5, -0.6, 0.7])
VOLTS = np.array([2.1, 1.7])
TOKEN = re.compile(r"\\left[(|]|\\right[)|]|\\frac|\\,|\\[a-z]+|\d+(?:\.\d+)?|[A-Za-z]|[_^{}=+\-,]")
FUNCTIONS: dict[str, Callable[..., float]] = {
    r"\sin": math.sin,
    r"\cos": math.cos,
    r"\arctan": math.atan,
    r"\max": max,
    r"\min": min,
}


class Reader:
    """Evaluates what `equations` writes: sums of products of powers, brackets, fractions, functions."""

    def __init__(self, text: str, known: dict[str, float]) -> None:
        self.tokens, self.known = list(map(str, TOKEN.findall(text))), known

    def value(self) -> float:
        result = self.sum()
        assert not self.tokens, self.tokens
        return result

    def take(self, wanted: str | None = None) -> str:
        token = self.tokens.pop(0)
        assert wanted in (None, token), (wanted, token)
        return token

    def next(self) -> str:
        return self.tokens[0] if self.tokens else ""

    def sum(self) -> float:
        sign = -1.0 if self.next() == "-" and self.take() else 1.0
        result = sign * self.product()
        while self.next() in ("+", "-"):
            result += (1.0 if self.take() == "+" else -1.0) * self.product()
        return result

    def product(self) -> float:
        result = self.power()
        while self.next() == r"\,":
            self.take()
            result *= self.power()
        return result

    def power(self) -> float:
        if self.next() in FUNCTIONS:
            function, exponent = FUNCTIONS[self.take()], self.exponent()
            bracketed = self.next() == r"\left("
            arguments = self.arguments() if bracketed else [self.atom()]
            return float(function(*arguments) ** exponent)
        base = self.atom()
        return float(base ** self.exponent())

    def exponent(self) -> float:
        if self.next() != "^":
            return 1.0
        self.take("^")
        self.take("{")
        result = self.sum()
        self.take("}")
        return result

    def arguments(self) -> list[float]:
        self.take(r"\left(")
        out = [self.sum()]
        while self.next() == ",":
            self.take()
            out.append(self.sum())
        self.take(r"\right)")
        return out

    def atom(self) -> float:
        if self.next() == r"\left(":
            return self.arguments()[0]
        if self.next() == r"\left|":
            self.take()
            result = abs(self.sum())
            self.take(r"\right|")
            return result
        if self.next() == r"\frac":
            self.take()
            parts = []
            for _ in range(2):
                self.take("{")
                parts.append(self.sum())
                self.take("}")
            return parts[0] / parts[1]
        if self.next()[0].isdigit():
            return float(self.take())
        return self.known[self.name()]

    def name(self) -> str:
        out = self.take()
        while self.next() in ("_", "{") and (self.next() == "_" or out.startswith(r"\dot")):
            if self.next() == "_":
                out += self.take()
            depth = 0
            while True:
                token = self.take()
                depth += (token == "{") - (token == "}")
                out += token
                if depth == 0:
                    break
        return out


def evaluated(model: Model, lines: list[Equation]) -> dict[str, float]:
    known = {symbol(s.name): float(v) for s, v in zip(model.states, STATE, strict=False)}
    known |= {symbol(q.name): v for q, v in zip(model.parameters, model.parameter_values(RIG), strict=True)}
    known |= {"V_{f}": VOLTS[0], "V_{b}": VOLTS[1]}
    for rotor in "fb":
        known[f"F_{{{rotor}}}"] = Reader(lines[0].right, {**known, "V_{i}": known[f"V_{{{rotor}}}"]}).value()
    for line in lines[1:]:
        if not line.right.startswith("Q,"):
            known[line.left] = Reader(line.right, known).value()
    return known


def accelerations(model: Model) -> np.ndarray:
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    f = ca.Function("f", [x, u], [model.dynamics(x, u, ca.SX(model.parameter_values(RIG)))])
    return np.asarray(f(STATE, VOLTS)).ravel()[3:6]


ANGLES = (r"\theta", r"\phi", r"\psi")


@pytest.mark.parametrize("model", [PaperModel(), PaperPrintedModel()], ids=lambda model: model.name)
def test_the_lines_of_a_paper_model_evaluate_to_its_accelerations(model: Model) -> None:
    known = evaluated(model, equations(model))
    written = [known[rf"J_{{{a}}}\,\ddot{{{a}}}"] / known[f"J_{{{a}}}"] for a in ANGLES]
    assert written == pytest.approx(accelerations(model), rel=1e-12)


def test_the_lines_of_the_lumped_model_evaluate_to_its_accelerations() -> None:
    model = LumpedModel(Coefficients(analytic(RIG, corrected=False), {}))
    known = evaluated(model, equations(model))
    assert [known[rf"\ddot{{{a}}}"] for a in ANGLES] == pytest.approx(accelerations(model), rel=1e-12)


def test_the_mass_matrix_and_the_forces_written_are_those_of_the_multibody_model() -> None:
    model = MultibodyModel()
    known = evaluated(model, equations(model))
    x = ca.SX.sym("x", 6)
    at = model.operands(x, ca.SX(VOLTS), ca.SX(model.parameter_values(RIG)))
    F = ca.SX([known["F_{f}"], known["F_{b}"]])
    inertia, forces, energy = (
        np.asarray(value)
        for value in ca.Function(
            "f", [x], [model.inertia_kg_m2(at), model.thrust_torque_Nm(at, F), model.energy_J(at)]
        )(np.concatenate((STATE[:3], np.zeros(3))))
    )
    for row in range(3):
        for column in range(row, 3):
            assert known[f"M_{{{ANGLES[row]}{ANGLES[column]}}}"] == pytest.approx(
                inertia[row, column], rel=1e-12
            )
    assert known["U"] == pytest.approx(float(energy.item()), rel=1e-12)
    friction = [RIG[f"friction_{axis}"].value for axis in ("elevation", "pitch", "travel")]
    constant = [RIG[f"torque_{axis}"].value for axis in ("elevation", "pitch", "travel")]
    total = forces.ravel() - np.array(friction) * STATE[3:] + constant
    assert [known[f"Q_{{{a}}}"] for a in ANGLES] == pytest.approx(total, rel=1e-12)


@pytest.mark.medium
@pytest.mark.parametrize(
    "model",
    [PaperModel(), PaperPrintedModel(), MultibodyModel((RotorLag(0.1),))],
    ids=lambda model: model.name,
)
def test_every_line_can_be_drawn_and_none_is_a_wall(model: Model) -> None:
    from matplotlib.mathtext import MathTextParser

    parser = MathTextParser("path")
    for equation in equations(model):
        width = parser.parse(f"${equation.text}$", dpi=72)[0]
        # At 12 points a wide page holds about 800; the longest line is M_psi_psi.
        assert 0.0 < width < 1700.0, equation.text


@pytest.mark.medium
@pytest.mark.parametrize(("effect", "lines"), [("rotor_reaction_torque", 2), ("gyroscopic_torque", 3)])
def test_a_torque_of_the_thrust_has_its_lines(effect: str, lines: int) -> None:
    written = equations(MultibodyModel(parse_effects([effect])))
    of_effect = [each for each in written if effect.replace("_", r"\_") in each.left]
    assert len(of_effect) == lines and all("F_{f}" in each.text for each in of_effect)
