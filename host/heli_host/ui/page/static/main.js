// Puts the page together: what comes goes into the history; what is shown is drawn from it, at its own pace.
import { Controls } from "./controls.js";
import { History } from "./history.js";
import { Gamepad, listenForArrows, listenForStop } from "./keys.js";
import { Link, Stop } from "./link.js";
import { Scene } from "./scene.js";
import { Strips } from "./strips.js";

const $ = (id) => document.getElementById(id);
const DEG = 180 / Math.PI;
const AXES = ["elevation", "pitch", "travel"];
const KINDS = { closed_loop: "fly", open_loop: "warn", streamed: "warn", armed: "warn", hold: "warn", landing: "warn", fault: "bad", emergency_landing: "bad" };
const OFF = ["idle", "fault"];
const WORDS_MS = 120;
const TITLES = { simulation: "SIMULATION", real: "REAL", replay: "REPLAY" };
const CONFIRM_MS = 1500; // a stop that the board does not confirm within this time is an alarm
const CONFIRMED_MS = 60000; // as long a confirmed stop is shown
const CAUSED = ["idle", "hold", "landing", "emergency_landing"]; // states whose cause the operator wants to know
const STALE_MS = 600; // a status is due every 200 ms, a frame every 80 ms

let hello = null, history = null, strips = null, scene = null, status = null, wordsMs = 0;
let statusMs = 0, stale = true, lost = false; // when the status that is shown came, by the clock of the socket's thread
let stopMs = null, confirmed = false; // when this page sent a stop, and whether the board has confirmed it
let frameState = null, frameMs = -Infinity, beatMs = -Infinity; // the state that the newest frame carries, by number

function say(words, bad = false) {
  $("message").textContent = words;
  $("message").className = bad ? "bad" : "";
}

// Only what changes: a screen reader would read the same words ten times a second.
function put(id, words) { if ($(id).textContent !== words) $(id).textContent = words; }

function alarm(words) {
  $("alarm").hidden = !words;
  put("alarm", words);
}

const stop = new Stop((answer) => {
  const good = answer === "stopped";
  if (hello?.mode === "replay") return say(good ? "the replay is paused" : answer, !good);
  say(good ? "stop sent to the board" : answer, !good);
});
const link = new Link({
  onOpen: (cameMs) => { statusMs = cameMs; },
  onClosed: () => {
    if (!lost) alarm(KINDS[name()] ? "The server does not answer. The board gets no setpoints from this page, and lands by itself. Reconnecting …" : "The server does not answer. Reconnecting …");
    [lost, stale, frameState] = [true, true, null];
  },
  onBeat: (nowMs) => {
    beatMs = performance.now();
    if (link.isOpen && nowMs - statusMs > STALE_MS) showStale();
    gamepad.poll(beatMs);
    showStop(beatMs);
  },
  // With the rows, not with what is drawn: a stop must not wait for a slow or hidden picture.
  onRows: (frame) => {
    [frameState, frameMs] = [frame.state, performance.now()];
    history?.append(frame);
    gamepad.poll(performance.now());
  },
  onWords: (words, cameMs) => take(words, cameMs),
});
const controls = new Controls(link, say);

function nameOf(state) { return hello?.states[state]?.name ?? ""; }

// The state that is shown: of the status, or of the newest frame where the status is old; empty when unknown.
function name() { return nameOf(stale ? frameState : status?.state); }

// Whether the motors are off for certain: by a status and a frame, neither of them old. Otherwise they may run.
function surelyOff() {
  if (hello?.mode === "replay") return true;
  const nowMs = performance.now(), fresh = !stale && nowMs - beatMs < STALE_MS && nowMs - frameMs < STALE_MS;
  return fresh && status.connected && OFF.includes(name()) && OFF.includes(nameOf(frameState));
}

function showStale() {
  stale = true;
  alarm("The server no longer sends its status. Space and Esc stop the motors, even in a text field.");
  put("state", name().replace("_", " ") || "unknown");
  $("state").dataset.kind = "bad";
  put("words", name() ? "The state shown is that of the newest samples." : "No samples arrive either.");
  if (status && name()) controls.show({ ...status, state: frameState });
}

function stopNow() {
  stop.now();
  if (hello?.mode === "replay") return;
  [stopMs, confirmed] = [performance.now(), false];
  showStop(stopMs);
}

// A stop is confirmed by the board's own telemetry, never by the sending alone. It is shown until the motors run again.
function showStop(nowMs) {
  if (stopMs === null) return;
  const sinceMs = nowMs - stopMs, runs = !stale && name() !== "" && !OFF.includes(name());
  if (!confirmed) confirmed = sinceMs > 100 && surelyOff();
  else if (runs || sinceMs > CONFIRMED_MS) stopMs = null;
  $("stopped").hidden = stopMs === null;
  const kind = confirmed ? "good" : sinceMs > CONFIRM_MS ? "bad" : "sent";
  $("stopped").dataset.kind = kind;
  put("stopped", { good: "STOPPED. The board confirms that both motors are off.", sent: "Stop sent. Waiting for the board …",
    bad: "The board does not confirm the stop. Use the rig's own stop switch." }[kind]);
}

function take(words, cameMs) {
  if (words.hello) greet(words.hello);
  if (words.values) controls.values(words);
  if (words.channels) { history.channels.forEach((spec, i) => Object.assign(spec, words.channels[i])); strips?.rename(); }
  if (words.event) controls.event(words.event);
  if (words.signal) strips?.signal(words.signal.name, words.signal.tick, words.signal.value);
  if (words.recorded) controls.recorded = `recorded ${words.recorded}`;
  if (words.status) {
    showStatus(words.status);
    // Only what is shown counts: a status at which this page fails is followed by the alarm.
    [statusMs, stale, lost] = [cameMs, false, false];
    alarm("");
  }
  if (words.control) controls.showControl(words.control);
}

function greet(news) {
  hello = news;
  document.title = `${TITLES[news.kind]} ${news.rig_name} – heli-lab`;
  $("badge").dataset.kind = news.kind;
  put("kind", TITLES[news.kind]);
  put("rig-name", news.rig_name || "rig without a name");
  $("board").textContent = news.board;
  history = new History(news.channels);
  strips = new Strips($("strips"), history, news.tick_s);
  strips.onView = showView;
  scene ??= new Scene($("scene"), news.rig);
  $("numbers").tBodies[0].replaceChildren(...AXES.map((axis) => {
    const row = document.createElement("tr");
    for (const text of [axis, "–", "–"]) row.append(Object.assign(document.createElement("td"), { textContent: text }));
    return row;
  }));
  controls.greet(news);
}

function showStatus(news) {
  status = news;
  const state = hello.states[news.state], fault = hello.faults[news.fault];
  $("state").textContent = state ? state.name.replace("_", " ") : "–";
  $("state").dataset.kind = news.connected ? KINDS[state?.name] ?? "" : "bad";
  const replay = hello.mode === "replay", alarmed = Boolean(news.twin?.alarm);
  const twin = news.twin && !alarmed ? ` ${news.twin.words}` : "", cause = news.cause && CAUSED.includes(state?.name) ? ` Cause: ${news.cause}.` : "";
  const words = !news.connected ? "The board does not answer. It holds level, then lands by itself. Reconnecting …"
    : fault ? (replay ? `The log shows a fault: ${fault.meaning}.` : `${fault.meaning}: ${fault.remedy}.`) : (state?.words ?? "") + cause + twin;
  $("twin-alarm").hidden = !alarmed;
  if (alarmed) put("twin-alarm", `TWIN ALARM: the rig has changed. ${news.twin.words.replace("Twin: alarm", "Alarm")}`);
  put("words", words);
  controls.show(news);
}

function showView() {
  const paused = strips.view !== null;
  $("pause").setAttribute("aria-pressed", String(paused));
  $("pause").textContent = paused ? "Continue" : "Pause";
  for (const button of document.querySelectorAll("[data-span]")) button.setAttribute("aria-pressed", String(!paused && Number(button.dataset.span) === strips.spanS));
}

function angles(suffix) { return AXES.map((axis) => history.latest(history.channels.findIndex((one) => one.name === `${axis}${suffix}`))); }

function showNumbers(nowMs) {
  if (nowMs - wordsMs < WORDS_MS || !history.end) return;
  wordsMs = nowMs;
  const is = angles("_rad"), goal = angles("_setpoint_rad"), off = OFF.includes(name());
  [...$("numbers").tBodies[0].rows].forEach((row, i) => {
    row.cells[1].textContent = (is[i] * DEG).toFixed(1);
    row.cells[2].textContent = off ? "–" : (goal[i] * DEG).toFixed(1);
  });
  const [front, back] = ["front_V", "back_V"].map((one) => history.latest(history.channels.findIndex((spec) => spec.name === one)));
  $("volts").textContent = `front ${front.toFixed(2)} V, back ${back.toFixed(2)} V`;
  $("clock").textContent = `${(history.latestTick * hello.tick_s).toFixed(1)} s`;
  $("pace").textContent = history.gaps ? `${history.gaps} gaps` : history.thinned ? "this browser is slow, so some rows are skipped" : "every tick";
  if (hello.mode === "live") controls.follow(Object.fromEntries(AXES.map((axis, i) => [axis, goal[i] * DEG])));
}

const gamepad = new Gamepad(stopNow, (axis, by) => controls.move(axis, by));
listenForStop(stopNow, surelyOff);
listenForArrows((axis, by) => controls.move(axis, by), () => controls.mark());
$("pause").addEventListener("click", () => (strips.view === null ? strips.pause() : strips.follow()));
for (const button of document.querySelectorAll("[data-span]")) button.addEventListener("click", () => strips.follow(Number(button.dataset.span)));

function frame(nowMs) {
  requestAnimationFrame(frame);
  if (!history) return;
  showNumbers(nowMs);
  strips.draw(nowMs);
  if (history.end) scene.draw(nowMs, strips.intervalMs, angles("_rad"), angles("_setpoint_rad"), !["idle", "fault", "armed", ""].includes(name()), status?.twin?.ghost_rad ?? null);
}
requestAnimationFrame(frame);

// For tests and the curious: what this page holds, in the board's own numbers.
window.heliPage = { get history() { return history; }, get hello() { return hello; }, get status() { return status; }, get frameState() { return frameState; }, get strips() { return strips; } };
