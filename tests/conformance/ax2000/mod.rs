//! Beckhoff AX2000, CANopen communication profile, pages 101 and 102.

mod ramps;
mod set_points;

use servocrab_sim::ds402::Behaviour;

use crate::bench::Drive;
use crate::common::Rig;
use crate::table::{Cell, Document, Row};

pub(crate) static DOCUMENT: Document = Document {
    title: "Beckhoff AX2000: motion profile type and set-points",
    about: "Pages 101 and 102 of the user manual \"CANopen communication profile\" of AX2000 and AX2500: 6086h, \"Functional Description\" and the figure of the handshake.",
    rows: ROWS,
    without_row: &[(
        "that these bits keep reaction times on the host short",
        "what they are good for, not what the drive does",
    )],
};

/// The simulated drive, enabled.
fn drive() -> Drive {
    Drive::enabled(Behaviour::ax2000())
}

/// The library on it, enabled, with linear ramps unless a move says otherwise.
fn rig() -> Rig {
    let mut rig = Rig::of(servocrab::drives::ax2000(), Behaviour::ax2000(), |config| {
        config.defaults.profile_type = Some(0);
    })
    .ideal();
    rig.enable();
    rig
}

const ROWS: &[Row] = &[
    Row {
        id: "AX2000-01",
        section: "6086h motion_profile_type",
        says: "It chooses between linear and sin² ramps.",
        drive: by!(
            ramps::drive_chooses_the_ramp_by_6086h,
            "drive-ramps-always-linear"
        ),
        library: by!(
            ramps::library_chooses_the_ramp_with_the_set_point,
            "library-6086h-not-written"
        ),
    },
    Row {
        id: "AX2000-02",
        section: "6086h motion_profile_type, type, access, PDO mapping",
        says: "16 bits with sign; it can be written, and mapped.",
        drive: by!(
            ramps::drive_has_6086h_as_16_bits_that_can_be_mapped,
            "drive-6086h-not-mapped"
        ),
        library: by!(
            ramps::library_has_6086h_as_16_bits_that_can_be_mapped,
            "library-6086h-not-mapped"
        ),
    },
    Row {
        id: "AX2000-03",
        section: "6086h motion_profile_type, profile codes 0 and 1",
        says: "0 is linear (trapezoidal), 1 is sin².",
        drive: by!(ramps::drive_takes_0_and_1, "drive-without-sin2"),
        library: by!(ramps::library_takes_0_and_1, "library-without-sin2"),
    },
    Row {
        id: "AX2000-04",
        section: "6086h motion_profile_type, profile codes below 0",
        says: "They are the manufacturer's, and not supported.",
        drive: by!(
            ramps::drive_refuses_manufacturer_specific_types,
            "drive-with-types-of-its-maker"
        ),
        library: by!(
            ramps::library_refuses_manufacturer_specific_types,
            "library-any-profile-type"
        ),
    },
    Row {
        id: "AX2000-05",
        section: "6086h motion_profile_type, profile codes from 2",
        says: "They are extensions, and not supported.",
        drive: by!(
            ramps::drive_refuses_further_types,
            "drive-with-further-types"
        ),
        library: by!(
            ramps::library_refuses_further_types,
            "library-any-profile-type"
        ),
    },
    Row {
        id: "AX2000-06",
        section: "6086h motion_profile_type, EEPROM",
        says: "It is kept in the EEPROM.",
        drive: by!(
            ramps::drive_keeps_6086h_in_its_eeprom,
            "drive-6086h-not-kept"
        ),
        library: Cell::NoPart("it sends 6086h with each set-point and relies on no saved one"),
    },
    Row {
        id: "AX2000-07",
        section: "Functional Description, set of setpoints",
        says: "After a target is reached the next is processed immediately; normally the velocity does not drop to zero there.",
        drive: by!(
            set_points::drive_goes_on_through_a_target_of_a_set,
            "drive-blend-stops"
        ),
        library: by!(set_points::library_blends_by_a_set, "library-bit-5-dropped"),
    },
    Row {
        id: "AX2000-08",
        section: "Functional Description, set of setpoints",
        says: "That is possible with trapezoidal ramps only.",
        drive: by!(
            set_points::drive_stops_between_with_sin2_ramps,
            "drive-blends-with-sin2"
        ),
        library: by!(
            set_points::library_refuses_a_blend_with_sin2_ramps,
            "library-blends-with-any-ramp"
        ),
    },
    Row {
        id: "AX2000-09",
        section: "Functional Description, single setpoints",
        says: "After a target is reached the drive says so and then receives a new set-point.",
        drive: by!(
            set_points::drive_tells_of_the_arrival_before_it_takes_a_single_one,
            "drive-queues-single-ones"
        ),
        library: by!(
            set_points::library_gives_a_single_one_after_the_arrival,
            "library-queues-single-ones"
        ),
    },
    Row {
        id: "AX2000-10",
        section: "Functional Description, single setpoints",
        says: "Normally the velocity drops to zero before the next move starts.",
        drive: by!(
            set_points::drive_stands_between_single_ones,
            "drive-blends-single-ones"
        ),
        library: by!(
            set_points::library_says_reached_between_single_ones,
            "library-position-is-enough"
        ),
    },
    Row {
        id: "AX2000-11",
        section: "Functional Description, the two modes",
        says: "The timing of bits 4, 5 and 12 decides between them. Page 102: the initial status of bit 5 does, 0 for a single set-point and 1 for a set.",
        drive: by!(
            set_points::drive_is_told_by_bit_5_which_of_both,
            "drive-ax2000-without-bit-5"
        ),
        library: by!(
            set_points::library_tells_by_bit_5_which_of_both,
            "library-bit-5-dropped"
        ),
    },
    Row {
        id: "AX2000-12",
        section: "Functional Description, the two modes",
        says: "There is no third way: nothing replaces a set-point that is being processed.",
        drive: by!(
            set_points::drive_knows_no_replacing,
            "drive-ax2000-replaces"
        ),
        library: by!(
            set_points::library_refuses_to_replace,
            "library-ax2000-replaces"
        ),
    },
    Row {
        id: "AX2000-13",
        section: "Functional Description, request and response",
        says: "A set can be given while another one is being processed.",
        drive: by!(
            set_points::drive_takes_the_next_of_a_set_while_one_runs,
            "drive-one-place"
        ),
        library: by!(
            set_points::library_gives_the_next_of_a_set_while_one_runs,
            "library-one-place"
        ),
    },
    Row {
        id: "AX2000-14",
        section: "Page 102, figure with six numbers",
        says: "Data (1), bit 4 rises (2), bit 12 rises (3), bit 4 falls (4), bit 12 falls and new data are accepted (5). With bit 5 = 1 (6, the dashed line) the timing of the others is the same.",
        drive: by!(
            set_points::drive_answers_in_the_order_of_the_figure,
            "drive-never-acknowledges"
        ),
        library: by!(
            set_points::library_asks_in_the_order_of_the_figure,
            "library-bit-4-stays-high"
        ),
    },
];
