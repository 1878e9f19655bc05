// The panel at the left: who flies, setpoints, plans, log, parameters, events, link.

const $ = (id) => document.getElementById(id);
const FLYING = new Set(["closed_loop", "hold"]);
const EVENTS_SHOWN = 200;
const SETPOINT_MS = 50;
const MOVED_MS = 3000; // as long the sliders show what was wished, then what the board has

function element(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

// Give controls their reason to be disabled, empty to enable them; return it for the line below them.
function block(controls, reason) {
  for (const control of controls) {
    control.disabled = Boolean(reason);
    control.title = reason;
  }
  return reason;
}

// One line below a group of controls: which of them are disabled, and why.
function explain(id, reasons) {
  const named = new Map();
  for (const [name, reason] of reasons) if (reason) named.set(reason, [...(named.get(reason) ?? []), name]);
  const words = [...named].map(([reason, names]) => `${names.join(", ")}: ${reason}.`).join(" ");
  if ($(id).textContent !== words) $(id).textContent = words;
}

export class Controls {
  constructor(link, say) {
    Object.assign(this, { link, say, hello: null, status: null, control: null, target: {}, setpointDeg: {}, movedMs: -Infinity, pending: null, sliders: {}, rows: new Map() });
    const press = (id, name, more = () => ({})) => $(id).addEventListener("click", () => this.ask(name, more()));
    press("take-off", "take_off");
    press("land", "land");
    press("hold", "hold");
    press("clear-fault", "clear_fault");
    press("record", "record", () => ({ on: !this.status?.recording }));
    press("undo", "undo");
    press("save", "save");
    $("mark").addEventListener("click", () => this.mark());
    $("mark-text").addEventListener("keydown", (event) => { if (event.key === "Enter") this.mark(); });
    $("filter").addEventListener("input", () => this.filter());
    $("play").addEventListener("click", () => this.ask("play", { on: !this.status?.playing }));
    for (const button of document.querySelectorAll("[data-speed]")) button.addEventListener("click", () => this.ask("play", { on: true, speed: Number(button.dataset.speed) }));
    $("seek").addEventListener("input", () => this.ask("seek", { t_s: Number($("seek").value) }));
    this.tabs();
    setInterval(() => this.flush(), SETPOINT_MS);
  }

  tabs() {
    const tabs = [...document.querySelectorAll('[role="tab"]')];
    const choose = (chosen) => {
      for (const tab of tabs) {
        const on = tab === chosen;
        tab.setAttribute("aria-selected", String(on));
        tab.tabIndex = on ? 0 : -1;
        $(tab.getAttribute("aria-controls")).hidden = !on;
      }
    };
    tabs.forEach((tab, index) => {
      tab.addEventListener("click", () => choose(tab));
      tab.addEventListener("keydown", (event) => {
        const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
        if (!by) return;
        event.preventDefault();
        const next = tabs[(index + by + tabs.length) % tabs.length];
        choose(next);
        next.focus();
      });
    });
  }

  async ask(name, more) {
    const answer = await this.link.ask(name, more);
    if (answer.error) this.say(`${answer.error}${answer.remedy ? `; ${answer.remedy}` : ""}`, true);
    else if (name === "save") this.say(`saved in the board's flash, generation ${answer.generation}`);
    else if (name === "undo") this.say(`${answer.name} is ${answer.value} again`);
    else if (answer.outcome) this.say(`plan: ${answer.outcome}`, answer.outcome !== "completed");
    else if (name !== "setpoint" && name !== "seek") this.say("");
    return answer;
  }

  async mark() {
    const field = $("mark-text");
    const answer = await this.ask("mark", field.value.trim() ? { text: field.value } : {});
    if (!answer.error) { field.value = ""; if (!answer.logged) this.say("marked on this page only: nothing is being recorded"); }
  }

  get flies() { return this.control?.pilot === this.hello?.you; }
  get state() { return this.hello?.states[this.status?.state]?.name ?? ""; }

  greet(hello) {
    [this.hello, this.status] = [hello, null]; // the status of another source has other fields
    const live = hello.mode === "live";
    for (const part of document.querySelectorAll(".live-only")) part.hidden = !live;
    for (const part of document.querySelectorAll(".replay-only")) part.hidden = live;
    for (const id of ["tab-parameters", "tab-link", "stop"]) $(id).hidden = !live;
    $("tab-fly").textContent = live ? "Fly" : "Replay";
    if (!live) Object.assign($("seek"), { min: hello.span_s[0], max: hello.span_s[1] });
    $("plans").replaceChildren(...hello.plans.map((plan) => element("div", { className: "plan-row" },
      element("button", { type: "button", className: "plan", onclick: () => this.ask("fly", { plans: [plan.name] }) }, `Fly ${plan.name}`),
      element("span", { className: "hint" }, plan.title))));
    const laws = [{ name: "", signals: [] }, ...(hello.laws ?? [])];
    $("law-box").hidden = laws.length < 2;
    this.laws = laws.map(({ name, rate_Hz, signals }) => element("button", { type: "button", value: name, onclick: () => this.ask("law", { name }),
      title: name ? `${rate_Hz} Hz; signals: ${signals.join(", ") || "none"}` : "the PID loops of the firmware" }, name || "board's own"));
    $("laws").replaceChildren(...this.laws);
    $("event-list").replaceChildren();
    hello.events.forEach((event) => this.event(event));
    this.buildParameters();
    this.values(hello);
  }

  values(news) {
    this.hello = { ...this.hello, ...news };
    const limits = this.hello.limits_deg;
    const axes = ["elevation", "travel"].filter((axis) => limits[axis]);
    if (Object.keys(this.sliders).join() !== axes.join()) this.buildSliders(axes);
    for (const axis of axes) {
      const [low, high] = limits[axis];
      for (const input of this.sliders[axis]) Object.assign(input, { min: low, max: high });
    }
    if (this.status) this.show(this.status);
    this.refreshParameters();
  }

  buildSliders(axes) {
    this.sliders = {};
    $("setpoints").replaceChildren(...axes.map((axis) => {
      const slider = element("input", { type: "range", step: 0.5, value: 0, id: `set-${axis}` });
      const exact = element("input", { type: "number", step: 0.5, value: 0 });
      exact.setAttribute("aria-label", `${axis} setpoint in degrees`);
      slider.addEventListener("input", () => this.want(axis, Number(slider.value)));
      exact.addEventListener("change", () => this.want(axis, Number(exact.value)));
      this.sliders[axis] = [slider, exact];
      const label = element("label", { htmlFor: slider.id }, axis);
      return element("div", { className: "setpoint" }, label, slider, exact);
    }));
  }

  // A setpoint of one axis [deg]; sent at most every 50 ms, the latest of all.
  want(axis, value) {
    const [low, high] = this.hello.limits_deg[axis];
    this.movedMs = performance.now();
    this.target[axis] = Math.min(Math.max(value, low), high);
    for (const input of this.sliders[axis]) if (document.activeElement !== input || input.type === "range") input.value = this.target[axis];
    this.pending = { ...this.pending, [`${axis}_deg`]: this.target[axis] };
  }

  move(axis, by) {
    if (this.flies && FLYING.has(this.state) && this.hello.limits_deg[axis]) this.want(axis, (this.target[axis] ?? this.setpointDeg[axis]) + by);
  }

  flush() {
    if (!this.pending) return;
    const pending = this.pending;
    this.pending = null;
    this.ask("setpoint", pending);
  }

  // While nobody moves them, sliders show the setpoint that the board has.
  follow(setpointDeg) {
    this.setpointDeg = setpointDeg;
    const moving = FLYING.has(this.state) && performance.now() - this.movedMs < MOVED_MS;
    for (const [axis, inputs] of Object.entries(this.sliders)) {
      if (moving || (inputs.includes(document.activeElement) && !document.activeElement.disabled)) continue;
      delete this.target[axis];
      for (const input of inputs) input.value = (Math.round(setpointDeg[axis] * 2) / 2).toFixed(1);
    }
  }

  show(status) {
    this.status = status;
    const off = ["idle", "fault", ""].includes(this.state), flies = this.flies, busy = Boolean(status.doing);
    const can = FLYING.has(this.state) && !status.flight;
    const watch = flies ? "" : "only the pilot may do this; ask for control", waits = busy ? `the board is busy (${status.doing})` : "";
    const start = watch || waits || (this.state === "idle" ? "" : "only while the motors are off");
    const move = watch || (status.flight ? "the plan gives the setpoints" : can ? "" : "only in flight; take off first");
    $("clear-fault").hidden = this.state !== "fault";
    explain("why-fly", [
      ["Take off", block([$("take-off")], start)], ["Land", block([$("land")], watch || (off ? "the motors are off" : ""))],
      ["Hold here", block([$("hold")], move)], ["Clear fault", this.state === "fault" ? block([$("clear-fault")], watch) : ""]]);
    explain("why-setpoint", [["Sliders", block(Object.values(this.sliders).flat(), move)]]);
    $("hands").hidden = Boolean(move);
    explain("why-plan", [["Plans", block(document.querySelectorAll(".plan"), start)]]);
    explain("why-record", [["Record", block([$("record")], watch || (status.flight ? "a plan is always recorded" : ""))]]);
    $("record").setAttribute("aria-pressed", String(Boolean(status.recording)));
    $("record").textContent = status.recording ? "Stop recording" : "Record";
    $("recording").textContent = status.trouble || (status.recording ? `recording ${status.recording}` : this.recorded ?? "not recording");
    const flight = status.flight;
    $("progress").textContent = flight ? `${flight.phase}, ${flight.t_s} s${flight.left_s == null ? "" : `, ${flight.left_s} s left`}. Press Land to end it` : status.doing;
    this.why = !this.mayTune ? "only the pilot may do this, unless the pilot allows it to others" : "";
    explain("why-parameters", [
      ["Undo", block([$("undo")], this.why || (this.hello.undo ? "" : "nothing was changed"))],
      ["Save", block([$("save")], this.why || (this.state === "idle" ? "" : "only while the motors are off"))]]);
    this.showLaw(status.law);
    this.refreshParameters();
    if (this.hello.mode === "replay") this.showReplay(status);
    else this.showLink(status.link);
  }

  showReplay(status) {
    block([$("play"), $("seek"), ...document.querySelectorAll("[data-speed]")], this.flies ? "" : "another page controls the replay; ask for control");
    $("play").textContent = status.playing ? "Pause" : "Play";
    for (const button of document.querySelectorAll("[data-speed]")) button.setAttribute("aria-pressed", String(Number(button.dataset.speed) === status.speed));
    $("at").textContent = `${status.at_s.toFixed(1)} s`;
    if (document.activeElement !== $("seek")) $("seek").value = status.at_s;
  }

  showLaw(law) {
    if (!law) return;
    const reason = !this.flies ? "only the pilot may do this; ask for control" : ["idle", "closed_loop"].includes(this.state) ? "" : "only with the motors off, or in closed loop";
    explain("why-law", [["Control law", reason]]);
    for (const button of this.laws) {
      button.disabled = Boolean(reason);
      button.setAttribute("aria-pressed", String(button.value === law.chosen));
    }
    if (this.lawShown !== law.chosen) {
      this.lawShown = law.chosen;
      $("law-parameters").replaceChildren(...Object.keys(law.values).map((name) => {
        const input = element("input", { type: "number", step: "any", id: `law-${name}`, name });
        input.addEventListener("change", () => this.ask("set_law", { name, value: Number(input.value) }));
        return element("div", { className: "parameter" }, element("label", { htmlFor: input.id }, name), input);
      }));
    }
    for (const input of $("law-parameters").querySelectorAll("input")) {
      input.disabled = !this.mayTune;
      if (document.activeElement !== input) input.value = +law.values[input.name].toPrecision(7);
    }
    const message = law.flies ? `${law.chosen} flies` : law.taken_over ? `the board's own control law took over: ${law.taken_over}` : law.chosen && this.state === "idle" ? `${law.chosen} is loaded, and flies after take-off` : "the board's own control law";
    $("law-message").className = law.taken_over ? "hint bad" : "hint";
    if ($("law-message").textContent !== message) $("law-message").textContent = message;
  }

  showLink(link) {
    const rows = { "ticks received": link.ticks, "ticks lost": link.lost_ticks, "good frames": link.frames, "bad frames": link.bad, "commands repeated": link.retries, reconnects: link.reconnects, "round trip [ms]": link.latency_ms ?? "–", "jitter [ms]": link.jitter_ms ?? "–" };
    $("link-list").replaceChildren(...Object.entries(rows).flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, String(value))]));
  }

  showControl(control) {
    const before = JSON.stringify(this.control);
    this.control = control;
    if (before === JSON.stringify(control)) return;
    const box = $("control"), button = (words, name, more) => element("button", { type: "button", onclick: () => this.ask(name, more) }, words);
    const others = control.clients - 1, audience = others > 0 ? ` ${others} other${others > 1 ? "s" : ""} watch.` : "";
    const replay = this.hello.mode === "replay", does = replay ? "controls the replay" : "flies";
    if (!this.flies) {
      const asked = control.asking === this.hello.you;
      box.replaceChildren(`You watch; ${control.pilot_name || "no page"} ${does}${control.present ? "" : ", but does not answer"}.${replay ? "" : " Stop works from here too."}`,
        element("div", { className: "row" }, asked ? "You asked for control. The pilot has to agree." : button("Ask for control", "ask")));
    } else if (control.asking) {
      box.replaceChildren(element("strong", {}, `${control.asking_name} asks for control.`),
        element("div", { className: "row" }, button("Hand over", "grant"), button("Keep", "keep")));
    } else if (replay) {
      box.replaceChildren(`You control the replay.${audience}`);
    } else {
      const share = element("input", { type: "checkbox", checked: control.shared, onchange: () => this.ask("share", { on: share.checked }) });
      box.replaceChildren(`You fly.${audience}`, element("div", {}, element("label", {}, share, " others may change parameters")));
    }
    if (this.status) this.show(this.status);
  }

  event(event) {
    const list = $("event-list");
    list.prepend(element("li", { className: event.kind }, element("b", {}, `${event.t_s.toFixed(2)} s`), event.text));
    while (list.children.length > EVENTS_SHOWN) list.lastChild.remove();
  }

  get mayTune() { return this.flies || Boolean(this.control?.shared); }

  buildParameters() {
    this.rows.clear();
    $("parameter-list").replaceChildren(...[...this.hello.parameters].sort((a, b) => a.idle_only - b.idle_only).map((spec) => {
      const input = element("input", { type: "number", step: "any", id: `p-${spec.name}`, title: `${spec.meaning}; valid: ${spec.valid_values}` });
      const why = element("span", { className: "why" });
      const row = element("div", { className: "parameter", title: spec.meaning }, element("label", { htmlFor: input.id }, spec.name), input, element("span", {}, spec.unit), why);
      input.addEventListener("change", async () => {
        const answer = await this.link.ask("set", { name: spec.name, value: Number(input.value) });
        const note = $("parameter-message");
        note.className = answer.error ? "hint bad" : "hint";
        note.textContent = answer.error ? `${answer.error}; ${answer.remedy}` : `${spec.name} is ${answer.value} ${spec.unit}, until the board restarts or it is saved`;
        input.value = this.hello.values[spec.name];
      });
      this.rows.set(spec.name, { spec, input, row, why });
      return row;
    }));
  }

  refreshParameters() {
    for (const { spec, input, row, why } of this.rows.values()) {
      const value = this.hello.values[spec.name], idle = this.state === "idle";
      const reason = !this.mayTune ? "the pilot changes parameters" : spec.idle_only && !idle ? "only while idle: a change would act on the flight" : "";
      if (input.disabled !== Boolean(reason)) input.disabled = Boolean(reason);
      if (why.textContent !== reason) why.textContent = reason;
      if (document.activeElement !== input && (input.value === "" || Number(input.value) !== value)) input.value = value;
      row.classList.toggle("changed", Math.abs(value - spec.default) > 1e-6 * Math.max(1, Math.abs(value)));
    }
  }

  filter() {
    const part = $("filter").value.trim();
    for (const { spec, row } of this.rows.values()) row.hidden = !spec.name.includes(part);
  }
}
