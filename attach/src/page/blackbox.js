// A black box: position and target over the time, with the states.

import { make } from "./dom.js";
import { seriesColour, themed } from "./scope.js";

let plot = null;
addEventListener("themechange", () => plot?.redraw());

function statesOf(cycles) {
  const changes = make("ol");
  let before = null;
  for (const cycle of cycles) {
    const state = cycle.state ?? "no answer";
    if (state !== before) changes.append(make("li", { textContent: `${cycle.time.toFixed(3)} s: ${state}` }));
    before = state;
  }
  return changes;
}

function key(place, text) {
  const swatch = make("span", { className: "swatch" });
  swatch.style.background = seriesColour(place);
  return make("span", { className: "key" }, swatch, text);
}

export function drawBlackBox(place, box) {
  plot?.destroy();
  place.replaceChildren(make("p", { textContent: box.text }), make("p", {}, key(0, "position"), " ", key(3, "target")));
  const column = (name) => box.cycles.map((cycle) => cycle[name] ?? null);
  plot = new uPlot({
    width: Math.max(place.clientWidth, 200), height: 220,
    scales: { x: { time: false } },
    legend: { show: false },
    axes: [themed.axis({ label: "s", labelSize: 16, size: 34 }), themed.axis({ label: box.unit, labelSize: 18, size: 64 })],
    series: [{}, { stroke: () => seriesColour(0), width: 1.5 }, { stroke: () => seriesColour(3), width: 1 }],
  }, [column("time"), column("position"), column("target")], place);
  place.append(statesOf(box.cycles));
}
