// The control laws that the page offers, as heli_host.ui.page.actions.LawChoice: a law is uploaded on the table, flies from
// the end of a take-off, and the board's own law runs along and takes over when it fails.
import { MESSAGES, NAMES } from "./declaration.js";
import { CHANNEL, HeliError, nameOf } from "./engine.js";

const PART_WORDS = MESSAGES.law_part.fields.filter(([name]) => name.startsWith("word_")).length;
const ENGAGED_S = 1;
const EXPECTED_ENDS = ["command", "state"]; // a command, or the landing

// Why the board's own law took over: [reason, value]; null for another event, or an expected one.
export function takeover({ kind, message }) {
  const reason = kind === "law_taken_over" ? nameOf("takeover", message.detail, "reason ") : "command";
  return EXPECTED_ENDS.includes(reason) ? null : [reason, +message.value.toPrecision(3)];
}

export class Laws {
  // laws: [{name, hash, words, parameters, signals}]; host: sends the commands.
  constructor(host, laws) {
    Object.assign(this, { host, laws: Object.fromEntries(laws.map((law) => [law.name, law])), chosen: "", takenOver: "" });
    this.values = Object.fromEntries(laws.map(({ name, parameters }) => [name, { ...parameters }]));
  }

  get flies() { return Boolean(this.host.engine.newest?.[CHANNEL.flags] & NAMES.flags.law); }

  status() {
    if (!Object.keys(this.laws).length) return null;
    return { chosen: this.chosen, flies: this.flies, taken_over: this.takenOver, values: this.values[this.chosen] ?? {} };
  }

  take(event) {
    const end = takeover(event);
    if (end) this.takenOver = `${end[0].replaceAll("_", " ")} (${end[1]})`;
  }

  *choose(name) {
    const { state } = this.host;
    if (name && !this.laws[name]) throw new HeliError(`unknown control law ${name.slice(0, 40)}`, `choose from: ${Object.keys(this.laws).join(", ")}`);
    if (!name) {
      if (this.flies) yield* this.host.command("law_fly", { on: 0 });
    } else if (state === "idle") yield* this.upload(this.laws[name]);
    else if (state === "closed_loop") yield* this.change(name);
    else throw new HeliError(`no control law can start while the board is ${state}`, "land first");
    [this.chosen, this.takenOver] = [name, ""];
    return { law: name };
  }

  *set(name, value) {
    if (!this.chosen) throw new HeliError("no control law is chosen", "change the gains of the board's own law among its parameters, or choose a law");
    const values = this.values[this.chosen], before = values[name];
    values[name] = yield* this.setOnBoard(this.laws[this.chosen], name, value);
    this.host.announce("parameter", `${this.chosen} ${name}: ${before} -> ${values[name]}`);
    return { value: values[name] };
  }

  *setOnBoard(law, name, value) {
    const names = Object.keys(law.parameters);
    if (!names.includes(name)) throw new HeliError(`control law ${law.name} has no parameter ${name.slice(0, 40)}`, `choose from: ${names.join(", ") || "none"}`);
    return +(yield* this.host.command("law_set", { index: names.indexOf(name), value })).message.value.toPrecision(7);
  }

  *isLoaded({ hash }) {
    const { message } = yield* this.host.command("law_read");
    return message.hash === hash && [NAMES.law_state.ready, NAMES.law_state.flying].includes(message.state);
  }

  *upload(law) {
    if (yield* this.isLoaded(law)) return;
    const { hash, words } = law;
    yield* this.host.command("law_begin", { hash, words: words.length });
    for (let first = 0; first < words.length; first += PART_WORDS) {
      const part = Array.from({ length: PART_WORDS }, (_, i) => [`word_${i}`, words[first + i] ?? 0]);
      yield* this.host.command("law_part", { first, ...Object.fromEntries(part) });
    }
    yield* this.host.command("law_end");
  }

  // The board accepts no other law in the air than the one that it holds.
  *change(name) {
    if (!(yield* this.isLoaded(this.laws[name]))) throw new HeliError(`the board has no control law ${name}, and accepts one only on the table`, "land first");
    if (!this.flies) yield* this.start(this.laws[name]);
  }

  // Hands control from the board's own law to the chosen law, if there is one; the board must hover.
  *engage() {
    this.takenOver = "";
    if (this.chosen) yield* this.start(this.laws[this.chosen]);
  }

  *start(law) {
    const { host } = this;
    yield* this.upload(law);
    host.nameSignals(law);
    for (const [name, value] of Object.entries(this.values[law.name])) if (value !== law.parameters[name]) yield* this.setOnBoard(law, name, value);
    yield* host.command("law_fly", { on: 1 });
    if (!(yield { until: () => this.flies || this.takenOver, forS: ENGAGED_S }) || this.takenOver) throw new HeliError(`control law ${law.name} was taken over immediately${this.takenOver && `: ${this.takenOver}`}`, "simulate it first with heli-host law check");
  }
}
