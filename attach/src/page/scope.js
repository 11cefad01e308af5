// The scope: a stream of every cycle, kept in columns, drawn by uPlot.

import { decodeBlock, openSocket, streamPath } from "./connection.js";
import { colour } from "./dom.js";

const LIGHT = ["#0b62c4", "#c4161c", "#17803d", "#a15c00", "#7b3fb5", "#0f8a8a", "#b5367a", "#6b7280"];
const DARK = ["#6aaeff", "#ff7b7f", "#57c785", "#f0b350", "#c39bf0", "#5fd3d3", "#f28fc0", "#aab3be"];
const KEPT_SECONDS = 30;
const LEAST_HEIGHT = 140;
/** Of a scale; on a phone the unit is in the table alone. */
const [AXIS_WIDTH, NARROW_AXIS_WIDTH, NARROW] = [64, 46, 500];

/** The colour of the signal at this place, in the theme that holds now. */
export function seriesColour(place) {
  const colours = document.documentElement.dataset.theme === "dark" ? DARK : LIGHT;
  return colours[place % colours.length];
}

/** From the least to the greatest value with some room, but never less than the span: noise stays as small as it is. */
export function rangeOf(least, most, span) {
  const [low, high] = least === null || most === null ? [0, 0] : [least, most];
  if (high - low >= span) {
    const room = 0.06 * (high - low);
    return [low - room, high + room];
  }
  // In steps, so that the scale does not tremble with the noise.
  const middle = Math.round((low + high) / 2 / (span / 4)) * (span / 4);
  return [middle - 0.75 * span, middle + 0.75 * span];
}

export const themed = {
  axis: (more) => ({ stroke: () => colour("quiet"), grid: { stroke: () => colour("rule"), width: 1 }, ticks: { stroke: () => colour("rule"), width: 1 }, ...more }),
};

export class Scope {
  /** `said` takes texts; `spanOf` gives the least span of a signal; `drawn` is called after each drawing. */
  constructor(place, { said, spanOf, drawn, paused, plotted }) {
    Object.assign(this, { place, said, spanOf, drawn, paused, plotted });
    this.signals = [];
    this.units = [];
    this.columns = [[]];
    this.lost = 0;
    this.window = 5;
    this.runs = true;
    this.trigger = null;
    this.frozen = null;
    this.height = 300;
    new ResizeObserver(() => this.resize()).observe(place);
    setInterval(() => this.draw(), 50);
    addEventListener("themechange", () => this.plot?.redraw());
  }

  /** Shows these signals from now on, and what is known of those that were shown before. */
  show(signals) {
    const [times, ...before] = this.columns;
    const known = new Map(this.signals.map((signal, place) => [signal, before[place]]));
    this.columns = [times, ...signals.map((signal) => known.get(signal) ?? times.map(() => null))];
    this.signals = signals;
    this.units = signals.map(() => "");
    this.lost = 0;
    this.frozen = null;
    this.socket?.close();
    this.socket = null;
    this.plot?.destroy();
    this.plot = null;
    if (signals.length > 0) this.stream(signals);
  }

  stream(signals) {
    const socket = openSocket(streamPath(signals));
    socket.binaryType = "arraybuffer";
    socket.onmessage = (message) => {
      if (socket !== this.socket) return;
      if (typeof message.data !== "string") return this.take(decodeBlock(message.data));
      const said = JSON.parse(message.data);
      if (said.signals) this.begin(said.signals.map((signal) => signal.unit));
    };
    socket.onclose = () => {
      if (socket === this.socket) this.said("the stream has ended");
    };
    this.socket = socket;
  }

  begin(units) {
    this.units = units;
    this.plot?.destroy();
    const kinds = [...new Set(units)];
    const scales = Object.fromEntries(kinds.map((unit) => [`unit ${unit}`, { range: (_, least, most) => rangeOf(least, most, this.span(unit)) }]));
    const series = this.signals.map((signal, place) => ({
      label: signal, scale: `unit ${units[place]}`, stroke: () => seriesColour(place), width: 1.5,
    }));
    const width = this.place.clientWidth < NARROW ? { size: NARROW_AXIS_WIDTH } : { size: AXIS_WIDTH, labelSize: 18 };
    const axes = kinds.map((unit, place) => themed.axis({
      ...width, scale: `unit ${unit}`, side: place % 2 ? 1 : 3, ...(width.labelSize ? { label: unit } : {}), ...(place ? { grid: { show: false } } : {}),
    }));
    this.plot = new uPlot({
      ...this.size(),
      scales: { x: { time: false }, ...scales },
      legend: { show: false },
      cursor: { drag: { x: true, y: false } },
      axes: [themed.axis({ label: "s", labelSize: 16, size: 34 }), ...axes],
      series: [{}, ...series],
    }, this.columns, this.place);
    this.plotted(this.plot);
  }

  /** The least span of all signals with this unit. */
  span(unit) {
    const spans = this.signals.filter((_, place) => this.units[place] === unit).map((signal) => this.spanOf(signal, unit));
    return Math.max(...spans);
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
      this.said(`triggered at ${this.frozen.toFixed(3)} s`);
    } else if (this.runs) {
      this.plot.setData(this.columns, false);
      this.plot.setScale("x", { min: latest - this.window, max: latest });
      this.said(`${this.lost} cycles lost${this.trigger ? ", waiting for the trigger" : ""}`);
    }
    this.drawn();
  }

  pause() {
    this.runs = false;
    this.kept = this.columns.map((column) => column.slice());
    this.plot?.setData(this.kept, false);
    const end = this.frozen === null ? this.columns[0].at(-1) : this.frozen + this.window / 2;
    this.plot?.setScale("x", { min: end - this.window, max: end });
    this.paused();
  }

  resume() {
    this.frozen = null;
    this.runs = true;
  }

  size() {
    return { width: Math.max(this.place.clientWidth, 200), height: this.height };
  }

  resize(height = this.height) {
    this.height = Math.max(height, LEAST_HEIGHT);
    this.plot?.setSize(this.size());
  }

  /** What is drawn: the time, then each signal. */
  shown() {
    return this.runs ? this.columns : this.kept;
  }

  /** The values of all signals at the cycle that is nearest to this time. */
  valuesAt(time) {
    const columns = this.shown();
    const times = columns[0];
    if (times.length === 0) return this.signals.map(() => null);
    let [low, high] = [0, times.length - 1];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] < time) low = middle + 1;
      else high = middle;
    }
    const at = low > 0 && time - times[low - 1] < times[low] - time ? low - 1 : low;
    return columns.slice(1).map((column) => column[at] ?? null);
  }

  csv() {
    const columns = this.shown();
    const names = this.signals.map((signal, place) => (this.units[place] ? `${signal} [${this.units[place]}]` : signal));
    // By RFC 4180, section 2.
    const quoted = (name) => (/[,"\r\n]/.test(name) ? `"${name.replaceAll('"', '""')}"` : name);
    // A spreadsheet would take such a name for a formula.
    const plain = (name) => (/^[=+\-@\t\r]/.test(name) ? `'${name}` : name);
    const rows = columns[0].map((_, row) => columns.map((column) => column[row] ?? "").join(","));
    return [["time [s]", ...names.map(plain).map(quoted)].join(","), ...rows].join("\n") + "\n";
  }
}
