"""Checks in OP: power, moves, and what happens when the process data stops coming."""

import time

import pysoem

from drive import expect, until
from states import DC_CYCLE_NS, WATCHDOG_MS, operational

# What an encoder shows at rest goes up and down by less than this.
NOISE = 5


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


def start(bench, targets, velocity, ramp=2_000_000, bits=0):
    """The handshake of one set-point, with further bits: bit 4 up until bit 12 is up, then down."""
    for axis, target in zip(bench.drive.numbers, targets):
        bench.set(axis, 0x607A, target)
        bench.set(axis, 0x6081, velocity)
        bench.set(axis, 0x6083, ramp)
        bench.set(axis, 0x6084, ramp)
    bench.cycle_until("bit 12 low before", lambda: not any(statuswords(bench, 0x1000)))
    order(bench, 0x001F | bits)
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


def arrival(bench, targets, doubt=0):
    """Bit 10 of all axes, and each within its window of its target, which is known but for so many counts."""
    bench.cycle_until("bit 10 of all axes", lambda: all(statuswords(bench, 0x0400)))
    positions = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    window = bench.drive.table.get("window", 10) + NOISE + doubt
    for target, position in zip(targets, positions):
        expect(f"{position} is within {window} of {target}", abs(position - target) <= window, True)


def second_set_point(bench):
    """Bit 5 = 0 while the first still moves: the drive goes there after the first, whether it keeps it until then, or takes
    it on arrival."""
    first, top = two_set_points(bench, 0)
    expect(f"it turned at the first target ({top}, {first})", abs(top - first) <= 1000, True)
    return f"turned at {top}"


def at_once(bench):
    """Bit 5 = 1 while the first still moves: the drive turns before the first target, or goes on through it."""
    first, top = two_set_points(bench, 0x0020)
    reached = abs(top - first) <= 1000
    expect(f"the first target was reached ({top}, {first})", reached, bench.drive.table["bit_5_reaches_first"])
    return "through the first target" if reached else "turned before the first target"


def two_set_points(bench, bits):
    """A second set-point, back towards the start, while the first is on its way: the first target and how far axis 1 went.
    Gentle ramps: the axis is within 1000 counts of where it turns for a quarter of a second, and is seen there."""
    here = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    first, second = [p + 10_000 for p in here], [p + 2_000 for p in here]
    start(bench, first, 20_000, 100_000)
    start(bench, second, 20_000, 100_000, bits)
    highest = list(here)

    def at_second():
        for axis in bench.drive.numbers:
            highest[axis] = max(highest[axis], bench.get(axis, 0x6064))
        return all(statuswords(bench, 0x0400)) and all(
            abs(bench.get(axis, 0x6064) - target) <= 10 for axis, target in enumerate(second)
        )

    bench.cycle_until("the second target", at_second)
    return first[0], highest[0]


def relative_move(bench):
    """Bit 6, from standstill."""
    here = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    start(bench, [-5_000 for _ in here], 100_000, bits=0x0040)
    bench.cycle_until("bit 12 low after", lambda: not any(statuswords(bench, 0x1000)))
    bench.cycle_until("moving", lambda: all(bench.get(axis, 0x6064) < at for axis, at in zip(bench.drive.numbers, here)))
    # From where the drive's demand was, which is within the window of where the axis was seen.
    arrival(bench, [position - 5_000 for position in here], doubt=10)
    return f"from {here[0]} to {bench.get(0, 0x6064)}"


def halt(bench):
    """Bit 8 in mid move: at rest short of the target, in Operation enabled; without it the move goes on."""
    here = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    targets = [position + 40_000 for position in here]
    start(bench, targets, 50_000, 500_000)
    bench.cycle_until(
        "moving", lambda: all(bench.get(axis, 0x6064) > at + 1_000 for axis, at in zip(bench.drive.numbers, here))
    )
    order(bench, 0x010F)
    stopped = until_at_rest(bench)
    expect("short of the targets", all(at < target for at, target in zip(stopped, targets)), True)
    expect("Operation enabled", set(statuswords(bench, 0x006F)), {0x0027})
    order(bench, 0x000F)
    bench.cycle_until(
        "going on", lambda: all(bench.get(axis, 0x6064) > at for axis, at in zip(bench.drive.numbers, stopped))
    )
    arrival(bench, targets)
    return f"at rest at {stopped[0]}, then at {targets[0]}"


def until_at_rest(bench):
    """The position of every axis for so many exchanges, but for what an encoder does at rest."""
    still, first = 0, None

    def at_rest():
        nonlocal still, first
        now = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
        stays = first is not None and all(abs(at - before) <= NOISE for at, before in zip(now, first))
        still, first = (still + 1, first) if stays else (0, now)
        return still >= 20

    bench.cycle_until("at rest", at_rest)
    return first


def expect_at(bench, wanted):
    """Every axis is there, within the window and what an encoder does at rest."""
    positions = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    near = all(abs(position - there) <= 10 + NOISE for position, there in zip(positions, wanted))
    expect(f"the positions {positions} are {wanted}", near, True)


def quick_stop(bench):
    """In mid move, with 605Ah = 6: the axis stops short of its target and stays in Quick stop active."""
    before = [bench.read(axis.index(0x605A), 0, "h") for axis in bench.drive.axes]
    for axis in bench.drive.axes:
        bench.write(axis.index(0x605A), 0, "h", 6)
    here = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    targets = [position + 1_000_000 for position in here]
    start(bench, targets, 100_000)
    bench.cycle_until(
        "moving", lambda: all(bench.get(axis, 0x6064) > at + 1_000 for axis, at in zip(bench.drive.numbers, here))
    )
    order(bench, 0x000B)
    bench.cycle_until("Quick stop active", lambda: all(word == 0x0007 for word in statuswords(bench, 0x006F)))
    stopped = until_at_rest(bench)
    expect("short of the targets", all(at < target for at, target in zip(stopped, targets)), True)
    expect("Quick stop active", set(statuswords(bench, 0x006F)), {0x0007})
    for axis, option in zip(bench.drive.axes, before):
        bench.write(axis.index(0x605A), 0, "h", option)
    enable(bench)
    expect_at(bench, stopped)
    return f"at rest at {stopped[0]}, enabled again"


def set_mode(bench, mode):
    for axis in bench.drive.numbers:
        bench.set(axis, 0x6060, mode)
    bench.cycle_until(f"mode {mode}", lambda: all(bench.get(axis, 0x6061) == mode for axis in bench.drive.numbers))


def modes(bench):
    """6502h, which the table gives for all axes."""
    seen = [bench.read(axis.index(0x6502), 0, "I") for axis in bench.drive.axes]
    expect("6502h", seen, [int(bench.drive.table["modes"], 16)] * len(seen))
    return seen[0]


def profile_velocity(bench):
    """Bit 2 of 6502h: up to a velocity, bit 10, and down again."""
    if not modes(bench) & 1 << 2:
        return "not offered by 6502h"
    numbers = bench.drive.numbers
    set_target = lambda value: [bench.write(axis.index(0x60FF), 0, "i", value) for axis in bench.drive.axes]
    velocities = lambda: [bench.read(axis.index(0x606C), 0, "i") for axis in bench.drive.axes]
    set_target(0)
    set_mode(bench, 3)
    order(bench, 0x000F)
    here = [bench.get(axis, 0x6064) for axis in numbers]
    set_target(-30_000)
    bench.cycle_until(
        "the velocity", lambda: all(statuswords(bench, 0x0400)) and all(abs(v + 30_000) < 3_000 for v in velocities())
    )
    bench.cycle_until("on the way", lambda: all(bench.get(axis, 0x6064) < at - 3_000 for axis, at in zip(numbers, here)))
    set_target(0)
    bench.cycle_until("at rest, bits 10 and 12", lambda: all(w == 0x1400 for w in statuswords(bench, 0x1400)))
    # 606Ch is an estimate, of which 0 is one value.
    expect("at rest", all(abs(velocity) < 3_000 for velocity in velocities()), True)
    set_mode(bench, 1)
    return "-30000 counts/s and back to rest"


def homing(bench):
    """Bit 5 of 6502h, method 37: the present position becomes the home position."""
    if not modes(bench) & 1 << 5:
        return "not offered by 6502h"
    for axis in bench.drive.axes:
        bench.write(axis.index(0x6098), 0, "b", 37)
        bench.write(axis.index(0x607C), 0, "i", 1234)
    order(bench, 0x000F)
    set_mode(bench, 6)
    order(bench, 0x001F)
    bench.cycle_until("attained", lambda: all(word == 0x1400 for word in statuswords(bench, 0x3400)))
    positions = [bench.get(axis, 0x6064) for axis in bench.drive.numbers]
    wanted = bench.drive.table["homed_at"]
    expect_at(bench, [wanted] * len(positions))
    order(bench, 0x000F)
    set_mode(bench, 1)
    return f"method 37, 607Ch = 1234, at {positions[0]}"


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
    expect_at(bench, before)
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
        # It may have left OP when SYNC0 went off, and stays where it is until its error is acknowledged.
        bench.request(state, acknowledge=True)
        until(f"state {state}", lambda: bench.state() == state)
    return "INIT"
