// The WebAssembly module with board, line, power stage and encoders, and the plant's module beside it.

const BAD_FILE = 8; // WASI's answer to every file: there is none
const AXES = 3;

// Makes worlds from the compiled modules.
export class WorldFactory {
  constructor(boardModule) { this.boardModule = boardModule; }

  // setup: {plant: module, state, parameters, supply_V, dead_band, counts_per_rad, offset_count, flash, delay_s, seed,
  // elf: segments of the firmware for the emulated Due, or null}
  open(setup) { return new World(this.boardModule, setup); }
}

export class World {
  constructor(boardModule, setup) {
    const wasi = {};
    for (const { module, name } of WebAssembly.Module.imports(boardModule)) (wasi[module] ??= {})[name] = () => BAD_FILE;
    const board = (this.board = new WebAssembly.Instance(boardModule, wasi).exports);
    board._initialize();
    this.tick = 0;
    this.count = setup.state.length;
    this.rest_rad = setup.state[0];
    this.plant = new WebAssembly.Instance(setup.plant, { env: board }).exports;
    const step = board.__indirect_function_table.grow(1);
    board.__indirect_function_table.set(step, this.plant.step);
    if (setup.elf) {
      board.make_due(setup.seed);
      for (const { address, bytes } of setup.elf) this.with(bytes, (place) => board.load_due(address, place, bytes.length));
      this.with(setup.flash.subarray(0, 1024), (place) => board.load_due(0xffc00, place, 1024));
    } else this.with(setup.flash, (place) => board.make_native(setup.seed, place));
    this.rx = board.allocate(1 << 16);
    this.withNumbers(setup.state, (state) => this.withNumbers(setup.parameters, (parameters) => this.withNumbers([...setup.counts_per_rad, ...setup.offset_count], (encoders) =>
      board.make_world(step, state, setup.state.length, parameters, setup.parameters.length, setup.supply_V, setup.dead_band, encoders, setup.delay_s ?? 0))));
    // The arm may drift off its table without voltage: then an operator supports it, as in heli_sim.sil.arm_support.
    if (this.restRate(setup) > 0) board.support_below(setup.state[0] + (0.2 * Math.PI) / 180);
  }

  // Elevation's rate after a step from rest without voltage [rad/s].
  restRate({ state, parameters }) {
    const zeros = [0, 0, 0];
    return this.withNumbers(state, (s) => this.withNumbers(zeros, (volts) => this.withNumbers(zeros, (locked) => this.withNumbers(parameters, (p) =>
      this.withNumbers(state, (next) => this.withNumbers(zeros, (angles) => {
        this.plant.step(s, volts, locked, p, next, angles);
        return new Float64Array(this.board.memory.buffer, next, state.length)[AXES];
      }))))));
  }

  with(bytes, use) {
    const place = this.board.allocate(bytes.length || 1);
    new Uint8Array(this.board.memory.buffer).set(bytes, place);
    const result = use(place);
    this.board.release(place);
    return result;
  }

  withNumbers(numbers, use) { return this.with(new Uint8Array(Float64Array.from(numbers).buffer), use); }

  // Lets up to `ticks` milliseconds pass; returns the bytes that reached the host. Throws if the emulated board stops.
  advance(ticks, bytes = new Uint8Array(0), untilOutput = false, least = 1) {
    new Uint8Array(this.board.memory.buffer).set(bytes, this.rx);
    const passed = this.board.advance(ticks, this.rx, bytes.length, untilOutput, least);
    if (passed < 0) throw new Error(this.text(this.board.error()));
    this.tick += passed;
    return new Uint8Array(this.board.memory.buffer, this.board.to_host(), this.board.to_host_count()).slice();
  }

  text(place) {
    const bytes = new Uint8Array(this.board.memory.buffer);
    return new TextDecoder().decode(bytes.slice(place, bytes.indexOf(0, place)));
  }

  get state() { return [...new Float64Array(this.board.memory.buffer, this.board.state(), this.count)]; }

  get volts() { return [...new Float64Array(this.board.memory.buffer, this.board.volts(), 2)]; }

  setParameters(values) { this.withNumbers(values, (place) => this.board.set_parameters(place, values.length)); }

  // Changes the rate of an axis within one tick, as a tap with a finger does; returns false if the arm rests, and does not yield.
  push(axis, rate_rad_s) {
    const state = new Float64Array(this.board.memory.buffer, this.board.state(), this.count);
    if (state[0] <= this.rest_rad) return false;
    state[AXES + axis] += rate_rad_s;
    return true;
  }

  setDelay(delay_s) { this.board.set_delay(delay_s); }
}
