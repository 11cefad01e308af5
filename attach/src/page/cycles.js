// The cycles: what was counted, and how late and how long they were, as histograms.

import { find, make } from "./dom.js";

const SVG = "http://www.w3.org/2000/svg";
const [WIDTH, HEIGHT] = [420, 170];
const [LEFT, RIGHT, TOP, BOTTOM] = [52, 28, 10, 40];

function draw(tag, attributes, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

export const timeText = (us) => (us >= 1000 ? `${us / 1000} ms` : us >= 1 ? `${us} µs` : `${Math.round(us * 1000)} ns`);
const countText = (count) => (count >= 1e6 ? `${count / 1e6} M` : count >= 1000 ? `${count / 1000} k` : String(count));

/** The powers of ten between two numbers. */
function decades(from, to) {
  const first = Math.ceil(Math.log10(from) - 1e-9);
  const last = Math.floor(Math.log10(to) + 1e-9);
  return Array.from({ length: Math.max(last - first + 1, 0) }, (_, place) => 10 ** (first + place));
}

/** From the least to the greatest time, in whole decades. */
function timesOf(bars) {
  const least = Math.max(bars[0]?.up_to ?? 1, 1e-3) / Math.SQRT2;
  const most = bars.at(-1)?.up_to ?? 1000;
  return [10 ** Math.floor(Math.log10(least)), 10 ** Math.ceil(Math.log10(most) - 1e-9)];
}

/**
 * Bars of counts over the time, both on logarithmic scales: the one late cycle among a million is what one looks for. A bar reaches up to
 * its time, from 1/√2 of it.
 */
export function histogram(name, bars) {
  const [least, most] = timesOf(bars);
  const top = Math.max(10, 10 ** Math.ceil(Math.log10(1 + Math.max(1, ...bars.map((bar) => bar.count)))));
  const x = (us) => LEFT + (WIDTH - LEFT - RIGHT) * Math.log(us / least) / Math.log(most / least || 10);
  // Half a cycle is the line at the foot, so that one cycle can be seen.
  const y = (count) => HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * Math.log(count / 0.5) / Math.log(top / 0.5);
  const plot = draw("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `histogram of the ${name}` });
  for (const count of decades(1, top)) {
    plot.append(draw("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y(count), y2: y(count), class: "grid" }),
      draw("text", { x: LEFT - 6, y: y(count) + 4, "text-anchor": "end" }, countText(count)));
  }
  for (const us of decades(least, most)) {
    plot.append(draw("line", { x1: x(us), x2: x(us), y1: HEIGHT - BOTTOM, y2: HEIGHT - BOTTOM + 4, class: "axis" }),
      draw("text", { x: x(us), y: HEIGHT - BOTTOM + 16, "text-anchor": "middle" }, timeText(us)));
  }
  for (const { up_to: end, count } of bars.filter((bar) => bar.count > 0)) {
    const from = Math.max(x(Math.max(end, 1e-3) / Math.SQRT2), LEFT);
    const bar = draw("rect", { x: from + 0.5, y: y(count), width: Math.max(x(end) - from - 1, 1), height: HEIGHT - BOTTOM - y(count), class: "column" });
    bar.append(draw("title", {}, `up to ${timeText(Number(end.toPrecision(3)))}: ${count} cycles`));
    plot.append(bar);
  }
  plot.append(draw("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: HEIGHT - BOTTOM, y2: HEIGHT - BOTTOM, class: "axis" }),
    draw("text", { x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 6, "text-anchor": "middle" }, `${name} (logarithmic)`),
    draw("text", { x: -(TOP + HEIGHT - BOTTOM) / 2, y: 11, transform: "rotate(-90)", "text-anchor": "middle" }, "cycles"));
  return make("figure", { className: "histogram" }, plot);
}

function row(name, value) {
  return make("tr", {}, make("td", { textContent: name }), make("td", { className: "number", textContent: value }));
}

export function showStatistics(shown) {
  const counted = [["cycles", shown.cycles], ["late cycles", shown.late_cycles], ["left out", shown.overruns], ["frames lost", shown.lost_frames],
    ["wrong working counters", shown.wrong_working_counters]];
  const times = [["lateness", shown.lateness_us], ["round trip", shown.round_trip_us]];
  const quantiles = ["least", "50 %", "99 %", "99.9 %", "most"];
  find("statistics").replaceChildren(...counted.map(([name, value]) => row(name, value)));
  find("quantiles").replaceChildren(
    make("tr", {}, make("th", { textContent: "µs" }), ...quantiles.map((quantile) => make("th", { className: "number", textContent: quantile }))),
    ...times.map(([name, of]) => make("tr", {}, make("td", { textContent: name }),
      ...quantiles.map((quantile) => make("td", { className: "number", textContent: of[quantile] === null ? "" : of[quantile].toFixed(1) })))));
  find("histograms").replaceChildren(...times.map(([name, of]) => histogram(name, of.histogram)));
}
