// Frames and messages of the link: COBS(protocol | id | sequence | payload | crc32) 0x00. See docs/reference/link.md.
import { CHANNELS, LINK, MESSAGES } from "./declaration.js";

const OVERHEAD = 7;
const MAX_PLAIN = LINK.max_telemetry_payload + OVERHEAD;
const MAX_ENCODED = MAX_PLAIN + 1 + Math.floor(MAX_PLAIN / 254);
// The CRC of a byte, and of a byte with one to seven zero bytes behind it.
const TABLES = Array.from({ length: 8 }, () => new Uint32Array(256));
for (let byte = 0; byte < 256; byte++) {
  let crc = byte;
  for (let bit = 0; bit < 8; bit++) crc = crc & 1 ? (crc >>> 1) ^ 0xedb88320 : crc >>> 1;
  TABLES[0][byte] = crc;
}
for (let k = 1; k < 8; k++) for (let byte = 0; byte < 256; byte++) TABLES[k][byte] = TABLES[0][TABLES[k - 1][byte] & 255] ^ (TABLES[k - 1][byte] >>> 8);
const [T0, T1, T2, T3, T4, T5, T6, T7] = TABLES;

export function crc32(bytes, crc = 0) {
  const end = bytes.length, eights = end - (end % 8);
  let at = 0;
  crc = ~crc;
  for (; at < eights; at += 8) {
    crc ^= bytes[at] | (bytes[at + 1] << 8) | (bytes[at + 2] << 16) | (bytes[at + 3] << 24);
    crc = T7[crc & 255] ^ T6[(crc >>> 8) & 255] ^ T5[(crc >>> 16) & 255] ^ T4[crc >>> 24] ^ T3[bytes[at + 4]] ^ T2[bytes[at + 5]] ^ T1[bytes[at + 6]] ^ T0[bytes[at + 7]];
  }
  for (; at < end; at++) crc = T0[(crc ^ bytes[at]) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
}

// COBS, with the zero that ends a frame.
function cobsEncode(bytes) {
  const out = new Uint8Array(bytes.length + Math.floor(bytes.length / 254) + 2);
  let code = 0, size = 1;
  for (let i = 0; i < bytes.length; i++) {
    if (bytes[i] !== 0) out[size++] = bytes[i];
    if (bytes[i] !== 0 && (size - code < 255 || i === bytes.length - 1)) continue;
    out[code] = size - code;
    code = size++;
  }
  out[code] = size - code;
  return out.subarray(0, size + 1);
}

// Returns null for bytes that are no COBS.
function cobsDecode(encoded) {
  const out = new Uint8Array(encoded.length);
  let size = 0, at = 0;
  while (at < encoded.length) {
    const code = encoded[at];
    if (code === 0 || at + code > encoded.length) return null;
    for (const end = at++ + code; at < end; at++) out[size++] = encoded[at];
    if (code < 255 && at < encoded.length) out[size++] = 0;
  }
  return out.subarray(0, size);
}

const SIZES = { B: 1, H: 2, h: 2, I: 4, i: 4, f: 4, Q: 8 };
const READERS = { B: "getUint8", H: "getUint16", h: "getInt16", I: "getUint32", i: "getInt32", f: "getFloat32" };
const WRITERS = { B: "setUint8", H: "setUint16", h: "setInt16", I: "setUint32", i: "setInt32", f: "setFloat32" };

const MESSAGE_SIZES = Object.fromEntries(Object.entries(MESSAGES).map(([name, { fields }]) => [name, fields.reduce((sum, [, code]) => sum + SIZES[code], 0)]));

export function sizeOf(name) { return MESSAGE_SIZES[name]; }

export function pack(name, values) {
  const view = new DataView(new ArrayBuffer(sizeOf(name)));
  let at = 0;
  for (const [field, code] of MESSAGES[name].fields) {
    if (code === "Q") view.setBigUint64(at, BigInt(values[field]), true);
    else view[WRITERS[code]](at, values[field], true);
    at += SIZES[code];
  }
  return new Uint8Array(view.buffer);
}

// Reads the fixed fields of a payload; null when it is too short.
export function unpack(name, payload) {
  if (payload.length < sizeOf(name)) return null;
  const view = new DataView(payload.buffer, payload.byteOffset, payload.length), values = {};
  let at = 0;
  for (const [field, code] of MESSAGES[name].fields) {
    values[field] = code === "Q" ? Number(view.getBigUint64(at, true)) : view[READERS[code]](at, true);
    at += SIZES[code];
  }
  return values;
}

export const NAME_OF_ID = Object.fromEntries(Object.entries(MESSAGES).map(([name, { id }]) => [id, name]));

export function encodeFrame(id, seq, payload) {
  const content = new Uint8Array(OVERHEAD + payload.length);
  content.set([LINK.protocol, id, seq]);
  content.set(payload, 3);
  new DataView(content.buffer).setUint32(3 + payload.length, crc32(content.subarray(0, -4)), true);
  return cobsEncode(content);
}

// Splits a stream of any bytes into frames that pass every check.
export class FrameParser {
  constructor() {
    Object.assign(this, { ok: 0, bad: 0, lost: 0, received: 0, dropped: 0, partial: new Uint8Array(0), overlong: false, synchronised: false, expected: -1 });
  }

  feed(data) {
    this.received += data.length;
    const frames = [];
    let bytes = data;
    if (this.partial.length) {
      bytes = new Uint8Array(this.partial.length + data.length);
      bytes.set(this.partial);
      bytes.set(data, this.partial.length);
    }
    let start = 0;
    for (let end = bytes.indexOf(0); end >= 0; start = end + 1, end = bytes.indexOf(0, start)) {
      const frame = this.frame(bytes.subarray(start, end));
      if (frame) frames.push(frame);
    }
    this.partial = bytes.slice(start);
    if (this.partial.length > MAX_ENCODED) {
      this.dropped += this.partial.length;
      this.partial = new Uint8Array(0);
      this.overlong = true;
    }
    return frames;
  }

  frame(encoded) {
    if (this.overlong) {
      this.overlong = false;
      return this.refuse(encoded);
    }
    if (!encoded.length) {
      this.synchronised = true;
      return null;
    }
    const plain = encoded.length <= MAX_ENCODED ? cobsDecode(encoded) : null;
    if (!plain || plain.length < OVERHEAD || plain[0] !== LINK.protocol) return this.refuse(encoded);
    const body = plain.subarray(0, -4), end = plain.length;
    const crc = (plain[end - 4] | (plain[end - 3] << 8) | (plain[end - 2] << 16) | (plain[end - 1] << 24)) >>> 0;
    if (crc32(body) !== crc) return this.refuse(encoded);
    const seq = plain[2], gap = (seq - this.expected) & 255;
    if (this.expected >= 0 && gap !== 255) this.lost += gap;
    this.expected = (seq + 1) & 255;
    this.synchronised = true;
    this.ok++;
    return { id: plain[1], payload: body.slice(3) };
  }

  refuse(encoded) {
    this.dropped += encoded.length;
    this.bad += this.synchronised ? 1 : 0;
    this.synchronised = true;
    return null;
  }

  restart() { Object.assign(this, { partial: new Uint8Array(0), overlong: false, synchronised: false, expected: -1 }); }
}

const WIDTHS = [0, 2, 4, 8, 16, 32];
const BASES = CHANNELS.map(([, code]) => ({ size: SIZES[code], signed: code === code.toLowerCase() }));

// Unpacks a batch: {first, raw: one array a channel}; null if it does not fit the declaration. Half of the time of the
// small host was spent here while each channel had closures and a buffer of its own.
export function unpackTelemetry(payload) {
  const head = unpack("telemetry", payload), channels = CHANNELS.length;
  if (!head || !head.count) return null;
  const { first_tick: first, count } = head, view = new DataView(payload.buffer, payload.byteOffset, payload.length);
  const codesAt = sizeOf("telemetry"), widths = [];
  let at = codesAt + ((channels + 1) >> 1), size = at;
  for (let c = 0; c < channels; c++) {
    widths[c] = WIDTHS[(payload[codesAt + (c >> 1)] >> (4 * (c & 1))) & 15];
    size += BASES[c].size + ((widths[c] * (count - 1) + 7) >> 3);
  }
  if (payload.length !== size) return null; // also where a width is unknown: the size is NaN
  const all = new Int32Array(count * channels), raw = [];
  for (let c = 0; c < channels; c++) {
    const { size: bytes, signed } = BASES[c];
    all[c * count] = bytes === 1 ? (signed ? view.getInt8(at) : payload[at]) : bytes === 2 ? (signed ? view.getInt16(at, true) : view.getUint16(at, true)) : view.getInt32(at, true);
    at += bytes;
  }
  for (let c = 0; c < channels; c++) {
    const width = widths[c], base = c * count;
    let value = all[base];
    if (width === 0) all.fill(value, base, base + count);
    else for (let i = 1; i < count; i++) {
      const bit = width * (i - 1), byte = at + (bit >> 3);
      value = (value + (width === 32 ? view.getInt32(byte, true) : width === 16 ? view.getInt16(byte, true) : (payload[byte] << (32 - width - (bit & 7))) >> (32 - width))) | 0;
      all[base + i] = value;
    }
    at += (width * (count - 1) + 7) >> 3;
    raw.push(all.subarray(base, base + count));
  }
  return { first, raw };
}
