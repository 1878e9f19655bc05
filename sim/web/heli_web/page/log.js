// Writes a flight as MCAP, in the layout of heli_host.data.log, with chunks that are not compressed.
import { CHANNELS } from "./declaration.js";
import { crc32 } from "./frames.js";

const MAGIC = Uint8Array.from([0x89, 0x4d, 0x43, 0x41, 0x50, 0x30, 0x0d, 0x0a]);
const OP = { header: 1, footer: 2, schema: 3, channel: 4, message: 5, chunk: 6, messageIndex: 7, chunkIndex: 8, statistics: 11, metadata: 12, metadataIndex: 13, summaryOffset: 14, dataEnd: 15 };
const CHUNK_TICKS = 1000;
const TICK = 1, EVENT = 2, LINK = 3;
const ENCODER = new TextEncoder();

class Bytes {
  constructor(size = 1 << 12) { [this.view, this.size] = [new DataView(new ArrayBuffer(size)), 0]; }

  room(count) {
    if (this.size + count > this.view.byteLength) {
      const grown = new Uint8Array(Math.max(2 * this.view.byteLength, this.size + count));
      grown.set(new Uint8Array(this.view.buffer, 0, this.size));
      this.view = new DataView(grown.buffer);
    }
    const at = this.size;
    this.size += count;
    return at;
  }

  put(kind, size, value) {
    const at = this.room(size); // may move the buffer
    this.view[`set${kind}`](at, value, true);
    return this;
  }

  u8(value) { return this.put("Uint8", 1, value); }
  u16(value) { return this.put("Uint16", 2, value); }
  u32(value) { return this.put("Uint32", 4, value); }
  u64(value) { return this.put("BigUint64", 8, BigInt(value)); }
  bytes(data) {
    const at = this.room(data.length);
    new Uint8Array(this.view.buffer).set(data, at);
    return this;
  }
  text(text) { const data = ENCODER.encode(text); return this.u32(data.length).bytes(data); }
  map(entries) {
    const inner = new Bytes();
    for (const [key, value] of entries) inner.text(key).text(value);
    return this.u32(inner.size).bytes(inner.data);
  }
  get data() { return new Uint8Array(this.view.buffer, 0, this.size); }
}

// Write a column of numbers at places that lie `size` bytes apart. A function a type: a choice by each number took half
// of the time.
const WRITE = {
  f4: (view, at, size, column, count) => { for (let i = 0; i < count; i++, at += size) view.setFloat32(at, column[i], true); },
  f8: (view, at, size, column, count) => { for (let i = 0; i < count; i++, at += size) view.setFloat64(at, column[i], true); },
  u1: (view, at, size, column, count) => { for (let i = 0; i < count; i++, at += size) view.setUint8(at, column[i]); },
  u2: (view, at, size, column, count) => { for (let i = 0; i < count; i++, at += size) view.setUint16(at, column[i], true); },
  u4: (view, at, size, column, count) => { for (let i = 0; i < count; i++, at += size) view.setUint32(at, column[i], true); },
  i2: (view, at, size, column, count) => { for (let i = 0; i < count; i++, at += size) view.setInt16(at, column[i], true); },
  i4: (view, at, size, column, count) => { for (let i = 0; i < count; i++, at += size) view.setInt32(at, column[i], true); },
};

function record(op, write) {
  const body = new Bytes();
  write(body);
  return new Bytes(body.size + 9).u8(op).u64(body.size).bytes(body.data).data;
}

function metadataCrc(name, values) {
  const bytes = new Bytes().text(name);
  for (const key of Object.keys(values).sort()) bytes.text(key).text(values[key]);
  return crc32(bytes.data).toString(16).padStart(8, "0");
}

// Ticks are written as fields in this order: widest first, so that none needs padding.
export class LogWriter {
  // schema: {library, schemas: [{name, encoding, data}], channels: [{topic, encoding}], fields: [{name, code, channel,
  // axis}]}; radPerCount of the three axes.
  constructor(schema, startMs, radPerCount) {
    Object.assign(this, { schema, startNs: BigInt(Math.round(startMs)) * 1000000n, radPerCount, parts: [], size: 0, crc: 0, chunks: [], metadata: [], counts: {}, firstNs: null, lastNs: 0n });
    Object.assign(this, { pending: [], body: new Bytes(1 << 17), column: new Float64Array(256), pendingTicks: 0, firstTick: null, lastTick: null, shiftMs: 0, ticks: 0, lost: 0, events: 0 });
    this.append(MAGIC);
    this.append(record(OP.header, (out) => out.text("").text(schema.library)));
    this.definitions().forEach((data) => this.append(data));
    const head = this.parts.reduce((crc, part) => crc32(part, crc), 0);
    this.writeMetadata("head", { crc32: head.toString(16).padStart(8, "0"), bytes: String(this.size) });
  }

  definitions() {
    const schemas = this.schema.schemas.map(({ name, encoding, data }, i) => record(OP.schema, (out) => out.u16(i + 1).text(name).text(encoding).text(data)));
    const channels = this.schema.channels.map(({ topic, encoding }, i) => record(OP.channel, (out) => out.u16(i + 1).u16(i + 1).text(topic).text(encoding).map([])));
    return [...schemas, ...channels];
  }

  // Keeps a part of the file; its bytes must not change afterwards.
  append(data) {
    this.parts.push(data);
    this.size += data.length;
    this.crc = crc32(data, this.crc);
  }

  // Appends a record with a head and a long content.
  appendLong(op, head, content) {
    const data = new Uint8Array(9 + head.size + content.size), view = new DataView(data.buffer);
    data[0] = op;
    view.setBigUint64(1, BigInt(head.size + content.size), true);
    data.set(head.data, 9);
    data.set(content.data, 9 + head.size);
    this.append(data);
    return data.length;
  }

  // Time on the log's axis [ms]: from the first tick logged, also after a restart of the board.
  timeMs(tick) { return this.firstTick === null ? 0 : Math.max(0, tick - this.firstTick + this.shiftMs); }

  // A batch with the ticks `tick`, `tick` + 1, ...; raw: one array a channel.
  writeTicks({ tick, raw }) {
    const count = raw[0].length;
    if (this.firstTick === null) this.firstTick = tick;
    if (this.lastTick !== null && tick <= this.lastTick) this.shiftMs += this.lastTick - tick + 1; // the board has restarted
    else if (this.lastTick !== null) this.lost += tick - this.lastTick - 1;
    this.lastTick = tick + count - 1;
    this.ticks += count;
    this.pending.push({ tick, raw, timeMs: this.timeMs(tick) });
    if ((this.pendingTicks += count) >= CHUNK_TICKS) this.flush();
  }

  writeEvent(tick, name, text, level = 2) {
    const timeMs = this.timeMs(tick), ns = this.startNs + BigInt(timeMs) * 1000000n;
    const body = { timestamp: { sec: Number(ns / 1000000000n), nsec: Number(ns % 1000000000n) }, level, message: text, name, t_s: timeMs / 1000, tick: tick >>> 0 };
    this.pending.push({ channel: EVENT, timeMs, body: ENCODER.encode(JSON.stringify(body)) });
    this.events++;
  }

  writeLink(tick, counters) {
    const timeMs = this.timeMs(tick);
    this.pending.push({ channel: LINK, timeMs, body: ENCODER.encode(JSON.stringify({ t_s: timeMs / 1000, ...counters })) });
  }

  writeMetadata(name, values) {
    this.flush();
    const data = record(OP.metadata, (out) => out.text(name).map([...Object.entries(values), ["(crc32)", metadataCrc(name, values)]]));
    this.metadata.push({ name, offset: this.size, length: data.length });
    this.append(data);
  }

  flush() {
    if (!this.pending.length) return;
    const body = this.body, index = {};
    body.size = 0;
    let [firstNs, lastNs] = [null, 0n];
    for (const part of this.pending) {
      const ns = this.startNs + BigInt(part.timeMs) * 1000000n, count = part.raw ? part.raw[0].length : 1, endNs = ns + BigInt(count - 1) * 1000000n;
      firstNs = firstNs === null || ns < firstNs ? ns : firstNs;
      lastNs = endNs > lastNs ? endNs : lastNs;
      const entries = (index[part.channel ?? TICK] ??= new Bytes(part.raw ? 1 << 15 : 1 << 8));
      if (part.raw) this.tickMessages(body, part, ns, entries);
      else {
        entries.u64(ns).u64(body.size);
        body.u8(OP.message).u64(22 + part.body.length).u16(part.channel).u32(0).u64(ns).u64(ns).bytes(part.body);
      }
    }
    [this.pending, this.pendingTicks] = [[], 0];
    const offset = this.size, crc = crc32(body.data);
    const length = this.appendLong(OP.chunk, new Bytes(48).u64(firstNs).u64(lastNs).u64(body.size).u32(crc).text("").u64(body.size), body), offsets = [];
    for (const [channel, entries] of Object.entries(index)) {
      offsets.push([Number(channel), this.size]);
      this.appendLong(OP.messageIndex, new Bytes(6).u16(channel).u32(entries.size), entries);
      this.counts[channel] = (this.counts[channel] ?? 0) + entries.size / 16;
    }
    this.chunks.push({ offset, length, bytes: body.size, firstNs, lastNs, offsets, indexLength: this.size - offset - length });
    if (this.firstNs === null || firstNs < this.firstNs) this.firstNs = firstNs;
    if (lastNs > this.lastNs) this.lastNs = lastNs;
  }

  // Writes a batch of ticks, and their entries in the index. Times are halves of 32 bits: a BigInt for each tick took
  // most of the time.
  tickMessages(body, { tick, raw, timeMs }, startNs, entries) {
    const { fields } = this.schema, count = raw[0].length, size = fields.reduce((sum, { code }) => sum + Number(code[1]), 35);
    const start = body.room(size * count), index = entries.room(16 * count), { view } = body;
    let [low, high] = [Number(startNs & 0xffffffffn), Number(startNs >> 32n)];
    for (let i = 0, at = start; i < count; i++, at += size) {
      view.setUint8(at, OP.message);
      view.setUint32(at + 1, size - 9, true);
      view.setUint32(at + 5, 0, true);
      view.setUint16(at + 9, TICK, true);
      view.setUint32(at + 11, (tick + i) >>> 0, true);
      for (const [target, place] of [[view, at + 15], [view, at + 23], [entries.view, index + 16 * i]]) {
        target.setUint32(place, low, true);
        target.setUint32(place + 4, high, true);
      }
      view.setUint32(at + 31, 0x100, true);
      entries.view.setUint32(index + 16 * i + 8, at, true);
      entries.view.setUint32(index + 16 * i + 12, 0, true);
      low += 1000000;
      if (low >= 4294967296) [low, high] = [low - 4294967296, high + 1];
    }
    let offset = start + 35;
    for (const { name, code, channel, axis } of fields) {
      const values = channel === null ? null : raw[channel], factor = axis !== null ? this.radPerCount[axis] : code[0] === "f" && values ? CHANNELS[channel][3] : 1;
      for (let i = 0; i < count; i++) this.column[i] = values ? values[i] * factor : name === "t_s" ? (timeMs + i) / 1000 : (tick + i) >>> 0;
      WRITE[code](view, offset, size, this.column, count);
      offset += Number(code[1]);
    }
  }

  // Returns the whole file.
  close(metadata) {
    this.flush();
    for (const [name, values] of Object.entries(metadata)) this.writeMetadata(name, values);
    const crc = this.crc, sum = (counts) => Object.values(counts).reduce((total, count) => total + count, 0);
    this.append(record(OP.dataEnd, (out) => out.u32(crc)));
    const definitions = this.definitions(), schemas = this.schema.schemas.length;
    const statistics = record(OP.statistics, (out) => {
      out.u64(sum(this.counts)).u16(schemas).u32(this.schema.channels.length).u32(0).u32(this.metadata.length).u32(this.chunks.length).u64(this.firstNs ?? 0n).u64(this.lastNs);
      const counts = Object.entries(this.counts);
      out.u32(10 * counts.length);
      for (const [channel, count] of counts) out.u16(channel).u64(count);
    });
    const groups = [[OP.schema, definitions.slice(0, schemas)], [OP.channel, definitions.slice(schemas)], [OP.statistics, [statistics]],
      [OP.chunkIndex, this.chunks.map((chunk) => this.chunkIndex(chunk))],
      [OP.metadataIndex, this.metadata.map(({ name, offset, length }) => record(OP.metadataIndex, (out) => out.u64(offset).u64(length).text(name)))]];
    const start = this.size, summary = new Bytes(), offsets = [];
    for (const [op, records] of groups) {
      const from = summary.size;
      records.forEach((data) => summary.bytes(data));
      if (summary.size > from) offsets.push(record(OP.summaryOffset, (out) => out.u8(op).u64(start + from).u64(summary.size - from)));
    }
    const offsetStart = start + summary.size;
    offsets.forEach((data) => summary.bytes(data));
    const footer = new Bytes().u8(OP.footer).u64(20).u64(start).u64(offsetStart);
    footer.u32(crc32(footer.data, crc32(summary.data)));
    [summary.data, footer.data, MAGIC].forEach((data) => this.append(data));
    const file = new Uint8Array(this.size);
    let at = 0;
    for (const part of this.parts) {
      file.set(part, at);
      at += part.length;
    }
    return file;
  }

  chunkIndex({ offset, length, bytes, firstNs, lastNs, offsets, indexLength }) {
    return record(OP.chunkIndex, (out) => {
      out.u64(firstNs).u64(lastNs).u64(offset).u64(length).u32(10 * offsets.length);
      for (const [channel, at] of offsets) out.u16(channel).u64(at);
      out.u64(indexLength).text("").u64(bytes).u64(bytes);
    });
  }
}
