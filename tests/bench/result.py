"""Measured numbers and their promised bounds."""

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Promise:
    """A bound on one number of bench.json."""

    key: str  # Its key
    meaning: str  # Meaning, for the table
    bound: float | None  # Promised bound; None for a number that is only reported
    at_least: bool = True  # Whether the bound is a lower one

    def holds(self, value: float) -> bool:
        if self.bound is None:
            return True
        return value >= self.bound if self.at_least else value <= self.bound


PROMISES = (
    Promise("sil_native_lockstep_x_realtime", "in process: board, plant, bytes, session", 200.0),
    Promise("sil_native_lockstep_x_cpu", "by the process's own time, whatever else runs", None),
    Promise("sil_native_flight_x_realtime", "the same, steered at 50 Hz and logged", None),
    Promise("sil_native_flight_x_cpu", "by the process's own time", None),
    Promise("sil_native_pty_x_realtime", "pseudo-terminal, steered and logged", 50.0),
    Promise("sil_due_x_realtime", "in process, the ELF on an emulated Due", 15.0),
    Promise("sil_due_x_cpu", "by the process's own time", None),
    Promise("host_decode_ticks_per_s", "bytes to arrays", 1e6),
    Promise("host_decode_ratio_to_pymavlink", "against a MAVLink message a tick", 4.0),
    Promise("telemetry_line_use", "share of 250 kbaud, hover and sine", 0.60, at_least=False),
    Promise("telemetry_line_use_worst", "with every voltage random", 1.0, at_least=False),
    Promise("host_cpu_at_1khz", "share of a core, recording", 0.05, at_least=False),
    Promise("page_stop_p99_ms", "stop in a page, to motors off on an emulated Due", 60.0, at_least=False),
    Promise("page_stop_median_ms", "the same; four tabs, both cores busy besides", None),
    Promise("page_cpu_ratio_three_tabs", "three tabs: host CPU over recording alone", 2.0, at_least=False),
    Promise("page_ticks_missed_three_tabs", "by three tabs together, in a minute", 0.0, at_least=False),
    Promise("foxglove_cpu_at_1khz", "every tick to a viewer: share of a core", 0.05, at_least=False),
    Promise("foxglove_ticks_missed", "by that viewer", 0.0, at_least=False),
    Promise("foxglove_stop_p99_ms", "stop in a page with a viewer, to motors off", 60.0, at_least=False),
    Promise("foxglove_stop_p99_without_ms", "the same in turn, without the feed", None),
    Promise("web_start_s", "opening the page in Chromium, to a take-off", 2.0, at_least=False),
    Promise("web_native_x_realtime", "the page hovers in Chromium, native flight code", 300.0),
    Promise("web_native_x_cpu", "by the page's own processor time, drawing included", None),
    Promise("web_native_recorded_x_realtime", "the same, a plan that is recorded", None),
    Promise("web_native_recorded_x_cpu", "by the page's own processor time", None),
    Promise("web_due_x_realtime", "the same, a hover of the emulated Due", 8.0),
    Promise("web_due_x_cpu", "by the page's own processor time", None),
    Promise("web_stop_p99_native_ms", "Space to both motors off, native", 60.0, at_least=False),
    Promise("web_stop_p99_due_ms", "the same, emulated Due", 60.0, at_least=False),
    Promise("web_memory_growth", "an hour at 20 x, after its first ten minutes", 0.05, at_least=False),
    Promise("web_ticks_lost", "in that hour", 0.0, at_least=False),
    Promise("web_lag_error_std", "a hidden lag from two logs, in standard errors", 2.0, at_least=False),
    Promise("read_600k_ticks_s", "seconds to read a ten-minute log", 2.0, at_least=False),
    Promise("due_tick_instructions_max", "the Due's tick, worst of all flights", 6000.0, at_least=False),
    Promise("due_tick_instructions_mean", "its mean", None),
    Promise("due_cascade_instructions", "the control law alone, worst", 2000.0, at_least=False),
    Promise("due_pid_v1_three_loops_instructions", "three loops of Arduino's PID_v1, for scale", None),
    Promise("law_lqi_instructions", "a law of the link, LQI: a call, worst", 4000.0, at_least=False),
    Promise("law_lqi_tick_instructions", "the tick with it, cascade in its shadow", 30000.0, at_least=False),
    Promise("law_mpc_tick_instructions", "the same with the MPC, spread over ticks", 30000.0, at_least=False),
    Promise("due_encoder_isr_instructions", "an edge of the travel encoder", 60.0, at_least=False),
    Promise("due_encoder_lost_counts", "of 20,000 edges at 200,000 a second", 0.0, at_least=False),
    Promise("due_boot_to_first_frame_ms", "power up to the first frame", 50.0, at_least=False),
    Promise("due_rx_lost_bytes", "of 20,000 in a row, under full telemetry", 0.0, at_least=False),
    Promise("due_motors_off_after_hang_ms", "worst over hangs, phases, 20-44 kHz", 300.0, at_least=False),
    Promise("plant_step_ns", "a millisecond of the multibody rig, compiled", 1500.0, at_least=False),
    Promise("plant_step_ratio_to_mujoco", "mj_step on the same rig takes this many times as long", 1.0),
    Promise("linearise_ms", "trim and linearise the multibody rig", 5.0, at_least=False),
    Promise("diagnose_one_effect_ratio", "diagnosing a lag: time of 1784116 over the time now", 0.9),
    Promise("diagnose_one_effect_ratio_cpu", "by the processes' own time", None),
    Promise("diagnose_measured_pair_ratio", "the same of a measured pair", 0.9),
    Promise("diagnose_measured_pair_ratio_cpu", "by the processes' own time", None),
    Promise("diagnose_peak_GB_10_min", "memory to diagnose ten minutes at 1 kHz", 0.5, at_least=False),
    Promise("identify_60s_flight_s", "a minute at 500 Hz, 13 free parameters", 10.0, at_least=False),
    Promise("identify_coverage_2std", "of 50 rigs' numbers, truth within 2 std", 0.93),
    Promise("diagnose_growth_100_flights", "a flight's CPU among 100, over one of 10", 1.3, at_least=False),
    Promise("campaign_two_workers_ratio", "200 cases of 0.1 s: two workers over one", 1.8),
    Promise("campaign_case_overhead_cpu_ms", "CPU of a case beside its own work", None),
    Promise("identify_heldout_normalised", "worst of 50 flights that no fit saw", 1.05, at_least=False),
)


@dataclass(frozen=True)
class Measured:
    """One number, measured several times."""

    key: str  # Its key in bench.json
    repetitions: Sequence[float]  # Every measurement

    @property
    def value(self) -> float:
        return statistics.median(self.repetitions)


def repeat(key: str, count: int, measure: Callable[[], float]) -> Measured:
    """Measure several times."""
    return Measured(key, [measure() for _ in range(count)])
