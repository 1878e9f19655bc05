"""Parallel maps give the same results as serial ones, and raise the exceptions of their threads; a diagnosis
leaves linear algebra one thread.
"""

import platform
import subprocess
import sys
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_lab.diagnose import diagnose
from heli_lab.explain.candidates import spline_candidates
from heli_lab.explain.comparison import ModelComparison
from heli_lab.explain.screening import Screening
from heli_lab.explain.term_scores import TermSignals, groups, score_groups
from heli_lab.threads import batches, default_thread_count, parallel_map, using_threads
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from threadpoolctl import threadpool_info, threadpool_limits

from tests.estimation.pendulum import RIG, flight_with_disturbances


class StopReading(Exception):
    """Ends a diagnosis at its first flight."""


PATIENCE_S = 60.0
"""How long a failing test waits."""
KINDS = [catalogue()[name] for name in ("rotor_lag", "periodic_torque.pitch", "thrust_step.front")]


def test_results_come_in_the_order_of_the_items() -> None:
    others_are_done = threading.Event()

    def last_at_first(number: int) -> tuple[int, str]:
        """The first item waits until the others are done, so that another thread does these."""
        if number == 5:
            others_are_done.set()
        assert number or others_are_done.wait(PATIENCE_S)
        return number, threading.current_thread().name

    results = parallel_map(last_at_first, range(6), 2)
    assert [number for number, _ in results] == list(range(6))
    assert len({name for _, name in results}) == 2


def test_batches_keep_the_order_and_are_not_larger_than_stated() -> None:
    sizes = [3, 2, 2, 5, 9, 1]
    assert batches(sizes, lambda size: size, 7) == [[3, 2, 2], [5], [9], [1]]
    assert batches([], len, 7) == []


def test_nested_parallel_map_runs_in_the_thread_that_calls_it() -> None:
    def nested(_: int) -> set[str]:
        return set(parallel_map(lambda _: threading.current_thread().name, range(4), 2))

    # If the inner map used the same pool, its workers would wait for each other forever.
    assert all(len(names) == 1 for names in parallel_map(nested, range(4), 2))


def test_exception_of_a_thread_is_raised_in_the_caller() -> None:
    with pytest.raises(ZeroDivisionError):
        parallel_map(lambda number: 1 / number, [1, 0, 2], 2)


def test_a_block_uses_the_given_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    with using_threads(3):
        with using_threads(threads=None):
            assert default_thread_count() == 3
        # Each item waits for the other two: with fewer threads they would never meet.
        meeting = threading.Barrier(3, timeout=PATIENCE_S)
        parallel_map(lambda _: meeting.wait(), range(3))
    assert default_thread_count() == 1


def test_linear_algebra_has_one_thread_during_a_diagnosis() -> None:
    counts: list[set[int]] = []

    def blas_threads() -> set[int]:
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    def flights() -> Iterator[Flight]:
        counts.append(blas_threads())
        raise StopReading
        yield

    with threadpool_limits(2, "blas"):
        with pytest.raises(StopReading):
            diagnose(MultibodyModel(), RIG, flights())
        counts.append(blas_threads())
    assert counts == [{1}, {2}]


@pytest.mark.diagnosis
def test_estimates_and_scores_are_the_same_with_one_thread_and_with_two() -> None:
    def estimates(threads: int) -> list[np.ndarray]:
        """Estimate a flight, and score candidates of all kinds, with a number of threads."""
        with using_threads(threads):
            estimate = (
                ModelComparison(MultibodyModel(), RIG, [flight_with_disturbances()], []).refit([]).estimate
            )
            screening = Screening(estimate)
            gains = [candidate.log_likelihood_gain for candidate in screening.splines()]
            gains += [candidate.log_likelihood_gain for candidate in screening.effects(KINDS)]
            signals = TermSignals(screening)
            equations = score_groups(
                screening, signals, groups(signals.spans)[:400]
            )  # 400 are enough, and quick
            gains += [equation.log_likelihood_gain for equation in equations]
            information = screening.spline_information(
                spline_candidates(screening.filtered.linearised_flights)
            )
        return [
            estimate.theta,
            estimate.disturbances.logarithms,
            np.array(gains),
            *(statistics.information for statistics in information),
        ]

    for single, double in zip(estimates(1), estimates(2), strict=True):
        assert np.array_equal(single, double)


# Allocates in two threads, and prints glibc's list of heaps as XML.
PRINT_HEAPS = """
import ctypes
from heli_lab.threads import limit_malloc_arenas, parallel_map
{first}
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
parallel_map(lambda _: [libc.malloc(50_000) for _ in range(100)], range(4), 2)
libc.malloc_info(0, ctypes.c_void_p.in_dll(libc, "stdout"))
"""


@pytest.mark.medium
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc has a heap per thread")
def test_limit_malloc_arenas_makes_all_threads_share_one_heap() -> None:
    heap_counts = [
        subprocess.run(
            [sys.executable, "-c", PRINT_HEAPS.format(first=first)],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.count("<heap nr=")
        for first in ("", "limit_malloc_arenas()")
    ]
    assert heap_counts[0] > 1
    assert heap_counts[1] == 1
