//! Yaskawa Sigma-7, "14.7 Profile Position Mode".

mod limits;
mod objects;

use crate::table::{Cell, Document, Row};

pub(crate) static DOCUMENT: Document = Document {
    title: "Yaskawa Sigma-7: 607Ah, 607Dh, 607Fh",
    about: "Section 14.7, \"Profile Position Mode\", of the manual's object dictionary (page 14-29).",
    rows: ROWS,
    without_row: &[
        (
            "607Ah in Cyclic Synchronous Position mode, where it is always absolute",
            "the simulated drive has no set-points in that mode, and the library does not command it",
        ),
        (
            "what becomes of a target beyond the limits",
            "the page does not say; the simulated drive goes to the limit and sets bit 11, and the library refuses the move before",
        ),
    ],
};

const ROWS: &[Row] = &[
    Row {
        id: "SIGMA7-01",
        section: "Target Position (607A Hex)",
        says: "It is the target position of Profile Position mode.",
        drive: by!(
            limits::drive_takes_607ah_as_the_target_of_profile_position,
            "drive-distance-halved"
        ),
        library: by!(
            limits::library_writes_the_target_into_607ah,
            "08-target-for-one-cycle"
        ),
    },
    Row {
        id: "SIGMA7-02",
        section: "Target Position (607A Hex)",
        says: "In Profile Position mode a flag of the controlword says whether it is absolute or relative.",
        drive: by!(
            limits::drive_takes_607ah_as_position_or_distance,
            "drive-never-relative"
        ),
        library: by!(
            limits::library_says_whether_607ah_is_position_or_distance,
            "library-never-relative"
        ),
    },
    Row {
        id: "SIGMA7-03",
        section: "Software Position Limits (607D Hex)",
        says: "They are absolute limits of the position demand.",
        drive: by!(
            limits::drive_keeps_its_demand_within_the_limits,
            "drive-without-limits"
        ),
        library: by!(
            limits::library_refuses_a_target_beyond_the_limits,
            "library-limits-unchecked"
        ),
    },
    Row {
        id: "SIGMA7-04",
        section: "Software Position Limits (607D Hex)",
        says: "Every target is checked against them.",
        drive: by!(
            limits::drive_checks_every_target,
            "drive-relative-targets-unchecked"
        ),
        library: by!(
            limits::library_checks_every_target_that_it_knows,
            "library-limits-unchecked"
        ),
    },
    Row {
        id: "SIGMA7-05",
        section: "Software Position Limits (607D Hex)",
        says: "They are in position units and count from the machine's home position.",
        drive: by!(
            limits::drive_counts_the_limits_from_the_home_position,
            "drive-homes-without-shift"
        ),
        library: Cell::NoPart(
            "positions and limits are the drive's own numbers; where home is, it does not know",
        ),
    },
    Row {
        id: "SIGMA7-06",
        section: "Software Position Limits (607D Hex), first correction",
        says: "The minimum in force is the minimum limit less the home offset 607Ch.",
        drive: by!(
            limits::drive_corrects_the_minimum_by_the_home_offset,
            "drive-minimum-uncorrected"
        ),
        library: by!(
            limits::library_corrects_the_minimum_by_the_home_offset,
            "library-home-offset-added"
        ),
    },
    Row {
        id: "SIGMA7-07",
        section: "Software Position Limits (607D Hex), second correction",
        says: "The maximum in force is the maximum limit less the home offset 607Ch.",
        drive: by!(
            limits::drive_corrects_the_maximum_by_the_home_offset,
            "drive-maximum-uncorrected"
        ),
        library: by!(
            limits::library_corrects_the_maximum_by_the_home_offset,
            "library-home-offset-added"
        ),
    },
    Row {
        id: "SIGMA7-08",
        section: "Software Position Limits (607D Hex)",
        says: "Targets are compared with the corrected values.",
        drive: by!(
            limits::drive_compares_targets_with_the_corrected_limits,
            "drive-maximum-uncorrected"
        ),
        library: by!(
            limits::library_compares_targets_with_the_corrected_limits,
            "library-home-offset-added"
        ),
    },
    Row {
        id: "SIGMA7-09",
        section: "Software Position Limits (607D Hex), enabled",
        says: "When homing is completed.",
        drive: by!(
            limits::drive_has_limits_once_it_is_homed,
            "drive-limits-without-homing"
        ),
        library: by!(
            limits::library_has_limits_once_the_axis_is_homed,
            "library-limits-always"
        ),
    },
    Row {
        id: "SIGMA7-10",
        section: "Software Position Limits (607D Hex), enabled",
        says: "When an absolute encoder is connected.",
        drive: by!(
            limits::drive_has_limits_with_an_absolute_encoder,
            "drive-limits-never"
        ),
        library: by!(
            limits::library_has_limits_with_an_absolute_encoder,
            "library-encoder-unknown"
        ),
    },
    Row {
        id: "SIGMA7-11",
        section: "Software Position Limits (607D Hex), disabled",
        says: "When the minimum is not below the maximum.",
        drive: by!(
            limits::drive_has_no_limits_where_min_is_not_below_max,
            "drive-limits-off-at-zero"
        ),
        library: by!(
            limits::library_has_no_limits_where_min_is_not_below_max,
            "library-limits-off-at-zero"
        ),
    },
    Row {
        id: "SIGMA7-12",
        section: "Max Profile Velocity (607F Hex)",
        says: "It is the highest speed of a move.",
        drive: by!(
            limits::drive_moves_no_faster_than_607fh,
            "drive-607fh-without-effect"
        ),
        library: by!(
            limits::library_asks_for_no_more_than_607fh,
            "library-607fh-unread"
        ),
    },
    Row {
        id: "SIGMA7-13",
        section: "Target Position (607A Hex), table",
        says: "32 bits with sign, read and write, mappable, the whole range, default 0, not saved.",
        drive: by!(
            objects::drive_has_607ah_as_the_table_says,
            "drive-607ah-kept"
        ),
        library: by!(
            objects::library_has_607ah_as_the_table_says,
            "library-607ah-at-607bh"
        ),
    },
    Row {
        id: "SIGMA7-14",
        section: "Software Position Limits (607D Hex), table, subindex 0",
        says: "8 bits, read only, not mappable, 2.",
        drive: by!(objects::drive_counts_two_limits, "drive-607d-counts-three"),
        library: Cell::NoPart("it does not read how many limits there are"),
    },
    Row {
        id: "SIGMA7-15",
        section: "Software Position Limits (607D Hex), table, subindices 1 and 2",
        says: "32 bits with sign, read and write, not mappable, -536 870 912 to 536 870 911, default 0.",
        drive: by!(
            objects::drive_has_both_limits_as_the_table_says,
            "drive-limits-of-any-size"
        ),
        library: by!(
            objects::library_has_both_limits_as_the_table_says,
            "library-limits-exchanged"
        ),
    },
    Row {
        id: "SIGMA7-16",
        section: "Software Position Limits (607D Hex), table, EEPROM",
        says: "Both limits are saved.",
        drive: by!(
            objects::drive_keeps_its_limits_in_its_eeprom,
            "drive-limits-not-kept"
        ),
        library: Cell::NoPart("it reads them when an axis attaches, and saves nothing"),
    },
    Row {
        id: "SIGMA7-17",
        section: "Max Profile Velocity (607F Hex), table",
        says: "32 bits, read and write, mappable, the whole range, default 2 147 483 647, saved.",
        drive: by!(
            objects::drive_has_607fh_as_the_table_says,
            "drive-607fh-with-another-default"
        ),
        library: by!(
            objects::library_has_607fh_as_the_table_says,
            "library-607fh-at-6080h"
        ),
    },
];
