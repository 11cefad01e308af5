// All values of a drive: saved to a file, and compared with one.

import { ask } from "./connection.js";
import { find, make, save, tell, write } from "./dom.js";
import { address, objectPath, valueOf } from "./values.js";

/** The values of all objects of a drive that can be read now, by their addresses. */
export async function valuesOf(drive, progress) {
  const objects = (await ask(`/v1/od/${drive}`)).filter((object) => /\br[ow]/.test(object.access));
  const values = {};
  for (const [place, object] of objects.entries()) {
    progress(`${place} of ${objects.length} objects are read`);
    try {
      const { bytes } = await ask(objectPath(drive, object));
      values[address(object)] = { name: object.name, type: object.type, bytes };
    } catch (error) {
      // One that the drive refuses now has no value.
      if (error.abort == null) throw error;
    }
  }
  progress("");
  return values;
}

/** The values that differ, or are on one side alone. */
export function showDifferences(saved, present) {
  const text = (entry) => (entry ? String(valueOf(entry.bytes, entry.type)) : "none");
  const addresses = [...new Set([...Object.keys(saved), ...Object.keys(present)])].sort();
  const differ = addresses.filter((object) => text(saved[object]) !== text(present[object]));
  find("differences").replaceChildren(...differ.map((object) => make("tr", {}, make("td", { textContent: object }),
    make("td", { textContent: (saved[object] ?? present[object]).name }), make("td", { textContent: text(saved[object]) }),
    make("td", { textContent: text(present[object]) }))));
  find("compared").hidden = false;
  write(find("compared-state"), `${differ.length} of ${addresses.length} values differ.`);
}

/** Runs what reads all objects of the drive that is chosen, with its progress shown. */
async function withValues(work) {
  const buttons = [find("save-values"), find("compare-values")];
  try {
    tell("");
    for (const button of buttons) button.disabled = true;
    work(await valuesOf(find("drive").value, (text) => write(find("values-state"), text)));
  } catch (error) {
    tell(error.message);
  } finally {
    for (const button of buttons) button.disabled = false;
  }
}

async function compareWith(file) {
  try {
    const saved = JSON.parse(await file.text());
    if (!Object.values(saved).every((entry) => Array.isArray(entry.bytes))) throw new Error("it has no values");
    withValues((present) => showDifferences(saved, present));
  } catch (error) {
    tell(`${file.name} was not saved by this page: ${error.message}`);
  }
}

find("save-values").addEventListener("click", () => withValues((values) =>
  save(`servocrab-drive-${find("drive").value}.json`, JSON.stringify(values, null, 1), "application/json")));
find("compare-values").addEventListener("click", () => find("compare-file").click());
find("compare-file").addEventListener("change", () => {
  const [file] = find("compare-file").files;
  find("compare-file").value = "";
  if (file) compareWith(file);
});
