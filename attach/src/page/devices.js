// The line: every device with its state, what its ports have counted, and its inputs and outputs.

import { ask, follow } from "./connection.js";
import { button, find, hexadecimal, make, rounded, write } from "./dom.js";

/** Cycles between two values. */
const EVERY = 50;
/** Of a device: a stream has so many at most. */
const MOST = 256;

const rows = new Map();
let signals = [];
let names = new Map();

function isDecent(device) {
  return device.state === "OP" || (device.kind === "other" && device.state !== null && device.error === null);
}

function portErrors(ports) {
  if (!ports) return { text: "ports not read", isClean: false };
  const counted = ports.flatMap((port, place) => [
    [port.invalid_frames, "invalid frames"], [port.physical, "symbol errors"], [port.forwarded, "forwarded errors"], [port.lost_links, "lost links"],
  ].filter(([count]) => count > 0).map(([count, what]) => `port ${place}: ${count === 255 ? "255 or more" : count} ${what}`));
  return counted.length === 0 ? { text: "no port errors", isClean: true } : { text: counted.join(", "), isClean: false };
}

/** The points of a device with their values, while they are open. */
function pointsOf(position) {
  const own = signals.filter((entry) => entry.device === position).slice(0, MOST);
  const values = own.map(() => make("td", { className: "number" }));
  const table = make("table", { className: "points" }, make("tbody", {}, ...own.map((entry, place) =>
    make("tr", {}, make("td", { className: "quiet", textContent: entry.is_input ? "in" : "out" }),
      make("td", { textContent: names.get(entry.signal) ?? entry.signal }), values[place], make("td", { className: "unit", textContent: entry.unit })))));
  const show = (cycles) => {
    const latest = cycles.at(-1);
    latest?.values.forEach((value, place) => write(values[place], shownValue(value, own[place])));
  };
  const end = own.length === 0 ? () => {} : follow(own.map((entry) => entry.signal), EVERY, show);
  return { table, end };
}

function shownValue(value, entry) {
  if (value === null) return "no answer";
  if (!entry.bits) return rounded(value);
  return entry.bits === 1 ? (value ? "1 on" : "0 off") : `${rounded(value)} (${hexadecimal(value, Math.ceil(entry.bits / 4))}h)`;
}

function toggle(row, device) {
  if (row.end) {
    row.end();
    row.end = null;
    row.points.replaceChildren();
  } else {
    const { table, end } = pointsOf(device.position);
    row.end = end;
    row.points.replaceChildren(table);
  }
  row.more.setAttribute("aria-expanded", String(row.end !== null));
}

function rowOf(device) {
  const row = { state: make("span", { className: "pill" }), ports: make("span", { className: "ports" }), points: make("div", { className: "device-points" }), end: null };
  const count = signals.filter((entry) => entry.device === device.position).length;
  row.more = button(`${count} inputs and outputs`, () => toggle(row, device), { className: "quiet-button", hidden: count === 0 });
  row.more.setAttribute("aria-expanded", "false");
  row.element = make("li", {}, make("div", { className: "device" },
    make("strong", { textContent: `${device.position}: ${device.name}` }), row.state, row.ports, row.more), row.points);
  row.element.dataset.position = device.position;
  return row;
}

function showDevice(device) {
  if (!rows.has(device.position)) {
    rows.set(device.position, rowOf(device));
    find("line").append(rows.get(device.position).element);
  }
  const row = rows.get(device.position);
  const ports = portErrors(device.ports);
  write(row.state, device.state ?? "no answer");
  row.state.className = `pill ${isDecent(device) ? (device.kind === "other" ? "off" : "good") : "bad"}`;
  row.state.title = device.text ?? "";
  write(row.ports, ports.text);
  row.ports.className = `ports ${ports.isClean ? "quiet" : "warn"}`;
  // An I/O terminal is its inputs and outputs.
  if (device.kind === "io" && !row.wasShown) toggle(row, device);
  row.wasShown = true;
}

/** Asks for all devices; an error is shown in their place. */
export async function refreshDevices() {
  try {
    for (const device of await ask("/v1/devices")) showDevice(device);
    write(find("line-state"), "");
  } catch (error) {
    write(find("line-state"), error.message);
  }
}

export function offerDevices(all, ios) {
  const bits = new Map(ios.flatMap((io) => io.points.map((point) => [point.signal, point.bits])));
  signals = all.map((entry) => ({ ...entry, bits: bits.get(entry.signal) }));
  names = new Map(ios.flatMap((io) => io.points.map((point) => [point.signal, point.name])));
}
