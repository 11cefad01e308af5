// Two cursors over a plot: lines that are dragged, and the times under them. They stay where they are on the screen.

import { make } from "./dom.js";

const STEP = 0.01;

export class Cursors {
  constructor(moved) {
    this.moved = moved;
    this.isShown = false;
    this.places = { A: 0.35, B: 0.65 };
    this.lines = Object.fromEntries(Object.keys(this.places).map((name) => [name, this.line(name)]));
  }

  line(name) {
    const line = make("div", { className: "cursor-line", tabIndex: 0 }, make("span", { textContent: name }));
    line.setAttribute("role", "slider");
    line.setAttribute("aria-label", `cursor ${name}`);
    const drag = (event) => {
      if (!line.hasPointerCapture(event.pointerId)) return;
      const { left, width } = line.parentElement.getBoundingClientRect();
      this.put(name, (event.clientX - left) / width);
    };
    line.addEventListener("pointerdown", (event) => line.setPointerCapture(event.pointerId));
    line.addEventListener("pointermove", drag);
    // Else the plot begins to zoom.
    line.addEventListener("mousedown", (event) => event.stopPropagation());
    line.addEventListener("keydown", ({ key }) => {
      if (key === "ArrowLeft") this.put(name, this.places[name] - STEP);
      if (key === "ArrowRight") this.put(name, this.places[name] + STEP);
    });
    return line;
  }

  put(name, place) {
    this.places[name] = Math.min(Math.max(place, 0), 1);
    this.show(this.isShown);
    this.moved();
  }

  show(isShown) {
    this.isShown = isShown;
    for (const [name, line] of Object.entries(this.lines)) {
      line.hidden = !isShown;
      line.style.left = `${100 * this.places[name]}%`;
      line.setAttribute("aria-valuenow", String(Math.round(100 * this.places[name])));
    }
  }

  /** The plot is a new one. */
  attach(plot) {
    plot.over.append(...Object.values(this.lines));
    this.show(this.isShown);
  }

  /** The times under them. */
  times(plot) {
    const { min, max } = plot.scales.x;
    return Object.fromEntries(Object.entries(this.places).map(([name, place]) => [name, min + place * (max - min)]));
  }
}
