//! Kollmorgen AKD2G, "Profile Position Mode".

mod profile;
mod sequence;
mod starts;
mod status;
mod stops;

use crate::table::{Cell, Document, Row};

pub(crate) static DOCUMENT: Document = Document {
    title: "Kollmorgen AKD2G: Profile Position Mode",
    about: "The page \"Profile Position Mode\" of the AKD2G's fieldbus documentation.",
    rows: ROWS,
    without_row: &[
        (
            "the commands AXIS#.OPMODE, AXIS#.CMDSOURCE, AXIS#.FBUS.*, AXIS#.PL.FB and the like",
            "names of the drive's terminal for what the objects hold; no bus shows them",
        ),
        (
            "that current (torque) can be scaled",
            "no set-point of this mode is a torque; the simulated drive has no mode of torque and the library commands none",
        ),
    ],
};

const ROWS: &[Row] = &[
    Row {
        id: "AKD2G-PP-01",
        section: "Profile Position Mode (heading)",
        says: "The mode is 1 in the axis' own object: 6060h on axis 1, 6860h on axis 2.",
        drive: by!(
            profile::drive_each_axis_has_its_own_mode_object,
            "drive-second-axis-at-1000h"
        ),
        library: by!(
            profile::library_each_axis_has_its_own_mode_object,
            "36-second-axis-offset"
        ),
    },
    Row {
        id: "AKD2G-PP-02",
        section: "Fieldbus",
        says: "EtherCAT with CoE supports the mode.",
        drive: by!(
            profile::drive_has_the_mode_and_coe,
            "drive-no-profile-position-in-6502h"
        ),
        library: by!(
            profile::library_reads_the_mode_from_6502h,
            "library-modes-of-6502h"
        ),
    },
    Row {
        id: "AKD2G-PP-03",
        section: "Description",
        says: "A move goes from point to point: it begins and ends at rest.",
        drive: by!(
            profile::drive_goes_from_rest_to_rest,
            "drive-passes-its-target"
        ),
        library: by!(
            profile::library_reports_the_arrival_at_rest,
            "07-level-of-bit-10"
        ),
    },
    Row {
        id: "AKD2G-PP-04",
        section: "Description",
        says: "Objects define the motion profile; none of the drive's stored motion tasks takes part.",
        drive: by!(
            profile::drive_takes_the_profile_from_objects,
            "drive-own-velocity"
        ),
        library: by!(
            profile::library_sends_the_profile_with_the_set_point,
            "12-parameters-after-the-edge"
        ),
    },
    Row {
        id: "AKD2G-PP-05",
        section: "Drive Opmode and Command Source",
        says: "Writing the mode of operation is all it takes; operation mode and command source follow by themselves.",
        drive: by!(
            profile::drive_needs_nothing_but_6060h_for_the_mode,
            "drive-moves-in-any-mode"
        ),
        library: by!(
            profile::library_moves_only_once_the_mode_is_shown,
            "library-mode-not-awaited"
        ),
    },
    Row {
        id: "AKD2G-PP-06",
        section: "Motion Settings; Common PDO Data, 6081h",
        says: "The profile velocity sets the speed of the move.",
        drive: by!(profile::drive_cruises_at_6081h, "drive-own-velocity"),
        library: by!(
            profile::library_puts_the_velocity_into_6081h,
            "library-velocity-into-6083h"
        ),
    },
    Row {
        id: "AKD2G-PP-07",
        section: "Motion Settings; Common PDO Data, 6083h",
        says: "The profile acceleration sets the ramp up.",
        drive: by!(
            profile::drive_speeds_up_by_6083h,
            "drive-speeds-up-by-6084h"
        ),
        library: by!(
            profile::library_puts_the_acceleration_into_6083h,
            "library-ramps-swapped"
        ),
    },
    Row {
        id: "AKD2G-PP-08",
        section: "Motion Settings; Common PDO Data, 6084h",
        says: "The profile deceleration sets the ramp down.",
        drive: by!(
            profile::drive_slows_down_by_6084h,
            "drive-slows-down-by-6083h"
        ),
        library: by!(
            profile::library_puts_the_deceleration_into_6084h,
            "library-ramps-swapped"
        ),
    },
    Row {
        id: "AKD2G-PP-09",
        section: "Common PDO Data, first table",
        says: "607Ah, 6081h, 6083h, 6084h and 6040h of both axes can be written by PDO, with the widths of the table.",
        drive: by!(
            profile::drive_maps_the_written_objects,
            "drive-6081h-not-mapped"
        ),
        library: by!(
            profile::library_maps_the_written_objects,
            "library-6084h-not-mapped"
        ),
    },
    Row {
        id: "AKD2G-PP-10",
        section: "Common PDO Data, second table",
        says: "6041h, 6063h, 6064h and 606Ch of both axes can be read by PDO, with the widths of the table.",
        drive: by!(
            profile::drive_maps_the_read_objects,
            "drive-6063h-not-mapped"
        ),
        library: by!(
            profile::library_maps_the_read_objects,
            "library-6063h-not-mapped"
        ),
    },
    Row {
        id: "AKD2G-PP-11",
        section: "Common PDO Data, 605Ah",
        says: "The quick stop option code stands among the data that are read by PDO, and can be written.",
        drive: by!(
            profile::drive_maps_the_quick_stop_option,
            "drive-605ah-not-mapped"
        ),
        library: by!(
            profile::library_maps_the_quick_stop_option,
            "library-605ah-not-mapped"
        ),
    },
    Row {
        id: "AKD2G-PP-12",
        section: "Common PDO Data, 5000h, 5100h",
        says: "Subindex 4 holds 32 bits of motion status for each axis, to be read.",
        drive: by!(
            profile::drive_has_a_motion_status_for_each_axis,
            "drive-motion-status-of-one-axis"
        ),
        library: by!(
            profile::library_has_a_motion_status_for_each_axis,
            "library-motion-status-of-one-axis"
        ),
    },
    Row {
        id: "AKD2G-PP-13",
        section: "Motion Functionality",
        says: "The mode stands on the DS402 state machine: one controlword leads the states and commands the motion.",
        drive: by!(
            profile::drive_is_moved_and_led_by_the_same_word,
            "drive-disable-operation-ignored"
        ),
        library: by!(
            profile::library_steps_through_the_states_before_a_move,
            "library-skips-switch-on"
        ),
    },
    Row {
        id: "AKD2G-PP-14",
        section: "Motion Functionality",
        says: "A move can be started in Operation enabled only.",
        drive: by!(
            profile::drive_starts_only_in_operation_enabled,
            "drive-starts-in-any-state"
        ),
        library: by!(
            profile::library_refuses_a_move_before_operation_is_enabled,
            "library-moves-while-disabled"
        ),
    },
    Row {
        id: "AKD2G-PP-15",
        section: "Motion Functionality",
        says: "The profile can be defined in any other state as well.",
        drive: by!(
            profile::drive_keeps_a_profile_from_another_state,
            "drive-forgets-its-target"
        ),
        library: by!(
            profile::library_shows_the_position_as_target_in_other_states,
            "29-target-zero"
        ),
    },
    Row {
        id: "AKD2G-PP-16",
        section: "Controlword Bit 2",
        says: "0 stops the motion.",
        drive: by!(stops::drive_stops_by_bit_2, "drive-deaf-to-bit-2"),
        library: by!(
            stops::library_stops_by_bit_2,
            "library-quick-stop-without-bit-2"
        ),
    },
    Row {
        id: "AKD2G-PP-17",
        section: "Controlword Bit 2",
        says: "605Ah chooses the ramp: 6084h, or AXIS#.CS.DEC (assumed: that this is 6085h).",
        drive: by!(
            stops::drive_takes_the_quick_stop_ramp_from_605ah,
            "drive-one-quick-stop-ramp"
        ),
        library: by!(
            stops::library_ends_a_quick_stop_where_605ah_leads,
            "library-605ah-unread"
        ),
    },
    Row {
        id: "AKD2G-PP-18",
        section: "Controlword Bit 2",
        says: "The velocity command becomes 0.",
        drive: by!(
            stops::drive_ends_a_quick_stop_at_velocity_zero,
            "drive-quick-stop-too-gentle"
        ),
        library: by!(
            stops::library_reports_a_quick_stop_only_at_rest,
            "library-quick-stop-done-at-once"
        ),
    },
    Row {
        id: "AKD2G-PP-19",
        section: "Controlword Bit 2",
        says: "The set-point before it is not remembered.",
        drive: by!(
            stops::drive_forgets_the_set_point_in_a_quick_stop,
            "drive-remembers-over-quick-stop"
        ),
        library: by!(
            stops::library_moves_nothing_after_a_quick_stop,
            "library-quick-stop-unreported"
        ),
    },
    Row {
        id: "AKD2G-PP-20",
        section: "Controlword Bit 2",
        says: "It is left by stepping through the state machine.",
        drive: by!(
            stops::drive_leaves_a_quick_stop_through_the_state_machine_only,
            "drive-transition-16"
        ),
        library: by!(
            stops::library_leaves_a_quick_stop_through_the_state_machine,
            "17-quick-stop-never-left"
        ),
    },
    Row {
        id: "AKD2G-PP-21",
        section: "Controlword Bit 2, table",
        says: "1 allows motion.",
        drive: by!(
            stops::drive_moves_with_bit_2_high,
            "drive-stops-with-bit-2-high"
        ),
        library: by!(
            stops::library_keeps_bit_2_high_in_a_move,
            "library-enables-without-bit-2"
        ),
    },
    Row {
        id: "AKD2G-PP-22",
        section: "Controlword Bit 4",
        says: "It starts the move.",
        drive: by!(
            starts::drive_starts_by_bit_4,
            "drive-moves-on-the-targets-level"
        ),
        library: by!(starts::library_starts_by_bit_4, "library-no-bit-4"),
    },
    Row {
        id: "AKD2G-PP-23",
        section: "Controlword Bit 4",
        says: "The profile is the one that the objects hold when bit 4 is set.",
        drive: by!(
            starts::drive_uses_the_profile_of_the_edge,
            "drive-follows-607ah"
        ),
        library: by!(
            starts::library_holds_the_profile_until_the_drive_has_taken_it,
            "08-target-for-one-cycle"
        ),
    },
    Row {
        id: "AKD2G-PP-24",
        section: "Controlword Bit 4",
        says: "Its rising edge counts: off and on again for the next move.",
        drive: by!(
            starts::drive_takes_edges_and_no_levels,
            "drive-takes-levels"
        ),
        library: by!(
            starts::library_shows_each_low_before_the_next_edge,
            "01-no-low-between"
        ),
    },
    Row {
        id: "AKD2G-PP-25",
        section: "Controlword Bit 4",
        says: "It may fall during the move, which goes on.",
        drive: by!(
            starts::drive_goes_on_when_bit_4_falls,
            "drive-stops-with-bit-4"
        ),
        library: by!(
            starts::library_lowers_bit_4_during_the_move,
            "library-bit-4-stays-high"
        ),
    },
    Row {
        id: "AKD2G-PP-26",
        section: "Controlword Bit 4, table, value 0",
        says: "It is reset before the next move, and before the same move again.",
        drive: by!(
            starts::drive_needs_a_low_to_restart_the_same_move,
            "drive-same-target-suppressed"
        ),
        library: by!(
            starts::library_sends_the_same_target_again,
            "10-same-target-suppressed"
        ),
    },
    Row {
        id: "AKD2G-PP-27",
        section: "Controlword Bit 5, value 0, left figure",
        says: "The new move starts after the current one is complete.",
        drive: by!(
            starts::drive_waits_for_the_current_move_with_bit_5_low,
            "drive-always-replaces"
        ),
        library: by!(starts::library_queues_with_bit_5_low, "11-always-bit-5"),
    },
    Row {
        id: "AKD2G-PP-28",
        section: "Controlword Bit 5, value 1, right figure",
        says: "The new move starts immediately.",
        drive: by!(
            starts::drive_starts_at_once_with_bit_5_high,
            "drive-never-replaces"
        ),
        library: by!(starts::library_replaces_with_bit_5_high, "11-no-bit-5"),
    },
    Row {
        id: "AKD2G-PP-29",
        section: "Controlword Bit 6, table",
        says: "0 is an absolute move, 1 a relative one, chosen with each set-point.",
        drive: by!(
            starts::drive_takes_bit_6_with_each_set_point,
            "drive-relative-stays"
        ),
        library: by!(
            starts::library_sets_bit_6_for_relative_moves_alone,
            "09-relative-stays"
        ),
    },
    Row {
        id: "AKD2G-PP-30",
        section: "Controlword Bit 6",
        says: "An absolute move ends at the target wherever the axis stood.",
        drive: by!(
            starts::drive_moves_to_an_absolute_target_from_anywhere,
            "drive-always-relative"
        ),
        library: by!(
            starts::library_moves_to_an_absolute_target_from_anywhere,
            "library-always-relative"
        ),
    },
    Row {
        id: "AKD2G-PP-31",
        section: "Controlword Bit 6",
        says: "A relative move goes by the distance that was asked for.",
        drive: by!(
            starts::drive_moves_by_a_relative_distance,
            "drive-never-relative"
        ),
        library: by!(
            starts::library_moves_by_a_relative_distance,
            "library-never-relative"
        ),
    },
    Row {
        id: "AKD2G-PP-32",
        section: "Controlword Bit 6",
        says: "The sign of the value is the direction of a relative move.",
        drive: by!(
            starts::drive_takes_the_direction_from_the_sign,
            "drive-distance-without-sign"
        ),
        library: by!(
            starts::library_sends_the_sign_of_a_distance,
            "library-distance-without-sign"
        ),
    },
    Row {
        id: "AKD2G-PP-33",
        section: "Controlword Bit 8",
        says: "It pauses the motion.",
        drive: by!(stops::drive_pauses_by_bit_8, "drive-deaf-to-bit-8"),
        library: by!(stops::library_pauses_by_bit_8, "15-halt-is-quick-stop"),
    },
    Row {
        id: "AKD2G-PP-34",
        section: "Controlword Bit 8",
        says: "The velocity command becomes 0.",
        drive: by!(stops::drive_halts_to_velocity_zero, "drive-halt-goes-on"),
        library: by!(
            stops::library_reports_a_halt_only_at_rest,
            "library-halt-done-at-once"
        ),
    },
    Row {
        id: "AKD2G-PP-35",
        section: "Controlword Bit 8",
        says: "The set-point before it is remembered.",
        drive: by!(
            stops::drive_remembers_the_set_point_in_a_halt,
            "drive-forgets-on-halt"
        ),
        library: by!(
            stops::library_completes_a_halted_move_after_resume,
            "14-halt-stays"
        ),
    },
    Row {
        id: "AKD2G-PP-36",
        section: "Controlword Bit 8",
        says: "When it is turned off the move continues, whatever bit 4 is.",
        drive: by!(
            stops::drive_resumes_whatever_bit_4_is,
            "drive-resumes-with-bit-4-only"
        ),
        library: by!(stops::library_resumes_without_bit_4, "14-halt-stays"),
    },
    Row {
        id: "AKD2G-PP-37",
        section: "Controlword Bit 8",
        says: "Its ramp is 6084h.",
        drive: by!(stops::drive_halts_by_6084h, "drive-halts-by-6085h"),
        library: by!(
            stops::library_waits_out_a_gentle_ramp,
            "library-halt-done-at-once"
        ),
    },
    Row {
        id: "AKD2G-PP-38",
        section: "Controlword Bit 8, table",
        says: "0 allows and resumes motion, 1 pauses it.",
        drive: by!(
            stops::drive_moves_with_bit_8_low_only,
            "drive-deaf-to-bit-8"
        ),
        library: by!(
            stops::library_refuses_a_move_while_halted,
            "library-moves-while-halted"
        ),
    },
    Row {
        id: "AKD2G-PP-39",
        section: "Controlword Bit 9",
        says: "A set-point given with bit 4 while another is in progress is blended into it.",
        drive: by!(
            starts::drive_blends_a_set_point_into_one_in_progress,
            "drive-no-blend"
        ),
        library: by!(
            starts::library_blends_a_set_point_into_one_in_progress,
            "library-no-bit-9"
        ),
    },
    Row {
        id: "AKD2G-PP-40",
        section: "Controlword Bit 9",
        says: "It needs bit 5 at 0.",
        drive: by!(
            starts::drive_blends_only_with_bit_5_low,
            "drive-bit-9-over-bit-5"
        ),
        library: by!(starts::library_blends_with_bit_5_low, "11-always-bit-5"),
    },
    Row {
        id: "AKD2G-PP-41",
        section: "Controlword Bit 9, value 0, left figure",
        says: "The next move starts from standstill.",
        drive: by!(
            starts::drive_starts_from_standstill_with_bit_9_low,
            "drive-always-blends"
        ),
        library: by!(
            starts::library_reports_a_stop_between_queued_moves,
            "library-reached-is-passed"
        ),
    },
    Row {
        id: "AKD2G-PP-42",
        section: "Controlword Bit 9, value 1, right figure",
        says: "The axis goes from the current move into the next without a stop.",
        drive: by!(
            starts::drive_keeps_its_speed_through_a_blend,
            "drive-blend-stops"
        ),
        library: by!(
            starts::library_says_passed_where_the_axis_did_not_stop,
            "library-passed-is-reached"
        ),
    },
    Row {
        id: "AKD2G-PP-43",
        section: "Controlword Bit 9",
        says: "With bit 5 set as well the new move starts at once and the current target is given up.",
        drive: by!(
            starts::drive_lets_bit_5_override_bit_9,
            "drive-bit-9-over-bit-5"
        ),
        library: by!(
            starts::library_never_sends_bits_5_and_9_together,
            "11-always-bit-5"
        ),
    },
    Row {
        id: "AKD2G-PP-44",
        section: "Status",
        says: "The statusword tells of faults, warnings, the power stage, the acknowledge and the arrival.",
        drive: by!(
            status::drive_tells_fault_warning_power_and_progress,
            "drive-warning-elsewhere"
        ),
        library: by!(
            status::library_shows_fault_warning_power_and_progress,
            "library-without-warning"
        ),
    },
    Row {
        id: "AKD2G-PP-45",
        section: "Mode-Specific Statusword Bits, bit 10",
        says: "Reached means within the window AXIS#.SETTLE.P (assumed: that this is 6067h).",
        drive: by!(
            status::drive_is_within_its_window_when_it_says_reached,
            "drive-reached-without-window"
        ),
        library: by!(
            status::library_takes_a_bit_10_elsewhere_for_no_arrival,
            "library-bit-10-is-enough"
        ),
    },
    Row {
        id: "AKD2G-PP-46",
        section: "Mode-Specific Statusword Bits, bit 10",
        says: "When exactly it is set can be configured (AXIS#.CANOPEN.TARPOSMODE).",
        drive: by!(
            status::drive_can_be_set_to_another_meaning_of_reached,
            "drive-one-meaning-of-reached"
        ),
        library: by!(
            status::library_reports_the_arrival_with_either_meaning,
            "library-bit-10-is-enough"
        ),
    },
    Row {
        id: "AKD2G-PP-47",
        section: "Mode-Specific Statusword Bits, bit 10 = 0, bit 8 = 0",
        says: "The target is not reached.",
        drive: by!(
            status::drive_shows_0_before_the_target,
            "drive-reached-while-moving"
        ),
        library: by!(
            status::library_reports_nothing_before_bit_10,
            "library-position-is-enough"
        ),
    },
    Row {
        id: "AKD2G-PP-48",
        section: "Mode-Specific Statusword Bits, bit 10 = 0, bit 8 = 1",
        says: "The axis decelerates.",
        drive: by!(
            status::drive_shows_0_while_a_halt_decelerates,
            "drive-halted-at-once"
        ),
        library: by!(
            status::library_ends_a_halt_no_earlier_than_bit_10,
            "library-halt-by-velocity"
        ),
    },
    Row {
        id: "AKD2G-PP-49",
        section: "Mode-Specific Statusword Bits, bit 10 = 1, bit 8 = 0",
        says: "The target is reached.",
        drive: by!(status::drive_shows_1_at_the_target, "drive-never-reached"),
        library: by!(
            status::library_reports_the_arrival_with_bit_10,
            "library-arrival-needs-settling"
        ),
    },
    Row {
        id: "AKD2G-PP-50",
        section: "Mode-Specific Statusword Bits, bit 10 = 1, bit 8 = 1",
        says: "The velocity has dropped to the threshold AXIS#.ZEROV, which need not be zero.",
        drive: by!(
            status::drive_shows_1_at_the_end_of_a_halt,
            "drive-halted-only-at-rest"
        ),
        library: by!(
            status::library_takes_no_halt_for_an_arrival,
            "library-halt-is-arrival"
        ),
    },
    Row {
        id: "AKD2G-PP-51",
        section: "Mode-Specific Statusword Bits, bit 12 = 0",
        says: "The set-point before is processed; a new one is awaited.",
        drive: by!(
            status::drive_waits_for_a_set_point_with_bit_12_low,
            "drive-never-acknowledges"
        ),
        library: by!(
            status::library_raises_bit_4_only_on_a_low_bit_12,
            "04-level-of-bit-12"
        ),
    },
    Row {
        id: "AKD2G-PP-52",
        section: "Mode-Specific Statusword Bits, bit 12 = 1",
        says: "The set-point before is still in process and may be overwritten.",
        drive: by!(
            status::drive_accepts_an_overwrite_while_one_is_in_process,
            "drive-never-replaces"
        ),
        library: by!(
            status::library_overwrites_a_set_point_in_process,
            "library-replaces-after-arrival"
        ),
    },
    Row {
        id: "AKD2G-PP-53",
        section: "Mode-Specific Statusword Bits, bit 12 = 1",
        says: "After the move it stays high as long as bit 4 is high.",
        drive: by!(
            status::drive_keeps_bit_12_with_bit_4_after_the_move,
            "drive-acknowledge-falls-at-arrival"
        ),
        library: by!(
            status::library_needs_no_acknowledge_before_the_arrival,
            "02-one-cycle-pulse"
        ),
    },
    Row {
        id: "AKD2G-PP-54",
        section: "Mode-Specific Statusword Bits, bit 12 = 1",
        says: "It turns off when bit 4 is turned off.",
        drive: by!(
            status::drive_drops_bit_12_with_bit_4,
            "drive-acknowledge-shows-the-buffer"
        ),
        library: by!(
            status::library_says_so_where_bit_12_does_not_fall,
            "05-no-deadline-idle"
        ),
    },
    Row {
        id: "AKD2G-PP-55",
        section: "Mode-Specific Statusword Bits, bit 13 = 0",
        says: "There is no following error.",
        drive: by!(
            status::drive_has_bit_13_low_without_following_error,
            "drive-following-error-too-early"
        ),
        library: Cell::NoPart("what it does on a following error follows the fault, not bit 13"),
    },
    Row {
        id: "AKD2G-PP-56",
        section: "Mode-Specific Statusword Bits, bit 13 = 1",
        says: "It is set when the drive faults with a following error (F6001).",
        drive: by!(
            status::drive_faults_with_bit_13_on_following_error,
            "drive-following-error-without-fault"
        ),
        library: by!(
            status::library_ends_a_move_with_the_following_error,
            "library-fault-unreported"
        ),
    },
    Row {
        id: "AKD2G-PP-57",
        section: "Example Sequence of Events, first rows",
        says: "Mode, target and parameters are set, 06h makes ready, 0Fh enables operation. The library sends 07h between the two, as CiA 402 does, and target and parameters after them, with the set-point.",
        drive: by!(
            profile::drive_obeys_the_first_rows_of_the_example,
            "drive-two-words-for-3-and-4"
        ),
        library: by!(
            profile::library_does_the_first_rows_of_the_example_in_their_order,
            "33-mode-left-at-0"
        ),
    },
    Row {
        id: "AKD2G-PP-58",
        section: "Example Sequence of Events, option 1",
        says: "The word before the move, then the one with bit 4: start from standstill, absolute (0Fh, 1Fh).",
        drive: by!(sequence::option_1::drive_starts, "drive-bit-6-inverted"),
        library: by!(sequence::option_1::library_starts, "library-bit-6-inverted"),
    },
    Row {
        id: "AKD2G-PP-59",
        section: "Example Sequence of Events, option 1",
        says: "11Fh halts, the word with bit 8 low resumes.",
        drive: by!(
            sequence::option_1::drive_halts_and_resumes,
            "drive-forgets-on-halt"
        ),
        library: by!(
            sequence::option_1::library_halts_and_resumes,
            "14-halt-stays"
        ),
    },
    Row {
        id: "AKD2G-PP-60",
        section: "Example Sequence of Events, option 1",
        says: "1Bh is the quick stop; it is left through the state machine.",
        drive: by!(
            sequence::option_1::drive_quick_stops,
            "drive-remembers-over-quick-stop"
        ),
        library: by!(
            sequence::option_1::library_quick_stops,
            "library-quick-stop-without-bit-2"
        ),
    },
    Row {
        id: "AKD2G-PP-61",
        section: "Example Sequence of Events, reset of the start bit, option 1",
        says: "The start bit may be reset at any time during or after the move (0Fh).",
        drive: by!(
            sequence::option_1::drive_lets_the_start_bit_fall,
            "drive-stops-with-bit-4"
        ),
        library: by!(
            sequence::option_1::library_lets_the_start_bit_fall,
            "library-bit-4-stays-high"
        ),
    },
    Row {
        id: "AKD2G-PP-62",
        section: "Example Sequence of Events, option 2",
        says: "The word before the move, then the one with bit 4: start from standstill, relative (4Fh, 5Fh).",
        drive: by!(sequence::option_2::drive_starts, "drive-bit-6-inverted"),
        library: by!(sequence::option_2::library_starts, "library-bit-6-inverted"),
    },
    Row {
        id: "AKD2G-PP-63",
        section: "Example Sequence of Events, option 2",
        says: "15Fh halts, the word with bit 8 low resumes.",
        drive: by!(
            sequence::option_2::drive_halts_and_resumes,
            "drive-forgets-on-halt"
        ),
        library: by!(
            sequence::option_2::library_halts_and_resumes,
            "14-halt-stays"
        ),
    },
    Row {
        id: "AKD2G-PP-64",
        section: "Example Sequence of Events, option 2",
        says: "5Bh is the quick stop; it is left through the state machine.",
        drive: by!(
            sequence::option_2::drive_quick_stops,
            "drive-remembers-over-quick-stop"
        ),
        library: by!(
            sequence::option_2::library_quick_stops,
            "library-quick-stop-without-bit-2"
        ),
    },
    Row {
        id: "AKD2G-PP-65",
        section: "Example Sequence of Events, reset of the start bit, option 2",
        says: "The start bit may be reset at any time during or after the move (4Fh). The library sends 0Fh in place of 4Fh: a relative flag never outlives its operation.",
        drive: by!(
            sequence::option_2::drive_lets_the_start_bit_fall,
            "drive-stops-with-bit-4"
        ),
        library: by!(
            sequence::option_2::library_lets_the_start_bit_fall,
            "library-bit-4-stays-high"
        ),
    },
    Row {
        id: "AKD2G-PP-66",
        section: "Example Sequence of Events, option 3",
        says: "The word before the move, then the one with bit 4: start immediately, absolute (2Fh, 3Fh).",
        drive: by!(sequence::option_3::drive_starts, "drive-bit-6-inverted"),
        library: by!(sequence::option_3::library_starts, "library-bit-6-inverted"),
    },
    Row {
        id: "AKD2G-PP-67",
        section: "Example Sequence of Events, option 3",
        says: "13Fh halts, the word with bit 8 low resumes.",
        drive: by!(
            sequence::option_3::drive_halts_and_resumes,
            "drive-forgets-on-halt"
        ),
        library: by!(
            sequence::option_3::library_halts_and_resumes,
            "14-halt-stays"
        ),
    },
    Row {
        id: "AKD2G-PP-68",
        section: "Example Sequence of Events, option 3",
        says: "3Bh is the quick stop; it is left through the state machine.",
        drive: by!(
            sequence::option_3::drive_quick_stops,
            "drive-remembers-over-quick-stop"
        ),
        library: by!(
            sequence::option_3::library_quick_stops,
            "library-quick-stop-without-bit-2"
        ),
    },
    Row {
        id: "AKD2G-PP-69",
        section: "Example Sequence of Events, reset of the start bit, option 3",
        says: "The start bit may be reset at any time during or after the move (2Fh). The library sends 0Fh in place of 2Fh: bits 5, 6 and 9 fall with bit 4.",
        drive: by!(
            sequence::option_3::drive_lets_the_start_bit_fall,
            "drive-stops-with-bit-4"
        ),
        library: by!(
            sequence::option_3::library_lets_the_start_bit_fall,
            "library-bit-4-stays-high"
        ),
    },
    Row {
        id: "AKD2G-PP-70",
        section: "Example Sequence of Events, option 4",
        says: "The word before the move, then the one with bit 4: start immediately, relative (6Fh, 7Fh).",
        drive: by!(sequence::option_4::drive_starts, "drive-bit-6-inverted"),
        library: by!(sequence::option_4::library_starts, "library-bit-6-inverted"),
    },
    Row {
        id: "AKD2G-PP-71",
        section: "Example Sequence of Events, option 4",
        says: "17Fh halts, the word with bit 8 low resumes.",
        drive: by!(
            sequence::option_4::drive_halts_and_resumes,
            "drive-forgets-on-halt"
        ),
        library: by!(
            sequence::option_4::library_halts_and_resumes,
            "14-halt-stays"
        ),
    },
    Row {
        id: "AKD2G-PP-72",
        section: "Example Sequence of Events, option 4",
        says: "7Bh is the quick stop; it is left through the state machine.",
        drive: by!(
            sequence::option_4::drive_quick_stops,
            "drive-remembers-over-quick-stop"
        ),
        library: by!(
            sequence::option_4::library_quick_stops,
            "library-quick-stop-without-bit-2"
        ),
    },
    Row {
        id: "AKD2G-PP-73",
        section: "Example Sequence of Events, reset of the start bit, option 4",
        says: "The start bit may be reset at any time during or after the move (6Fh). The library sends 0Fh in place of 6Fh: a relative flag never outlives its operation.",
        drive: by!(
            sequence::option_4::drive_lets_the_start_bit_fall,
            "drive-stops-with-bit-4"
        ),
        library: by!(
            sequence::option_4::library_lets_the_start_bit_fall,
            "library-bit-4-stays-high"
        ),
    },
    Row {
        id: "AKD2G-PP-74",
        section: "Monitor",
        says: "Bits 12, 13 and 10 and the two actual positions show the progress.",
        drive: by!(
            profile::drive_shows_what_the_monitor_rows_read,
            "drive-never-acknowledges"
        ),
        library: by!(
            profile::library_passes_on_what_the_monitor_rows_read,
            "library-statusword-cut"
        ),
    },
    Row {
        id: "AKD2G-PP-75",
        section: "CANopen Scaling",
        says: "Objects scale between the units of set-points and positions and the encoder's increments.",
        drive: by!(
            profile::drive_scales_between_6063h_and_6064h,
            "drive-6063h-unscaled"
        ),
        library: by!(
            profile::library_scales_between_units_and_counts,
            "39-rounding-truncates"
        ),
    },
    Row {
        id: "AKD2G-PP-76",
        section: "CANopen Scaling",
        says: "Scale factors change what the numbers in the set-point objects mean, so they are set before them.",
        drive: by!(
            profile::drive_means_another_speed_once_a_factor_has_changed,
            "drive-velocity-factor-ignored"
        ),
        library: by!(
            profile::library_counts_a_velocity_by_its_factor,
            "library-velocity-factor-ignored"
        ),
    },
    Row {
        id: "AKD2G-PP-77",
        section: "Status",
        says: "The statusword tells that home is attained (in Homing mode).",
        drive: by!(
            status::drive_tells_that_home_is_attained,
            "drive-home-unsaid"
        ),
        library: by!(
            status::library_knows_that_home_is_attained,
            "library-home-forgotten"
        ),
    },
    Row {
        id: "AKD2G-PP-78",
        section: "CANopen Scaling",
        says: "Acceleration and deceleration are scaled as well.",
        drive: by!(
            profile::drive_means_another_ramp_once_a_factor_has_changed,
            "drive-acceleration-factor-ignored"
        ),
        library: by!(
            profile::library_counts_a_ramp_by_its_factor,
            "library-acceleration-factor-ignored"
        ),
    },
    Row {
        id: "AKD2G-PP-79",
        section: "Example Sequence of Events, options 1 to 4",
        says: "The words have bits 5 and 6 one step before bit 4, and keep them after it. Whether the drive needs that is not said. Sent so, a set-point is right on a drive that takes them with the edge and on one that takes them from the word before; sent with bit 4, only on the first. The library sends them so.",
        drive: by!(
            sequence::drive_may_take_the_start_bits_with_the_edge_or_before,
            "drive-start-bits-only-with-the-edge"
        ),
        library: by!(
            sequence::library_sends_the_start_bits_first,
            "library-start-bits-never-first"
        ),
    },
];
