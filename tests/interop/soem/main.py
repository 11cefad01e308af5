"""Runs the SOEM master against one simulated drive: `main.py INTERFACE TABLE DRIVE DICTIONARY`.

What a drive should answer is in the table (drives.json); the program has no case for any of them. Each check prints a line
`ok NAME: what was seen` or `FAILED NAME: why`; a failure ends the program, because the checks go up the EtherCAT states
one after the other. DICTIONARY has a row for each object and entry that the drive should list. Nothing here shares code or constants with the simulated drive or with the library under test.
"""

import json
import sys

import coe
import motion
import states
from bench import Bench
from drive import Drive, report

CHECKS = (
    states.default_mapping,
    coe.scan,
    coe.sii_strings,
    coe.identity_by_sdo,
    coe.expedited,
    coe.segmented,
    coe.complete_access,
    coe.object_list,
    coe.aborts,
    states.mapping_refusals,
    states.remapping,
    states.clock,
    states.al_refusals,
    states.watchdog_on,
    states.safe_op,
    states.operational,
    states.cyclic,
    motion.enable,
    motion.profile_move,
    motion.second_set_point,
    motion.at_once,
    motion.relative_move,
    motion.halt,
    motion.quick_stop,
    motion.profile_velocity,
    motion.homing,
    motion.watchdog,
    motion.emergency,
    motion.recovery,
    motion.fault_reset,
    motion.back_to_init,
)


def main():
    interface, table, name, dictionary = sys.argv[1:]
    with open(table) as file:
        bench = Bench(interface, Drive(json.load(file)[name]))
    bench.dictionary = dictionary
    return report(bench, CHECKS)


if __name__ == "__main__":
    sys.exit(main())
