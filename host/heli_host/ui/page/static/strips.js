// Signals against time: one strip a quantity, one time axis for all, with pause, zoom and a cursor.
/* global uPlot */

const DEG = 180 / Math.PI;
const STRIPS = [
  { title: "elevation, deg", series: [["elevation_rad", "elevation", "#0b5394"], ["elevation_setpoint_rad", "setpoint", "#b45f06"]] },
  { title: "pitch, deg", series: [["pitch_rad", "pitch", "#0b5394"], ["pitch_setpoint_rad", "setpoint", "#b45f06"]] },
  { title: "travel, deg", series: [["travel_rad", "travel", "#0b5394"], ["travel_setpoint_rad", "setpoint", "#b45f06"]] },
  { title: "motors, V", series: [["front_V", "front", "#14602c"], ["back_V", "back", "#741b47"]] },
];
const MAX_DRAWN = 1e12; // of a program's signal: far beyond, uPlot's axis fails, and the drawing of all else with it
const TIME_AXIS = 34; // height of the time axis [px], below the lowest strip only
const INTERVAL_MS = 60;
const LONGEST_MS = 600; // between two drawings, where the browser draws slowly: it has more to do than strips

export class Strips {
  constructor(holder, history, tickS) {
    Object.assign(this, { holder, history, tickS, spanS: 20, view: null, drawnMs: 0, frameMs: 0, frameCostMs: 16, changed: true });
    this.own = new Map(); // signals that programs sent: name -> {x: [], y: []}
    this.onView = () => {};
    this.plots = [];
    this.build();
    new ResizeObserver(() => this.resize()).observe(holder);
  }

  build() {
    for (const plot of this.plots) plot.u.destroy();
    this.holder.replaceChildren();
    const known = new Map(this.history.channels.map((spec, index) => [spec.name, index]));
    const strips = STRIPS.map(({ title, series }) => ({
      title, series: series.map(([, label, stroke]) => ({ label, stroke })),
      wanted: series.map(([name]) => ({ channel: known.get(name), factor: this.history.channels[known.get(name)].unit === "rad" ? DEG : 1 })),
    }));
    const colours = ["#0b5394", "#b45f06", "#14602c", "#741b47", "#351c75"];
    this.named = JSON.stringify(this.signals());
    if (this.signals().length)
      strips.push({ title: "law", series: this.signals().map((spec, i) => ({ label: spec.signal, stroke: colours[i] })), wanted: this.signals().map((spec) => ({ channel: known.get(spec.name), factor: 1 })) });
    if (this.own.size)
      strips.push({ title: "programs", series: [...this.own.keys()].map((label, i) => ({ label, stroke: colours[i % colours.length] })), wanted: null });
    this.plots = strips.map(({ title, series, wanted }, i) => ({ wanted, u: this.plot(title, series, i === strips.length - 1) }));
    this.resize();
    this.changed = true;
  }

  // Channels that hold a signal of a law that came over the link.
  signals() { return this.history.channels.filter((spec) => spec.signal); }

  rename() { if (JSON.stringify(this.signals()) !== this.named) this.build(); }

  // Of one strip: its part of the height without its legend; the lowest strip has the time axis as well.
  size(isLowest) {
    const legends = this.plots.reduce((sum, { u }) => sum + (u?.root.querySelector(".u-legend").offsetHeight ?? 0), 0);
    const each = Math.max(44, Math.floor((this.holder.clientHeight - legends - TIME_AXIS) / this.plots.length));
    return { width: this.holder.clientWidth, height: each + (isLowest ? TIME_AXIS : 0) };
  }

  plot(title, series, isLowest) {
    const value = (_, v) => (v == null || Number.isNaN(v) ? "–" : v.toFixed(2));
    return new uPlot({
      width: this.holder.clientWidth, height: 100, pxAlign: 0,
      cursor: { sync: { key: "strips" }, drag: { x: true, y: false, setScale: false } },
      legend: { live: true },
      scales: { x: { time: false, auto: false }, y: { range: (_, low, high) => padded(low, high) } },
      padding: [6, 28, 0, 0],
      axes: [{ size: isLowest ? TIME_AXIS : 4, ticks: { show: isLowest }, values: (_, splits) => splits.map((s) => (isLowest ? `${+s.toFixed(3)} s` : "")) }, { size: 52, splits: (u, _, low, high) => ticks(low, high, u.over.clientHeight), label: title, labelSize: 18, labelFont: "12px system-ui, 'DejaVu Sans', sans-serif" }],
      series: [{ label: "time", value: (_, v) => (v == null ? "–" : `${v.toFixed(3)} s`) }, ...series.map((one) => ({ ...one, width: 1.5, value, points: { show: false } }))],
      hooks: {
        setSelect: [(u) => {
          if (u.select.width < 4 || !u.over.matches(":hover")) return; // the others only follow
          this.show(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
          u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
        }],
        ready: [(u) => {
          u.over.addEventListener("dblclick", () => this.follow());
          u.over.addEventListener("wheel", (event) => {
            event.preventDefault();
            const [from, to] = this.range(), at = u.posToVal(event.offsetX, "x"), by = event.deltaY > 0 ? 1.25 : 0.8;
            this.show(at - (at - from) * by, at + (to - at) * by);
          }, { passive: false });
        }],
      },
    }, [[], ...series.map(() => [])], this.holder);
  }

  signal(name, tick, value) {
    const isNew = !this.own.has(name);
    if (isNew) this.own.set(name, { x: [], y: [] });
    const { x, y } = this.own.get(name);
    x.push(tick * this.tickS);
    y.push(Math.abs(value) < MAX_DRAWN ? value : null);
    if (x.length > 20000) { x.splice(0, 5000); y.splice(0, 5000); }
    if (isNew) this.build();
    this.changed = true;
  }

  range() {
    if (this.view) return this.view;
    const nowS = this.history.latestTick * this.tickS;
    return [nowS - this.spanS, nowS];
  }

  show(fromS, toS) {
    const least = 0.02;
    this.view = toS - fromS < least ? [fromS, fromS + least] : [fromS, toS];
    this.changed = true;
    this.onView();
  }

  follow(spanS = this.spanS) {
    this.spanS = spanS;
    this.view = null;
    this.changed = true;
    this.onView();
  }

  pause() { this.show(...this.range()); }

  resize() { this.plots.forEach(({ u }, i) => u.setSize(this.size(i === this.plots.length - 1))); }

  // Between two drawings, of the rig too.
  get intervalMs() { return Math.min(Math.max(INTERVAL_MS, 3 * this.frameCostMs), LONGEST_MS); }

  draw(nowMs) {
    this.frameCostMs += 0.2 * (Math.min(nowMs - this.frameMs, 1000) - this.frameCostMs);
    this.frameMs = nowMs;
    if (!(this.changed || this.view === null) || nowMs - this.drawnMs < this.intervalMs || document.hidden) return;
    this.drawnMs = nowMs;
    this.changed = false;
    const [from, to] = this.range();
    const most = Math.max(200, this.holder.clientWidth);
    for (const { wanted, u } of this.plots) {
      const data = wanted ? this.history.window(from / this.tickS, to / this.tickS, wanted, most, this.tickS) : joined([...this.own.values()]);
      u.setData(data, false);
      u.setScale("x", { min: from, max: to });
      // Without a cursor the legend shows the newest values.
      if (u.cursor.idx == null) u.setLegend({ idxs: data.map((all) => newest(all)) }, false);
    }
  }
}

function padded(low, high) {
  if (low == null || !Number.isFinite(low)) return [-1, 1];
  const room = Math.max(0.08 * (high - low), 0.5);
  return [low - room, high + room];
}

// Ticks at round numbers: as few as fit, and never fewer than two.
function ticks(low, high, height) {
  const least = height < 90 ? 2 : 3;
  for (let power = Math.ceil(Math.log10(high - low)); ; power--)
    for (const part of [5, 2, 1]) {
      const step = part * 10 ** power, first = Math.ceil(low / step), last = Math.floor(high / step);
      if (last - first + 1 >= least) return Array.from({ length: last - first + 1 }, (_, i) => +((first + i) * step).toPrecision(12));
    }
}

// Place of the last value in a series, null without any.
function newest(values) {
  for (let i = values.length - 1; i >= 0; i--) if (values[i] != null) return i;
  return null;
}

// Series with times of their own on one axis, null where one has no value.
function joined(all) {
  const x = [...new Set(all.flatMap((one) => one.x))].sort((a, b) => a - b);
  const place = new Map(x.map((time, index) => [time, index]));
  return [x, ...all.map((one) => {
    const y = new Array(x.length).fill(null);
    one.x.forEach((time, index) => { y[place.get(time)] = one.y[index]; });
    return y;
  })];
}
