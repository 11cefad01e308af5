"""Runs SDO transfers of every size and kind against one simulated drive: `transfers.py INTERFACE TABLE DRIVE SESSION`.

The drive's mailboxes are what its SII says. With those of the session (tests/vectors/sdo_session.txt), every mail between SOEM and
the drive is recorded from the interface while SOEM repeats the session, and must be the one that stands there.
"""

import functools
import json
import socket
import struct
import sys

import pysoem

import coe
from bench import FRAME_US, Bench
from drive import Drive, expect, report

TEXT_BYTES = 4096
# The mailboxes of the session.
SESSION_MAILBOX = 32


def mailbox(bench):
    """Words 18h to 1Bh of the SII: where both mailboxes are, and how long."""
    words = [struct.unpack("<H", bench.slave.eeprom_read(at, FRAME_US)[:2])[0] for at in range(0x18, 0x1C)]
    expect("both are of one length", words[1], words[3])
    return words


def sizes(length):
    """Around each boundary: what fits an expedited transfer, the initiating mail, and each number of segments."""
    first, segment = length - 16, length - 9
    ends = list(range(first, TEXT_BYTES + 1, segment))
    around = {end + off for end in [4, *ends[:4], ends[-1]] for off in range(-2, 3)}
    # The last segment is padded up to seven bytes.
    padded = {end + off for end in ends[:2] for off in range(1, 9)}
    chosen = around | padded | set(range(1, 9)) | {TEXT_BYTES - 1, TEXT_BYTES}
    return sorted(size for size in chosen if 1 <= size <= TEXT_BYTES)


def text(size):
    return bytes((7 * at + size) % 251 for at in range(size))


def all_sizes(bench):
    index, longest = bench.drive.text_object
    expect("the text's room", longest, TEXT_BYTES)
    length = mailbox(bench)[1]
    for size in sizes(length):
        bench.slave.sdo_write(index, 0, text(size))
        expect(f"{size} bytes", bench.slave.sdo_read(index, 0, size=longest), text(size))
    code = bench.abort_of(lambda: bench.slave.sdo_write(index, 0, bytes(longest + 1)))
    expect("one byte too many", f"{code:08X}", "06070012")
    expect("the text after it", bench.slave.sdo_read(index, 0, size=longest), text(longest))
    return f"{len(sizes(length))} sizes up to {longest} bytes each way"


def complete_sizes(bench):
    """A PDO of no, one and up to eight entries as a whole, from subindex 0 with its count in two bytes and from 1."""
    if not bench.drive.table["complete_access"]:
        code = bench.abort_of(lambda: bench.slave.sdo_write(0x607D, 1, bytes(8), ca=True))
        expect("the abort code", f"{code:08X}", "06010004")
        return "not offered, refused with 06010004h"
    pdo = 0x1603
    entries = [0x60400010, 0x60600008, 0x607A0020, 0x60810020, 0x60830020, 0x60840020, 0x60820020, 0x60860010]
    packed = lambda some: b"".join(struct.pack("<I", entry) for entry in some)
    seen = set()
    for count in [*range(len(entries) + 1), 3]:
        whole = struct.pack("<H", count) + packed(entries[:count])
        bench.slave.sdo_write(pdo, 0, whole, ca=True)
        expect(f"{count} entries from 0", bench.slave.sdo_read(pdo, 0, size=64, ca=True), whole)
        if count:
            expect(f"{count} entries from 1", bench.slave.sdo_read(pdo, 1, size=64, ca=True), whole[2:])
        singles = b"".join(bench.slave.sdo_read(pdo, at + 1) for at in range(bench.read(pdo, 0, "B")))
        expect(f"{count} entries one by one", singles, whole[2:])
        seen |= {len(whole), len(whole) - 2}
    # From subindex 1, where the count stays as it is.
    for limits in ((-5_000, 7_000), (0, 0)):
        bench.slave.sdo_write(0x607D, 1, struct.pack("<ii", *limits), ca=True)
        expect("607Dh", (bench.read(0x607D, 1, "i"), bench.read(0x607D, 2, "i")), limits)
    return f"{len(seen - {0})} lengths up to {max(seen)} bytes each way"


class Recorder:
    """The mails that pass the interface; each frame that came back with a working counter carries what was done."""

    def __init__(self, interface, words):
        self.out, self.length, self.back = words[0], words[1], words[2]
        self.socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x88A4))
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.socket.bind((interface, 0x88A4))
        self.socket.setblocking(False)

    def take(self):
        """What was written to and read from the drive's mailboxes since the last time, in order."""
        mails = []
        while True:
            try:
                frame, source = self.socket.recvfrom(2048)
            except BlockingIOError:
                return mails
            # Of a frame that leaves, nobody knows yet what comes of it.
            if source[2] != socket.PACKET_OUTGOING:
                mails += self.of_frame(frame)

    def of_frame(self, frame):
        at, more = 16, True
        while more:
            command, _, _, register, length, _ = struct.unpack_from("<BBHHHH", frame, at)
            more, length = bool(length & 0x8000), length & 0x07FF
            data = frame[at + 10 : at + 10 + length]
            (counter,) = struct.unpack_from("<H", frame, at + 10 + length)
            # FPWR and FPRD of the whole mailbox.
            if counter and length == self.length and (command, register) in ((5, self.out), (4, self.back)):
                size = struct.unpack_from("<H", data)[0]
                yield {5: "request", 4: "reply"}[command], data[: 6 + size].hex(" ").upper()
            at += 12 + length


def rows(session):
    """Operation, value, request as SOEM sends it, reply; without what SOEM has no call for."""
    with open(session) as file:
        lines = [[column.strip() for column in line.split("|")] for line in file if not line.startswith("#")]
    end = next(at for at, columns in enumerate(lines) if columns[-1] == "-")
    expect("SOEM's part stands together", all(c[-1] == "-" or not c[0] for c in lines[end:]), True)
    for operation, value, request, reply, by_soem in lines[:end]:
        yield operation, bytes.fromhex(value), by_soem or request, reply


def perform(bench, operation, value, reply):
    """Does an operation with SOEM and compares what it brings."""
    what, address = operation.rsplit(" ", 1)
    index, subindex = address.split("h:")
    index, subindex, whole = int(index, 16), int(subindex), what.endswith("all")
    if what.startswith("write"):
        action = lambda: bench.slave.sdo_write(index, subindex, value, ca=whole)
    else:
        action = lambda: bench.slave.sdo_read(index, subindex, size=TEXT_BYTES, ca=whole)
    refused = bytes.fromhex(reply)[7:9] == b"\x20\x80"
    if refused:
        code = struct.unpack_from("<I", bytes.fromhex(reply), 12)[0]
        expect(operation, f"{bench.abort_of(action):08X}", f"{code:08X}")
    elif what.startswith("write"):
        action()
    else:
        expect(operation, action(), value)


def pinned_messages(bench, session):
    words = mailbox(bench)
    if words[1] != SESSION_MAILBOX:
        return f"not offered: the session is that of mailboxes of {SESSION_MAILBOX} bytes"
    # A new master and a drive that comes from INIT: both count their mails from one.
    bench.request(pysoem.INIT_STATE)
    coe.scan(bench)
    recorder = Recorder(bench.interface, words)
    expected, operations = [], list(rows(session))
    for operation, value, request, reply in operations:
        if operation != "segment":
            expect("the mails so far", recorder.take(), expected)
            expected = []
            perform(bench, operation, value, reply)
        expected += [("request", request), ("reply", reply)]
    expect("the last mails", recorder.take(), expected)
    described(bench, session, recorder)
    return f"{2 * len(operations)} mails of SOEM and the drive are those of the session"


def described(bench, session, recorder):
    """SOEM asks for descriptions only behind its list of all objects: they are the session's but for their counters."""
    with open(session) as file:
        lines = [[column.strip() for column in line.split("|")] for line in file]
    row = next(columns for columns in lines if columns[0] == "describe 1018h")
    identity = next(entry for entry in bench.slave.od if entry.index == 0x1018)
    recorder.take()
    expect("the name of 1018h", identity.name.decode(), bytes.fromhex(row[1]).decode())
    uncounted = lambda mail: mail[:15] + "x" + mail[16:]
    seen = [(which, uncounted(mail)) for which, mail in recorder.take()]
    expect("its description", seen, [("request", uncounted(row[2])), ("reply", uncounted(row[3]))])


def scan(bench):
    seen = coe.scan(bench)
    return f"{seen}, mailboxes of {mailbox(bench)[1]} bytes"


def main():
    interface, table, name, session = sys.argv[1:]
    with open(table) as file:
        bench = Bench(interface, Drive(json.load(file)[name]))
    pinned = functools.partial(pinned_messages, session=session)
    pinned.__name__ = pinned_messages.__name__
    return report(bench, (scan, all_sizes, complete_sizes, pinned))


if __name__ == "__main__":
    sys.exit(main())
