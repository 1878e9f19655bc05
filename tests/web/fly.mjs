// Flies plans with the small host, without a browser. Standard input: {board, facts, settings, plans, law, log}; the log is
// written to a file, and the outcome to standard output.
import { readFileSync, writeFileSync } from "node:fs";
import { Host } from "../../sim/web/heli_web/page/host.js";
import { defaultSettings, worldSetup } from "../../sim/web/heli_web/page/settings.js";
import { WorldFactory } from "../../sim/web/heli_web/page/world.js";

const { board, facts, settings, plans, law = "", log, seconds = 0, elf = null } = JSON.parse(readFileSync(0, "utf8"));
const chosen = { ...defaultSettings(facts), ...settings };
const firmware = elf?.map(({ address, content }) => ({ address, bytes: Uint8Array.from(Buffer.from(content, "base64")) })) ?? null;
const { setup, session } = worldSetup(facts, chosen, firmware);
const world = new WorldFactory(new WebAssembly.Module(readFileSync(board))).open(setup);
let outcome = null, file = null;
const tell = { words: () => {}, rows: () => {}, cleared: () => {}, log: (_, bytes) => { file = bytes; } };
const host = new Host(world, facts, tell, { session });
host.start(host.connect(), (result) => { outcome = result.error ? result : null; });
while (!outcome && !Object.keys(host.params).length) host.step(20);
host.start(host.laws.choose(law), (result) => { outcome = result.error ? result : null; });
host.step(1000);
if (plans) host.start(host.fly(plans), (result) => { outcome = result; });
const begin = performance.now();
while (plans ? !outcome : world.tick < 1000 * seconds) host.step(100, 20);
const took = (performance.now() - begin) / 1000;
if (log) writeFileSync(log, file);
process.stdout.write(JSON.stringify({ ...outcome, tick: world.tick, speed: world.tick / 1000 / took, counters: host.engine.counters() }));
