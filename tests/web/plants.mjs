// Steps plants in WebAssembly. Standard input: {board, cases: [{plant, state, parameters, volts}]}; output: states and angles.
import { readFileSync } from "node:fs";

const { board: file, cases } = JSON.parse(readFileSync(0, "utf8"));
const module = new WebAssembly.Module(readFileSync(file)), imports = {};
for (const { module: from, name } of WebAssembly.Module.imports(module)) (imports[from] ??= {})[name] = () => 8;
const board = new WebAssembly.Instance(module, imports).exports;
board._initialize();
const numbers = (values) => {
  const place = board.allocate(8 * values.length);
  new Float64Array(board.memory.buffer, place, values.length).set(values);
  return place;
};
const results = cases.map(({ plant, state, parameters, volts }) => {
  const { step } = new WebAssembly.Instance(new WebAssembly.Module(Buffer.from(plant, "base64")), { env: board }).exports;
  let [before, after] = [numbers(state), numbers(state)];
  const [locked, angles, constants] = [numbers([0, 0, 0]), numbers([0, 0, 0]), numbers(parameters)];
  return volts.map((pair) => {
    step(before, numbers(pair), locked, constants, after, angles);
    [before, after] = [after, before];
    return [...new Float64Array(board.memory.buffer, before, state.length), ...new Float64Array(board.memory.buffer, angles, 3)];
  });
});
process.stdout.write(JSON.stringify(results));
