// Where each axis is going: seen in the process data, whoever has begun the move.

import { fitting, follow } from "./connection.js";

const NEW_SET_POINT = 4;
const RELATIVE = 6;
const PROFILE_POSITION = 1;
const PARTS = ["controlword", "target", "position", "mode", "target_velocity"];

const goals = new Map();

/** What is known of an axis: `from` and `to` of its latest set-point, and its target velocity. */
export const goalOf = (axis) => goals.get(axis) ?? { from: null, to: null, velocity: null };

/** One cycle of one axis; `seen` is what the cycle before had. */
function take(seen, { controlword, target, position, mode, target_velocity: velocity }) {
  const begins = (controlword >> NEW_SET_POINT) & 1;
  if (begins && !seen.begins && mode === PROFILE_POSITION && target != null && position != null) {
    seen.from = position;
    seen.to = (controlword >> RELATIVE) & 1 ? position + target : target;
  }
  seen.begins = begins;
  seen.velocity = velocity ?? null;
}

/** Follows all axes whose process data have what it takes. */
export function followGoals(axes, signals) {
  const known = new Set(signals.map((entry) => entry.signal));
  const followed = axes.map((axis) => axis.name).filter((name) => known.has(`${name}.controlword`));
  const all = followed.flatMap((name) => PARTS.filter((part) => known.has(`${name}.${part}`)).map((part) => ({ name, part })));
  const places = all.slice(0, fitting(all.map(({ name, part }) => `${name}.${part}`)));
  if (places.length === 0) return;
  for (const name of followed) goals.set(name, { from: null, to: null, velocity: null, begins: 0 });
  follow(places.map(({ name, part }) => `${name}.${part}`), 1, (cycles) => {
    for (const { values } of cycles) {
      const read = new Map(followed.map((name) => [name, {}]));
      places.forEach(({ name, part }, place) => { read.get(name)[part] = values[place]; });
      for (const [name, cycle] of read) take(goals.get(name), cycle);
    }
  });
}
