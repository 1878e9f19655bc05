// Plans as setpoints over time; the tables come from Python, which has read and checked them (heli_host.fly.plan).

const AXES = ["elevation", "pitch", "travel"];
const smooth = (share) => share * share * (3 - 2 * share);
const clip = (value, low, high) => Math.min(Math.max(value, low), high);
const hold = (at) => () => at;

function ramp(from, to, durationS) { return (t) => from.map((start, i) => start + clip(t / durationS, 0, 1) * (to[i] - start)); }

function targets(row, at) { return AXES.map((axis, i) => row[`${axis}_deg`] ?? at[i]); }

// Duration and shape of a segment that begins at the setpoints `at` [deg].
const KINDS = {
  hold: (row, at) => [row.duration_s, hold(at)],
  excite: (row, at) => [row.duration_s, hold(at)],
  land: (row, at) => [0, hold(at)],
  step: (row, at) => [row.duration_s, hold(targets(row, at))],
  ramp(row, at) {
    const to = targets(row, at), distance = Math.max(...to.map((value, i) => Math.abs(value - at[i])));
    const durationS = Math.max(row.duration_s ?? distance / row.rate_deg_s, 1e-3);
    return [durationS, ramp(at, to, durationS)];
  },
  sine(row, at) {
    const period = (prefix) => row[`${prefix}period_s`] ?? (row[`${prefix}frequency_Hz`] ? 1 / row[`${prefix}frequency_Hz`] : undefined);
    const amplitude = AXES.map((axis) => row[`${axis}_amplitude_deg`] ?? 0);
    const periodS = AXES.map((axis, i) => (amplitude[i] ? period(`${axis}_`) ?? period("") : 1)), durationS = row.duration_s;
    return [durationS, (t) => at.map((start, i) => {
      const fadeS = Math.min(0.5 * periodS[i], 0.5 * durationS), envelope = smooth(clip(Math.min(t, durationS - t) / fadeS, 0, 1));
      return start + amplitude[i] * envelope * Math.sin((2 * Math.PI * t) / periodS[i]);
    })];
  },
  waypoints(row, at) {
    const isSmooth = (row.path ?? "smooth") === "smooth";
    const columns = AXES.map((axis, i) => {
      const points = row.points.filter((point) => point[`${axis}_deg`] !== undefined).map((point) => [point.at_s, point[`${axis}_deg`]]);
      return points.length && points[0][0] === 0 ? points : [[0, at[i]], ...points];
    });
    return [row.duration_s ?? row.points.at(-1).at_s, (t) => columns.map((points) => {
      if (points.length < 2) return points[0][1];
      const found = points.findLastIndex(([atS]) => atS <= t), first = clip(found, 0, points.length - 2);
      const [[t0, v0], [t1, v1]] = [points[first], points[first + 1]], share = clip((t - t0) / (t1 - t0), 0, 1);
      return v0 + (isSmooth ? smooth(share) : share) * (v1 - v0);
    })];
  },
};

export class Route {
  constructor(startDeg) { Object.assign(this, { startDeg, pieces: [], durationS: 0, endDeg: startDeg }); }

  add(phase, name, durationS, shape, excitation = null) {
    this.pieces.push({ phase, name, startS: this.durationS, durationS, shape, excitation });
    this.durationS += durationS;
    this.endDeg = shape(durationS);
  }

  pieceAt(t) { return t < 0 || t >= this.durationS ? null : this.pieces.findLast((piece) => piece.startS <= t); }

  evaluate(t) {
    const piece = this.pieces.findLast(({ startS }) => startS <= t);
    return piece ? piece.shape(Math.min(t - piece.startS, piece.durationS)) : this.startDeg;
  }
}

// Take-off and plans as one route, from the arm's present angles [deg].
export function takeOffRoute(plans, startDeg) {
  const route = new Route([startDeg[0], 0, startDeg[2]]);
  plans.forEach(({ name, table }, number) => {
    const start = { elevation_deg: 0, rate_deg_s: 8, settle_s: 4, ...table.start }, from = route.endDeg, to = [start.elevation_deg, from[1], from[2]];
    const durationS = Math.max(...to.map((value, i) => Math.abs(value - from[i]))) / start.rate_deg_s, phase = number ? name : "take-off";
    if (durationS > 0) route.add(phase, "rise", durationS, ramp(from, to, durationS));
    if (!number && start.settle_s > 0) route.add(phase, "settle", start.settle_s, hold(to));
    for (const row of table.segment) {
      const [segmentS, shape] = KINDS[row.kind](row, route.endDeg);
      const excitation = row.kind === "excite" ? row : row.excite;
      if (segmentS > 0) route.add(name, row.kind, segmentS, shape, excitation && { ...excitation, duration_s: segmentS });
    }
  });
  return route;
}

export function closedAxes(plans) { return plans[0].table.axes ?? AXES; }

// Tracking errors of a flight, as heli_host.fly.tracking judges them.
export class Tracking {
  constructor(plans, axes) {
    this.axes = axes;
    this.bounds = AXES.map((axis) => Math.max(...plans.map(({ table }) => table.tolerance?.[`${axis}_deg`] ?? { elevation: 3, pitch: 15, travel: 15 }[axis])));
    this.forS = Math.max(...plans.map(({ table }) => table.tolerance?.for_s ?? 2));
    Object.assign(this, { beyondMs: [0, 0, 0], peak: [0, 0, 0], longestS: [0, 0, 0], worstDeg: [0, 0, 0], unreached: "" });
  }

  // Errors of one tick [deg].
  take(errors, isFlown) {
    for (let i = 0; i < errors.length; i++) {
      const error = errors[i];
      if (!isFlown || error <= this.bounds[i] || !this.axes.includes(AXES[i])) {
        this.beyondMs[i] = this.peak[i] = 0;
        continue;
      }
      this.beyondMs[i]++;
      this.peak[i] = Math.max(this.peak[i], error);
      if (this.beyondMs[i] / 1000 > this.longestS[i]) [this.longestS[i], this.worstDeg[i]] = [this.beyondMs[i] / 1000, this.peak[i]];
    }
  }

  // The end of a step: the board's setpoint must be at its target, or the arm; at the end of the route the arm.
  takeEnd(piece, angles, setpoints, isLast) {
    if (this.unreached || piece.name !== "step") return;
    const end = piece.shape(piece.durationS);
    AXES.forEach((axis, i) => {
      if (this.unreached || !this.axes.includes(axis) || (axis === "pitch" && this.axes.includes("travel"))) return;
      const nearest = Math.min(Math.abs(angles[i] - end[i]), isLast ? Infinity : Math.abs(setpoints[i] - end[i]));
      if (nearest > this.bounds[i]) this.unreached = `not_tracked: ${axis} was at ${angles[i].toFixed(1)} degrees when its step to ${+end[i].toPrecision(6)} ended (allowed: ${this.bounds[i]} from it); give the segment more time, because the board moves the setpoint by at most ${axis}_slew_deg_s`;
    });
  }

  verdict() {
    const i = this.longestS.findIndex((longest) => longest > this.forS);
    if (i < 0) return this.unreached;
    return `not_tracked: ${AXES[i]} was up to ${this.worstDeg[i].toFixed(1)} degrees from its setpoint for ${this.longestS[i].toFixed(1)} s (allowed: ${this.bounds[i]} for ${this.forS} s); tune the gains for this rig, or widen [tolerance] of the plan`;
  }
}
