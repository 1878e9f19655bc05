"""Messages, channels, parameters and faults of the link.

Written by firmware/generate.py from firmware/link.toml. Do not edit.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import TYPE_CHECKING, ClassVar, Self

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

LINK_HASH = 0x56651D81
PARAMS_HASH = 0xF6FEF19E
LINK_VERSION = "1.5"
FIRMWARE_VERSION = "0.1.0"
PROTOCOL = 1
BAUD = 250000
TICK_US = 1000
MAX_COMMAND_PAYLOAD = 64
MAX_TELEMETRY_PAYLOAD = 480

SETPOINT_MARGIN_DEG = {"elevation_max_deg": 2, "travel_max_deg": 5, "elevation_rest_deg": 1}
"""Distances between the setpoints that the board accepts and these parameters, in degrees."""


class Name(IntEnum):
    """A declared number, which prints as its name in link.toml."""

    def __str__(self) -> str:
        return self.name.lower()


class Message:
    """A message of the link: a dataclass whose fields have the layout of `STRUCT`, in order."""

    __slots__: tuple[str, ...] = ()
    ID: ClassVar[IntEnum]
    STRUCT: ClassVar[struct.Struct]

    def pack(self) -> bytes:
        """Return the payload bytes."""
        return self.STRUCT.pack(*(getattr(self, name) for name in self.__slots__))

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Read the fixed fields from the start of ``payload``."""
        return cls(*cls.STRUCT.unpack_from(payload))



class Axis(Name):
    """Axes in the order used everywhere: in telemetry, masks and messages."""

    ELEVATION = 0  # angle of the long arm; positive is up
    PITCH = 1  # angle of the short arm about the long arm; positive if the front rotor pushes more
    TRAVEL = 2  # angle about the vertical; a positive pitch accelerates it positively


class State(Name):
    """State of the supervisor, sent with every tick."""

    IDLE = 0  # drivers disabled, motors off; the only state in which every parameter may be set
    ARMED = 1  # drivers enabled at zero voltage, pre-flight checks passed
    CLOSED_LOOP = 2  # the board's control law controls the axes of the axis mask
    OPEN_LOOP = 3  # constant voltages plus excitation; no control loop is closed
    STREAMED = 4  # the host sends the motor voltages; each acts for a limited time only
    HOLD = 5  # no recent setpoint: the board hovers level in place
    LANDING = 6  # controlled descent to the table, then motors off
    FAULT = 7  # motors off; the fault stays until clear_fault
    EMERGENCY_LANDING = 8  # descent after a fault, without control of the axis whose reading is wrong; then motors off, and the fault stays until clear_fault


class Result(Name):
    """Answer to a command."""

    OK = 0  # done
    UNKNOWN_COMMAND = 1  # no such message id
    BAD_LENGTH = 2  # the payload length is wrong for this message
    BAD_VALUE = 3  # a field is out of range or not finite; detail is its position in the message, from 0
    BAD_STATE = 4  # not allowed in the current state; detail is the state
    CHECK_FAILED = 5  # a pre-flight check failed; detail is the fault code
    OUT_OF_RANGE = 6  # parameter value outside its range; detail is the parameter
    NO_SUCH_PARAMETER = 7  # parameter index beyond the table
    UNSAFE_NOW = 8  # this parameter may only be set while idle; detail is the parameter
    FLASH_FAILED = 9  # the parameter page could not be written and verified
    NO_HANDSHAKE = 10  # hello with a matching declaration must come first
    HASH_MISMATCH = 11  # host and board were built from different declarations
    BAD_LAW = 12  # the law is refused; detail is the law_error, and the meaning of value is listed there


class LawError(Name):
    """Reasons for refusing a law or a part of it. The text of each reason states the meaning of ack.value."""

    NONE = 0  # nothing is wrong
    NOT_LOADED = 1  # no law is loaded; value 0
    FLYING = 2  # the loaded law flies, so it cannot be replaced; value 0
    TOO_LONG = 3  # the law is too long for an upload; value = largest number of words allowed
    WRONG_PART = 4  # a part beyond the end, or before law_begin; value = its first word
    INCOMPLETE = 5  # parts are missing; value = words received
    WRONG_HASH = 6  # the hash does not match the received words; value 0
    WRONG_FORMAT = 7  # another version of the format, or counts that contradict the length; value = number of words that follows from the counts
    TOO_LARGE = 8  # the law needs more cells than there are; value = cells that it needs
    UNKNOWN_OPERATION = 9  # no such operation; value = place of the instruction
    BAD_CELL = 10  # an instruction writes a forbidden cell, or an output names a cell that does not exist; value = place of the instruction; outputs count on after the last instruction
    NOT_WRITTEN = 11  # a cell is read before it is written; value = place of the instruction; outputs count on after the last instruction
    BAD_NUMBER = 12  # a constant, a parameter or an initial state is not finite; value = its place among these numbers
    BAD_DIVISOR = 13  # the tick rate is not a multiple of the law's rate; value = divisor
    TOO_COSTLY = 14  # a call of the law needs more ticks than there are until the next call; value = ticks that it needs
    NO_SUCH_PARAMETER = 15  # the law has no parameter with this number; value = number of its parameters
    BAD_SUM = 17  # a sum of products has no terms or too many, or its terms reach beyond the last word; value = place of the word
    NOT_FLYING = 16  # a law may fly only in flight, while the board controls all three axes; value = state


class LawState(Name):
    """State of the uploaded law on the board."""

    NONE = 0  # no law
    RECEIVING = 1  # an upload has started and is not complete
    READY = 2  # verified; may fly
    FLYING = 3  # it controls the motors


class Takeover(Name):
    """Why the board's own law took over."""

    COMMAND = 0  # the host requested it; value 0
    NOT_FINITE = 1  # an output, a signal or a new state was not finite; value = its position among voltages, setpoints, signals, states
    VOLTAGE_JUMP = 2  # a voltage jumped from one tick to the next; value in V
    ELEVATION_ENVELOPE = 3  # elevation could not stop before its limits; value = predicted angle in deg
    PITCH_ENVELOPE = 4  # pitch could not stop before its limit; value = predicted angle in deg
    TRAVEL_ENVELOPE = 5  # travel could not stop before its limit; value = predicted angle in deg
    ELEVATION_FOLLOWING = 6  # elevation stayed too far from the board's setpoint; value in deg
    PITCH_FOLLOWING = 7  # pitch stayed too far from the law's own setpoint; value in deg
    TRAVEL_FOLLOWING = 8  # travel stayed too far from the board's setpoint; value in deg
    STATE = 9  # the board left closed loop: stop, landing, a missing setpoint, a fault; value = state


class Reset(Name):
    """Why the board last started."""

    POWER_UP = 0  # power applied
    USER = 1  # reset line: opening the port, or the button
    WATCHDOG = 2  # the watchdog fired, because control tick or idle loop hung
    SOFTWARE = 3  # the firmware reset itself after it recorded a fault


class ParamsSource(Name):
    """Origin of the parameters at this start of the board."""

    DEFAULTS = 0  # the flash has no stored set, so the defaults are in force
    STORED = 1  # the newest valid copy in flash
    FALLBACK = 2  # the newest copy was damaged; the older valid copy is used
    CORRUPT = 3  # both copies are damaged or have another format: the defaults are in force, and the board refuses to arm until parameters are saved
    MIGRATED = 4  # the newest valid copy has another list of parameters: known values are kept, and new parameters have their defaults; see params_origin


class Excitation(Name):
    """Kinds of excitation, which the board adds to the motor voltages."""

    NONE = 0  # no excitation
    STEP = 1  # constant amplitude for the duration
    DOUBLET = 2  # plus amplitude for the first half, minus for the second
    CHIRP = 3  # sine whose frequency rises linearly from start_Hz to stop_Hz
    MULTISINE = 4  # eight sines spread evenly from start_Hz to stop_Hz, Schroeder phases; the back motor uses frequencies between those of the front
    PRBS = 5  # pseudo-random binary sequence that may switch every 1/stop_Hz, seeded


class Event(Name):
    """Kinds of event messages."""

    BOOT = 0  # first message after start; detail = reset cause, value = boot id
    STATE = 1  # the state changed; detail = new state, cause = the trigger
    FAULT = 2  # a fault occurred; detail = fault code, value = the quantity that exceeded its limit
    SETPOINT_STALE = 3  # setpoints stopped; value = their rate in Hz in the last second before
    SETPOINT_FRESH = 4  # setpoints came back while holding
    PARAMS_SAVED = 5  # parameters written to flash; value = generation
    EXCITATION_END = 6  # excitation finished or was stopped; detail = kind
    SETPOINT_REJECTED = 7  # a streamed value was refused; detail = result code
    ZEROED = 8  # encoder zeros taken; detail = axis mask
    LAW_ENGAGED = 9  # an uploaded law began to fly; value = its divisor, the number of ticks from one call to the next
    LAW_TAKEN_OVER = 10  # the board's own law took over from an uploaded law; detail = takeover, and the meaning of value is listed there
    TRAVEL_PROBE = 11  # the board tilts the arm to see whether the travel encoder still counts; detail = probe, value = tilt in deg


class Probe(Name):
    """Result of the tilt that checks a silent travel encoder."""

    NONE = 0  # nothing
    ASKED = 1  # the tilt begins
    COUNTS = 2  # the encoder counts
    SILENT = 3  # the encoder does not count, although the tilt must have turned the arm; the fault is travel_motionless
    STOPPED = 4  # the check ended without a result, because the state changed or pitch did not tilt far enough


class Trigger(Name):
    """Event that changes the supervisor's state. State events and telemetry report it as the cause."""

    ARM = 0  # arm command
    STOP = 1  # stop command
    CLOSE_LOOP = 2  # control command with at least one axis
    OPEN_LOOP = 3  # control command without any axis
    STREAM = 4  # stream command
    LAND = 5  # land command
    SETPOINT_FRESH = 6  # a valid setpoint arrived while holding
    STALE_HOLD = 7  # setpoint (or link, or streamed voltage) older than the hold time
    STALE_LAND = 8  # setpoint or link older than the land time
    TOUCHDOWN = 9  # at rest on the table while landing
    TRIP = 10  # a fault tripped
    CLEAR = 11  # clear_fault command
    AXIS_LOST = 12  # a fault of one axis tripped: the arm can still land without its reading
    START = 13  # the board has started; in telemetry only


class Axes(IntFlag):
    """Axis mask."""

    ELEVATION = 1  # elevation loop
    PITCH = 2  # pitch loop
    TRAVEL = 4  # travel loop; needs pitch


class Flags(IntFlag):
    """Sent with every tick."""

    FRONT_SATURATED = 1  # front motor voltage was limited
    BACK_SATURATED = 2  # back motor voltage was limited
    EXCITATION = 4  # excitation is being added
    LINK_ALIVE = 8  # a valid host frame arrived within the hold time
    PITCH_LIMITED = 16  # the travel loop's pitch setpoint was limited
    OVERRUN = 32  # the tick before this one was late
    LAW = 64  # the voltages are those of an uploaded law


class Fault(Name):
    """Fault codes."""

    NONE = 0  # no fault
    ELEVATION_LIMIT = 1  # elevation above its limit
    PITCH_LIMIT = 2  # pitch beyond its limit
    TRAVEL_LIMIT = 3  # travel beyond its limit, so that the cables wind up
    ELEVATION_RATE = 4  # elevation moved faster than its limit
    PITCH_RATE = 5  # pitch moved faster than its limit
    TRAVEL_RATE = 6  # travel moved faster than its limit
    ENCODER_ELEVATION = 7  # too many illegal transitions of the elevation encoder
    ENCODER_PITCH = 8  # too many illegal transitions of the pitch encoder
    ENCODER_TRAVEL = 9  # too many illegal transitions of the travel encoder
    LANDING_TIMEOUT = 10  # the arm did not reach the table in time
    TICK_OVERRUN = 11  # too many control ticks ran late
    HARDWARE_STOP = 12  # the hardware stop input is active
    ELEVATION_FOLLOWING = 13  # elevation stayed too far from its setpoint for following_s
    PITCH_FOLLOWING = 14  # pitch stayed too far from its setpoint for following_s
    TRAVEL_FOLLOWING = 15  # travel stayed too far from its setpoint for following_s
    ENCODER_OVERLOAD = 16  # encoder edges came faster than the board can count, so the angle is wrong
    ELEVATION_MOTIONLESS = 17  # the sum of both voltages changed enough to move the arm, but the elevation encoder did not count
    PITCH_MOTIONLESS = 18  # the difference of the voltages changed enough to tilt the short arm, but the pitch encoder did not count
    TRAVEL_MOTIONLESS = 19  # pitch tilted long enough to turn the arm, but the travel encoder did not count; value: predicted travel in deg
    NOT_AT_REST = 20  # the arm does not rest on the table
    MOVING = 21  # an axis is moving
    LINK_NOT_ALIVE = 22  # no recent frame from the host
    PARAMETERS_INVALID = 23  # the stored parameters are damaged or contradict each other
    PITCH_NOT_LEVEL = 24  # the short arm is not level
    ELEVATION_BELOW_TABLE = 25  # elevation read more than 1 degree plus this tolerance below the table, where the arm cannot be
    ELEVATION_STEP = 26  # elevation changed within 4 ms by more than the arm can turn; the board does not arm until the axis is zeroed
    PITCH_STEP = 27  # pitch changed within 4 ms by more than the short arm can turn; the board does not arm until the axis is zeroed
    TRAVEL_STEP = 28  # travel changed within 4 ms by more than the arm can turn; the board does not arm until the axis is zeroed
    ELEVATION_REST = 29  # after landing, the arm rests without lift at another elevation than before take-off
    ELEVATION_SIGN = 33  # at take-off, elevation decreased although the rotors lift: the sign of the elevation encoder is wrong
    PITCH_SIGN = 34  # pitch turned against the difference of the voltages: the sign of the pitch encoder is wrong, the motors are exchanged, or one pushes down
    TRAVEL_SIGN = 35  # travel turned against the tilt: the sign of the travel encoder is wrong
    WATCHDOG = 30  # the watchdog restarted the board, because the control tick or the idle loop hung
    HARD_FAULT = 31  # the processor reported an error; the board switched off the motor drivers and restarted
    UNEXPECTED_INTERRUPT = 32  # an interrupt without a handler came; the board switched off the motor drivers and restarted


class Param(Name):
    """Position of each parameter in the table."""

    ELEVATION_COUNTS_PER_REV = 0  # count: counts of the elevation encoder per turn: four times its pulses; a negative number reverses its direction
    PITCH_COUNTS_PER_REV = 1  # count: counts of the pitch encoder per turn: four times its pulses; a negative number reverses its direction
    TRAVEL_COUNTS_PER_REV = 2  # count: counts of the travel encoder per turn: four times its pulses; a negative number reverses its direction
    ELEVATION_REST_DEG = 3  # deg: elevation of the arm at rest on the table; level is 0
    SUPPLY_V = 4  # V: supply voltage of the motor drivers; full duty gives this voltage
    MOTOR_MIN_V = 5  # V: lowest motor voltage; with 0, no rotor is ever reversed
    MOTOR_MAX_V = 6  # V: highest motor voltage
    MOTOR_FRONT_SIGN = 7  # : -1 reverses the front motor, as if its leads were swapped
    MOTOR_BACK_SIGN = 8  # : -1 reverses the back motor, as if its leads were swapped
    DEAD_ZONE_V = 9  # V: voltage below which a rotor gives no thrust (paper eq. 31); the control law adds it
    HOVER_V = 10  # V: sum of both voltages, above the dead zone, that holds the arm level
    HOVER_SLOPE = 11  # V/deg: change of hover_V with elevation: masses below the axis need more lift at a higher elevation
    ELEVATION_KP = 12  # V/deg: elevation proportional gain (paper Table 6: 0.5)
    ELEVATION_KI = 13  # V/(deg s): elevation integral gain (paper Table 6: 1)
    ELEVATION_KD = 14  # V s/deg: elevation derivative gain, on the measurement (paper Table 6: 0.1)
    ELEVATION_RATE_FF = 15  # : share of the setpoint's rate that the derivative term uses; with 0, it uses the measured rate only
    ELEVATION_ACCELERATION_FF = 16  # V s2/deg: sum of the voltages per acceleration of the elevation setpoint: inertia / (thrust gain x arm)
    PITCH_KP = 17  # V/deg: pitch proportional gain (paper Table 6: 0.66)
    PITCH_KI = 18  # V/(deg s): pitch integral gain (paper Table 6: 3)
    PITCH_KD = 19  # V s/deg: pitch derivative gain, on the measurement (paper Table 6: 0.1)
    PITCH_HOLD_FF = 20  # V/deg: difference of the voltages per degree of pitch setpoint, which holds a tilt against the weight below the pitch axis
    TRAVEL_KP = 21  # deg/deg: travel proportional gain to the pitch setpoint (paper Table 6 with P and I exchanged: 0.7)
    TRAVEL_KI = 22  # deg/(deg s): travel integral gain (paper Table 6 with P and I exchanged: 0.13)
    TRAVEL_KD = 23  # deg s/deg: travel derivative gain, on the measurement (paper Table 6: 1.462)
    TRAVEL_RATE_FF = 24  # : share of the setpoint's rate that the derivative term uses; with 0, it uses the measured rate only
    TRAVEL_ACCELERATION_FF = 25  # deg s2/deg: pitch per acceleration of the travel setpoint: inertia / (hover thrust x arm)
    ELEVATION_INTEGRAL_MAX_V = 26  # V: bound of the elevation integrator
    PITCH_INTEGRAL_MAX_V = 27  # V: bound of the pitch integrator
    TRAVEL_INTEGRAL_MAX_DEG = 28  # deg: bound of the travel integrator
    ELEVATION_FILTER_HZ = 29  # Hz: cut-off of the elevation rate filter (two poles)
    PITCH_FILTER_HZ = 30  # Hz: cut-off of the pitch rate filter (two poles)
    TRAVEL_FILTER_HZ = 31  # Hz: cut-off of the travel rate filter (two poles)
    PITCH_SETPOINT_MAX_DEG = 32  # deg: largest pitch setpoint, from the travel loop or the host
    DIFFERENTIAL_MAX_V = 33  # V: largest difference of front and back voltage; the mixer prefers pitch to lift, so a larger difference would lift the arm
    ELEVATION_SLEW_DEG_S = 34  # deg/s: fastest change of the elevation setpoint
    PITCH_SLEW_DEG_S = 35  # deg/s: fastest change of the pitch setpoint, from the travel loop or the host
    TRAVEL_SLEW_DEG_S = 36  # deg/s: fastest change of the travel setpoint
    ELEVATION_ACCELERATION_DEG_S2 = 37  # deg/s2: fastest change of the elevation setpoint's rate, which makes a step a smooth ramp
    TRAVEL_ACCELERATION_DEG_S2 = 38  # deg/s2: fastest change of the travel setpoint's rate; travel can only accelerate by tilting
    BUMPLESS_S = 39  # s: time constant of the smooth change from one control law or state to the next
    ELEVATION_MAX_DEG = 40  # deg: limit of elevation, above which the board lands without this encoder; setpoints must be 2 degrees lower
    PITCH_MAX_DEG = 41  # deg: pitch beyond which the motors are cut
    TRAVEL_MAX_DEG = 42  # deg: limit of travel, beyond which the motors are cut; setpoints must stay 5 degrees inside it
    ELEVATION_RATE_MAX_DEG_S = 43  # deg/s: rate of elevation beyond which the board lands without this encoder
    PITCH_RATE_MAX_DEG_S = 44  # deg/s: pitch rate beyond which the motors are cut
    TRAVEL_RATE_MAX_DEG_S = 45  # deg/s: travel rate beyond which the motors are cut
    ENCODER_ILLEGAL_MAX = 46  # : number of illegal transitions of an encoder since arming that is tolerated
    OVERRUN_MAX = 47  # : number of late ticks since arming that is tolerated
    ELEVATION_FOLLOWING_MAX_DEG = 48  # deg: limit of the distance of elevation from its moving setpoint; after following_s beyond it, the board lands without this encoder
    PITCH_FOLLOWING_MAX_DEG = 49  # deg: limit of the distance of pitch from its setpoint; after following_s beyond it, the motors are cut
    TRAVEL_FOLLOWING_MAX_DEG = 50  # deg: limit of the distance of travel from its moving setpoint; after following_s beyond it, the board lands
    FOLLOWING_S = 51  # s: time for which an axis may be farther from its setpoint than its limit
    ELEVATION_MOTION_V = 52  # V: change of the sum of the voltages (without dead zones) that must move elevation within motion_s; at take-off, it counts from hover_V
    PITCH_MOTION_V = 53  # V: change of front minus back voltage (without dead zones) that must move pitch within motion_s
    MOTION_S = 54  # s: longest time for which elevation or pitch may stay within one count although the motors drive it
    TRAVEL_MOTION_DEG = 55  # deg: additional pitch, beyond the pitch at which travel rests, that must turn the arm within travel_motion_s
    TRAVEL_MOTION_S = 56  # s: time within which travel_motion_deg must turn the arm; if the additional pitch is smaller, the arm may rest longer
    TRAVEL_SILENCE_S = 57  # s: time in the air without a count of travel after which a short tilt checks the travel encoder; 0 switches this check off
    ELEVATION_GAIN = 58  # rad/(s2 V): acceleration of elevation per volt of the voltages' sum: thrust gain k L_a / J_theta; predicts how far elevation must move
    PITCH_GAIN = 59  # rad/(s2 V): acceleration of pitch per volt of front minus back voltage: k L_h / J_phi; predicts how far pitch must move
    TRAVEL_GAIN = 60  # 1/s2: acceleration of travel per radian of pitch at hover: the thrust of both rotors times L_a / J_psi; predicts how far travel must move
    LAW_JUMP_MAX_V = 61  # V: largest change of a motor's voltage from one tick to the next; if an uploaded law exceeds it, the board's own law takes over
    LAW_ENVELOPE = 62  # : share of the limits of angles, rates and distances from the setpoints; if an uploaded law exceeds it, the board's own law takes over
    ARM_RATE_MAX_DEG_S = 63  # deg/s: the board arms only if no axis turns faster than this
    ARM_ELEVATION_TOLERANCE_DEG = 64  # deg: the board arms only if elevation is this close to rest
    ARM_PITCH_TOLERANCE_DEG = 65  # deg: the board arms only if pitch is this close to level
    SETPOINT_HOLD_S = 66  # s: time without a recent setpoint after which the board holds level
    SETPOINT_LAND_S = 67  # s: time without a recent setpoint after which the board lands
    LANDING_RATE_DEG_S = 68  # deg/s: rate at which the elevation setpoint decreases while landing
    LANDING_TIMEOUT_S = 69  # s: longest landing; then the motors are switched off with a fault. A landing without the elevation encoder takes 1.5 times as long
    VOLTAGE_VALID_MAX_MS = 70  # ms: longest time that a streamed voltage acts
    EXCITATION_MAX_V = 71  # V: largest amplitude of an excitation
    EXCITATION_MAX_S = 72  # s: longest duration of an excitation
    TELEMETRY_BATCH_TICKS = 73  # tick: ticks per telemetry batch: 20 saves bandwidth, 5 reduces the delay for a host controller
    CONTROLLER = 74  # : compiled controller that flies: its row in the board's table; a number beyond the last row is refused


class Channel(Name):
    """Position of each telemetry channel."""

    ELEVATION_COUNT = 0  # count: elevation encoder: level is 0, upwards is positive
    PITCH_COUNT = 1  # count: pitch encoder: level is 0, positive with the front rotor up
    TRAVEL_COUNT = 2  # count: travel encoder: 0 is the position at which it was zeroed
    ELEVATION_SETPOINT = 3  # rad: elevation setpoint that the control law used, after the limit of its rate
    PITCH_SETPOINT = 4  # rad: pitch setpoint that the control law used: the travel loop's output, or the host's
    TRAVEL_SETPOINT = 5  # rad: travel setpoint that the control law used, after the limit of its rate
    FRONT = 6  # V: voltage that acted on the front motor during this tick, after every limit
    BACK = 7  # V: voltage that acted on the back motor during this tick
    STATE = 8  # enum state: supervisor state
    FAULT = 9  # enum fault: fault code, 0 while none
    FLAGS = 10  # bits flags: flag bits
    TRIGGER = 11  # enum trigger: event that led to the present state; after a touchdown, the event that led to the landing
    SIGNAL_1 = 12  # : first signal of an uploaded law; if the law logs its own setpoints, the board's setpoints follow after the law's signals; 0 while no law flies
    SIGNAL_2 = 13  # : second signal of an uploaded law
    SIGNAL_3 = 14  # : third signal of an uploaded law
    SIGNAL_4 = 15  # : fourth signal of an uploaded law


class MessageId(Name):
    """Second byte of a frame."""

    HELLO = 1  # Opens a session. The layouts of hello and welcome never change, so that any two versions recognise each other.
    PING = 2  # Shows that the host is alive, and compares the clocks of host and board.
    ARM = 3  # Runs the checks before a flight. If they pass, it enables the drivers at zero voltage.
    STOP = 4  # Switches the motors off immediately, in any state. It also ends the armed state.
    CONTROL = 5  # Closes the control loops of the axes in the mask. The other axes get their share of the given voltages. If the mask is 0, no loop is closed (open loop).
    STREAM = 6  # From now on, the host sends the motor voltages (message voltages).
    LAND = 7  # Lands the arm under control, then switches the motors off.
    EXCITE = 8  # Starts an excitation, which is added to the motor voltages.
    EXCITE_STOP = 9  # Ends a running excitation.
    PARAM_SET = 10  # Sets one parameter in memory. ack.value is the value that is now in force.
    PARAMS_READ = 11  # Reads up to 32 parameters from `first` on.
    PARAMS_SAVE = 12  # Writes all parameters to the flash, only while the board is idle.
    PARAMS_DEFAULT = 13  # Sets all parameters to their defaults in memory, only while the board is idle. It does not save them.
    ZERO = 14  # Makes the present position the rest position (elevation) or zero (pitch, travel), only while the board is idle.
    CLEAR_FAULT = 15  # Changes the state from fault to idle.
    STATUS_READ = 16  # Asks for the counters. The board also sends them once per second.
    LAW_BEGIN = 17  # Begins the upload of a law, and deletes the loaded law. Not allowed while a law flies.
    LAW_PART = 18  # Twelve words of the law, in order; the board ignores words behind the last one of the law. ack.value: words received so far. Sending the same part again changes nothing.
    LAW_END = 19  # Ends the upload: the board verifies the law. ack.value: instructions that a call takes in the worst case. If the law is already ready, the answer is the same.
    LAW_FLY = 20  # Starts the law at the next tick, or lets the board's own law take over. ack.detail: the state.
    LAW_SET = 21  # Sets a parameter of the law, also in flight. The value stays until the next upload. ack.value: the value in force.
    LAW_READ = 22  # Asks which law the board has.
    CONTROLLER_READ = 23  # Asks for the name of a compiled controller.
    PARAMS_ORIGIN_READ = 24  # Asks which parameters had a value in the stored set when the board started.
    SETPOINT = 32  # Target that the setpoint should reach at a tick of the board. The setpoint moves there linearly, within the limits of its rate.
    VOLTAGES = 33  # Motor voltages from the host, in the state streamed.
    FOLLOWING = 34  # Setpoints that the host's law follows in the streamed state. The board only logs them; in other states, it ignores this message.
    ACK = 128  # Answer to a command.
    WELCOME = 129  # Answer to hello.
    PONG = 130  # Answer to ping.
    PARAMS = 131  # Parameter values, as many as `count` says (at most 32), in table order.
    STATUS = 132  # Counters since the start of the board. The board sends them once per second with request = 0, and after status_read.
    LAW = 135  # The law that the board has.
    CONTROLLER = 136  # Name of a compiled controller in ASCII; zeros fill the rest.
    PARAMS_ORIGIN = 137  # Where the parameters came from when the board started; after a save, what was saved.
    TELEMETRY = 133  # Samples of consecutive ticks, as differences; the section Telemetry batch gives the layout.
    EVENT = 134  # An event with its reason.


AXES: tuple[str, ...] = ("elevation", "pitch", "travel",)
"""Names of the axes in the order of `Axis`."""


@dataclass(frozen=True, slots=True)
class ParamSpec:
    """One row of the parameter table; ``min``, ``max`` and ``default`` are in ``unit``."""

    index: int
    name: str
    unit: str
    min: float
    max: float
    default: float
    nonzero: bool
    integer: bool
    idle_only: bool
    id: int
    meaning: str


@dataclass(frozen=True, slots=True)
class FaultSpec:
    """One fault: its number, the parameter that set its limit, and what to do."""

    code: int
    name: str
    kind: str
    parameter: str | None
    meaning: str
    remedy: str


@dataclass(frozen=True, slots=True)
class ChannelSpec:
    """One telemetry channel: value = raw * scale, in ``unit``."""

    name: str  # Name in `Channel`, in lower case
    code: str  # Type on the wire, as a format of `struct`
    unit: str
    scale: float  # Value of the raw number 1, in `unit`
    column: str  # Name in samples, flights and tables; for an encoder, that of its angle in rad
    field: str  # Name in a log
    axis: Axis | None  # Axis whose encoder the channel counts; None for other channels
    kind: type[IntEnum] | type[IntFlag] | None  # What its numbers name; None for plain numbers
    meaning: str


PARAMS: tuple[ParamSpec, ...] = (
    ParamSpec(0, "elevation_counts_per_rev", "count", -65536.0, 65536.0, 4096.0, True, False, True, 52847, "counts of the elevation encoder per turn: four times its pulses; a negative number reverses its direction"),
    ParamSpec(1, "pitch_counts_per_rev", "count", -65536.0, 65536.0, 4096.0, True, False, True, 33298, "counts of the pitch encoder per turn: four times its pulses; a negative number reverses its direction"),
    ParamSpec(2, "travel_counts_per_rev", "count", -65536.0, 65536.0, 4096.0, True, False, True, 56105, "counts of the travel encoder per turn: four times its pulses; a negative number reverses its direction"),
    ParamSpec(3, "elevation_rest_deg", "deg", -60.0, 0.0, -25.0, False, False, True, 18648, "elevation of the arm at rest on the table; level is 0"),
    ParamSpec(4, "supply_V", "V", 5.0, 24.0, 12.0, False, False, True, 14206, "supply voltage of the motor drivers; full duty gives this voltage"),
    ParamSpec(5, "motor_min_V", "V", -24.0, 0.0, 0.0, False, False, True, 40861, "lowest motor voltage; with 0, no rotor is ever reversed"),
    ParamSpec(6, "motor_max_V", "V", 0.5, 24.0, 10.0, False, False, True, 44159, "highest motor voltage"),
    ParamSpec(7, "motor_front_sign", "", -1.0, 1.0, 1.0, True, True, True, 39247, "-1 reverses the front motor, as if its leads were swapped"),
    ParamSpec(8, "motor_back_sign", "", -1.0, 1.0, 1.0, True, True, True, 44112, "-1 reverses the back motor, as if its leads were swapped"),
    ParamSpec(9, "dead_zone_V", "V", 0.0, 5.0, 1.0, False, False, False, 7221, "voltage below which a rotor gives no thrust (paper eq. 31); the control law adds it"),
    ParamSpec(10, "hover_V", "V", 0.0, 20.0, 1.4, False, False, False, 45436, "sum of both voltages, above the dead zone, that holds the arm level"),
    ParamSpec(11, "hover_slope", "V/deg", -1.0, 1.0, 0.06, False, False, False, 62739, "change of hover_V with elevation: masses below the axis need more lift at a higher elevation"),
    ParamSpec(12, "elevation_kp", "V/deg", 0.0, 20.0, 0.28, False, False, False, 59537, "elevation proportional gain (paper Table 6: 0.5)"),
    ParamSpec(13, "elevation_ki", "V/(deg s)", 0.0, 20.0, 0.49, False, False, False, 50189, "elevation integral gain (paper Table 6: 1)"),
    ParamSpec(14, "elevation_kd", "V s/deg", 0.0, 20.0, 0.22, False, False, False, 36612, "elevation derivative gain, on the measurement (paper Table 6: 0.1)"),
    ParamSpec(15, "elevation_rate_ff", "", 0.0, 1.0, 1.0, False, False, False, 30968, "share of the setpoint's rate that the derivative term uses; with 0, it uses the measured rate only"),
    ParamSpec(16, "elevation_acceleration_ff", "V s2/deg", 0.0, 1.0, 0.036, False, False, False, 41366, "sum of the voltages per acceleration of the elevation setpoint: inertia / (thrust gain x arm)"),
    ParamSpec(17, "pitch_kp", "V/deg", 0.0, 20.0, 0.09, False, False, False, 19686, "pitch proportional gain (paper Table 6: 0.66)"),
    ParamSpec(18, "pitch_ki", "V/(deg s)", 0.0, 20.0, 0.0025, False, False, False, 19601, "pitch integral gain (paper Table 6: 3)"),
    ParamSpec(19, "pitch_kd", "V s/deg", 0.0, 20.0, 0.028, False, False, False, 16416, "pitch derivative gain, on the measurement (paper Table 6: 0.1)"),
    ParamSpec(20, "pitch_hold_ff", "V/deg", -1.0, 1.0, 0.033, False, False, False, 36726, "difference of the voltages per degree of pitch setpoint, which holds a tilt against the weight below the pitch axis"),
    ParamSpec(21, "travel_kp", "deg/deg", 0.0, 20.0, 0.6, False, False, False, 18791, "travel proportional gain to the pitch setpoint (paper Table 6 with P and I exchanged: 0.7)"),
    ParamSpec(22, "travel_ki", "deg/(deg s)", 0.0, 20.0, 0.06, False, False, False, 54432, "travel integral gain (paper Table 6 with P and I exchanged: 0.13)"),
    ParamSpec(23, "travel_kd", "deg s/deg", 0.0, 20.0, 3.15, False, False, False, 13136, "travel derivative gain, on the measurement (paper Table 6: 1.462)"),
    ParamSpec(24, "travel_rate_ff", "", 0.0, 1.0, 1.0, False, False, False, 10459, "share of the setpoint's rate that the derivative term uses; with 0, it uses the measured rate only"),
    ParamSpec(25, "travel_acceleration_ff", "deg s2/deg", 0.0, 20.0, 1.09, False, False, False, 14566, "pitch per acceleration of the travel setpoint: inertia / (hover thrust x arm)"),
    ParamSpec(26, "elevation_integral_max_V", "V", 0.0, 20.0, 3.0, False, False, False, 31496, "bound of the elevation integrator"),
    ParamSpec(27, "pitch_integral_max_V", "V", 0.0, 20.0, 2.0, False, False, False, 33512, "bound of the pitch integrator"),
    ParamSpec(28, "travel_integral_max_deg", "deg", 0.0, 45.0, 10.0, False, False, False, 15807, "bound of the travel integrator"),
    ParamSpec(29, "elevation_filter_Hz", "Hz", 0.5, 200.0, 6.0, False, False, False, 42134, "cut-off of the elevation rate filter (two poles)"),
    ParamSpec(30, "pitch_filter_Hz", "Hz", 0.5, 200.0, 16.0, False, False, False, 37074, "cut-off of the pitch rate filter (two poles)"),
    ParamSpec(31, "travel_filter_Hz", "Hz", 0.5, 200.0, 3.0, False, False, False, 31395, "cut-off of the travel rate filter (two poles)"),
    ParamSpec(32, "pitch_setpoint_max_deg", "deg", 1.0, 45.0, 30.0, False, False, False, 62937, "largest pitch setpoint, from the travel loop or the host"),
    ParamSpec(33, "differential_max_V", "V", 0.1, 24.0, 1.4, False, False, False, 48257, "largest difference of front and back voltage; the mixer prefers pitch to lift, so a larger difference would lift the arm"),
    ParamSpec(34, "elevation_slew_deg_s", "deg/s", 0.5, 200.0, 15.0, False, False, False, 10933, "fastest change of the elevation setpoint"),
    ParamSpec(35, "pitch_slew_deg_s", "deg/s", 1.0, 1000.0, 90.0, False, False, False, 13902, "fastest change of the pitch setpoint, from the travel loop or the host"),
    ParamSpec(36, "travel_slew_deg_s", "deg/s", 0.5, 200.0, 20.0, False, False, False, 47362, "fastest change of the travel setpoint"),
    ParamSpec(37, "elevation_acceleration_deg_s2", "deg/s2", 1.0, 2000.0, 29.0, False, False, False, 25307, "fastest change of the elevation setpoint's rate, which makes a step a smooth ramp"),
    ParamSpec(38, "travel_acceleration_deg_s2", "deg/s2", 1.0, 2000.0, 4.5, False, False, False, 54873, "fastest change of the travel setpoint's rate; travel can only accelerate by tilting"),
    ParamSpec(39, "bumpless_s", "s", 0.02, 5.0, 0.3, False, False, False, 5611, "time constant of the smooth change from one control law or state to the next"),
    ParamSpec(40, "elevation_max_deg", "deg", 1.0, 60.0, 24.0, False, False, True, 57010, "limit of elevation, above which the board lands without this encoder; setpoints must be 2 degrees lower"),
    ParamSpec(41, "pitch_max_deg", "deg", 5.0, 80.0, 45.0, False, False, True, 32123, "pitch beyond which the motors are cut"),
    ParamSpec(42, "travel_max_deg", "deg", 10.0, 3600.0, 175.0, False, False, True, 23820, "limit of travel, beyond which the motors are cut; setpoints must stay 5 degrees inside it"),
    ParamSpec(43, "elevation_rate_max_deg_s", "deg/s", 10.0, 1000.0, 120.0, False, False, True, 38917, "rate of elevation beyond which the board lands without this encoder"),
    ParamSpec(44, "pitch_rate_max_deg_s", "deg/s", 10.0, 2000.0, 400.0, False, False, True, 64419, "pitch rate beyond which the motors are cut"),
    ParamSpec(45, "travel_rate_max_deg_s", "deg/s", 10.0, 1000.0, 150.0, False, False, True, 42965, "travel rate beyond which the motors are cut"),
    ParamSpec(46, "encoder_illegal_max", "", 0.0, 1000.0, 5.0, False, False, True, 7961, "number of illegal transitions of an encoder since arming that is tolerated"),
    ParamSpec(47, "overrun_max", "", 0.0, 1000.0, 10.0, False, False, True, 61050, "number of late ticks since arming that is tolerated"),
    ParamSpec(48, "elevation_following_max_deg", "deg", 1.0, 180.0, 15.0, False, False, True, 7603, "limit of the distance of elevation from its moving setpoint; after following_s beyond it, the board lands without this encoder"),
    ParamSpec(49, "pitch_following_max_deg", "deg", 1.0, 180.0, 20.0, False, False, True, 321, "limit of the distance of pitch from its setpoint; after following_s beyond it, the motors are cut"),
    ParamSpec(50, "travel_following_max_deg", "deg", 1.0, 3600.0, 30.0, False, False, True, 63735, "limit of the distance of travel from its moving setpoint; after following_s beyond it, the board lands"),
    ParamSpec(51, "following_s", "s", 0.1, 10.0, 1.0, False, False, True, 14065, "time for which an axis may be farther from its setpoint than its limit"),
    ParamSpec(52, "elevation_motion_V", "V", 0.1, 48.0, 1.2, False, False, True, 11783, "change of the sum of the voltages (without dead zones) that must move elevation within motion_s; at take-off, it counts from hover_V"),
    ParamSpec(53, "pitch_motion_V", "V", 0.1, 48.0, 0.5, False, False, True, 15865, "change of front minus back voltage (without dead zones) that must move pitch within motion_s"),
    ParamSpec(54, "motion_s", "s", 0.1, 10.0, 0.5, False, False, True, 45910, "longest time for which elevation or pitch may stay within one count although the motors drive it"),
    ParamSpec(55, "travel_motion_deg", "deg", 0.5, 90.0, 8.0, False, False, True, 51749, "additional pitch, beyond the pitch at which travel rests, that must turn the arm within travel_motion_s"),
    ParamSpec(56, "travel_motion_s", "s", 0.1, 30.0, 1.0, False, False, True, 26309, "time within which travel_motion_deg must turn the arm; if the additional pitch is smaller, the arm may rest longer"),
    ParamSpec(57, "travel_silence_s", "s", 0.0, 60.0, 2.5, False, False, True, 47652, "time in the air without a count of travel after which a short tilt checks the travel encoder; 0 switches this check off"),
    ParamSpec(58, "elevation_gain", "rad/(s2 V)", 0.02, 10.0, 0.485, False, False, False, 12260, "acceleration of elevation per volt of the voltages' sum: thrust gain k L_a / J_theta; predicts how far elevation must move"),
    ParamSpec(59, "pitch_gain", "rad/(s2 V)", 0.1, 100.0, 2.97, False, False, False, 62647, "acceleration of pitch per volt of front minus back voltage: k L_h / J_phi; predicts how far pitch must move"),
    ParamSpec(60, "travel_gain", "1/s2", 0.05, 100.0, 0.5, False, False, False, 47475, "acceleration of travel per radian of pitch at hover: the thrust of both rotors times L_a / J_psi; predicts how far travel must move"),
    ParamSpec(61, "law_jump_max_V", "V", 0.1, 48.0, 2.5, False, False, True, 49258, "largest change of a motor's voltage from one tick to the next; if an uploaded law exceeds it, the board's own law takes over"),
    ParamSpec(62, "law_envelope", "", 0.2, 1.0, 0.8, False, False, True, 51186, "share of the limits of angles, rates and distances from the setpoints; if an uploaded law exceeds it, the board's own law takes over"),
    ParamSpec(63, "arm_rate_max_deg_s", "deg/s", 0.1, 100.0, 3.0, False, False, True, 43912, "the board arms only if no axis turns faster than this"),
    ParamSpec(64, "arm_elevation_tolerance_deg", "deg", 0.1, 60.0, 2.0, False, False, True, 4074, "the board arms only if elevation is this close to rest"),
    ParamSpec(65, "arm_pitch_tolerance_deg", "deg", 0.1, 60.0, 10.0, False, False, True, 2930, "the board arms only if pitch is this close to level"),
    ParamSpec(66, "setpoint_hold_s", "s", 0.05, 5.0, 0.5, False, False, True, 62867, "time without a recent setpoint after which the board holds level"),
    ParamSpec(67, "setpoint_land_s", "s", 0.1, 30.0, 2.0, False, False, True, 30307, "time without a recent setpoint after which the board lands"),
    ParamSpec(68, "landing_rate_deg_s", "deg/s", 0.5, 60.0, 8.0, False, False, False, 47532, "rate at which the elevation setpoint decreases while landing"),
    ParamSpec(69, "landing_timeout_s", "s", 1.0, 60.0, 12.0, False, False, True, 4700, "longest landing; then the motors are switched off with a fault. A landing without the elevation encoder takes 1.5 times as long"),
    ParamSpec(70, "voltage_valid_max_ms", "ms", 5.0, 500.0, 100.0, False, False, True, 46174, "longest time that a streamed voltage acts"),
    ParamSpec(71, "excitation_max_V", "V", 0.0, 12.0, 2.0, False, False, True, 50530, "largest amplitude of an excitation"),
    ParamSpec(72, "excitation_max_s", "s", 1.0, 600.0, 120.0, False, False, True, 26314, "longest duration of an excitation"),
    ParamSpec(73, "telemetry_batch_ticks", "tick", 4.0, 32.0, 20.0, False, True, False, 49108, "ticks per telemetry batch: 20 saves bandwidth, 5 reduces the delay for a host controller"),
    ParamSpec(74, "controller", "", 0.0, 7.0, 0.0, False, True, True, 6747, "compiled controller that flies: its row in the board's table; a number beyond the last row is refused"),
)

FAULTS: tuple[FaultSpec, ...] = (
    FaultSpec(1, "elevation_limit", "land", "elevation_max_deg", "elevation above its limit", "lower the setpoint; lift the arm by hand and check that elevation rises in heli-host watch; tune the gains for this rig"),
    FaultSpec(2, "pitch_limit", "trip", "pitch_max_deg", "pitch beyond its limit", "check that the front rotor lifts the front, and that pitch then rises; otherwise exchange the motors; then tune the gains"),
    FaultSpec(3, "travel_limit", "trip", "travel_max_deg", "travel beyond its limit, so that the cables wind up", "turn the arm back by hand, then zero travel"),
    FaultSpec(4, "elevation_rate", "land", "elevation_rate_max_deg_s", "elevation moved faster than its limit", "look at the figure: after a single jump, check the encoder's cable; if elevation oscillates, tune the gains"),
    FaultSpec(5, "pitch_rate", "trip", "pitch_rate_max_deg_s", "pitch moved faster than its limit", "look at the figure: after a single jump, check the encoder's cable; if pitch oscillates, tune the gains"),
    FaultSpec(6, "travel_rate", "trip", "travel_rate_max_deg_s", "travel moved faster than its limit", "look at the figure: after a single jump, check the encoder's cable; if travel oscillates, tune the gains"),
    FaultSpec(7, "encoder_elevation", "land", "encoder_illegal_max", "too many illegal transitions of the elevation encoder", "check its plug, pull-ups, shield and ground"),
    FaultSpec(8, "encoder_pitch", "land", "encoder_illegal_max", "too many illegal transitions of the pitch encoder", "check its plug, pull-ups, shield and ground"),
    FaultSpec(9, "encoder_travel", "land", "encoder_illegal_max", "too many illegal transitions of the travel encoder", "check its plug, pull-ups, shield and ground"),
    FaultSpec(10, "landing_timeout", "trip", "landing_timeout_s", "the arm did not reach the table in time", "check that nothing holds the arm, and that its weight brings it down without voltage"),
    FaultSpec(11, "tick_overrun", "trip", "overrun_max", "too many control ticks ran late", "report it with the log: the firmware missed its deadline"),
    FaultSpec(12, "hardware_stop", "trip", None, "the hardware stop input is active", "release the stop, check its wire, then clear the fault; without a switch, connect D29 to ground"),
    FaultSpec(13, "elevation_following", "land", "elevation_following_max_deg", "elevation stayed too far from its setpoint for following_s", "check supply and propellers, then hover_V, then the elevation encoder; tune the gains for this rig"),
    FaultSpec(14, "pitch_following", "trip", "pitch_following_max_deg", "pitch stayed too far from its setpoint for following_s", "check that both rotors push, then the gains and the pitch encoder; tune the gains for this rig"),
    FaultSpec(15, "travel_following", "land", "travel_following_max_deg", "travel stayed too far from its setpoint for following_s", "look for a cable, a draught or friction that holds or drives the arm; then check the gains and the travel encoder"),
    FaultSpec(16, "encoder_overload", "trip", None, "encoder edges came faster than the board can count, so the angle is wrong", "look for noise from the motors, a missing ground or a missing pull-up; then zero the axis"),
    FaultSpec(17, "elevation_motionless", "land", "elevation_motion_V", "the sum of both voltages changed enough to move the arm, but the elevation encoder did not count", "check the elevation encoder's plug, the motors' supply and enable lines; a heavier rig needs its own hover_V (tune)"),
    FaultSpec(18, "pitch_motionless", "land", "pitch_motion_V", "the difference of the voltages changed enough to tilt the short arm, but the pitch encoder did not count", "check the pitch encoder's plug, then that both rotors push"),
    FaultSpec(19, "travel_motionless", "land", "travel_motion_deg", "pitch tilted long enough to turn the arm, but the travel encoder did not count; value: predicted travel in deg", "check the travel encoder's plug; look for friction, or a cable that holds the arm; with much friction, raise travel_motion_deg"),
    FaultSpec(20, "not_at_rest", "check", "arm_elevation_tolerance_deg", "the arm does not rest on the table", "let it rest on the table and zero it; if it rests at another angle, set elevation_rest_deg"),
    FaultSpec(21, "moving", "check", "arm_rate_max_deg_s", "an axis is moving", "wait until everything is still"),
    FaultSpec(22, "link_not_alive", "check", "setpoint_hold_s", "no recent frame from the host", "keep the session open while arming; a debugger or a busy computer may have paused it"),
    FaultSpec(23, "parameters_invalid", "check", None, "the stored parameters are damaged or contradict each other", "restore your copy with heli-host params restore FILE --save, or set the named parameters and save"),
    FaultSpec(24, "pitch_not_level", "check", "arm_pitch_tolerance_deg", "the short arm is not level", "level it, or zero it while level"),
    FaultSpec(25, "elevation_below_table", "land", "arm_elevation_tolerance_deg", "elevation read more than 1 degree plus this tolerance below the table, where the arm cannot be", "check the elevation encoder's plug; then let the arm rest on the table and zero it"),
    FaultSpec(26, "elevation_step", "land", "elevation_rate_max_deg_s", "elevation changed within 4 ms by more than the arm can turn; the board does not arm until the axis is zeroed", "check the elevation encoder's plug and cable; then let the arm rest on the table and zero it"),
    FaultSpec(27, "pitch_step", "land", "pitch_rate_max_deg_s", "pitch changed within 4 ms by more than the short arm can turn; the board does not arm until the axis is zeroed", "check the pitch encoder's plug and cable, and that nothing strikes the short arm; then level it and zero it"),
    FaultSpec(28, "travel_step", "land", "travel_rate_max_deg_s", "travel changed within 4 ms by more than the arm can turn; the board does not arm until the axis is zeroed", "check the travel encoder's plug and cable; then zero it"),
    FaultSpec(29, "elevation_rest", "trip", "elevation_rest_deg", "after landing, the arm rests without lift at another elevation than before take-off", "check the elevation encoder's plug; if the arm floats or sticks above the table without voltage, shift its counterweight or free its bearing; then let it rest on the table and zero it"),
    FaultSpec(33, "elevation_sign", "trip", None, "at take-off, elevation decreased although the rotors lift: the sign of the elevation encoder is wrong", "lift the arm by hand: heli-host watch must show a larger elevation; if not, reverse the sign of elevation_counts_per_rev, or swap the encoder's lines A and B"),
    FaultSpec(34, "pitch_sign", "land", "pitch_motion_V", "pitch turned against the difference of the voltages: the sign of the pitch encoder is wrong, the motors are exchanged, or one pushes down", "tilt the short arm by hand: pitch must be positive with the front rotor up; then try each motor alone with heli-host motors"),
    FaultSpec(35, "travel_sign", "land", "travel_motion_deg", "travel turned against the tilt: the sign of the travel encoder is wrong", "turn the arm by hand and compare with the signs; reverse the sign of travel_counts_per_rev, or swap the encoder's lines A and B; after a loose pitch plug, zero pitch"),
    FaultSpec(30, "watchdog", "boot", None, "the watchdog restarted the board, because the control tick or the idle loop hung", "report it with the log"),
    FaultSpec(31, "hard_fault", "boot", None, "the processor reported an error; the board switched off the motor drivers and restarted", "report it with the log"),
    FaultSpec(32, "unexpected_interrupt", "boot", None, "an interrupt without a handler came; the board switched off the motor drivers and restarted", "report it with the log"),
)

CHANNELS: tuple[ChannelSpec, ...] = (
    ChannelSpec("elevation_count", "<i", "count", 1.0, "elevation_rad", "elevation_count", Axis.ELEVATION, None, "elevation encoder: level is 0, upwards is positive"),
    ChannelSpec("pitch_count", "<i", "count", 1.0, "pitch_rad", "pitch_count", Axis.PITCH, None, "pitch encoder: level is 0, positive with the front rotor up"),
    ChannelSpec("travel_count", "<i", "count", 1.0, "travel_rad", "travel_count", Axis.TRAVEL, None, "travel encoder: 0 is the position at which it was zeroed"),
    ChannelSpec("elevation_setpoint", "<i", "rad", 1e-05, "elevation_setpoint_rad", "elevation_setpoint_rad", None, None, "elevation setpoint that the control law used, after the limit of its rate"),
    ChannelSpec("pitch_setpoint", "<i", "rad", 1e-05, "pitch_setpoint_rad", "pitch_setpoint_rad", None, None, "pitch setpoint that the control law used: the travel loop's output, or the host's"),
    ChannelSpec("travel_setpoint", "<i", "rad", 1e-05, "travel_setpoint_rad", "travel_setpoint_rad", None, None, "travel setpoint that the control law used, after the limit of its rate"),
    ChannelSpec("front", "<h", "V", 0.001, "front_V", "front_volt", None, None, "voltage that acted on the front motor during this tick, after every limit"),
    ChannelSpec("back", "<h", "V", 0.001, "back_V", "back_volt", None, None, "voltage that acted on the back motor during this tick"),
    ChannelSpec("state", "<B", "enum state", 1.0, "state", "state", None, State, "supervisor state"),
    ChannelSpec("fault", "<B", "enum fault", 1.0, "fault", "fault", None, Fault, "fault code, 0 while none"),
    ChannelSpec("flags", "<B", "bits flags", 1.0, "flags", "flags", None, Flags, "flag bits"),
    ChannelSpec("trigger", "<B", "enum trigger", 1.0, "trigger", "trigger", None, Trigger, "event that led to the present state; after a touchdown, the event that led to the landing"),
    ChannelSpec("signal_1", "<i", "", 1e-05, "signal_1", "signal_1", None, None, "first signal of an uploaded law; if the law logs its own setpoints, the board's setpoints follow after the law's signals; 0 while no law flies"),
    ChannelSpec("signal_2", "<i", "", 1e-05, "signal_2", "signal_2", None, None, "second signal of an uploaded law"),
    ChannelSpec("signal_3", "<i", "", 1e-05, "signal_3", "signal_3", None, None, "third signal of an uploaded law"),
    ChannelSpec("signal_4", "<i", "", 1e-05, "signal_4", "signal_4", None, None, "fourth signal of an uploaded law"),
)


@dataclass(frozen=True)
class ChannelValues:
    """The values of all channels in one tick, each in its unit."""

    tick: int  # Device time [tick], unwrapped beyond 2^32
    elevation_rad: float  # elevation encoder: level is 0, upwards is positive [rad]
    pitch_rad: float  # pitch encoder: level is 0, positive with the front rotor up [rad]
    travel_rad: float  # travel encoder: 0 is the position at which it was zeroed [rad]
    elevation_setpoint_rad: float  # elevation setpoint that the control law used, after the limit of its rate [rad]
    pitch_setpoint_rad: float  # pitch setpoint that the control law used: the travel loop's output, or the host's [rad]
    travel_setpoint_rad: float  # travel setpoint that the control law used, after the limit of its rate [rad]
    front_V: float  # voltage that acted on the front motor during this tick, after every limit [V]
    back_V: float  # voltage that acted on the back motor during this tick [V]
    state: State  # supervisor state
    fault: Fault  # fault code, 0 while none
    flags: Flags  # flag bits
    trigger: Trigger  # event that led to the present state; after a touchdown, the event that led to the landing
    signal_1: float  # first signal of an uploaded law; if the law logs its own setpoints, the board's setpoints follow after the law's signals; 0 while no law flies
    signal_2: float  # second signal of an uploaded law
    signal_3: float  # third signal of an uploaded law
    signal_4: float  # fourth signal of an uploaded law


@dataclass(frozen=True)
class ChannelArrays:
    """The values of all channels in many ticks, as in `ChannelValues`: arrays of shape (n,).

    A gap in `tick` means that ticks were lost.
    """

    tick: NDArray[np.int64]
    elevation_rad: NDArray[np.float64]
    pitch_rad: NDArray[np.float64]
    travel_rad: NDArray[np.float64]
    elevation_setpoint_rad: NDArray[np.float64]
    pitch_setpoint_rad: NDArray[np.float64]
    travel_setpoint_rad: NDArray[np.float64]
    front_V: NDArray[np.float64]
    back_V: NDArray[np.float64]
    state: NDArray[np.uint8]
    fault: NDArray[np.uint8]
    flags: NDArray[np.uint8]
    trigger: NDArray[np.uint8]
    signal_1: NDArray[np.float64]
    signal_2: NDArray[np.float64]
    signal_3: NDArray[np.float64]
    signal_4: NDArray[np.float64]

LAW_FORMAT = 2
LAW_CELLS = 512
LAW_WORDS = 1536
LAW_SIGNALS = 4
LAW_MAX_TICKS = 16
LAW_MAX_TERMS = 64
LAW_TICK_COST = 20000
LAW_FIXED_COST = 1120
LAW_OUTPUT_COST = 320
LAW_INPUT_COST = 22
LAW_MOVING_COST = 135
LAW_TERM_COST = 41
LAW_STATE_COST = 13
LAW_SIGNAL_COST = 80
LAW_INPUTS: tuple[str, ...] = (
    "elevation_rad",
    "pitch_rad",
    "travel_rad",
    "elevation_rad_s",
    "pitch_rad_s",
    "travel_rad_s",
    "elevation_setpoint_rad",
    "pitch_setpoint_rad",
    "travel_setpoint_rad",
    "elevation_setpoint_rad_s",
    "pitch_setpoint_rad_s",
    "travel_setpoint_rad_s",
    "elevation_setpoint_rad_s2",
    "pitch_setpoint_rad_s2",
    "travel_setpoint_rad_s2",
    "front_V",
    "back_V",
)
"""Inputs of a law, in the order of its cells."""


@dataclass(frozen=True, slots=True)
class OperationSpec:
    """One operation of a law: its number, its number of operands, and its worst-case instructions."""

    name: str
    code: int
    operands: int
    cost: int
    meaning: str


OPERATIONS: tuple[OperationSpec, ...] = (
    OperationSpec("copy", 0, 1, 15, "a"),
    OperationSpec("add", 1, 2, 63, "a + b"),
    OperationSpec("subtract", 2, 2, 64, "a - b"),
    OperationSpec("multiply", 3, 2, 51, "a b"),
    OperationSpec("divide", 4, 2, 78, "a / b"),
    OperationSpec("negate", 5, 1, 17, "-a"),
    OperationSpec("absolute", 6, 1, 17, "|a|"),
    OperationSpec("minimum", 7, 2, 30, "the smaller of a and b; not a number (NaN) if a or b is NaN"),
    OperationSpec("maximum", 8, 2, 30, "the larger of a and b; NaN if a or b is NaN"),
    OperationSpec("less", 9, 2, 35, "1 if a < b, otherwise 0; NaN if a or b is NaN, as in all conditions"),
    OperationSpec("less_equal", 10, 2, 35, "1 if a <= b, otherwise 0"),
    OperationSpec("equal", 11, 2, 35, "1 if a = b, otherwise 0"),
    OperationSpec("not_equal", 12, 2, 35, "1 if a is not b, otherwise 0"),
    OperationSpec("both", 13, 2, 27, "1 if neither a nor b is 0, otherwise 0"),
    OperationSpec("either", 14, 2, 26, "1 if a or b is not 0, otherwise 0"),
    OperationSpec("negation", 15, 1, 23, "1 if a is 0, otherwise 0"),
    OperationSpec("select", 16, 2, 22, "b if a is not 0, otherwise 0; b has no effect if it is not selected"),
    OperationSpec("floor", 17, 1, 31, "the greatest whole number that is not above a"),
    OperationSpec("square_root", 18, 1, 299, "square root of a; NaN below 0"),
    OperationSpec("sine", 19, 1, 93, "of a in rad; NaN beyond 8192 rad"),
    OperationSpec("cosine", 20, 1, 89, "of a in rad; NaN beyond 8192 rad"),
    OperationSpec("tangent", 21, 1, 228, "of a in rad; NaN beyond 8192 rad"),
    OperationSpec("arctangent", 22, 2, 238, "of a / b, in the quadrant of (b, a), rad"),
    OperationSpec("hyperbolic_tangent", 23, 1, 277, "of a"),
    OperationSpec("exponential", 24, 1, 127, "e to the power of a"),
    OperationSpec("sum_of_products", 25, 0, 63, "a b + c d - ... of the terms that follow it, rounded once; NaN if one of them is not finite"),
)


@dataclass(frozen=True, slots=True)
class HelloMessage(Message):
    """Opens a session. The layouts of hello and welcome never change, so that any two versions recognise each other."""

    ID: ClassVar[MessageId] = MessageId.HELLO
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BII")
    REPLY: ClassVar[MessageId] = MessageId.WELCOME
    request: int  # request number; a retry repeats it
    link_hash: int  # hash of the host's declaration
    session: int  # random number of this host session; a new one clears the memory of past requests


@dataclass(frozen=True, slots=True)
class PingMessage(Message):
    """Shows that the host is alive, and compares the clocks of host and board."""

    ID: ClassVar[MessageId] = MessageId.PING
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BQ")
    REPLY: ClassVar[MessageId] = MessageId.PONG
    request: int  # request number; a retry repeats it
    host_us: int  # clock of the host when it sends; the answer repeats it [us]


@dataclass(frozen=True, slots=True)
class ArmMessage(Message):
    """Runs the checks before a flight. If they pass, it enables the drivers at zero voltage."""

    ID: ClassVar[MessageId] = MessageId.ARM
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class StopMessage(Message):
    """Switches the motors off immediately, in any state. It also ends the armed state."""

    ID: ClassVar[MessageId] = MessageId.STOP
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class ControlMessage(Message):
    """Closes the control loops of the axes in the mask. The other axes get their share of the given voltages. If the mask is 0, no loop is closed (open loop)."""

    ID: ClassVar[MessageId] = MessageId.CONTROL
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BBff")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it
    axes: int  # axes to close [bits axes]
    front_V: float  # front voltage for what is not closed [V]
    back_V: float  # back voltage for what is not closed [V]


@dataclass(frozen=True, slots=True)
class StreamMessage(Message):
    """From now on, the host sends the motor voltages (message voltages)."""

    ID: ClassVar[MessageId] = MessageId.STREAM
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class LandMessage(Message):
    """Lands the arm under control, then switches the motors off."""

    ID: ClassVar[MessageId] = MessageId.LAND
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class ExciteMessage(Message):
    """Starts an excitation, which is added to the motor voltages."""

    ID: ClassVar[MessageId] = MessageId.EXCITE
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BBfffffI")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it
    kind: int  # signal [enum excitation]
    front_V: float  # amplitude on the front motor [V]
    back_V: float  # amplitude on the back motor [V]
    start_Hz: float  # lowest frequency (chirp, multisine) [Hz]
    stop_Hz: float  # highest frequency (chirp, multisine), or switching rate (prbs) [Hz]
    duration_s: float  # length; then the excitation ends by itself [s]
    seed: int  # seed of prbs, not 0


@dataclass(frozen=True, slots=True)
class ExciteStopMessage(Message):
    """Ends a running excitation."""

    ID: ClassVar[MessageId] = MessageId.EXCITE_STOP
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class ParamSetMessage(Message):
    """Sets one parameter in memory. ack.value is the value that is now in force."""

    ID: ClassVar[MessageId] = MessageId.PARAM_SET
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BBf")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it
    index: int  # position in the parameter table [enum param]
    value: float  # new value [as declared]


@dataclass(frozen=True, slots=True)
class ParamsReadMessage(Message):
    """Reads up to 32 parameters from `first` on."""

    ID: ClassVar[MessageId] = MessageId.PARAMS_READ
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BB")
    REPLY: ClassVar[MessageId] = MessageId.PARAMS
    request: int  # request number; a retry repeats it
    first: int  # first index wanted [enum param]


@dataclass(frozen=True, slots=True)
class ParamsSaveMessage(Message):
    """Writes all parameters to the flash, only while the board is idle."""

    ID: ClassVar[MessageId] = MessageId.PARAMS_SAVE
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class ParamsDefaultMessage(Message):
    """Sets all parameters to their defaults in memory, only while the board is idle. It does not save them."""

    ID: ClassVar[MessageId] = MessageId.PARAMS_DEFAULT
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class ZeroMessage(Message):
    """Makes the present position the rest position (elevation) or zero (pitch, travel), only while the board is idle."""

    ID: ClassVar[MessageId] = MessageId.ZERO
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BB")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it
    axes: int  # axes to zero [bits axes]


@dataclass(frozen=True, slots=True)
class ClearFaultMessage(Message):
    """Changes the state from fault to idle."""

    ID: ClassVar[MessageId] = MessageId.CLEAR_FAULT
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class StatusReadMessage(Message):
    """Asks for the counters. The board also sends them once per second."""

    ID: ClassVar[MessageId] = MessageId.STATUS_READ
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.STATUS
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class LawBeginMessage(Message):
    """Begins the upload of a law, and deletes the loaded law. Not allowed while a law flies."""

    ID: ClassVar[MessageId] = MessageId.LAW_BEGIN
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BIH")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it
    hash: int  # CRC-32 of the words of the law, little-endian
    words: int  # number of these words


@dataclass(frozen=True, slots=True)
class LawPartMessage(Message):
    """Twelve words of the law, in order; the board ignores words behind the last one of the law. ack.value: words received so far. Sending the same part again changes nothing."""

    ID: ClassVar[MessageId] = MessageId.LAW_PART
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BHIIIIIIIIIIII")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it
    first: int  # position of the first of these words in the law
    word_0: int  # word first + 0
    word_1: int  # word first + 1
    word_2: int  # word first + 2
    word_3: int  # word first + 3
    word_4: int  # word first + 4
    word_5: int  # word first + 5
    word_6: int  # word first + 6
    word_7: int  # word first + 7
    word_8: int  # word first + 8
    word_9: int  # word first + 9
    word_10: int  # word first + 10
    word_11: int  # word first + 11


@dataclass(frozen=True, slots=True)
class LawEndMessage(Message):
    """Ends the upload: the board verifies the law. ack.value: instructions that a call takes in the worst case. If the law is already ready, the answer is the same."""

    ID: ClassVar[MessageId] = MessageId.LAW_END
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class LawFlyMessage(Message):
    """Starts the law at the next tick, or lets the board's own law take over. ack.detail: the state."""

    ID: ClassVar[MessageId] = MessageId.LAW_FLY
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BB")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it
    on: int  # 1: the law; 0: the board's own law


@dataclass(frozen=True, slots=True)
class LawSetMessage(Message):
    """Sets a parameter of the law, also in flight. The value stays until the next upload. ack.value: the value in force."""

    ID: ClassVar[MessageId] = MessageId.LAW_SET
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BBf")
    REPLY: ClassVar[MessageId] = MessageId.ACK
    request: int  # request number; a retry repeats it
    index: int  # position of the parameter in the law
    value: float  # new value


@dataclass(frozen=True, slots=True)
class LawReadMessage(Message):
    """Asks which law the board has."""

    ID: ClassVar[MessageId] = MessageId.LAW_READ
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.LAW
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class ControllerReadMessage(Message):
    """Asks for the name of a compiled controller."""

    ID: ClassVar[MessageId] = MessageId.CONTROLLER_READ
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BB")
    REPLY: ClassVar[MessageId] = MessageId.CONTROLLER
    request: int  # request number; a retry repeats it
    index: int  # value of the parameter `controller`


@dataclass(frozen=True, slots=True)
class ParamsOriginReadMessage(Message):
    """Asks which parameters had a value in the stored set when the board started."""

    ID: ClassVar[MessageId] = MessageId.PARAMS_ORIGIN_READ
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<B")
    REPLY: ClassVar[MessageId] = MessageId.PARAMS_ORIGIN
    request: int  # request number; a retry repeats it


@dataclass(frozen=True, slots=True)
class SetpointMessage(Message):
    """Target that the setpoint should reach at a tick of the board. The setpoint moves there linearly, within the limits of its rate."""

    ID: ClassVar[MessageId] = MessageId.SETPOINT
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<Ifff")
    apply_tick: int  # tick at which the setpoint should reach the target; if it is past: immediately; more than 500 ticks ahead: refused [tick]
    elevation_rad: float  # elevation target [rad]
    pitch_rad: float  # pitch target; used only while the travel loop is not closed [rad]
    travel_rad: float  # travel target [rad]


@dataclass(frozen=True, slots=True)
class VoltagesMessage(Message):
    """Motor voltages from the host, in the state streamed."""

    ID: ClassVar[MessageId] = MessageId.VOLTAGES
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<ffH")
    front_V: float  # front motor [V]
    back_V: float  # back motor [V]
    valid_ms: int  # how long the voltages may act; then the board holds the arm level by itself [ms]


@dataclass(frozen=True, slots=True)
class FollowingMessage(Message):
    """Setpoints that the host's law follows in the streamed state. The board only logs them; in other states, it ignores this message."""

    ID: ClassVar[MessageId] = MessageId.FOLLOWING
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<fff")
    elevation_rad: float  # elevation setpoint [rad]
    pitch_rad: float  # pitch setpoint [rad]
    travel_rad: float  # travel setpoint [rad]


@dataclass(frozen=True, slots=True)
class AckMessage(Message):
    """Answer to a command."""

    ID: ClassVar[MessageId] = MessageId.ACK
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BBBBf")
    request: int  # request number; a retry repeats it
    command: int  # command answered [message id]
    result: int  # result [enum result]
    detail: int  # see the result's meaning
    value: float  # value in force, or the quantity that was refused


@dataclass(frozen=True, slots=True)
class WelcomeMessage(Message):
    """Answer to hello."""

    ID: ClassVar[MessageId] = MessageId.WELCOME
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BBIBBBBBBBBIIB")
    request: int  # request number; a retry repeats it
    result: int  # ok or hash_mismatch [enum result]
    link_hash: int  # hash of the board's declaration
    link_major: int  # version of the board's declaration
    link_minor: int  # version of the board's declaration
    firmware_major: int  # version of the flight code
    firmware_minor: int  # version of the flight code
    firmware_patch: int  # version of the flight code
    board: int  # 0 native, 1 Arduino Due
    reset: int  # why the board started [enum reset]
    boot_fault: int  # fault that was recorded before this start, 0 if none [enum fault]
    boot_id: int  # 24 random bits, new at every start; with the tick, the host distinguishes a reconnection from a restart of the board
    tick: int  # device time [tick]
    params_source: int  # where the parameters came from [enum params_source]


@dataclass(frozen=True, slots=True)
class PongMessage(Message):
    """Answer to ping."""

    ID: ClassVar[MessageId] = MessageId.PONG
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BQI")
    request: int  # request number; a retry repeats it
    host_us: int  # as sent [us]
    tick: int  # tick of the board at the answer [tick]


@dataclass(frozen=True, slots=True)
class ParamsMessage(Message):
    """Parameter values, as many as `count` says (at most 32), in table order."""

    ID: ClassVar[MessageId] = MessageId.PARAMS
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BBB")
    request: int  # request number; a retry repeats it
    first: int  # index of the first value [enum param]
    count: int  # number of f32 values that follow


@dataclass(frozen=True, slots=True)
class StatusMessage(Message):
    """Counters since the start of the board. The board sends them once per second with request = 0, and after status_read."""

    ID: ClassVar[MessageId] = MessageId.STATUS
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BIIIIIIIIHHHHH")
    request: int  # request number; a retry repeats it
    tick: int  # device time [tick]
    frames_ok: int  # frames accepted from the host
    frames_bad: int  # frames refused: COBS, length, CRC, protocol
    frames_lost: int  # frames of the host that are missing in its sequence numbers
    duplicates: int  # repeated commands that were answered from memory
    stale_streams: int  # streamed values that were refused
    ticks_dropped: int  # telemetry ticks not sent because the line was full [tick]
    overruns: int  # ticks that ran late
    tick_max_us: int  # longest tick [us]
    illegal_elevation: int  # illegal encoder transitions; 65535: that many or more
    illegal_pitch: int  # illegal encoder transitions; 65535: that many or more
    illegal_travel: int  # illegal encoder transitions; 65535: that many or more
    setpoint_rate_Hz: int  # streamed values accepted during the last second [Hz]


@dataclass(frozen=True, slots=True)
class LawMessage(Message):
    """The law that the board has."""

    ID: ClassVar[MessageId] = MessageId.LAW
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BIBBBI")
    request: int  # request number; a retry repeats it
    hash: int  # as given by law_begin; 0 without a law
    state: int  # state of the law [enum law_state]
    divisor: int  # ticks from one call to the next
    ticks: int  # ticks that a call is spread over [tick]
    cost: int  # instructions of a call in the worst case


@dataclass(frozen=True, slots=True)
class ControllerMessage(Message):
    """Name of a compiled controller in ASCII; zeros fill the rest."""

    ID: ClassVar[MessageId] = MessageId.CONTROLLER
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BBBIIII")
    request: int  # request number; a retry repeats it
    index: int  # as requested
    count: int  # controllers that the board was built with
    name_0: int  # characters 1 to 4, the first in the low byte; 0 beyond the last controller
    name_1: int  # characters 5 to 8
    name_2: int  # characters 9 to 12
    name_3: int  # characters 13 to 16


@dataclass(frozen=True, slots=True)
class ParamsOriginMessage(Message):
    """Where the parameters came from when the board started; after a save, what was saved."""

    ID: ClassVar[MessageId] = MessageId.PARAMS_ORIGIN
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<BBIBBIII")
    request: int  # request number; a retry repeats it
    source: int  # where the parameters came from [enum params_source]
    schema: int  # hash of the schema under which they were stored
    kept: int  # number of stored values that are in force
    dropped: int  # number of stored values that were not used, because they are unknown or out of range
    new_0: int  # bit i: parameter i had no usable stored value and has its default
    new_1: int  # parameters 32 to 63
    new_2: int  # parameters 64 to 95


@dataclass(frozen=True, slots=True)
class TelemetryMessage(Message):
    """Samples of consecutive ticks, as differences; the section Telemetry batch gives the layout."""

    ID: ClassVar[MessageId] = MessageId.TELEMETRY
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<IB")
    first_tick: int  # tick of the first sample [tick]
    count: int  # number of ticks in the batch, at least 1


@dataclass(frozen=True, slots=True)
class EventMessage(Message):
    """An event with its reason."""

    ID: ClassVar[MessageId] = MessageId.EVENT
    STRUCT: ClassVar[struct.Struct] = struct.Struct("<IBBBf")
    tick: int  # when [tick]
    kind: int  # what [enum event]
    detail: int  # see the event's meaning
    cause: int  # see the event's meaning [enum trigger]
    value: float  # see the event's meaning
