"use strict";
// The panel: asks for what the network shows, and lets hold to jog where that is granted.

const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const find = (id) => document.getElementById(id);
const STATES = ["Not ready to switch on", "Switch on disabled", "Ready to switch on", "Switched on", "Operation enabled",
  "Quick stop active", "Fault reaction active", "Fault"];
let grants = { parameters: false, axes: [] };
let drives = [];

function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

function tell(text) {
  find("message").textContent = text;
  find("message").hidden = text === "";
}

async function ask(path, body, method, signal) {
  const options = { headers: { Authorization: `Bearer ${token}` }, method: method ?? (body === undefined ? "GET" : "POST"), signal };
  if (body !== undefined && body !== null) options.body = JSON.stringify(body);
  const response = await fetch(path, options);
  const answer = await response.json();
  if (!response.ok) throw Object.assign(new Error(answer.error?.text ?? `${response.status}`), { abort: answer.error?.abort });
  return answer;
}

async function act(path, body = null) {
  try {
    tell("");
    return await ask(path, body, "POST");
  } catch (error) {
    tell(error.message);
    return null;
  }
}

function openSocket(path) {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  return new WebSocket(`${scheme}://${location.host}${path}`, ["servocrab", `token.${token}`]);
}

// Stops: on the screen at all times, and by one key.

// A browser has six requests to one server under way, and further ones wait. Moves are answered at their end.
const STOP_ANSWERS = 2000;
const stops = new Set();

/**
 * Over the WebSocket, which waits for no request, and by a request, which needs no WebSocket. A stop may be asked for more than once, so a
 * connection that ends on the way does not lose it.
 */
async function stop(path, said) {
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
let control = null;
let tick = null;

function connect() {
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

function jogButton(axis, text, direction, speed) {
  const button = make("button", { className: "jog", textContent: text });
  button.dataset.axis = axis;
  button.setAttribute("aria-label", `hold to jog ${axis} ${text}`);
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

// Axes.

const cards = new Map();

function card(axis) {
  const granted = grants.axes.find((known) => known.axis === axis.name);
  const path = `/v1/axes/${encodeURIComponent(axis.name)}`;
  const parts = {
    mode: make("span", { className: "quiet" }),
    position: make("span", { className: "number" }),
    velocity: make("span", { className: "number" }),
    effort: make("p", { className: "bits effort" }),
    limits: make("p", { className: "bits limits" }),
    states: make("ul", { className: "states" }),
    status: make("p", { className: "bits" }),
    control: make("p", { className: "bits" }),
    flags: make("p", { className: "bits" }),
  };
  for (const state of STATES) parts.states.append(make("li", { textContent: state }));
  const button = (text, action) => {
    const made = make("button", { textContent: text });
    made.addEventListener("click", action);
    return made;
  };
  const rows = [make("div", { className: "row" }, button("Stop", () => stop(`${path}/stop`, { stop: { axis: axis.name } })))];
  if (granted) {
    rows[0].append(button("Enable", () => act(`${path}/enable`)), button("Disable", () => act(`${path}/disable`)),
      button("Reset fault", () => act(`${path}/reset_fault`)));
  }
  if (granted && granted.max_velocity !== null) {
    const velocity = make("input", { type: "number", step: "any", min: 0, max: granted.max_velocity, value: granted.max_velocity / 10 });
    velocity.setAttribute("aria-label", `jog velocity of ${axis.name}`);
    rows.push(make("div", { className: "row" }, jogButton(axis.name, "−", -1, () => velocity.valueAsNumber),
      jogButton(axis.name, "+", 1, () => velocity.valueAsNumber), velocity, make("span", { textContent: `${axis.unit}/s` })));
  }
  if (granted?.moves) {
    const to = make("input", { type: "number", step: "any", value: 0 });
    const velocity = make("input", { type: "number", step: "any", min: 0, value: granted.max_velocity ? granted.max_velocity / 10 : 1 });
    to.setAttribute("aria-label", `target of ${axis.name}`);
    velocity.setAttribute("aria-label", `velocity of the move of ${axis.name}`);
    rows.push(make("div", { className: "row" },
      button("Move to", () => act(`${path}/move`, { to: to.valueAsNumber, velocity: velocity.valueAsNumber })),
      to, make("span", { textContent: `${axis.unit} with` }), velocity, make("span", { textContent: `${axis.unit}/s` })));
  }
  const element = make("article", { className: "card" },
    make("h3", {}, make("span", { textContent: axis.name }), parts.mode),
    make("div", { className: "row" }, parts.position, make("span", { textContent: axis.unit }), parts.velocity,
      make("span", { textContent: `${axis.unit}/s` })),
    parts.effort, parts.limits, parts.states, parts.status, parts.control, parts.flags, ...rows);
  element.dataset.axis = axis.name;
  find("axes").append(element);
  showLimits(path, parts.limits, axis.count);
  parts.count = axis.count;
  return parts;
}

/** With as many decimals as one count of the axis needs. */
const number = (value, count) => value.toFixed(count > 0 ? Math.min(Math.max(Math.ceil(-Math.log10(count)), 0), 9) : 3);

/** What the drive holds in 607Dh and 607Fh. */
async function showLimits(path, place, count) {
  try {
    const { unit, min_position: min, max_position: max, max_velocity: velocity } = await ask(`${path}/limits`);
    const positions = min === null || max === null ? "none" : min < max ? `${number(min, count)} to ${number(max, count)} ${unit}` : "off";
    place.textContent = `Limits: positions ${positions}, velocity ${velocity ? `${number(velocity, count)} ${unit}/s` : "none"}`;
  } catch (error) {
    place.textContent = `Limits: ${error.message}`;
  }
}

function showAxes(axes) {
  for (const axis of axes) {
    if (!cards.has(axis.name)) cards.set(axis.name, card(axis));
    const parts = cards.get(axis.name);
    parts.mode.textContent = `${axis.mode}, drive ${axis.drive}`;
    parts.position.textContent = number(axis.position, axis.count);
    parts.velocity.textContent = number(axis.velocity, axis.count);
    const effort = [
      axis.following_error !== null && `following error ${number(axis.following_error, axis.count)} ${axis.unit}`,
      axis.torque !== null && `torque ${(100 * axis.torque).toFixed(1)} % of rated`,
    ];
    parts.effort.textContent = effort.filter(Boolean).join(", ") || "Following error and torque: map 60F4h and 6077h";
    for (const item of parts.states.children) {
      item.className = item.textContent === axis.state ? `now${axis.state.startsWith("Fault") ? " fault" : ""}` : "";
    }
    const names = (bits) => bits.map((bit) => bit.toLowerCase().replaceAll("_", " ").replace(/^bit /, "")).join(", ");
    parts.status.textContent = `Statusword ${hexadecimal(axis.statusword.value, 4)}h: ${names(axis.statusword.bits)}`;
    parts.control.textContent = `Controlword ${hexadecimal(axis.controlword, 4)}h: ${names(axis.controlword_bits)}`;
    const flags = [axis.lost && "lost", axis.halted && "halted", axis.has_set_point && "has a set-point",
      axis.referenced ? "referenced" : "not referenced"];
    parts.flags.textContent = flags.filter(Boolean).join(", ");
  }
}

// The scope.

const scope = new Scope(find("scope"), openSocket, (text) => { find("scope-state").textContent = text; });
let signals = [];

function showSignals(next) {
  signals = next;
  scope.show(signals);
  find("run").textContent = "Pause";
  scope.resume();
  find("shown-signals").replaceChildren(...signals.map((signal) => {
    const chip = make("button", { textContent: `${signal} ×`, title: "Remove" });
    chip.addEventListener("click", () => showSignals(signals.filter((other) => other !== signal)));
    return make("li", {}, chip);
  }));
  const options = signals.map((signal) => make("option", { value: signal, textContent: signal }));
  find("trigger-signal").replaceChildren(make("option", { value: "", textContent: "none" }), ...options);
  setTrigger();
}

function setTrigger() {
  const signal = find("trigger-signal").value;
  const level = find("trigger-level").valueAsNumber;
  scope.trigger = signal && Number.isFinite(level) ? { signal, level, rises: find("trigger-edge").value === "rise" } : null;
}
for (const id of ["trigger-signal", "trigger-edge", "trigger-level"]) find(id).addEventListener("change", setTrigger);
find("window").addEventListener("change", () => { scope.window = Number(find("window").value); });
find("add-signal").addEventListener("click", () => {
  const signal = find("signal").value.trim();
  if (signal && !signals.includes(signal)) showSignals([...signals, signal]);
  find("signal").value = "";
});
find("signal").addEventListener("keydown", (event) => {
  if (event.key === "Enter") find("add-signal").click();
});
scope.onpause = () => { find("run").textContent = "Run"; };
find("run").addEventListener("click", () => {
  if (scope.runs) return scope.pause();
  scope.resume();
  find("run").textContent = "Pause";
});
find("export").addEventListener("click", () => {
  const url = URL.createObjectURL(new Blob([scope.csv()], { type: "text/csv" }));
  make("a", { href: url, download: "servocrab-scope.csv" }).click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
});

// Events with their black boxes.

function showEmergencies(emergencies) {
  find("emergencies").replaceChildren(...emergencies.toReversed().map((emergency) => make("li", {
    textContent: `drive ${emergency.drive}: ${hexadecimal(emergency.code, 4)}h ${emergency.text}, at ${emergency.seconds.toFixed(3)} s`,
  })));
  find("emergencies-title").hidden = emergencies.length === 0;
}

let shownEvents = -1;

function showEvents(events) {
  const latest = events.at(-1)?.number ?? -1;
  if (latest === shownEvents) return;
  shownEvents = latest;
  find("events").replaceChildren(...events.toReversed().map((event) => {
    const item = make("li", {}, event.text);
    if (event.has_black_box) {
      const button = make("button", { textContent: "Black box" });
      button.addEventListener("click", async () => {
        try {
          drawBlackBox(find("black-box"), await ask(`/v1/events/${event.number}/black_box`));
        } catch (error) {
          tell(error.message);
        }
      });
      item.append(" ", button);
    }
    return item;
  }));
}

// Objects.

const hexadecimal = (number, digits) => number.toString(16).toUpperCase().padStart(digits, "0");
const address = (object) => `${hexadecimal(object.index, 4)}h:${hexadecimal(object.subindex, 2)}`;
const objectPath = (drive, object) => `/v1/od/${drive}/${hexadecimal(object.index, 4)}h/${hexadecimal(object.subindex, 2)}`;

/** The number of these bytes, which come with the lowest first. */
const whole = (bytes) => bytes.reduceRight((number, byte) => (number << 8n) | BigInt(byte), 0n);
const widthOf = (type) => Number(/^(?:UNSIGNED|INTEGER|REAL)(\d+)$/.exec(type)?.[1] ?? 0) / 8;

/** A number of 32 bits with the digits that it was written with, and none of the conversion's. */
function ofSingle(value) {
  const digits = [6, 7, 8, 9].map((count) => Number(value.toPrecision(count)));
  return digits.find((short) => Math.fround(short) === value) ?? value;
}

function valueOf(bytes, type) {
  if (type === "VISIBLE_STRING") return new TextDecoder().decode(Uint8Array.from(bytes)).replace(/\0+$/, "");
  if (type === "BOOLEAN" && bytes.length === 1) return String(bytes[0]);
  if (bytes.length === 0 || widthOf(type) !== bytes.length) {
    return bytes.map((byte) => byte.toString(16).padStart(2, "0")).join(" ");
  }
  const view = new DataView(Uint8Array.from(bytes).buffer);
  if (type === "REAL32") return String(ofSingle(view.getFloat32(0, true)));
  if (type === "REAL64") return String(view.getFloat64(0, true));
  return (type.startsWith("INTEGER") ? BigInt.asIntN(8 * bytes.length, whole(bytes)) : whole(bytes)).toString();
}

/** The bytes of what was typed. What the type does not hold is refused: a number that is cut is another one. */
function bytesOf(text, type, bits) {
  const typed = text.trim();
  const wrong = () => new Error(`"${typed}" is no ${type}${bits ? ` of ${bits} bits` : ""}`);
  if (typed === "") throw wrong();
  if (type === "VISIBLE_STRING") {
    const bytes = [...new TextEncoder().encode(typed)];
    if (bits && 8 * bytes.length > bits) throw wrong();
    return bytes;
  }
  if (type === "BOOLEAN") {
    if (!/^[01]$/.test(typed)) throw wrong();
    return [Number(typed)];
  }
  const width = widthOf(type);
  if (width === 0) {
    if (!/^[0-9a-f]{2}( [0-9a-f]{2})*$/i.test(typed)) throw new Error(`"${typed}" is not bytes in hexadecimal, as "0A FF"`);
    return typed.split(" ").map((byte) => Number.parseInt(byte, 16));
  }
  if (type.startsWith("REAL")) {
    const number = Number(typed);
    const view = new DataView(new ArrayBuffer(width));
    if (width === 4) view.setFloat32(0, number, true);
    else view.setFloat64(0, number, true);
    const kept = width === 4 ? view.getFloat32(0, true) : number;
    if (!Number.isFinite(kept)) throw wrong();
    return [...new Uint8Array(view.buffer)];
  }
  if (!/^(-?\d+|0x[0-9a-f]+)$/i.test(typed)) throw wrong();
  const number = BigInt(typed);
  const kept = type.startsWith("INTEGER") ? BigInt.asIntN(8 * width, number) : BigInt.asUintN(8 * width, number);
  if (kept !== number) throw wrong();
  return Array.from({ length: width }, (_, place) => Number((number >> BigInt(8 * place)) & 0xffn));
}

function objectRow(drive, object) {
  const value = make("td");
  const path = objectPath(drive, object);
  const read = make("button", { textContent: "Read" });
  read.addEventListener("click", async () => {
    try {
      const answer = await ask(path);
      const word = /^(UNSIGNED|INTEGER)/.test(object.type) ? ` (${hexadecimal(whole(answer.bytes), 1)}h)` : "";
      value.textContent = `${valueOf(answer.bytes, object.type)}${word}`;
    } catch (error) {
      value.textContent = error.message;
    }
  });
  const buttons = make("td", {}, read);
  if (grants.parameters && /w/i.test(object.access)) {
    // No prompt(): while it is open the page hears neither a button nor a key, so nobody could stop.
    const typed = make("input", { type: "text", size: 10 });
    typed.setAttribute("aria-label", `value for ${address(object)}`);
    const write = make("button", { textContent: "Write" });
    write.addEventListener("click", async () => {
      try {
        tell("");
        await ask(path, { bytes: bytesOf(typed.value, object.type, object.bits) });
        typed.value = "";
        read.click();
        for (const [name, parts] of cards) showLimits(`/v1/axes/${encodeURIComponent(name)}`, parts.limits, parts.count);
      } catch (error) {
        tell(error.message);
      }
    });
    buttons.append(" ", typed);
    buttons.append(" ", write);
  }
  return make("tr", {}, make("td", { textContent: address(object) }), make("td", { textContent: object.name }),
    make("td", { textContent: object.type }), value, buttons);
}

find("list-objects").addEventListener("click", async () => {
  const drive = find("drive").value;
  const filter = find("filter").value.trim().toLowerCase();
  try {
    tell("");
    find("list-objects").disabled = true;
    const objects = await ask(`/v1/od/${drive}`);
    const fits = (object) => address(object).toLowerCase().includes(filter) || object.name.toLowerCase().includes(filter);
    find("objects").replaceChildren(...objects.filter(fits).slice(0, 500).map((object) => objectRow(drive, object)));
  } catch (error) {
    tell(error.message);
  } finally {
    find("list-objects").disabled = false;
  }
});
find("filter").addEventListener("keydown", (event) => {
  if (event.key === "Enter") find("list-objects").click();
});

/** The values of all objects of a drive that can be read now, by their addresses. */
async function valuesOf(drive, progress) {
  const objects = (await ask(`/v1/od/${drive}`)).filter((object) => /\br[ow]/.test(object.access));
  const values = {};
  for (const [place, object] of objects.entries()) {
    progress(`${place} of ${objects.length} objects are read`);
    try {
      const { bytes } = await ask(objectPath(drive, object));
      values[address(object)] = { name: object.name, type: object.type, bytes };
    } catch (error) {
      // One that the drive refuses now has no value.
      if (error.abort == null) throw error;
    }
  }
  progress("");
  return values;
}

/** The values that differ, or are on one side alone. */
function showDifferences(saved, present) {
  const text = (entry) => (entry ? String(valueOf(entry.bytes, entry.type)) : "none");
  const addresses = [...new Set([...Object.keys(saved), ...Object.keys(present)])].sort();
  const differ = addresses.filter((object) => text(saved[object]) !== text(present[object]));
  find("differences").replaceChildren(...differ.map((object) => make("tr", {}, make("td", { textContent: object }),
    make("td", { textContent: (saved[object] ?? present[object]).name }), make("td", { textContent: text(saved[object]) }),
    make("td", { textContent: text(present[object]) }))));
  find("compared").hidden = false;
  find("compared-state").textContent = `${differ.length} of ${addresses.length} values differ.`;
}

/** Runs what reads all objects of the drive that is chosen, with its progress shown. */
async function withValues(work) {
  const buttons = [find("save-values"), find("compare-values")];
  try {
    tell("");
    for (const button of buttons) button.disabled = true;
    work(await valuesOf(find("drive").value, (text) => { find("objects-state").textContent = text; }));
  } catch (error) {
    tell(error.message);
  } finally {
    for (const button of buttons) button.disabled = false;
  }
}

find("save-values").addEventListener("click", () => withValues((values) => {
  const url = URL.createObjectURL(new Blob([JSON.stringify(values, null, 1)], { type: "application/json" }));
  make("a", { href: url, download: `servocrab-drive-${find("drive").value}.json` }).click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}));
find("compare-values").addEventListener("click", () => find("compare-file").click());
find("compare-file").addEventListener("change", async () => {
  const [file] = find("compare-file").files;
  find("compare-file").value = "";
  if (!file) return;
  let saved;
  try {
    saved = JSON.parse(await file.text());
    if (!Object.values(saved).every((entry) => Array.isArray(entry.bytes))) throw new Error("it has no values");
  } catch (error) {
    tell(`${file.name} was not saved by this page: ${error.message}`);
    return;
  }
  withValues((present) => showDifferences(saved, present));
});

// Inputs and outputs, and the cycles.

function showIos(ios) {
  if (ios.length === 0) return;
  find("ios-section").hidden = false;
  const points = ios.flatMap((io) => io.points.map((point) => ({ ...point, io: io.name })));
  const values = points.map(() => make("td"));
  find("ios").replaceChildren(...points.map((point, place) =>
    make("tr", {}, make("td", { textContent: point.io }), make("td", { textContent: point.name }), values[place])));
  const socket = openSocket(`/v1/stream?every=50&signals=${points.map((point) => encodeURIComponent(point.signal)).join(",")}`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = (message) => {
    if (typeof message.data === "string") return;
    const latest = decodeBlock(message.data).cycles.at(-1);
    latest?.values.forEach((value, place) => { values[place].textContent = value ?? "no answer"; });
  };
}

function showStatistics(shown) {
  find("cycles").textContent = `${shown.cycles} cycles, ${shown.lost_frames} frames lost`;
  const rows = [["late cycles", shown.late_cycles], ["left out", shown.overruns], ["frames lost", shown.lost_frames],
    ["wrong working counters", shown.wrong_working_counters]];
  const plain = rows.map(([name, value]) => make("tr", {}, make("td", { textContent: name }), make("td", { textContent: value })));
  const times = [["lateness", shown.lateness_us], ["round trip", shown.round_trip_us]];
  const quantiles = times.flatMap(([name, of]) => ["least", "50 %", "99 %", "99.9 %", "most"].map((quantile) =>
    make("tr", {}, make("td", { textContent: `${name}, ${quantile}` }),
      make("td", { textContent: of[quantile] === null ? "" : `${of[quantile].toFixed(1)} µs` }))));
  find("statistics").replaceChildren(...plain, ...quantiles);
  find("histograms").replaceChildren(...times.map(([name, of]) => histogram(name, of.histogram)));
}

/** Bars of counts, on a logarithmic scale: the one late cycle among a million is what one looks for. */
function histogram(name, bars) {
  const time = (us) => (us < 1000 ? `${us.toPrecision(2)} µs` : `${(us / 1000).toPrecision(2)} ms`);
  const most = Math.log10(1 + Math.max(1, ...bars.map((bar) => bar.count)));
  const drawn = bars.map(({ up_to, count }) => {
    const column = make("span", { className: "column", title: `up to ${time(up_to)}: ${count}` });
    column.style.height = `${100 * Math.log10(1 + count) / most}%`;
    return column;
  });
  const [first, last] = [time(bars[0]?.up_to ?? 0), time(bars.at(-1)?.up_to ?? 0)];
  return make("figure", { className: "histogram" }, make("div", {}, ...drawn),
    make("figcaption", { textContent: `${name}, up to ${first} … up to ${last}; counts on a logarithmic scale` }));
}

// All together.

function connected(text, kind) {
  find("connection").textContent = text;
  find("connection").className = `badge ${kind}`;
}

async function begin() {
  grants = await ask("/v1/grants");
  drives = (await ask("/v1/line")).drives;
  find("drive").replaceChildren(...drives.map((drive) => make("option", { value: drive.position, textContent: `${drive.position}: ${drive.name}` })));
  const ios = await ask("/v1/ios");
  const devices = [...drives.map((drive) => ({ position: drive.position, text: drive.name })),
    ...ios.map((io) => ({ position: io.position, text: io.name }))].sort((one, other) => one.position - other.position);
  find("line").replaceChildren(...devices.map((device) => make("li", { textContent: `${device.position}: ${device.text}` })));
  const axes = await ask("/v1/axes");
  showAxes(axes);
  showIos(ios);
  const names = ["position", "velocity", "following_error", "torque", "target", "target_velocity", "statusword", "state"];
  find("signals").replaceChildren(...axes.flatMap((axis) => names.map((name) => make("option", { value: `${axis.name}.${name}` }))),
    make("option", { value: "lateness" }));
  if (axes.length > 0) showSignals([`${axes[0].name}.position`, `${axes[0].name}.velocity`]);
  connect();
}

/** After this time without an answer what is shown is old, and the page says so. */
const AXES_ANSWER = 1000;

async function refresh() {
  const request = new AbortController();
  const late = setTimeout(() => request.abort(), AXES_ANSWER);
  try {
    showAxes(await ask("/v1/axes", undefined, "GET", request.signal));
    connected("connected", "good");
  } catch (error) {
    connected(error.name === "AbortError" ? "no answer: what is shown is old" : error.message, "bad");
  } finally {
    clearTimeout(late);
  }
  setTimeout(refresh, 150);
}

async function refreshSlowly() {
  try {
    showStatistics(await ask("/v1/statistics"));
    showEvents(await ask("/v1/events"));
    showEmergencies(await ask("/v1/emergencies"));
  } catch {
    // The faster one shows it.
  }
  setTimeout(refreshSlowly, 1000);
}

begin().then(() => { refresh(); refreshSlowly(); }, (error) => {
  connected("refused", "bad");
  tell(error.message);
});
