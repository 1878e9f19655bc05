// Compares angles at rest. Standard input: [[elevation, pitch, tilt of the hover, elevations, pitches after the landing]]
// [deg], null for a number that is not known; what differs goes to standard output.
import { readFileSync } from "node:fs";
import { RestAngles } from "../../sim/web/heli_web/page/rest.js";

const shifts = JSON.parse(readFileSync(0, "utf8")).map(([elevation, pitch, tilt, elevations, pitches]) => {
  const before = new RestAngles([elevation], [pitch ?? NaN], 0.1);
  before.hover.meanDeg = tilt ?? NaN;
  return before.shiftAfter(elevations, pitches);
});
process.stdout.write(JSON.stringify(shifts));
