// A log that was dropped on the page, as heli_host.ui.page.replay shows one. Reads MCAP.
import { CHANNELS } from "./declaration.js";
import { CHANNEL, HeliError } from "./engine.js";
import { crc32 } from "./frames.js";
import { unpackZstd } from "./zstd.js";

const MAX_BYTES = 1 << 28, MAX_CHUNK = 1 << 24, BEFORE_TICKS = 60000, SPEED_MAX = 50;
const MAX_UNPACKED = 1 << 28; // 40 minutes of flight [bytes]; a small file may unpack to more than the memory of a phone
const MAGIC = "137,77,67,65,80,48,13,10";
const SIZES = { float32: 4, float64: 8, uint8: 1, int8: 1, uint16: 2, int16: 2, uint32: 4, int32: 4, uint64: 8, int64: 8 };
const DECODER = new TextDecoder();

class Reader {
  constructor(data, at = 0) { Object.assign(this, { data, at, view: new DataView(data.buffer, data.byteOffset, data.length) }); }
  take(count) {
    if (count > this.data.length - this.at) throw new RangeError("a record reaches beyond its end");
    this.at += count;
    return this.data.subarray(this.at - count, this.at);
  }
  u16() { this.take(2); return this.view.getUint16(this.at - 2, true); }
  u32() { this.take(4); return this.view.getUint32(this.at - 4, true); }
  u64() { this.take(8); return Number(this.view.getBigUint64(this.at - 8, true)); }
  text() { return DECODER.decode(this.take(this.u32())); }
  map() {
    const entries = {}, inner = new Reader(this.take(this.u32()));
    while (inner.at < inner.data.length) entries[inner.text()] = inner.text();
    return entries;
  }
}

// Yields the records of a file or of a chunk; a last record that is cut off ends a file.
function* records(data, at, isFile) {
  const reader = new Reader(data, at);
  while (reader.data.length - reader.at >= 9) {
    const op = reader.take(1)[0], length = reader.u64();
    if (op === 0) throw new RangeError("a record has no type");
    if (length > reader.data.length - reader.at) {
      if (isFile) return;
      throw new RangeError("a record reaches beyond its chunk");
    }
    yield [op, new Reader(reader.take(length))];
    if (op === 15) return; // the index follows
  }
}

export class Replay {
  // Reads a file in steps, so that a flight goes on and a stop is heard; the last step returns the replay.
  static *read(name, bytes, facts) {
    const replay = new Replay(name, facts);
    if (bytes.length > MAX_BYTES) replay.refuse("is too large for the page", "replay it with heli-host dashboard --replay");
    if (String([...bytes.subarray(0, 8)]) !== MAGIC) replay.refuse("is not a log", "drop an .mcap file that heli-host or this page has written");
    try {
      yield* replay.parse(bytes);
      return replay;
    } catch (error) {
      if (error instanceof HeliError) throw error;
      return replay.refuse(`is damaged (${error.message})`, "check it with heli-host info");
    }
  }

  constructor(name, facts) {
    Object.assign(this, { name, facts, schemas: {}, topics: {}, metadata: {}, ticks: [], raw: CHANNELS.map(() => []), events: [], notes: "", position: 0, speed: 1, playing: true, owed: 0, unpacked: 0 });
  }

  refuse(cause, remedy) { throw new HeliError(`${this.name.slice(0, 60)} ${cause}`, remedy); }

  *parse(bytes) {
    let count = 0;
    for (const [op, reader] of records(bytes, 8, true)) {
      if (op === 6) yield* this.chunk(reader);
      else this.record(op, reader);
      if (++count % 1000 === 0) yield;
    }
    if (!this.ticks.length) this.refuse("holds no ticks", "record again");
    this.raw = this.raw.map((values) => Int32Array.from(values));
    this.actions = { play: (request) => this.play(request), seek: (request) => this.seek(request.t_s) };
  }

  get newest() { return this.raw.map((values) => values[Math.max(this.position - 1, 0)]); }

  *chunk(reader) {
    reader.take(16);
    const size = reader.u64(), crc = reader.u32(), compression = reader.text(), packed = reader.take(reader.u64());
    if (size > MAX_CHUNK || (this.unpacked += size) > MAX_UNPACKED) this.refuse("is too large for the page", "replay it with heli-host dashboard --replay");
    if (compression !== "" && compression !== "zstd") throw new RangeError("an unknown compression");
    const body = compression ? unpackZstd(packed, size) : packed;
    if (body.length !== size || (crc && crc32(body) !== crc)) throw new RangeError("a chunk does not match its checksum");
    let count = 0;
    yield;
    for (const [op, record] of records(body, 0, false)) {
      this.record(op, record);
      if (++count % 1000 === 0) yield;
    }
  }

  record(op, reader) {
    if (op === 3) {
      const id = reader.u16(), [, encoding] = [reader.text(), reader.text()];
      this.schemas[id] = { encoding, data: DECODER.decode(reader.take(reader.u32())) };
    } else if (op === 4) {
      const id = reader.u16(), schema = this.schemas[reader.u16()], topic = reader.text();
      this.topics[id] = { topic, layout: topic === "/heli/tick" && schema ? layoutOf(schema.data) : null };
    } else if (op === 12) this.metadata[reader.text()] = reader.map();
    else if (op === 5) this.message(reader);
  }

  message(reader) {
    const { topic, layout } = this.topics[reader.u16()] ?? {};
    reader.take(20);
    if (layout) this.tick(reader.data.subarray(reader.at), layout);
    else if (topic === "/heli/event") {
      const { t_s, name, message } = JSON.parse(DECODER.decode(reader.data.subarray(reader.at)));
      if (this.events.length < 1000) this.events.push({ t_s: Number(t_s) || 0, kind: String(name), text: String(message) });
    }
  }

  tick(payload, layout) {
    if (payload.length !== layout.size + 4) throw new RangeError("a tick has another length than its schema");
    const view = new DataView(payload.buffer, payload.byteOffset + 4, layout.size);
    this.ticks.push(Math.round(layout.fields.t_s(view) * 1000));
    CHANNELS.forEach(([name, , , scale], c) => {
      const field = layout.fields[FIELDS[c]];
      if (!field) this.refuse(`has no channel ${name}`, "replay it with the heli-host that wrote it");
      this.raw[c].push(layout.whole[FIELDS[c]] ? field(view) : Math.round(field(view) / scale));
    });
  }

  describe() {
    const session = this.metadata.session ?? {}, values = Object.fromEntries(Object.entries(this.metadata.parameters ?? {}).map(([name, value]) => [name, Number(value)]));
    const channels = this.facts.hello.channels.map((row) => {
      const counts = values[row.name.replace("_rad", "_counts_per_rev")];
      return row.unit === "rad" && counts ? { ...row, scale: (2 * Math.PI) / Math.abs(counts) } : row;
    });
    return {
      mode: "replay", kind: "replay", rig_name: session.rig ?? "", board: `${this.name}: ${session.board ?? "a board"}`, rig: this.facts.rigs[0].drawing, tick_s: 0.001, channels,
      states: Object.fromEntries(Object.entries(this.facts.hello.states).map(([number, { name }]) => [number, { name, words: `The log shows the state ${name.replaceAll("_", " ")}.` }])),
      faults: this.facts.faults, parameters: [], values, undo: 0, limits_deg: {}, plans: [], span_s: [this.ticks[0] / 1000, this.ticks.at(-1) / 1000], events: this.events,
    };
  }

  status() {
    const newest = this.newest;
    return {
      state: newest[CHANNEL.state], fault: newest[CHANNEL.fault], connected: true, link: { ticks: this.position, lost_ticks: 0 }, recording: null, trouble: this.notes, doing: "", flight: null,
      at_s: +(this.ticks[Math.max(this.position - 1, 0)] / 1000).toFixed(2), playing: this.playing, speed: this.speed,
    };
  }

  play({ on = true, speed }) {
    if (Number.isFinite(speed)) this.speed = Math.min(Math.max(speed, 0.1), SPEED_MAX);
    this.playing = Boolean(on);
    if (this.playing && this.position >= this.ticks.length) this.seek(this.ticks[0] / 1000);
    return {};
  }

  seek(t_s) {
    if (!Number.isFinite(t_s)) return { error: "t_s is not a number", remedy: "give a number" };
    const at = this.ticks.findIndex((tick) => tick >= t_s * 1000);
    this.position = at < 0 ? this.ticks.length : at;
    this.sought = true;
    return {};
  }

  // Passes the next ticks of the log to the page.
  pass(passedMs, tell) {
    let from = this.position;
    if (this.sought) {
      tell.cleared();
      [this.sought, from] = [false, Math.max(this.position - BEFORE_TICKS, 0)];
    } else {
      this.owed += this.playing ? passedMs * this.speed : 0;
      this.position = Math.min(this.position + Math.floor(this.owed), this.ticks.length);
      this.owed %= 1;
      if (this.position >= this.ticks.length) this.playing = false;
    }
    if (this.position > from) tell.rows({ tick: this.ticks[from], ticks: this.ticks.slice(from, this.position), raw: this.raw.map((values) => values.subarray(from, this.position)) });
  }
}

// Names of the channels in a log: with the unit, volts spelled out, as ROS permits no capitals.
const FIELDS = CHANNELS.map(([name, , unit]) => (unit === "V" ? `${name}_volt` : unit === "rad" ? `${name}_rad` : name));

// Reads a ros2msg definition that has only numbers in it.
function layoutOf(text) {
  const fields = {}, whole = {};
  let size = 0;
  for (const line of text.split("\n")) {
    const [, type, name] = /^(\w+)\s+(\w+)\s*$/.exec(line.split("#")[0].trim()) ?? [];
    if (!SIZES[type]) continue;
    const at = Math.ceil(size / SIZES[type]) * SIZES[type], getter = `get${type[0].toUpperCase()}${type.slice(1)}`.replace("int", "int");
    fields[name] = type.endsWith("64") && type[0] !== "f" ? (view) => Number(view[`getBig${type[0].toUpperCase()}${type.slice(1)}`](at, true)) : (view) => view[getter](at, true);
    whole[name] = type[0] !== "f";
    size = at + SIZES[type];
  }
  return { fields, whole, size };
}
