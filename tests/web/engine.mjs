// Plays the calls of a recorded session of heli_host into the small host's engine; prints the bytes that it sends.
import { readFileSync } from "node:fs";
import { Engine } from "../../sim/web/heli_web/page/engine.js";
import { NAME_OF_ID, unpack } from "../../sim/web/heli_web/page/frames.js";

const bytes = (text) => Uint8Array.from(Buffer.from(text, "base64"));
const message = (id, text) => unpack(NAME_OF_ID[id], bytes(text));
const engine = new Engine(1), sent = [], events = [];
let ticks = 0;
for (const [name, nowS, ...values] of JSON.parse(readFileSync(0, "utf8"))) {
  if (name === "receive") {
    const received = engine.receive(bytes(values[0]), nowS);
    events.push(...received.events.map(({ tick, kind, text }) => [tick, kind, text]));
    ticks += received.batches.reduce((sum, { raw }) => sum + raw[0].length, 0);
  } else if (name === "outgoing") sent.push(Buffer.from(engine.outgoing(nowS)).toString("base64"));
  else if (name === "ask") engine.ask(NAME_OF_ID[values[0]], message(...values), nowS);
  else if (name === "preempt") engine.preempt(nowS);
  else if (name === "put") engine.stream(message(...values));
  else if (name === "kept") engine.kept = values[0] === null ? null : message(...values);
  else if (name === "cut") engine.cut(nowS);
}
process.stdout.write(JSON.stringify({ sent, events, ticks, counters: engine.counters(), newest: engine.newest }));
