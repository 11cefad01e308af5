// The bits of statusword and controlword by their names, of which some are those of the mode that 6061h shows.

const STATUS = ["ready to switch on", "switched on", "operation enabled", "fault", "voltage enabled", "quick stop (0: active)",
  "switch on disabled", "warning", "manufacturer's 8", "remote", "target reached", "internal limit", "of the mode", "of the mode",
  "manufacturer's 14", "manufacturer's 15"];
const CONTROL = ["switch on", "enable voltage", "quick stop (0: active)", "enable operation", "of the mode", "of the mode", "of the mode",
  "fault reset", "halt", "of the mode", "reserved", "manufacturer's 11", "manufacturer's 12", "manufacturer's 13", "manufacturer's 14",
  "manufacturer's 15"];

const MODES = {
  1: {
    name: "profile position",
    status: { 12: "set-point acknowledge", 13: "following error" },
    control: { 4: "new set-point", 5: "change set immediately", 6: "relative", 9: "change on set-point" },
  },
  3: {
    name: "profile velocity",
    status: { 12: "speed is 0", 13: "max slippage error" },
    control: {},
  },
  6: {
    name: "homing",
    status: { 12: "homing attained", 13: "homing error" },
    control: { 4: "homing operation start" },
  },
  8: {
    name: "cyclic position",
    status: { 12: "drive follows the command", 13: "following error" },
    control: {},
  },
  9: { name: "cyclic velocity", status: { 12: "drive follows the command" }, control: {} },
  10: { name: "cyclic torque", status: { 12: "drive follows the command" }, control: {} },
};

export const modeName = (mode) => MODES[mode]?.name ?? (mode === 0 ? "no mode" : `mode ${mode}`);

function bits(names, ofMode) {
  return names.map((name, bit) => ({ bit, name: ofMode[bit] ?? name, isOfMode: bit in ofMode }));
}

/** All 16 bits of a statusword in this mode: number, name, whether the mode gives the name. */
export const statusBits = (mode) => bits(STATUS, MODES[mode]?.status ?? {});
export const controlBits = (mode) => bits(CONTROL, MODES[mode]?.control ?? {});
export const isSet = (word, bit) => ((word >> bit) & 1) === 1;

/** A state of DS402 in one word, and its kind: what colour it has. */
export function stateWord(axis) {
  if (axis.trouble?.kind === "lost" || axis.lost) return { word: "lost", kind: "bad" };
  if (axis.state.startsWith("Fault")) return { word: "fault", kind: "bad" };
  if (axis.slipped) return { word: "slipped on its brake", kind: "warn" };
  if (axis.state === "Operation enabled") return axis.halted ? { word: "halted", kind: "warn" } : { word: "enabled", kind: "good" };
  if (axis.state === "Quick stop active") return { word: "stopped", kind: "warn" };
  if (axis.state === "Not ready to switch on") return { word: "starting", kind: "warn" };
  return { word: "disabled", kind: "off" };
}
