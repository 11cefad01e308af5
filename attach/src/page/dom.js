// What all parts of the page use of it: elements, messages, numbers as texts, colours.

export const find = (id) => document.getElementById(id);

export function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

export function button(text, action, properties = {}) {
  const made = make("button", { type: "button", textContent: text, ...properties });
  made.addEventListener("click", action);
  return made;
}

/** Of a text that did not change nothing is drawn anew, and a selection in it stays. */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Above the page, until the next command. */
export function tell(text) {
  write(find("message"), text);
  find("message").hidden = text === "";
}

export const hexadecimal = (number, digits) => number.toString(16).toUpperCase().padStart(digits, "0");

const MINUS = "−";

/** With as many decimals as one count of the axis needs. */
export function number(value, count) {
  const text = value.toFixed(count > 0 ? Math.min(Math.max(Math.ceil(-Math.log10(count)), 0), 9) : 3);
  const plain = Number(text) === 0 ? text.replace("-", "") : text;
  return plain.replace("-", MINUS);
}

/** Of a value whose resolution is not known. */
export function rounded(value) {
  if (value === null || value === undefined) return "–";
  const text = Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(6)));
  return text.replace("-", MINUS);
}

/** A colour of the theme that holds now. */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

export function save(name, text, type) {
  const url = URL.createObjectURL(new Blob([text], { type }));
  make("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}
