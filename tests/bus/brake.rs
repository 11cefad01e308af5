//! A load that hangs on an axis, and its brake on 60FEh: it stays where it is until the program opens the brake.

use std::{
    future::Future,
    pin::pin,
    sync::{Arc, Mutex},
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    Axis, AxisConfig, DriveConfig, Move, Network, NetworkError, Outcome, ProfilePosition,
    Referencing, SetPoint,
    axis::OutputField,
    bus::{DriveFault, Recovered},
    coe::obj,
    drives::{self, DriveDescription},
    ds402::DigitalOutputs,
    parameters::{StartUpWrite, Transition, WriteFault},
};
use servocrab_sim::{
    AlState, Segment,
    ds402::{Machine, MachineBrake},
    personality::Servo,
};

use crate::{
    rig::{Line, Rig},
    unset::{INPUTS, with_fixed_outputs},
};

const MS: Duration = Duration::from_millis(1);
/// One g at 1000 counts a millimetre: in 2 ms a load falls by 20 counts.
const GRAVITY: u32 = 9_806_650;
/// How long its brake takes to close.
const CLOSES_IN: Duration = Duration::from_millis(80);
/// How far a load may go at most where it is held: the drive's position window.
const WINDOW: i64 = 10;
/// Bit 0 of 60FEh.
const SET: u32 = DigitalOutputs::SET_BRAKE.bits();

/// The axis of a drive that carries a load: the last one.
struct Lift {
    line: Line,
    rig: Rig,
    number: usize,
    seen: Arc<Mutex<Seen>>,
}

/// How high the load was, how far it has come down from there, and whether it was driven against its brake.
#[derive(Default)]
struct Seen {
    highest: i64,
    fallen: i64,
    grinds: bool,
}

/// A drive with a load on each axis, of which the last is watched in each cycle.
fn hanging(servo: Servo) -> (Line, usize, Arc<Mutex<Seen>>) {
    let servo = servo.change(|drive| {
        drive.machine = Machine {
            gravity: GRAVITY,
            brake: Some(MachineBrake::new(CLOSES_IN)),
            ends: Some((-1_000_000, i64::MAX)),
            ..Machine::default()
        };
    });
    let mut segment = Segment::new().with(servo.build());
    let number = segment.device(0).unwrap().axes().len() - 1;
    let seen = Arc::new(Mutex::new(Seen::default()));
    let watched = Arc::clone(&seen);
    segment.observe(move |record| {
        // It counts axes from 1.
        if record.axis == number + 1 {
            let position = record.model.mechanical_position();
            let mut seen = watched.lock().unwrap();
            seen.highest = seen.highest.max(position);
            seen.fallen = seen.fallen.max(seen.highest - position);
            let (_, velocity) = record.model.demand();
            seen.grinds |= record.model.is_braked() && velocity != 0.0;
        }
    });
    (Line::new(segment), number, seen)
}

/// An axis with its brake in the process data.
fn braked(name: &str) -> AxisConfig {
    AxisConfig::new(name)
        .referencing(Referencing::UnreferencedMovesAllowed)
        .map_output(obj::DIGITAL_OUTPUTS)
}

/// Enables the brake's output.
fn mask() -> StartUpWrite {
    StartUpWrite::new(obj::DIGITAL_OUTPUTS_MASK, SET)
}

fn generic() -> DriveConfig {
    DriveConfig::new(drives::generic()).axis(braked("lift"))
}

impl Lift {
    fn start(servo: Servo, drive: DriveConfig) -> Self {
        let (line, number, seen) = hanging(servo);
        let rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
        Self {
            line,
            rig,
            number,
            seen,
        }
    }

    /// With the axis enabled and its brake opened by the program.
    fn held_by_its_drive(servo: Servo) -> Self {
        let mut lift = Self::start(servo, generic().start_up(mask()));
        lift.opens_its_brake();
        lift
    }

    fn opens_its_brake(&mut self) {
        let axis = self.axis();
        self.rig.until(axis.enable()).unwrap();
        assert!(self.is_braked(), "nobody has opened it");
        self.brake().set(0);
        self.rig.run_for(100 * MS);
        assert!(!self.is_braked());
    }

    fn axis(&self) -> Axis {
        self.rig.net().axis("lift").unwrap()
    }

    fn brake(&self) -> OutputField<u32> {
        self.axis().output(obj::DIGITAL_OUTPUTS).unwrap()
    }

    fn is_braked(&self) -> bool {
        let segment = self.line.segment();
        segment.axis(0, self.number).unwrap().is_braked()
    }

    fn has_not_fallen(&self) {
        let seen = self.seen.lock().unwrap();
        assert!(
            seen.fallen <= WINDOW,
            "the load has fallen by {}",
            seen.fallen
        );
        assert!(!seen.grinds, "its brake was closed while it moved");
    }

    /// Begins to lift the load by its drive. What is returned keeps the mode.
    fn sets_off(&mut self, by: i32) -> (ProfilePosition, Move) {
        let axis = self.axis();
        self.rig.until(async {
            let pp = axis.profile_position().await.unwrap();
            let set_point = SetPoint::new()
                .velocity(20_000)
                .acceleration(100_000)
                .deceleration(100_000);
            let lifted = pp.move_rel(by, set_point).await.unwrap();
            (pp, lifted)
        })
    }

    /// Lifts the load by its drive, and sets it on its brake.
    fn lifts(&mut self) {
        self.opens_its_brake();
        let (pp, lifted) = self.sets_off(5_000);
        let outcome = self.rig.until(lifted.done()).unwrap();
        assert!(matches!(outcome, Outcome::Reached { .. }), "{outcome:?}");
        self.rig.until(pp.release()).unwrap();
        self.brake().set(SET);
        self.rig.run_for(CLOSES_IN + 20 * MS);
        assert!(self.is_braked());
        self.rig.until(self.axis().disable()).unwrap();
        self.rig.run_for(100 * MS);
        self.has_not_fallen();
    }

    /// Ends the network, and looks at the load for some time after that. What is done in each cycle until then.
    fn shuts_down_while(mut self, meanwhile: impl Fn()) {
        let net = self.rig.net.take().unwrap();
        let mut over = pin!(net.shutdown());
        let mut context = Context::from_waker(Waker::noop());
        let ended = loop {
            if let Poll::Ready(ended) = over.as_mut().poll(&mut context) {
                break ended;
            }
            let _is_over = !self.rig.bus.turn();
            meanwhile();
        };
        ended.unwrap();
        let later = self.rig.bus.now() + Duration::from_secs(1);
        self.line.segment().advance(later);
        assert!(self.is_braked());
        self.has_not_fallen();
        let segment = self.line.segment();
        assert_eq!(segment.device(0).unwrap().al_state(), AlState::Init);
        let state = segment.axis(0, self.number).unwrap().state();
        assert!(!state.is_powered(), "{state:?}");
    }

    fn shuts_down(self) {
        self.shuts_down_while(|| {});
    }

    /// The drive leaves OP by a fault of its own.
    fn falls(&mut self) {
        let mut segment = self.line.segment();
        segment.device_mut(0).unwrap().fall_to_safe_op(0x001B);
        drop(segment);
        self.rig.run_for(500 * MS);
    }
}

/// A drive whose only outputs PDO has the mask before the value.
fn mask_first() -> (Servo, DriveDescription) {
    let outputs = [
        (0x6040, 0, 16),
        (0x60FE, 2, 32),
        (0x60FE, 1, 32),
        (0x6060, 0, 8),
        (0x607A, 0, 32),
    ];
    let description = with_fixed_outputs(drives::generic(), &outputs);
    let servo = Servo::generic()
        .with_fixed_pdo(0x1701, &outputs)
        .with_fixed_pdo(0x1B01, &INPUTS)
        .fixed_mapping();
    (servo, description)
}

/// Each way in which a drive comes to its mask, on the first axis and on the second.
fn ways() -> Vec<(&'static str, Servo, DriveConfig)> {
    let mask_is_mapped = DriveConfig::new(drives::generic())
        .axis(braked("lift").map_output(obj::DIGITAL_OUTPUTS_MASK));
    let (servo, description) = mask_first();
    let axis = AxisConfig::new("lift").referencing(Referencing::UnreferencedMovesAllowed);
    let mask_is_first = DriveConfig::new(description).axis(axis);
    let of_second = StartUpWrite::new(obj::DIGITAL_OUTPUTS_MASK.axis(2), SET);
    let second = DriveConfig::new(drives::akd2g())
        .axis("x")
        .axis(braked("lift"));
    vec![
        ("PREOP", Servo::generic(), generic().start_up(mask())),
        (
            "SAFEOP",
            Servo::generic(),
            generic().start_up(mask().at(Transition::SafeOpToOp)),
        ),
        ("mapped", Servo::generic(), mask_is_mapped.start_up(mask())),
        ("mapped first", servo, mask_is_first.start_up(mask())),
        ("axis 2", Servo::akd2g(), second.start_up(of_second)),
    ]
}

#[test]
fn a_load_stays_where_it_is_from_the_first_frame_to_the_last() {
    for (way, servo, drive) in ways() {
        let mut lift = Lift::start(servo, drive);
        lift.rig.run_for(300 * MS);
        assert!(lift.is_braked(), "{way}");
        lift.has_not_fallen();
        lift.lifts();
        lift.shuts_down();
    }
}

#[test]
fn a_load_stays_where_it_is_while_a_drive_that_was_without_power_is_brought_back() {
    for (way, servo, drive) in ways() {
        let mut lift = Lift::start(servo, drive);
        lift.lifts();
        lift.rig.loses_power(&lift.line, 0);
        let recovered = lift.rig.recover(0).unwrap();
        let is_anew = matches!(recovered, Recovered::BroughtUp { .. });
        assert!(is_anew, "{way}: {recovered:?}");
        lift.rig.run_for(300 * MS);
        lift.has_not_fallen();
        lift.lifts();
        lift.shuts_down();
    }
}

/// Its program has set the brake before.
#[test]
fn a_load_stays_where_it_is_while_a_drive_that_fell_is_led_back() {
    for (way, servo, drive) in ways() {
        let mut lift = Lift::start(servo, drive);
        lift.lifts();
        lift.falls();
        let recovered = lift.rig.recover(0).unwrap();
        let is_back = matches!(recovered, Recovered::FromSafeOp { .. });
        assert!(is_back, "{way}: {recovered:?}");
        lift.rig.run_for(300 * MS);
        lift.has_not_fallen();
        lift.lifts();
        lift.shuts_down();
    }
}

/// By 605Ah it carries the load in Quick stop active, until the brake is set.
#[test]
fn the_brake_of_a_drive_that_is_led_back_is_set_before_its_power_goes() {
    let servo = Servo::generic().change(|drive| drive.quick_stop_option = 6);
    let mut lift = Lift::held_by_its_drive(servo);
    lift.falls();
    assert!(!lift.is_braked());
    lift.rig.recover(0).unwrap();
    lift.rig.run_for(CLOSES_IN + 20 * MS);
    assert!(lift.is_braked());
    lift.rig.until(lift.axis().disable()).unwrap();
    lift.rig.run_for(300 * MS);
    lift.has_not_fallen();
    lift.shuts_down();
}

#[test]
fn at_shutdown_a_standing_load_is_set_on_its_brake_before_its_drive_loses_its_power() {
    Lift::held_by_its_drive(Servo::generic()).shuts_down();
}

#[test]
fn at_shutdown_a_moving_load_is_stopped_and_set_on_its_brake_before_its_drive_loses_its_power() {
    let mut lift = Lift::held_by_its_drive(Servo::generic());
    let _kept = lift.sets_off(1_000_000);
    lift.rig.run_for(500 * MS);
    lift.shuts_down();
}

#[test]
fn no_handle_opens_a_brake_that_was_set_at_shutdown() {
    let lift = Lift::held_by_its_drive(Servo::generic());
    let brake = lift.brake();
    lift.shuts_down_while(|| brake.set(0));
}

/// It would open before anybody has enabled the axis.
#[test]
fn a_start_up_line_that_opens_a_mapped_brake_is_refused_before_anything_is_written() {
    let (line, number, seen) = hanging(Servo::generic());
    let open = StartUpWrite::new(obj::DIGITAL_OUTPUTS, 0x0003_0000);
    let drive = generic().start_up(mask()).start_up(open);
    let refused = Rig::start(Network::builder().link(line.wire()).drive(0, drive));
    let Err(NetworkError::Drive { error, .. }) = refused.map(drop) else {
        panic!("it has started");
    };
    let DriveFault::StartUp(error) = *error else {
        panic!("{error}");
    };
    assert_eq!(error.object, obj::DIGITAL_OUTPUTS.address());
    assert_eq!(error.fault, WriteFault::Brake);
    let segment = line.segment();
    let drive = segment.axis(0, number).unwrap();
    assert_eq!(drive.get(0x60FE, 2), Some(0));
    assert_eq!(seen.lock().unwrap().fallen, 0);
}
