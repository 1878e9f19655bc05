// One session with one board, without input and output: takes received bytes, returns the bytes to send.
//
// The rules are those of heli_host.link: a test plays the same bytes through both. Host and board share one clock
// here, so device time passes as fast as host time.
import { CHANNELS, LINK, MESSAGES, NAMES } from "./declaration.js";
import { encodeFrame, FrameParser, NAME_OF_ID, pack, unpack, unpackTelemetry } from "./frames.js";

const HEARTBEAT_S = 0.199, CLOCK_PING_S = 1, SILENCE_S = 1, HELLO_S = 0.1;
const FIRST_TRY_S = 0.06, LONGEST_TRY_S = 0.5, TIMEOUT_S = 2;
const SETPOINT_S = 1 / 200, KEEP_ALIVE_S = 0.099;
const HELD_BATCHES = 500, NOTHING = new Uint8Array(0);
export const CHANNEL = Object.fromEntries(CHANNELS.map(([name], index) => [name, index]));
const KIND_OF = Object.fromEntries(Object.entries(NAMES).map(([kind, names]) => [kind, Object.fromEntries(Object.entries(names).map(([name, value]) => [value, name]))]));

export function nameOf(kind, value, prefix = "") { return KIND_OF[kind][value] ?? `${prefix}${value}`; }

// An error for a person: what is wrong, and what to do.
export class HeliError extends Error {
  constructor(cause, remedy) {
    super(`${cause}; ${remedy}`);
    Object.assign(this, { cause, remedy });
  }
}

function joined(frames) {
  if (frames.length < 2) return frames[0] ?? NOTHING;
  return Uint8Array.from(frames.flatMap((frame) => [...frame]));
}

class Request {
  constructor(name, fields, nowS) {
    Object.assign(this, { name, fields, deadlineS: nowS + TIMEOUT_S, nextTryS: nowS, tries: 0, reply: null, error: null });
  }

  get done() { return this.reply !== null || this.error !== null; }
}

export class Engine {
  constructor(session = 1) {
    Object.assign(this, { session, number: session & 255, seq: 0, isOpen: false, welcome: null, nextHelloS: -Infinity, mismatch: null });
    Object.assign(this, { parser: new FrameParser(), request: null, roundTripS: 0, retries: 0, malformed: 0, reconnects: 0, restarts: 0 });
    Object.assign(this, { kept: null, waiting: null, sentSetpointS: -1e9, setpointsSent: 0, setpointsSkipped: 0, permitted: () => true });
    Object.assign(this, { held: [], lastTick: null, newest: null, ticksReceived: 0, ticksLost: 0, heardS: 0, sentS: -1e9, pingS: -1e9, status: null, arrived: [] });
    this.baseline = this.counts();
    this.helloRequest = this.take();
  }

  get state() { return this.newest ? nameOf("state", this.newest[CHANNEL.state]) : null; }

  take() { return (this.number = (this.number % 255) + 1); }

  counts() { const { ok, bad, lost, received, dropped } = this.parser; return { ok, bad, lost, received, dropped }; }

  // Counters of the session, by the names that logs use.
  counters() {
    const now = this.counts(), before = this.baseline;
    return {
      frames_ok: now.ok - before.ok, frames_bad: now.bad - before.bad + this.malformed, frames_lost: now.lost - before.lost,
      bytes_received: now.received - before.received, bytes_dropped: now.dropped - before.dropped, retries: this.retries,
      reconnects: this.reconnects, restarts: this.restarts, ticks_received: this.ticksReceived, ticks_lost: this.ticksLost,
      setpoints_sent: this.setpointsSent, setpoints_skipped: this.setpointsSkipped, voltages_sent: 0, voltages_skipped: 0,
      ...Object.fromEntries(Object.entries(this.status ?? {}).filter(([name]) => name !== "request" && name !== "tick").map(([name, value]) => [`board_${name}`, value])),
    };
  }

  ask(name, fields, nowS) {
    this.request = new Request(name, { ...fields, request: this.take() }, nowS);
    return this.request;
  }

  // A stop takes the place of any other command.
  preempt(nowS) {
    if (this.request && !this.request.done) this.request.error = new HeliError(`a stop came before the board answered ${this.request.name}`, "begin again");
    [this.kept, this.waiting] = [null, null];
    return this.ask("stop", {}, nowS);
  }

  // A streamed setpoint: of several that wait, only the newest is sent.
  stream(setpoint) {
    this.setpointsSkipped += this.waiting ? 1 : 0;
    this.waiting = setpoint;
  }

  // Returns what arrived: {batches, events, statuses}. A batch is {tick, raw} with ticks counted on beyond 2^32.
  receive(data, nowS) {
    const received = { batches: [], events: [], statuses: [] };
    const frames = data.length ? this.parser.feed(data) : [];
    if (frames.length) this.heardS = nowS;
    for (const frame of frames) {
      if (frame.id === MESSAGES.telemetry.id) this.held.push(frame.payload);
      else this.process(frame, nowS, received);
    }
    if (!this.isOpen) {
      this.held.splice(0, this.held.length - HELD_BATCHES);
      return received;
    }
    this.acceptTelemetry(nowS, received);
    if (nowS - this.heardS > SILENCE_S) {
      this.greetAgain(nowS);
      this.tell(received, "link_silent", "the board has fallen silent");
    }
    return received;
  }

  // The frames that are due: a command first, then a setpoint, then a sign of life.
  outgoing(nowS) {
    const request = this.request, out = [];
    const send = (name, fields) => {
      this.sentS = nowS;
      this.seq = (this.seq + 1) & 255;
      out.push(encodeFrame(MESSAGES[name].id, this.seq, pack(name, fields)));
    };
    if (request && !request.done && nowS >= request.deadlineS) request.error = new HeliError(`the board did not answer ${request.name}`, "check the link, then try again");
    if (!this.isOpen) {
      if (nowS >= this.nextHelloS) {
        this.nextHelloS = nowS + HELLO_S;
        send("hello", { request: this.helloRequest, link_hash: LINK.hash, session: this.session });
      }
      return joined(out);
    }
    const waits = request && !request.done;
    if (waits && nowS >= request.nextTryS) {
      this.retries += request.tries > 0 ? 1 : 0;
      request.nextTryS = nowS + Math.min(Math.max(FIRST_TRY_S, 2 * this.roundTripS) * 1.5 ** request.tries++, LONGEST_TRY_S);
      send(request.name, request.fields);
    }
    const isFlying = this.state === "closed_loop" || this.state === "hold";
    let keepAlive = isFlying && nowS - this.sentSetpointS >= KEEP_ALIVE_S ? this.kept : null;
    if ((this.waiting || keepAlive) && !this.permitted()) keepAlive = this.waiting = null;
    const replacesKept = this.waiting !== null, isDue = replacesKept && nowS >= this.sentSetpointS + SETPOINT_S;
    const setpoint = isDue ? this.waiting : replacesKept ? null : keepAlive;
    if (setpoint) {
      if (isDue) this.waiting = null;
      this.sentSetpointS = nowS;
      this.setpointsSent++;
      send("setpoint", setpoint);
    }
    if (!waits && (nowS - this.sentS >= HEARTBEAT_S || nowS - this.pingS >= CLOCK_PING_S)) {
      this.pingS = nowS;
      send("ping", { request: this.take(), host_us: Math.round(nowS * 1e6) });
    }
    return joined(out);
  }

  // The line was interrupted, or the port was opened again.
  cut(nowS) {
    this.parser.restart();
    this.greetAgain(nowS);
  }

  greetAgain(nowS) {
    [this.isOpen, this.nextHelloS, this.parser.expected] = [false, nowS, -1];
    this.helloRequest = this.take();
  }

  tell(received, kind, text) { received.events.push({ tick: (this.lastTick ?? 0) >>> 0, kind, text }); }

  unwrap(tick) { return this.lastTick === null ? tick : this.lastTick + ((tick - this.lastTick) | 0); }

  process(frame, nowS, received) {
    const name = NAME_OF_ID[frame.id], message = name ? unpack(name, frame.payload) : null;
    if (name && !message) {
      this.malformed++;
      return;
    }
    if (name === "welcome") this.processWelcome(message, nowS, received);
    else if (name === "pong") this.roundTripS = Math.max(0.8 * this.roundTripS, nowS - message.host_us * 1e-6);
    else if (name === "status") {
      this.status = message;
      received.statuses.push(message);
    } else if (name === "event") {
      received.events.push({ tick: message.tick, kind: nameOf("event", message.kind, "event_"), text: eventText(message), message });
      if (message.kind === NAMES.event.state || message.kind === NAMES.event.fault) this.arrived = [...this.arrived.slice(-63), message];
      if (message.kind === NAMES.event.boot && message.value !== this.welcome?.boot_id) this.greetAgain(nowS);
    } else if (name === "ack" && message.result === NAMES.result.no_handshake) {
      this.greetAgain(nowS);
      return;
    }
    const request = this.request;
    if (!request || request.done || message?.request !== request.fields.request) return;
    const isReply = name === "ack" ? message.command === MESSAGES[request.name].id : name === MESSAGES[request.name].reply;
    if (isReply) request.reply = { name, message, payload: frame.payload };
  }

  processWelcome(message, nowS, received) {
    if (this.isOpen || message.request !== this.helloRequest) return;
    if (message.result !== NAMES.result.ok || message.link_hash !== LINK.hash) {
      this.mismatch = new HeliError("this page and the firmware have different versions of the link", "build both from the same sources");
      return;
    }
    const before = this.welcome, isBehind = this.lastTick !== null && this.unwrap(message.tick) < this.lastTick;
    [this.isOpen, this.welcome] = [true, message];
    this.sentS = this.pingS = nowS - HEARTBEAT_S;
    if (!before) {
      this.held = [];
      this.baseline = this.counts();
      return;
    }
    this.reconnects++;
    if (message.boot_id === before.boot_id && !isBehind) {
      this.tell(received, "link_restored", "the link is back");
      if (this.request) this.request.nextTryS = nowS;
      return;
    }
    this.restarts++;
    Object.assign(this, { held: [], newest: null, kept: null, arrived: [] });
    const text = `the board restarted (${nameOf("reset", message.reset)})`;
    this.tell(received, "board_restarted", text);
    this.lastTick = null;
    if (this.request && !this.request.done) this.request.error = new HeliError(`${text} before it answered`, "check its supply, then arm again");
  }

  acceptTelemetry(nowS, received) {
    for (const payload of this.held.splice(0)) {
      const batch = unpackTelemetry(payload);
      if (!batch) {
        this.malformed++;
        continue;
      }
      const count = batch.raw[0].length, tick = this.unwrap(batch.first);
      if (this.lastTick !== null && tick <= this.lastTick) {
        this.greetAgain(nowS); // the board has restarted
        return;
      }
      this.ticksLost += this.lastTick === null ? 0 : tick - this.lastTick - 1;
      this.ticksReceived += count;
      this.noteMissed(batch, tick, received);
      this.lastTick = tick + count - 1;
      this.newest = batch.raw.map((values) => values[count - 1]);
      received.batches.push({ tick, raw: batch.raw });
    }
  }

  // Events that the samples show and whose messages were lost on the line.
  noteMissed({ raw }, tick, received) {
    const [states, triggers, faults] = ["state", "trigger", "fault"].map((name) => raw[CHANNEL[name]]);
    let [state, trigger, fault] = this.newest ? ["state", "trigger", "fault"].map((name) => this.newest[CHANNEL[name]]) : [states[0], triggers[0], faults[0]];
    const since = this.lastTick ?? tick - 1;
    const hasArrived = (kind, detail, at) => this.arrived.some((event) => event.kind === kind && event.detail === detail && this.unwrap(event.tick) > since - 1 && this.unwrap(event.tick) <= at);
    const add = (kind, detail, cause, at) => {
      const message = { tick: at >>> 0, kind, detail, cause, value: NaN };
      received.events.push({ tick: message.tick, kind: nameOf("event", kind), text: `${eventText(message)}; from telemetry, its event was lost`, message });
    };
    for (let i = 0; i < states.length; i++) {
      if (states[i] === state && triggers[i] === trigger && faults[i] === fault) continue;
      if ((states[i] !== state || triggers[i] !== trigger) && !hasArrived(NAMES.event.state, states[i], tick + i)) add(NAMES.event.state, states[i], triggers[i], tick + i);
      if (faults[i] !== fault && faults[i] && !hasArrived(NAMES.event.fault, faults[i], tick + i)) add(NAMES.event.fault, faults[i], triggers[i], tick + i);
      [state, trigger, fault] = [states[i], triggers[i], faults[i]];
    }
  }
}

// Set by the page's tables: number of a fault -> {name, meaning, remedy}.
export const FAULTS = {};

export function faultText(code) {
  const spec = FAULTS[code];
  return spec ? `${spec.name}: ${spec.meaning}${spec.parameter ? ` (${spec.parameter})` : ""}; ${spec.remedy}` : `fault ${code}`;
}

export function stateText(state, trigger) { return `state ${nameOf("state", state)}, because of ${nameOf("trigger", trigger)}`; }

function eventText({ kind, detail, cause, value }) {
  const words = {
    boot: () => `board started (${nameOf("reset", detail)}), boot id ${value.toFixed(0)}`,
    state: () => stateText(detail, cause),
    fault: () => `fault ${faultText(detail)}${Number.isNaN(value) ? "" : `; seen: ${+value.toPrecision(4)}`}`,
    setpoint_stale: () => `setpoints stopped coming; they came at ${value.toFixed(0)} Hz in the second before`,
    setpoint_fresh: () => "setpoints came back",
    params_saved: () => `parameters saved, generation ${value.toFixed(0)}`,
    excitation_end: () => `excitation ${nameOf("excitation", detail)} ended`,
    setpoint_rejected: () => `a streamed value was refused: ${nameOf("result", detail)}`,
    zeroed: () => `zero taken: ${Object.keys(NAMES.axes).filter((axis) => NAMES.axes[axis] & detail).join(", ")}`,
    law_engaged: () => `the law of the link flies, a call each ${value.toFixed(0)} ticks`,
    law_taken_over: () => `the board's own law took over (${nameOf("takeover", detail)}; ${+value.toPrecision(4)})`,
    travel_probe: () => `tilt to check the travel encoder: ${nameOf("probe", detail)}; tilt ${value.toFixed(1)} degrees`,
  }[nameOf("event", kind)];
  return words ? words() : `event ${nameOf("event", kind)} (detail ${detail}, value ${+value.toPrecision(4)})`;
}
