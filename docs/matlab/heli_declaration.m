function d = heli_declaration()
% HELI_DECLARATION  Messages, channels, parameters and faults of the link, as a structure.
%
% Written by firmware/generate.py from firmware/link.toml. Do not edit.

d.link_version = '1.5';
d.link_hash = uint32(1449467265);
d.protocol = 1;
d.baud = 250000;
d.tick_us = 1000;
d.max_command_payload = 64;
d.max_telemetry_payload = 480;

% Messages: id, names and types of their fields, the reply.
d.messages = struct();
d.messages.hello = struct('id', 1, 'fields', {{'request', 'link_hash', 'session'}}, 'types', {{'u8', 'u32', 'u32'}}, 'reply', 'welcome');
d.messages.ping = struct('id', 2, 'fields', {{'request', 'host_us'}}, 'types', {{'u8', 'u64'}}, 'reply', 'pong');
d.messages.arm = struct('id', 3, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'ack');
d.messages.stop = struct('id', 4, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'ack');
d.messages.control = struct('id', 5, 'fields', {{'request', 'axes', 'front_V', 'back_V'}}, 'types', {{'u8', 'u8', 'f32', 'f32'}}, 'reply', 'ack');
d.messages.stream = struct('id', 6, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'ack');
d.messages.land = struct('id', 7, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'ack');
d.messages.excite = struct('id', 8, 'fields', {{'request', 'kind', 'front_V', 'back_V', 'start_Hz', 'stop_Hz', 'duration_s', 'seed'}}, 'types', {{'u8', 'u8', 'f32', 'f32', 'f32', 'f32', 'f32', 'u32'}}, 'reply', 'ack');
d.messages.excite_stop = struct('id', 9, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'ack');
d.messages.param_set = struct('id', 10, 'fields', {{'request', 'index', 'value'}}, 'types', {{'u8', 'u8', 'f32'}}, 'reply', 'ack');
d.messages.params_read = struct('id', 11, 'fields', {{'request', 'first'}}, 'types', {{'u8', 'u8'}}, 'reply', 'params');
d.messages.params_save = struct('id', 12, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'ack');
d.messages.params_default = struct('id', 13, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'ack');
d.messages.zero = struct('id', 14, 'fields', {{'request', 'axes'}}, 'types', {{'u8', 'u8'}}, 'reply', 'ack');
d.messages.clear_fault = struct('id', 15, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'ack');
d.messages.status_read = struct('id', 16, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'status');
d.messages.law_begin = struct('id', 17, 'fields', {{'request', 'hash', 'words'}}, 'types', {{'u8', 'u32', 'u16'}}, 'reply', 'ack');
d.messages.law_part = struct('id', 18, 'fields', {{'request', 'first', 'word_0', 'word_1', 'word_2', 'word_3', 'word_4', 'word_5', 'word_6', 'word_7', 'word_8', 'word_9', 'word_10', 'word_11'}}, 'types', {{'u8', 'u16', 'u32', 'u32', 'u32', 'u32', 'u32', 'u32', 'u32', 'u32', 'u32', 'u32', 'u32', 'u32'}}, 'reply', 'ack');
d.messages.law_end = struct('id', 19, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'ack');
d.messages.law_fly = struct('id', 20, 'fields', {{'request', 'on'}}, 'types', {{'u8', 'u8'}}, 'reply', 'ack');
d.messages.law_set = struct('id', 21, 'fields', {{'request', 'index', 'value'}}, 'types', {{'u8', 'u8', 'f32'}}, 'reply', 'ack');
d.messages.law_read = struct('id', 22, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'law');
d.messages.controller_read = struct('id', 23, 'fields', {{'request', 'index'}}, 'types', {{'u8', 'u8'}}, 'reply', 'controller');
d.messages.params_origin_read = struct('id', 24, 'fields', {{'request'}}, 'types', {{'u8'}}, 'reply', 'params_origin');
d.messages.setpoint = struct('id', 32, 'fields', {{'apply_tick', 'elevation_rad', 'pitch_rad', 'travel_rad'}}, 'types', {{'u32', 'f32', 'f32', 'f32'}}, 'reply', '');
d.messages.voltages = struct('id', 33, 'fields', {{'front_V', 'back_V', 'valid_ms'}}, 'types', {{'f32', 'f32', 'u16'}}, 'reply', '');
d.messages.following = struct('id', 34, 'fields', {{'elevation_rad', 'pitch_rad', 'travel_rad'}}, 'types', {{'f32', 'f32', 'f32'}}, 'reply', '');
d.messages.ack = struct('id', 128, 'fields', {{'request', 'command', 'result', 'detail', 'value'}}, 'types', {{'u8', 'u8', 'u8', 'u8', 'f32'}}, 'reply', '');
d.messages.welcome = struct('id', 129, 'fields', {{'request', 'result', 'link_hash', 'link_major', 'link_minor', 'firmware_major', 'firmware_minor', 'firmware_patch', 'board', 'reset', 'boot_fault', 'boot_id', 'tick', 'params_source'}}, 'types', {{'u8', 'u8', 'u32', 'u8', 'u8', 'u8', 'u8', 'u8', 'u8', 'u8', 'u8', 'u32', 'u32', 'u8'}}, 'reply', '');
d.messages.pong = struct('id', 130, 'fields', {{'request', 'host_us', 'tick'}}, 'types', {{'u8', 'u64', 'u32'}}, 'reply', '');
d.messages.params = struct('id', 131, 'fields', {{'request', 'first', 'count'}}, 'types', {{'u8', 'u8', 'u8'}}, 'reply', '');
d.messages.status = struct('id', 132, 'fields', {{'request', 'tick', 'frames_ok', 'frames_bad', 'frames_lost', 'duplicates', 'stale_streams', 'ticks_dropped', 'overruns', 'tick_max_us', 'illegal_elevation', 'illegal_pitch', 'illegal_travel', 'setpoint_rate_Hz'}}, 'types', {{'u8', 'u32', 'u32', 'u32', 'u32', 'u32', 'u32', 'u32', 'u32', 'u16', 'u16', 'u16', 'u16', 'u16'}}, 'reply', '');
d.messages.law = struct('id', 135, 'fields', {{'request', 'hash', 'state', 'divisor', 'ticks', 'cost'}}, 'types', {{'u8', 'u32', 'u8', 'u8', 'u8', 'u32'}}, 'reply', '');
d.messages.controller = struct('id', 136, 'fields', {{'request', 'index', 'count', 'name_0', 'name_1', 'name_2', 'name_3'}}, 'types', {{'u8', 'u8', 'u8', 'u32', 'u32', 'u32', 'u32'}}, 'reply', '');
d.messages.params_origin = struct('id', 137, 'fields', {{'request', 'source', 'schema', 'kept', 'dropped', 'new_0', 'new_1', 'new_2'}}, 'types', {{'u8', 'u8', 'u32', 'u8', 'u8', 'u32', 'u32', 'u32'}}, 'reply', '');
d.messages.telemetry = struct('id', 133, 'fields', {{'first_tick', 'count'}}, 'types', {{'u32', 'u8'}}, 'reply', '');
d.messages.event = struct('id', 134, 'fields', {{'tick', 'kind', 'detail', 'cause', 'value'}}, 'types', {{'u32', 'u8', 'u8', 'u8', 'f32'}}, 'reply', '');

% Enumerations and sets of bits: numbers by name.
d.enums = struct();
d.enums.axis.elevation = 0;
d.enums.axis.pitch = 1;
d.enums.axis.travel = 2;
d.enums.state.idle = 0;
d.enums.state.armed = 1;
d.enums.state.closed_loop = 2;
d.enums.state.open_loop = 3;
d.enums.state.streamed = 4;
d.enums.state.hold = 5;
d.enums.state.landing = 6;
d.enums.state.fault = 7;
d.enums.state.emergency_landing = 8;
d.enums.result.ok = 0;
d.enums.result.unknown_command = 1;
d.enums.result.bad_length = 2;
d.enums.result.bad_value = 3;
d.enums.result.bad_state = 4;
d.enums.result.check_failed = 5;
d.enums.result.out_of_range = 6;
d.enums.result.no_such_parameter = 7;
d.enums.result.unsafe_now = 8;
d.enums.result.flash_failed = 9;
d.enums.result.no_handshake = 10;
d.enums.result.hash_mismatch = 11;
d.enums.result.bad_law = 12;
d.enums.law_error.none = 0;
d.enums.law_error.not_loaded = 1;
d.enums.law_error.flying = 2;
d.enums.law_error.too_long = 3;
d.enums.law_error.wrong_part = 4;
d.enums.law_error.incomplete = 5;
d.enums.law_error.wrong_hash = 6;
d.enums.law_error.wrong_format = 7;
d.enums.law_error.too_large = 8;
d.enums.law_error.unknown_operation = 9;
d.enums.law_error.bad_cell = 10;
d.enums.law_error.not_written = 11;
d.enums.law_error.bad_number = 12;
d.enums.law_error.bad_divisor = 13;
d.enums.law_error.too_costly = 14;
d.enums.law_error.no_such_parameter = 15;
d.enums.law_error.bad_sum = 17;
d.enums.law_error.not_flying = 16;
d.enums.law_state.none = 0;
d.enums.law_state.receiving = 1;
d.enums.law_state.ready = 2;
d.enums.law_state.flying = 3;
d.enums.takeover.command = 0;
d.enums.takeover.not_finite = 1;
d.enums.takeover.voltage_jump = 2;
d.enums.takeover.elevation_envelope = 3;
d.enums.takeover.pitch_envelope = 4;
d.enums.takeover.travel_envelope = 5;
d.enums.takeover.elevation_following = 6;
d.enums.takeover.pitch_following = 7;
d.enums.takeover.travel_following = 8;
d.enums.takeover.state = 9;
d.enums.reset.power_up = 0;
d.enums.reset.user = 1;
d.enums.reset.watchdog = 2;
d.enums.reset.software = 3;
d.enums.params_source.defaults = 0;
d.enums.params_source.stored = 1;
d.enums.params_source.fallback = 2;
d.enums.params_source.corrupt = 3;
d.enums.params_source.migrated = 4;
d.enums.excitation.none = 0;
d.enums.excitation.step = 1;
d.enums.excitation.doublet = 2;
d.enums.excitation.chirp = 3;
d.enums.excitation.multisine = 4;
d.enums.excitation.prbs = 5;
d.enums.event.boot = 0;
d.enums.event.state = 1;
d.enums.event.fault = 2;
d.enums.event.setpoint_stale = 3;
d.enums.event.setpoint_fresh = 4;
d.enums.event.params_saved = 5;
d.enums.event.excitation_end = 6;
d.enums.event.setpoint_rejected = 7;
d.enums.event.zeroed = 8;
d.enums.event.law_engaged = 9;
d.enums.event.law_taken_over = 10;
d.enums.event.travel_probe = 11;
d.enums.probe.none = 0;
d.enums.probe.asked = 1;
d.enums.probe.counts = 2;
d.enums.probe.silent = 3;
d.enums.probe.stopped = 4;
d.enums.trigger.arm = 0;
d.enums.trigger.stop = 1;
d.enums.trigger.close_loop = 2;
d.enums.trigger.open_loop = 3;
d.enums.trigger.stream = 4;
d.enums.trigger.land = 5;
d.enums.trigger.setpoint_fresh = 6;
d.enums.trigger.stale_hold = 7;
d.enums.trigger.stale_land = 8;
d.enums.trigger.touchdown = 9;
d.enums.trigger.trip = 10;
d.enums.trigger.clear = 11;
d.enums.trigger.axis_lost = 12;
d.enums.trigger.start = 13;
d.enums.axes.elevation = 1;
d.enums.axes.pitch = 2;
d.enums.axes.travel = 4;
d.enums.flags.front_saturated = 1;
d.enums.flags.back_saturated = 2;
d.enums.flags.excitation = 4;
d.enums.flags.link_alive = 8;
d.enums.flags.pitch_limited = 16;
d.enums.flags.overrun = 32;
d.enums.flags.law = 64;

% Channels in the order of the wire: name, type, scale, column of samples.
d.channels = {
  'elevation_count', 'i32', 1, 'elevation_rad'
  'pitch_count', 'i32', 1, 'pitch_rad'
  'travel_count', 'i32', 1, 'travel_rad'
  'elevation_setpoint', 'i32', 1e-05, 'elevation_setpoint_rad'
  'pitch_setpoint', 'i32', 1e-05, 'pitch_setpoint_rad'
  'travel_setpoint', 'i32', 1e-05, 'travel_setpoint_rad'
  'front', 'i16', 0.001, 'front_V'
  'back', 'i16', 0.001, 'back_V'
  'state', 'u8', 1, 'state'
  'fault', 'u8', 1, 'fault'
  'flags', 'u8', 1, 'flags'
  'trigger', 'u8', 1, 'trigger'
  'signal_1', 'i32', 1e-05, 'signal_1'
  'signal_2', 'i32', 1e-05, 'signal_2'
  'signal_3', 'i32', 1e-05, 'signal_3'
  'signal_4', 'i32', 1e-05, 'signal_4'
};

% Parameters in the order of the table: name, unit, least, most, default.
d.parameters = {
  'elevation_counts_per_rev', 'count', -65536, 65536, 4096
  'pitch_counts_per_rev', 'count', -65536, 65536, 4096
  'travel_counts_per_rev', 'count', -65536, 65536, 4096
  'elevation_rest_deg', 'deg', -60, 0, -25
  'supply_V', 'V', 5, 24, 12
  'motor_min_V', 'V', -24, 0, 0
  'motor_max_V', 'V', 0.5, 24, 10
  'motor_front_sign', '', -1, 1, 1
  'motor_back_sign', '', -1, 1, 1
  'dead_zone_V', 'V', 0, 5, 1
  'hover_V', 'V', 0, 20, 1.4
  'hover_slope', 'V/deg', -1, 1, 0.06
  'elevation_kp', 'V/deg', 0, 20, 0.28
  'elevation_ki', 'V/(deg s)', 0, 20, 0.49
  'elevation_kd', 'V s/deg', 0, 20, 0.22
  'elevation_rate_ff', '', 0, 1, 1
  'elevation_acceleration_ff', 'V s2/deg', 0, 1, 0.036
  'pitch_kp', 'V/deg', 0, 20, 0.09
  'pitch_ki', 'V/(deg s)', 0, 20, 0.0025
  'pitch_kd', 'V s/deg', 0, 20, 0.028
  'pitch_hold_ff', 'V/deg', -1, 1, 0.033
  'travel_kp', 'deg/deg', 0, 20, 0.6
  'travel_ki', 'deg/(deg s)', 0, 20, 0.06
  'travel_kd', 'deg s/deg', 0, 20, 3.15
  'travel_rate_ff', '', 0, 1, 1
  'travel_acceleration_ff', 'deg s2/deg', 0, 20, 1.09
  'elevation_integral_max_V', 'V', 0, 20, 3
  'pitch_integral_max_V', 'V', 0, 20, 2
  'travel_integral_max_deg', 'deg', 0, 45, 10
  'elevation_filter_Hz', 'Hz', 0.5, 200, 6
  'pitch_filter_Hz', 'Hz', 0.5, 200, 16
  'travel_filter_Hz', 'Hz', 0.5, 200, 3
  'pitch_setpoint_max_deg', 'deg', 1, 45, 30
  'differential_max_V', 'V', 0.1, 24, 1.4
  'elevation_slew_deg_s', 'deg/s', 0.5, 200, 15
  'pitch_slew_deg_s', 'deg/s', 1, 1000, 90
  'travel_slew_deg_s', 'deg/s', 0.5, 200, 20
  'elevation_acceleration_deg_s2', 'deg/s2', 1, 2000, 29
  'travel_acceleration_deg_s2', 'deg/s2', 1, 2000, 4.5
  'bumpless_s', 's', 0.02, 5, 0.3
  'elevation_max_deg', 'deg', 1, 60, 24
  'pitch_max_deg', 'deg', 5, 80, 45
  'travel_max_deg', 'deg', 10, 3600, 175
  'elevation_rate_max_deg_s', 'deg/s', 10, 1000, 120
  'pitch_rate_max_deg_s', 'deg/s', 10, 2000, 400
  'travel_rate_max_deg_s', 'deg/s', 10, 1000, 150
  'encoder_illegal_max', '', 0, 1000, 5
  'overrun_max', '', 0, 1000, 10
  'elevation_following_max_deg', 'deg', 1, 180, 15
  'pitch_following_max_deg', 'deg', 1, 180, 20
  'travel_following_max_deg', 'deg', 1, 3600, 30
  'following_s', 's', 0.1, 10, 1
  'elevation_motion_V', 'V', 0.1, 48, 1.2
  'pitch_motion_V', 'V', 0.1, 48, 0.5
  'motion_s', 's', 0.1, 10, 0.5
  'travel_motion_deg', 'deg', 0.5, 90, 8
  'travel_motion_s', 's', 0.1, 30, 1
  'travel_silence_s', 's', 0, 60, 2.5
  'elevation_gain', 'rad/(s2 V)', 0.02, 10, 0.485
  'pitch_gain', 'rad/(s2 V)', 0.1, 100, 2.97
  'travel_gain', '1/s2', 0.05, 100, 0.5
  'law_jump_max_V', 'V', 0.1, 48, 2.5
  'law_envelope', '', 0.2, 1, 0.8
  'arm_rate_max_deg_s', 'deg/s', 0.1, 100, 3
  'arm_elevation_tolerance_deg', 'deg', 0.1, 60, 2
  'arm_pitch_tolerance_deg', 'deg', 0.1, 60, 10
  'setpoint_hold_s', 's', 0.05, 5, 0.5
  'setpoint_land_s', 's', 0.1, 30, 2
  'landing_rate_deg_s', 'deg/s', 0.5, 60, 8
  'landing_timeout_s', 's', 1, 60, 12
  'voltage_valid_max_ms', 'ms', 5, 500, 100
  'excitation_max_V', 'V', 0, 12, 2
  'excitation_max_s', 's', 1, 600, 120
  'telemetry_batch_ticks', 'tick', 4, 32, 20
  'controller', '', 0, 7, 0
};

% Faults: code, name, what it means and what to do.
d.faults = {
  1, 'elevation_limit', 'elevation above its limit', 'lower the setpoint; lift the arm by hand and check that elevation rises in heli-host watch; tune the gains for this rig'
  2, 'pitch_limit', 'pitch beyond its limit', 'check that the front rotor lifts the front, and that pitch then rises; otherwise exchange the motors; then tune the gains'
  3, 'travel_limit', 'travel beyond its limit, so that the cables wind up', 'turn the arm back by hand, then zero travel'
  4, 'elevation_rate', 'elevation moved faster than its limit', 'look at the figure: after a single jump, check the encoder''s cable; if elevation oscillates, tune the gains'
  5, 'pitch_rate', 'pitch moved faster than its limit', 'look at the figure: after a single jump, check the encoder''s cable; if pitch oscillates, tune the gains'
  6, 'travel_rate', 'travel moved faster than its limit', 'look at the figure: after a single jump, check the encoder''s cable; if travel oscillates, tune the gains'
  7, 'encoder_elevation', 'too many illegal transitions of the elevation encoder', 'check its plug, pull-ups, shield and ground'
  8, 'encoder_pitch', 'too many illegal transitions of the pitch encoder', 'check its plug, pull-ups, shield and ground'
  9, 'encoder_travel', 'too many illegal transitions of the travel encoder', 'check its plug, pull-ups, shield and ground'
  10, 'landing_timeout', 'the arm did not reach the table in time', 'check that nothing holds the arm, and that its weight brings it down without voltage'
  11, 'tick_overrun', 'too many control ticks ran late', 'report it with the log: the firmware missed its deadline'
  12, 'hardware_stop', 'the hardware stop input is active', 'release the stop, check its wire, then clear the fault; without a switch, connect D29 to ground'
  13, 'elevation_following', 'elevation stayed too far from its setpoint for following_s', 'check supply and propellers, then hover_V, then the elevation encoder; tune the gains for this rig'
  14, 'pitch_following', 'pitch stayed too far from its setpoint for following_s', 'check that both rotors push, then the gains and the pitch encoder; tune the gains for this rig'
  15, 'travel_following', 'travel stayed too far from its setpoint for following_s', 'look for a cable, a draught or friction that holds or drives the arm; then check the gains and the travel encoder'
  16, 'encoder_overload', 'encoder edges came faster than the board can count, so the angle is wrong', 'look for noise from the motors, a missing ground or a missing pull-up; then zero the axis'
  17, 'elevation_motionless', 'the sum of both voltages changed enough to move the arm, but the elevation encoder did not count', 'check the elevation encoder''s plug, the motors'' supply and enable lines; a heavier rig needs its own hover_V (tune)'
  18, 'pitch_motionless', 'the difference of the voltages changed enough to tilt the short arm, but the pitch encoder did not count', 'check the pitch encoder''s plug, then that both rotors push'
  19, 'travel_motionless', 'pitch tilted long enough to turn the arm, but the travel encoder did not count; value: predicted travel in deg', 'check the travel encoder''s plug; look for friction, or a cable that holds the arm; with much friction, raise travel_motion_deg'
  20, 'not_at_rest', 'the arm does not rest on the table', 'let it rest on the table and zero it; if it rests at another angle, set elevation_rest_deg'
  21, 'moving', 'an axis is moving', 'wait until everything is still'
  22, 'link_not_alive', 'no recent frame from the host', 'keep the session open while arming; a debugger or a busy computer may have paused it'
  23, 'parameters_invalid', 'the stored parameters are damaged or contradict each other', 'restore your copy with heli-host params restore FILE --save, or set the named parameters and save'
  24, 'pitch_not_level', 'the short arm is not level', 'level it, or zero it while level'
  25, 'elevation_below_table', 'elevation read more than 1 degree plus this tolerance below the table, where the arm cannot be', 'check the elevation encoder''s plug; then let the arm rest on the table and zero it'
  26, 'elevation_step', 'elevation changed within 4 ms by more than the arm can turn; the board does not arm until the axis is zeroed', 'check the elevation encoder''s plug and cable; then let the arm rest on the table and zero it'
  27, 'pitch_step', 'pitch changed within 4 ms by more than the short arm can turn; the board does not arm until the axis is zeroed', 'check the pitch encoder''s plug and cable, and that nothing strikes the short arm; then level it and zero it'
  28, 'travel_step', 'travel changed within 4 ms by more than the arm can turn; the board does not arm until the axis is zeroed', 'check the travel encoder''s plug and cable; then zero it'
  29, 'elevation_rest', 'after landing, the arm rests without lift at another elevation than before take-off', 'check the elevation encoder''s plug; if the arm floats or sticks above the table without voltage, shift its counterweight or free its bearing; then let it rest on the table and zero it'
  33, 'elevation_sign', 'at take-off, elevation decreased although the rotors lift: the sign of the elevation encoder is wrong', 'lift the arm by hand: heli-host watch must show a larger elevation; if not, reverse the sign of elevation_counts_per_rev, or swap the encoder''s lines A and B'
  34, 'pitch_sign', 'pitch turned against the difference of the voltages: the sign of the pitch encoder is wrong, the motors are exchanged, or one pushes down', 'tilt the short arm by hand: pitch must be positive with the front rotor up; then try each motor alone with heli-host motors'
  35, 'travel_sign', 'travel turned against the tilt: the sign of the travel encoder is wrong', 'turn the arm by hand and compare with the signs; reverse the sign of travel_counts_per_rev, or swap the encoder''s lines A and B; after a loose pitch plug, zero pitch'
  30, 'watchdog', 'the watchdog restarted the board, because the control tick or the idle loop hung', 'report it with the log'
  31, 'hard_fault', 'the processor reported an error; the board switched off the motor drivers and restarted', 'report it with the log'
  32, 'unexpected_interrupt', 'an interrupt without a handler came; the board switched off the motor drivers and restarted', 'report it with the log'
};
end
