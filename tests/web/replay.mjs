// Plays the calls of a recorded simulation into the WebAssembly build, and prints what its board sent.
// Standard input: {board, setup, calls}; standard output: {sent: base64, volts, states, seconds}.
import { readFileSync } from "node:fs";
import { WorldFactory } from "../../sim/web/heli_web/page/world.js";

const bytes = (text) => Uint8Array.from(Buffer.from(text, "base64"));
const { board, setup, calls } = JSON.parse(readFileSync(0, "utf8"));
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
process.stdout.write(JSON.stringify({ sent: Buffer.concat(sent).toString("base64"), state: world.state, volts: world.volts, tick: world.tick, seconds }));
