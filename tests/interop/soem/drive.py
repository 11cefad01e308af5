"""What the suites share: how checks are made and reported, and a row of drives.json taken apart."""

import struct
import time
import traceback
from dataclasses import dataclass, field

# struct code and the number of the data type in CoE (ETG.1000.6).
TYPES = {"I8": ("b", 2), "I16": ("h", 3), "I32": ("i", 4), "U8": ("B", 5), "U16": ("H", 6), "U32": ("I", 7)}


def expect(what, seen, wanted):
    if seen != wanted:
        raise AssertionError(f"{what}: expected {wanted!r}, got {seen!r}")


def until(what, condition, seconds=5):
    """Asks until it is so; not so in time is a failure."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise AssertionError(f"not in {seconds} s: {what}")


def report(bench, checks):
    """Runs the checks one after the other until one fails; what the program should exit with."""
    try:
        for check in checks:
            try:
                seen = check(bench)
            except Exception as error:
                traceback.print_exc()
                print(f"FAILED {check.__name__}: {error!r}", flush=True)
                return 1
            print(f"ok {check.__name__}: {seen}", flush=True)
    finally:
        bench.close()
    return 0


@dataclass
class Field:
    """An object of an axis and its place in the process data; without a place it goes by SDO."""

    index: int
    kind: str
    at: int | None
    subindex: int = 0

    @property
    def mapped(self):
        return self.at is not None

    @property
    def bits(self):
        return 8 * struct.calcsize(TYPES[self.kind][0])

    @property
    def coe_type(self):
        return TYPES[self.kind][1]

    @property
    def entry(self):
        """As a mapping object holds it."""
        return self.index << 16 | self.subindex << 8 | self.bits

    def pack(self, value):
        return struct.pack("<" + TYPES[self.kind][0], value)

    def put(self, data, value):
        struct.pack_into("<" + TYPES[self.kind][0], data, self.at, value)

    def unpack(self, data):
        return struct.unpack_from("<" + TYPES[self.kind][0], data, self.at)[0]


@dataclass
class Axis:
    offset: int
    rx: int
    tx: int
    outputs: list = field(default_factory=list)
    inputs: list = field(default_factory=list)

    def index(self, index):
        """The index of an object of axis 1, for this axis."""
        return index + self.offset


class Drive:
    def __init__(self, table):
        self.table = table
        self.identity = tuple(int(table[key], 16) for key in ("vendor", "product", "revision"))
        text = table["text_object"]
        self.text_object = int(text["index"], 16), text["bytes"]
        self.startup = [
            (int(index, 16), subindex, TYPES[kind][0], value) for index, subindex, kind, value in table["startup"]
        ]
        self.axes = [Axis(*(int(axis[key], 16) for key in ("offset", "rx", "tx"))) for axis in table["axes"]]
        self.numbers = range(len(self.axes))
        self.output_bytes = self._place("outputs")
        self.input_bytes = self._place("inputs")

    def _place(self, side):
        """Gives the fields of one direction their places; the bytes that they take."""
        at = 0
        for axis in self.axes:
            for row in self.table[side]:
                index, kind, *by_sdo = row.split()
                placed = Field(axis.index(int(index, 16)), kind, None if by_sdo else at)
                getattr(axis, side).append(placed)
                at += 0 if by_sdo else placed.bits // 8
        return at

    def output(self, axis, index):
        return self._find(self.axes[axis], "outputs", index)

    def input(self, axis, index):
        return self._find(self.axes[axis], "inputs", index)

    def mapped_outputs(self):
        return [known for axis in self.axes for known in axis.outputs if known.mapped]

    @staticmethod
    def _find(axis, side, index):
        return next(known for known in getattr(axis, side) if known.index == axis.index(index))
