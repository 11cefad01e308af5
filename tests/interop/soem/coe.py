"""Checks in PREOP: the SII and the mailbox."""

import struct

import pysoem

from bench import FRAME_US
from drive import expect, until


def scan(bench):
    found = bench.open(manual=True)
    expect("the number of SubDevices", (found, len(bench.master.slaves)), (1, 1))
    slave = bench.slave
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
        words += bench.slave.eeprom_read(len(words) // 2, FRAME_US)[:2]
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
    mailbox = struct.unpack("<H", bench.slave.eeprom_read(0x19, FRAME_US)[:2])[0]
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
    # The same PDO written as a whole, its entries the other way round, after it was taken out of the assignment; then
    # all as it was.
    assigned = bench.slave.sdo_read(0x1C12, 0, size=64, ca=True)
    bench.slave.sdo_write(0x1C12, 0, struct.pack("<H", 0), ca=True)
    expect("1C12h:0", bench.read(0x1C12, 0, "B"), 0)
    turned = whole[:2] + b"".join(reversed([singles[at : at + 4] for at in range(0, 4 * entries, 4)]))
    for written in (turned, whole[: 2 + 4 * entries]):
        bench.slave.sdo_write(index, 0, written, ca=True)
        seen = b"".join(bench.slave.sdo_read(index, at + 1) for at in range(entries))
        expect(f"{index:04X}h after a write", seen, written[2:])
    bench.slave.sdo_write(0x1C12, 0, assigned, ca=True)
    expect("1C12h", bench.slave.sdo_read(0x1C12, 0, size=64, ca=True), assigned)
    return f"1018h, 1C12h and {index:04X}h in one transfer each, the latter two both ways"


def object_list(bench):
    if not bench.drive.table["object_list"]:
        try:
            objects = bench.slave.od
        except pysoem.SdoInfoError:
            # SOEM has expected another message than an SDO abort.
            expect("what SOEM has kept", kept_errors(bench), {("PacketError", 1)})
            return "not offered, refused by an SDO abort"
        raise AssertionError(f"an object list with {len(objects)} entries was not expected")
    objects = {entry.index: entry for entry in bench.slave.od}
    expect("the mandatory objects", {0x1000, 0x1018, 0x1C12, 0x1C13} - objects.keys(), set())
    # What the list says of the objects that this suite moves the drive with is what it uses them as.
    for axis in bench.drive.axes:
        # Bit 6 of the access: it goes into an RxPDO; bit 7: into a TxPDO.
        for field, direction in [(f, 0x40) for f in axis.outputs] + [(f, 0x80) for f in axis.inputs]:
            expect("is in the list", (f"{field.index:04X}h", field.index in objects), (f"{field.index:04X}h", True))
            known = objects[field.index]
            expect(f"the name of {field.index:04X}h", bool(known.name), True)
            expect(f"the bits of {field.index:04X}h", known.bit_length, field.bits)
            expect(f"the type of {field.index:04X}h", known.data_type, field.coe_type)
            if field.mapped:
                expect(f"the direction of {field.index:04X}h", known.obj_access & direction, direction)
    identity = objects[0x1018]
    expect("the entries of 1018h", [entry.bit_length for entry in identity.entries], [8, 32, 32, 32, 32])
    compared = dictionary(bench, objects)
    return f"{len(objects)} objects, {compared} entries, each as the drive has it"


def dictionary(bench, objects):
    """Every object and every entry is listed as the drive has it; how many entries these are."""
    with open(bench.dictionary) as file:
        rows = [line.rstrip("\n").split("|") for line in file]
    # SOEM keeps 40 characters of a name, and shows no entries of an object without subindices, but what its first one is.
    has = {int(row[0]): row[1:] for row in rows if ":" not in row[0]}
    expect("the objects", sorted(objects), sorted(has))
    for index, (kind, code, last, name) in has.items():
        seen = objects[index]
        expect(f"{index:04X}h", (seen.data_type, seen.object_code), (int(kind), int(code)))
        expect(f"the name of {index:04X}h", seen.name.decode(), name[:40])
        expect(f"the entries of {index:04X}h", len(seen.entries), int(last) + 1 if int(last) else 0)
    entries = [(*map(int, row[0].split(":")), *row[1:]) for row in rows if ":" in row[0]]
    for index, subindex, kind, bits, access, name in entries:
        seen = objects[index] if has[index][2] == "0" else objects[index].entries[subindex]
        what = f"{index:04X}h:{subindex}"
        expect(what, (seen.bit_length, seen.obj_access), (int(bits), int(access)))
        expect(f"the type of {what}", seen.data_type, int(kind))
        expect(f"the name of {what}", seen.name.decode(), name[:40])
    return len(entries)


def kept_errors(bench):
    """The errors that SOEM has kept: its wrapper raises one with each call, whether that call went well or not."""
    errors = set()
    for _ in range(100):
        try:
            bench.slave.sdo_read(0x1000, 0)
        except (pysoem.MailboxError, pysoem.PacketError) as error:
            errors.add((type(error).__name__, error.error_code))
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
