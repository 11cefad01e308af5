"""Runs the SOEM master against one simulated drive: `soem.py INTERFACE DRIVE`.

What each drive should answer is in drives.json; the program has no case for any of them. Each check prints a line
`ok NAME: what was seen` or `FAILED NAME: why`; a failure ends the program, because the checks go up the EtherCAT states
one after the other. Nothing here shares code or constants with the simulated drive or with the library under test.
"""

import json
import pathlib
import struct
import sys
import time
import traceback

import pysoem

from drive import Drive, expect, until

MS = 1_000_000
CYCLE_NS = 1 * MS
DC_CYCLE_NS = 2 * MS
WATCHDOG_MS = 500


class Bench:
    """The master, its only SubDevice, and the process data."""

    def __init__(self, interface, drive):
        self.drive = drive
        # A busy machine is no lost frame: the timeouts for one are far longer than SOEM's 2 ms.
        timeouts = pysoem.settings.timeouts
        timeouts.ret, timeouts.safe = 100_000, 200_000
        timeouts.rx_mailbox, timeouts.tx_mailbox = 2_000_000, 500_000
        self.master = pysoem.Master()
        # The state changes are checks of their own.
        self.master.manual_state_change = True
        self.master.open(interface)
        self.found = self.master.config_init()
        self.slave = self.master.slaves[0] if self.master.slaves else None
        self.emergencies = []
        self.outputs = {}
        self.next_cycle = 0

    def prepare(self):
        self.slave.add_emergency_callback(self.emergencies.append)

    def read(self, index, subindex, kind):
        return struct.unpack(f"<{kind}", self.slave.sdo_read(index, subindex))[0]

    def write(self, index, subindex, kind, value):
        self.slave.sdo_write(index, subindex, struct.pack(f"<{kind}", value))

    def request(self, state, acknowledge=False):
        self.slave.state = state | (pysoem.STATE_ACK if acknowledge else 0)
        self.slave.write_state()

    def state(self):
        self.master.read_state()
        return self.slave.state

    def set(self, axis, index, value):
        """Sets an output, in the process data or by SDO, as the drive has it."""
        field = self.drive.output(axis, index)
        if field.mapped:
            self.outputs[field.index] = value
        else:
            self.slave.sdo_write(field.index, field.subindex, field.pack(value))

    def get(self, axis, index):
        field = self.drive.input(axis, index)
        return field.unpack(self.slave.input)

    def cycle(self):
        """One exchange of process data, at its time; gives the working counter."""
        now = time.monotonic_ns()
        if now < self.next_cycle:
            time.sleep((self.next_cycle - now) / 1e9)
        self.next_cycle = max(now, self.next_cycle) + CYCLE_NS
        data = bytearray(self.drive.output_bytes)
        for field in self.drive.mapped_outputs():
            field.put(data, self.outputs.get(field.index, 0))
        self.slave.output = bytes(data)
        self.master.send_processdata()
        return self.master.receive_processdata(100_000)

    def cycle_until(self, what, condition, seconds=5):
        def step():
            wkc = self.cycle()
            expect("the working counter", wkc, self.master.expected_wkc)
            return condition()

        until(what, step, seconds)

    def abort_of(self, action):
        try:
            action()
        except pysoem.SdoError as error:
            return error.abort_code
        raise AssertionError("it was not refused")


def scan(bench):
    slaves = bench.master.slaves
    expect("the number of SubDevices", (bench.found, len(slaves)), (1, 1))
    slave = bench.slave
    bench.prepare()
    seen = (slave.man, slave.id, slave.rev)
    expect("vendor, product, revision", seen, bench.drive.identity)
    bench.request(pysoem.PREOP_STATE)
    until("PREOP", lambda: bench.state() == pysoem.PREOP_STATE)
    return "vendor {:08X}h, product {:08X}h, revision {:08X}h".format(*seen)


def sii_strings(bench):
    """SOEM takes string 1 for the name; the rest is read word by word and taken apart here."""
    expect("string 1", bench.slave.name, bench.drive.table["order"])
    words = bytearray()
    while not words.endswith(b"\xff\xff") or len(words) < 0x82:
        expect("the end of the SII", len(words) < 0x4000, True)
        words += bench.slave.eeprom_read(len(words) // 2)[:2]
    checksum = 0xFF
    for byte in words[:14]:
        checksum ^= byte
        for _ in range(8):
            checksum = (checksum << 1 ^ 0x07 if checksum & 0x80 else checksum << 1) & 0xFF
    expect("the checksum", words[14], checksum)
    categories = dict(sii_categories(words))
    strings, at = [], 1
    for _ in range(categories[10][0]):
        length = categories[10][at]
        strings.append(categories[10][at + 1 : at + 1 + length].decode())
        at += 1 + length
    general = categories[30]
    order, name = strings[general[2] - 1], strings[general[3] - 1]
    expect("order and name", (order, name), (bench.drive.table["order"], bench.drive.table["name"]))
    return f"{len(strings)} strings, order {order!r}, name {name!r}"


def sii_categories(words):
    at = 0x80
    while words[at : at + 2] != b"\xff\xff":
        kind, length = struct.unpack_from("<HH", words, at)
        yield kind, bytes(words[at + 4 : at + 4 + 2 * length])
        at += 4 + 2 * length


def identity_by_sdo(bench):
    expect("1018h:0", bench.read(0x1018, 0, "B"), 4)
    seen = tuple(bench.read(0x1018, subindex, "I") for subindex in (1, 2, 3))
    expect("1018h", seen, bench.drive.identity)
    name = bench.slave.sdo_read(0x1008, 0).decode()
    expect("1008h", name, bench.drive.table["name"])
    profile = bench.read(0x1000, 0, "I")
    expect("the profile in 1000h", profile & 0xFFFF, 402)
    return f"1008h {name!r}, 1000h {profile:08X}h"


def expedited(bench):
    """One object of each length, written, read back, and set back."""
    seen = []
    for index, kind, value in ((0x6060, "b", 1), (0x605D, "h", 1), (0x6081, "I", 0x00012345)):
        before = bench.read(index, 0, kind)
        for written in (value, before):
            bench.write(index, 0, kind, written)
            expect(f"{index:04X}h", bench.read(index, 0, kind), written)
        seen.append(f"{index:04X}h")
    return " ".join(seen)


def segmented(bench):
    """A text longer than the mailbox, so that neither way does one mail hold it."""
    index, longest = bench.drive.text_object
    mailbox = struct.unpack("<H", bench.slave.eeprom_read(0x19)[:2])[0]
    expect("the text takes several segments", longest > 2 * mailbox, True)
    # Every length of a last segment that is padded or not, and one that fills the object.
    room = mailbox - 16
    lengths = sorted({room, *range(room + 1, room + 10), 2 * room + 20, longest})
    for length in lengths:
        text = bytes((7 * at + length) % 251 for at in range(length))
        bench.slave.sdo_write(index, 0, text)
        expect(f"{length} bytes", bench.slave.sdo_read(index, 0, size=longest + 8), text)
    return f"{index:04X}h, {len(lengths)} lengths up to {longest} bytes by a mailbox of {mailbox}"


def complete_access(bench):
    if not bench.drive.table["complete_access"]:
        code = bench.abort_of(lambda: bench.slave.sdo_read(0x1018, 0, size=64, ca=True))
        expect("the abort code", f"{code:08X}", "06010004")
        return "not offered, refused with 06010004h"
    expected = struct.pack("<H", 4) + b"".join(
        bench.slave.sdo_read(0x1018, subindex) for subindex in (1, 2, 3, 4)
    )
    expect("1018h", bench.slave.sdo_read(0x1018, 0, size=64, ca=True), expected)
    index = bench.drive.axes[0].rx
    entries = bench.read(index, 0, "B")
    singles = b"".join(bench.slave.sdo_read(index, at + 1) for at in range(entries))
    whole = bench.slave.sdo_read(index, 0, size=1024, ca=True)
    expect(f"{index:04X}h", whole[: 2 + 4 * entries], struct.pack("<H", entries) + singles)
    return f"1018h and {index:04X}h in one transfer each"


def object_list(bench):
    if not bench.drive.table["object_list"]:
        try:
            objects = bench.slave.od
        except pysoem.SdoInfoError:
            # Service not supported.
            expect("the mailbox error", mailbox_errors(bench), {4})
            return "not offered, refused with mailbox error 4"
        raise AssertionError(f"an object list with {len(objects)} entries was not expected")
    objects = {entry.index: entry for entry in bench.slave.od}
    expect("the mandatory objects", {0x1000, 0x1018, 0x1C12, 0x1C13} - objects.keys(), set())
    # What the list says of the objects that this suite moves the drive with is what it uses them as.
    for axis in bench.drive.axes:
        for field in axis.outputs + axis.inputs:
            expect("is in the list", (f"{field.index:04X}h", field.index in objects), (f"{field.index:04X}h", True))
            known = objects[field.index]
            expect(f"the name of {field.index:04X}h", bool(known.name), True)
            expect(f"the bits of {field.index:04X}h", known.bit_length, field.bits)
            expect(f"the type of {field.index:04X}h", known.data_type, field.coe_type)
    identity = objects[0x1018]
    expect("the entries of 1018h", [entry.bit_length for entry in identity.entries], [8, 32, 32, 32, 32])
    return f"{len(objects)} objects, {sum(len(o.entries) for o in objects.values())} entries"


def mailbox_errors(bench):
    """The error mails that SOEM has kept: its wrapper raises one with each call, whether that call went well or not."""
    errors = set()
    for _ in range(100):
        try:
            bench.slave.sdo_read(0x1000, 0)
        except pysoem.MailboxError as error:
            errors.add(error.error_code)
        else:
            return errors
    raise AssertionError("error mails without end")


def aborts(bench):
    """Each refusal has the code of ETG.1000.6, and the drive still answers after it."""
    write, read = bench.slave.sdo_write, bench.slave.sdo_read
    cases = [
        ("no such object", 0x06020000, lambda: read(0x2FFE, 0)),
        ("no such subindex", 0x06090011, lambda: read(0x1018, 9)),
        ("write of a read-only object", 0x06010002, lambda: write(0x6041, 0, b"\0\0")),
        ("too long, expedited", 0x06070012, lambda: write(0x6040, 0, b"\0\0\0\0")),
        ("too long, normal", 0x06070012, lambda: write(0x6081, 0, bytes(8))),
        ("too short", 0x06070013, lambda: write(0x6081, 0, b"\0")),
        ("value out of range", 0x06090030, lambda: write(0x605A, 0, struct.pack("<h", 99))),
    ]
    for what, code, action in cases:
        expect(what, f"{bench.abort_of(action):08X}", f"{code:08X}")
        expect("1000h after it", bench.read(0x1000, 0, "I") & 0xFFFF, 402)
    return f"{len(cases)} refusals"


def mapped(bench, pdo):
    """The entries of a PDO."""
    return [f"{bench.read(pdo, at + 1, 'I'):08X}" for at in range(bench.read(pdo, 0, "B"))]


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
    active = slave._fprd(0x0980, 2)
    expect("cyclic operation and SYNC0 (0981h)", active[1] & 0x03, 0x03)
    cycle = struct.unpack("<I", slave._fprd(0x09A0, 4))[0]
    expect("SYNC0 cycle (09A0h)", cycle, DC_CYCLE_NS)
    start = struct.unpack("<Q", slave._fprd(0x0990, 8))[0]
    system = struct.unpack("<Q", slave._fprd(0x0910, 8))[0]
    expect("SYNC0 starts later than now (0990h, 0910h)", start > system, True)
    later = struct.unpack("<Q", slave._fprd(0x0910, 8))[0]
    expect("the system time runs", later > system, True)
    return f"SYNC0 each {cycle} ns"


def watchdog_on(bench):
    """The SII of these drives leaves the watchdog's trigger off; a locked sync manager is opened to switch it on."""
    slave = bench.slave
    slave.set_watchdog("processdata", WATCHDOG_MS)
    expect("the time", slave.get_watchdog("processdata"), WATCHDOG_MS)
    control = slave._fprd(0x0814, 1)[0] | 0x40
    slave._fpwr(0x0816, b"\0")
    slave._fpwr(0x0814, bytes([control]))
    slave._fpwr(0x0816, b"\1")
    expect("0814h", slave._fprd(0x0814, 1)[0], control)
    return f"{WATCHDOG_MS} ms, 0814h = {control:02X}h"


def safe_op(bench):
    bench.request(pysoem.SAFEOP_STATE)
    until("SAFEOP", lambda: bench.state() == pysoem.SAFEOP_STATE)
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
    """Each of many exchanges is answered in full, while SDOs go on beside them."""
    exchanges = 500
    for number in range(exchanges):
        expect("the working counter", bench.cycle(), bench.master.expected_wkc)
        if number % 50 == 0:
            expect("6061h", bench.read(0x6061, 0, "b"), bench.get(0, 0x6061))
    expect("the state", bench.state(), pysoem.OP_STATE)
    return f"{exchanges} exchanges"


def statuswords(bench, mask):
    return [bench.get(axis, 0x6041) & mask for axis in bench.drive.numbers]


def order(bench, controlword):
    for axis in bench.drive.numbers:
        bench.set(axis, 0x6040, controlword)


def enable(bench):
    """Shutdown, Switch on, Enable operation, each when the one before is seen."""
    for name, word, mask, seen in (
        ("Switch on disabled", 0x0000, 0x004F, 0x0040),
        ("Ready to switch on", 0x0006, 0x006F, 0x0021),
        ("Switched on", 0x0007, 0x006F, 0x0023),
        ("Operation enabled", 0x000F, 0x006F, 0x0027),
    ):
        order(bench, word)
        bench.cycle_until(name, lambda: all(word == seen for word in statuswords(bench, mask)))
    modes = [bench.get(axis, 0x6061) for axis in bench.drive.numbers]
    expect("the modes", modes, [1] * len(modes))
    return "Operation enabled, mode 1"


def start(bench, targets, velocity, ramp=2_000_000):
    """The handshake of one set-point: bit 4 up until bit 12 is up, then down until it is down."""
    for axis, target in zip(bench.drive.numbers, targets):
        bench.set(axis, 0x607A, target)
        bench.set(axis, 0x6081, velocity)
        bench.set(axis, 0x6083, ramp)
        bench.set(axis, 0x6084, ramp)
    bench.cycle_until("bit 12 low before", lambda: not any(statuswords(bench, 0x1000)))
    order(bench, 0x001F)
    bench.cycle_until("bit 12 high", lambda: all(statuswords(bench, 0x1000)))
    order(bench, 0x000F)


def profile_move(bench):
    """Absolute moves of all axes to targets of their own, judged by bit 10 and the position."""
    here = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    targets = [position + 40_000 + 1_000 * axis for axis, position in enumerate(here)]
    start(bench, targets, 100_000)
    bench.cycle_until("bit 12 low after", lambda: not any(statuswords(bench, 0x1000)))
    bench.cycle_until(
        "on the way, bit 10 low",
        lambda: all(
            begun < bench.get(axis, 0x6064) < target
            for axis, begun, target in zip(bench.drive.numbers, here, targets)
        )
        and not any(statuswords(bench, 0x0400)),
    )
    arrival(bench, targets)
    return f"at {' '.join(map(str, targets))}"


def arrival(bench, targets):
    bench.cycle_until("bit 10 of all axes", lambda: all(statuswords(bench, 0x0400)))
    positions = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    window = bench.drive.table.get("window", 10)
    for target, position in zip(targets, positions):
        expect(f"{position} is within {window} of {target}", abs(position - target) <= window, True)


def second_set_point(bench):
    """Bit 5 = 0 while the first still moves: the drive goes there after the first, whether it keeps it until then, or takes
    it on arrival."""
    here = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    first, second = [p + 10_000 for p in here], [p + 2_000 for p in here]
    # Gentle ramps: the axis is within 1000 counts of where it turns for a quarter of a second, and is seen there.
    start(bench, first, 20_000, 100_000)
    start(bench, second, 20_000, 100_000)
    highest = list(here)

    def at_second():
        for axis in bench.drive.numbers:
            highest[axis] = max(highest[axis], bench.get(axis, 0x6064))
        return all(statuswords(bench, 0x0400)) and all(
            abs(bench.get(axis, 0x6064) - target) <= 10 for axis, target in enumerate(second)
        )

    bench.cycle_until("the second target", at_second)
    for top, target in zip(highest, first):
        expect(f"it turned at the first target ({top}, {target})", abs(top - target) <= 1000, True)
    return f"turned at {highest[0]}, at {second[0]}"


def watchdog(bench):
    """Outputs stop in mid move: the drive leaves OP with 001Bh and, as 6007h = 1 says, faults."""
    for axis in bench.drive.axes:
        bench.write(axis.index(0x6007), 0, "h", 1)
    here = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    start(bench, [position + 2_000_000 for position in here], 100_000)
    bench.cycle_until(
        "moving", lambda: all(bench.get(axis, 0x6064) > at + 2_000 for axis, at in zip(bench.drive.numbers, here))
    )
    begun = time.monotonic()
    fallen = pysoem.SAFEOP_STATE | pysoem.STATE_ERROR
    until("SAFEOP with error", lambda: bench.state() == fallen)
    took = time.monotonic() - begun
    expect("the AL status code", f"{bench.slave.al_status:04X}", "001B")
    expect("it took no less than the watchdog's time", took * 1000 > WATCHDOG_MS - 50, True)
    return f"AL status code {bench.slave.al_status:04X}h"


def emergency(bench):
    """The fault announced itself: 8130h from each axis, with the bits of 1001h that belong to it."""

    def received():
        bench.slave.mbx_receive()
        return len(bench.emergencies) >= len(bench.drive.axes)

    until("an emergency from each axis", received)
    for message in bench.emergencies:
        expect("its code", f"{message.error_code:04X}", bench.drive.table["loss_code"])
        expect("its register", f"{message.error_reg:02X}", bench.drive.table["loss_register"])
    for axis in bench.drive.axes:
        expect("603Fh", f"{bench.read(axis.index(0x603F), 0, 'H'):04X}", bench.drive.table["loss_code"])
    return f"{len(bench.emergencies)} of {bench.drive.table['loss_code']}h"


def recovery(bench):
    """The error is acknowledged, OP comes again with fresh outputs, and nothing moves by that."""
    bench.request(pysoem.OP_STATE)
    expect("no way up before the acknowledge", bench.state(), pysoem.SAFEOP_STATE | pysoem.STATE_ERROR)
    bench.request(pysoem.SAFEOP_STATE, acknowledge=True)
    until("SAFEOP", lambda: bench.state() == pysoem.SAFEOP_STATE)
    expect("the AL status code", bench.slave.al_status, 0)
    order(bench, 0)
    operational(bench)
    bench.cycle_until("Fault", lambda: all(word == 0x0008 for word in statuswords(bench, 0x004F)))
    before = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    for _ in range(50):
        bench.cycle()
    expect("the positions", [bench.get(axis, 0x6064) for axis in bench.drive.numbers], before)
    return "OP again, axes in Fault, at rest"


def fault_reset(bench):
    order(bench, 0x0080)
    bench.cycle_until("Switch on disabled", lambda: all(w == 0x0040 for w in statuswords(bench, 0x004F)))
    for axis in bench.drive.axes:
        expect("603Fh", bench.read(axis.index(0x603F), 0, "H"), 0)
    order(bench, 0x0000)
    enable(bench)
    here = bench.get(0, 0x6064)
    profile_move(bench)
    order(bench, 0x0000)
    bench.cycle_until("Switch on disabled", lambda: all(w == 0x0040 for w in statuswords(bench, 0x004F)))
    return f"and a move from {here} to {bench.get(0, 0x6064)}"


def back_to_init(bench):
    bench.slave.dc_sync(False, DC_CYCLE_NS)
    for state in (pysoem.SAFEOP_STATE, pysoem.PREOP_STATE, pysoem.INIT_STATE):
        bench.request(state)
        until(f"state {state}", lambda: bench.state() == state)
    return "INIT"


CHECKS = (
    scan,
    sii_strings,
    identity_by_sdo,
    expedited,
    segmented,
    complete_access,
    object_list,
    aborts,
    remapping,
    clock,
    watchdog_on,
    safe_op,
    operational,
    cyclic,
    enable,
    profile_move,
    second_set_point,
    watchdog,
    emergency,
    recovery,
    fault_reset,
    back_to_init,
)


def main():
    interface, name = sys.argv[1:]
    table = json.loads((pathlib.Path(__file__).parent / "drives.json").read_text())
    bench = Bench(interface, Drive(table[name]))
    try:
        for check in CHECKS:
            try:
                seen = check(bench)
            except Exception as error:
                traceback.print_exc()
                print(f"FAILED {check.__name__}: {error!r}", flush=True)
                return 1
            print(f"ok {check.__name__}: {seen}", flush=True)
    finally:
        bench.master.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
