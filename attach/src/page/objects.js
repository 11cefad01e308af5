// The objects of a drive: filtered as one types, read as they come into view, edited in place.

import { ask } from "./connection.js";
import { refreshLimits } from "./cards.js";
import { button, find, make, tell, write } from "./dom.js";
import { address, bytesOf, objectPath, valueOf, wordOf } from "./values.js";

/** Rows at a time: a drive can have thousands of objects. */
const ROWS = 400;

let objects = [];
let drive = null;
/** What is read of each object that came into view, in this order. */
const queue = [];
let reads = false;

const isReadable = (object) => /\br[ow]/i.test(object.access);
const isWritable = (object) => /w/i.test(object.access);

/** One after the other: the drive's mailbox is the program's. */
async function readQueue() {
  if (reads) return;
  reads = true;
  while (queue.length > 0) {
    const row = queue.shift();
    if (row.isConnected && row.isVisible) await readRow(row);
  }
  reads = false;
}

async function readRow(row) {
  const { object, value } = row;
  try {
    const { bytes } = await ask(objectPath(row.drive, object));
    row.text = valueOf(bytes, object.type);
    row.isRead = true;
    if (row.isEdited) return;
    value.className = "value";
    value.replaceChildren(row.text, " ", make("span", { className: "quiet", textContent: wordOf(bytes, object.type) }));
  } catch (error) {
    // The drive has refused it; without its word it is asked again when it is seen again.
    row.isRead = error.abort != null;
    if (row.isEdited) return;
    value.className = "value refused";
    write(value, error.message);
  }
}

const seen = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    target.isVisible = isIntersecting;
    if (isIntersecting && !target.isRead && isReadable(target.object)) queue.push(target);
  }
  readQueue();
}, { root: find("objects-scroll"), rootMargin: "60px" });

function readAgain() {
  for (const row of find("objects").children) {
    row.isRead = false;
    if (row.isVisible && isReadable(row.object)) queue.push(row);
  }
  readQueue();
}

/** In the page itself and in no window: while one is open the page hears neither a button nor a key, so nobody could stop. */
function edit(row) {
  if (row.isEdited) return;
  row.isEdited = true;
  const { object, value } = row;
  const typed = make("input", { type: "text", value: row.text ?? "", className: "edit" });
  typed.setAttribute("aria-label", `value for ${address(object)}`);
  const close = () => {
    row.isEdited = false;
    value.replaceChildren(row.text ?? "");
    queue.push(row);
    readQueue();
  };
  const put = async () => {
    try {
      tell("");
      await ask(objectPath(row.drive, object), { bytes: bytesOf(typed.value, object.type, object.bits) });
      close();
      refreshLimits();
    } catch (error) {
      tell(error.message);
      typed.focus();
    }
  };
  typed.addEventListener("keydown", (event) => {
    if (event.key === "Enter") put();
    if (event.key === "Escape") close();
  });
  value.replaceChildren(typed, button("Write", put), button("Cancel", close, { className: "quiet-button" }));
  typed.focus();
  typed.select();
}

export function objectRow(ofDrive, object, grants) {
  const value = make("div", { className: "value quiet", textContent: isReadable(object) ? "…" : "write only" });
  const cell = make("td", {}, value);
  const row = make("tr", {}, make("td", { className: "address", textContent: address(object) }), make("td", { textContent: object.name }),
    make("td", { className: "type", textContent: object.type }), make("td", { className: "access", textContent: object.access }), cell);
  Object.assign(row, { object, value, drive: ofDrive });
  row.dataset.object = address(object);
  if (grants.parameters && isWritable(object) && !object.owned) {
    cell.className = "editable";
    const change = button("Edit", () => edit(row), { className: "quiet-button" });
    change.setAttribute("aria-label", `edit ${address(object)}`);
    cell.append(change);
    value.addEventListener("click", () => edit(row));
  }
  return row;
}

function showObjects(grants) {
  const filter = find("filter").value.trim().toLowerCase();
  const fits = objects.filter((object) => address(object).toLowerCase().includes(filter) || object.name.toLowerCase().includes(filter));
  seen.disconnect();
  queue.length = 0;
  const rows = fits.slice(0, ROWS).map((object) => objectRow(drive, object, grants));
  find("objects").replaceChildren(...rows);
  for (const row of rows) seen.observe(row);
  const more = fits.length > ROWS ? `, the first ${ROWS} are shown` : "";
  write(find("objects-state"), `${fits.length} of ${objects.length} objects${more}`);
}

async function list(grants) {
  drive = find("drive").value;
  const asked = drive;
  try {
    write(find("objects-state"), "the objects are listed …");
    const listed = await ask(`/v1/od/${asked}`);
    if (asked !== drive) return;
    objects = listed;
    showObjects(grants);
  } catch (error) {
    write(find("objects-state"), error.message);
  }
}

/** They are listed once somebody looks: that can take a drive seconds. */
export function offerObjects(drives, grants) {
  find("drive").replaceChildren(...drives.map((known) => make("option", { value: known.position, textContent: `${known.position}: ${known.name}` })));
  find("drive").addEventListener("change", () => list(grants));
  find("filter").addEventListener("input", () => showObjects(grants));
  find("read-again").addEventListener("click", readAgain);
  const wanted = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting) || drives.length === 0) return;
    wanted.disconnect();
    list(grants);
  });
  wanted.observe(find("objects-section"));
}
