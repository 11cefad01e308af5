// Requests to the server, with the token of the address.

import { tell } from "./dom.js";

const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";

export async function ask(path, body, method, signal) {
  const options = { headers: { Authorization: `Bearer ${token}` }, method: method ?? (body === undefined ? "GET" : "POST"), signal };
  if (body !== undefined && body !== null) options.body = JSON.stringify(body);
  const response = await fetch(path, options);
  const answer = await response.json();
  if (!response.ok) throw Object.assign(new Error(answer.error?.text ?? `${response.status}`), { abort: answer.error?.abort });
  return answer;
}

/** A command; why it was not done is said above the page. */
export async function act(path, body = null) {
  try {
    tell("");
    return await ask(path, body, "POST");
  } catch (error) {
    tell(error.message);
    return null;
  }
}

export function openSocket(path) {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  return new WebSocket(`${scheme}://${location.host}${path}`, ["servocrab", `token.${token}`]);
}

export const streamPath = (signals, every = 1) =>
  `/v1/stream?every=${every}&signals=${signals.map(encodeURIComponent).join(",")}`;

/** A stream has 512 signals at most, and its request has room for so many characters. */
const [SIGNALS, CHARACTERS] = [512, 12_000];

/** How many of these signals one stream has room for. */
export function fitting(signals) {
  let length = 0;
  const end = signals.findIndex((signal) => {
    length += encodeURIComponent(signal).length + 1;
    return length > CHARACTERS;
  });
  return Math.min(end < 0 ? signals.length : end, SIGNALS);
}

/** One block of a stream: see streams.rs. */
export function decodeBlock(buffer) {
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

/** The cycles of these signals, block by block, also after a connection that was lost, until what is given back is called. */
export function follow(signals, every, take) {
  let socket;
  let isOver = false;
  const open = () => {
    if (isOver) return;
    socket = openSocket(streamPath(signals, every));
    socket.binaryType = "arraybuffer";
    socket.onmessage = (message) => {
      if (typeof message.data !== "string") take(decodeBlock(message.data).cycles);
    };
    socket.onclose = () => setTimeout(open, 1000);
  };
  open();
  return () => {
    isOver = true;
    socket.close();
  };
}
