// Stops, and hold to jog, over one WebSocket.

import { ask, openSocket } from "./connection.js";
import { find, make, tell } from "./dom.js";

// Stops: on the screen at all times, and by one key.

// A browser has six requests to one server under way, and further ones wait. Moves are answered at their end.
const STOP_ANSWERS = 2000;
const stops = new Set();

/**
 * Over the WebSocket, which waits for no request, and by a request, which needs no WebSocket. A stop may be asked for more than once, so a
 * connection that ends on the way does not lose it.
 */
export async function stop(path, said) {
  tell("");
  for (let attempt = 1; ; attempt += 1) {
    const request = new AbortController();
    const late = setTimeout(() => request.abort(), STOP_ANSWERS);
    let heard;
    const answered = new Promise((resolve) => { heard = resolve; });
    if (control?.readyState === WebSocket.OPEN) {
      stops.add(heard);
      control.send(JSON.stringify(said));
    }
    try {
      return await Promise.race([answered, ask(path, null, "POST", request.signal)]);
    } catch (error) {
      const lost = error instanceof TypeError || error.name === "AbortError";
      tell(`${path}: ${error.name === "AbortError" ? "there is no answer" : error.message}`);
      if (!lost || attempt === 5) return null;
    } finally {
      clearTimeout(late);
      stops.delete(heard);
      request.abort();
    }
  }
}

export const stopAxis = (axis) => stop(`/v1/axes/${encodeURIComponent(axis)}/stop`, { stop: { axis } });

function quickStop() {
  releaseAll();
  stop("/v1/quick_stop", { quick_stop: {} });
}
find("quick-stop").addEventListener("click", quickStop);
addEventListener("keydown", (event) => {
  if (event.key === "Escape") quickStop();
});

// Hold to jog. A hold echoes the server's latest tick; what goes wrong on this side or on the way ends the holds.

const held = new Map();
export let control = null;
export let tick = null;

export function connect() {
  control = openSocket("/v1/control");
  control.onmessage = (message) => {
    const said = JSON.parse(message.data);
    if (said.tick !== undefined) {
      tick = said.tick;
      for (const [axis, velocity] of held) control.send(JSON.stringify({ hold: { axis, velocity, tick } }));
    } else if (said.asked) {
      for (const heard of stops) heard(said);
    } else if (said.error) {
      tell(said.error.text);
    } else if (said.jog && said.jog.state === "ended") {
      release(said.jog.axis);
      tell(said.jog.text);
    }
  };
  control.onclose = () => {
    releaseAll();
    tick = null;
    setTimeout(connect, 1000);
  };
}

function hold(axis, direction, speed, button) {
  // The button says which way.
  if (!(speed > 0)) return tell("the velocity of a jog is a number above 0");
  const velocity = direction * speed;
  if (tick === null) return tell("there is no connection");
  tell("");
  held.set(axis, velocity);
  button.classList.add("held");
  control.send(JSON.stringify({ hold: { axis, velocity, tick } }));
}

function release(axis) {
  if (held.delete(axis) && control.readyState === WebSocket.OPEN) control.send(JSON.stringify({ release: { axis } }));
  document.querySelectorAll(".jog.held").forEach((button) => {
    if (button.dataset.axis === axis) button.classList.remove("held");
  });
}

function releaseAll() {
  for (const axis of [...held.keys()]) release(axis);
}
addEventListener("blur", releaseAll);
addEventListener("pagehide", releaseAll);
document.addEventListener("visibilitychange", () => {
  if (document.hidden) releaseAll();
});

export function jogButton(axis, text, direction, speed) {
  const button = make("button", { type: "button", className: "jog", textContent: text, title: "It moves as long as this is held" });
  button.dataset.axis = axis;
  button.dataset.direction = direction;
  button.setAttribute("aria-label", `hold to jog ${axis} ${direction < 0 ? "−" : "+"}`);
  const end = () => release(axis);
  button.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    button.setPointerCapture(event.pointerId);
    hold(axis, direction, speed(), button);
  });
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) button.addEventListener(kind, end);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  button.addEventListener("keydown", (event) => {
    if (event.key === " " && !event.repeat) {
      event.preventDefault();
      hold(axis, direction, speed(), button);
    }
  });
  button.addEventListener("keyup", end);
  return button;
}
