// Decompresses the chunks of logs that heli-host has written.
import { decompress } from "./vendor/fzstd.js";

export function unpackZstd(packed, size) {
  const body = decompress(packed);
  if (body.length !== size) throw new RangeError("a chunk does not have its stated size");
  return body;
}
