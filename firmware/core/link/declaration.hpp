// Written by firmware/generate.py from firmware/link.toml. Do not edit.
// clang-format off
#pragma once

#include <cstddef>
#include <cstdint>

#include "bytes.hpp"

namespace heli::link {

inline constexpr std::uint32_t kLinkHash = 0x56651d81U;
inline constexpr std::uint32_t kParamsHash = 0xf6fef19eU;
inline constexpr std::uint8_t kLinkMajor = 1;
inline constexpr std::uint8_t kLinkMinor = 5;
inline constexpr std::uint8_t kFirmwareMajor = 0;
inline constexpr std::uint8_t kFirmwareMinor = 1;
inline constexpr std::uint8_t kFirmwarePatch = 0;
inline constexpr std::uint8_t kProtocol = 1;
inline constexpr std::uint32_t kBaud = 250000;
inline constexpr std::uint32_t kTick_us = 1000;
inline constexpr std::size_t kMaxCommandPayload = 64;
inline constexpr std::size_t kMaxTelemetryPayload = 480;

// Distances between the accepted setpoints and these parameters, in degrees.
inline constexpr float kElevationMaxMargin_deg = 2.0F;
inline constexpr float kTravelMaxMargin_deg = 5.0F;
inline constexpr float kElevationRestMargin_deg = 1.0F;

// Axes in the order used everywhere: in telemetry, masks and messages.
enum class Axis : std::uint8_t {
  elevation = 0,  // angle of the long arm; positive is up
  pitch = 1,  // angle of the short arm about the long arm; positive if the front rotor pushes more
  travel = 2,  // angle about the vertical; a positive pitch accelerates it positively
};
inline constexpr std::size_t kAxisCount = 3;

// State of the supervisor, sent with every tick.
enum class State : std::uint8_t {
  idle = 0,  // drivers disabled, motors off; the only state in which every parameter may be set
  armed = 1,  // drivers enabled at zero voltage, pre-flight checks passed
  closed_loop = 2,  // the board's control law controls the axes of the axis mask
  open_loop = 3,  // constant voltages plus excitation; no control loop is closed
  streamed = 4,  // the host sends the motor voltages; each acts for a limited time only
  hold = 5,  // no recent setpoint: the board hovers level in place
  landing = 6,  // controlled descent to the table, then motors off
  fault = 7,  // motors off; the fault stays until clear_fault
  emergency_landing = 8,  // descent after a fault, without control of the axis whose reading is wrong; then motors off, and the fault stays until clear_fault
};
inline constexpr std::size_t kStateCount = 9;

// Answer to a command.
enum class Result : std::uint8_t {
  ok = 0,  // done
  unknown_command = 1,  // no such message id
  bad_length = 2,  // the payload length is wrong for this message
  bad_value = 3,  // a field is out of range or not finite; detail is its position in the message, from 0
  bad_state = 4,  // not allowed in the current state; detail is the state
  check_failed = 5,  // a pre-flight check failed; detail is the fault code
  out_of_range = 6,  // parameter value outside its range; detail is the parameter
  no_such_parameter = 7,  // parameter index beyond the table
  unsafe_now = 8,  // this parameter may only be set while idle; detail is the parameter
  flash_failed = 9,  // the parameter page could not be written and verified
  no_handshake = 10,  // hello with a matching declaration must come first
  hash_mismatch = 11,  // host and board were built from different declarations
  bad_law = 12,  // the law is refused; detail is the law_error, and the meaning of value is listed there
};
inline constexpr std::size_t kResultCount = 13;

// Reasons for refusing a law or a part of it. The text of each reason states the meaning of ack.value.
enum class LawError : std::uint8_t {
  none = 0,  // nothing is wrong
  not_loaded = 1,  // no law is loaded; value 0
  flying = 2,  // the loaded law flies, so it cannot be replaced; value 0
  too_long = 3,  // the law is too long for an upload; value = largest number of words allowed
  wrong_part = 4,  // a part beyond the end, or before law_begin; value = its first word
  incomplete = 5,  // parts are missing; value = words received
  wrong_hash = 6,  // the hash does not match the received words; value 0
  wrong_format = 7,  // another version of the format, or counts that contradict the length; value = number of words that follows from the counts
  too_large = 8,  // the law needs more cells than there are; value = cells that it needs
  unknown_operation = 9,  // no such operation; value = place of the instruction
  bad_cell = 10,  // an instruction writes a forbidden cell, or an output names a cell that does not exist; value = place of the instruction; outputs count on after the last instruction
  not_written = 11,  // a cell is read before it is written; value = place of the instruction; outputs count on after the last instruction
  bad_number = 12,  // a constant, a parameter or an initial state is not finite; value = its place among these numbers
  bad_divisor = 13,  // the tick rate is not a multiple of the law's rate; value = divisor
  too_costly = 14,  // a call of the law needs more ticks than there are until the next call; value = ticks that it needs
  no_such_parameter = 15,  // the law has no parameter with this number; value = number of its parameters
  bad_sum = 17,  // a sum of products has no terms or too many, or its terms reach beyond the last word; value = place of the word
  not_flying = 16,  // a law may fly only in flight, while the board controls all three axes; value = state
};
inline constexpr std::size_t kLawErrorCount = 18;

// State of the uploaded law on the board.
enum class LawState : std::uint8_t {
  none = 0,  // no law
  receiving = 1,  // an upload has started and is not complete
  ready = 2,  // verified; may fly
  flying = 3,  // it controls the motors
};
inline constexpr std::size_t kLawStateCount = 4;

// Why the board's own law took over.
enum class Takeover : std::uint8_t {
  command = 0,  // the host requested it; value 0
  not_finite = 1,  // an output, a signal or a new state was not finite; value = its position among voltages, setpoints, signals, states
  voltage_jump = 2,  // a voltage jumped from one tick to the next; value in V
  elevation_envelope = 3,  // elevation could not stop before its limits; value = predicted angle in deg
  pitch_envelope = 4,  // pitch could not stop before its limit; value = predicted angle in deg
  travel_envelope = 5,  // travel could not stop before its limit; value = predicted angle in deg
  elevation_following = 6,  // elevation stayed too far from the board's setpoint; value in deg
  pitch_following = 7,  // pitch stayed too far from the law's own setpoint; value in deg
  travel_following = 8,  // travel stayed too far from the board's setpoint; value in deg
  state = 9,  // the board left closed loop: stop, landing, a missing setpoint, a fault; value = state
};
inline constexpr std::size_t kTakeoverCount = 10;

// Why the board last started.
enum class Reset : std::uint8_t {
  power_up = 0,  // power applied
  user = 1,  // reset line: opening the port, or the button
  watchdog = 2,  // the watchdog fired, because control tick or idle loop hung
  software = 3,  // the firmware reset itself after it recorded a fault
};
inline constexpr std::size_t kResetCount = 4;

// Origin of the parameters at this start of the board.
enum class ParamsSource : std::uint8_t {
  defaults = 0,  // the flash has no stored set, so the defaults are in force
  stored = 1,  // the newest valid copy in flash
  fallback = 2,  // the newest copy was damaged; the older valid copy is used
  corrupt = 3,  // both copies are damaged or have another format: the defaults are in force, and the board refuses to arm until parameters are saved
  migrated = 4,  // the newest valid copy has another list of parameters: known values are kept, and new parameters have their defaults; see params_origin
};
inline constexpr std::size_t kParamsSourceCount = 5;

// Kinds of excitation, which the board adds to the motor voltages.
enum class Excitation : std::uint8_t {
  none = 0,  // no excitation
  step = 1,  // constant amplitude for the duration
  doublet = 2,  // plus amplitude for the first half, minus for the second
  chirp = 3,  // sine whose frequency rises linearly from start_Hz to stop_Hz
  multisine = 4,  // eight sines spread evenly from start_Hz to stop_Hz, Schroeder phases; the back motor uses frequencies between those of the front
  prbs = 5,  // pseudo-random binary sequence that may switch every 1/stop_Hz, seeded
};
inline constexpr std::size_t kExcitationCount = 6;

// Kinds of event messages.
enum class Event : std::uint8_t {
  boot = 0,  // first message after start; detail = reset cause, value = boot id
  state = 1,  // the state changed; detail = new state, cause = the trigger
  fault = 2,  // a fault occurred; detail = fault code, value = the quantity that exceeded its limit
  setpoint_stale = 3,  // setpoints stopped; value = their rate in Hz in the last second before
  setpoint_fresh = 4,  // setpoints came back while holding
  params_saved = 5,  // parameters written to flash; value = generation
  excitation_end = 6,  // excitation finished or was stopped; detail = kind
  setpoint_rejected = 7,  // a streamed value was refused; detail = result code
  zeroed = 8,  // encoder zeros taken; detail = axis mask
  law_engaged = 9,  // an uploaded law began to fly; value = its divisor, the number of ticks from one call to the next
  law_taken_over = 10,  // the board's own law took over from an uploaded law; detail = takeover, and the meaning of value is listed there
  travel_probe = 11,  // the board tilts the arm to see whether the travel encoder still counts; detail = probe, value = tilt in deg
};
inline constexpr std::size_t kEventCount = 12;

// Result of the tilt that checks a silent travel encoder.
enum class Probe : std::uint8_t {
  none = 0,  // nothing
  asked = 1,  // the tilt begins
  counts = 2,  // the encoder counts
  silent = 3,  // the encoder does not count, although the tilt must have turned the arm; the fault is travel_motionless
  stopped = 4,  // the check ended without a result, because the state changed or pitch did not tilt far enough
};
inline constexpr std::size_t kProbeCount = 5;

// Event that changes the supervisor's state. State events and telemetry report it as the cause.
enum class Trigger : std::uint8_t {
  arm = 0,  // arm command
  stop = 1,  // stop command
  close_loop = 2,  // control command with at least one axis
  open_loop = 3,  // control command without any axis
  stream = 4,  // stream command
  land = 5,  // land command
  setpoint_fresh = 6,  // a valid setpoint arrived while holding
  stale_hold = 7,  // setpoint (or link, or streamed voltage) older than the hold time
  stale_land = 8,  // setpoint or link older than the land time
  touchdown = 9,  // at rest on the table while landing
  trip = 10,  // a fault tripped
  clear = 11,  // clear_fault command
  axis_lost = 12,  // a fault of one axis tripped: the arm can still land without its reading
  start = 13,  // the board has started; in telemetry only
};
inline constexpr std::size_t kTriggerCount = 14;

// Axis mask.
namespace axes {
inline constexpr std::uint8_t elevation = 1U << 0U;  // elevation loop
inline constexpr std::uint8_t pitch = 1U << 1U;  // pitch loop
inline constexpr std::uint8_t travel = 1U << 2U;  // travel loop; needs pitch
}  // namespace axes

// Sent with every tick.
namespace flags {
inline constexpr std::uint8_t front_saturated = 1U << 0U;  // front motor voltage was limited
inline constexpr std::uint8_t back_saturated = 1U << 1U;  // back motor voltage was limited
inline constexpr std::uint8_t excitation = 1U << 2U;  // excitation is being added
inline constexpr std::uint8_t link_alive = 1U << 3U;  // a valid host frame arrived within the hold time
inline constexpr std::uint8_t pitch_limited = 1U << 4U;  // the travel loop's pitch setpoint was limited
inline constexpr std::uint8_t overrun = 1U << 5U;  // the tick before this one was late
inline constexpr std::uint8_t law = 1U << 6U;  // the voltages are those of an uploaded law
}  // namespace flags

enum class Fault : std::uint8_t {
  none = 0,
  elevation_limit = 1,  // land: elevation above its limit
  pitch_limit = 2,  // trip: pitch beyond its limit
  travel_limit = 3,  // trip: travel beyond its limit, so that the cables wind up
  elevation_rate = 4,  // land: elevation moved faster than its limit
  pitch_rate = 5,  // trip: pitch moved faster than its limit
  travel_rate = 6,  // trip: travel moved faster than its limit
  encoder_elevation = 7,  // land: too many illegal transitions of the elevation encoder
  encoder_pitch = 8,  // land: too many illegal transitions of the pitch encoder
  encoder_travel = 9,  // land: too many illegal transitions of the travel encoder
  landing_timeout = 10,  // trip: the arm did not reach the table in time
  tick_overrun = 11,  // trip: too many control ticks ran late
  hardware_stop = 12,  // trip: the hardware stop input is active
  elevation_following = 13,  // land: elevation stayed too far from its setpoint for following_s
  pitch_following = 14,  // trip: pitch stayed too far from its setpoint for following_s
  travel_following = 15,  // land: travel stayed too far from its setpoint for following_s
  encoder_overload = 16,  // trip: encoder edges came faster than the board can count, so the angle is wrong
  elevation_motionless = 17,  // land: the sum of both voltages changed enough to move the arm, but the elevation encoder did not count
  pitch_motionless = 18,  // land: the difference of the voltages changed enough to tilt the short arm, but the pitch encoder did not count
  travel_motionless = 19,  // land: pitch tilted long enough to turn the arm, but the travel encoder did not count; value: predicted travel in deg
  not_at_rest = 20,  // check: the arm does not rest on the table
  moving = 21,  // check: an axis is moving
  link_not_alive = 22,  // check: no recent frame from the host
  parameters_invalid = 23,  // check: the stored parameters are damaged or contradict each other
  pitch_not_level = 24,  // check: the short arm is not level
  elevation_below_table = 25,  // land: elevation read more than 1 degree plus this tolerance below the table, where the arm cannot be
  elevation_step = 26,  // land: elevation changed within 4 ms by more than the arm can turn; the board does not arm until the axis is zeroed
  pitch_step = 27,  // land: pitch changed within 4 ms by more than the short arm can turn; the board does not arm until the axis is zeroed
  travel_step = 28,  // land: travel changed within 4 ms by more than the arm can turn; the board does not arm until the axis is zeroed
  elevation_rest = 29,  // trip: after landing, the arm rests without lift at another elevation than before take-off
  elevation_sign = 33,  // trip: at take-off, elevation decreased although the rotors lift: the sign of the elevation encoder is wrong
  pitch_sign = 34,  // land: pitch turned against the difference of the voltages: the sign of the pitch encoder is wrong, the motors are exchanged, or one pushes down
  travel_sign = 35,  // land: travel turned against the tilt: the sign of the travel encoder is wrong
  watchdog = 30,  // boot: the watchdog restarted the board, because the control tick or the idle loop hung
  hard_fault = 31,  // boot: the processor reported an error; the board switched off the motor drivers and restarted
  unexpected_interrupt = 32,  // boot: an interrupt without a handler came; the board switched off the motor drivers and restarted
};

enum class Param : std::uint8_t {
  elevation_counts_per_rev = 0,  // count: counts of the elevation encoder per turn: four times its pulses; a negative number reverses its direction
  pitch_counts_per_rev = 1,  // count: counts of the pitch encoder per turn: four times its pulses; a negative number reverses its direction
  travel_counts_per_rev = 2,  // count: counts of the travel encoder per turn: four times its pulses; a negative number reverses its direction
  elevation_rest_deg = 3,  // deg: elevation of the arm at rest on the table; level is 0
  supply_V = 4,  // V: supply voltage of the motor drivers; full duty gives this voltage
  motor_min_V = 5,  // V: lowest motor voltage; with 0, no rotor is ever reversed
  motor_max_V = 6,  // V: highest motor voltage
  motor_front_sign = 7,  // : -1 reverses the front motor, as if its leads were swapped
  motor_back_sign = 8,  // : -1 reverses the back motor, as if its leads were swapped
  dead_zone_V = 9,  // V: voltage below which a rotor gives no thrust (paper eq. 31); the control law adds it
  hover_V = 10,  // V: sum of both voltages, above the dead zone, that holds the arm level
  hover_slope = 11,  // V/deg: change of hover_V with elevation: masses below the axis need more lift at a higher elevation
  elevation_kp = 12,  // V/deg: elevation proportional gain (paper Table 6: 0.5)
  elevation_ki = 13,  // V/(deg s): elevation integral gain (paper Table 6: 1)
  elevation_kd = 14,  // V s/deg: elevation derivative gain, on the measurement (paper Table 6: 0.1)
  elevation_rate_ff = 15,  // : share of the setpoint's rate that the derivative term uses; with 0, it uses the measured rate only
  elevation_acceleration_ff = 16,  // V s2/deg: sum of the voltages per acceleration of the elevation setpoint: inertia / (thrust gain x arm)
  pitch_kp = 17,  // V/deg: pitch proportional gain (paper Table 6: 0.66)
  pitch_ki = 18,  // V/(deg s): pitch integral gain (paper Table 6: 3)
  pitch_kd = 19,  // V s/deg: pitch derivative gain, on the measurement (paper Table 6: 0.1)
  pitch_hold_ff = 20,  // V/deg: difference of the voltages per degree of pitch setpoint, which holds a tilt against the weight below the pitch axis
  travel_kp = 21,  // deg/deg: travel proportional gain to the pitch setpoint (paper Table 6 with P and I exchanged: 0.7)
  travel_ki = 22,  // deg/(deg s): travel integral gain (paper Table 6 with P and I exchanged: 0.13)
  travel_kd = 23,  // deg s/deg: travel derivative gain, on the measurement (paper Table 6: 1.462)
  travel_rate_ff = 24,  // : share of the setpoint's rate that the derivative term uses; with 0, it uses the measured rate only
  travel_acceleration_ff = 25,  // deg s2/deg: pitch per acceleration of the travel setpoint: inertia / (hover thrust x arm)
  elevation_integral_max_V = 26,  // V: bound of the elevation integrator
  pitch_integral_max_V = 27,  // V: bound of the pitch integrator
  travel_integral_max_deg = 28,  // deg: bound of the travel integrator
  elevation_filter_Hz = 29,  // Hz: cut-off of the elevation rate filter (two poles)
  pitch_filter_Hz = 30,  // Hz: cut-off of the pitch rate filter (two poles)
  travel_filter_Hz = 31,  // Hz: cut-off of the travel rate filter (two poles)
  pitch_setpoint_max_deg = 32,  // deg: largest pitch setpoint, from the travel loop or the host
  differential_max_V = 33,  // V: largest difference of front and back voltage; the mixer prefers pitch to lift, so a larger difference would lift the arm
  elevation_slew_deg_s = 34,  // deg/s: fastest change of the elevation setpoint
  pitch_slew_deg_s = 35,  // deg/s: fastest change of the pitch setpoint, from the travel loop or the host
  travel_slew_deg_s = 36,  // deg/s: fastest change of the travel setpoint
  elevation_acceleration_deg_s2 = 37,  // deg/s2: fastest change of the elevation setpoint's rate, which makes a step a smooth ramp
  travel_acceleration_deg_s2 = 38,  // deg/s2: fastest change of the travel setpoint's rate; travel can only accelerate by tilting
  bumpless_s = 39,  // s: time constant of the smooth change from one control law or state to the next
  elevation_max_deg = 40,  // deg: limit of elevation, above which the board lands without this encoder; setpoints must be 2 degrees lower
  pitch_max_deg = 41,  // deg: pitch beyond which the motors are cut
  travel_max_deg = 42,  // deg: limit of travel, beyond which the motors are cut; setpoints must stay 5 degrees inside it
  elevation_rate_max_deg_s = 43,  // deg/s: rate of elevation beyond which the board lands without this encoder
  pitch_rate_max_deg_s = 44,  // deg/s: pitch rate beyond which the motors are cut
  travel_rate_max_deg_s = 45,  // deg/s: travel rate beyond which the motors are cut
  encoder_illegal_max = 46,  // : number of illegal transitions of an encoder since arming that is tolerated
  overrun_max = 47,  // : number of late ticks since arming that is tolerated
  elevation_following_max_deg = 48,  // deg: limit of the distance of elevation from its moving setpoint; after following_s beyond it, the board lands without this encoder
  pitch_following_max_deg = 49,  // deg: limit of the distance of pitch from its setpoint; after following_s beyond it, the motors are cut
  travel_following_max_deg = 50,  // deg: limit of the distance of travel from its moving setpoint; after following_s beyond it, the board lands
  following_s = 51,  // s: time for which an axis may be farther from its setpoint than its limit
  elevation_motion_V = 52,  // V: change of the sum of the voltages (without dead zones) that must move elevation within motion_s; at take-off, it counts from hover_V
  pitch_motion_V = 53,  // V: change of front minus back voltage (without dead zones) that must move pitch within motion_s
  motion_s = 54,  // s: longest time for which elevation or pitch may stay within one count although the motors drive it
  travel_motion_deg = 55,  // deg: additional pitch, beyond the pitch at which travel rests, that must turn the arm within travel_motion_s
  travel_motion_s = 56,  // s: time within which travel_motion_deg must turn the arm; if the additional pitch is smaller, the arm may rest longer
  travel_silence_s = 57,  // s: time in the air without a count of travel after which a short tilt checks the travel encoder; 0 switches this check off
  elevation_gain = 58,  // rad/(s2 V): acceleration of elevation per volt of the voltages' sum: thrust gain k L_a / J_theta; predicts how far elevation must move
  pitch_gain = 59,  // rad/(s2 V): acceleration of pitch per volt of front minus back voltage: k L_h / J_phi; predicts how far pitch must move
  travel_gain = 60,  // 1/s2: acceleration of travel per radian of pitch at hover: the thrust of both rotors times L_a / J_psi; predicts how far travel must move
  law_jump_max_V = 61,  // V: largest change of a motor's voltage from one tick to the next; if an uploaded law exceeds it, the board's own law takes over
  law_envelope = 62,  // : share of the limits of angles, rates and distances from the setpoints; if an uploaded law exceeds it, the board's own law takes over
  arm_rate_max_deg_s = 63,  // deg/s: the board arms only if no axis turns faster than this
  arm_elevation_tolerance_deg = 64,  // deg: the board arms only if elevation is this close to rest
  arm_pitch_tolerance_deg = 65,  // deg: the board arms only if pitch is this close to level
  setpoint_hold_s = 66,  // s: time without a recent setpoint after which the board holds level
  setpoint_land_s = 67,  // s: time without a recent setpoint after which the board lands
  landing_rate_deg_s = 68,  // deg/s: rate at which the elevation setpoint decreases while landing
  landing_timeout_s = 69,  // s: longest landing; then the motors are switched off with a fault. A landing without the elevation encoder takes 1.5 times as long
  voltage_valid_max_ms = 70,  // ms: longest time that a streamed voltage acts
  excitation_max_V = 71,  // V: largest amplitude of an excitation
  excitation_max_s = 72,  // s: longest duration of an excitation
  telemetry_batch_ticks = 73,  // tick: ticks per telemetry batch: 20 saves bandwidth, 5 reduces the delay for a host controller
  controller = 74,  // : compiled controller that flies: its row in the board's table; a number beyond the last row is refused
};
inline constexpr std::size_t kParamCount = 75;

struct ParamInfo {
  float min;
  float max;
  float initial;
  bool nonzero;
  bool integer;
  bool idle_only;
  std::uint16_t id;  // in stored sets
};
inline constexpr ParamInfo kParams[kParamCount] = {
    {-65536.0F, 65536.0F, 4096.0F, true, false, true, 0xce6fU},  // elevation_counts_per_rev
    {-65536.0F, 65536.0F, 4096.0F, true, false, true, 0x8212U},  // pitch_counts_per_rev
    {-65536.0F, 65536.0F, 4096.0F, true, false, true, 0xdb29U},  // travel_counts_per_rev
    {-60.0F, 0.0F, -25.0F, false, false, true, 0x48d8U},  // elevation_rest_deg
    {5.0F, 24.0F, 12.0F, false, false, true, 0x377eU},  // supply_V
    {-24.0F, 0.0F, 0.0F, false, false, true, 0x9f9dU},  // motor_min_V
    {0.5F, 24.0F, 10.0F, false, false, true, 0xac7fU},  // motor_max_V
    {-1.0F, 1.0F, 1.0F, true, true, true, 0x994fU},  // motor_front_sign
    {-1.0F, 1.0F, 1.0F, true, true, true, 0xac50U},  // motor_back_sign
    {0.0F, 5.0F, 1.0F, false, false, false, 0x1c35U},  // dead_zone_V
    {0.0F, 20.0F, 1.4F, false, false, false, 0xb17cU},  // hover_V
    {-1.0F, 1.0F, 0.06F, false, false, false, 0xf513U},  // hover_slope
    {0.0F, 20.0F, 0.28F, false, false, false, 0xe891U},  // elevation_kp
    {0.0F, 20.0F, 0.49F, false, false, false, 0xc40dU},  // elevation_ki
    {0.0F, 20.0F, 0.22F, false, false, false, 0x8f04U},  // elevation_kd
    {0.0F, 1.0F, 1.0F, false, false, false, 0x78f8U},  // elevation_rate_ff
    {0.0F, 1.0F, 0.036F, false, false, false, 0xa196U},  // elevation_acceleration_ff
    {0.0F, 20.0F, 0.09F, false, false, false, 0x4ce6U},  // pitch_kp
    {0.0F, 20.0F, 0.0025F, false, false, false, 0x4c91U},  // pitch_ki
    {0.0F, 20.0F, 0.028F, false, false, false, 0x4020U},  // pitch_kd
    {-1.0F, 1.0F, 0.033F, false, false, false, 0x8f76U},  // pitch_hold_ff
    {0.0F, 20.0F, 0.6F, false, false, false, 0x4967U},  // travel_kp
    {0.0F, 20.0F, 0.06F, false, false, false, 0xd4a0U},  // travel_ki
    {0.0F, 20.0F, 3.15F, false, false, false, 0x3350U},  // travel_kd
    {0.0F, 1.0F, 1.0F, false, false, false, 0x28dbU},  // travel_rate_ff
    {0.0F, 20.0F, 1.09F, false, false, false, 0x38e6U},  // travel_acceleration_ff
    {0.0F, 20.0F, 3.0F, false, false, false, 0x7b08U},  // elevation_integral_max_V
    {0.0F, 20.0F, 2.0F, false, false, false, 0x82e8U},  // pitch_integral_max_V
    {0.0F, 45.0F, 10.0F, false, false, false, 0x3dbfU},  // travel_integral_max_deg
    {0.5F, 200.0F, 6.0F, false, false, false, 0xa496U},  // elevation_filter_Hz
    {0.5F, 200.0F, 16.0F, false, false, false, 0x90d2U},  // pitch_filter_Hz
    {0.5F, 200.0F, 3.0F, false, false, false, 0x7aa3U},  // travel_filter_Hz
    {1.0F, 45.0F, 30.0F, false, false, false, 0xf5d9U},  // pitch_setpoint_max_deg
    {0.1F, 24.0F, 1.4F, false, false, false, 0xbc81U},  // differential_max_V
    {0.5F, 200.0F, 15.0F, false, false, false, 0x2ab5U},  // elevation_slew_deg_s
    {1.0F, 1000.0F, 90.0F, false, false, false, 0x364eU},  // pitch_slew_deg_s
    {0.5F, 200.0F, 20.0F, false, false, false, 0xb902U},  // travel_slew_deg_s
    {1.0F, 2000.0F, 29.0F, false, false, false, 0x62dbU},  // elevation_acceleration_deg_s2
    {1.0F, 2000.0F, 4.5F, false, false, false, 0xd659U},  // travel_acceleration_deg_s2
    {0.02F, 5.0F, 0.3F, false, false, false, 0x15ebU},  // bumpless_s
    {1.0F, 60.0F, 24.0F, false, false, true, 0xdeb2U},  // elevation_max_deg
    {5.0F, 80.0F, 45.0F, false, false, true, 0x7d7bU},  // pitch_max_deg
    {10.0F, 3600.0F, 175.0F, false, false, true, 0x5d0cU},  // travel_max_deg
    {10.0F, 1000.0F, 120.0F, false, false, true, 0x9805U},  // elevation_rate_max_deg_s
    {10.0F, 2000.0F, 400.0F, false, false, true, 0xfba3U},  // pitch_rate_max_deg_s
    {10.0F, 1000.0F, 150.0F, false, false, true, 0xa7d5U},  // travel_rate_max_deg_s
    {0.0F, 1000.0F, 5.0F, false, false, true, 0x1f19U},  // encoder_illegal_max
    {0.0F, 1000.0F, 10.0F, false, false, true, 0xee7aU},  // overrun_max
    {1.0F, 180.0F, 15.0F, false, false, true, 0x1db3U},  // elevation_following_max_deg
    {1.0F, 180.0F, 20.0F, false, false, true, 0x0141U},  // pitch_following_max_deg
    {1.0F, 3600.0F, 30.0F, false, false, true, 0xf8f7U},  // travel_following_max_deg
    {0.1F, 10.0F, 1.0F, false, false, true, 0x36f1U},  // following_s
    {0.1F, 48.0F, 1.2F, false, false, true, 0x2e07U},  // elevation_motion_V
    {0.1F, 48.0F, 0.5F, false, false, true, 0x3df9U},  // pitch_motion_V
    {0.1F, 10.0F, 0.5F, false, false, true, 0xb356U},  // motion_s
    {0.5F, 90.0F, 8.0F, false, false, true, 0xca25U},  // travel_motion_deg
    {0.1F, 30.0F, 1.0F, false, false, true, 0x66c5U},  // travel_motion_s
    {0.0F, 60.0F, 2.5F, false, false, true, 0xba24U},  // travel_silence_s
    {0.02F, 10.0F, 0.485F, false, false, false, 0x2fe4U},  // elevation_gain
    {0.1F, 100.0F, 2.97F, false, false, false, 0xf4b7U},  // pitch_gain
    {0.05F, 100.0F, 0.5F, false, false, false, 0xb973U},  // travel_gain
    {0.1F, 48.0F, 2.5F, false, false, true, 0xc06aU},  // law_jump_max_V
    {0.2F, 1.0F, 0.8F, false, false, true, 0xc7f2U},  // law_envelope
    {0.1F, 100.0F, 3.0F, false, false, true, 0xab88U},  // arm_rate_max_deg_s
    {0.1F, 60.0F, 2.0F, false, false, true, 0x0feaU},  // arm_elevation_tolerance_deg
    {0.1F, 60.0F, 10.0F, false, false, true, 0x0b72U},  // arm_pitch_tolerance_deg
    {0.05F, 5.0F, 0.5F, false, false, true, 0xf593U},  // setpoint_hold_s
    {0.1F, 30.0F, 2.0F, false, false, true, 0x7663U},  // setpoint_land_s
    {0.5F, 60.0F, 8.0F, false, false, false, 0xb9acU},  // landing_rate_deg_s
    {1.0F, 60.0F, 12.0F, false, false, true, 0x125cU},  // landing_timeout_s
    {5.0F, 500.0F, 100.0F, false, false, true, 0xb45eU},  // voltage_valid_max_ms
    {0.0F, 12.0F, 2.0F, false, false, true, 0xc562U},  // excitation_max_V
    {1.0F, 600.0F, 120.0F, false, false, true, 0x66caU},  // excitation_max_s
    {4.0F, 32.0F, 20.0F, false, true, false, 0xbfd4U},  // telemetry_batch_ticks
    {0.0F, 7.0F, 0.0F, false, true, true, 0x1a5bU},  // controller
};

enum class Channel : std::uint8_t {
  elevation_count = 0,  // count: elevation encoder: level is 0, upwards is positive
  pitch_count = 1,  // count: pitch encoder: level is 0, positive with the front rotor up
  travel_count = 2,  // count: travel encoder: 0 is the position at which it was zeroed
  elevation_setpoint = 3,  // rad: elevation setpoint that the control law used, after the limit of its rate
  pitch_setpoint = 4,  // rad: pitch setpoint that the control law used: the travel loop's output, or the host's
  travel_setpoint = 5,  // rad: travel setpoint that the control law used, after the limit of its rate
  front = 6,  // V: voltage that acted on the front motor during this tick, after every limit
  back = 7,  // V: voltage that acted on the back motor during this tick
  state = 8,  // enum state: supervisor state
  fault = 9,  // enum fault: fault code, 0 while none
  flags = 10,  // bits flags: flag bits
  trigger = 11,  // enum trigger: event that led to the present state; after a touchdown, the event that led to the landing
  signal_1 = 12,  // : first signal of an uploaded law; if the law logs its own setpoints, the board's setpoints follow after the law's signals; 0 while no law flies
  signal_2 = 13,  // : second signal of an uploaded law
  signal_3 = 14,  // : third signal of an uploaded law
  signal_4 = 15,  // : fourth signal of an uploaded law
};
inline constexpr std::size_t kChannelCount = 16;
inline constexpr std::uint8_t kChannelBytes[kChannelCount] = {4, 4, 4, 4, 4, 4, 2, 2, 1, 1, 1, 1, 4, 4, 4, 4};
inline constexpr float kElevationSetpointPerUnit = 100000.0F;  // raw = value in rad * this
inline constexpr float kPitchSetpointPerUnit = 100000.0F;  // raw = value in rad * this
inline constexpr float kTravelSetpointPerUnit = 100000.0F;  // raw = value in rad * this
inline constexpr float kFrontPerUnit = 1000.0F;  // raw = value in V * this
inline constexpr float kBackPerUnit = 1000.0F;  // raw = value in V * this
inline constexpr float kSignal1PerUnit = 100000.0F;  // raw = value in  * this
inline constexpr float kSignal2PerUnit = 100000.0F;  // raw = value in  * this
inline constexpr float kSignal3PerUnit = 100000.0F;  // raw = value in  * this
inline constexpr float kSignal4PerUnit = 100000.0F;  // raw = value in  * this

// Laws that come over the link.
inline constexpr std::uint32_t kLawFormat = 2;
inline constexpr std::uint32_t kLawCells = 512;
inline constexpr std::uint32_t kLawWords = 1536;
inline constexpr std::uint32_t kLawSignals = 4;
inline constexpr std::uint32_t kLawMaxTicks = 16;
inline constexpr std::uint32_t kLawMaxTerms = 64;
inline constexpr std::uint32_t kLawTickCost = 20000;
inline constexpr std::uint32_t kLawFixedCost = 1120;
inline constexpr std::uint32_t kLawOutputCost = 320;
inline constexpr std::uint32_t kLawInputCost = 22;
inline constexpr std::uint32_t kLawMovingCost = 135;
inline constexpr std::uint32_t kLawTermCost = 41;
inline constexpr std::uint32_t kLawStateCost = 13;
inline constexpr std::uint32_t kLawSignalCost = 80;
enum class LawInput : std::uint8_t {
  elevation_rad = 0,  // angle, by the encoder
  pitch_rad = 1,  // angle, by the encoder
  travel_rad = 2,  // angle, by the encoder
  elevation_rad_s = 3,  // rate, filtered at elevation_filter_Hz
  pitch_rad_s = 4,  // rate, filtered at pitch_filter_Hz
  travel_rad_s = 5,  // rate, filtered at travel_filter_Hz
  elevation_setpoint_rad = 6,  // the board's setpoint on its path, rounded as in the log
  pitch_setpoint_rad = 7,  // the host's setpoint, for a law that does not control travel; rounded as in the log
  travel_setpoint_rad = 8,  // the board's setpoint on its path, rounded as in the log
  elevation_setpoint_rad_s = 9,  // rate of the setpoint of elevation, through the same filter as the measured rate, so that both lag equally
  pitch_setpoint_rad_s = 10,  // rate of the setpoint of pitch, likewise filtered
  travel_setpoint_rad_s = 11,  // rate of the setpoint of travel, likewise filtered
  elevation_setpoint_rad_s2 = 12,  // acceleration of the setpoint of elevation: the change of its rate, through the same filter once more
  pitch_setpoint_rad_s2 = 13,  // acceleration of the setpoint of pitch, likewise filtered
  travel_setpoint_rad_s2 = 14,  // acceleration of the setpoint of travel, likewise filtered
  front_V = 15,  // voltage that acted in the previous tick, as logged
  back_V = 16,  // voltage that acted in the previous tick, as logged
};
inline constexpr std::size_t kLawInputCount = 17;
enum class Operation : std::uint8_t {
  copy = 0,  // a
  add = 1,  // a + b
  subtract = 2,  // a - b
  multiply = 3,  // a b
  divide = 4,  // a / b
  negate = 5,  // -a
  absolute = 6,  // |a|
  minimum = 7,  // the smaller of a and b; not a number (NaN) if a or b is NaN
  maximum = 8,  // the larger of a and b; NaN if a or b is NaN
  less = 9,  // 1 if a < b, otherwise 0; NaN if a or b is NaN, as in all conditions
  less_equal = 10,  // 1 if a <= b, otherwise 0
  equal = 11,  // 1 if a = b, otherwise 0
  not_equal = 12,  // 1 if a is not b, otherwise 0
  both = 13,  // 1 if neither a nor b is 0, otherwise 0
  either = 14,  // 1 if a or b is not 0, otherwise 0
  negation = 15,  // 1 if a is 0, otherwise 0
  select = 16,  // b if a is not 0, otherwise 0; b has no effect if it is not selected
  floor = 17,  // the greatest whole number that is not above a
  square_root = 18,  // square root of a; NaN below 0
  sine = 19,  // of a in rad; NaN beyond 8192 rad
  cosine = 20,  // of a in rad; NaN beyond 8192 rad
  tangent = 21,  // of a in rad; NaN beyond 8192 rad
  arctangent = 22,  // of a / b, in the quadrant of (b, a), rad
  hyperbolic_tangent = 23,  // of a
  exponential = 24,  // e to the power of a
  sum_of_products = 25,  // a b + c d - ... of the terms that follow it, rounded once; NaN if one of them is not finite
};
inline constexpr std::size_t kOperationCount = 26;
inline constexpr std::uint16_t kOperationCost[kOperationCount] = {15, 63, 64, 51, 78, 17, 17, 30, 30, 35, 35, 35, 35, 27, 26, 23, 22, 31, 299, 93, 89, 228, 238, 277, 127, 63};
// A bit for each that has two operands.
inline constexpr std::uint32_t kBinaryOperations = 0x00417f9eU;

enum class MessageId : std::uint8_t {
  hello = 1,
  ping = 2,
  arm = 3,
  stop = 4,
  control = 5,
  stream = 6,
  land = 7,
  excite = 8,
  excite_stop = 9,
  param_set = 10,
  params_read = 11,
  params_save = 12,
  params_default = 13,
  zero = 14,
  clear_fault = 15,
  status_read = 16,
  law_begin = 17,
  law_part = 18,
  law_end = 19,
  law_fly = 20,
  law_set = 21,
  law_read = 22,
  controller_read = 23,
  params_origin_read = 24,
  setpoint = 32,
  voltages = 33,
  following = 34,
  ack = 128,
  welcome = 129,
  pong = 130,
  params = 131,
  status = 132,
  law = 135,
  controller = 136,
  params_origin = 137,
  telemetry = 133,
  event = 134,
};

// Floats of a message, which follow each other: byte offset and position of the first, and how many.
struct Floats {
  std::uint8_t offset;
  std::uint8_t field;
  std::uint8_t count;
};

// Opens a session. The layouts of hello and welcome never change, so that any two versions recognise each other.
struct HelloMessage {
  static constexpr MessageId kId = MessageId::hello;
  static constexpr std::size_t kSize = 9;
  std::uint8_t request = {};  // -
  std::uint32_t link_hash = {};  // -
  std::uint32_t session = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u32(to + 1, link_hash);
    put_u32(to + 5, session);
  }
  static HelloMessage read([[maybe_unused]] const std::uint8_t* from) {
    HelloMessage m;
    m.request = get_u8(from + 0);
    m.link_hash = get_u32(from + 1);
    m.session = get_u32(from + 5);
    return m;
  }
};

// Shows that the host is alive, and compares the clocks of host and board.
struct PingMessage {
  static constexpr MessageId kId = MessageId::ping;
  static constexpr std::size_t kSize = 9;
  std::uint8_t request = {};  // -
  std::uint64_t host_us = {};  // us
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u64(to + 1, host_us);
  }
  static PingMessage read([[maybe_unused]] const std::uint8_t* from) {
    PingMessage m;
    m.request = get_u8(from + 0);
    m.host_us = get_u64(from + 1);
    return m;
  }
};

// Runs the checks before a flight. If they pass, it enables the drivers at zero voltage.
struct ArmMessage {
  static constexpr MessageId kId = MessageId::arm;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static ArmMessage read([[maybe_unused]] const std::uint8_t* from) {
    ArmMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Switches the motors off immediately, in any state. It also ends the armed state.
struct StopMessage {
  static constexpr MessageId kId = MessageId::stop;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static StopMessage read([[maybe_unused]] const std::uint8_t* from) {
    StopMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Closes the control loops of the axes in the mask. The other axes get their share of the given voltages. If the mask is 0, no loop is closed (open loop).
struct ControlMessage {
  static constexpr MessageId kId = MessageId::control;
  static constexpr std::size_t kSize = 10;
  std::uint8_t request = {};  // -
  std::uint8_t axes = {};  // bits axes
  float front_V = {};  // V
  float back_V = {};  // V
  static constexpr Floats kFloats = {2, 2, 2};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, axes);
    put_f32(to + 2, front_V);
    put_f32(to + 6, back_V);
  }
  static ControlMessage read([[maybe_unused]] const std::uint8_t* from) {
    ControlMessage m;
    m.request = get_u8(from + 0);
    m.axes = get_u8(from + 1);
    m.front_V = get_f32(from + 2);
    m.back_V = get_f32(from + 6);
    return m;
  }
};

// From now on, the host sends the motor voltages (message voltages).
struct StreamMessage {
  static constexpr MessageId kId = MessageId::stream;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static StreamMessage read([[maybe_unused]] const std::uint8_t* from) {
    StreamMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Lands the arm under control, then switches the motors off.
struct LandMessage {
  static constexpr MessageId kId = MessageId::land;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static LandMessage read([[maybe_unused]] const std::uint8_t* from) {
    LandMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Starts an excitation, which is added to the motor voltages.
struct ExciteMessage {
  static constexpr MessageId kId = MessageId::excite;
  static constexpr std::size_t kSize = 26;
  std::uint8_t request = {};  // -
  std::uint8_t kind = {};  // enum excitation
  float front_V = {};  // V
  float back_V = {};  // V
  float start_Hz = {};  // Hz
  float stop_Hz = {};  // Hz
  float duration_s = {};  // s
  std::uint32_t seed = {};  // -
  static constexpr Floats kFloats = {2, 2, 5};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, kind);
    put_f32(to + 2, front_V);
    put_f32(to + 6, back_V);
    put_f32(to + 10, start_Hz);
    put_f32(to + 14, stop_Hz);
    put_f32(to + 18, duration_s);
    put_u32(to + 22, seed);
  }
  static ExciteMessage read([[maybe_unused]] const std::uint8_t* from) {
    ExciteMessage m;
    m.request = get_u8(from + 0);
    m.kind = get_u8(from + 1);
    m.front_V = get_f32(from + 2);
    m.back_V = get_f32(from + 6);
    m.start_Hz = get_f32(from + 10);
    m.stop_Hz = get_f32(from + 14);
    m.duration_s = get_f32(from + 18);
    m.seed = get_u32(from + 22);
    return m;
  }
};

// Ends a running excitation.
struct ExciteStopMessage {
  static constexpr MessageId kId = MessageId::excite_stop;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static ExciteStopMessage read([[maybe_unused]] const std::uint8_t* from) {
    ExciteStopMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Sets one parameter in memory. ack.value is the value that is now in force.
struct ParamSetMessage {
  static constexpr MessageId kId = MessageId::param_set;
  static constexpr std::size_t kSize = 6;
  std::uint8_t request = {};  // -
  std::uint8_t index = {};  // enum param
  float value = {};  // as declared
  static constexpr Floats kFloats = {2, 2, 1};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, index);
    put_f32(to + 2, value);
  }
  static ParamSetMessage read([[maybe_unused]] const std::uint8_t* from) {
    ParamSetMessage m;
    m.request = get_u8(from + 0);
    m.index = get_u8(from + 1);
    m.value = get_f32(from + 2);
    return m;
  }
};

// Reads up to 32 parameters from `first` on.
struct ParamsReadMessage {
  static constexpr MessageId kId = MessageId::params_read;
  static constexpr std::size_t kSize = 2;
  std::uint8_t request = {};  // -
  std::uint8_t first = {};  // enum param
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, first);
  }
  static ParamsReadMessage read([[maybe_unused]] const std::uint8_t* from) {
    ParamsReadMessage m;
    m.request = get_u8(from + 0);
    m.first = get_u8(from + 1);
    return m;
  }
};

// Writes all parameters to the flash, only while the board is idle.
struct ParamsSaveMessage {
  static constexpr MessageId kId = MessageId::params_save;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static ParamsSaveMessage read([[maybe_unused]] const std::uint8_t* from) {
    ParamsSaveMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Sets all parameters to their defaults in memory, only while the board is idle. It does not save them.
struct ParamsDefaultMessage {
  static constexpr MessageId kId = MessageId::params_default;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static ParamsDefaultMessage read([[maybe_unused]] const std::uint8_t* from) {
    ParamsDefaultMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Makes the present position the rest position (elevation) or zero (pitch, travel), only while the board is idle.
struct ZeroMessage {
  static constexpr MessageId kId = MessageId::zero;
  static constexpr std::size_t kSize = 2;
  std::uint8_t request = {};  // -
  std::uint8_t axes = {};  // bits axes
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, axes);
  }
  static ZeroMessage read([[maybe_unused]] const std::uint8_t* from) {
    ZeroMessage m;
    m.request = get_u8(from + 0);
    m.axes = get_u8(from + 1);
    return m;
  }
};

// Changes the state from fault to idle.
struct ClearFaultMessage {
  static constexpr MessageId kId = MessageId::clear_fault;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static ClearFaultMessage read([[maybe_unused]] const std::uint8_t* from) {
    ClearFaultMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Asks for the counters. The board also sends them once per second.
struct StatusReadMessage {
  static constexpr MessageId kId = MessageId::status_read;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static StatusReadMessage read([[maybe_unused]] const std::uint8_t* from) {
    StatusReadMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Begins the upload of a law, and deletes the loaded law. Not allowed while a law flies.
struct LawBeginMessage {
  static constexpr MessageId kId = MessageId::law_begin;
  static constexpr std::size_t kSize = 7;
  std::uint8_t request = {};  // -
  std::uint32_t hash = {};  // -
  std::uint16_t words = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u32(to + 1, hash);
    put_u16(to + 5, words);
  }
  static LawBeginMessage read([[maybe_unused]] const std::uint8_t* from) {
    LawBeginMessage m;
    m.request = get_u8(from + 0);
    m.hash = get_u32(from + 1);
    m.words = get_u16(from + 5);
    return m;
  }
};

// Twelve words of the law, in order; the board ignores words behind the last one of the law. ack.value: words received so far. Sending the same part again changes nothing.
struct LawPartMessage {
  static constexpr MessageId kId = MessageId::law_part;
  static constexpr std::size_t kSize = 51;
  std::uint8_t request = {};  // -
  std::uint16_t first = {};  // -
  std::uint32_t word_0 = {};  // -
  std::uint32_t word_1 = {};  // -
  std::uint32_t word_2 = {};  // -
  std::uint32_t word_3 = {};  // -
  std::uint32_t word_4 = {};  // -
  std::uint32_t word_5 = {};  // -
  std::uint32_t word_6 = {};  // -
  std::uint32_t word_7 = {};  // -
  std::uint32_t word_8 = {};  // -
  std::uint32_t word_9 = {};  // -
  std::uint32_t word_10 = {};  // -
  std::uint32_t word_11 = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u16(to + 1, first);
    put_u32(to + 3, word_0);
    put_u32(to + 7, word_1);
    put_u32(to + 11, word_2);
    put_u32(to + 15, word_3);
    put_u32(to + 19, word_4);
    put_u32(to + 23, word_5);
    put_u32(to + 27, word_6);
    put_u32(to + 31, word_7);
    put_u32(to + 35, word_8);
    put_u32(to + 39, word_9);
    put_u32(to + 43, word_10);
    put_u32(to + 47, word_11);
  }
  static LawPartMessage read([[maybe_unused]] const std::uint8_t* from) {
    LawPartMessage m;
    m.request = get_u8(from + 0);
    m.first = get_u16(from + 1);
    m.word_0 = get_u32(from + 3);
    m.word_1 = get_u32(from + 7);
    m.word_2 = get_u32(from + 11);
    m.word_3 = get_u32(from + 15);
    m.word_4 = get_u32(from + 19);
    m.word_5 = get_u32(from + 23);
    m.word_6 = get_u32(from + 27);
    m.word_7 = get_u32(from + 31);
    m.word_8 = get_u32(from + 35);
    m.word_9 = get_u32(from + 39);
    m.word_10 = get_u32(from + 43);
    m.word_11 = get_u32(from + 47);
    return m;
  }
};

// Ends the upload: the board verifies the law. ack.value: instructions that a call takes in the worst case. If the law is already ready, the answer is the same.
struct LawEndMessage {
  static constexpr MessageId kId = MessageId::law_end;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static LawEndMessage read([[maybe_unused]] const std::uint8_t* from) {
    LawEndMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Starts the law at the next tick, or lets the board's own law take over. ack.detail: the state.
struct LawFlyMessage {
  static constexpr MessageId kId = MessageId::law_fly;
  static constexpr std::size_t kSize = 2;
  std::uint8_t request = {};  // -
  std::uint8_t on = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, on);
  }
  static LawFlyMessage read([[maybe_unused]] const std::uint8_t* from) {
    LawFlyMessage m;
    m.request = get_u8(from + 0);
    m.on = get_u8(from + 1);
    return m;
  }
};

// Sets a parameter of the law, also in flight. The value stays until the next upload. ack.value: the value in force.
struct LawSetMessage {
  static constexpr MessageId kId = MessageId::law_set;
  static constexpr std::size_t kSize = 6;
  std::uint8_t request = {};  // -
  std::uint8_t index = {};  // -
  float value = {};  // -
  static constexpr Floats kFloats = {2, 2, 1};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, index);
    put_f32(to + 2, value);
  }
  static LawSetMessage read([[maybe_unused]] const std::uint8_t* from) {
    LawSetMessage m;
    m.request = get_u8(from + 0);
    m.index = get_u8(from + 1);
    m.value = get_f32(from + 2);
    return m;
  }
};

// Asks which law the board has.
struct LawReadMessage {
  static constexpr MessageId kId = MessageId::law_read;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static LawReadMessage read([[maybe_unused]] const std::uint8_t* from) {
    LawReadMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Asks for the name of a compiled controller.
struct ControllerReadMessage {
  static constexpr MessageId kId = MessageId::controller_read;
  static constexpr std::size_t kSize = 2;
  std::uint8_t request = {};  // -
  std::uint8_t index = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, index);
  }
  static ControllerReadMessage read([[maybe_unused]] const std::uint8_t* from) {
    ControllerReadMessage m;
    m.request = get_u8(from + 0);
    m.index = get_u8(from + 1);
    return m;
  }
};

// Asks which parameters had a value in the stored set when the board started.
struct ParamsOriginReadMessage {
  static constexpr MessageId kId = MessageId::params_origin_read;
  static constexpr std::size_t kSize = 1;
  std::uint8_t request = {};  // -
  static constexpr Floats kFloats = {0, 0, 0};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
  }
  static ParamsOriginReadMessage read([[maybe_unused]] const std::uint8_t* from) {
    ParamsOriginReadMessage m;
    m.request = get_u8(from + 0);
    return m;
  }
};

// Target that the setpoint should reach at a tick of the board. The setpoint moves there linearly, within the limits of its rate.
struct SetpointMessage {
  static constexpr MessageId kId = MessageId::setpoint;
  static constexpr std::size_t kSize = 16;
  std::uint32_t apply_tick = {};  // tick
  float elevation_rad = {};  // rad
  float pitch_rad = {};  // rad
  float travel_rad = {};  // rad
  static constexpr Floats kFloats = {4, 1, 3};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u32(to + 0, apply_tick);
    put_f32(to + 4, elevation_rad);
    put_f32(to + 8, pitch_rad);
    put_f32(to + 12, travel_rad);
  }
  static SetpointMessage read([[maybe_unused]] const std::uint8_t* from) {
    SetpointMessage m;
    m.apply_tick = get_u32(from + 0);
    m.elevation_rad = get_f32(from + 4);
    m.pitch_rad = get_f32(from + 8);
    m.travel_rad = get_f32(from + 12);
    return m;
  }
};

// Motor voltages from the host, in the state streamed.
struct VoltagesMessage {
  static constexpr MessageId kId = MessageId::voltages;
  static constexpr std::size_t kSize = 10;
  float front_V = {};  // V
  float back_V = {};  // V
  std::uint16_t valid_ms = {};  // ms
  static constexpr Floats kFloats = {0, 0, 2};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_f32(to + 0, front_V);
    put_f32(to + 4, back_V);
    put_u16(to + 8, valid_ms);
  }
  static VoltagesMessage read([[maybe_unused]] const std::uint8_t* from) {
    VoltagesMessage m;
    m.front_V = get_f32(from + 0);
    m.back_V = get_f32(from + 4);
    m.valid_ms = get_u16(from + 8);
    return m;
  }
};

// Setpoints that the host's law follows in the streamed state. The board only logs them; in other states, it ignores this message.
struct FollowingMessage {
  static constexpr MessageId kId = MessageId::following;
  static constexpr std::size_t kSize = 12;
  float elevation_rad = {};  // rad
  float pitch_rad = {};  // rad
  float travel_rad = {};  // rad
  static constexpr Floats kFloats = {0, 0, 3};
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_f32(to + 0, elevation_rad);
    put_f32(to + 4, pitch_rad);
    put_f32(to + 8, travel_rad);
  }
  static FollowingMessage read([[maybe_unused]] const std::uint8_t* from) {
    FollowingMessage m;
    m.elevation_rad = get_f32(from + 0);
    m.pitch_rad = get_f32(from + 4);
    m.travel_rad = get_f32(from + 8);
    return m;
  }
};

// Answer to a command.
struct AckMessage {
  static constexpr MessageId kId = MessageId::ack;
  static constexpr std::size_t kSize = 8;
  std::uint8_t request = {};  // -
  std::uint8_t command = {};  // message id
  std::uint8_t result = {};  // enum result
  std::uint8_t detail = {};  // -
  float value = {};  // -
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, command);
    put_u8(to + 2, result);
    put_u8(to + 3, detail);
    put_f32(to + 4, value);
  }
  static AckMessage read([[maybe_unused]] const std::uint8_t* from) {
    AckMessage m;
    m.request = get_u8(from + 0);
    m.command = get_u8(from + 1);
    m.result = get_u8(from + 2);
    m.detail = get_u8(from + 3);
    m.value = get_f32(from + 4);
    return m;
  }
};

// Answer to hello.
struct WelcomeMessage {
  static constexpr MessageId kId = MessageId::welcome;
  static constexpr std::size_t kSize = 23;
  std::uint8_t request = {};  // -
  std::uint8_t result = {};  // enum result
  std::uint32_t link_hash = {};  // -
  std::uint8_t link_major = {};  // -
  std::uint8_t link_minor = {};  // -
  std::uint8_t firmware_major = {};  // -
  std::uint8_t firmware_minor = {};  // -
  std::uint8_t firmware_patch = {};  // -
  std::uint8_t board = {};  // -
  std::uint8_t reset = {};  // enum reset
  std::uint8_t boot_fault = {};  // enum fault
  std::uint32_t boot_id = {};  // -
  std::uint32_t tick = {};  // tick
  std::uint8_t params_source = {};  // enum params_source
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, result);
    put_u32(to + 2, link_hash);
    put_u8(to + 6, link_major);
    put_u8(to + 7, link_minor);
    put_u8(to + 8, firmware_major);
    put_u8(to + 9, firmware_minor);
    put_u8(to + 10, firmware_patch);
    put_u8(to + 11, board);
    put_u8(to + 12, reset);
    put_u8(to + 13, boot_fault);
    put_u32(to + 14, boot_id);
    put_u32(to + 18, tick);
    put_u8(to + 22, params_source);
  }
  static WelcomeMessage read([[maybe_unused]] const std::uint8_t* from) {
    WelcomeMessage m;
    m.request = get_u8(from + 0);
    m.result = get_u8(from + 1);
    m.link_hash = get_u32(from + 2);
    m.link_major = get_u8(from + 6);
    m.link_minor = get_u8(from + 7);
    m.firmware_major = get_u8(from + 8);
    m.firmware_minor = get_u8(from + 9);
    m.firmware_patch = get_u8(from + 10);
    m.board = get_u8(from + 11);
    m.reset = get_u8(from + 12);
    m.boot_fault = get_u8(from + 13);
    m.boot_id = get_u32(from + 14);
    m.tick = get_u32(from + 18);
    m.params_source = get_u8(from + 22);
    return m;
  }
};

// Answer to ping.
struct PongMessage {
  static constexpr MessageId kId = MessageId::pong;
  static constexpr std::size_t kSize = 13;
  std::uint8_t request = {};  // -
  std::uint64_t host_us = {};  // us
  std::uint32_t tick = {};  // tick
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u64(to + 1, host_us);
    put_u32(to + 9, tick);
  }
  static PongMessage read([[maybe_unused]] const std::uint8_t* from) {
    PongMessage m;
    m.request = get_u8(from + 0);
    m.host_us = get_u64(from + 1);
    m.tick = get_u32(from + 9);
    return m;
  }
};

// Parameter values, as many as `count` says (at most 32), in table order.
struct ParamsMessage {
  static constexpr MessageId kId = MessageId::params;
  static constexpr std::size_t kSize = 3;
  std::uint8_t request = {};  // -
  std::uint8_t first = {};  // enum param
  std::uint8_t count = {};  // -
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, first);
    put_u8(to + 2, count);
  }
  static ParamsMessage read([[maybe_unused]] const std::uint8_t* from) {
    ParamsMessage m;
    m.request = get_u8(from + 0);
    m.first = get_u8(from + 1);
    m.count = get_u8(from + 2);
    return m;
  }
};

// Counters since the start of the board. The board sends them once per second with request = 0, and after status_read.
struct StatusMessage {
  static constexpr MessageId kId = MessageId::status;
  static constexpr std::size_t kSize = 43;
  std::uint8_t request = {};  // -
  std::uint32_t tick = {};  // tick
  std::uint32_t frames_ok = {};  // -
  std::uint32_t frames_bad = {};  // -
  std::uint32_t frames_lost = {};  // -
  std::uint32_t duplicates = {};  // -
  std::uint32_t stale_streams = {};  // -
  std::uint32_t ticks_dropped = {};  // tick
  std::uint32_t overruns = {};  // -
  std::uint16_t tick_max_us = {};  // us
  std::uint16_t illegal_elevation = {};  // -
  std::uint16_t illegal_pitch = {};  // -
  std::uint16_t illegal_travel = {};  // -
  std::uint16_t setpoint_rate_Hz = {};  // Hz
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u32(to + 1, tick);
    put_u32(to + 5, frames_ok);
    put_u32(to + 9, frames_bad);
    put_u32(to + 13, frames_lost);
    put_u32(to + 17, duplicates);
    put_u32(to + 21, stale_streams);
    put_u32(to + 25, ticks_dropped);
    put_u32(to + 29, overruns);
    put_u16(to + 33, tick_max_us);
    put_u16(to + 35, illegal_elevation);
    put_u16(to + 37, illegal_pitch);
    put_u16(to + 39, illegal_travel);
    put_u16(to + 41, setpoint_rate_Hz);
  }
  static StatusMessage read([[maybe_unused]] const std::uint8_t* from) {
    StatusMessage m;
    m.request = get_u8(from + 0);
    m.tick = get_u32(from + 1);
    m.frames_ok = get_u32(from + 5);
    m.frames_bad = get_u32(from + 9);
    m.frames_lost = get_u32(from + 13);
    m.duplicates = get_u32(from + 17);
    m.stale_streams = get_u32(from + 21);
    m.ticks_dropped = get_u32(from + 25);
    m.overruns = get_u32(from + 29);
    m.tick_max_us = get_u16(from + 33);
    m.illegal_elevation = get_u16(from + 35);
    m.illegal_pitch = get_u16(from + 37);
    m.illegal_travel = get_u16(from + 39);
    m.setpoint_rate_Hz = get_u16(from + 41);
    return m;
  }
};

// The law that the board has.
struct LawMessage {
  static constexpr MessageId kId = MessageId::law;
  static constexpr std::size_t kSize = 12;
  std::uint8_t request = {};  // -
  std::uint32_t hash = {};  // -
  std::uint8_t state = {};  // enum law_state
  std::uint8_t divisor = {};  // -
  std::uint8_t ticks = {};  // tick
  std::uint32_t cost = {};  // -
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u32(to + 1, hash);
    put_u8(to + 5, state);
    put_u8(to + 6, divisor);
    put_u8(to + 7, ticks);
    put_u32(to + 8, cost);
  }
  static LawMessage read([[maybe_unused]] const std::uint8_t* from) {
    LawMessage m;
    m.request = get_u8(from + 0);
    m.hash = get_u32(from + 1);
    m.state = get_u8(from + 5);
    m.divisor = get_u8(from + 6);
    m.ticks = get_u8(from + 7);
    m.cost = get_u32(from + 8);
    return m;
  }
};

// Name of a compiled controller in ASCII; zeros fill the rest.
struct ControllerMessage {
  static constexpr MessageId kId = MessageId::controller;
  static constexpr std::size_t kSize = 19;
  std::uint8_t request = {};  // -
  std::uint8_t index = {};  // -
  std::uint8_t count = {};  // -
  std::uint32_t name_0 = {};  // -
  std::uint32_t name_1 = {};  // -
  std::uint32_t name_2 = {};  // -
  std::uint32_t name_3 = {};  // -
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, index);
    put_u8(to + 2, count);
    put_u32(to + 3, name_0);
    put_u32(to + 7, name_1);
    put_u32(to + 11, name_2);
    put_u32(to + 15, name_3);
  }
  static ControllerMessage read([[maybe_unused]] const std::uint8_t* from) {
    ControllerMessage m;
    m.request = get_u8(from + 0);
    m.index = get_u8(from + 1);
    m.count = get_u8(from + 2);
    m.name_0 = get_u32(from + 3);
    m.name_1 = get_u32(from + 7);
    m.name_2 = get_u32(from + 11);
    m.name_3 = get_u32(from + 15);
    return m;
  }
};

// Where the parameters came from when the board started; after a save, what was saved.
struct ParamsOriginMessage {
  static constexpr MessageId kId = MessageId::params_origin;
  static constexpr std::size_t kSize = 20;
  std::uint8_t request = {};  // -
  std::uint8_t source = {};  // enum params_source
  std::uint32_t schema = {};  // -
  std::uint8_t kept = {};  // -
  std::uint8_t dropped = {};  // -
  std::uint32_t new_0 = {};  // -
  std::uint32_t new_1 = {};  // -
  std::uint32_t new_2 = {};  // -
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u8(to + 0, request);
    put_u8(to + 1, source);
    put_u32(to + 2, schema);
    put_u8(to + 6, kept);
    put_u8(to + 7, dropped);
    put_u32(to + 8, new_0);
    put_u32(to + 12, new_1);
    put_u32(to + 16, new_2);
  }
  static ParamsOriginMessage read([[maybe_unused]] const std::uint8_t* from) {
    ParamsOriginMessage m;
    m.request = get_u8(from + 0);
    m.source = get_u8(from + 1);
    m.schema = get_u32(from + 2);
    m.kept = get_u8(from + 6);
    m.dropped = get_u8(from + 7);
    m.new_0 = get_u32(from + 8);
    m.new_1 = get_u32(from + 12);
    m.new_2 = get_u32(from + 16);
    return m;
  }
};

// Samples of consecutive ticks, as differences; the section Telemetry batch gives the layout.
struct TelemetryMessage {
  static constexpr MessageId kId = MessageId::telemetry;
  static constexpr std::size_t kSize = 5;
  std::uint32_t first_tick = {};  // tick
  std::uint8_t count = {};  // -
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u32(to + 0, first_tick);
    put_u8(to + 4, count);
  }
  static TelemetryMessage read([[maybe_unused]] const std::uint8_t* from) {
    TelemetryMessage m;
    m.first_tick = get_u32(from + 0);
    m.count = get_u8(from + 4);
    return m;
  }
};

// An event with its reason.
struct EventMessage {
  static constexpr MessageId kId = MessageId::event;
  static constexpr std::size_t kSize = 11;
  std::uint32_t tick = {};  // tick
  std::uint8_t kind = {};  // enum event
  std::uint8_t detail = {};  // -
  std::uint8_t cause = {};  // enum trigger
  float value = {};  // -
  void write([[maybe_unused]] std::uint8_t* to) const {
    put_u32(to + 0, tick);
    put_u8(to + 4, kind);
    put_u8(to + 5, detail);
    put_u8(to + 6, cause);
    put_f32(to + 7, value);
  }
  static EventMessage read([[maybe_unused]] const std::uint8_t* from) {
    EventMessage m;
    m.tick = get_u32(from + 0);
    m.kind = get_u8(from + 4);
    m.detail = get_u8(from + 5);
    m.cause = get_u8(from + 6);
    m.value = get_f32(from + 7);
    return m;
  }
};

}  // namespace heli::link
