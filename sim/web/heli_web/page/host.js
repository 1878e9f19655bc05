// The small host: commands, flights and logs over one session. Waiting is done by generators that the simulation
// resumes after each reading, so that a flight does not depend on the browser's timers.
import { CHANNELS, LINK, NAMES, SETPOINT_MARGIN_DEG } from "./declaration.js";
import { CHANNEL, Engine, FAULTS, faultText, HeliError, nameOf, stateText } from "./engine.js";
import { crc32 } from "./frames.js";
import { Laws, takeover } from "./laws.js";
import { LogWriter } from "./log.js";
import { RestAngles } from "./rest.js";
import { closedAxes, takeOffRoute, Tracking } from "./plans.js";

const AXES = ["elevation", "pitch", "travel"];
const DEG = 180 / Math.PI;
const INTERVAL_TICKS = 20, LEAD_TICKS = 100, LONGEST_LEAD_TICKS = 400, SETPOINT_LEAD_TICKS = 40;
const BEFORE_TICKS = 500, AFTER_TICKS = 200, REST_TICKS = 2000;
const IN_THE_AIR = ["closed_loop", "streamed", "open_loop"], LANDED_BY = ["land", "stale_land"];
const DOWN = ["idle", "fault"], FLYING = ["armed", "closed_loop", "hold"];
const URGENT = { fault: 4, link_lost: 4, board_restarted: 4, link_silent: 3, setpoint_stale: 3, setpoint_rejected: 3 };
const STATE_REMEDIES = {
  idle: "arm first", armed: "start a control mode first, or stop to return to idle", landing: "wait until it has landed", hold: "send setpoints again, or land",
  fault: "see which fault it is, remove its cause, then clear the fault", emergency_landing: "wait until it has landed, then see which fault it was",
};

function shortest(value) { return +Math.fround(value).toPrecision(7); }

export class Host {
  // world: see world.js; facts: what heli_web.build writes; tell: takes news for the page.
  constructor(world, facts, tell, setup = {}) {
    Object.assign(this, { world, facts, tell, setup, engine: new Engine(), tasks: [], params: {}, undo: [], marks: 0, stops: 0 });
    Object.assign(this, { events: [], doing: "", flight: null, target: null, recorder: null, cause: "", pull: false, arrivedTick: 0, recent: [], atRest: null });
    Object.assign(FAULTS, facts.faults);
    Object.assign(this, { laws: new Laws(this, facts.laws ?? []), signals: {} });
  }

  get nowS() { return this.world.tick * 1e-3; }
  get state() { return this.engine.state; }
  get tick() { return this.engine.lastTick ?? 0; }

  // Lets milliseconds of the simulation pass.
  step(ticks, least = 4) {
    const end = this.world.tick + ticks;
    while (this.world.tick < end) {
      const left = end - this.world.tick;
      const bytes = this.pull ? new Uint8Array(0) : this.engine.outgoing(this.nowS);
      const received = this.world.advance(Math.min(left, 20), bytes, true, Math.min(least, left));
      this.take(this.engine.receive(this.pull ? new Uint8Array(0) : received, this.nowS));
      this.resume();
    }
  }

  take({ batches, events, statuses }) {
    for (const event of events) this.event(event);
    for (const batch of batches) {
      this.arrivedTick = this.world.tick;
      this.recorder?.log.writeTicks(batch);
      this.recent.push(batch);
      while (this.recent[0].tick <= batch.tick - REST_TICKS) this.recent.shift();
      this.flight?.take?.(batch);
      this.tell.rows(batch);
    }
    if (statuses.length) this.recorder?.log.writeLink(statuses.at(-1).tick, this.engine.counters());
  }

  event({ tick, kind, text, message }) {
    if (kind === "board_restarted") {
      [this.target, this.recent, this.atRest] = [null, [], null];
      this.tell.cleared();
      this.start(this.readParameters());
    }
    this.laws.take({ kind, message });
    if (kind === "state") this.cause = nameOf("trigger", message.cause).replaceAll("_", " ");
    this.recorder?.log.writeEvent(tick, kind, text, URGENT[kind] ?? 2);
    this.flight?.event?.({ kind, text, message });
    this.show(tick, kind, text);
  }

  show(tick, kind, text) {
    const entry = { t_s: +(tick * 1e-3).toFixed(3), kind, text };
    this.events = [...this.events.slice(-199), entry];
    this.tell.words({ event: entry });
  }

  announce(kind, text) {
    this.recorder?.log.writeEvent(this.tick, kind, text);
    this.show(this.tick, kind, text);
  }

  // Runs a generator; it yields {until, forS} to wait. `settle` gets its result, or the error.
  start(generator, settle = () => {}) {
    const task = { generator, settle, until: () => true, deadlineS: Infinity };
    this.tasks.push(task);
    this.resumeTask(task);
  }

  resume() { for (const task of [...this.tasks]) this.resumeTask(task); }

  resumeTask(task) {
    try {
      for (let fulfilled = task.until(); fulfilled || this.nowS >= task.deadlineS; fulfilled = task.until()) {
        const { value, done } = task.generator.next(fulfilled);
        if (done) {
          this.tasks = this.tasks.filter((other) => other !== task);
          return task.settle(value ?? {});
        }
        Object.assign(task, { until: value.until ?? (() => false), deadlineS: this.nowS + (value.forS ?? Infinity) });
      }
    } catch (error) {
      this.tasks = this.tasks.filter((other) => other !== task);
      if (!(error instanceof HeliError)) throw error;
      task.settle({ error: error.cause, remedy: error.remedy });
    }
  }

  *connect() {
    yield { until: () => this.engine.isOpen || this.engine.mismatch };
    if (this.engine.mismatch) throw this.engine.mismatch;
    yield* this.readParameters();
    yield { until: () => this.engine.newest };
  }

  // Sends a command and waits for its answer. `stops`: a command that starts motors is refused after a later stop.
  *command(name, fields = {}, stops = null) {
    yield { until: () => !this.engine.request || this.engine.request.done };
    if (stops !== null && stops !== this.stops) throw new HeliError("a stop cancelled this command", "send the command again");
    const request = this.engine.ask(name, fields, this.nowS);
    yield { until: () => request.done };
    if (request.error) throw request.error;
    const { name: kind, message } = request.reply;
    if (kind === "ack" && message.result !== NAMES.result.ok) throw this.refusal(name, message);
    return request.reply;
  }

  refusal(name, { result, detail, value }) {
    const head = `the board refused ${name}: `, fault = FAULTS[detail];
    if (result === NAMES.result.bad_state) return new HeliError(`${head}not allowed in state ${nameOf("state", detail)}`, STATE_REMEDIES[nameOf("state", detail)] ?? "land first, or stop the motors");
    if (result === NAMES.result.check_failed && fault) return new HeliError(`${head}${fault.name}: ${fault.meaning}${fault.parameter ? ` (limit: ${fault.parameter}, now ${+value.toPrecision(4)})` : ""}`, fault.remedy);
    const spec = this.facts.hello.parameters[detail];
    if (result === NAMES.result.out_of_range && spec) return new HeliError(`${head}${spec.name} is out of its range`, `give ${spec.valid_values}`);
    if (result === NAMES.result.unsafe_now && spec) return new HeliError(`${head}${spec.name} can be changed only while idle`, "land first");
    return new HeliError(`${head}${nameOf("result", result)}`, "see docs/reference/link.md");
  }

  *readParameters() {
    const specs = this.facts.hello.parameters, values = [];
    while (values.length < specs.length) {
      const { message, payload } = yield* this.command("params_read", { first: values.length });
      const view = new DataView(payload.buffer, payload.byteOffset + payload.length - 4 * message.count);
      for (let i = 0; i < message.count; i++) values.push(shortest(view.getFloat32(4 * i, true)));
    }
    this.params = Object.fromEntries(specs.map(({ name }, i) => [name, values[i]]));
    this.tellValues();
  }

  // Angle of a count of an encoder [rad].
  radPerCount(axis) { return (2 * Math.PI) / Math.abs(this.params[`${axis}_counts_per_rev`]); }

  channels() {
    return this.facts.hello.channels.map((row) => {
      const axis = AXES.find((name) => row.name === `${name}_rad`);
      return { ...row, scale: axis ? this.radPerCount(axis) : row.scale, signal: this.signals[row.name] ?? "" };
    });
  }

  // Names the channels that hold the signals of a law, also in the log.
  nameSignals({ name, hash, signals }) {
    this.signals = Object.fromEntries(signals.map((signal, i) => [`signal_${i + 1}`, signal]));
    this.announce("law_signals", `law ${name} (${hash.toString(16).padStart(8, "0")}); its signals: ${signals.join(", ") || "none"}`);
    if (this.recorder) this.recorder.law = { ...this.signals, law: name };
    this.tell.words({ channels: this.channels() });
  }

  limitsDeg() {
    const p = this.params, inside = (name) => p[name] - SETPOINT_MARGIN_DEG[name];
    const [pitch, travel] = [p.pitch_setpoint_max_deg, inside("travel_max_deg")];
    return { elevation: [inside("elevation_rest_deg"), inside("elevation_max_deg")], pitch: [-pitch, pitch], travel: [-travel, travel] };
  }

  tellValues() { this.tell.words({ values: this.params, undo: this.undo.length, limits_deg: this.limitsDeg(), channels: this.channels() }); }

  anglesDeg(suffix = "count") { return AXES.map((axis) => this.engine.newest[CHANNEL[`${axis}_count`]] * this.radPerCount(axis) * DEG); }

  // Device time now: samples arrive late by what the line takes.
  get deviceTick() { return this.tick + Math.min(this.world.tick - this.arrivedTick, 250); }

  targetHere() {
    const limits = this.limitsDeg(), deg = this.anglesDeg(), within = (i) => Math.min(Math.max(deg[i], limits[AXES[i]][0]), limits[AXES[i]][1]) / DEG;
    return { apply_tick: this.deviceTick >>> 0, elevation_rad: within(0), pitch_rad: 0, travel_rad: within(2) };
  }

  sendTarget(target) {
    this.target = target;
    this.engine.stream(target);
    this.engine.kept = target;
  }

  forgetTarget() { [this.target, this.engine.kept] = [null, null]; }

  checkSetpoint(deg) {
    for (const [axis, value] of Object.entries(deg)) {
      const [low, high] = this.limitsDeg()[axis];
      if (!Number.isFinite(value)) throw new HeliError(`${axis}_deg is not a number`, "give a number");
      if (value < low || value > high) throw new HeliError(`${axis} setpoint of ${value} degrees is outside the board's limits`, `give ${+low.toPrecision(6)} to ${+high.toPrecision(6)} degrees`);
    }
  }

  setpoint(deg) {
    this.checkSetpoint(deg);
    if (!["closed_loop", "hold"].includes(this.state)) throw new HeliError(`the board is ${this.state}, and does not follow setpoints`, "take off first");
    const target = { ...(this.target ?? this.targetHere()), apply_tick: (this.deviceTick + SETPOINT_LEAD_TICKS) >>> 0 };
    for (const [axis, value] of Object.entries(deg)) target[`${axis}_rad`] = value / DEG;
    this.sendTarget(target);
  }

  stop() {
    this.stops++;
    this.forgetTarget();
    this.engine.preempt(this.nowS);
  }

  // Waits until telemetry shows a state, or until a fault or a stop comes instead.
  *waitFor(state, stops) {
    const isReached = yield { until: () => this.state === state || this.state === "fault" || stops !== this.stops, forS: 2 };
    if (!isReached) throw new HeliError(`telemetry does not show the state ${state}`, "check the link, then try again");
  }

  // Angles of the newest samples of an axis [deg].
  recentDeg(axis) { return this.recent.flatMap(({ raw }) => this.batchDeg(axis, raw)); }

  batchDeg(axis, raw) {
    const deg = this.radPerCount(axis) * DEG;
    return Array.from(raw[CHANNEL[`${axis}_count`]], (count) => count * deg);
  }

  *arm(stops) {
    const atRest = new RestAngles(this.recentDeg("elevation"), this.recentDeg("pitch"), this.radPerCount("pitch") * DEG);
    yield* this.command("arm", {}, stops);
    this.atRest = atRest;
    yield* this.waitFor("armed", stops);
  }

  *control(mask, stops) {
    yield* this.command("control", { axes: mask, front_V: 0, back_V: 0 }, stops);
    this.sendTarget(this.targetHere());
    yield* this.waitFor("closed_loop", stops);
  }

  *takeOff(elevationDeg) {
    this.checkSetpoint({ elevation: elevationDeg });
    const stops = this.stops;
    [this.doing] = ["taking off"];
    try {
      if (this.state === "idle") yield* this.arm(stops);
      yield* this.control(7, stops);
      this.setpoint({ elevation: elevationDeg });
      const limitS = Math.abs(elevationDeg - this.anglesDeg()[0]) / this.params.elevation_slew_deg_s + 20;
      let nearMs = -1;
      const isThere = () => {
        const isNear = Math.abs(this.anglesDeg()[0] - elevationDeg) <= 2;
        nearMs = !isNear ? -1 : nearMs < 0 ? this.tick : nearMs;
        return (nearMs >= 0 && this.tick - nearMs >= 300) || DOWN.includes(this.state);
      };
      if (!(yield { until: isThere, forS: limitS })) throw new HeliError("the elevation was not reached in time", "land, then check gains and rig");
      if (this.state === "fault") throw new HeliError(`the board switched the motors off: ${faultText(this.engine.newest[CHANNEL.fault])}`, "clear the fault");
      if (this.state === "closed_loop") yield* this.laws.engage();
    } finally {
      this.doing = "";
    }
  }

  *land() {
    if (this.state === "idle") return;
    this.forgetTarget();
    yield* this.command("land");
  }

  *set(name, value) {
    const index = this.facts.hello.parameters.findIndex((spec) => spec.name === name), before = this.params[name];
    if (index < 0) throw new HeliError(`unknown parameter ${name}`, "choose a name from the list");
    const spec = this.facts.hello.parameters[index];
    if (!Number.isFinite(value) || value < spec.min || value > spec.max) throw new HeliError(`${name} = ${value} is out of range`, `give ${spec.valid_values}`);
    const { message } = yield* this.command("param_set", { index, value });
    this.params[name] = shortest(message.value);
    return before;
  }

  *setParameter(name, value) {
    const before = yield* this.set(name, value);
    this.undo = [...this.undo, [name, before]].slice(-50);
    this.announce("parameter", `${name}: ${before} -> ${this.params[name]}`);
    this.tellValues();
    return { value: this.params[name] };
  }

  *undoLast() {
    if (!this.undo.length) throw new HeliError("this page has not changed any parameter", "change a parameter first");
    const [name, before] = this.undo.at(-1);
    yield* this.set(name, before);
    this.undo.pop();
    this.announce("parameter", `${name}: back to ${before}`);
    this.tellValues();
    return { name, value: before };
  }

  *save() { return { generation: (yield* this.command("params_save")).message.value }; }

  // ------------------------------------------------------------------ flights of plans

  *fly(names) {
    const known = this.facts.plans, plans = names.map((name) => known.find((plan) => plan.name === name));
    const unknown = names.find((_, i) => !plans[i]);
    if (unknown !== undefined || !plans.length) throw new HeliError(`unknown plan ${String(unknown).slice(0, 40)}`, `choose from ${known.map(({ name }) => name).join(", ")}`);
    if (this.state !== "idle") throw new HeliError("a plan starts only from the table, with the motors off", "land first");
    const route = takeOffRoute(plans, this.anglesDeg()), begins = this.recorder === null;
    if (begins) this.record(plans);
    const flight = (this.flight = new PlanFlight(this, plans, route));
    this.doing = `flying ${names.join(", ")}`;
    try {
      yield* flight.fly();
    } finally {
      [this.flight, this.doing] = [null, ""];
      if (begins) this.endRecording(flight.outcome);
    }
    return { outcome: flight.outcome };
  }

  // ------------------------------------------------------------------ logs

  record(plans = []) {
    const now = Date.now(), start = new Date(now), log = new LogWriter(this.facts.log, now, AXES.map((axis) => this.radPerCount(axis)));
    const stamp = start.toISOString().replace(/[:T]/g, "-").slice(0, 19), welcome = this.engine.welcome, session = this.setup.session ?? {};
    const version = (...parts) => parts.join("."), text = (values) => Object.fromEntries(Object.entries(values).map(([name, value]) => [name, String(value)]));
    this.recorder = { log, name: `heli-${stamp}.mcap`, parameters: { ...this.params } };
    const plain = {
      rig: session.rig ?? "", controller: "default", url: session.url ?? "", boot_id: welcome.boot_id,
    };
    log.writeMetadata("session", text({
      ...(session.sealed ? { sealed: session.sealed } : plain), board: session.board ?? "", axes: plans.length ? closedAxes(plans).join(" ") : "",
      firmware: version(welcome.firmware_major, welcome.firmware_minor, welcome.firmware_patch), link: version(welcome.link_major, welcome.link_minor),
      link_hash: welcome.link_hash.toString(16).padStart(8, "0"), host: this.facts.version, host_link: LINK.version, host_link_hash: LINK.hash.toString(16).padStart(8, "0"),
      start: start.toISOString(), reset: nameOf("reset", welcome.reset), params_source: nameOf("params_source", welcome.params_source ?? 0), boot_fault: welcome.boot_fault ? faultText(welcome.boot_fault) : "",
    }));
    log.writeMetadata("parameters", text(this.params));
    log.writeMetadata("plan", Object.fromEntries(plans.map(({ name, text: toml }, i) => [plans.findIndex((plan) => plan.name === name) === i ? name : `${name} (${i + 1})`, toml])));
    this.tell.words({ recording: this.recorder.name });
  }

  endRecording(outcome = "recorded") {
    if (!this.recorder) return;
    const { log, name, parameters, law } = this.recorder, counters = this.engine.counters();
    const changed = Object.fromEntries(Object.entries(this.params).filter(([key, value]) => parameters[key] !== value).map(([key, value]) => [key, String(value)]));
    const file = log.close({
      counters: Object.fromEntries(Object.entries(counters).map(([key, value]) => [key, String(value)])),
      result: { outcome, ticks_logged: String(log.ticks), ticks_lost: String(log.lost), ticks_dropped: "0", events_logged: String(log.events) },
      ...(Object.keys(changed).length ? { parameters_changed: changed } : {}),
      ...(law ? { law } : {}),
    });
    this.recorder = null;
    this.tell.log(name, file, log.ticks);
    this.tell.words({ recorded: name });
  }

  mark(text) {
    const words = text || `mark ${++this.marks}`;
    this.announce("mark", words);
    return { logged: this.recorder !== null };
  }

  status() {
    const newest = this.engine.newest, counters = this.engine.counters();
    return {
      state: newest ? newest[CHANNEL.state] : -1, fault: newest ? newest[CHANNEL.fault] : 0, cause: this.cause, connected: this.engine.isOpen,
      link: { frames: counters.frames_ok, bad: counters.frames_bad, lost_ticks: counters.ticks_lost, ticks: counters.ticks_received, retries: counters.retries, reconnects: counters.reconnects, latency_ms: +(1e3 * this.engine.roundTripS).toFixed(1), jitter_ms: null },
      recording: this.recorder?.name ?? null, trouble: "", doing: this.doing, flight: this.flight?.progress ?? null, twin: null, law: this.laws.status(),
    };
  }
}

// One flight of plans: every way in which it ends leads to a landing. See heli_host.fly.pilot.
class PlanFlight {
  constructor(host, plans, route) {
    Object.assign(this, { host, plans, route, outcome: "not flown", streaming: false, startTick: 0, sentTick: 0, endedBy: "", fault: "", hears: false, wasClosed: false, handedOver: false, takeover: "" });
    this.axes = closedAxes(plans);
    this.tracking = new Tracking(plans, this.axes);
    this.progress = { phase: "take-off", t_s: 0, left_s: +route.durationS.toFixed(1) };
    this.ends = [...route.pieces];
    this.phases = route.pieces.filter((piece, i) => !i || route.pieces[i - 1].phase !== piece.phase);
    this.takenOffMs = Math.round(1e3 * (this.phases.find(({ phase }) => phase !== "take-off")?.startS ?? route.durationS));
    this.excitations = route.pieces.filter(({ excitation }) => excitation);
  }

  get tS() { return (this.host.tick - this.startTick) * 1e-3; }

  event({ kind, text, message }) {
    const end = takeover({ kind, message });
    if (end && !this.takeover) this.takeover = `law_taken_over: ${end[0]} (${end[1]}), ${((message.tick - this.engagedTick) * 1e-3).toFixed(1)} s after the uploaded law began; the board's own law flew the rest`;
    if (kind === "law_engaged") this.engagedTick = message.tick;
    if (kind === "fault" && this.hears && !this.fault) this.fault = `fault ${faultText(message.detail)}`;
    if (kind !== "state" || !this.hears || this.endedBy || message.cause === NAMES.trigger.touchdown) return;
    this.endedBy = FLYING.includes(nameOf("state", message.detail)) ? "" : text;
  }

  // Samples: judges the tracking, and streams the setpoint that is due.
  take({ tick, raw }) {
    const { host } = this, count = raw[0].length;
    host.atRest?.hover.take(tick + count - 1, IN_THE_AIR.includes(nameOf("state", raw[CHANNEL.state][count - 1])), () => host.batchDeg("pitch", raw));
    if (this.landed) for (const axis of ["elevation", "pitch"]) this.landed[axis].push(...host.batchDeg(axis, raw));
    if (!this.streaming) return;
    const counts = AXES.map((axis) => raw[CHANNEL[`${axis}_count`]]), goals = AXES.map((axis) => raw[CHANNEL[`${axis}_setpoint`]]), states = raw[CHANNEL.state];
    const angleScale = AXES.map((axis) => host.radPerCount(axis) * DEG), goalScale = AXES.map((axis) => CHANNELS[CHANNEL[`${axis}_setpoint`]][3] * DEG);
    const angleDeg = (axis, i) => counts[axis][i] * angleScale[axis], goalDeg = (axis, i) => goals[axis][i] * goalScale[axis];
    const errors = [0, 0, 0]; // one array for all ticks: garbage of each tick slowed a fast simulation
    for (let i = 0; i < count; i++) {
      const isFlown = states[i] === NAMES.state.closed_loop && tick + i >= this.startTick + this.takenOffMs;
      for (let axis = 0; axis < 3; axis++) errors[axis] = Math.abs(angleDeg(axis, i) - goalDeg(axis, i));
      this.tracking.take(errors, isFlown);
    }
    const now = tick + count - 1, last = count - 1;
    while (this.ends.length && now >= this.startTick + Math.round(1e3 * (this.ends[0].startS + this.ends[0].durationS))) {
      const piece = this.ends.shift();
      if (states[last] === NAMES.state.closed_loop) this.tracking.takeEnd(piece, AXES.map((_, axis) => angleDeg(axis, last)), AXES.map((_, axis) => goalDeg(axis, last)), !this.ends.length);
    }
    while (this.phases.length && now >= this.startTick + Math.round(1e3 * this.phases[0].startS)) {
      const piece = this.phases.shift();
      host.recorder?.log.writeEvent(this.startTick + Math.round(1e3 * piece.startS), "phase", piece.phase);
    }
    if (now >= this.sentTick + INTERVAL_TICKS) this.sendSetpoint(now);
  }

  sendSetpoint(tick) {
    const at = tick + Math.min(Math.max(LEAD_TICKS, tick - this.sentTick + INTERVAL_TICKS), LONGEST_LEAD_TICKS);
    const [elevation, pitch, travel] = this.route.evaluate((at - this.startTick) * 1e-3);
    this.sentTick = tick;
    this.host.sendTarget({ apply_tick: at >>> 0, elevation_rad: elevation / DEG, pitch_rad: pitch / DEG, travel_rad: travel / DEG });
  }

  mustEnd() {
    const { state } = this.host;
    this.wasClosed ||= state === "closed_loop";
    return state !== null && !(this.wasClosed ? ["closed_loop", "hold"] : ["closed_loop", "armed"]).includes(state);
  }

  *whyDown() {
    const { host } = this;
    if (["fault", "emergency_landing"].includes(host.state)) return `fault ${faultText(host.engine.newest[CHANNEL.fault])}`;
    yield { until: () => this.endedBy, forS: 0.05 };
    const reason = this.endedBy || stateText(host.engine.newest[CHANNEL.state], host.engine.newest[CHANNEL.trigger]), head = `state ${host.state}, `;
    return `the board went to state ${host.state}${reason.startsWith(head) ? `, ${reason.slice(head.length)}` : ` (${reason})`}`;
  }

  *check() {
    const restarted = this.host.engine.restarts !== this.restarts;
    if (restarted) throw new HeliError("the board restarted in flight, motors off", "check its supply and the log's last events");
    if (this.mustEnd() || (!this.wasClosed && this.tS > 2)) throw new HeliError(yield* this.whyDown(), "");
  }

  *fly() {
    const { host } = this, stops = host.stops;
    this.restarts = host.engine.restarts;
    try {
      const from = host.tick;
      yield { until: () => host.tick >= from + BEFORE_TICKS };
      this.hears = true;
      yield* host.arm(stops);
      yield* host.control(this.axes.reduce((mask, axis) => mask | NAMES.axes[axis], 0), stops);
      [this.startTick, this.sentTick, this.streaming] = [host.tick, host.tick - INTERVAL_TICKS, true];
      const endTick = this.startTick + Math.round(1e3 * this.route.durationS);
      while (host.tick < endTick) {
        yield* this.check();
        if (!this.handedOver && host.tick >= this.startTick + this.takenOffMs) {
          this.handedOver = true;
          yield* host.laws.engage();
        }
        yield* this.exciteIfDue(stops);
        const piece = this.route.pieceAt(this.tS);
        this.progress = { phase: piece?.phase ?? "landing", t_s: +this.tS.toFixed(1), left_s: +Math.max(this.route.durationS - this.tS, 0).toFixed(1) };
        const next = this.excitations.length ? this.startTick + Math.round(1e3 * this.excitations[0].startS) : endTick;
        yield { until: () => host.tick >= Math.min(endTick, next) || this.mustEnd(), forS: 0.05 };
      }
      yield* this.check();
      this.outcome = this.takeover || this.tracking.verdict() || "completed";
    } catch (error) {
      if (!(error instanceof HeliError)) throw error;
      this.outcome = `aborted: ${error.cause}${error.remedy ? `; ${error.remedy}` : ""}`;
    }
    this.streaming = false;
    yield* this.comeDown();
    if (this.fault && !this.outcome.includes(this.fault.split(":")[0])) this.outcome = this.outcome === "completed" ? `aborted: ${this.fault}` : `aborted: ${this.fault}; ${this.outcome.replace("aborted: ", "")}`;
  }

  *exciteIfDue(stops) {
    while (this.excitations.length && this.host.tick >= this.startTick + Math.round(1e3 * this.excitations[0].startS)) {
      const e = this.excitations.shift().excitation;
      yield* this.host.command("excite", { kind: NAMES.excitation[e.signal], front_V: e.front_V ?? 0, back_V: e.back_V ?? 0, start_Hz: e.start_Hz ?? 0, stop_Hz: e.stop_Hz ?? 0, duration_s: e.duration_s, seed: e.seed ?? 1 }, stops);
    }
  }

  // Lands if the motors run, and records the arm at rest.
  *comeDown() {
    const { host } = this, limitS = 3 * host.params.landing_timeout_s, startS = host.nowS;
    let isMarked = false;
    while (!DOWN.includes(host.state) && host.engine.restarts === this.restarts && host.nowS - startS < limitS) {
      if (!isMarked) host.recorder?.log.writeEvent(host.tick, "phase", "landing");
      isMarked = true;
      this.progress = { phase: "landing", t_s: +this.tS.toFixed(1), left_s: null };
      const { state } = host;
      if (!["landing", "emergency_landing"].includes(state)) {
        host.forgetTarget();
        try {
          yield* host.command(state === "armed" ? "stop" : "land");
        } catch (error) {
          if (!(error instanceof HeliError)) throw error;
        }
      }
      yield { until: () => host.state !== state, forS: 0.1 };
    }
    const from = host.tick;
    this.landed = { elevation: [], pitch: [] };
    yield { until: () => host.tick >= from + AFTER_TICKS || host.engine.restarts !== this.restarts, forS: 2 };
    const shift = yield* this.shiftAtRest();
    if (shift) this.outcome = this.outcome === "completed" ? shift : `${this.outcome}; ${shift}`;
  }

  // The axes whose angles at rest differ from those before the take-off; empty if none does.
  *shiftAtRest() {
    const { host } = this, before = host.atRest, cause = nameOf("trigger", host.engine.newest?.[CHANNEL.trigger]);
    host.atRest = null;
    let shift = before && LANDED_BY.includes(cause) ? null : "";
    while (shift === null && host.state === "idle" && host.engine.restarts === this.restarts) {
      shift = before.shiftAfter(this.landed.elevation, this.landed.pitch);
      if (shift === null) yield { forS: AFTER_TICKS * 1e-3 };
    }
    return shift;
  }
}
