// Every row that came, as raw numbers, in rings; and rows to draw: all of them, or the least and most of equal pieces.

const CAPACITY = 1 << 19; // 524 s of ticks: the longest span, and as much again to scroll back

export class History {
  constructor(channels) {
    this.channels = channels;
    this.tick = new Float64Array(CAPACITY);
    this.raw = channels.map(() => new Int32Array(CAPACITY));
    this.clear();
  }

  clear() {
    this.begin = this.end = 0; // positions: rows ever written; the place in the rings is modulo their length
    this.gaps = 0;
    this.thinned = 0;
  }

  get latestTick() { return this.end > this.begin ? this.tick[(this.end - 1) % CAPACITY] : 0; }

  latest(channel) { return this.end > this.begin ? this.raw[channel][(this.end - 1) % CAPACITY] * this.channels[channel].scale : NaN; }

  append(frame) {
    if (frame.reset && this.end > this.begin && frame.rows && frame.first <= this.latestTick) this.clear();
    if (!frame.rows) return;
    if (frame.thinned && this.end > this.begin) this.thinned++;
    else if (this.end > this.begin && frame.first !== this.latestTick + 1) this.gaps++;
    for (let from = 0; from < frame.rows;) {
      const place = this.end % CAPACITY, count = Math.min(frame.rows - from, CAPACITY - place);
      for (let i = 0; i < count; i++) this.tick[place + i] = frame.first + frame.offset[from + i];
      frame.raw.forEach((values, c) => this.raw[c].set(values.subarray(from, from + count), place));
      this.end += count;
      from += count;
    }
    this.begin = Math.max(this.begin, this.end - CAPACITY);
  }

  // First position whose tick is not before this one.
  find(tick) {
    let low = this.begin, high = this.end;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.tick[middle % CAPACITY] < tick) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  // Rows between two ticks for channels, in shown units: [x, y of the first channel, ...]. Where there are more than
  // `most`, each piece gives its least and its most, in the order in which they came.
  window(fromTick, toTick, wanted, most, tickS) {
    const start = this.find(fromTick), stop = Math.min(this.find(toTick + 1), this.end);
    const step = Math.max(1, Math.ceil((stop - start) / most));
    const rows = step === 1 ? stop - start : 2 * Math.ceil((stop - start) / step);
    const x = new Float64Array(rows), ys = wanted.map(() => new Float64Array(rows));
    const factors = wanted.map(({ channel, factor }) => this.channels[channel].scale * factor);
    if (step === 1) {
      for (let i = 0; i < rows; i++) {
        const place = (start + i) % CAPACITY;
        x[i] = this.tick[place] * tickS;
        for (let w = 0; w < wanted.length; w++) ys[w][i] = this.raw[wanted[w].channel][place] * factors[w];
      }
      return [x, ...ys];
    }
    // Pieces begin at multiples of the step, so that they do not flicker as time goes on.
    let out = 0;
    for (let from = start; from < stop; from += step, out += 2) {
      const until = Math.min(from + step, stop);
      x[out] = this.tick[from % CAPACITY] * tickS;
      x[out + 1] = this.tick[(until - 1) % CAPACITY] * tickS;
      for (let w = 0; w < wanted.length; w++) {
        const values = this.raw[wanted[w].channel];
        let least = Infinity, most_ = -Infinity, leastAt = 0, mostAt = 0;
        for (let p = from; p < until; p++) {
          const v = values[p % CAPACITY];
          if (v < least) { least = v; leastAt = p; }
          if (v > most_) { most_ = v; mostAt = p; }
        }
        ys[w][out] = (leastAt <= mostAt ? least : most_) * factors[w];
        ys[w][out + 1] = (leastAt <= mostAt ? most_ : least) * factors[w];
      }
    }
    return [x, ...ys];
  }
}
