"""``python -m tests.mutants``: make small changes in the firmware and report which of them no test notices."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.mutants import bench_core, session
from tests.mutants.declared import DeclarationError, read_declarations
from tests.mutants.generate import ROOT, Mutant, mutants_of, sample, sources
from tests.mutants.results import Result, Results, table
from tests.mutants.run import Runner
from tests.mutants.tree import BUILD, BuildError, digest


def main(words: list[str] | None = None) -> int:
    """Run the command; 1 if a mutant survived."""
    options = _parser().parse_args(words)
    try:
        read_declarations()
        files = sources(only=options.files)
        if not files:
            print(f"error: no source of the firmware has {options.files!r} in its path", file=sys.stderr)
            return 2
        chosen = sample(_all_mutants(files), options.seed, options.count)
        if options.only:
            chosen = [m for m in _all_mutants(files) if m.identity in options.only]
        if options.list:
            print("\n".join(f"{mutant.identity} {mutant.kind:<10} {mutant}" for mutant in chosen))
            return 0
        results = _run(chosen)
    except (DeclarationError, BuildError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(table(results))
    return int(any(result.outcome in ("survived", "unreached") for result in results))


def _run(chosen: list[Mutant]) -> list[Result]:
    session.preload()
    work = BUILD / "work"
    found: list[Result] = []
    kept = Results(BUILD / "results.jsonl")
    declarations = read_declarations()
    core = [mutant for mutant in chosen if mutant.file.startswith("firmware/core")]
    if core:
        bench = bench_core.CoreBench(work / "core")
        print("looking which test reaches which line; this takes minutes when sources or tests have changed", flush=True)
        reach = bench.reach()
        runner = Runner(
            bench, reach, declarations, kept, digest(*bench_core.SOURCES), digest(*bench_core.test_files())
        )
        for number, result in enumerate(runner.run(core), 1):
            print(f"{number}/{len(core)} {result.outcome} {result.text}  ({result.by[-70:]})", flush=True)
            found.append(result)
    return found


def _all_mutants(files: list[str]) -> list[Mutant]:
    return [m for file in files for m in mutants_of(file, (ROOT / file).read_text(encoding="utf-8"))]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--files", default="firmware/core", help="part of the path of the files [default: firmware/core]")
    parser.add_argument("--seed", default="1", help="which mutants [default: 1]")
    parser.add_argument("--count", type=int, default=150, help="how many [default: 150]")
    parser.add_argument("--only", nargs="*", default=[], help="identities of single mutants")
    parser.add_argument("--list", action="store_true", help="print the mutants and run nothing")
    return parser


if __name__ == "__main__":
    sys.exit(main())
