// The page's socket in a thread of its own: a page that draws slowly, or loads, still answers that it is there.
// A page that hangs for longer does not: nobody can fly from it.
const HUNG_MS = 3000;
const SIGN_MS = 100;
let socket = null, shown = 0, shownMs = -Infinity, signedMs = -Infinity;

function sign() {
  if (socket?.readyState !== WebSocket.OPEN) return;
  socket.send(new Uint32Array([shown]));
  signedMs = performance.now();
}

function open(address) {
  socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => postMessage({ open: true, cameMs: performance.now() });
  // With the time at which words came: how old a status is must not depend on how slowly the page draws.
  socket.onmessage = ({ data }) => (typeof data === "string" ? postMessage({ words: JSON.parse(data), cameMs: performance.now() }) : postMessage({ rows: data }, [data]));
  socket.onclose = () => {
    [shown, shownMs] = [0, -Infinity]; // numbers of frames begin anew
    postMessage({ open: false });
    setTimeout(() => open(address), 500);
  };
}

onmessage = ({ data }) => {
  if (data.address) open(data.address);
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
