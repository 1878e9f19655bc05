// The panel that only the page in a browser has: rig, board, effect, disturbances, faults, speed, logs.
import { AXES, defaultSettings, readAddress, SettingsError, writeAddress } from "./settings.js";

const $ = (id) => document.getElementById(id);
const BOARDS = { native: "native flight code", due: "emulated Due with the firmware file" };
const PUSHES_deg_s = { elevation: 15, pitch: 40, travel: 15 }; // large enough to be seen, small enough for the loops of the board
const LINK_MAX = 2000;

function element(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

function options(select, entries) { select.replaceChildren(...entries.map(([value, text]) => element("option", { value }, text))); }

// Puts the panel into the page; returns the settings of the address.
export function buildLab(facts, hasFirmware, tellWorker) {
  const panel = new Lab(facts, hasFirmware, tellWorker);
  return panel;
}

class Lab {
  constructor(facts, hasFirmware, tellWorker) {
    Object.assign(this, { facts, tellWorker, settings: defaultSettings(facts), logs: [] });
    options($("lab-rig"), facts.rigs.map(({ name }) => [name, name]));
    options($("lab-board"), Object.entries(BOARDS).filter(([name]) => name === "native" || hasFirmware));
    options($("lab-effect"), [["", "none"], ...facts.effects.map(({ id, sentence }) => [id, `${id}: ${sentence}`])]);
    $("lab-effects").hidden = Boolean(facts.puzzle);
    $("lab-puzzle").hidden = !facts.puzzle;
    this.pushesAndFaults();
    for (const id of ["lab-rig", "lab-board", "lab-effect", "lab-seed"]) $(id).addEventListener("change", () => this.choose());
    $("lab-speed").addEventListener("input", () => this.speed());
    $("lab-pause").addEventListener("click", () => this.tellWorker({ lab: { pause: $("lab-pause").getAttribute("aria-pressed") !== "true" } }));
    $("lab-reset").addEventListener("click", () => this.tellWorker({ lab: { reset: true } }));
    $("lab-again").addEventListener("click", () => this.open(this.settings));
    $("lab-link").addEventListener("click", () => this.copyAddress());
    $("lab-file").addEventListener("change", () => this.drop($("lab-file").files));
    document.addEventListener("dragover", (event) => event.preventDefault());
    document.addEventListener("drop", (event) => { event.preventDefault(); this.drop(event.dataTransfer.files); });
    document.addEventListener("visibilitychange", () => this.tellWorker({ lab: { hidden: document.hidden } }));
    window.addEventListener("hashchange", () => this.readAddress(true));
    this.hasFirmware = hasFirmware;
    this.readAddress(false);
  }

  say(words, bad = true) {
    $("lab-message").className = bad ? "hint bad" : "hint";
    $("lab-message").textContent = words;
  }

  readAddress(opens) {
    try {
      this.settings = readAddress(location.hash.slice(1), this.facts, this.hasFirmware);
      if (opens && location.hash.slice(1) === this.written) return;
      this.say("");
    } catch (error) {
      if (!(error instanceof SettingsError)) throw error;
      this.settings = defaultSettings(this.facts);
      this.say(`${error.message[0].toUpperCase()}${error.message.slice(1)}. The usual settings are used.`);
    }
    this.show();
    if (opens) this.open(this.settings);
  }

  show() {
    const { rig, board, effect, seed, speed } = this.settings;
    [$("lab-rig").value, $("lab-board").value, $("lab-effect").value, $("lab-seed").value] = [rig, board, effect, seed];
    $("lab-speed").value = Math.log(speed);
    $("lab-speed-value").textContent = `${+speed.toPrecision(2)} ×`;
    this.sliders();
  }

  choose() {
    const seed = Math.min(Math.max(Math.floor(Number($("lab-seed").value)) || 1, 1), 2 ** 32 - 1), effect = this.facts.puzzle ? this.settings.effect : $("lab-effect").value;
    this.open({ ...this.settings, rig: $("lab-rig").value, board: $("lab-board").value, effect, seed, values: effect === this.settings.effect ? this.settings.values : {}, plan: "" });
  }

  open(settings) {
    this.settings = settings;
    this.show();
    this.writeAddress();
    for (const button of document.querySelectorAll("[data-fault]")) button.setAttribute("aria-pressed", "false");
    this.tellWorker({ lab: { settings } });
  }

  writeAddress() {
    this.written = writeAddress(this.settings, this.facts);
    history.replaceState(null, "", `#${this.written}`);
  }

  async copyAddress() {
    const gains = window.heliPage.hello?.values ?? {}, defaults = Object.fromEntries((window.heliPage.hello?.parameters ?? []).map((spec) => [spec.name, spec.default]));
    const rigValues = this.started ?? defaults, changed = Object.entries(gains).filter(([name, value]) => value !== rigValues[name]);
    this.settings = { ...this.settings, gains: Object.fromEntries(changed) };
    this.writeAddress();
    const address = location.href;
    if (address.length > LINK_MAX) this.say("The address is long; some programs shorten it.");
    try {
      await navigator.clipboard.writeText(address);
      this.say("The address of this set-up is in the clipboard.", false);
    } catch {
      this.say("Copy the address from the address bar: it holds this set-up.", false);
    }
  }

  speed() {
    const speed = +Math.exp(Number($("lab-speed").value)).toPrecision(2);
    this.settings = { ...this.settings, speed };
    $("lab-speed-value").textContent = `${speed} ×`;
    this.tellWorker({ lab: { speed } });
    this.writeAddress();
  }

  sliders() {
    const effect = this.facts.puzzle ? null : this.facts.effects.find(({ id }) => id === this.settings.effect);
    $("lab-values").replaceChildren(...(effect?.parameters ?? []).map(({ name, unit, meaning, typical, low, high }) => {
      const value = this.settings.values[name] ?? typical, short = name.slice(effect.id.length + 1);
      const output = element("output", {}, `${+value.toPrecision(3)} ${unit}`), id = `lab-value-${short}`;
      const slider = element("input", { type: "range", min: low, max: high, step: (high - low) / 200, value, id });
      slider.addEventListener("input", () => {
        const chosen = +Number(slider.value).toPrecision(4);
        output.textContent = `${chosen} ${unit}`;
        this.settings = { ...this.settings, values: { ...this.settings.values, [name]: chosen } };
        this.tellWorker({ lab: { effect: { [name]: chosen } } });
        this.writeAddress();
      });
      return element("div", { className: "lab-slider" }, element("label", { htmlFor: id, title: name }, meaning), slider, output);
    }));
  }

  pushesAndFaults() {
    const toggle = (text, send) => {
      const button = element("button", { type: "button" }, text);
      button.dataset.fault = text;
      button.setAttribute("aria-pressed", "false");
      button.addEventListener("click", () => {
        const on = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(on));
        this.tellWorker({ lab: send(on) });
      });
      return button;
    };
    $("lab-pushes").replaceChildren(...AXES.map((axis) => {
      const button = element("button", { type: "button" }, `push ${axis}`);
      button.dataset.push = axis;
      button.addEventListener("click", () => this.tellWorker({ lab: { push: { axis, deg_s: PUSHES_deg_s[axis] } } }));
      return button;
    }));
    $("lab-faults").replaceChildren(
      ...AXES.map((axis) => toggle(`${axis} plug off`, (on) => ({ encoder: { axis, out: on } }))),
      toggle("motor supply off", (on) => ({ supply: !on })), toggle("cable cut", (on) => ({ cable: on })), toggle("stop switch pressed", (on) => ({ stop_switch: on })));
  }

  async drop(files) {
    const [file] = files;
    if (!file) return;
    try {
      const bytes = await file.arrayBuffer();
      this.say(`Reading ${file.name.slice(0, 60)} …`, false);
      this.tellWorker({ lab: { log: { name: file.name, bytes } } });
    } catch {
      this.say(`${file.name.slice(0, 60)} cannot be read; drop an .mcap file.`);
    }
  }

  // What the worker says of itself.
  take({ error, pace, paused, flown, ready, replay }) {
    if (error) this.say(error);
    if (flown) this.say(`The plan of the address: ${flown}.`, flown !== "completed");
    if (ready) this.started = { ...window.heliPage.hello?.values };
    if (replay !== undefined) {
      $("lab-replay").hidden = false;
      this.say("");
    }
    if (ready) $("lab-replay").hidden = true;
    if (paused) {
      const words = paused.includes("hidden") ? "The simulation paused while this page was hidden." : paused.length ? "The simulation is paused." : "";
      if ($("lab-paused").textContent !== words) $("lab-paused").textContent = words;
      $("lab-pause").setAttribute("aria-pressed", String(paused.includes("you")));
      $("lab-pause").textContent = paused.includes("you") ? "Continue simulation" : "Pause simulation";
    }
    if (pace !== undefined) {
      const slow = pace < 0.8 * this.settings.speed && !paused?.length, words = slow ? `This computer reaches ${pace.toFixed(1)} × real time.` : "";
      if ($("lab-pace").textContent !== words) $("lab-pace").textContent = words;
    }
  }

  log({ name, bytes, ticks }) {
    const link = element("a", { href: URL.createObjectURL(new Blob([bytes], { type: "application/octet-stream" })), download: name, className: "lab-save" }, `Save ${name}`);
    const row = element("li", {}, link, ` ${(ticks / 1000).toFixed(1)} s, ${(bytes.length / 1e6).toFixed(1)} MB`);
    $("lab-logs").prepend(row);
    this.logs.unshift(link);
    while (this.logs.length > 10) { URL.revokeObjectURL(this.logs.pop().href); $("lab-logs").lastChild.remove(); }
    $("lab-no-log").hidden = true;
  }
}
