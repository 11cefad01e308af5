//! The drive with object 2010h, "Profile Position Mode (pp)".

mod objects;
mod set_points;

use servocrab_sim::ds402::Behaviour;

use crate::bench::Drive;
use crate::common::Rig;
use crate::table::{Cell, Document, Row};

pub(crate) static DOCUMENT: Document = Document {
    title: "Drive with 2010h: Profile Position Mode (pp)",
    about: "The page \"Profile Position Mode (pp)\" of a drive with the object 2010h `Min_Profile_Velocity`.",
    rows: ROWS,
    without_row: &[
        (
            "the figures 1-1 and 1-2",
            "pictures of what the rows on the hand-over and on both methods say; `docs/figures` has ours",
        ),
        (
            "what a set-point with bit 5 = 0 does when all are busy",
            "the page does not say; the simulated drive drops it, and the library never sends it",
        ),
    ],
};

/// The simulated drive, enabled.
fn drive() -> Drive {
    Drive::enabled(Behaviour::pp2010())
}

/// The library on it, enabled.
fn rig() -> Rig {
    let mut rig = Rig::of(servocrab::drives::pp2010(), Behaviour::pp2010(), |_| {}).ideal();
    rig.enable();
    rig
}

const ROWS: &[Row] = &[
    Row {
        id: "PP2010-01",
        section: "opening",
        says: "The target position goes into the trajectory generator, which makes the position demand 6062h for the position loop.",
        drive: by!(
            set_points::drive_generates_the_demand_from_the_target,
            "drive-demand-is-actual"
        ),
        library: Cell::NoPart("the demand is the drive's own; a program that wants it maps 6062h"),
    },
    Row {
        id: "PP2010-02",
        section: "opening",
        says: "Bits 4 and 5 of the controlword and bit 12 of the statusword control how set-points are given.",
        drive: by!(
            set_points::drive_takes_set_points_by_bits_4_5_and_12_alone,
            "drive-moves-on-the-targets-level"
        ),
        library: by!(
            set_points::library_takes_bit_12_for_the_answer,
            "13-accepted-before-sent"
        ),
    },
    Row {
        id: "PP2010-03",
        section: "first list, bit 5 = 1",
        says: "A single set-point is expected.",
        drive: by!(
            set_points::drive_expects_one_set_point_with_bit_5,
            "drive-never-replaces"
        ),
        library: by!(
            set_points::library_asks_for_a_single_set_point_with_bit_5,
            "11-no-bit-5"
        ),
    },
    Row {
        id: "PP2010-04",
        section: "first list, bit 5 = 0",
        says: "A set of set-points is expected.",
        drive: by!(
            set_points::drive_expects_a_set_without_bit_5,
            "drive-always-replaces"
        ),
        library: by!(
            set_points::library_asks_for_a_set_without_bit_5,
            "11-always-bit-5"
        ),
    },
    Row {
        id: "PP2010-05",
        section: "hand-over",
        says: "A set-point is sent first; the rising edge of bit 4 then makes it valid.",
        drive: by!(
            set_points::drive_takes_what_is_there_at_the_edge,
            "drive-follows-607ah"
        ),
        library: by!(
            set_points::library_raises_bit_4_with_the_target_there,
            "08-target-for-one-cycle"
        ),
    },
    Row {
        id: "PP2010-06",
        section: "hand-over",
        says: "Bit 12 becomes 1 when the set-point has been received.",
        drive: by!(
            set_points::drive_acknowledges_a_set_point,
            "drive-never-acknowledges"
        ),
        library: by!(
            set_points::library_holds_bit_4_until_the_acknowledge,
            "02-one-cycle-pulse"
        ),
    },
    Row {
        id: "PP2010-07",
        section: "hand-over",
        says: "Bit 12 becomes 0 when the drive can take another set-point.",
        drive: by!(
            set_points::drive_lowers_bit_12_when_it_can_take_another,
            "drive-acknowledge-follows-bit-4"
        ),
        library: by!(
            set_points::library_sends_the_third_when_bit_12_is_low,
            "04-level-of-bit-12"
        ),
    },
    Row {
        id: "PP2010-08",
        section: "methods, single set-point",
        says: "Given while another is in progress it is processed immediately.",
        drive: by!(
            set_points::drive_processes_a_single_set_point_at_once,
            "drive-never-replaces"
        ),
        library: by!(
            set_points::library_tells_a_single_set_point_that_it_is_superseded,
            "11-no-bit-5"
        ),
    },
    Row {
        id: "PP2010-09",
        section: "methods, set of set-points",
        says: "Given while another is in progress it is processed after that one has been reached.",
        drive: by!(
            set_points::drive_processes_a_set_in_order,
            "drive-always-replaces"
        ),
        library: by!(
            set_points::library_reports_a_set_in_order,
            "11-always-bit-5"
        ),
    },
    Row {
        id: "PP2010-10",
        section: "buffer",
        says: "Up to two set-points can be set up (that the one in progress is one of them is inferred).",
        drive: by!(set_points::drive_holds_two_set_points, "drive-three-places"),
        library: by!(
            set_points::library_waits_with_a_third_set_point,
            "library-full-buffer-timed"
        ),
    },
    Row {
        id: "PP2010-11",
        section: "buffer",
        says: "While all are busy bit 12 is 1, and a set-point with bit 5 = 1 is processed immediately as a single one.",
        drive: by!(
            set_points::drive_replaces_a_full_buffer_with_bit_5,
            "drive-full-buffer-deaf"
        ),
        library: by!(
            set_points::library_replaces_a_full_buffer,
            "library-full-buffer-waits"
        ),
    },
    Row {
        id: "PP2010-12",
        section: "target reached",
        says: "Bit 10 stays 0 until all set-points are processed.",
        drive: by!(
            set_points::drive_has_bit_10_low_until_all_are_processed,
            "drive-reached-when-slow"
        ),
        library: by!(
            set_points::library_needs_no_bit_10_for_the_first_of_two,
            "library-room-unread"
        ),
    },
    Row {
        id: "PP2010-13",
        section: "trajectory",
        says: "The only ramps are linear ones.",
        drive: by!(
            set_points::drive_has_linear_ramps_only,
            "drive-2010h-with-other-ramps"
        ),
        library: by!(
            set_points::library_refuses_other_ramps,
            "library-2010h-with-other-ramps"
        ),
    },
    Row {
        id: "PP2010-14",
        section: "trajectory",
        says: "Acceleration and deceleration have parameters of their own.",
        drive: by!(
            set_points::drive_has_a_ramp_up_and_a_ramp_down,
            "drive-slows-down-by-6083h"
        ),
        library: by!(
            set_points::library_sends_a_ramp_up_and_a_ramp_down,
            "library-ramps-swapped"
        ),
    },
    Row {
        id: "PP2010-15",
        section: "related objects, types and access",
        says: "17 objects with their types and access, of which 6066h and 6068h are 16 bits wide.",
        drive: by!(
            objects::drive_has_the_objects_with_their_types,
            "drive-6066h-as-32-bits"
        ),
        library: by!(
            objects::library_has_the_objects_with_their_types,
            "34-6068h-as-32-bits"
        ),
    },
    Row {
        id: "PP2010-16",
        section: "related objects, mandatory ones",
        says: "6040h, 6041h, 6064h, 607Ah, 6081h, 6083h, 6086h and 2010h are mandatory, the others optional.",
        drive: by!(
            objects::drive_has_the_mandatory_objects,
            "drive-2010h-without-6086h"
        ),
        library: by!(
            objects::library_needs_no_more_than_the_objects_of_the_table,
            "library-2010h-with-606ch"
        ),
    },
    Row {
        id: "PP2010-17",
        section: "related objects, 2010h",
        says: "Min_Profile_Velocity (the speed at which ramps start and end, by its name).",
        drive: by!(
            objects::drive_starts_and_stops_at_the_speed_of_2010h,
            "drive-2010h-without-effect"
        ),
        library: by!(objects::library_knows_2010h, "library-2010h-as-32-bits"),
    },
];
