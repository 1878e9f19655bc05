classdef Heli < handle
  % HELI  A 3-DOF lab helicopter, from MATLAB or Octave: samples, setpoints, voltages, parameters.
  %
  %   h = Heli('127.0.0.1', 5000);       % heli-host sil --tcp 127.0.0.1:5000
  %   h = Heli('COM3');                  % the board itself; '/dev/ttyACM0' on Linux
  %   h.takeOff(0);                      % elevation in degrees, level is 0
  %   h.setpoint(4, 15);                 % elevation and travel, degrees
  %   h.wait(10);
  %   s = h.samples();
  %   plot(s.t_s, s.travel_rad * 180 / pi)
  %   h.land();
  %   h.close();
  %
  % Nothing happens in the background: setpoints are sent and samples come in only while a method
  % runs, so let time pass with h.wait(seconds), not with pause. When MATLAB stops asking, the board
  % holds level after half a second and lands by itself after two.
  %
  % Angles are in radians as their names say, and in degrees where they are given. Voltages are in
  % volts. Signs and zeros are those of docs/explanation/architecture.md, bytes those of docs/reference/link.md.
  %
  % MATLAB needs R2020b for tcpclient, R2019b for serialport; Octave the package instrument-control.

  properties (SetAccess = private)
    declaration  % messages, channels, parameters and faults, as heli_declaration() returns them
    info         % who answered: board, versions, why it started
    latest       % newest sample, a structure; empty before the first
    events       % cell array of what the board has reported, structures
    losses       % structure: frames that came damaged, ticks that did not come
  end

  properties
    keep_s = 600  % samples that are kept, s
  end

  properties (Access = private)
    port
    received = zeros(1, 0, 'uint8')
    sequence = 0
    request = 0
    replies = struct('id', {}, 'payload', {})
    batches = {}
    parameter_values = []
    target = []
    target_sent_s = -Inf
    pinged_s = -Inf
    next_tick = -1
    crc_bits
    crc_zeros
    base_weights
    base_spans
    scales
    clock
  end

  methods
    function h = Heli(where, number)
      % HELI  Connect to a board at a serial port, or at a host and its TCP port.
      h.declaration = heli_declaration();
      [h.crc_bits, h.crc_zeros] = Heli.crcTables(h.declaration.max_telemetry_payload + 8);
      h.layOut();
      h.clock = tic();
      h.events = {};
      h.losses = struct('frames', 0, 'ticks', 0);
      if nargin > 1
        h.port = tcpclient(where, number);
      else
        h.port = serialport(where, h.declaration.baud);
      end
      h.greet();
      h.readParameters();
    end

    function close(h)
      % CLOSE  Motors off, and leave the port. Land before.
      if ~isempty(h.port)
        h.stop();
        h.port = [];
      end
    end

    % ---- flying

    function arm(h)
      % ARM  Pre-flight checks, then drivers on at zero voltage. An error names the check that failed.
      h.command('arm', struct());
    end

    function stop(h)
      % STOP  Motors off now, from any state.
      h.target = [];
      h.command('stop', struct());
    end

    function control(h, axes, front_V, back_V)
      % CONTROL  Close the loops of some axes: control({'elevation', 'pitch'}). None: open loop, with voltages.
      if nargin < 4
        front_V = 0; back_V = 0;
      end
      h.command('control', struct('axes', h.mask(axes), 'front_V', front_V, 'back_V', back_V));
    end

    function takeOff(h, elevation_deg, timeout_s)
      % TAKEOFF  Arm if idle, close all loops, climb, and wait until it is there.
      if nargin < 2, elevation_deg = 0; end
      if nargin < 3, timeout_s = 20; end
      h.waitUntil(@(s) true, 5);
      if strcmp(h.state(), 'idle')
        h.arm();
      end
      h.control({'elevation', 'pitch', 'travel'});
      h.setpoint(elevation_deg, h.latest.travel_rad * 180 / pi);
      % The answer to a command overtakes the telemetry of the tick before it.
      h.waitUntil(@(s) ~any(strcmp(h.state(), {'idle', 'armed'})), 5);
      there = @(s) abs(s.elevation_rad * 180 / pi - elevation_deg) < 2;
      h.waitUntil(@(s) there(s) || any(strcmp(h.state(), {'idle', 'fault'})), timeout_s);
      if ~there(h.latest)
        error('Heli:flight', 'the board is %s: %s', h.state(), h.faultText(h.latest.fault));
      end
    end

    function setpoint(h, elevation_deg, travel_deg, pitch_deg)
      % SETPOINT  Where to, in degrees; repeated ten times a second while a method runs. Pitch counts
      % only while travel is not closed.
      if nargin < 4, pitch_deg = 0; end
      h.target = [elevation_deg, pitch_deg, travel_deg] * pi / 180;
      h.sendTarget();
    end

    function land(h, timeout_s)
      % LAND  Controlled descent, then motors off; waits for it.
      if nargin < 2, timeout_s = 30; end
      h.command('land', struct());
      h.target = [];
      h.waitUntil(@(s) any(strcmp(h.state(), {'idle', 'fault'})), timeout_s);
    end

    function stream(h)
      % STREAM  Hand the motor voltages over to voltages().
      h.command('stream', struct());
    end

    function voltages(h, front_V, back_V, valid_ms)
      % VOLTAGES  Motor voltages for the next valid_ms (100 at most by default), after stream().
      if nargin < 4, valid_ms = 100; end
      h.send('voltages', struct('front_V', front_V, 'back_V', back_V, 'valid_ms', valid_ms));
      h.poll();
    end

    function clearFault(h)
      % CLEARFAULT  Leave the fault state for idle.
      h.command('clear_fault', struct());
    end

    function zero(h, axes)
      % ZERO  Take the present position as rest (elevation) or zero (pitch, travel); only while idle.
      h.command('zero', struct('axes', h.mask(axes)));
    end

    function said = command(h, name, fields)
      % COMMAND  Any command of docs/reference/link.md with its fields as a structure; its reply as one.
      fields.request = mod(h.request, 255) + 1;
      h.request = fields.request;
      reply = h.declaration.messages.(h.declaration.messages.(name).reply);
      for attempt = 1:10
        h.send(name, fields);
        until_s = toc(h.clock) + 0.3;
        while toc(h.clock) < until_s
          said = h.takeReply(reply, fields.request);
          if ~isempty(said)
            h.refuse(name, said);
            return
          end
          h.poll();
        end
      end
      error('Heli:silent', 'no answer to %s: is the board there, and is no other program using its port?', name);
    end

    % ---- what is known

    function wait(h, duration_s)
      % WAIT  Let time pass: setpoints go out, samples come in.
      until_s = toc(h.clock) + duration_s;
      while toc(h.clock) < until_s
        h.poll();
      end
    end

    function sample = waitUntil(h, condition, timeout_s)
      % WAITUNTIL  Wait for a condition of the newest sample, such as @(s) s.elevation_rad > 0.
      until_s = toc(h.clock) + timeout_s;
      while isempty(h.latest) || ~condition(h.latest)
        if toc(h.clock) > until_s
          error('Heli:timeout', 'this did not happen within %g s', timeout_s);
        end
        h.poll();
      end
      sample = h.latest;
    end

    function s = samples(h)
      % SAMPLES  Every tick that came, as a structure of columns: tick, t_s, elevation_rad, front_V, ...
      s = struct('tick', [], 't_s', []);
      names = h.declaration.channels(:, 4);
      table = vertcat(h.batches{:});
      if isempty(table)
        table = zeros(0, 1 + numel(names));
      end
      s.tick = table(:, 1);
      s.t_s = (s.tick - min([s.tick; Inf])) * h.declaration.tick_us * 1e-6;
      for index = 1:numel(names)
        s.(names{index}) = table(:, 1 + index);
      end
    end

    function name = state(h)
      % STATE  State of the board, by its name: idle, armed, closed_loop, hold, landing, fault, ...
      name = '';
      if ~isempty(h.latest)
        name = h.nameOf('state', h.latest.state);
      end
    end

    function p = parameters(h)
      % PARAMETERS  All parameters of the board, as a structure.
      p = cell2struct(num2cell(h.parameter_values(:)), h.declaration.parameters(:, 1), 1);
    end

    function value = setParameter(h, name, value)
      % SETPARAMETER  Set one in memory; returns the value in force. saveParameters() keeps it.
      index = find(strcmp(h.declaration.parameters(:, 1), name));
      if isempty(index)
        error('Heli:parameter', 'there is no parameter ''%s''; parameters() lists them', name);
      end
      said = h.command('param_set', struct('index', index - 1, 'value', value));
      value = said.value;
      h.parameter_values(index) = value;
      h.findScales();
    end

    function saveParameters(h)
      % SAVEPARAMETERS  Write all parameters to the board's flash; only while idle.
      h.command('params_save', struct());
    end

    function text = faultText(h, code)
      % FAULTTEXT  What a fault code means, and what to do.
      text = 'no fault';
      row = find(cell2mat(h.declaration.faults(:, 1)) == code);
      if ~isempty(row)
        text = sprintf('%s; %s', h.declaration.faults{row, 3}, h.declaration.faults{row, 4});
      end
    end

    function poll(h)
      % POLL  Send what is due, take in what has come. wait() does it for you.
      h.sendDue();
      count = h.port.NumBytesAvailable;
      if count == 0
        pause(0.002);
        return
      end
      h.received = [h.received, reshape(uint8(read(h.port, count, 'uint8')), 1, [])];
      start = 1;
      for stop = find(h.received == 0)
        h.take(h.received(start:stop - 1));
        start = stop + 1;
        h.sendDue();
      end
      h.received = h.received(start:end);
    end
  end

  methods (Access = private)
    function greet(h)
      % A board on a serial port starts anew when the port is opened, which takes it some seconds.
      session = floor(rand() * 2^32);
      request = struct('link_hash', h.declaration.link_hash, 'session', session);
      h.info = h.command('hello', request);
      if h.info.result ~= h.declaration.enums.result.ok
        error('Heli:version', ['the board has link version %d.%d, but this class has %s: flash the board, or take ' ...
          'Heli.m and heli_declaration.m of its version'], h.info.link_major, h.info.link_minor, ...
          h.declaration.link_version);
      end
    end

    function readParameters(h)
      count = size(h.declaration.parameters, 1);
      h.parameter_values = nan(1, count);
      first = 0;
      while first < count
        said = h.command('params_read', struct('first', first));
        h.parameter_values(first + (1:said.count)) = typecast(said.rest(1:4 * said.count), 'single');
        first = first + said.count;
      end
      h.findScales();
      % What came before is in counts.
      h.batches = {};
    end

    function sendDue(h)
      % The board takes silence for a host that is gone: first it holds level, then it lands.
      now_s = toc(h.clock);
      if ~isempty(h.target) && now_s - h.target_sent_s > 0.1
        h.sendTarget();
      elseif isempty(h.target) && now_s - h.pinged_s > 0.1
        h.pinged_s = now_s;
        % The number 0 is none of a command that is waited for.
        h.send('ping', struct('request', 0, 'host_us', floor(now_s * 1e6)));
      end
    end

    function sendTarget(h)
      h.target_sent_s = toc(h.clock);
      tick = 0;
      if ~isempty(h.latest)
        tick = mod(h.latest.tick, 2^32);
      end
      h.send('setpoint', struct('apply_tick', tick, 'elevation_rad', h.target(1), ...
        'pitch_rad', h.target(2), 'travel_rad', h.target(3)));
    end

    function send(h, name, fields)
      message = h.declaration.messages.(name);
      payload = zeros(1, 0, 'uint8');
      for index = 1:numel(message.fields)
        number = fields.(message.fields{index});
        payload = [payload, typecast(cast(number, Heli.typeOf(message.types{index})), 'uint8')]; %#ok<AGROW>
      end
      body = [uint8([h.declaration.protocol, message.id, h.sequence]), payload];
      h.sequence = mod(h.sequence + 1, 256);
      crc = typecast(Heli.crc(body, h.crc_bits, h.crc_zeros), 'uint8');
      write(h.port, [Heli.encode([body, crc]), uint8(0)], 'uint8');
    end

    function take(h, frame)
      % One frame as it came, without its delimiter.
      body = Heli.decode(frame);
      right = numel(body) >= 7 && numel(body) <= numel(h.crc_zeros);
      if right
        crc = typecast(body(end - 3:end), 'uint32');
        right = crc == Heli.crc(body(1:end - 4), h.crc_bits, h.crc_zeros) ...
          && body(1) == h.declaration.protocol;
      end
      if ~right
        h.losses.frames = h.losses.frames + ~isempty(frame);
        return
      end
      id = double(body(2));
      payload = body(4:end - 4);
      messages = h.declaration.messages;
      if id == messages.telemetry.id
        h.takeBatch(payload);
      elseif id == messages.event.id
        event = Heli.unpack(messages.event, payload);
        event.name = h.nameOf('event', event.kind);
        h.events{end + 1} = event;
      else
        h.replies(end + 1) = struct('id', id, 'payload', payload);
        h.replies = h.replies(max(1, end - 7):end);
      end
    end

    function said = takeReply(h, reply, request)
      said = [];
      for index = 1:numel(h.replies)
        one = h.replies(index);
        if one.id == reply.id && one.payload(1) == request
          said = Heli.unpack(reply, one.payload);
          h.replies(index) = [];
          return
        end
      end
    end

    function refuse(h, name, said)
      if ~isfield(said, 'result') || isfield(said, 'link_hash') || said.result == 0
        return
      end
      why = h.nameOf('result', said.result);
      if said.result == h.declaration.enums.result.check_failed
        why = h.faultText(said.detail);
      elseif said.result == h.declaration.enums.result.bad_state
        why = ['not while ', h.nameOf('state', said.detail)];
      end
      error('Heli:refused', 'the board refuses %s: %s', name, why);
    end

    function takeBatch(h, payload)
      bytes = double(payload);
      first = bytes(1:4) * 256.^(0:3)';
      count = bytes(5);
      nibbles = [mod(bytes(6:13), 16); floor(bytes(6:13) / 16)];
      widths = [0, 2, 4, 8, 16, 32];
      widths = widths(nibbles(1:numel(h.base_spans)) + 1);
      place = 14 + size(h.base_weights, 1);
      bases = bytes(14:place - 1) * h.base_weights;
      negative = bases >= h.base_spans / 2;
      bases(negative) = bases(negative) - h.base_spans(negative);
      raw = repmat(bases, count, 1);
      for index = find(widths > 0 & count > 1)
        width = widths(index);
        last = place + ceil(width * (count - 1) / 8);
        bits = Heli.bitsOf(payload(place:last - 1));
        deltas = 2.^(0:width - 1) * reshape(bits(1:width * (count - 1)), width, []);
        deltas = deltas - 2^width * (deltas >= 2^(width - 1));
        raw(2:end, index) = bases(index) + cumsum(deltas(:));
        if width == 32
          raw(:, index) = mod(raw(:, index) + 2^31, 2^32) - 2^31;
        end
        place = last;
      end
      table = [first + (0:count - 1)', bsxfun(@times, raw, h.scales)];
      if h.next_tick >= 0 && first > h.next_tick
        h.losses.ticks = h.losses.ticks + first - h.next_tick;
      end
      h.next_tick = first + count;
      h.batches{end + 1} = table;
      while numel(h.batches) > 1 && first - h.batches{1}(1) > h.keep_s * 1e6 / h.declaration.tick_us
        h.batches(1) = [];
      end
      h.latest = cell2struct(num2cell(table(end, :)'), [{'tick'}; h.declaration.channels(:, 4)], 1);
    end

    function layOut(h)
      % Where the bases of a batch lie: weights of their bytes, and the span of those with a sign.
      channels = h.declaration.channels;
      h.base_weights = zeros(0, size(channels, 1));
      h.base_spans = zeros(1, size(channels, 1));
      h.scales = zeros(1, size(channels, 1));
      for index = 1:size(channels, 1)
        bytes = Heli.sizeOf(channels{index, 2});
        h.base_weights(end + (1:bytes), index) = 256.^(0:bytes - 1)';
        h.base_spans(index) = 256^bytes;
        if channels{index, 2}(1) == 'u'
          h.base_spans(index) = Inf;
        end
        h.scales(index) = channels{index, 3};
      end
    end

    function findScales(h)
      % An encoder's count is an angle, by the parameter of its axis.
      for axis = fieldnames(h.declaration.enums.axis)'
        channel = strcmp(h.declaration.channels(:, 1), [axis{1}, '_count']);
        turn = strcmp(h.declaration.parameters(:, 1), [axis{1}, '_counts_per_rev']);
        h.scales(channel) = 2 * pi / abs(h.parameter_values(turn));
      end
    end

    function bits = mask(h, axes)
      bits = 0;
      for axis = reshape(cellstr(axes), 1, [])
        if ~isempty(axis{1})
          bits = bits + h.declaration.enums.axes.(axis{1});
        end
      end
    end

    function name = nameOf(h, kind, number)
      names = fieldnames(h.declaration.enums.(kind));
      name = sprintf('%s %d', kind, number);
      for index = 1:numel(names)
        if h.declaration.enums.(kind).(names{index}) == number
          name = names{index};
        end
      end
    end
  end

  methods (Static)
    function said = unpack(message, payload)
      % UNPACK  Fields of a message, as numbers; what follows them in `rest`.
      said = struct();
      place = 1;
      for index = 1:numel(message.fields)
        last = place + Heli.sizeOf(message.types{index});
        number = typecast(payload(place:last - 1), Heli.typeOf(message.types{index}));
        said.(message.fields{index}) = double(number);
        place = last;
      end
      said.rest = payload(place:end);
    end

    function out = encode(bytes)
      % ENCODE  Consistent overhead byte stuffing: no zeros are left.
      out = zeros(1, 0, 'uint8');
      ends = [find(bytes == 0), numel(bytes) + 1];
      start = 1;
      for stop = ends
        block = bytes(start:stop - 1);
        while numel(block) >= 254
          out = [out, uint8(255), block(1:254)]; %#ok<AGROW>
          block = block(255:end);
          if isempty(block) && stop == numel(bytes) + 1
            return
          end
        end
        out = [out, uint8(numel(block) + 1), block]; %#ok<AGROW>
        start = stop + 1;
      end
    end

    function out = decode(frame)
      % DECODE  The opposite of encode; empty where a code byte points beyond the end.
      out = zeros(1, 0, 'uint8');
      codes = double(frame);
      joints = zeros(1, 0);
      place = 1;
      while place <= numel(codes)
        joints(end + 1) = place; %#ok<AGROW>
        place = place + codes(place);
      end
      if isempty(codes) || place ~= numel(codes) + 1 || any(codes == 0)
        return
      end
      out = frame;
      out(joints) = 0;
      full = codes(joints) == 255;
      out([1, joints([false, full(1:end - 1)])]) = [];
    end

    function value = crc(bytes, bits, zeros_crc)
      % CRC  CRC-32 (IEEE 802.3, reflected): linear in the bits, so that no loop over bytes is needed.
      ones = Heli.bitsOf(bytes(end:-1:1));
      % The whole table, and zeros for what the message is too short for: a part of it would be copied.
      ones(size(bits, 1)) = 0;
      odd = mod(ones * bits, 2);
      value = bitxor(uint32(odd * 2.^(0:31)'), zeros_crc(numel(bytes) + 1));
    end

    function [bits, zeros_crc] = crcTables(length)
      % CRCTABLES  What each bit of a message contributes, counted from its end; and the CRC of zeros.
      polynomial = uint32(hex2dec('EDB88320'));
      table = uint32(0:255);
      for k = 1:8
        odd = bitand(table, uint32(1)) == 1;
        table = bitshift(table, -1);
        table(odd) = bitxor(table(odd), polynomial);
      end
      step = @(c) bitxor(bitshift(c, -8), table(double(bitand(c, uint32(255))) + 1));
      one = table(2.^(0:7) + 1);
      state = uint32(4294967295);
      zeros_crc = zeros(1, length + 1, 'uint32');
      each = zeros(8, length, 'uint32');
      for k = 1:length
        zeros_crc(k) = bitxor(state, uint32(4294967295));
        state = step(state);
        each(:, k) = one;
        one = step(one);
      end
      bits = zeros(8 * length, 32);
      for bit = 1:32
        bits(:, bit) = double(bitget(each(:), bit));
      end
      zeros_crc(length + 1) = bitxor(state, uint32(4294967295));
    end

    function bits = bitsOf(bytes)
      % BITSOF  Bits of bytes, each from its least significant one on.
      bits = zeros(8, numel(bytes));
      for bit = 1:8
        bits(bit, :) = double(bitget(bytes, bit));
      end
      bits = reshape(bits, 1, []);
    end

    function name = typeOf(wire)
      % TYPEOF  MATLAB's name of a type of the wire.
      names = struct('u8', 'uint8', 'u16', 'uint16', 'u32', 'uint32', 'u64', 'uint64', 'i8', 'int8', ...
        'i16', 'int16', 'i32', 'int32', 'f32', 'single');
      name = names.(wire);
    end

    function bytes = sizeOf(wire)
      % SIZEOF  Bytes of a type of the wire.
      bytes = str2double(wire(2:end)) / 8;
    end
  end
end
