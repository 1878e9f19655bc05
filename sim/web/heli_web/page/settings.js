// What the address and the panel choose: rig, board, effect, seed, plan, gains; checked, and made to a world.
import { Generator } from "./random.js";

export const AXES = ["elevation", "pitch", "travel"]; // as heli_sim orders them
const MODULUS = 2 ** 31 - 1, OFFSET_COUNTS = 50000; // of heli_sim.model.plant and heli_sim.sil.world

export class SettingsError extends Error {}

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const SEED_MAX = 2 ** 32 - 1, SPEED_MAX = 50;

function numberIn(text, name, low, high) {
  const value = Number(text);
  if (text.trim() === "" || !Number.isFinite(value) || value < low || value > high) throw new SettingsError(`${name} in the address is ${text.slice(0, 30)}; give a number from ${low} to ${high}`);
  return value;
}

function choice(text, name, known) {
  if (!known.includes(text)) throw new SettingsError(`the address names an unknown ${name}, ${text.slice(0, 30)}; choose ${known.slice(0, 4).join(", ")}${known.length > 4 ? " or another of the list" : ""}`);
  return text;
}

export function defaultSettings(facts) { return { rig: facts.rigs[0].name, board: "native", effect: facts.puzzle?.effect ?? facts.start ?? "", values: {}, seed: 1, plan: "", gains: {}, speed: 1 }; }

// From the text behind the # of an address; throws a SettingsError with one sentence.
export function readAddress(text, facts, hasFirmware) {
  const settings = defaultSettings(facts);
  if (text.length > 4000) throw new SettingsError("the address is too long; open the page without what follows the #");
  for (const [key, value] of new URLSearchParams(text)) {
    if (key === "rig") settings.rig = choice(value, "rig", facts.rigs.map(({ name }) => name));
    else if (key === "board") settings.board = choice(value, "board", hasFirmware ? ["native", "due"] : ["native"]);
    else if (key === "seed") settings.seed = Math.floor(numberIn(value, "seed", 1, SEED_MAX));
    else if (key === "speed") settings.speed = numberIn(value, "speed", 0.1, SPEED_MAX);
    else if (key === "plan") settings.plan = choice(value, "plan", facts.plans.map(({ name }) => name));
    else if (key === "effect" && !facts.puzzle) readEffect(value, facts, settings);
    else if (key === "set") {
      const [name, number = ""] = value.split(":"), spec = facts.hello.parameters.find((row) => row.name === name);
      if (!spec) throw new SettingsError(`the address sets an unknown parameter, ${name.slice(0, 30)}; choose a name from the list of parameters`);
      settings.gains[name] = numberIn(number, name, spec.min, spec.max);
    } else throw new SettingsError(`the address holds an unknown word, ${key.slice(0, 30)}; use rig, board, effect, seed, speed, plan and set`);
  }
  return settings;
}

// effect=rotor_lag,s:0.12
function readEffect(text, facts, settings) {
  const [id, ...parts] = text.split(",");
  settings.effect = text && choice(id, "effect", facts.effects.map((effect) => effect.id));
  const effect = facts.effects.find((known) => known.id === id);
  for (const part of parts) {
    const [name, value = ""] = part.split(":"), parameter = effect?.parameters.find((known) => known.name === `${id}.${name}`);
    if (!parameter) throw new SettingsError(`the effect ${id.slice(0, 30)} has no parameter ${name.slice(0, 30)}; open the page without it`);
    settings.values[parameter.name] = numberIn(value, name, parameter.low, parameter.high);
  }
}

export function writeAddress(settings, facts) {
  const text = new URLSearchParams(), usual = defaultSettings(facts);
  for (const key of ["rig", "board", "seed", "speed", "plan"]) if (settings[key] !== usual[key]) text.set(key, settings[key]);
  if (settings.effect && !facts.puzzle) text.set("effect", [settings.effect, ...Object.entries(settings.values).map(([name, value]) => `${name.slice(settings.effect.length + 1)}:${value}`)].join(","));
  for (const [name, value] of Object.entries(settings.gains)) text.append("set", `${name}:${value}`);
  return text.toString().replaceAll("%2C", ",").replaceAll("%3A", ":");
}

// What world.js needs for these settings.
export function worldSetup(facts, settings, elf) {
  const rig = facts.rigs.find(({ name }) => name === settings.rig), effect = facts.puzzle?.hidden ?? facts.effects.find(({ id }) => id === settings.effect);
  const plant = effect?.plant ?? facts.plants[""], draw = new Generator(settings.seed), named = { ...rig.values };
  for (const parameter of effect?.parameters ?? []) named[parameter.symbol] = settings.values[parameter.name] ?? parameter.typical;
  const state = new Array(plant.states).fill(0), due = settings.board === "due";
  state[0] = (named.elevation_min * Math.PI) / 180;
  const offset_count = [0, 1, 2].map(() => draw.uniform(-OFFSET_COUNTS, OFFSET_COUNTS));
  if (plant.random_state >= 0) state[plant.random_state] = 1 + new Generator(settings.seed).integer(MODULUS - 1);
  plant.compiled ??= new WebAssembly.Module(bytes(plant.module));
  return {
    name: rig.name, board: due ? "emulated Due, firmware file of the board" : "native flight code",
    session: { rig: rig.name, board: due ? "emulated Due, heli.elf" : "native board", sealed: facts.puzzle?.sealed ?? "", url: "heli-lab.html" },
    setup: {
      plant: plant.compiled, state, parameters: plant.parameters.map((name) => named[name]), named, drawing: rig.drawing, supply_V: rig.supply_V, dead_band: rig.dead_band,
      counts_per_rad: rig.counts_per_rad, offset_count, flash: bytes(rig.flash), delay_s: plant.delay ? named[plant.delay] : 0, seed: settings.seed, elf: due ? elf : null,
    },
  };
}
