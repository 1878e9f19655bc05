// The page's socket in a thread of its own: a page that draws slowly, or loads, still answers that it is there.
// A page that hangs for longer does not: nobody can fly from it.
const HUNG_MS = 3000;
const SIGN_MS = 100;
const STALE_MS = 600; // as in main.js
const DRIFT = 1e-4; // between the clocks of two computers
let offsetMs = Infinity, heardMs = 0; // from the server's clock to this one, by the status that was fastest
let address = "", socket = null, shown = 0, shownMs = -Infinity, signedMs = -Infinity;

function sign() {
  if (socket?.readyState !== WebSocket.OPEN) return;
  socket.send(new Uint32Array([shown]));
  signedMs = performance.now();
}

// When a status would have come without a delay. One that waited in the socket while this computer suspended the page is
// not shown: it would pass for the present.
function take(text, nowMs) {
  const words = JSON.parse(text);
  if (words.status?.sent_s === undefined) return { words, cameMs: nowMs };
  const sentMs = 1e3 * words.status.sent_s;
  offsetMs = Math.min(offsetMs + DRIFT * (nowMs - heardMs), nowMs - sentMs);
  heardMs = nowMs;
  const cameMs = sentMs + offsetMs;
  if (!words.hello && nowMs - cameMs > STALE_MS) delete words.status;
  return { words, cameMs };
}

function open() {
  socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  offsetMs = Infinity;
  socket.onopen = () => postMessage({ open: true, cameMs: performance.now() });
  // With the time: how old a status is must not depend on how slowly the page draws.
  socket.onmessage = ({ data }) => (typeof data === "string" ? postMessage(take(data, performance.now())) : postMessage({ rows: data }, [data]));
  socket.onclose = () => {
    [shown, shownMs] = [0, -Infinity]; // numbers of frames begin again
    postMessage({ open: false });
    setTimeout(open, 500);
  };
}

onmessage = ({ data }) => {
  if (data.address) {
    address = data.address;
    if (!socket) open();
  }
  else if (data.text) socket.send(data.text);
  else {
    [shown, shownMs] = [data.shown, performance.now()];
    sign();
  }
};
setInterval(() => {
  const nowMs = performance.now();
  postMessage({ nowMs });
  if (nowMs - shownMs < HUNG_MS && nowMs - signedMs >= SIGN_MS) sign();
}, SIGN_MS);
