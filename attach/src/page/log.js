// What was commanded and how it ended, and what happened to drives and axes.

import { ask } from "./connection.js";
import { drawBlackBox } from "./blackbox.js";
import { button, find, hexadecimal, make, tell } from "./dom.js";

const time = (seconds) => new Date(1000 * seconds).toLocaleTimeString([], { hour12: false });

function outcomeOf(command) {
  if (command.done === null) return { text: "under way", kind: "now" };
  const after = command.seconds >= 0.05 ? `, ${command.seconds.toFixed(1)} s` : "";
  return { text: `${command.outcome}${after}`, kind: command.done ? "good" : "bad" };
}

function commandRow(command) {
  const { text, kind } = outcomeOf(command);
  const what = command.times > 1 ? `${command.what} (${command.times} times)` : command.what;
  return make("tr", {}, make("td", { className: "time", textContent: time(command.at) }), make("td", { textContent: what }),
    make("td", { className: `outcome ${kind}`, textContent: text }), make("td", { className: "quiet who", textContent: command.client }));
}

/** Draws anew what has changed: a text that somebody has selected stays. */
function changed(element, shown) {
  const text = JSON.stringify(shown);
  if (element.shown === text) return false;
  element.shown = text;
  return true;
}

export function showCommands(commands) {
  if (!changed(find("commands"), commands)) return;
  find("commands").replaceChildren(...commands.toReversed().map(commandRow));
  find("no-commands").hidden = commands.length > 0;
}

export function showEmergencies(emergencies) {
  if (!changed(find("emergencies"), emergencies)) return;
  find("emergencies").replaceChildren(...emergencies.toReversed().map((emergency) => make("li", {
    textContent: `drive ${emergency.drive}: ${hexadecimal(emergency.code, 4)}h ${emergency.text}, at ${emergency.seconds.toFixed(3)} s`,
  })));
  find("emergencies-title").hidden = emergencies.length === 0;
}

async function showBlackBox(number) {
  try {
    drawBlackBox(find("black-box"), await ask(`/v1/events/${number}/black_box`));
  } catch (error) {
    tell(error.message);
  }
}

export function showEvents(events) {
  if (!changed(find("events"), events)) return;
  find("no-events").hidden = events.length > 0;
  find("events").replaceChildren(...events.toReversed().map((event) => {
    const item = make("li", {}, event.text);
    if (event.has_black_box) item.append(" ", button("Black box", () => showBlackBox(event.number)));
    return item;
  }));
}
