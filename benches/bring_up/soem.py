"""SOEM through pysoem: from nothing to every drive in OP, and until its calls have read what motion needs of each; prints milliseconds."""

import sys
import time

import pysoem

# What servocrab reads of each of the two axes of an AKD2G beside the mapping: object and subindex, and the offset of the second axis'.
AXIS = [(0x6081, 0), (0x6082, 0), (0x6083, 0), (0x6084, 0), (0x6067, 0), (0x605A, 0), (0x605B, 0), (0x605C, 0), (0x605D, 0), (0x605E, 0)]
AXIS += [(0x606D, 0), (0x606E, 0), (0x606F, 0), (0x6070, 0), (0x6502, 0), (0x607D, 1), (0x607D, 2), (0x607B, 1), (0x607B, 2)]
AXIS += [(0x607C, 0), (0x607F, 0), (0x6007, 0)]
NEXT_AXIS = 0x800
HOMED = [(0x5000, 4), (0x5100, 4)]


def read_all(slave):
    objects = AXIS + [(index + NEXT_AXIS, subindex) for index, subindex in AXIS] + HOMED
    for index, subindex in objects:
        try:
            slave.sdo_read(index, subindex)
        except pysoem.SdoError:
            pass  # The drive has no such object, and that is an answer.


def main(interface, drives):
    # A busy machine, or a slow drive, is no lost frame.
    timeouts = pysoem.settings.timeouts
    timeouts.ret, timeouts.safe = 1_000_000, 2_000_000
    timeouts.rx_mailbox, timeouts.tx_mailbox = 2_000_000, 500_000
    begun = time.perf_counter()
    master = pysoem.Master()
    master.open(interface)
    found = master.config_init()
    assert found == drives, f"{found} SubDevices"
    master.config_map()
    assert master.state_check(pysoem.SAFEOP_STATE, 10_000_000) == pysoem.SAFEOP_STATE
    master.send_processdata()
    master.receive_processdata(100_000)
    master.state = pysoem.OP_STATE
    master.write_state()
    deadline = time.perf_counter() + 30
    while master.state_check(pysoem.OP_STATE, 1_000) != pysoem.OP_STATE:
        master.send_processdata()
        master.receive_processdata(100_000)
        assert time.perf_counter() < deadline, "no OP"
    operational = time.perf_counter() - begun
    for slave in master.slaves:
        read_all(slave)
    print(operational * 1e3, (time.perf_counter() - begun) * 1e3)
    master.state = pysoem.INIT_STATE
    master.write_state()
    master.close()


main(sys.argv[1], int(sys.argv[2]))
