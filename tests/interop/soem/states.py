"""Checks on the way from PREOP to OP: mapping, clock, watchdog, AL states."""

import time

import pysoem

from bench import read_register, set_watchdog, write_register
from drive import expect, until

DC_CYCLE_NS = 2_000_000
WATCHDOG_MS = 1000


def default_mapping(bench):
    """A master that configures nothing: sizes and SAFEOP by what the drive says of itself."""
    expect("the number of SubDevices", bench.open(manual=False), 1)
    bench.master.config_map()
    sizes = len(bench.slave.output), len(bench.slave.input)
    expect("the image", sizes, tuple(bench.drive.table["default_bytes"]))
    expect("the state", bench.master.state_check(pysoem.SAFEOP_STATE, 5_000_000), pysoem.SAFEOP_STATE)
    return "{} bytes of outputs, {} of inputs, SAFEOP".format(*sizes)


def mapped(bench, pdo):
    """The entries of a PDO."""
    return [f"{bench.read(pdo, at + 1, 'I'):08X}" for at in range(bench.read(pdo, 0, "B"))]


def mapping_refusals(bench):
    """Entries and PDOs that cannot be, and the order that must be kept; afterwards the mapping is what it was."""
    axis = bench.drive.axes[0]
    before = mapped(bench, axis.rx)
    assigned = bench.read(0x1C12, 0, "B")
    refusals = 0

    def refused(what, code, index, subindex, kind, value):
        nonlocal refusals
        seen = bench.abort_of(lambda: bench.write(index, subindex, kind, value))
        expect(what, f"{seen:08X}", code)
        refusals += 1

    controlword = axis.index(0x6040) << 16 | 16
    bench.write(0x1C12, 0, "B", 0)
    refused("an entry before the PDO is empty", "06010003", axis.rx, 1, "I", controlword)
    bench.write(axis.rx, 0, "B", 0)
    refused("an object that goes into no PDO", "06040041", axis.rx, 1, "I", 0x1000 << 16 | 32)
    refused("an input among the outputs", "06040041", axis.rx, 1, "I", axis.index(0x6041) << 16 | 16)
    refused("an object that does not exist", "06020000", axis.rx, 1, "I", 0x2FFE << 16 | 16)
    refused("another length than the object's", "06070010", axis.rx, 1, "I", controlword + 16)
    refused("more entries than there is room for", "06040042", axis.rx, 0, "B", 200)
    refused("a PDO that does not exist", "06090030", 0x1C12, 1, "H", 0x16FF)
    bench.write(axis.rx, 0, "B", len(before))
    bench.write(0x1C12, 0, "B", assigned)
    expect("the mapping", mapped(bench, axis.rx), before)
    return f"{refusals} refusals"


def remapping(bench):
    """Writes another mapping than the one at power-up, reads it back, and lets SOEM make its image of it."""
    drive, slave = bench.drive, bench.slave
    before = {pdo: mapped(bench, pdo) for axis in drive.axes for pdo in (axis.rx, axis.tx)}

    def configure(_position):
        for index, subindex, kind, value in drive.startup:
            bench.write(index, subindex, kind, value)
        for sync_manager, side in ((0x1C12, "rx"), (0x1C13, "tx")):
            bench.write(sync_manager, 0, "B", 0)
            for at, axis in enumerate(drive.axes):
                pdo, fields = getattr(axis, side), axis.outputs if side == "rx" else axis.inputs
                fields = [field for field in fields if field.mapped]
                bench.write(pdo, 0, "B", 0)
                for slot, field in enumerate(fields):
                    bench.write(pdo, slot + 1, "I", field.entry)
                bench.write(pdo, 0, "B", len(fields))
                bench.write(sync_manager, at + 1, "H", pdo)
            bench.write(sync_manager, 0, "B", len(drive.axes))

    slave.config_func = configure
    bench.master.config_map()
    for axis in drive.axes:
        for pdo, fields in ((axis.rx, axis.outputs), (axis.tx, axis.inputs)):
            wanted = [f"{field.entry:08X}" for field in fields if field.mapped]
            expect(f"{pdo:04X}h is another than at power-up", wanted != before[pdo], True)
            expect(f"{pdo:04X}h", mapped(bench, pdo), wanted)
    sizes = len(slave.output), len(slave.input)
    expect("the image", sizes, (drive.output_bytes, drive.input_bytes))
    expect("the state", bench.state(), pysoem.PREOP_STATE)
    return "{} bytes of outputs, {} of inputs".format(*sizes)


def clock(bench):
    """Delay measurement, offset, and the registers that make SYNC0."""
    slave = bench.slave
    expect("a clock was found", bool(bench.master.config_dc()), True)
    slave.dc_sync(True, DC_CYCLE_NS, 100_000)
    expect("cyclic operation and SYNC0 (0981h)", read_register(slave, 0x0981, "B") & 0x03, 0x03)
    cycle = read_register(slave, 0x09A0, "I")
    expect("SYNC0 cycle (09A0h)", cycle, DC_CYCLE_NS)
    start = read_register(slave, 0x0990, "Q")
    system = read_register(slave, 0x0910, "Q")
    expect("SYNC0 starts later than now (0990h, 0910h)", start > system, True)
    later = read_register(slave, 0x0910, "Q")
    expect("the system time runs", later > system, True)
    return f"SYNC0 each {cycle} ns"


def al_refusals(bench):
    """What the drive must not go along with, each with its AL status code; afterwards it is as it was."""
    preop = pysoem.PREOP_STATE
    # Two states up at once.
    bench.refused(pysoem.OP_STATE, preop, "0011")
    # Sync managers whose length is not that of the mapping.
    for register, code in ((0x0810, "001D"), (0x0818, "001E")):
        length = read_register(bench.slave, register + 2, "H")
        set_sync_manager(bench, register, 2, "H", length + 1)
        bench.refused(pysoem.SAFEOP_STATE, preop, code)
        set_sync_manager(bench, register, 2, "H", length)
    # SYNC0 without a cycle; SYNC1, which is in no clock mode of the SII.
    bench.slave.dc_sync(True, 0)
    bench.refused(pysoem.SAFEOP_STATE, preop, "0035")
    bench.slave.dc_sync(True, DC_CYCLE_NS, 0, DC_CYCLE_NS)
    bench.refused(pysoem.SAFEOP_STATE, preop, "0030")
    bench.slave.dc_sync(True, DC_CYCLE_NS, 100_000)
    return "0011h 001Dh 001Eh 0035h 0030h"


def set_sync_manager(bench, register, offset, kind, value):
    """Its settings are locked while it is on."""
    write_register(bench.slave, register + 6, "B", 0)
    write_register(bench.slave, register + offset, kind, value)
    write_register(bench.slave, register + 6, "B", 1)


def watchdog_on(bench):
    """The watchdog's trigger, which not every SII has on."""
    slave = bench.slave
    set_watchdog(slave, WATCHDOG_MS)
    control = read_register(slave, 0x0814, "B") | 0x40
    set_sync_manager(bench, 0x0810, 4, "B", control)
    expect("0814h", read_register(slave, 0x0814, "B"), control)
    return f"{WATCHDOG_MS} ms, 0814h = {control:02X}h"


def safe_op(bench):
    bench.request(pysoem.SAFEOP_STATE)
    until("SAFEOP", lambda: bench.state() == pysoem.SAFEOP_STATE)
    # No outputs have come.
    bench.refused(pysoem.OP_STATE, pysoem.SAFEOP_STATE, "0019")
    bench.cycle()
    statuswords = [bench.get(axis, 0x6041) for axis in bench.drive.numbers]
    by_sdo = [bench.read(axis.index(0x6041), 0, "H") for axis in bench.drive.axes]
    expect("the statuswords in the inputs", statuswords, by_sdo)
    refused = bench.abort_of(lambda: bench.write(0x1C12, 0, "B", 0))
    expect("1C12h in SAFEOP", f"{refused:08X}", "08000022")
    return "statuswords " + " ".join(f"{word:04X}h" for word in statuswords)


def operational(bench):
    for axis in bench.drive.numbers:
        bench.set(axis, 0x6060, 1)
        bench.set(axis, 0x6040, 0)
        bench.set(axis, 0x607A, bench.get(axis, 0x6064))
    bench.cycle_until("outputs are taken", lambda: True)
    bench.request(pysoem.OP_STATE)
    bench.cycle_until("OP", lambda: bench.state() == pysoem.OP_STATE)
    return f"working counter {bench.master.expected_wkc}"


def cyclic(bench):
    """Each of many exchanges is answered in full, while SDOs go on beside them; the reference clock comes with each."""
    exchanges = 600
    begun, clock = time.monotonic_ns(), bench.master.dc_time
    for number in range(exchanges):
        expect("the working counter", bench.cycle(), bench.master.expected_wkc)
        if number % 50 == 0:
            expect("6061h", bench.read(0x6061, 0, "b"), bench.get(0, 0x6061))
    expect("the state", bench.state(), pysoem.OP_STATE)
    # The two clocks are read at different times, between which a busy machine may do something else.
    passed, told = time.monotonic_ns() - begun, bench.master.dc_time - clock
    expect(f"the time of the clock ({told} ns) is ours ({passed} ns)", abs(told - passed) < 0.1 * passed + 300_000_000, True)
    return f"{exchanges} exchanges"
