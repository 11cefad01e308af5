// The axes: what each does, and what may be done with it.

import { act, ask } from "./connection.js";
import { jogButton, stopAxis } from "./control.js";
import { button, find, hexadecimal, make, number, write } from "./dom.js";
import { goalOf } from "./goals.js";
import { controlBits, isSet, modeName, stateWord, statusBits } from "./words.js";

/** Counts by which an axis that stands may be seen to move, between so many looks. */
const STANDS = 100;
const LOOKS = 4;

const cards = new Map();

function field(label, properties) {
  const input = make("input", { type: "number", step: "any", ...properties });
  input.setAttribute("aria-label", label);
  return input;
}

const unit = (text) => make("span", { className: "unit", textContent: text });

function jogs(axis, granted) {
  const velocity = field(`jog velocity of ${axis.name}`, { min: 0, max: granted.max_velocity, value: granted.max_velocity / 10 });
  const speed = () => velocity.valueAsNumber;
  return [jogButton(axis.name, "− Jog", -1, speed), jogButton(axis.name, "Jog +", 1, speed),
    make("span", { className: "with-unit" }, velocity, unit(`${axis.unit}/s`))];
}

function moves(axis, path, granted) {
  const way = make("select", {}, make("option", { value: "to", textContent: "to" }), make("option", { value: "by", textContent: "by" }));
  way.setAttribute("aria-label", `move ${axis.name} to or by`);
  const target = field(`target of ${axis.name}`, { value: 0 });
  const velocity = field(`velocity of the move of ${axis.name}`, { min: 0, value: granted.max_velocity ? granted.max_velocity / 10 : 1 });
  const ramp = field(`acceleration of the move of ${axis.name}`, { min: 0, placeholder: "drive's", title: "Empty: as the drive holds it" });
  const go = () => {
    const asked = { [way.value]: target.valueAsNumber, velocity: velocity.valueAsNumber };
    if (ramp.value !== "") asked.acceleration = asked.deceleration = ramp.valueAsNumber;
    act(`${path}/move`, asked);
  };
  return make("div", { className: "row move" }, button("Move", go, { className: "go" }), way, make("span", { className: "with-unit" }, target, unit(axis.unit)),
    make("span", { className: "with-unit" }, unit("at"), velocity, unit(`${axis.unit}/s`)),
    make("span", { className: "with-unit" }, unit("ramp"), ramp, unit(`${axis.unit}/s²`)));
}

function homing(axis, path) {
  const method = field(`homing method of ${axis.name}`, { value: 37, step: 1, className: "short", title: "Homing method 6098h" });
  const within = field(`longest homing of ${axis.name}`, { value: 60, min: 1, className: "short", title: "Longest time in seconds" });
  const go = () => act(`${path}/home`, { method: method.valueAsNumber, within: within.valueAsNumber });
  return make("div", { className: "row home" }, button("Home", go), make("span", { className: "with-unit" }, unit("method"), method),
    make("span", { className: "with-unit" }, unit("within"), within, unit("s")));
}

function reading(name, className) {
  const value = make("span", { className: "value" });
  return { value, element: make("div", { className }, make("span", { className: "label", textContent: name }), value) };
}

/** What is behind the click: words, mode, limits. */
function detailsOf(axis) {
  const parts = {
    status: make("ul", { className: "bits" }), control: make("ul", { className: "bits" }),
    statusWord: make("h4"), controlWord: make("h4"),
    effort: make("p", { className: "effort" }), limits: make("p", { className: "limits" }), state: make("p"),
  };
  const element = make("div", { className: "words", hidden: true }, make("div", {}, parts.statusWord, parts.status),
    make("div", {}, parts.controlWord, parts.control), make("div", {}, parts.state, parts.effort, parts.limits));
  element.id = `words-of-${axis.name}`;
  return { parts, element };
}

function toggle(element, axis) {
  const made = button("Words", () => {
    element.hidden = !element.hidden;
    made.setAttribute("aria-expanded", String(!element.hidden));
  }, { className: "quiet-button words-button" });
  made.setAttribute("aria-expanded", "false");
  made.setAttribute("aria-label", `words of ${axis.name}`);
  return made;
}

function headOf(axis, path, granted, parts, words) {
  const right = make("div", { className: "head-actions" });
  if (granted) {
    parts.enable = button("Enable", () => act(`${path}/enable`), { className: "enable" });
    right.append(parts.enable, button("Disable", () => act(`${path}/disable`)));
  }
  right.append(toggle(words, axis));
  return make("header", { className: "card-head" }, make("h3", { textContent: axis.name }), parts.state, parts.moving, parts.mode, right);
}

function troubleOf(path, granted, parts) {
  parts.why = make("span", { className: "why" });
  parts.recover = button("Recover", () => act(`${path}/recover`), { className: "recover" });
  parts.reset = button("Reset", () => act(`${path}/reset_fault`), { className: "reset" });
  parts.trouble = make("div", { className: "trouble", hidden: true }, parts.why);
  if (granted) parts.trouble.append(parts.recover, parts.reset);
  return parts.trouble;
}

function card(axis, grants) {
  const granted = grants.axes.find((known) => known.axis === axis.name);
  const path = `/v1/axes/${encodeURIComponent(axis.name)}`;
  const position = reading("position", "reading large");
  const velocity = reading("velocity", "reading");
  const target = reading("target", "reading");
  const { parts: words, element: wordsElement } = detailsOf(axis);
  const fill = make("div", { className: "fill" });
  const parts = {
    words, wordsElement, fill, position: position.value, velocity: velocity.value, target: target.value,
    state: make("span", { className: "pill state" }), moving: make("span", { className: "moving", textContent: "moving", hidden: true }),
    mode: make("span", { className: "quiet mode" }), bar: make("div", { className: "bar" }, fill), seen: [],
  };
  parts.bar.setAttribute("role", "progressbar");
  parts.bar.setAttribute("aria-label", `progress of the move of ${axis.name}`);
  const stop = button("Stop", () => stopAxis(axis.name), { className: "stop" });
  stop.setAttribute("aria-label", `stop ${axis.name}`);
  const actions = make("div", { className: "row actions" }, stop);
  if (granted && granted.max_velocity !== null) actions.append(...jogs(axis, granted));
  parts.element = make("article", { className: "card" }, headOf(axis, path, granted, parts, wordsElement),
    make("div", { className: "readings" }, position.element, velocity.element, target.element), parts.bar,
    make("div", { className: "motions" }, actions));
  if (granted?.moves) {
    actions.after(homing(axis, path));
    parts.element.append(moves(axis, path, granted));
  }
  // Below the buttons: none of them moves when something is wrong.
  parts.element.append(troubleOf(path, granted, parts), wordsElement);
  parts.element.dataset.axis = axis.name;
  find("axes").append(parts.element);
  showLimits(path, words.limits, axis.count);
  parts.path = path;
  return parts;
}

/** What the drive holds in 607Dh and 607Fh. */
async function showLimits(path, place, count) {
  try {
    const { unit, min_position: min, max_position: max, max_velocity: velocity } = await ask(`${path}/limits`);
    const positions = min === null || max === null ? "none" : min < max ? `${number(min, count)} to ${number(max, count)} ${unit}` : "off";
    write(place, `Limits: positions ${positions}, velocity ${velocity ? `${number(velocity, count)} ${unit}/s` : "none"}`);
  } catch (error) {
    write(place, `Limits: ${error.message}`);
  }
}

/** Reads the limits of all axes again: an object was written. */
export function refreshLimits() {
  for (const parts of cards.values()) showLimits(parts.path, parts.words.limits, parts.count);
}

/** Whether it goes somewhere, or is moved: noise is neither. */
function isMoving(axis, parts) {
  parts.seen.push(axis.position);
  if (parts.seen.length > LOOKS) parts.seen.shift();
  const moved = Math.abs(axis.position - parts.seen[0]) > STANDS * axis.count;
  return !axis.lost && ((axis.has_set_point && !axis.halted) || moved);
}

function showGoal(axis, parts) {
  const goal = goalOf(axis.name);
  const isMove = axis.mode_number === 1 && goal.to !== null;
  const isJog = axis.mode_number === 3 && goal.velocity !== null;
  write(parts.target, isMove ? `${number(goal.to, axis.count)} ${axis.unit}`
    : isJog ? `${number(goal.velocity, axis.count)} ${axis.unit}/s` : "–");
  const way = isMove && axis.has_set_point ? goal.to - goal.from : 0;
  const done = way === 0 ? 0 : Math.min(Math.max((axis.position - goal.from) / way, 0), 1);
  parts.bar.classList.toggle("busy", way !== 0);
  parts.fill.style.width = `${100 * done}%`;
  parts.bar.setAttribute("aria-valuenow", String(Math.round(100 * done)));
}

function showTrouble(axis, parts) {
  parts.trouble.hidden = !axis.trouble;
  write(parts.why, axis.trouble ? `${axis.trouble.kind === "lost" ? "Lost" : "Fault"}: ${axis.trouble.text}` : "");
  parts.recover.hidden = axis.trouble?.kind !== "lost";
  parts.reset.hidden = axis.trouble?.kind !== "fault";
}

function showBits(list, word, names) {
  const shown = names.map(({ bit, name }) => `${bit} ${name}`);
  if (list.dataset.names !== shown.join()) {
    list.dataset.names = shown.join();
    list.replaceChildren(...shown.map((text, place) => make("li", { textContent: text, className: names[place].isOfMode ? "of-mode" : "" })));
  }
  [...list.children].forEach((item, place) => item.classList.toggle("set", isSet(word, names[place].bit)));
}

function showWords(axis, { words, wordsElement }) {
  if (wordsElement.hidden) return;
  write(words.statusWord, `Statusword ${hexadecimal(axis.statusword.value, 4)}h`);
  write(words.controlWord, `Controlword ${hexadecimal(axis.controlword, 4)}h`);
  showBits(words.status, axis.statusword.value, statusBits(axis.mode_number));
  showBits(words.control, axis.controlword, controlBits(axis.mode_number));
  write(words.state, `${axis.state}; ${axis.mode}; ${axis.referenced ? "referenced" : "not referenced"}${axis.has_set_point ? "; has a set-point" : ""}`);
  const effort = [
    axis.following_error !== null && `following error ${number(axis.following_error, axis.count)} ${axis.unit}`,
    axis.torque !== null && `torque ${(100 * axis.torque).toFixed(1)} % of rated`,
  ];
  write(words.effort, effort.filter(Boolean).join(", ") || "Following error and torque: map 60F4h and 6077h");
}

function showAxis(axis, parts) {
  const { word, kind } = stateWord(axis);
  write(parts.state, word);
  parts.state.className = `pill state ${kind}`;
  parts.state.title = axis.state;
  parts.element.dataset.kind = kind;
  parts.element.classList.toggle("bad", kind === "bad");
  parts.moving.hidden = !isMoving(axis, parts);
  write(parts.mode, `${modeName(axis.mode_number)}, drive ${axis.drive}${axis.referenced ? "" : ", not referenced"}`);
  write(parts.position, `${number(axis.position, axis.count)} ${axis.unit}`);
  write(parts.velocity, `${number(axis.velocity, axis.count)} ${axis.unit}/s`);
  if (parts.enable) parts.enable.disabled = axis.state === "Operation enabled" || kind === "bad";
  showGoal(axis, parts);
  showTrouble(axis, parts);
  showWords(axis, parts);
}

export function showAxes(axes, grants) {
  for (const axis of axes) {
    if (!cards.has(axis.name)) cards.set(axis.name, { ...card(axis, grants), count: axis.count });
    showAxis(axis, cards.get(axis.name));
  }
}

export function offerEnableAll(grants) {
  find("enable-all").hidden = grants.axes.length === 0;
  find("enable-all").addEventListener("click", () => act("/v1/enable"));
}
