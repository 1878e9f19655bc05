// Compares the angles at rest before the take-off with those after the landing, as heli_host.board.rest_check: the
// numbers are explained there, and a test plays the same angles through both.

const MAX_SHIFT_DEG = 1, FIRST_LOOK_TICKS = 200, SETTLED_TICKS = 2000, SETTLED_DEG = 0.5, LONGEST_TICKS = 15000;
const TURNED_SHARE = 0.25, HOVER_TICKS = [4000, 5500], HOVER_DEG = 2, STILL_COUNTS = 1.5;

const spread = (values) => values.reduce((most, value) => Math.max(most, value), -Infinity) - values.reduce((least, value) => Math.min(least, value), Infinity);
const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;

// The mean pitch of a hover some seconds after the take-off began [deg].
class HoverTilt {
  constructor() { Object.assign(this, { meanDeg: NaN, startTick: null, sum: 0, count: 0 }); }

  // Takes successive ticks, of which `tick` is the newest; readPitch returns their pitch [deg].
  take(tick, isInTheAir, readPitch) {
    if (!Number.isNaN(this.meanDeg)) return;
    if (this.startTick === null) {
      if (isInTheAir) this.startTick = tick;
      return;
    }
    if (tick - this.startTick >= HOVER_TICKS[0]) {
      const pitchDeg = readPitch();
      this.sum += pitchDeg.reduce((sum, value) => sum + value, 0);
      this.count += pitchDeg.length;
    }
    if (tick - this.startTick >= HOVER_TICKS[1]) this.meanDeg = this.sum / this.count;
  }
}

export class RestAngles {
  // From the samples before the motors are armed [deg]; countDeg: the angle of a count of the pitch encoder.
  constructor(elevationDeg, pitchDeg, countDeg) {
    const isStill = !pitchDeg.length || spread(pitchDeg) <= STILL_COUNTS * countDeg;
    Object.assign(this, { elevationDeg: elevationDeg.at(-1), pitchDeg: isStill ? pitchDeg.at(-1) : NaN, countDeg, hover: new HoverTilt() });
  }

  // From the samples since the landing; null while they do not show it, empty if no axis is shifted.
  shiftAfter(elevationDeg, pitchDeg) {
    if (pitchDeg.length < FIRST_LOOK_TICKS) return null;
    let pitch = this.settledPitch(pitchDeg);
    const elevation = this.settledElevation(elevationDeg);
    if (pitch === null || elevation === null) return null;
    if (this.isHeld(pitchDeg[0], pitch)) pitch = this.pitchDeg;
    const shifted = Object.entries({ elevation: [this.elevationDeg, elevation], pitch: [this.pitchDeg, pitch] }).filter(([, [before, after]]) => Math.abs(after - before) > MAX_SHIFT_DEG);
    if (!shifted.length) return "";
    const words = shifted.map(([axis, [before, after]]) => `${axis} at rest was ${before.toFixed(1)} degrees before the take-off and is ${after.toFixed(1)} after the landing, a difference of ${(after - before).toFixed(1)}`);
    return `angle_shifted: ${words.join(", ")} (allowed: ${MAX_SHIFT_DEG}); do not use the angles of this flight: check plug and cable of the ${shifted.map(([axis]) => axis).join(" and ")} encoder, let the arm rest, then zero it`;
  }

  isHeld(landedDeg, restDeg) {
    const stayed = Math.abs(restDeg - landedDeg) < TURNED_SHARE * Math.abs(restDeg - this.pitchDeg), hoverDeg = this.hover.meanDeg;
    return stayed && Math.min(0, hoverDeg) - HOVER_DEG <= landedDeg && landedDeg <= Math.max(0, hoverDeg) + HOVER_DEG;
  }

  settledElevation(elevationDeg) {
    const nearest = elevationDeg.slice(0, FIRST_LOOK_TICKS).reduce((best, value) => (Math.abs(value - this.elevationDeg) < Math.abs(best - this.elevationDeg) ? value : best));
    if (nearest - this.elevationDeg <= MAX_SHIFT_DEG) return nearest;
    if (elevationDeg.length < SETTLED_TICKS) return null;
    return spread(elevationDeg.slice(0, SETTLED_TICKS)) <= SETTLED_DEG ? nearest : this.elevationDeg;
  }

  settledPitch(pitchDeg) {
    if (Number.isNaN(this.pitchDeg)) return this.pitchDeg;
    const isNear = (values) => values.every((value) => Math.abs(value - this.pitchDeg) <= MAX_SHIFT_DEG);
    let newest = pitchDeg.slice(-FIRST_LOOK_TICKS);
    if (isNear(newest) && spread(newest) <= STILL_COUNTS * this.countDeg) return newest.at(-1);
    if (pitchDeg.length < SETTLED_TICKS) return null;
    newest = pitchDeg.slice(-SETTLED_TICKS);
    if (isNear(newest) || spread(newest) <= STILL_COUNTS * this.countDeg) return mean(newest);
    if (pitchDeg.length < LONGEST_TICKS) return null;
    newest = pitchDeg.slice(-2 * SETTLED_TICKS);
    const middle = mean(newest);
    return Math.abs(middle - this.pitchDeg) > 0.5 * spread(newest) + MAX_SHIFT_DEG ? middle : this.pitchDeg;
  }
}
