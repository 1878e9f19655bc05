"""The same tuning for each method: five values of one constant, the best skill on an open split.

``python -m heli_benchmark.tests.tuning public`` prints the skill for each value. A method computes once per
case what does not depend on its constant.
"""

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from heli_host.errors import HeliError

from heli_benchmark.methods import terms
from heli_benchmark.scores import score_answer, scored_truth
from heli_benchmark.task import Answer, BenchmarkCase, check_answer, read_case, read_split

TUNED: dict[str, tuple[str, tuple[float, ...], tuple[str, ...]]] = {
    "stepwise": ("_MIN_NATS", (3.0, 6.0, 12.0, 25.0, 50.0), ()),
    "sindy": ("_THRESHOLD", (0.12, 0.2, 0.3, 0.45, 0.7), ()),
    "residual_tests": ("_SIGNIFICANCE", (0.05, 0.01, 1e-3, 1e-5, 1e-8), ()),
    "symbolic": ("_MIN_R2", (0.02, 0.05, 0.1, 0.2, 0.4), ("search_equations",)),
    "likelihood_ratio": ("_MIN_NATS", (12.0, 20.0, 35.0, 60.0, 100.0), ("identified_and_changed",)),
    "boosting": ("_SHARPNESS", (0.25, 0.5, 0.7, 1.0, 1.4), ()),
    "lisdd": ("_FALSE_DISCOVERIES", (0.05, 1e-3, 1e-6, 1e-12, 1e-24), ()),
}
"""By method: its constant, the values that are tried, and functions whose results do not depend on it."""


def main(folder: Path, *methods: str) -> int:
    """Print the skill of each method for each value of its constant."""
    split = read_split(folder)
    cases = [read_case(place, folder) for place in split.cases]
    truths = [scored_truth(split.truth(case.name)) for case in cases]
    regression = _once(terms.residual_regression)
    for method in methods or TUNED:
        constant, values, fixed = TUNED[method]
        module = import_module(f"heli_benchmark.methods.{method}")
        if hasattr(module, "residual_regression"):
            # A module has no attributes that mypy knows.
            module.residual_regression = regression  # type: ignore[attr-defined]
        if hasattr(module, "train"):
            module.train(folder)
        for name in fixed:
            setattr(module, name, _once(getattr(module, name)))
        skills = {}
        for value in values:
            setattr(module, constant, value)
            skills[value] = _skill(module, cases, truths)
        print(f"{method} {constant}: {', '.join(f'{v:g}: {skill:.3f}' for v, skill in skills.items())}")
    return 0


def _skill(module: ModuleType, cases: list[BenchmarkCase], truths: list[Any]) -> float:
    loss = base = 0.0
    for case, truth in zip(cases, truths, strict=True):
        try:
            answer = check_answer(module.diagnose(case), case.causes, case.name)
        except HeliError:
            # As in a run: a case without an answer counts as base rates.
            answer = Answer(case.causes.base_rates)
        score = score_answer(case.name, answer, truth, case.causes)
        loss, base = loss + score.log_loss, base + score.base_loss
    return 1.0 - loss / base


def _once(function: Callable[..., Any]) -> Callable[..., Any]:
    """Keep the results of a function by the name of a case, or the identity of another argument."""
    kept: dict[tuple[object, bool], Any] = {}

    def call(argument: object, weak_form: bool = False) -> Any:
        key = (getattr(argument, "name", id(argument)), weak_form)
        if key not in kept:
            kept[key] = function(argument, weak_form) if weak_form else function(argument)
        return kept[key]

    return call


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), *sys.argv[2:]))
