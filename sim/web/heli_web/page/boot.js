// Starts the page: unpacks its parts, puts a worker with board and host in the place of the dashboard's socket.
// Part of heli-lab.html, whose element "parts" holds everything as gzip in base64.
(async () => {
  const unpack = async (id) => {
    const packed = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };
  const fail = (words) => { document.getElementById("words").textContent = words; document.getElementById("board").textContent = ""; };
  if (!globalThis.WebAssembly || !globalThis.DecompressionStream) return fail("This browser is too old for the page: it needs WebAssembly and DecompressionStream (Chrome 103, Firefox 113, Safari 16.4).");
  const decoder = new TextDecoder(), parts = JSON.parse(decoder.decode(await unpack("parts")));
  const board = await unpack("board-module"), firmware = document.getElementById("firmware") ? JSON.parse(decoder.decode(await unpack("firmware"))) : null;
  const elf = firmware?.map(({ address, content }) => ({ address, bytes: Uint8Array.from(atob(content), (c) => c.charCodeAt(0)) })) ?? null;

  const blob = (text) => URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  const urls = {};
  for (const [name, text] of parts.modules) urls[name] = blob(text.replace(/(\bfrom\s*|\bimport\s*)"\.\/([\w./-]+)"/g, (whole, word, path) => {
    const found = Object.keys(urls).find((known) => known === path || known === `vendor/${path}`);
    return found ? `${word}"${urls[found]}"` : whole;
  }));
  let worker = null, lab = null;
  const Ordinary = globalThis.Worker;
  globalThis.Worker = class extends Ordinary {
    constructor() {
      super(blob(parts.worker));
      worker = this;
      this.addEventListener("message", ({ data }) => {
        if (data.words?.lab) lab.take(data.words.lab);
        if (data.file) lab.log(data.file);
      });
      this.onerror = ({ message }) => fail(`The simulation does not start: ${message}. Reload the page.`);
      this.postMessage({ facts: parts.facts, board, elf, settings: lab.settings });
    }
  };
  // The dashboard's socket of the stop, which leads to the worker here.
  globalThis.WebSocket = class {
    static OPEN = 1;
    readyState = 1;
    constructor() { setTimeout(() => worker.addEventListener("message", ({ data }) => { if (data.stopped) this.onmessage?.({ data: "stopped" }); })); }
    send() { worker.postMessage({ stop: true }); }
  };
  await new Promise((settle, failed) => document.head.append(Object.assign(document.createElement("script"), { src: blob(parts.uplot), onload: settle, onerror: failed })));
  const { buildLab } = await import(urls["lab.js"]);
  lab = buildLab(parts.facts, elf !== null, (message) => worker?.postMessage(message));
  globalThis.heliLab = lab;
  await import(urls["main.js"]);
})();
