//! From power-on to OP with each kind of PDO mapping that drives have, and each way in which they refuse one.

use std::time::Duration;

use servocrab::{
    AxisConfig, DriveConfig, Network, NetworkError, Referencing,
    bus::{BringUpStep, DriveFault},
    coe::obj,
    drives::{self, DriveDescription},
    pdo_map::{Direction, Entry, FixedPdo, MappingError, MappingWrite, read_offered},
};
use servocrab_sim::{Abort, AlState, Device, Segment, ds402::ReachedPolicy, personality::Servo};

use crate::rig::{Line, Rig, unhomed};

const CONTROLWORD: Entry = Entry::new(0x6040, 0, 16);
const MODE: Entry = Entry::new(0x6060, 0, 8);
const TARGET: Entry = Entry::new(0x607A, 0, 32);
const STATUSWORD: Entry = Entry::new(0x6041, 0, 16);
const MODE_DISPLAY: Entry = Entry::new(0x6061, 0, 8);
const POSITION: Entry = Entry::new(0x6064, 0, 32);

fn config(description: DriveDescription) -> DriveConfig {
    unhomed(description, &["x"])
}

fn started(device: Device, config: DriveConfig) -> (Line, Result<Rig, NetworkError>) {
    let line = Line::new(Segment::new().with(device));
    let rig = Rig::start(Network::builder().link(line.wire()).drive(0, config));
    (line, rig)
}

/// Brings the drive up, moves its axes, and gives the bytes of its outputs.
fn moves(device: Device, config: DriveConfig, axes: &[&str]) -> usize {
    let (line, rig) = started(device, config);
    let mut rig = rig.unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(line.segment().devices()[0].al_state(), AlState::Op);
    rig.moves_each(&line, axes);
    let bytes = line.segment().last_outputs(0).len();
    rig.shutdown();
    bytes
}

fn fault(result: Result<Rig, NetworkError>) -> (String, BringUpStep, DriveFault) {
    match result {
        Ok(_) => panic!("it was started"),
        Err(error) => {
            let text = error.to_string();
            match error {
                NetworkError::Drive { step, error, .. } => (text, step, *error),
                other => panic!("no fault of a drive: {other}"),
            }
        }
    }
}

/// A drive of which nothing can be filled: the PDOs of the simulated drive, one of them with padding.
fn fixed_drive() -> Servo {
    Servo::generic()
        .with_fixed_pdo(
            0x1701,
            &[(0x6040, 0, 16), (0x6060, 0, 8), (0, 0, 8), (0x607A, 0, 32)],
        )
        .with_fixed_pdo(
            0x1B01,
            &[(0x6041, 0, 16), (0x6061, 0, 8), (0, 0, 8), (0x6064, 0, 32)],
        )
        .fixed_mapping()
}

fn fixed_description() -> DriveDescription {
    let mut description = drives::generic();
    description.axes[0].rx_pdos.clear();
    description.axes[0].tx_pdos.clear();
    let padding = Entry::padding(8);
    description.fixed_pdos = vec![
        FixedPdo::new(0x1601, [CONTROLWORD, TARGET]),
        FixedPdo::new(0x1602, [CONTROLWORD, MODE]),
        FixedPdo::new(0x1701, [CONTROLWORD, MODE, padding, TARGET]),
        FixedPdo::new(0x1A01, [STATUSWORD, POSITION]),
        FixedPdo::new(0x1B01, [STATUSWORD, MODE_DISPLAY, padding, POSITION]),
    ];
    description
}

#[test]
fn a_fixed_drive_gets_the_offered_pdos_that_hold_most_and_moves_with_the_rest_by_sdo() {
    let bytes = moves(fixed_drive().build(), config(fixed_description()), &["x"]);
    assert_eq!(bytes, 8, "1701h with its padding");
}

#[test]
fn the_last_handle_stops_an_axis_at_the_end_velocity_that_its_drive_held_by_itself() {
    let device = fixed_drive().change(|behaviour| {
        behaviour.goes_on_at_end_velocity = true;
        behaviour.reached = ReachedPolicy::Window;
    });
    let mut device = device.build();
    let drive = device.axis_mut(0).unwrap();
    drive.set(0x6082, 0, 5_000).unwrap();
    // Neither it nor 606Ch is mapped.
    let (line, rig) = started(device, config(fixed_description()));
    let mut rig = rig.unwrap_or_else(|error| panic!("{error}"));
    let axis = rig.net().axis("x").unwrap();
    rig.moved("x", 10_000);
    rig.run_for(Duration::from_millis(300));
    let velocity = |line: &Line| line.segment().axis(0, 0).unwrap().velocity();
    assert!((velocity(&line) - 5_000.0).abs() < 500.0, "it goes on");
    assert_eq!(axis.status().velocity, 0, "not mapped");
    drop(axis);
    rig.run_for(Duration::from_millis(500));
    assert_eq!(velocity(&line), 0.0);
    rig.shutdown();
}

#[test]
fn a_fixed_pdo_that_holds_something_else_than_described_is_shown_and_not_filled() {
    let other = Servo::generic()
        .with_fixed_pdo(
            0x1701,
            &[(0x6040, 0, 16), (0, 0, 8), (0x6060, 0, 8), (0x607A, 0, 32)],
        )
        .with_fixed_pdo(
            0x1B01,
            &[(0x6041, 0, 16), (0x6061, 0, 8), (0, 0, 8), (0x6064, 0, 32)],
        )
        .fixed_mapping();
    let (_, result) = started(other.build(), config(fixed_description()));
    let (text, step, fault) = fault(result);
    assert_eq!(step, BringUpStep::Mapping);
    assert!(matches!(fault, DriveFault::MappingDiffers(_)), "{text}");
    assert!(text.contains("1701h:02"), "{text}");
}

#[test]
fn the_pdos_that_a_drive_offers_are_read_from_it_and_chosen_among() {
    let described = fixed_description();
    let (_line, rig) = started(fixed_drive().build(), config(described.clone()));
    let mut rig = rig.unwrap_or_else(|error| panic!("{error}"));
    let sdo = rig.net().sdo(0).unwrap();
    let pdos = [0x1601, 0x1602, 0x1701, 0x17FF, 0x1A01, 0x1B01];
    let offered = rig.until(read_offered(&sdo, pdos)).unwrap();
    assert_eq!(offered, described.fixed_pdos, "and 17FFh is not there");
    rig.shutdown();
    let read = DriveDescription {
        fixed_pdos: offered,
        ..described
    };
    assert_eq!(moves(fixed_drive().build(), config(read), &["x"]), 8);
}

#[test]
fn an_object_that_a_fixed_drive_does_not_offer_is_named_before_anything_is_mapped() {
    let wanted = config(fixed_description())
        .change_axis("x", |axis| axis.map_input(obj::FOLLOWING_ERROR_ACTUAL));
    let (line, result) = started(fixed_drive().build(), wanted);
    let (text, step, fault) = fault(result);
    assert_eq!(step, BringUpStep::Mapping);
    assert!(text.contains("60F4h:00"), "{text}");
    assert!(
        matches!(
            fault,
            DriveFault::Declaration(MappingError::NotOffered {
                direction: Direction::Inputs,
                ..
            })
        ),
        "{text}"
    );
    assert_ne!(line.segment().devices()[0].al_state(), AlState::Op);
}

#[test]
fn an_object_that_is_mapped_if_there_is_left_out_by_a_fixed_drive_and_taken_by_one_that_has_it() {
    let following_error = Entry::new(0x60F4, 0, 32);
    let has_it = fixed_drive().with_fixed_pdo(0x1B02, &[(0x60F4, 0, 32)]);
    let mut with_it = fixed_description();
    let offer = FixedPdo::new(0x1B02, [following_error]);
    with_it.fixed_pdos.push(offer);
    for (device, description, there) in [
        (fixed_drive(), fixed_description(), false),
        (has_it, with_it, true),
    ] {
        let wanted = config(description).change_axis("x", |axis| {
            axis.map_input_if_there(obj::FOLLOWING_ERROR_ACTUAL)
                .map_output_if_there(obj::END_VELOCITY)
        });
        let (line, rig) = started(device.build(), wanted);
        let mut rig = rig.unwrap_or_else(|error| panic!("{error}"));
        let x = rig.net().axis("x").unwrap();
        assert_eq!(x.input(obj::FOLLOWING_ERROR_ACTUAL).is_ok(), there);
        assert!(x.output(obj::END_VELOCITY).is_err());
        rig.moves_each(&line, &["x"]);
        drop(x);
        rig.shutdown();
    }
}

#[test]
fn a_fixed_drive_described_otherwise_than_it_is_is_found_out_side_by_side() {
    let mut description = fixed_description();
    // The description lacks the padding of 1701h: every object behind it would lie in another place.
    description.fixed_pdos[2] = FixedPdo::new(0x1701, [CONTROLWORD, MODE, TARGET]);
    let (_, result) = started(fixed_drive().build(), config(description));
    let (text, step, fault) = fault(result);
    assert!(
        matches!(
            (step, &fault),
            (BringUpStep::Mapping, DriveFault::MappingDiffers(_))
        ),
        "{text}"
    );
    let lines: Vec<_> = text.lines().map(str::trim).collect();
    assert_eq!(
        lines[1..],
        [
            "place     expected            got",
            "1701h:03  607Ah:00 (32 bits)  8 bits of padding",
            "1701h:04  nothing             607Ah:00 (32 bits)",
        ]
    );
}

#[test]
fn a_drive_with_fixed_and_free_pdos_gets_the_fixed_one_and_the_rest_filled() {
    let device = Servo::generic()
        .fixed_pdos(&[0x1600, 0x1601, 0x1A00, 0x1A01])
        .build();
    let mut description = drives::generic();
    description.axes[0].rx_pdos = vec![0x1603];
    description.axes[0].tx_pdos = vec![0x1A03];
    description.limits.entries_per_pdo = 4;
    description.fixed_pdos = vec![
        FixedPdo::new(0x1601, [CONTROLWORD, TARGET]),
        FixedPdo::new(0x1A01, [STATUSWORD, POSITION]),
    ];
    let wanted =
        config(description).change_axis("x", |axis| axis.map_input(obj::FOLLOWING_ERROR_ACTUAL));
    // 1601h with 6 bytes, and 6060h, 6081h, 6083h, 6084h in 1603h.
    assert_eq!(moves(device, wanted, &["x"]), 19);
}

#[test]
fn a_drive_with_eight_entries_per_pdo_gets_the_ninth_in_its_next_pdo() {
    let device = Servo::generic().entries_per_pdo(8).pdos_assigned(2).build();
    let wanted = config(drives::generic())
        .change_axis("x", |axis| axis.map_output(obj::END_VELOCITY))
        .change_axis("x", |axis| axis.map_output(obj::QUICK_STOP_DECELERATION))
        .change_axis("x", |axis| axis.map_output(obj::TARGET_VELOCITY));
    assert_eq!(moves(device, wanted, &["x"]), 19 + 4 + 4 + 4);
}

#[test]
fn more_pdos_than_a_sync_manager_takes_are_refused_with_both_numbers() {
    let mut description = drives::generic();
    description.limits.output_pdos = 1;
    description.limits.entries_per_pdo = 4;
    let wanted = config(description)
        .change_axis("x", |axis| axis.map_output(obj::END_VELOCITY))
        .change_axis("x", |axis| axis.map_output(obj::QUICK_STOP_DECELERATION))
        .change_axis("x", |axis| axis.map_output(obj::TARGET_VELOCITY));
    let (_, result) = started(Servo::generic().build(), wanted);
    let (text, ..) = fault(result);
    assert!(
        text.contains("2 PDOs of the outputs, the drive takes 1"),
        "{text}"
    );
}

#[test]
fn two_axes_come_up_with_either_increment_of_their_pdos() {
    for increment in [1, 0x10] {
        let device = Servo::akd2g().pdo_increment(increment).build();
        let mut description = drives::akd2g();
        description = description.with_axes(2, increment);
        let both = config(description)
            .axis(AxisConfig::new("y").referencing(Referencing::UnreferencedMovesAllowed));
        assert_eq!(moves(device, both, &["x", "y"]), 38, "{increment:X}h");
    }
}

#[test]
fn a_second_axis_at_the_wrong_increment_is_refused_with_the_object_that_is_not_there() {
    let device = Servo::akd2g().pdo_increment(1).build();
    let both = config(drives::akd2g()).axis("y");
    let (_, result) = started(device, both);
    let (text, step, fault) = fault(result);
    assert_eq!(step, BringUpStep::Mapping);
    assert!(
        matches!(fault, DriveFault::MappingRefused { step, .. } if step.object.index == 0x1610),
        "{text}"
    );
}

/// The generic drive with its objects in another order than the simulated one has them at power-up.
fn another_order() -> DriveDescription {
    let mut description = drives::generic();
    description.axes[0].outputs.reverse();
    description.axes[0].inputs.reverse();
    description
}

/// The value that a step writes.
fn value(step: &MappingWrite) -> u32 {
    let bytes = step.value().iter().rev();
    bytes.fold(0, |value, byte| value << 8 | u32::from(*byte))
}

#[test]
fn a_mapping_that_the_drive_has_already_is_read_and_not_written() {
    let plan = drives::generic().default_mapping().unwrap().plan();
    let refusing = |servo: Servo, step: &MappingWrite| {
        let (index, subindex) = (step.object.index, step.object.subindex);
        servo.refuses_pdo_write(index, subindex, value(step), Abort::State)
    };
    let unwritten = plan.steps().iter().fold(Servo::generic(), refusing);
    moves(unwritten.build(), config(drives::generic()), &["x"]);
    // Of a drive with other inputs only these are written.
    let outputs = |step: &&MappingWrite| step.object.index == 0x1C12 || step.object.index < 0x1A00;
    let outputs = plan.steps().iter().filter(outputs);
    let unwritten = outputs.fold(Servo::generic(), refusing);
    let mut description = drives::generic();
    description.axes[0].inputs.reverse();
    moves(unwritten.build(), config(description), &["x"]);
}

#[test]
fn a_drive_that_confirms_a_step_and_keeps_what_it_had_never_reaches_op() {
    let plan = another_order().default_mapping().unwrap().plan();
    for step in plan.steps() {
        // Another mapping than the wanted one before, in each of its lists.
        let device = Servo::generic()
            .assigned_at_power_up(&[0x1601, 0x1A01])
            .ignores_pdo_write(step.object.index, step.object.subindex, value(step))
            .build();
        let (line, result) = started(device, config(another_order()));
        let (text, at, _) = fault(result);
        assert_eq!(at, BringUpStep::Mapping, "{step}: {text}");
        assert_ne!(line.segment().devices()[0].al_state(), AlState::Op);
    }
}

#[test]
fn what_an_axis_does_without_its_master_stops_it_where_the_process_data_hold_that_as_well() {
    let device = Servo::generic().build();
    let line = Line::new(Segment::new().with(device));
    let object = |line: &Line| line.segment().axis(0, 0).unwrap().get(0x6007, 0);
    // What the drive has stored.
    line.segment()
        .axis_mut(0, 0)
        .unwrap()
        .set(0x6007, 0, 0)
        .unwrap();
    let axis = AxisConfig::new("x").map_output(obj::ABORT_CONNECTION_OPTION);
    let config = DriveConfig::new(drives::generic()).axis(axis);
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, config)).unwrap();
    rig.run_for(Duration::from_millis(50));
    assert_eq!(object(&line), Some(3));
    rig.shutdown();
}
