"""Speed and cost of the board, simulated and emulated: flying, instructions, the line, logs, the plant."""

import ctypes
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import heli_host
import numpy as np
import numpy.typing as npt
from heli_host.board.heli import Heli
from heli_host.data.log.reader import read_flight
from heli_host.declaration import BAUD, CHANNELS, Channel, MessageId
from heli_host.fly.plan import Plan, load_plan
from heli_host.fly.recorder import Recorder
from heli_host.fly.runner import fly
from heli_host.link.frames import FrameParser, encode_frame
from heli_host.link.session import Session
from heli_host.link.telemetry import TelemetryDecoder, Ticks
from heli_sim.evaluate.compiled import c_source, compile_source
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import linearise, trim
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions
from heli_sim.sil.transport import SilProcess
from heli_sim.sil.world import SilWorld
from heli_test_native import link as core_link

from firmware.due.report import read_image
from tests.bench.result import Measured, repeat
from tests.firmware.cost import LAW_UPDATE, Flight, measure_costs
from tests.firmware.desk import (
    Board,
    boot_to_first_frame_ms,
    longest_off_after_hang_ms,
    rx_lost_bytes,
    travel_counts_lost,
)
from tests.law.flown import fly_and_steer, law_of

RIG = "makki2024"


class TappedTransport(InProcessTransport):
    """The simulated board, with a copy of every byte that it sends."""

    def __init__(self, world: SilWorld) -> None:
        super().__init__(world)
        self.sent: list[bytes] = []

    def read(self, timeout_s: float) -> bytes:
        data = super().read(timeout_s)
        self.sent.append(data)
        return data


def demonstration() -> list[Plan]:
    """Return the plans of `make fly`."""
    return [load_plan("hover"), load_plan("sine")]


def hover(duration_s: float) -> Plan:
    """Return a plan that hovers for a while."""
    return Plan.parse(
        f'[[segment]]\nkind = "hold"\nduration_s = {duration_s}\n', "hover of the bench", "hover"
    )


@contextmanager
def tapped_board() -> Iterator[tuple[Heli, TappedTransport]]:
    """Connect in lockstep to a simulated board whose bytes are kept."""
    transport = TappedTransport(SilWorld(SilOptions(rig=RIG)))
    session = Session(transport)
    session.connect()
    with Heli(session) as heli:
        yield heli, transport


REPETITIONS = 5
DUE_REPETITIONS = 3
HOVER_S = 60.0
SLICE_ms = 100
"""Simulated time in one read; the host's bytes reach the line at the beginning of each."""
SPEEDS = (200.0, 150.0, 120.0, 100.0, 80.0, 70.0, 60.0, 50.0)
LARGEST_ERROR_DEG = {"elevation": 0.5, "travel": 2.0}
"""Beyond this a flight was not flown. A host that is 1 ms late is 0.1 s late at 100 times real time."""


@dataclass(frozen=True)
class Speed:
    """How much faster than real time something flew."""

    # By the clock on the wall, and by the time that this process had a core: on a machine with other work
    # only the second says what the code costs
    elapsed_x: float
    # By the clock on the wall, and by the time that this process had a core: on a machine with other work
    # only the second says what the code costs
    cpu_x: float


class Stopwatch:
    """Starts when it is made."""

    def __init__(self) -> None:
        self._elapsed_s, self._cpu_s = time.perf_counter(), time.process_time()

    def speed(self, simulated_s: float) -> Speed:
        """Speed at which so much simulated time passed since the start [s]."""
        return Speed(
            simulated_s / (time.perf_counter() - self._elapsed_s),
            simulated_s / (time.process_time() - self._cpu_s),
        )


def lockstep_hover() -> Speed:
    """Hover in process: board, plant, bytes and a whole session, which decodes every tick."""
    with heli_host.connect(f"sil://?rig={RIG}&speed=max&slice_ms={SLICE_ms}") as heli:
        heli.take_off()
        watch = Stopwatch()
        heli.wait(HOVER_S)
        return watch.speed(HOVER_S)


def lockstep_flight() -> Speed:
    """Fly hover and sine in process, with setpoints at 50 Hz, a log, and the summary read from it."""
    with heli_host.connect(f"sil://?rig={RIG}&speed=max") as heli:
        watch = Stopwatch()
        return watch.speed(fly(heli, demonstration()).duration_s)


def due_flight(elf: Path) -> Speed:
    """The same with the flight code's ELF on the emulated Due."""
    with heli_host.connect(f"sil://?board=due&elf={elf}&rig={RIG}&speed=max") as heli:
        watch = Stopwatch()
        return watch.speed(fly(heli, demonstration()).duration_s)


def _measure_emulated() -> list[Measured]:
    """Fly the emulated Due; nothing without the cross-compiler."""
    if not has_cross_compiler():
        return []
    with TemporaryDirectory() as folder:
        elf = build(Path(folder))
        return repeat_speed("sil_due", DUE_REPETITIONS, lambda: due_flight(elf))


def repeat_speed(name: str, count: int, fly_once: Callable[[], Speed]) -> list[Measured]:
    """Measure a speed several times, by both clocks."""
    speeds = [fly_once() for _ in range(count)]
    return [
        Measured(f"{name}_x_realtime", [speed.elapsed_x for speed in speeds]),
        Measured(f"{name}_x_cpu", [speed.cpu_x for speed in speeds]),
    ]


def over_a_pty() -> float:
    """Fly hover and sine over a pseudo-terminal, at the highest speed that loses and spoils nothing."""
    for speed in SPEEDS:
        with (
            TemporaryDirectory() as folder,
            SilProcess(rig=RIG, speed=speed) as board,
            heli_host.connect(board.url) as heli,
        ):
            start_s, start_tick = time.perf_counter(), heli.latest.tick
            summary = fly(heli, demonstration(), log_path=Path(folder) / "flight.mcap")
            passed_s = (heli.latest.tick - start_tick) * 1e-3
            elapsed_s = time.perf_counter() - start_s
        errors_deg = summary.rms_error_deg
        steered = all((errors_deg[axis] or 0.0) <= most for axis, most in LARGEST_ERROR_DEG.items())
        if summary.completed and summary.ticks_lost == 0 and steered:
            return passed_s / elapsed_s
    return 0.0


def measure_simulation() -> list[Measured]:
    """Fly in process, over a pseudo-terminal, and on the emulated Due."""
    return [
        *repeat_speed("sil_native_lockstep", REPETITIONS, lockstep_hover),
        *repeat_speed("sil_native_flight", REPETITIONS, lockstep_flight),
        repeat("sil_native_pty_x_realtime", REPETITIONS, over_a_pty),
        *_measure_emulated(),
    ]


ROOT = Path(__file__).resolve().parents[2]


def build(folder: Path) -> Path:
    """Build the firmware and return the ELF."""
    elf = folder / "heli.elf"
    subprocess.run(["make", "-s", "-C", ROOT / "firmware" / "due", f"BUILD={folder}", elf], check=True)
    return elf


def has_cross_compiler() -> bool:
    """Whether the firmware can be built here."""
    return shutil.which("arm-none-eabi-g++") is not None


def law_costs(elf: Path) -> dict[str, float]:
    """Instructions of laws that came over the link, in flight."""
    instructions: dict[str, float] = {}
    for name in ("lqi", "mpc"):
        flight = Flight(elf, read_image(elf), (LAW_UPDATE,))
        fly_and_steer(flight, law_of(ROOT / "docs" / "laws" / f"{name}.py").program, 5.0)
        instructions[f"law_{name}_tick_instructions"] = flight.tick_cost().max_instructions
        if name == "lqi":
            instructions["law_lqi_instructions"] = flight.function_cost(LAW_UPDATE).max_instructions
    return instructions


def measure_due() -> list[Measured]:
    """Count instructions, bytes and milliseconds; needs the cross-compiler."""
    with TemporaryDirectory() as folder:
        elf = build(Path(folder))
        image = read_image(elf)
        costs = measure_costs(elf)
        numbers = {
            "due_tick_instructions_max": costs.tick_instructions_max,
            "due_tick_instructions_mean": costs.tick_instructions_mean,
            "due_cascade_instructions": costs.cascade_instructions_max,
            "due_pid_v1_three_loops_instructions": costs.pid_v1_three_loops_instructions,
            **law_costs(elf),
            "due_encoder_isr_instructions": costs.encoder_isr_instructions_max,
            "due_encoder_lost_counts": travel_counts_lost(Board(elf, image)),
            "due_boot_to_first_frame_ms": boot_to_first_frame_ms(Board(elf, image)),
            "due_rx_lost_bytes": rx_lost_bytes(Board(elf, image)),
            "due_motors_off_after_hang_ms": longest_off_after_hang_ms(elf, image),
        }
    return [Measured(key, [float(value)]) for key, value in numbers.items()]


PLANT_REPETITIONS = 7
STEPS = 2_000
"""Two seconds from level, at voltages that nearly hover: no stop is reached."""
ROUNDS = 50

_STEP_LOOP = """
int plant_steps(long long steps, double* state, const double* volts, const double* locked, const double* p) {{
  double after[{states}], measured[3], w[{w}];
  long long iw[{iw}];
  const double* arg[{arg}] = {{state, volts, locked, p}};
  double* res[{res}] = {{after, measured}};
  for (long long k = 0; k < steps; ++k) {{
    plant_step(arg, res, iw, w, 0);
    for (int i = 0; i < {states}; ++i) state[i] = after[i];
  }}
  return 0;
}}
"""


def hovering() -> tuple[Plant, npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The multibody rig, a state near level, and voltages."""
    rig = load_rig(RIG)
    plant = Plant(MultibodyModel(), rig)
    at = trim(plant.model, rig)
    return plant, np.array([*at.state]), np.array([*at.volts_V])


def our_step() -> Callable[[], float]:
    """Nanoseconds for one compiled step, as the simulated board calls it."""
    plant, state, volts = hovering()
    function = plant.function
    loop = _STEP_LOOP.format(
        states=len(state),
        w=max(1, function.sz_w()),
        iw=max(1, function.sz_iw()),
        arg=max(4, function.sz_arg()),
        res=max(2, function.sz_res()),
    )
    library = compile_source("bench_plant", c_source(function) + loop)
    assert library is not None, "the bench needs a C compiler"
    call = ctypes.CDLL(str(library)).plant_steps
    arrays = state.copy(), volts, np.zeros(3), plant.parameters
    pointers = [ctypes.c_void_p(array.ctypes.data) for array in arrays]

    def measure() -> float:
        passed_s = 0.0
        for _ in range(ROUNDS):
            arrays[0][:] = state
            start_s = time.perf_counter()
            call(ctypes.c_longlong(STEPS), *pointers)
            passed_s += time.perf_counter() - start_s
        assert abs(arrays[0][0]) < 0.1, "the arm left level"
        return 1e9 * passed_s / (ROUNDS * STEPS)

    return measure


def mujocos_step() -> Callable[[], float]:
    """Nanoseconds for one mj_step of the same masses, RK4 at 1 ms as well."""
    import mujoco
    from heli_benchmark.plant import mujoco_rig

    plant, _, volts = hovering()
    physics = mujoco_rig(plant.rig)
    data = mujoco.MjData(physics)
    gain, dead_V = plant.rig["thrust_gain"].value, plant.rig["dead_zone"].value

    def measure() -> float:
        passed_s = 0.0
        for _ in range(ROUNDS // 10):
            mujoco.mj_resetData(physics, data)
            data.ctrl[:] = gain * (volts - dead_V)
            start_s = time.perf_counter()
            mujoco.mj_step(physics, data, STEPS)
            passed_s += time.perf_counter() - start_s
        return 1e9 * passed_s / (ROUNDS // 10 * STEPS)

    return measure


def linearise_ms() -> float:
    """Trim and linearise the multibody rig, its symbols being there."""
    rig, model = load_rig(RIG), MultibodyModel()
    linearise(model, rig)
    start_s = time.perf_counter()
    for _ in range(20):
        linearise(model, rig)
    return 1e3 * (time.perf_counter() - start_s) / 20


def measure_plant() -> list[Measured]:
    """Step ours and MuJoCo's in turn, then linearise."""
    ours, theirs = our_step(), mujocos_step()
    pairs = [(ours(), theirs()) for _ in range(PLANT_REPETITIONS)]
    return [
        Measured("plant_step_ns", [ours_ns for ours_ns, _ in pairs]),
        Measured("mujoco_step_ns", [mujoco_ns for _, mujoco_ns in pairs]),
        Measured("plant_step_ratio_to_mujoco", [mujoco_ns / ours_ns for ours_ns, mujoco_ns in pairs]),
        repeat("linearise_ms", PLANT_REPETITIONS, linearise_ms),
    ]


BYTES_A_SECOND = BAUD / 10
"""8N1: ten bits a byte."""
VOLTAGE_RANGE_mV = 12000


def flight_bytes() -> tuple[bytes, float]:
    """Fly hover and sine; return what the board sent, and in how many seconds."""
    with tapped_board() as (heli, transport):
        transport.sent.clear()
        start_s = transport.now_s()
        fly(heli, demonstration())
        return b"".join(transport.sent), transport.now_s() - start_s


def worst_case_bytes(sent: bytes, batch_ticks: int) -> tuple[int, int]:
    """Pack the flight again with every voltage random; return bytes and ticks."""
    ticks = _ticks(sent)
    raw = ticks.raw.copy()
    random = np.random.default_rng(1)
    for channel in Channel:
        if CHANNELS[channel].unit == "V":
            raw[:, channel] = random.integers(0, VOLTAGE_RANGE_mV, len(raw))
    size = 0
    for start in range(0, len(raw) - batch_ticks, batch_ticks):
        payloads = core_link.pack_telemetry(int(ticks.tick[start]), raw[start : start + batch_ticks])
        size += sum(len(encode_frame(MessageId.TELEMETRY, 0, payload)) for payload in payloads)
    return size, len(raw) - batch_ticks


def _ticks(sent: bytes) -> Ticks:
    frames = FrameParser().feed(sent)
    return TelemetryDecoder().decode([frame.payload for frame in frames if frame.id == MessageId.TELEMETRY])


def measure_line(sent: bytes, duration_s: float) -> list[Measured]:
    """Count the bytes of a flight; one repetition, the simulation being deterministic."""
    with tapped_board() as (heli, _):
        batch_ticks = round(heli.params["telemetry_batch_ticks"])
    worst, ticks = worst_case_bytes(sent, batch_ticks)
    return [
        Measured("telemetry_line_use", [len(sent) / duration_s / BYTES_A_SECOND]),
        Measured("telemetry_line_use_worst", [worst / (ticks * 1e-3) / BYTES_A_SECOND]),
    ]


DECODING_REPETITIONS = 5
# Size of the pieces in which a program reads a port or a saved stream: about 6 s of flight.
CHUNK_BYTES = 65536


def chunks(data: bytes) -> Iterator[bytes]:
    for start in range(0, len(data), CHUNK_BYTES):
        yield data[start : start + CHUNK_BYTES]


def decode_ours(data: bytes) -> int:
    """Ticks decoded from the bytes of a flight."""
    parser, decoder = FrameParser(), TelemetryDecoder()
    ticks = 0
    for chunk in chunks(data):
        frames = parser.feed(chunk)
        ticks += len(decoder.decode([frame.payload for frame in frames if frame.id == MessageId.TELEMETRY]))
    return ticks


def mavlink_bytes(ticks: int) -> bytes:
    """As many HIL_CONTROLS messages: 11 fields in 42 bytes, about as many as a tick holds."""
    from pymavlink.dialects.v20 import common

    link = common.MAVLink(None)
    return b"".join(
        link.hil_controls_encode(
            1000 * tick, 0.1, 0.01 * (tick % 100), -0.2, 5.0, 5.1, 0.3, 0.2, 0.1, 2, 3
        ).pack(link)
        for tick in range(ticks)
    )


def decode_mavlink(data: bytes) -> int:
    """Messages decoded from a MAVLink stream."""
    from pymavlink.dialects.v20 import common

    link = common.MAVLink(None)
    return sum(len(link.parse_buffer(chunk) or ()) for chunk in chunks(data))


def measure_decoding(flight_bytes: bytes) -> list[Measured]:
    """Decode the same number of ticks both ways, in turn."""
    ticks = decode_ours(flight_bytes)
    theirs = mavlink_bytes(ticks)
    rates: list[tuple[float, float]] = []
    for _ in range(DECODING_REPETITIONS):
        start_s = time.perf_counter()
        assert decode_ours(flight_bytes) == ticks
        middle_s = time.perf_counter()
        assert decode_mavlink(theirs) == ticks
        end_s = time.perf_counter()
        rates.append((ticks / (middle_s - start_s), ticks / (end_s - middle_s)))
    return [
        Measured("host_decode_ticks_per_s", [ours for ours, _ in rates]),
        Measured("pymavlink_messages_per_s", [peer for _, peer in rates]),
        Measured("host_decode_ratio_to_pymavlink", [ours / peer for ours, peer in rates]),
    ]


RECORD_REPETITIONS = 3
RECORD_S = 20.0


def core_share() -> float:
    """Hover in real time over a pseudo-terminal; processor time of this process over wall time."""
    with (
        TemporaryDirectory() as folder,
        SilProcess(rig=RIG, speed=1.0) as board,
        heli_host.connect(board.url) as heli,
    ):
        heli.take_off()
        with Recorder(heli, Path(folder) / "flight.mcap"):
            start_s, busy_s = time.perf_counter(), time.process_time()
            heli.wait(RECORD_S)
            return (time.process_time() - busy_s) / (time.perf_counter() - start_s)


def measure_recording() -> list[Measured]:
    """Record three hovers."""
    return [repeat("host_cpu_at_1khz", RECORD_REPETITIONS, core_share)]


READ_REPETITIONS = 5
LOG_TICKS = 600_000


def measure_reading() -> list[Measured]:
    """Record ten minutes in lockstep, then read them."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        with heli_host.connect(f"sil://?rig={RIG}&speed=max") as heli:
            fly(heli, [hover(LOG_TICKS * 1e-3)], log_path=path)

        def read_s() -> float:
            start_s = time.perf_counter()
            flight = read_flight(path)
            elapsed_s = time.perf_counter() - start_s
            assert len(flight) >= LOG_TICKS
            return elapsed_s * LOG_TICKS / len(flight)

        return [repeat("read_600k_ticks_s", READ_REPETITIONS, read_s)]
