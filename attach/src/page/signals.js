// What the scope shows: signals chosen from a list, their values, and its buttons.

import { ask } from "./connection.js";
import { Cursors } from "./cursors.js";
import { button, find, make, rounded, save, write } from "./dom.js";
import { Scope, seriesColour } from "./scope.js";

const VALUES_EVERY = 100;
const MOST = 32;

/** All that can be chosen: `{ signal, unit, device }`. */
let known = [];
/** The size of one count of each axis, by its name. */
let counts = new Map();
let chosen = [];
let shownAt = 0;

/** The least span of the scale of a signal: some hundred counts, some thousand counts per second. */
function spanOf(signal, unit) {
  if (signal === "lateness") return 100;
  const axis = [...counts.keys()].find((name) => signal.startsWith(`${name}.`));
  if (unit === "" || axis === undefined) return 10;
  const count = counts.get(axis) || 1;
  if (unit.endsWith("/s²")) return 50_000 * count;
  return (unit.endsWith("/s") ? 5000 : 100) * count;
}

const cursors = new Cursors(() => showValues());
export const scope = new Scope(find("scope"), {
  said: (text) => write(find("scope-state"), text),
  spanOf,
  drawn: () => {
    const now = performance.now();
    if (now - shownAt < VALUES_EVERY) return;
    shownAt = now;
    showValues();
  },
  paused: () => write(find("run"), "Run"),
  plotted: (plot) => cursors.attach(plot),
});

export function showSignals(next) {
  chosen = next;
  scope.show(chosen);
  write(find("run"), "Pause");
  scope.resume();
  find("values").replaceChildren(...chosen.map(valueRow));
  const options = chosen.map((signal) => make("option", { value: signal, textContent: signal }));
  const trigger = find("trigger-signal").value;
  find("trigger-signal").replaceChildren(make("option", { value: "", textContent: "none" }), ...options);
  if (chosen.includes(trigger)) find("trigger-signal").value = trigger;
  setTrigger();
  showList();
}

// The values.

function valueRow(signal) {
  const cell = (name) => make("td", { className: `number ${name}` });
  const remove = button("×", () => showSignals(chosen.filter((other) => other !== signal)), { title: "Remove", className: "quiet-button remove" });
  remove.setAttribute("aria-label", `remove ${signal}`);
  const swatch = make("span", { className: "swatch" });
  const row = make("tr", {}, make("th", { scope: "row" }, swatch, make("span", { textContent: signal }), " ", make("span", { className: "unit" })),
    cell("now"), cell("at-a"), cell("at-b"), cell("between"), make("td", {}, remove));
  row.dataset.signal = signal;
  return row;
}

function showValues() {
  const columns = scope.shown();
  if (!scope.plot || columns[0].length === 0) return;
  const last = columns.slice(1).map((column) => column.at(-1) ?? null);
  find("cursor-times").hidden = !cursors.isShown;
  find("values-table").classList.toggle("with-cursors", cursors.isShown);
  const times = cursors.isShown ? cursors.times(scope.plot) : null;
  const [a, b] = times ? [scope.valuesAt(times.A), scope.valuesAt(times.B)] : [[], []];
  if (times) {
    write(find("time-a"), `${times.A.toFixed(3)} s`);
    write(find("time-b"), `${times.B.toFixed(3)} s`);
    write(find("time-between"), `${(times.B - times.A).toFixed(3)} s`);
  }
  [...find("values").children].forEach((row, place) => {
    const put = (name, value) => write(row.querySelector(`.${name}`), value === undefined ? "" : rounded(value));
    row.querySelector(".swatch").style.background = seriesColour(place);
    write(row.querySelector(".unit"), scope.units[place] ?? "");
    put("now", last[place]);
    put("at-a", a[place]);
    put("at-b", b[place]);
    put("between", times ? (a[place] === null || b[place] === null ? null : b[place] - a[place]) : undefined);
  });
}

// The list.

function listed() {
  const filter = find("signal").value.trim().toLowerCase();
  return known.map((entry) => entry.signal).filter((signal) => signal.toLowerCase().includes(filter));
}

function showList() {
  find("signal-list").replaceChildren(...listed().map((signal) => {
    const box = make("input", { type: "checkbox", checked: chosen.includes(signal) });
    box.addEventListener("change", () => {
      if (box.checked) add(signal);
      else showSignals(chosen.filter((other) => other !== signal));
    });
    return make("li", {}, make("label", {}, box, " ", make("span", { textContent: signal })));
  }));
}

function refuse(text) {
  write(find("signal-error"), text);
  find("signal-error").hidden = text === "";
}

/** A name that the server does not know leaves the scope as it is. */
async function add(name) {
  refuse("");
  if (chosen.includes(name)) return;
  if (chosen.length >= MOST) return refuse(`at most ${MOST} signals are shown`);
  try {
    const [{ signal }] = await ask(`/v1/signals?name=${encodeURIComponent(name)}`);
    if (!chosen.includes(signal)) showSignals([...chosen, signal]);
    if (find("signal").value !== "") {
      find("signal").value = "";
      showList();
    }
  } catch (error) {
    refuse(error.message);
    showList();
  }
}

function addTyped() {
  const typed = find("signal").value.trim();
  const fits = listed();
  if (typed) add(fits.length === 1 ? fits[0] : typed);
}

// The buttons.

function setTrigger() {
  const signal = find("trigger-signal").value;
  const level = find("trigger-level").valueAsNumber;
  scope.trigger = signal && Number.isFinite(level) ? { signal, level, rises: find("trigger-edge").value === "rise" } : null;
}

function toggleRun() {
  if (scope.runs) return scope.pause();
  scope.resume();
  write(find("run"), "Pause");
}

function toggleCursors() {
  cursors.show(!cursors.isShown);
  find("cursors").setAttribute("aria-pressed", String(cursors.isShown));
  showValues();
}

/** The bar below the plot is dragged, or moved by the arrow keys. */
function dragHeight() {
  const handle = find("scope-handle");
  let from = null;
  handle.addEventListener("pointerdown", (event) => {
    handle.setPointerCapture(event.pointerId);
    from = { y: event.clientY, height: scope.height };
  });
  handle.addEventListener("pointermove", (event) => {
    if (from && handle.hasPointerCapture(event.pointerId)) scope.resize(from.height + event.clientY - from.y);
  });
  handle.addEventListener("lostpointercapture", () => { from = null; });
  handle.addEventListener("keydown", (event) => {
    const by = { ArrowDown: 20, ArrowUp: -20 }[event.key];
    if (by === undefined) return;
    event.preventDefault();
    scope.resize(scope.height + by);
  });
}

export function offerSignals(signals, axes) {
  known = signals;
  counts = new Map(axes.map((axis) => [axis.name, axis.count]).sort(([one], [other]) => other.length - one.length));
  if (matchMedia("(max-width: 40rem)").matches) scope.resize(220);
  for (const id of ["trigger-signal", "trigger-edge", "trigger-level"]) find(id).addEventListener("change", setTrigger);
  find("window").addEventListener("change", () => { scope.window = Number(find("window").value); });
  find("signal").addEventListener("input", showList);
  find("signal").addEventListener("keydown", (event) => {
    if (event.key === "Enter") addTyped();
  });
  find("add-signal").addEventListener("click", addTyped);
  find("run").addEventListener("click", toggleRun);
  find("cursors").addEventListener("click", toggleCursors);
  find("export").addEventListener("click", () => save("servocrab-scope.csv", scope.csv(), "text/csv"));
  document.addEventListener("pointerdown", (event) => {
    if (!find("picker").contains(event.target)) find("picker").open = false;
  });
  dragHeight();
  const first = axes[0]?.name;
  const usual = [`${first}.position`, `${first}.velocity`].filter((signal) => known.some((entry) => entry.signal === signal));
  showSignals(usual);
}
