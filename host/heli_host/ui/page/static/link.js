// The two sockets: one for everything, in a thread of its own, one for the stop alone. See docs/reference/dashboard-protocol.md for what
// goes over them.

const HEADER = 24;
const query = new URLSearchParams(location.search);
const token = query.get("token") ?? "";

function address(path, more = {}) {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  return `${scheme}//${location.host}${path}?${new URLSearchParams({ token, ...more })}`;
}

// An id that outlives reloading the page, so that its control lease stays valid.
function ownId() {
  return sessionStorage.getItem("client") ||
    Array.from(crypto.getRandomValues(new Uint8Array(8)), (b) => b.toString(16).padStart(2, "0")).join("");
}

export function unpack(buffer) {
  const head = new DataView(buffer);
  const flags = head.getUint8(1), channels = head.getUint16(2, true), rows = head.getUint32(8, true);
  const raw = [];
  for (let c = 0; c < channels; c++) raw.push(new Int32Array(buffer, HEADER + 4 * rows * (1 + c), rows));
  return {
    thinned: (flags & 1) !== 0, reset: (flags & 2) !== 0, number: head.getUint32(4, true), rows, state: head.getUint8(12),
    first: head.getFloat64(16, true), offset: new Uint32Array(buffer, HEADER, rows), raw,
  };
}

export class Link {
  constructor({ onWords, onRows, onOpen, onClosed, onBeat }) {
    Object.assign(this, { onWords, onRows, onOpen, onClosed, onBeat });
    this.waiting = new Map();
    this.number = 0;
    this.isOpen = false;
    this.socket = new Worker("socket.js");
    this.socket.onmessage = ({ data }) => {
      if (data.words) this.take(data.words, data.cameMs);
      else if (data.rows) {
        const frame = unpack(data.rows);
        this.onRows(frame);
        // Says that these were shown, and that this page lives: without it setpoints go missing to the board.
        this.socket.postMessage({ shown: frame.number });
      } else if (data.nowMs) this.onBeat(data.nowMs);
      else if (data.open) this.opened(data.cameMs);
      else this.closed();
    };
    this.connectAs(ownId());
  }

  // Connects, or names this page differently when it connects again.
  connectAs(client) {
    sessionStorage.setItem("client", client);
    this.socket.postMessage({ address: address("/ws", { client }) });
  }

  opened(cameMs) {
    this.isOpen = true;
    this.onOpen(cameMs);
  }

  closed() {
    this.isOpen = false;
    for (const settle of this.waiting.values()) settle({ error: "the connection was lost", remedy: "wait until it is back" });
    this.waiting.clear();
    this.onClosed();
  }

  take(words, cameMs) {
    if ("answer" in words) {
      this.waiting.get(words.answer)?.(words);
      this.waiting.delete(words.answer);
    } else {
      // The server gives another id while the page before a reload, or the original of a duplicated tab, is connected.
      if (words.hello) this.connectAs(words.hello.you);
      this.onWords(words, cameMs);
    }
  }

  ask(name, more = {}) {
    if (!this.isOpen)
      return Promise.resolve({ error: "there is no connection", remedy: "wait until it is back" });
    const id = ++this.number;
    this.socket.postMessage({ text: JSON.stringify({ do: name, id, ...more }) });
    return new Promise((settle) => this.waiting.set(id, settle));
  }
}

export class Stop {
  constructor(onAnswer) {
    this.onAnswer = onAnswer;
    this.open();
  }

  open() {
    this.socket = new WebSocket(address("/stop"));
    this.socket.onmessage = ({ data }) => this.onAnswer(data);
    this.socket.onclose = () => setTimeout(() => this.open(), 500);
  }

  now() {
    if (this.socket.readyState === WebSocket.OPEN) return this.socket.send("stop");
    fetch(`/stop?${new URLSearchParams({ token })}`, { method: "POST", keepalive: true })
      .then(async (answer) => this.onAnswer((await answer.text()).trim()))
      .catch(() => this.onAnswer("error: the server does not answer; use the rig's own stop switch"));
  }
}
