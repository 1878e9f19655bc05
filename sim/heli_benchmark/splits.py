"""Splits of the published benchmark: drawn, flown by MuJoCo, and written as folders."""

from __future__ import annotations

import hashlib
import hmac
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.data.files import read_file
from heli_host.data.flight import Flight
from heli_host.errors import FlightAborted
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from heli_benchmark.cases.published import PublishedCase, base_rates, published_cases, redrawn
from heli_benchmark.data_card import write_card
from heli_benchmark.errors import BenchmarkError
from heli_benchmark.task import (
    CAUSES_FILE,
    NOTHING,
    SCHEMA,
    UNLISTED,
    AxisSeries,
    flight_name,
    read_json,
    series_content,
    torques_file,
    write_case,
    write_commitments,
    write_json,
)
from heli_benchmark.truth import hidden_in
from heli_benchmark.visibility import true_torque_Nm, visibility

MIN_HEX_DIGITS: Final = 32
"""Shortest secret: 128 bits, as `openssl rand -hex 16` prints. A program could try all shorter ones: it
draws the cases of each, and compares the flights."""
_MOST_BYTES: Final = 1 << 20


@dataclass(frozen=True)
class Seal:
    """Secret of a sealed split."""

    secret: str  # Random hexadecimal digits

    @property
    def seed(self) -> int:
        """Seed of the cases, 256 bits."""
        return int(self._derived_key("cases"), 16)

    @property
    def digest(self) -> str:
        """SHA-256 of the secret. It is published with the split, and the secret after the scores."""
        return hashlib.sha256(self.secret.encode()).hexdigest()

    def salt(self, case: str) -> str:
        """Return random digits for the truth of a case."""
        # Without them, anybody could hash all truths that a case may have until one agrees with its
        # commitment.
        return self._derived_key(f"salt of {case}")

    def _derived_key(self, purpose: str) -> str:
        return hmac.new(bytes.fromhex(self.secret), purpose.encode(), hashlib.sha256).hexdigest()


def read_seal(path: Path) -> Seal:
    """Read a secret from its file."""
    remedy = "write random digits into it with `openssl rand -hex 32`"
    try:
        secret = read_file(path, _MOST_BYTES).decode("ascii").strip().lower()
        bytes.fromhex(secret)
    except OSError as error:
        raise BenchmarkError(f"cannot read {path}: {error.strerror or error}", remedy) from None
    except ValueError:
        raise BenchmarkError(f"{path} is not one line of hexadecimal digits", remedy) from None
    if len(secret) < MIN_HEX_DIGITS or len(set(secret)) < 4:
        raise BenchmarkError(f"the secret in {path} can be guessed: {len(secret)} digits", remedy)
    return Seal(secret)


def causes_content() -> dict[str, Any]:
    """Return the causes by name, as the causes file has them."""
    specs, content = catalogue(), {}
    meanings = {NOTHING: "nothing is hidden", UNLISTED: "a cause that this list does not have"}
    for name, rate in base_rates().items():
        if name in meanings:
            meaning, units = meanings[name], {}
        else:
            meaning = specs[name].equation
            units = {quantity.name: quantity.unit for quantity in specs[name].parameters}
        content[name] = {"base_rate": round(rate, 6), "meaning": meaning, "parameters": units}
    return content


MAX_ATTEMPTS: Final = 8
"""Draws of routes until another case is drawn. Fewer: easy rigs become more frequent. More: time."""
MAX_REDRAWS: Final = 8
"""Draws of a case until the split is given up. One of 120 cases needed a redraw."""
_TORQUE_DECIMALS: Final = 7
"""Decimals of torques in N m; the smallest hidden ones are 0.001 N m."""


def make_split(
    folder: Path,
    split: str,
    draw: int | Seal,
    count: int,
    *,
    truth_folder: Path | None = None,
    workers: int = 1,
    say: Callable[[str, int], None] | None = None,
) -> None:
    """Make a split; cases that exist are kept, so that an interrupted run continues."""
    # An open split grows if `count` is larger than before. A sealed one does not, because its commitments are
    # complete. Without a `truth_folder`, the truths of an open split are in its folder `truth`. `say` takes
    # the name of each case and how many cases exist.
    seal = draw if isinstance(draw, Seal) else None
    truth_folder = truth_folder or folder / "truth"
    if seal is not None and truth_folder.resolve().is_relative_to(folder.resolve()):
        raise BenchmarkError(f"{truth_folder} is inside {folder}", "give another folder with --truth")
    origin = {"seed": draw} if seal is None else {"secret_sha256": seal.digest}
    content = {"schema": SCHEMA, "split": split, **origin, "count": count, "causes": causes_content()}
    causes_file = folder / CAUSES_FILE
    if causes_file.exists() and not _has_all_earlier_cases(
        read_json(causes_file, "choose another folder"), content
    ):
        raise BenchmarkError(
            f"{folder} contains another split, or the split of another release",
            "choose another folder, or delete it",
        )
    for place in (folder / "cases", truth_folder):
        place.mkdir(parents=True, exist_ok=True)
    write_json(causes_file, content)
    cases = list(published_cases(draw.seed if isinstance(draw, Seal) else draw, count))
    waiting = [case for case in cases if not (folder / "cases" / case.name).exists()]
    write = partial(_fly_and_write, folder=folder, truth_folder=truth_folder, seal=seal)
    for done_count, name in enumerate(_results_in_order(write, waiting, workers), count - len(waiting) + 1):
        if say is not None:
            say(name, done_count)
    write_card(folder, content)
    if seal is not None:
        # Last: a split without commitments is not complete, and no method runs on it.
        write_commitments(folder, truth_folder, [case.name for case in cases])


def _has_all_earlier_cases(earlier: Mapping[str, Any], content: Mapping[str, Any]) -> bool:
    """Whether the split with `content` has all cases of the earlier one."""
    if "seed" not in content:
        return earlier == content
    return {**earlier, "count": content["count"]} == content and earlier["count"] <= content["count"]


def _results_in_order(
    work: Callable[[PublishedCase], str], cases: Sequence[PublishedCase], workers: int
) -> Iterator[str]:
    """Yield the result of `work` on each case, in order."""
    if workers == 1:
        yield from map(work, cases)
        return
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(work, cases)


def _fly_and_write(case: PublishedCase, folder: Path, truth_folder: Path, seal: Seal | None) -> str:
    """Fly a case, write its truth, then its flights, and return its name."""
    case, flights = fly_case(case)
    split_at = len(case.training_s)
    truth = truth_content(case, flights[0])
    if seal is not None:
        truth["salt"] = seal.salt(case.name)
    write_json(truth_folder / f"{case.name}.json", truth)
    if case.unlisted:
        # Beside the truth, whose digest is published: the draw gives these torques again.
        write_json(truth_folder / torques_file(case.name), unlisted_torques(case))
    # Renamed when complete: a folder in `cases` is whole.
    unfinished = folder / f"unfinished-{case.name}"
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir()
    write_case(unfinished, load_rig(case.rig_name), flights[:split_at], flights[split_at:])
    unfinished.rename(folder / "cases" / case.name)
    return case.name


def fly_case(case: PublishedCase) -> tuple[PublishedCase, tuple[Flight, ...]]:
    """Fly all flights of a case; if the rig leaves its angles, draw other routes, then another case."""
    for _ in range(1 + MAX_REDRAWS):
        for attempt in range(MAX_ATTEMPTS):
            case = replace(case, attempt=attempt)
            try:
                # The first flight last: the visibility of the causes needs its trajectory next.
                last = [case.fly(i, case.durations_s[i])[0] for i in range(1, len(case.durations_s))]
                return case, (case.fly(0, case.durations_s[0])[0], *last)
            except FlightAborted:
                continue  # `attempt` draws another route
        case = redrawn(case)
    raise BenchmarkError(
        f"{case.name} left the safe range of angles in each of {MAX_ATTEMPTS * (1 + MAX_REDRAWS)} attempts",
        "make it with another seed",
    )


def unlisted_torques(case: PublishedCase) -> dict[str, Any]:
    """Return the torques of the unlisted causes along each validation flight, as their file has them."""
    series = {}
    for number, duration_s in enumerate(case.validation_s):
        t_s, torque_Nm = true_torque_Nm(case, len(case.training_s) + number, duration_s)
        series[flight_name(number)] = AxisSeries(t_s, np.round(torque_Nm, _TORQUE_DECIMALS))
    return series_content(series, "Nm")


def truth_content(case: PublishedCase, flight: Flight) -> dict[str, Any]:
    """Return the truth of a case, as its file has it."""
    visible = visibility(case, case.durations_s[0])
    causes = {
        hidden.id: {
            "visibility_std": visible[hidden.id],
            "parameters": dict(hidden.scalars),
            "model_parameters": dict(hidden.start),
        }
        for hidden in hidden_in(case, float(flight.t_s[0]))
    }
    nominal, true_rig = load_rig(case.rig_name), case.rig()
    unlisted = {name: visible[f"off-{name}"] for name, _ in case.unlisted}
    return {
        "schema": SCHEMA,
        "case": case.name,
        "causes": causes,
        "unlisted": unlisted,
        "rig": {
            name: true_rig[name].value for name in true_rig if true_rig[name].value != nominal[name].value
        },
        "conditions": {
            "rig": case.rig_name,
            "rate_Hz": case.rate_Hz,
            "controller": case.controller,
            "weakly_excited": case.gentle,
            "fast_std_Nm": list(case.disturbances.gusts_Nm),
            "correlation_time_s": case.disturbances.correlation_time_s,
            "slow_std_Nm": list(case.disturbances.slow_std_Nm),
        },
    }
