// The panel: asks for what the network shows, and gives it to the parts of the page.

import { offerEnableAll, showAxes } from "./cards.js";
import { ask } from "./connection.js";
import { connect } from "./control.js";
import { showStatistics } from "./cycles.js";
import { offerDevices, refreshDevices } from "./devices.js";
import { find, tell, write } from "./dom.js";
import { followGoals } from "./goals.js";
import { showCommands, showEmergencies, showEvents } from "./log.js";
import { offerObjects } from "./objects.js";
import { offerSignals } from "./signals.js";
import "./compare.js";

/** After this time without an answer what is shown is old, and the page says so. */
const AXES_ANSWER = 1000;
const AXES_EVERY = 150;
const REST_EVERY = 1000;
const LINE_EVERY = 2000;

let grants = { parameters: false, axes: [] };

function connected(text, kind) {
  write(find("connection"), text);
  find("connection").className = `pill ${kind}`;
}

/** What of the line is wrong, for the head of the page. */
export function lineText(axes) {
  const names = (of) => of.map((axis) => axis.name).join(", ");
  const lost = axes.filter((axis) => axis.lost || axis.trouble?.kind === "lost");
  const faulted = axes.filter((axis) => axis.trouble?.kind === "fault");
  if (axes.length > 0 && lost.length === axes.length) return { text: "line lost: no axis answers", kind: "bad" };
  if (lost.length > 0) return { text: `lost: ${names(lost)}`, kind: "bad" };
  if (faulted.length > 0) return { text: `fault: ${names(faulted)}`, kind: "bad" };
  return { text: "connected", kind: "good" };
}

async function refresh() {
  const request = new AbortController();
  const late = setTimeout(() => request.abort(), AXES_ANSWER);
  try {
    const axes = await ask("/v1/axes", undefined, "GET", request.signal);
    showAxes(axes, grants);
    const { text, kind } = lineText(axes);
    connected(text, kind);
  } catch (error) {
    connected(error.name === "AbortError" ? "no answer: what is shown is old" : error.message, "bad");
  } finally {
    clearTimeout(late);
  }
  setTimeout(refresh, AXES_EVERY);
}

async function refreshSlowly() {
  try {
    showCommands(await ask("/v1/commands"));
    showEvents(await ask("/v1/events"));
    showEmergencies(await ask("/v1/emergencies"));
    const statistics = await ask("/v1/statistics");
    showStatistics(statistics);
    write(find("cycles"), `${statistics.cycles} cycles, ${statistics.lost_frames} frames lost`);
  } catch {
    // The faster one shows it.
  }
  setTimeout(refreshSlowly, REST_EVERY);
}

/** These are asked over the line. */
async function refreshLine() {
  await refreshDevices();
  setTimeout(refreshLine, LINE_EVERY);
}

/** The address has the token behind its #, so links do not change it. */
function jumps() {
  for (const link of document.querySelectorAll("nav a")) {
    link.addEventListener("click", (event) => {
      event.preventDefault();
      document.querySelector(link.getAttribute("href")).scrollIntoView({ behavior: "smooth" });
    });
  }
}

async function begin() {
  jumps();
  grants = await ask("/v1/grants");
  const [{ drives }, ios, axes, signals] = [await ask("/v1/line"), await ask("/v1/ios"), await ask("/v1/axes"), await ask("/v1/signals")];
  offerEnableAll(grants);
  offerObjects(drives, grants);
  offerDevices(signals, ios);
  followGoals(axes, signals);
  showAxes(axes, grants);
  offerSignals(signals, axes);
  connect();
}

begin().then(() => { refresh(); refreshSlowly(); refreshLine(); }, (error) => {
  connected("refused", "bad");
  tell(error.message);
});
