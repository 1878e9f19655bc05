// Runs a piece of the page without a browser: `node pieces.mjs NAME`, with JSON as input and output.
import { readFileSync, writeFileSync } from "node:fs";
import { Engine } from "../../sim/web/heli_web/page/engine.js";
import { NAME_OF_ID, unpack } from "../../sim/web/heli_web/page/frames.js";
import { Host } from "../../sim/web/heli_web/page/host.js";
import { Generator } from "../../sim/web/heli_web/page/random.js";
import { RestAngles } from "../../sim/web/heli_web/page/rest.js";
import { defaultSettings, worldSetup } from "../../sim/web/heli_web/page/settings.js";
import { WorldFactory } from "../../sim/web/heli_web/page/world.js";

const bytes = (text) => Uint8Array.from(Buffer.from(text, "base64"));

// Plays the calls of a recorded session of heli_host into the small host's engine; returns the bytes that it sends.
function engine(given) {
  const message = (id, text) => unpack(NAME_OF_ID[id], bytes(text));
  const engine = new Engine(1), sent = [], events = [];
  let ticks = 0;
  for (const [name, nowS, ...values] of given) {
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
  return { sent, events, ticks, counters: engine.counters(), newest: engine.newest };
}

// Flies plans with the small host, given {board, facts, settings, plans, law, log}; writes the log to a file, and returns the
// outcome.
function fly(given) {
  const { board, facts, settings, plans, law = "", log, seconds = 0, elf = null } = given;
  const chosen = { ...defaultSettings(facts), ...settings };
  const firmware = elf?.map(({ address, content }) => ({ address, bytes: bytes(content) })) ?? null;
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
  return { ...outcome, tick: world.tick, speed: world.tick / 1000 / took, counters: host.engine.counters() };
}

// Steps plants in WebAssembly, given {board, cases: [{plant, state, parameters, volts}]}; returns states and angles.
function plants(given) {
  const { board: file, cases } = given;
  const module = new WebAssembly.Module(readFileSync(file)), imports = {};
  for (const { module: from, name } of WebAssembly.Module.imports(module)) (imports[from] ??= {})[name] = () => 8;
  const board = new WebAssembly.Instance(module, imports).exports;
  board._initialize();
  const numbers = (values) => {
    const place = board.allocate(8 * values.length);
    new Float64Array(board.memory.buffer, place, values.length).set(values);
    return place;
  };
  return cases.map(({ plant, state, parameters, volts }) => {
    const { step } = new WebAssembly.Instance(new WebAssembly.Module(Buffer.from(plant, "base64")), { env: board }).exports;
    let [before, after] = [numbers(state), numbers(state)];
    const [locked, angles, constants] = [numbers([0, 0, 0]), numbers([0, 0, 0]), numbers(parameters)];
    return volts.map((pair) => {
      step(before, numbers(pair), locked, constants, after, angles);
      [before, after] = [after, before];
      return [...new Float64Array(board.memory.buffer, before, state.length), ...new Float64Array(board.memory.buffer, angles, 3)];
    });
  });
}

// Draws three numbers from -50,000 to 50,000, and then from the same seed again a whole number below 2^31 - 2.
function random(given) {
  return given.map((seed) => {
    const numbers = new Generator(seed);
    return [...[0, 1, 2].map(() => numbers.uniform(-5e4, 5e4)), new Generator(seed).integer(2 ** 31 - 2)];
  });
}

// Plays the calls of a recorded simulation into the WebAssembly build, given {board, setup, calls}; returns the bytes that its
// board sent in base64, and the final state.
function replay(given) {
  const { board, setup, calls } = given;
  const module = new WebAssembly.Module(readFileSync(board));
  const world = new WorldFactory(module).open({
    ...setup, plant: new WebAssembly.Module(bytes(setup.plant)), flash: bytes(setup.flash),
    elf: setup.elf?.map(({ address, content }) => ({ address, bytes: bytes(content) })) ?? null,
  });
  const sent = [], begin = performance.now();
  for (const [name, ...values] of calls) {
    if (name === "advance") sent.push(world.advance(values[0], bytes(values[1]), values[2], values[3]));
    else world.board[name](...values);
  }
  const seconds = (performance.now() - begin) / 1000;
  return { sent: Buffer.concat(sent).toString("base64"), state: world.state, volts: world.volts, tick: world.tick, seconds };
}

// Compares angles at rest, given [[elevation, pitch, tilt of the hover, elevations, pitches after the landing]] [deg], null
// for a number that is not known; returns what differs.
function rest(given) {
  return given.map(([elevation, pitch, tilt, elevations, pitches]) => {
    const before = new RestAngles([elevation], [pitch ?? NaN], 0.1);
    before.hover.meanDeg = tilt ?? NaN;
    return before.shiftAfter(elevations, pitches);
  });
}

const pieces = { engine, fly, plants, random, replay, rest };
const result = pieces[process.argv[2]](JSON.parse(readFileSync(0, "utf8")));
process.stdout.write(JSON.stringify(result));
