// Takes the place of the dashboard's socket.js: speaks the same protocol, with board, rig and small host behind it
// instead of a server. See docs/reference/dashboard-protocol.md.
import { HeliError, nameOf, CHANNEL } from "./engine.js";
import { Host } from "./host.js";
import { Replay } from "./replay.js";
import { AXES, SettingsError, worldSetup } from "./settings.js";
import { WorldFactory } from "./world.js";

const LOOP_MS = 6, BUDGET_MS = 14, READ_MS = 10; // a stop waits for one of each at most
const FRAME_MS = 30, STATUS_MS = 100, PRESENCE_MS = 200;
const MAX_BEHIND_MS = 100; // more is not caught up: the page was suspended, or the computer is too slow
const MAX_ROWS = 1 << 16, MAX_UNSHOWN = 8, HUNG_MS = 3000;
const HEADER = 24, THINNED = 1, RESET = 2;
const YOU = "page";

let facts = null, factory = null, elf = null, settings = null;
let host = null, replay = null, reading = null, ready = false;
let pausedBy = new Set(), speed = 1, owed = 0, beforeMs = 0, paceMs = 0, paceTick = 0, pace = 0;
let rows = [], rowsReset = false, frameNumber = 0, shown = 0, shownMs = 0, frameMs = 0;
let statusText = "", statusMs = 0, epoch = 0;

const say = (words, more = {}, transfer = []) => postMessage({ words, cameMs: performance.now(), ...more }, transfer);
const tell = {
  words: (words) => { if (ready) say(words); },
  rows: (batch) => rows.push(batch),
  cleared: () => { [rows, rowsReset] = [[], true]; },
  log: (name, bytes, ticks) => say({}, { file: { name, bytes, ticks } }, [bytes.buffer]),
};

// ---------------------------------------------------------------- the page's requests

const number = (request, name) => {
  if (typeof request[name] !== "number" || !Number.isFinite(request[name])) throw new HeliError(`${name} is not a number`, "give a number");
  return request[name];
};
const targets = (request) => Object.fromEntries(["elevation_deg", "travel_deg"].filter((name) => name in request).map((name) => [name.replace("_deg", ""), number(request, name)]));
const simple = (run) => function* (request) { return run(request) ?? {}; };
const noPlan = () => { if (host.flight) throw new HeliError("a plan flies now, and controls the setpoints", "end it with Land"); };
const ACTIONS = {
  take_off: (request) => host.takeOff("elevation_deg" in request ? number(request, "elevation_deg") : 0),
  fly: (request) => host.fly(request.plans ?? []),
  land: () => host.land(),
  clear_fault: () => host.command("clear_fault"),
  zero: () => host.command("zero", { axes: 7 }),
  setpoint: simple((request) => { noPlan(); host.setpoint(targets(request)); }),
  hold: simple(() => { noPlan(); host.sendTarget(host.targetHere()); }),
  set: (request) => host.setParameter(String(request.name), number(request, "value")),
  law: (request) => host.laws.choose(String(request.name ?? "")),
  set_law: (request) => host.laws.set(String(request.name), number(request, "value")),
  undo: () => host.undoLast(),
  save: () => host.save(),
  record: simple((request) => {
    if (host.flight) throw new HeliError("a plan flies now, and is always recorded", "land first");
    if (request.on && !host.recorder) host.record();
    else if (!request.on) host.endRecording();
  }),
  mark: simple((request) => host.mark(String(request.text ?? "").trim().slice(0, 200))),
  stop: simple(() => stop()),
};

function request(text) {
  const { do: name, id, ...more } = JSON.parse(text);
  const answer = (result) => say({ answer: id, ...result });
  const actions = replay ? replay.actions : ACTIONS;
  if (!actions[name]) return answer({ error: `the page has no request ${name}`, remedy: "reload the page" });
  if (replay) return answer(actions[name](more));
  if (!ready) return answer({ error: "the board does not answer yet", remedy: "wait a moment" });
  try {
    host.start(actions[name](more), ({ name: kind, message, payload, ...result }) => answer(result));
  } catch (error) {
    answer({ error: String(error.message ?? error), remedy: "report it" });
  }
}

function stop() {
  if (replay) return replay.actions.play({ on: false });
  pausedBy.delete("you"); // a simulation that stands still would not show the stop
  host?.stop();
}

// ---------------------------------------------------------------- boards, rigs, faults

// Begins anew with other settings: rig, board, effect, seed.
function open(next) {
  const mine = ++epoch, { setup, name, board, session } = worldSetup(facts, next, elf);
  host?.endRecording("the settings were changed");
  [reading, ready, replay, settings, speed, pausedBy] = [null, false, null, next, next.speed, new Set([...pausedBy].filter((who) => who === "hidden"))];
  tell.cleared();
  host = new Host(factory.open(setup), facts, tell, { session });
  host.engine.permitted = () => performance.now() - shownMs < HUNG_MS;
  const opened = host;
  host.start(host.connect(), ({ error, remedy }) => {
    if (mine !== epoch) return;
    if (error) return say({ lab: { error: `${error}; ${remedy}` } });
    host.start(applyGains(next.gains), (result) => {
      if (host !== opened) return;
      ready = true;
      greet(name, board, setup);
      if (result.error) say({ lab: { error: `${result.error}; ${result.remedy}` } });
      if (next.plan) host.start(host.fly([next.plan]), (flown) => say({ lab: flown.error ? { error: `${flown.error}; ${flown.remedy}` } : { flown: flown.outcome } }));
    });
  });
}

function* applyGains(gains) {
  for (const [name, value] of Object.entries(gains)) yield* host.setParameter(name, value);
  host.undo = [];
}

function greet(name, board, setup) {
  const hello = {
    you: YOU, ...facts.hello, rig_name: name, board, rig: setup.drawing, faults: facts.faults,
    values: host.params, undo: 0, limits_deg: host.limitsDeg(), channels: host.channels(), events: host.events,
  };
  say({ hello, status: present(), ...lease(), lab: { settings, ready: true, setup: { parameters: setup.named } } });
}

function lease() { return { control: { pilot: YOU, pilot_name: "this page", present: true, asking: "", shared: false, clients: 1 } }; }

const LAB = {
  settings: (next) => open(next),
  speed: (value) => { speed = value; },
  pause: (on) => { if (on) pausedBy.add("you"); else pausedBy.delete("you"); },
  hidden: (on) => { if (on) pausedBy.add("hidden"); else pausedBy.delete("hidden"); },
  effect: (values) => {
    const { setup } = worldSetup(facts, { ...settings, values: { ...settings.values, ...values } }, elf);
    settings = { ...settings, values: { ...settings.values, ...values } };
    host.world.setParameters(setup.parameters);
    host.world.setDelay(setup.delay_s);
    for (const [name, value] of Object.entries(values)) if (!facts.puzzle) host.announce("effect", `${name}: ${value}`);
  },
  push: ({ axis, deg_s }) => {
    if (!host.world.push(AXES.indexOf(axis), (deg_s * Math.PI) / 180)) throw new HeliError("the arm rests, and does not yield to a push", "take off first");
    host.announce("rig", `${axis} is pushed: its rate changes by ${deg_s} deg/s`);
  },
  encoder: ({ axis, out }) => {
    host.world.board.set_encoder_out(AXES.indexOf(axis), out);
    host.announce("rig", `plug of the ${axis} encoder ${out ? "off" : "back"}`);
  },
  supply: (on) => { host.world.board.set_supply_on(on); host.announce("rig", `supply of the motors ${on ? "on" : "off"}`); },
  stop_switch: (pressed) => { host.world.board.set_stop(pressed); host.announce("rig", `stop switch ${pressed ? "pressed" : "released"}`); },
  cable: (cut) => {
    host.pull = cut;
    host.world.board.set_host_reading(!cut);
    host.world.board.unplug();
    host.take({ batches: [], statuses: [], events: [{ tick: host.tick, kind: cut ? "link_lost" : "cable", text: cut ? "the cable is cut" : "the cable is plugged in again" }] });
    if (cut) host.engine.cut(host.nowS);
  },
  reset: () => host.world.board.reset(),
  log: ({ name, bytes }) => { reading = { name, steps: Replay.read(name, new Uint8Array(bytes), facts) }; },
};

// Reads on in a log that was dropped. Once it is read, it takes the place of the simulation.
function readLog(nowMs) {
  try {
    let step = reading.steps.next();
    while (!step.done && performance.now() - nowMs < READ_MS) step = reading.steps.next();
    if (step.done) showReplay(reading.name, step.value);
  } catch (error) {
    reading = null;
    if (!(error instanceof HeliError)) throw error;
    say({ lab: { error: error.message } });
  }
}

function showReplay(name, opened) {
  host?.endRecording("a log was opened");
  [replay, host, ready, reading] = [opened, null, true, null];
  epoch++;
  tell.cleared();
  say({ hello: { you: YOU, ...replay.describe() }, status: present(), ...lease(), lab: { replay: name } });
}

// ---------------------------------------------------------------- time

function present() {
  const status = replay ? replay.status() : host.status();
  return { ...status, sent_s: +(performance.now() / 1000).toFixed(3) };
}

function pass(nowMs) {
  const passedMs = Math.min(nowMs - beforeMs, MAX_BEHIND_MS);
  beforeMs = nowMs;
  if (replay) return replay.pass(passedMs, tell);
  if (!host || pausedBy.size) return;
  owed = Math.min(owed + passedMs * speed, MAX_BEHIND_MS * speed);
  try {
    while (owed >= 1 && performance.now() - nowMs < BUDGET_MS) {
      const ticks = Math.min(20, Math.floor(owed));
      host.step(ticks);
      owed -= ticks;
    }
  } catch (error) {
    const words = error instanceof HeliError ? error.message : `the simulation ended: ${error.message}`;
    [host, ready] = [null, false];
    say({ lab: { error: `${words}; choose a rig or a board to begin again` } });
  }
}

// The rows since the last frame; where the page is too slow for all of them, every n-th.
function sendRows(nowMs) {
  if (nowMs - frameMs < FRAME_MS || frameNumber - shown >= MAX_UNSHOWN || !ready || (frameNumber > 0 && !rows.length)) return;
  frameMs = nowMs;
  const batches = rows, count = batches.reduce((sum, { raw }) => sum + raw[0].length, 0), step = Math.max(1, Math.ceil(count / MAX_ROWS));
  rows = [];
  const channels = Object.keys(CHANNEL).length, kept = Math.floor((count + step - 1) / step);
  const buffer = new ArrayBuffer(HEADER + 4 * kept * (1 + channels)), head = new DataView(buffer), newest = replay?.newest ?? host?.engine.newest;
  const ticks = new Uint32Array(buffer, HEADER, kept), raw = new Int32Array(buffer, HEADER + 4 * kept), first = batches[0]?.tick ?? 0;
  let row = 0, at = (step - 1) - ((step * kept - count) % step);
  if (step === 1) at = 0;
  for (const batch of batches) {
    const size = batch.raw[0].length;
    for (; at < size && row < kept; at += step, row++) {
      ticks[row] = (batch.ticks ? batch.ticks[at] : batch.tick + at) - first;
      for (let c = 0; c < channels; c++) raw[c * kept + row] = batch.raw[c][at];
    }
    at -= size;
  }
  head.setUint8(0, 1);
  head.setUint8(1, (step > 1 ? THINNED : 0) | (rowsReset ? RESET : 0));
  head.setUint16(2, channels, true);
  head.setUint32(4, ++frameNumber, true);
  head.setUint32(8, kept, true);
  head.setUint8(12, newest ? newest[CHANNEL.state] : 255);
  head.setUint8(13, newest ? newest[CHANNEL.fault] : 0);
  head.setFloat64(16, first, true);
  rowsReset = false;
  postMessage({ rows: buffer }, [buffer]);
}

function sendStatus(nowMs) {
  if (!ready || nowMs - statusMs < STATUS_MS) return;
  const { sent_s: sentS, link, ...status } = present(), text = JSON.stringify(status);
  if (text === statusText && nowMs - statusMs < PRESENCE_MS) return;
  [statusText, statusMs] = [text, nowMs];
  const tick = replay ? 0 : host.world.tick;
  if (nowMs - paceMs > 1000) [pace, paceMs, paceTick] = [(tick - paceTick) / (nowMs - paceMs), nowMs, tick];
  say({ status: { ...status, link, sent_s: sentS }, lab: { pace, paused: [...pausedBy], volts: host?.world.volts, tick } });
}

function loop() {
  const nowMs = performance.now();
  if (reading) readLog(nowMs);
  pass(performance.now());
  sendRows(nowMs);
  sendStatus(nowMs);
}

onmessage = ({ data }) => {
  if (data.facts) {
    [facts, elf] = [data.facts, data.elf];
    factory = new WorldFactory(new WebAssembly.Module(data.board));
    beforeMs = shownMs = performance.now();
    setInterval(loop, LOOP_MS);
    setInterval(() => postMessage({ nowMs: performance.now() }), 100);
    postMessage({ open: true, cameMs: performance.now() });
    open(data.settings);
  } else if (data.text) request(data.text);
  else if (data.stop) {
    stop();
    say({}, { stopped: true });
    frameMs = -Infinity; // what the stop does is shown at the first chance
    loop();
  } else if (data.lab) {
    try {
      for (const [name, value] of Object.entries(data.lab)) if (host || replay || name === "settings" || name === "log") LAB[name](value);
    } catch (error) {
      if (!(error instanceof SettingsError || error instanceof HeliError)) throw error;
      say({ lab: { error: error.message } });
    }
  } else if (data.shown !== undefined) [shown, shownMs] = [data.shown, performance.now()];
};
