// Draws three numbers from -50,000 to 50,000, and anew a whole number below 2^31 - 2, of each seed.
import { readFileSync } from "node:fs";
import { Generator } from "../../sim/web/heli_web/page/random.js";

const draws = JSON.parse(readFileSync(0, "utf8")).map((seed) => {
  const numbers = new Generator(seed);
  return [...[0, 1, 2].map(() => numbers.uniform(-5e4, 5e4)), new Generator(seed).integer(2 ** 31 - 2)];
});
process.stdout.write(JSON.stringify(draws));
