"""``--quick`` runs tests without a marker, and imports no file that is expensive as a whole."""

from __future__ import annotations

import pytest

pytest_plugins = ["pytester"]


def test_quick_leaves_expensive_tests_out_and_does_not_import_their_files(pytester: pytest.Pytester) -> None:
    pytester.makeini("[pytest]\nmarkers =\n  medium\n  slow\n  emulated\n")
    pytester.makepyfile(
        test_mixed="""
        import pytest

        def test_cheap(): pass

        @pytest.mark.slow
        def test_slow(): assert False

        @pytest.mark.medium
        def test_medium(): assert False
        """,
        test_expensive="""
        import pytest

        pytestmark = pytest.mark.emulated

        raise AssertionError("imported")
        """,
    )
    result = pytester.runpytest_inprocess("-p", "tests.running.quick", "--quick", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=1, deselected=2)


def test_without_the_option_all_run(pytester: pytest.Pytester) -> None:
    pytester.makeini("[pytest]\nmarkers = slow\n")
    pytester.makepyfile("import pytest\n\n@pytest.mark.slow\ndef test_slow(): pass\n")
    pytester.runpytest_inprocess("-p", "tests.running.quick", "-p", "no:cacheprovider").assert_outcomes(
        passed=1
    )
