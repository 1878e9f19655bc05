"""``python -m tests.mutants``: change the firmware a little and report which changes no test notices."""

import argparse
import sys
import tempfile
from pathlib import Path

from tests.mutants import build_core, build_due, rotation, session
from tests.mutants.generate import BUILD, ROOT, BuildError, Mutant, digest, mutants_of, sample, sources
from tests.mutants.results import SURVIVED, DeclarationError, Result, Results, read_declarations, table
from tests.mutants.session import Runner


def main(words: list[str] | None = None) -> int:
    """Run the command; 1 if a mutant survived, 2 if nothing could be run."""
    options = _parser().parse_args(words)
    try:
        if options.rotating is not None:
            return rotation.repeat(rotation.killed(options.rotating, options.seed), on_due=False)
        if options.mistakes is not None:
            return rotation.repeat(rotation.mistakes(options.mistakes or None, options.seed), on_due=True)
        files = sources(only=options.files)
        if not files:
            print(
                f"error: no source of the firmware has {options.files!r} in its path; give part of one",
                file=sys.stderr,
            )
            return 2
        every = [m for file in files for m in mutants_of(file, (ROOT / file).read_text(encoding="utf-8"))]
        chosen = sample(every, options.seed, options.count)
        if options.only:
            chosen = [mutant for mutant in every if mutant.identity in options.only]
        if options.list:
            print("\n".join(f"{mutant.identity} {mutant.kind:<10} {mutant}" for mutant in chosen))
            return 0
        results = _run(chosen, options.tests)
    except (DeclarationError, BuildError, ValueError, session.ChildError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(table(results))
    if options.record:
        rotation.record(chosen, results)
    return int(any(result.outcome in SURVIVED for result in results))


def _run(chosen: list[Mutant], tests: str) -> list[Result]:
    session.preload()
    matches: list[Result] = []
    core = [mutant for mutant in chosen if mutant.file.startswith(build_core.FOLDER)]
    due = [mutant for mutant in chosen if mutant.file.startswith(build_due.FOLDER)]
    BUILD.mkdir(parents=True, exist_ok=True)
    # A folder of this run: the suite, too, runs a few mutants.
    with tempfile.TemporaryDirectory(prefix="work-", dir=BUILD) as work:
        if core:
            files = _of_tests(build_core.test_files(), tests)
            sources_digest, tests_digest = digest(*build_core.SOURCES), digest(*files)
            core_bench = build_core.CoreBench(Path(work) / "core", files)
            matches += _run_on(core_bench, core, sources_digest, tests_digest)
        if due:
            files = _of_tests(build_due.test_files(), tests)
            sources_digest = digest(*build_due.SOURCES)
            tests_digest = digest(*(files if tests else build_due.ROOMS))
            due_bench = build_due.DueBench(Path(work) / "due", files)
            matches += _run_on(due_bench, due, sources_digest, tests_digest)
    return matches


def _of_tests(files: list[str], part: str) -> list[str]:
    """Files of tests that have a text in their path; an empty text leaves all."""
    chosen = [file for file in files if part in file]
    if not chosen:
        raise BuildError(
            f"no file of tests that run this part has {part!r} in its path; give part of {files[0]}"
        )
    return chosen


def _run_on(
    bench: build_core.CoreBench | build_due.DueBench,
    mutants: list[Mutant],
    sources_digest: str,
    tests_digest: str,
) -> list[Result]:
    print("looking which test reaches which line; after a change of sources this takes minutes", flush=True)
    results = Results(BUILD / "results.jsonl")
    reach = bench.reach({mutant.file for mutant in mutants})
    runner = Runner(
        bench,
        reach,
        declarations=read_declarations(),
        results=results,
        sources=sources_digest,
        tests=tests_digest,
    )
    matches = []
    for number, result in enumerate(runner.run(mutants), 1):
        print(f"{number}/{len(mutants)} {result.outcome} {result.text}  ({result.by[-70:]})", flush=True)
        matches.append(result)
    return matches


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument(
        "--files", default=build_core.FOLDER, help="part of the path of the files [default: %(default)s]"
    )
    parser.add_argument(
        "--tests",
        default="",
        help="part of the path of the files of tests that run [default: all that apply]",
    )
    parser.add_argument("--seed", default="1", help="which mutants [default: 1]")
    parser.add_argument("--count", type=int, default=150, help="how many [default: 150]")
    parser.add_argument("--only", nargs="*", default=[], help="identities of single mutants")
    parser.add_argument("--list", action="store_true", help="print the mutants and run nothing")
    parser.add_argument(
        "--record", action="store_true", help="let the suite repeat the killed ones, in killed.json"
    )
    parser.add_argument("--rotating", type=int, help="so many of killed.json, each against its test only")
    parser.add_argument("--mistakes", type=int, help="so many of mistakes.toml, likewise; 0: all")
    return parser


if __name__ == "__main__":
    sys.exit(main())
