// Random numbers of numpy's default_rng (PCG64, seeded by SeedSequence), so that a seed gives the same rig here and in
// heli_sim.

const MASK_128 = (1n << 128n) - 1n, MULTIPLIER = 0x2360ed051fc65da44385df649fccf645n;

// SeedSequence(seed).generate_state(8) of a seed below 2^32.
function seedWords(seed) {
  let constant = 0x43b0d7e5;
  const hash = (value) => {
    value ^= constant;
    constant = Math.imul(constant, 0x931e8875);
    value = Math.imul(value, constant);
    return value ^ (value >>> 16);
  };
  const mix = (x, y) => {
    const mixed = (Math.imul(0xca01f9dd, x) - Math.imul(0x4973f715, y)) | 0;
    return mixed ^ (mixed >>> 16);
  };
  const pool = [seed, 0, 0, 0].map(hash), words = [];
  for (let from = 0; from < 4; from++) for (let to = 0; to < 4; to++) if (from !== to) pool[to] = mix(pool[to], hash(pool[from]));
  constant = 0x8b51f9dd;
  for (let i = 0; i < 8; i++) {
    let value = pool[i % 4] ^ constant;
    constant = Math.imul(constant, 0x58f38ded);
    value = Math.imul(value, constant);
    words.push(BigInt((value ^ (value >>> 16)) >>> 0));
  }
  return words;
}

export class Generator {
  constructor(seed) {
    const words = seedWords(seed), whole = (i) => (((words[i + 1] << 32n) | words[i]) << 64n) | (words[i + 3] << 32n) | words[i + 2];
    this.increment = ((whole(4) << 1n) | 1n) & MASK_128;
    this.state = (this.increment + whole(0)) & MASK_128;
    this.step();
    this.half = null;
  }

  step() { this.state = (this.state * MULTIPLIER + this.increment) & MASK_128; }

  bits64() {
    this.step();
    const turn = this.state >> 122n, folded = (this.state >> 64n) ^ (this.state & 0xffffffffffffffffn);
    return ((folded >> turn) | (folded << ((64n - turn) & 63n))) & 0xffffffffffffffffn;
  }

  // The lower half of 64 bits, then the upper one.
  bits32() {
    if (this.half !== null) {
      const upper = this.half;
      this.half = null;
      return upper;
    }
    const bits = this.bits64();
    this.half = bits >> 32n;
    return bits & 0xffffffffn;
  }

  uniform(low, high) { return low + (high - low) * (Number(this.bits64() >> 11n) / 9007199254740992); }

  // A whole number from 0 to `count` - 1; count at most 2^32 (Lemire's method, as numpy's).
  integer(count) {
    const range = BigInt(count), least = ((1n << 32n) - range) % range;
    let product = this.bits32() * range;
    while ((product & 0xffffffffn) < least) product = this.bits32() * range;
    return Number(product >> 32n);
  }
}
