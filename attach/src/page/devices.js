// The line: every device with its state, what its ports have counted, and its inputs and outputs.

import { ask, fitting, follow } from "./connection.js";
import { button, find, hexadecimal, make, rounded, write } from "./dom.js";

/** Cycles between two values. */
const EVERY = 50;

const rows = new Map();
let signals = [];
let names = new Map();
let endFollowing = () => {};

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

/** The points of a device, each with the cell of its value. */
function pointsOf(position) {
  return signals.filter((entry) => entry.device === position).map((entry) => ({ entry, cell: make("td", { className: "number" }) }));
}

function pointRow({ entry, cell }) {
  return make("tr", {}, make("td", { className: "quiet", textContent: entry.is_input ? "in" : "out" }),
    make("td", { textContent: names.get(entry.signal) ?? entry.signal }), cell, make("td", { className: "unit", textContent: entry.unit }));
}

/** One stream for the points of all devices that are open: each takes a place of the server. */
function followOpen() {
  endFollowing();
  const open = [...rows.values()].flatMap((row) => row.open);
  const count = fitting(open.map(({ entry }) => entry.signal));
  for (const { cell } of open.slice(count)) write(cell, "too many are open");
  const followed = open.slice(0, count);
  endFollowing = followed.length === 0 ? () => {} : follow(followed.map(({ entry }) => entry.signal), EVERY, (cycles) => {
    cycles.at(-1)?.values.forEach((value, place) => write(followed[place].cell, shownValue(value, followed[place].entry)));
  });
}

function shownValue(value, entry) {
  if (value === null) return "no answer";
  if (!entry.bits) return rounded(value);
  return entry.bits === 1 ? (value ? "1 on" : "0 off") : `${rounded(value)} (${hexadecimal(value, Math.ceil(entry.bits / 4))}h)`;
}

function toggle(row, device) {
  row.open = row.open.length > 0 ? [] : pointsOf(device.position);
  row.points.replaceChildren(...(row.open.length > 0 ? [make("table", { className: "points" }, make("tbody", {}, ...row.open.map(pointRow)))] : []));
  row.more.setAttribute("aria-expanded", String(row.open.length > 0));
  followOpen();
}

function rowOf(device) {
  const row = { state: make("span", { className: "pill" }), ports: make("span", { className: "ports" }), points: make("div", { className: "device-points" }), open: [] };
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
