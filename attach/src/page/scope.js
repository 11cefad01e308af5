"use strict";
// The scope: streams of every cycle, kept in columns, drawn by uPlot.

const COLOURS = ["#0b62c4", "#c4161c", "#17803d", "#a15c00", "#7b3fb5", "#0f8a8a", "#b5367a", "#6b7280"];
const KEPT_SECONDS = 30;

/** One block of a stream: see src/streams.rs. */
function decodeBlock(buffer) {
  const view = new DataView(buffer);
  const block = { lost: Number(view.getBigUint64(0, true)), cycles: [] };
  const count = view.getUint32(8, true);
  const signals = view.getUint32(12, true);
  let at = 16;
  for (let cycle = 0; cycle < count; cycle += 1) {
    const number = Number(view.getBigUint64(at, true));
    const time = Number(view.getBigUint64(at + 8, true)) / 1e9;
    const values = [];
    for (let signal = 0; signal < signals; signal += 1) {
      const value = view.getFloat64(at + 16 + 8 * signal, true);
      values.push(Number.isNaN(value) ? null : value);
    }
    block.cycles.push({ number, time, values });
    at += 16 + 8 * signals;
  }
  return block;
}

class Scope {
  constructor(place, open, state) {
    this.place = place;
    this.open = open;
    this.state = state;
    this.signals = [];
    this.units = [];
    this.columns = [[]];
    this.lost = 0;
    this.window = 5;
    this.runs = true;
    this.trigger = null;
    this.frozen = null;
    new ResizeObserver(() => this.resize()).observe(place);
    setInterval(() => this.draw(), 50);
  }

  /** Shows these signals, from now on. */
  show(signals) {
    this.signals = signals;
    this.columns = [[], ...signals.map(() => [])];
    this.units = signals.map(() => "");
    this.lost = 0;
    this.frozen = null;
    if (this.socket) this.socket.close();
    this.socket = null;
    this.plot?.destroy();
    this.plot = null;
    if (signals.length === 0) return;
    const socket = this.open(`/v1/stream?signals=${signals.map(encodeURIComponent).join(",")}`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = (message) => {
      if (socket !== this.socket) return;
      if (typeof message.data === "string") {
        const said = JSON.parse(message.data);
        if (said.signals) this.begin(said.signals.map((signal) => signal.unit));
        return;
      }
      this.take(decodeBlock(message.data));
    };
    socket.onclose = () => {
      if (socket === this.socket) this.state("the stream has ended");
    };
    this.socket = socket;
  }

  begin(units) {
    this.units = units;
    const kinds = [...new Set(units)];
    const series = this.signals.map((signal, place) => ({
      label: units[place] ? `${signal} [${units[place]}]` : signal,
      scale: `unit ${units[place]}`,
      stroke: COLOURS[place % COLOURS.length],
      width: 1.5,
    }));
    const quiet = getComputedStyle(document.documentElement).getPropertyValue("--quiet");
    const grid = { stroke: getComputedStyle(document.documentElement).getPropertyValue("--rule"), width: 1 };
    const axes = kinds.map((unit, place) => ({
      scale: `unit ${unit}`, side: place % 2 ? 1 : 3, label: unit, stroke: quiet, grid: place ? { show: false } : grid, size: 64,
    }));
    this.plot = new uPlot({
      width: Math.max(this.place.clientWidth, 200), height: 320,
      scales: { x: { time: false } },
      cursor: { drag: { x: true, y: false } },
      axes: [{ label: "s", stroke: quiet, grid }, ...axes],
      series: [{ label: "time [s]" }, ...series],
    }, this.columns, this.place);
  }

  take(block) {
    this.lost += block.lost;
    for (const cycle of block.cycles) {
      const last = this.columns[1].length - 1;
      if (this.runs && this.trigger && this.frozen === null && last >= 0) this.look(cycle, last);
      this.columns[0].push(cycle.time);
      cycle.values.forEach((value, place) => this.columns[place + 1].push(value));
    }
    const from = this.columns[0].at(-1) - KEPT_SECONDS;
    const old = this.columns[0].findIndex((time) => time >= from);
    if (old > 0) for (const column of this.columns) column.splice(0, old);
  }

  /** Whether the trigger is met in this cycle; then half a window more is shown, and the picture stays. */
  look(cycle, last) {
    const column = this.signals.indexOf(this.trigger.signal);
    if (column < 0) return;
    const before = this.columns[column + 1][last];
    const now = cycle.values[column];
    if (before === null || now === null) return;
    const { level, rises } = this.trigger;
    if (rises ? before <= level && now > level : before >= level && now < level) this.frozen = cycle.time;
  }

  draw() {
    if (!this.plot || this.columns[0].length < 2) return;
    const latest = this.columns[0].at(-1);
    if (this.frozen !== null && this.runs && latest >= this.frozen + this.window / 2) {
      this.pause();
      this.state(`triggered at ${this.frozen.toFixed(3)} s`);
      return;
    }
    if (!this.runs) return;
    this.plot.setData(this.columns, false);
    this.plot.setScale("x", { min: latest - this.window, max: latest });
    const waits = this.trigger ? ", waiting for the trigger" : "";
    this.state(`${this.lost} cycles lost${waits}`);
  }

  pause() {
    this.runs = false;
    this.shown = this.columns.map((column) => column.slice());
    this.plot?.setData(this.shown, false);
    const end = this.frozen === null ? this.columns[0].at(-1) : this.frozen + this.window / 2;
    this.plot?.setScale("x", { min: end - this.window, max: end });
    this.onpause?.();
  }

  resume() {
    this.frozen = null;
    this.runs = true;
  }

  resize() {
    this.plot?.setSize({ width: Math.max(this.place.clientWidth, 200), height: 320 });
  }

  csv() {
    const columns = this.runs ? this.columns : this.shown;
    const names = this.signals.map((signal, place) => (this.units[place] ? `${signal} [${this.units[place]}]` : signal));
    // By RFC 4180, section 2.
    const quoted = (name) => (/[,"\r\n]/.test(name) ? `"${name.replaceAll('"', '""')}"` : name);
    // A spreadsheet would take such a name for a formula.
    const plain = (name) => (/^[=+\-@\t\r]/.test(name) ? `'${name}` : name);
    const rows = columns[0].map((_, row) => columns.map((column) => column[row] ?? "").join(","));
    return [["time [s]", ...names.map(plain).map(quoted)].join(","), ...rows].join("\n") + "\n";
  }
}

/** A black box: position and target over the time, with the states. */
function drawBlackBox(place, box) {
  place.replaceChildren();
  const title = document.createElement("p");
  title.textContent = box.text;
  place.append(title);
  const times = box.cycles.map((cycle) => cycle.time);
  const column = (name) => box.cycles.map((cycle) => cycle[name] ?? null);
  const quiet = getComputedStyle(document.documentElement).getPropertyValue("--quiet");
  new uPlot({
    width: Math.max(place.clientWidth, 200), height: 240,
    scales: { x: { time: false } },
    axes: [{ label: "s", stroke: quiet }, { label: box.unit, stroke: quiet, size: 64 }],
    series: [
      { label: "time [s]" },
      { label: `position [${box.unit}]`, stroke: COLOURS[0], width: 1.5 },
      { label: `target [${box.unit}]`, stroke: COLOURS[3], width: 1 },
    ],
  }, [times, column("position"), column("target")], place);
  const changes = document.createElement("ol");
  let before = null;
  for (const cycle of box.cycles) {
    const state = cycle.state ?? "no answer";
    if (state !== before) {
      const change = document.createElement("li");
      change.textContent = `${cycle.time.toFixed(3)} s: ${state}`;
      changes.append(change);
    }
    before = state;
  }
  place.append(changes);
}
