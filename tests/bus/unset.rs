//! What goes out in mapped objects until the program sets them, after a recovery, and at the end.

use std::time::Duration;

use servocrab::{
    AxisConfig, DriveConfig, Network, NetworkError,
    bus::{BringUpStep, DriveFault, Recovered},
    coe::{Mappable, Object, ReadWrite, obj},
    drives::{self, DriveDescription},
    parameters::StartUpWrite,
    pdo_map::{Entry, FixedPdo},
};
use servocrab_sim::{
    PlainEntry, PlainObject, Segment,
    ds402::{Machine, MachineBrake},
    personality::Servo,
};

use crate::rig::{Line, Rig};

const MS: Duration = Duration::from_millis(1);
/// An object of the maker's.
const OWN: Object<u16, ReadWrite> =
    Object::new(0x3001, 0, "analogue output").mappable(Mappable::OUTPUTS);

pub(crate) const INPUTS: [(u16, u8, u8); 3] = [(0x6041, 0, 16), (0x6061, 0, 8), (0x6064, 0, 32)];

/// The same drive with these outputs alone.
pub(crate) fn with_fixed_outputs(
    mut description: DriveDescription,
    outputs: &[(u16, u8, u8)],
) -> DriveDescription {
    for axis in &mut description.axes {
        axis.rx_pdos.clear();
        axis.tx_pdos.clear();
    }
    let pdo = |index, entries: &[(u16, u8, u8)]| {
        let entries = entries.iter();
        let entries = entries.map(|(index, subindex, bits)| Entry::new(*index, *subindex, *bits));
        FixedPdo::new(index, entries)
    };
    description.fixed_pdos = vec![pdo(0x1701, outputs), pdo(0x1B01, &INPUTS)];
    description
}

/// A drive with an object of its maker's, which holds this.
fn with_own(readable: bool, held: &[u8]) -> Servo {
    Servo::generic().object(PlainObject {
        index: OWN.index(),
        name: "analogue output".into(),
        is_array: false,
        entries: vec![PlainEntry {
            subindex: 0,
            name: "analogue output".into(),
            // UNSIGNED16 and UNSIGNED64 (ETG.1000.6).
            data_type: if held.len() == 2 { 0x06 } else { 0x1B },
            bytes: held.len(),
            varies: false,
            default: Some(held.to_vec()),
            readable,
            writable: true,
            outputs: true,
            inputs: false,
        }],
    })
}

/// A drive of which more lies behind the 19 bytes of its usual outputs.
struct Bench {
    line: Line,
    rig: Rig,
}

impl Bench {
    fn start(line: Line, drive: DriveConfig) -> Result<Self, NetworkError> {
        let rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive))?;
        Ok(Self { line, rig })
    }

    /// What the drive has used last.
    fn outputs(&self) -> Vec<u8> {
        let segment = self.line.segment();
        segment.device(0).unwrap().outputs()[19..].to_vec()
    }

    /// These are what goes out at the start, after each recovery, and at the end, whatever the program sets meanwhile.
    fn goes_out(mut self, expected: &[u8], sets: impl Fn(&Rig)) {
        self.rig.run_for(50 * MS);
        assert_eq!(self.outputs(), expected, "at the start");
        self.is_set(expected, &sets);
        let mut segment = self.line.segment();
        segment.device_mut(0).unwrap().fall_to_safe_op(0x001B);
        drop(segment);
        self.rig.run_for(50 * MS);
        let recovered = self.rig.recover(0).unwrap();
        assert!(matches!(recovered, Recovered::FromSafeOp { .. }));
        assert_eq!(self.outputs(), expected, "after a fall");
        self.is_set(expected, &sets);
        self.rig.loses_power(&self.line, 0);
        let recovered = self.rig.recover(0).unwrap();
        assert!(matches!(recovered, Recovered::BroughtUp { .. }));
        assert_eq!(self.outputs(), expected, "after a loss of power");
        self.is_set(expected, &sets);
        let line = self.line.clone();
        self.rig.shutdown();
        let segment = line.segment();
        let last = &segment.device(0).unwrap().outputs()[19..];
        assert_eq!(last, expected, "at the end");
    }

    fn is_set(&mut self, expected: &[u8], sets: impl Fn(&Rig)) {
        sets(&self.rig);
        self.rig.run_for(10 * MS);
        assert_ne!(self.outputs(), expected, "the program has set it");
    }
}

fn mapped(object: Object<u16, ReadWrite>) -> DriveConfig {
    DriveConfig::new(drives::generic()).axis(AxisConfig::new("x").map_output(object))
}

fn sets_own(rig: &Rig) {
    let axis = rig.net().axis("x").unwrap();
    axis.output(OWN).unwrap().set(0x4321);
}

#[test]
fn an_object_of_the_makers_is_what_the_drive_held() {
    let servo = with_own(true, &[0x34, 0x12]);
    let line = Line::new(Segment::new().with(servo.build()));
    let bench = Bench::start(line, mapped(OWN)).unwrap();
    bench.goes_out(&[0x34, 0x12], sets_own);
}

#[test]
fn an_object_of_the_makers_is_what_a_start_up_line_says() {
    for readable in [true, false] {
        let servo = with_own(readable, &[0x34, 0x12]);
        let line = Line::new(Segment::new().with(servo.build()));
        let drive = mapped(OWN).start_up(StartUpWrite::new(OWN, 0x0077));
        let bench = Bench::start(line, drive).unwrap();
        bench.goes_out(&[0x77, 0], sets_own);
    }
}

#[test]
fn an_object_that_cannot_be_read_and_of_which_no_start_up_line_says_anything_is_refused_by_name() {
    let servo = with_own(false, &[0x34, 0x12]);
    let line = Line::new(Segment::new().with(servo.build()));
    let Err(error) = Bench::start(line, mapped(OWN)) else {
        panic!("it has started");
    };
    let text = error.to_string();
    assert!(
        text.contains("3001h:00") && text.contains("start-up list at PREOP-SAFEOP"),
        "{text}"
    );
    let NetworkError::Drive { step, error, .. } = error else {
        panic!("{text}");
    };
    assert_eq!(step, BringUpStep::Parameters);
    let is_unknown =
        matches!(*error, DriveFault::OutputUnknown { object, .. } if object == OWN.address());
    assert!(is_unknown, "{text}");
}

/// No output field takes it: only what the drive held can go out.
#[test]
fn an_object_that_is_longer_than_a_field_is_what_the_drive_held() {
    let held = [1, 2, 3, 4, 5, 6, 7, 8];
    let outputs = [(0x6040, 0, 16), (0x3001, 0, 64), (0x607A, 0, 32)];
    let servo = with_own(true, &held)
        .with_fixed_pdo(0x1701, &outputs)
        .with_fixed_pdo(0x1B01, &INPUTS)
        .fixed_mapping();
    let description = with_fixed_outputs(drives::generic(), &outputs);
    let line = Line::new(Segment::new().with(servo.build()));
    let drive = DriveConfig::new(description).axis("x");
    let mut bench = Bench::start(line, drive).unwrap();
    bench.rig.run_for(50 * MS);
    assert_eq!(bench.line.segment().last_outputs(0)[2..10], held);
    bench.rig.shutdown();
}

/// The bits of 60FEh, but for the brake.
#[test]
fn digital_outputs_are_what_the_drive_held_or_a_start_up_line_says() {
    let axis = || {
        let axis = AxisConfig::new("x").map_output(obj::DIGITAL_OUTPUTS);
        DriveConfig::new(drives::generic()).axis(axis.map_output(obj::DIGITAL_OUTPUTS_MASK))
    };
    let held = || {
        let mut segment = Segment::new().with(Servo::generic().build());
        let drive = segment.axis_mut(0, 0).unwrap();
        drive.set(0x60FE, 1, 0x0005_0000).unwrap();
        drive.set(0x60FE, 2, 0x0007_0000).unwrap();
        Line::new(segment)
    };
    let sets = |rig: &Rig| {
        let axis = rig.net().axis("x").unwrap();
        axis.output(obj::DIGITAL_OUTPUTS).unwrap().set(0x0002_0000);
        let mask = axis.output(obj::DIGITAL_OUTPUTS_MASK).unwrap();
        mask.set(0x0002_0001);
    };
    let bench = Bench::start(held(), axis()).unwrap();
    bench.goes_out(&[1, 0, 5, 0, 0, 0, 7, 0], sets);
    let said = axis()
        .start_up(StartUpWrite::new(obj::DIGITAL_OUTPUTS, 0x0003_0001))
        .start_up(StartUpWrite::new(obj::DIGITAL_OUTPUTS_MASK, 0x0001_0001));
    let bench = Bench::start(held(), said).unwrap();
    bench.goes_out(&[1, 0, 3, 0, 1, 0, 1, 0], sets);
}

/// Its PDO is of a fixed content.
#[test]
fn the_brake_of_an_axis_that_the_program_does_not_name_is_set() {
    let outputs = [
        (0x6040, 0, 16),
        (0x6060, 0, 8),
        (0x607A, 0, 32),
        (0x6840, 0, 16),
        (0x68FE, 1, 32),
    ];
    let servo = Servo::akd2g()
        .change(|drive| {
            drive.machine = Machine {
                gravity: 10_000_000,
                brake: Some(MachineBrake::new(Duration::ZERO)),
                ..Machine::default()
            };
        })
        .with_fixed_pdo(0x1701, &outputs)
        .with_fixed_pdo(0x1B01, &INPUTS)
        .fixed_mapping();
    let description = with_fixed_outputs(drives::akd2g(), &outputs);
    let mask = StartUpWrite::new(obj::DIGITAL_OUTPUTS_MASK.axis(2), 1);
    let drive = DriveConfig::new(description).axis("x").start_up(mask);
    let line = Line::new(Segment::new().with(servo.build()));
    let mut bench = Bench::start(line, drive).unwrap();
    bench.rig.run_for(300 * MS);
    let line = bench.line.clone();
    let position = || line.segment().axis(0, 1).unwrap().mechanical_position();
    assert_eq!(position(), 0);
    bench.rig.shutdown();
    assert_eq!(position(), 0);
}
