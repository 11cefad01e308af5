"""SOEM through pysoem: brings the line up and runs cycles as it is told (see measure.rs for the orders and answers)."""

import os
import sys
import time

import pysoem

PERIOD_NS = 1_000_000


def bring_up(interface, axes):
    timeouts = pysoem.settings.timeouts
    timeouts.ret, timeouts.safe = 1_000_000, 2_000_000
    timeouts.rx_mailbox, timeouts.tx_mailbox = 2_000_000, 500_000
    master = pysoem.Master()
    master.open(interface)
    drives = (axes + 1) // 2
    found = master.config_init()
    assert found == drives, f"{found} SubDevices"
    master.config_map()
    assert master.state_check(pysoem.SAFEOP_STATE, 10_000_000) == pysoem.SAFEOP_STATE
    cycle(master)
    master.state = pysoem.OP_STATE
    master.write_state()
    deadline = time.perf_counter() + 30
    while master.state_check(pysoem.OP_STATE, 1_000) != pysoem.OP_STATE:
        cycle(master)
        assert time.perf_counter() < deadline, "no OP"
    # Every drive takes outputs and gives inputs.
    wanted = 3 * drives
    assert master.expected_wkc == wanted, master.expected_wkc
    return master, wanted


def cycle(master):
    master.send_processdata()
    return master.receive_processdata(100_000)


def fast(master, count, wanted):
    times = []
    start = time.perf_counter_ns()
    for _ in range(count):
        counter = cycle(master)
        following = time.perf_counter_ns()
        times.append(following - start)
        start = following
        assert counter == wanted, counter
    return times


def paced(master, count, wanted):
    times = []
    due = time.perf_counter_ns()
    for _ in range(count):
        due += PERIOD_NS
        time.sleep(max(0, due - time.perf_counter_ns()) / 1e9)
        counter = cycle(master)
        end = time.perf_counter_ns()
        times.append(end - due)
        due = max(due, end - PERIOD_NS)
        assert counter == wanted, counter
    return times


def main(interface, axes, core):
    os.sched_setaffinity(0, {core})
    master, wanted = bring_up(interface, axes)
    print("ready", flush=True)
    for line in sys.stdin:
        mode, count = line.split()
        run = paced if mode == "1kHz" else fast
        before = time.process_time_ns()
        times = run(master, int(count), wanted)
        cpu = (time.process_time_ns() - before) / len(times)
        times.sort()
        values = [times[round((len(times) - 1) * part)] for part in (0.5, 0.99, 0.999, 1.0)]
        print(*(value / 1e3 for value in [*values, cpu]), flush=True)
    # Without taking the line down in order: nobody is there any more.
    os._exit(0)


main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
