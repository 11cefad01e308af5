"""Runs the SOEM master against several SubDevices in a line: `line.py INTERFACE TABLE DEVICE...`, the first nearest.

As main.py for one drive: a line `ok NAME: what was seen` for each check, the first failure ends the program.
"""

import json
import sys

import pysoem

from bench import FRAME_US, patient, read_register, set_watchdog
from drive import expect, report, until


# So long that a busy machine does not let it expire.
WATCHDOG_MS = 1000


class Line:
    def __init__(self, interface, rows):
        self.interface = interface
        self.rows = rows
        self.master = pysoem.Master()

    def close(self):
        self.master.close()

    def states(self):
        self.master.read_state()
        return {slave.state for slave in self.master.slaves}

    def cycle(self):
        self.master.send_processdata()
        return self.master.receive_processdata(FRAME_US)

    def registers(self, address, kind):
        return [read_register(slave, address, kind) for slave in self.master.slaves]


def line_scan(line):
    line.master.open(line.interface)
    expect("the number of SubDevices", line.master.config_init(), len(line.rows))
    for slave, row in zip(line.master.slaves, line.rows):
        seen = f"{slave.man:08X}", f"{slave.id:08X}", f"{slave.rev:08X}", slave.name
        expect("identity and name", seen, tuple(row[key] for key in ("vendor", "product", "revision", "order")))
    until("PREOP", lambda: line.states() == {pysoem.PREOP_STATE})
    return f"{len(line.rows)} SubDevices"


def line_map(line):
    """Each by its own description, those without a mailbox by their SII."""
    line.master.config_map()
    sizes = [[len(slave.output), len(slave.input)] for slave in line.master.slaves]
    expect("the images", sizes, [row["default_bytes"] for row in line.rows])
    # Outputs count twice in the working counter of an LRW, inputs once.
    counts = sum(2 * (outputs > 0) + (inputs > 0) for outputs, inputs in sizes)
    expect("the working counter", line.master.expected_wkc, counts)
    for slave in line.master.slaves:
        set_watchdog(slave, WATCHDOG_MS)
    return f"working counter {counts}"


def line_clock(line):
    """Delays grow along the line; after the offsets are set and drift frames have gone round, all clocks agree."""
    expect("a clock was found", bool(line.master.config_dc()), True)
    delays = line.registers(0x0928, "I")
    expect("the delays grow", delays, sorted(set(delays)))
    until("SAFEOP", lambda: line.states() == {pysoem.SAFEOP_STATE})
    for _ in range(30):
        # How many frames it takes depends on how far apart they are.
        for _ in range(100):
            expect("the working counter", line.cycle(), line.master.expected_wkc)
        # The first is the reference and compares itself with nobody.
        differences = [value & 0x7FFFFFFF for value in line.registers(0x092C, "I")[1:]]
        if max(differences) < 1_000:
            break
    expect(f"the clocks agree to 1 µs ({differences} ns)", max(differences) < 1_000, True)
    return f"delays {delays} ns"


def line_operational(line):
    line.master.state = pysoem.OP_STATE
    line.master.write_state()

    def in_op():
        expect("the working counter", line.cycle(), line.master.expected_wkc)
        return line.states() == {pysoem.OP_STATE}

    until("OP", in_op)
    exchanges = 300
    for _ in range(exchanges):
        expect("the working counter", line.cycle(), line.master.expected_wkc)
    expect("the states", line.states(), {pysoem.OP_STATE})
    return f"all in OP, {exchanges} exchanges"


CHECKS = (line_scan, line_map, line_clock, line_operational)


def main():
    interface, table, *names = sys.argv[1:]
    with open(table) as file:
        table = json.load(file)
    patient()
    return report(Line(interface, [table[name] for name in names]), CHECKS)


if __name__ == "__main__":
    sys.exit(main())
