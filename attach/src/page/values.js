// The values of objects: bytes as they are transferred, and the texts that people read and type.

import { hexadecimal } from "./dom.js";

export const address = (object) => `${hexadecimal(object.index, 4)}h:${hexadecimal(object.subindex, 2)}`;
export const objectPath = (drive, object) => `/v1/od/${drive}/${hexadecimal(object.index, 4)}h/${hexadecimal(object.subindex, 2)}`;

/** The number of these bytes, which come with the lowest first. */
const whole = (bytes) => bytes.reduceRight((number, byte) => (number << 8n) | BigInt(byte), 0n);
const widthOf = (type) => Number(/^(?:UNSIGNED|INTEGER|REAL)(\d+)$/.exec(type)?.[1] ?? 0) / 8;

/** A number of 32 bits with the digits that it was written with, and none of the conversion's. */
function ofSingle(value) {
  const digits = [6, 7, 8, 9].map((count) => Number(value.toPrecision(count)));
  return digits.find((short) => Math.fround(short) === value) ?? value;
}

export function valueOf(bytes, type) {
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

/** A whole number in hexadecimal too. */
export function wordOf(bytes, type) {
  return /^(UNSIGNED|INTEGER)/.test(type) && bytes.length > 0 ? `${hexadecimal(whole(bytes), 1)}h` : "";
}

function bytesOfReal(typed, width, wrong) {
  const number = Number(typed);
  const view = new DataView(new ArrayBuffer(width));
  if (width === 4) view.setFloat32(0, number, true);
  else view.setFloat64(0, number, true);
  const kept = width === 4 ? view.getFloat32(0, true) : number;
  if (!Number.isFinite(kept)) throw wrong();
  return [...new Uint8Array(view.buffer)];
}

function bytesOfWhole(typed, type, width, wrong) {
  if (!/^(-?\d+|0x[0-9a-f]+)$/i.test(typed)) throw wrong();
  const number = BigInt(typed);
  const kept = type.startsWith("INTEGER") ? BigInt.asIntN(8 * width, number) : BigInt.asUintN(8 * width, number);
  if (kept !== number) throw wrong();
  return Array.from({ length: width }, (_, place) => Number((number >> BigInt(8 * place)) & 0xffn));
}

/** The bytes of what was typed. What the type does not hold is refused: a number that is cut is another one. */
export function bytesOf(text, type, bits) {
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
  return type.startsWith("REAL") ? bytesOfReal(typed, width, wrong) : bytesOfWhole(typed, type, width, wrong);
}
