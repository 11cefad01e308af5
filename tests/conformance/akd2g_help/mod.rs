//! Kollmorgen AKD2G, "AXIS#.MOTIONSTAT" of the maker's public help.

mod motion_status;

use crate::table::{Cell, Document, Row};

pub(crate) static DOCUMENT: Document = Document {
    title: "Kollmorgen AKD2G: AXIS#.MOTIONSTAT",
    about: "The page \"AXIS#.MOTIONSTAT\" of the AKD2G's public help: the bits of 5000h:4 and 5100h:4.",
    rows: ROWS,
    without_row: &[
        (
            "bits 9 and 10, service motion and a motion task that could not be activated",
            "no fieldbus starts either; the simulated drive has none of them",
        ),
        (
            "bits 12, 13 and 14, target velocity reached, exception, target crossed",
            "named and not described; the library goes by the statusword and the position",
        ),
    ],
};

const ROWS: &[Row] = &[
    Row {
        id: "AKD2G-MS-01",
        section: "Bits 0, 11 and 15",
        says: "A motion task is active; the trajectory is over and the axis within SETTLE.P; it is in the position window (assumed: that a set-point of the profile counts as a motion task).",
        drive: by!(
            motion_status::drive_shows_a_move_and_its_end,
            "drive-motion-status-without-bit-11"
        ),
        library: Cell::NoPart("it goes by the statusword and the position"),
    },
    Row {
        id: "AKD2G-MS-02",
        section: "Bits 1 and 2",
        says: "The home position has been found; the homing is done.",
        drive: by!(
            motion_status::drive_shows_that_the_homing_is_done,
            "drive-motion-status-without-bit-2"
        ),
        library: by!(
            motion_status::library_takes_homing_done_for_a_reference,
            "library-homed-signal-unused"
        ),
    },
    Row {
        id: "AKD2G-MS-03",
        section: "Bits 3 and 4",
        says: "A homing is active; there was an error during the homing.",
        drive: by!(
            motion_status::drive_shows_a_homing_and_its_error,
            "drive-motion-status-without-bit-4"
        ),
        library: by!(
            motion_status::library_takes_no_homing_under_way_or_failed_for_a_reference,
            "library-homing-error-ignored"
        ),
    },
];
