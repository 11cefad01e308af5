"""SOEM through pysoem: from nothing to every drive in OP; prints the milliseconds."""

import sys
import time

import pysoem


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
    print((time.perf_counter() - begun) * 1e3)
    master.state = pysoem.INIT_STATE
    master.write_state()
    master.close()


main(sys.argv[1], int(sys.argv[2]))
