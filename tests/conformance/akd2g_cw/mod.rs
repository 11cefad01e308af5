//! Kollmorgen AKD2G, "6040h, 6840h Controlword".

mod bits;
mod commands;
mod modes;

use crate::table::{Cell, Document, Row};

pub(crate) static DOCUMENT: Document = Document {
    title: "Kollmorgen AKD2G: Controlword",
    about: "The page \"6040h, 6840h Controlword - AxisX\" of the AKD2G's fieldbus documentation.",
    rows: ROWS,
    without_row: &[
        (
            "\"only manufacturer-specific modes are supported at present\"",
            "the table below it lists the standard's modes beside the maker's, and the page \"Profile Position Mode\" describes mode 1: taken for a sentence of an older edition",
        ),
        (
            "the modes FDh, FEh and FFh (electronic gearing, analog torque and velocity)",
            "the manufacturer's own, without a description of what they do; the simulated drive has none of them",
        ),
        (
            "AXIS#.CANOPEN.CONTROLBIT##.MODE",
            "parameters of the drive's terminal, whose values the page does not give",
        ),
    ],
};

const ROWS: &[Row] = &[
    Row {
        id: "AKD2G-CW-01",
        section: "6040h, 6840h Controlword",
        says: "The commands are built from bits and from outside signals, such as the input that enables the output stage.",
        drive: by!(
            commands::drive_needs_its_enable_input,
            "drive-needs-no-enable-input"
        ),
        library: by!(
            commands::library_says_what_it_waits_for_without_the_enable_input,
            "13-enabled-before-sent"
        ),
    },
    Row {
        id: "AKD2G-CW-02",
        section: "Bit assignment, bit 10",
        says: "It is reserved.",
        drive: by!(bits::drive_has_no_use_for_bit_10, "drive-halts-by-bit-10"),
        library: by!(
            bits::library_never_sends_bit_10,
            "library-bit-10-is-the-programs"
        ),
    },
    Row {
        id: "AKD2G-CW-03",
        section: "Bit assignment; bits 11-15 mode",
        says: "Bits 11 to 15 are the manufacturer's; what each does is set by a parameter of its own.",
        drive: by!(
            bits::drive_leaves_bits_11_to_15_to_its_maker,
            "drive-halts-by-bit-11"
        ),
        library: by!(
            bits::library_leaves_bits_11_to_15_to_the_program,
            "library-manufacturer-bits-dropped"
        ),
    },
    Row {
        id: "AKD2G-CW-04",
        section: "Commands in the controlword, Shutdown",
        says: "Bits 2, 1, 0 = 110: transitions 2, 6, 8.",
        drive: by!(commands::drive_shuts_down, "drive-shutdown-needs-bit-3-low"),
        library: by!(
            commands::library_shuts_down,
            "library-shutdown-without-bit-1"
        ),
    },
    Row {
        id: "AKD2G-CW-05",
        section: "Commands in the controlword, Switch on",
        says: "Bits 2, 1, 0 = 111: transition 3.",
        drive: by!(commands::drive_switches_on, "drive-never-switches-on"),
        library: by!(
            commands::library_switches_on,
            "library-switch-on-without-bit-2"
        ),
    },
    Row {
        id: "AKD2G-CW-06",
        section: "Commands in the controlword, Disable voltage",
        says: "Bit 1 = 0, whatever the others: transitions 7, 9, 10, 12.",
        drive: by!(
            commands::drive_disables_the_voltage,
            "drive-disable-voltage-needs-bit-0-low"
        ),
        library: by!(
            commands::library_disables_the_voltage,
            "library-disable-voltage-with-bit-1"
        ),
    },
    Row {
        id: "AKD2G-CW-07",
        section: "Commands in the controlword, Quick stop",
        says: "Bits 2, 1 = 01: transitions 7, 10, 11.",
        drive: by!(commands::drive_quick_stops, "drive-deaf-to-bit-2"),
        library: by!(
            commands::library_quick_stops,
            "library-quick-stop-without-bit-2"
        ),
    },
    Row {
        id: "AKD2G-CW-08",
        section: "Commands in the controlword, Disable operation",
        says: "Bits 3, 2, 1, 0 = 0111: transition 5.",
        drive: by!(
            commands::drive_disables_operation,
            "drive-disable-operation-ignored"
        ),
        library: Cell::NoPart("it leaves Operation enabled by shutdown, or by quick stop"),
    },
    Row {
        id: "AKD2G-CW-09",
        section: "Commands in the controlword, Enable operation",
        says: "Bits 3, 2, 1, 0 = 1111: transition 4.",
        drive: by!(
            commands::drive_enables_operation,
            "drive-stops-with-bit-2-high"
        ),
        library: by!(
            commands::library_enables_operation,
            "library-enables-without-bit-2"
        ),
    },
    Row {
        id: "AKD2G-CW-10",
        section: "Commands in the controlword, Fault reset",
        says: "Bit 7 = 1, whatever the others: transition 15.",
        drive: by!(
            commands::drive_resets_a_fault,
            "drive-resets-with-bit-7-alone"
        ),
        library: by!(
            commands::library_resets_a_fault,
            "library-reset-without-bit-7"
        ),
    },
    Row {
        id: "AKD2G-CW-11",
        section: "Commands in the controlword, column bit 7",
        says: "It is irrelevant beside the other commands.",
        drive: by!(
            commands::drive_ignores_bit_7_beside_a_command,
            "drive-bit-7-masks-commands"
        ),
        library: by!(
            commands::library_sends_bit_7_alone,
            "24-bit-7-outlives-the-reset"
        ),
    },
    Row {
        id: "AKD2G-CW-12",
        section: "Bit assignment, bit 7",
        says: "It has an effect on faults only.",
        drive: by!(
            commands::drive_resets_nothing_without_a_fault,
            "drive-bit-7-resets-any-state"
        ),
        library: by!(
            commands::library_sends_no_reset_without_a_fault,
            "library-resets-without-fault"
        ),
    },
    Row {
        id: "AKD2G-CW-13",
        section: "Mode-dependent bits, column No.",
        says: "6060h, 6860h sets the mode: 1, 3, 4, 6, 8, 9 by these numbers.",
        drive: by!(bits::drive_takes_the_mode_from_6060h, "drive-without-csv"),
        library: by!(
            bits::library_selects_the_mode_by_6060h,
            "library-modes-mixed-up"
        ),
    },
    Row {
        id: "AKD2G-CW-14",
        section: "Mode-dependent bits, pv, tq, csp, csv",
        says: "Bits 4, 5, 6 and 9 are reserved in these modes.",
        drive: by!(
            bits::drive_has_no_use_for_the_mode_bits_elsewhere,
            "drive-moves-in-any-mode"
        ),
        library: by!(
            bits::library_sends_no_set_point_in_another_mode,
            "library-moves-in-any-mode"
        ),
    },
    Row {
        id: "AKD2G-CW-15",
        section: "Mode-dependent bits, pp",
        says: "Bit 4 new set-point, bit 5 use it immediately, bit 6 relative, bit 9 blend.",
        drive: by!(
            bits::drive_knows_the_four_bits_of_profile_position,
            "drive-bit-6-inverted"
        ),
        library: by!(
            bits::library_knows_the_four_bits_of_profile_position,
            "library-bit-6-inverted"
        ),
    },
    Row {
        id: "AKD2G-CW-16",
        section: "Axis 1, Axis 2",
        says: "6040h and 6840h are 16 bits wide, can be written and can be mapped.",
        drive: by!(
            bits::drive_has_a_controlword_for_each_axis,
            "drive-second-axis-at-1000h"
        ),
        library: by!(
            bits::library_has_a_controlword_for_each_axis,
            "36-second-axis-offset"
        ),
    },
    Row {
        id: "AKD2G-CW-17",
        section: "Mode-dependent bits, hm",
        says: "Bit 4 starts homing; bits 5, 6 and 9 are reserved.",
        drive: by!(
            modes::drive_starts_homing_by_bit_4_alone,
            "drive-homes-by-bit-5"
        ),
        library: by!(
            modes::library_starts_homing_by_bit_4_alone,
            "library-homes-by-bit-6"
        ),
    },
    Row {
        id: "AKD2G-CW-18",
        section: "Description of the remaining bits, bit 8",
        says: "It halts (pauses) in every mode; what the mode was set to, the speed of homing for instance, is kept. The library resumes no homing: of the drives that it knows some go on when bit 8 falls and some do not, so a halted homing is over and bit 4 falls.",
        drive: by!(
            modes::drive_halts_in_every_mode_and_keeps_its_velocity,
            "drive-homes-through-a-halt"
        ),
        library: by!(
            modes::library_halts_by_bit_8_in_homing_as_elsewhere,
            "library-halt-lost-in-homing"
        ),
    },
];
