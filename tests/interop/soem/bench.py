"""The master, its only SubDevice, and the process data."""

import struct
import time

import pysoem

from drive import expect, until

CYCLE_NS = 1_000_000
# How long a frame may take.
FRAME_US = 1_000_000


def patient():
    """A busy machine is no lost frame: the timeouts for one are far longer than SOEM's 2 ms."""
    timeouts = pysoem.settings.timeouts
    timeouts.ret, timeouts.safe = FRAME_US, 2 * FRAME_US
    timeouts.rx_mailbox, timeouts.tx_mailbox = 2_000_000, 500_000


def read_register(slave, address, kind):
    """A register of the ESC; the wrapper's own timeout for these is a fixed 2 ms."""
    data = slave._fprd(address, struct.calcsize("<" + kind), FRAME_US)
    return struct.unpack("<" + kind, data)[0]


def write_register(slave, address, kind, value):
    slave._fpwr(address, struct.pack("<" + kind, value), FRAME_US)


def set_watchdog(slave, milliseconds):
    """The time of the process-data watchdog (0420h), in ticks of the divider (0400h) plus two times 40 ns."""
    tick_ns = 40 * (read_register(slave, 0x0400, "H") + 2)
    ticks = milliseconds * 1_000_000 // tick_ns
    write_register(slave, 0x0420, "H", ticks)
    expect("0420h", read_register(slave, 0x0420, "H"), ticks)


class Bench:
    """The master, its only SubDevice, and the process data."""

    def __init__(self, interface, drive):
        self.interface = interface
        self.drive = drive
        self.master = None
        self.slave = None
        self.emergencies = []
        self.outputs = {}
        self.next_cycle = 0
        patient()

    def open(self, manual):
        """A new master; how many SubDevices it finds. With `manual` it leaves the state changes to the checks."""
        self.close()
        self.master = pysoem.Master()
        self.master.manual_state_change = manual
        self.master.open(self.interface)
        found = self.master.config_init()
        if self.master.slaves:
            self.slave = self.master.slaves[0]
            self.slave.add_emergency_callback(self.emergencies.append)
        return found

    def close(self):
        if self.master is not None:
            self.master.close()

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

    def refused(self, state, stays, code):
        """Asks for a state; the drive stays where it is and says why, until that is acknowledged."""
        self.request(state)
        until(f"the refusal {code}", lambda: self.state() == stays | pysoem.STATE_ERROR)
        expect("the AL status code", f"{self.slave.al_status:04X}", code)
        self.request(stays, acknowledge=True)
        until("the acknowledge", lambda: self.state() == stays)
        expect("the AL status code after it", self.slave.al_status, 0)

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
        return self.master.receive_processdata(FRAME_US)

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
