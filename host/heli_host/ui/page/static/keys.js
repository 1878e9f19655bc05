// What hands do: the stop from anywhere, arrow keys and gamepad for the setpoint.

const GAMEPAD_DEG_S = { elevation: 8, travel: 12 };
const DEAD_ZONE = 0.15;
const STOP_BUTTONS = [1, 2, 3]; // all on the right but the lowest, whatever they are called

function writing(target) { return target instanceof HTMLInputElement && target.type !== "range"; }

// Space and Esc stop whatever has the focus; only while the motors are off for certain does a field for words get its
// spaces.
export function listenForStop(stop, motorsAreOff) {
  window.addEventListener("keydown", (event) => {
    if (event.code !== "Space" && event.key !== "Escape") return;
    if (event.code === "Space" && writing(event.target) && motorsAreOff()) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) stop();
  }, { capture: true });
  // A button is pressed when its space is released: without this, a stop would also press what has the focus.
  window.addEventListener("keyup", (event) => {
    if (event.code === "Space" && !writing(event.target)) { event.preventDefault(); event.stopImmediatePropagation(); }
  }, { capture: true });
  const button = document.getElementById("stop");
  // The press itself, not the click that follows when it is let go.
  button.addEventListener("pointerdown", (event) => { event.preventDefault(); button.focus(); stop(); });
  button.addEventListener("keydown", (event) => { if (event.key === "Enter" && !event.repeat) { event.preventDefault(); stop(); } });
}

export function listenForArrows(move, mark) {
  window.addEventListener("keydown", (event) => {
    if (event.target instanceof HTMLInputElement || event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.target.getAttribute?.("role") === "tab") return;
    const step = event.shiftKey ? 5 : 1;
    const moves = { ArrowUp: ["elevation", step], ArrowDown: ["elevation", -step], ArrowRight: ["travel", step], ArrowLeft: ["travel", -step] };
    if (moves[event.key]) { event.preventDefault(); move(...moves[event.key]); }
    else if (event.key.toLowerCase() === "m" && !event.repeat) mark();
  });
}

export class Gamepad {
  constructor(stop, move) {
    Object.assign(this, { stop, move, pressed: false, beforeMs: 0 });
  }

  poll(nowMs) {
    const passedS = Math.min((nowMs - this.beforeMs) / 1000, 0.1);
    this.beforeMs = nowMs;
    const pad = navigator.getGamepads?.().find((one) => one?.connected);
    if (!pad) return;
    const pressed = STOP_BUTTONS.some((index) => pad.buttons[index]?.pressed);
    if (pressed && !this.pressed) this.stop();
    this.pressed = pressed;
    for (const [axis, value] of [["travel", pad.axes[0]], ["elevation", -pad.axes[1]]])
      if (Math.abs(value) > DEAD_ZONE) this.move(axis, value * GAMEPAD_DEG_S[axis] * passedS);
  }
}
