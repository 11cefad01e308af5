//! A load that hangs, and the brake that its axis was declared with: on an output of the drive, or managed by the drive itself.

use std::{
    future::Future,
    pin::pin,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    task::{Context, Waker},
    time::Duration,
};

use servocrab::{
    Axis, AxisConfig, AxisError, DriveConfig, Failure, Move, Network, NetworkError,
    ProfilePosition, Referencing, SetPoint,
    axis::{AxisErrorKind, Brake, Deadlines, OutputBrake},
    bus::{AxisIncident, DriveFault, NetworkEvent},
    coe::obj,
    drives,
    ds402::{DigitalInput, DigitalOutput, State},
    link::Wire,
    parameters::{StartUpWrite, WriteFault},
};
use servocrab_sim::{
    Segment,
    ds402::{Disturbances, Machine, MachineBrake, Opener},
    personality::Servo,
};

use crate::rig::{Line, Rig, datagrams};

const MS: Duration = Duration::from_millis(1);
/// One g at 1000 counts a millimetre.
const GRAVITY: u32 = 9_806_650;
/// How long the brake takes, and what the program declares.
const OPENS_IN: Duration = Duration::from_millis(30);
const CLOSES_IN: Duration = Duration::from_millis(80);
const RELEASE: Duration = Duration::from_millis(400);
const SET: Duration = Duration::from_millis(90);
/// How far a load may go at most where it is held: the drive's position window.
const WINDOW: i64 = 10;

/// What the simulated drive has done with the load.
#[derive(Debug, Default)]
struct Seen {
    highest: i64,
    /// How far it has come down from its highest place.
    fallen: i64,
    /// It was driven against its brake.
    grinds: bool,
    /// It was in no hands: no control of the drive, and an open brake.
    dropped: bool,
}

/// A drive of which one axis hangs.
struct Lift {
    line: Line,
    rig: Rig,
    seen: Arc<Mutex<Seen>>,
}

/// A generic drive with this brake, which holds its axis at quick stop.
fn servo(brake: MachineBrake) -> Servo {
    Servo::generic().change(|drive| {
        drive.quick_stop_option = 6;
        drive.machine = Machine {
            gravity: GRAVITY,
            brake: Some(brake),
            ends: Some((-1_000_000, i64::MAX)),
            ..Machine::default()
        };
    })
}

fn watched(servo: Servo) -> (Line, Arc<Mutex<Seen>>) {
    let mut segment = Segment::new().with(servo.build());
    let seen = Arc::new(Mutex::new(Seen::default()));
    let watched = Arc::clone(&seen);
    segment.observe(move |record| {
        let axis = record.model;
        let position = axis.mechanical_position();
        let mut seen = watched.lock().unwrap();
        seen.highest = seen.highest.max(position);
        seen.fallen = seen.fallen.max(seen.highest - position);
        let (_, velocity) = axis.demand();
        let is_driven = matches!(
            axis.state(),
            servocrab_sim::ds402::State::OperationEnabled
                | servocrab_sim::ds402::State::QuickStopActive
                | servocrab_sim::ds402::State::FaultReactionActive
        );
        seen.grinds |= axis.is_braked() && is_driven && velocity != 0.0;
        seen.dropped |= !is_driven && !axis.is_braked();
    });
    (Line::new(segment), seen)
}

fn axis() -> AxisConfig {
    AxisConfig::new("lift").referencing(Referencing::UnreferencedMovesAllowed)
}

fn drive(axis: AxisConfig) -> DriveConfig {
    // So gently that its shaft does not swing.
    let ramp = StartUpWrite::new(obj::QUICK_STOP_DECELERATION, 100_000);
    DriveConfig::new(drives::generic())
        .axis(axis)
        .start_up(ramp)
}

/// With this mask 60FEh:2.
fn masked(axis: AxisConfig, mask: u32) -> DriveConfig {
    drive(axis).start_up(StartUpWrite::new(obj::DIGITAL_OUTPUTS_MASK, mask))
}

/// Bit 0, which the standard has for it.
fn on_bit_0() -> (MachineBrake, OutputBrake) {
    let brake = MachineBrake {
        opens_in: OPENS_IN,
        feedback: Some(17),
        ..MachineBrake::new(CLOSES_IN)
    };
    let declared = OutputBrake::new(DigitalOutput::SetBrake, RELEASE, SET);
    (brake, declared)
}

/// A maker's output that opens it by 1.
fn on_bit_16() -> (MachineBrake, OutputBrake) {
    let (brake, _) = on_bit_0();
    let opened_by = Opener::Output {
        bit: 16,
        level: true,
        closed_by_drive: false,
    };
    let declared = OutputBrake::new(DigitalOutput::Bit(16), RELEASE, SET).released_by_one();
    (MachineBrake { opened_by, ..brake }, declared)
}

fn managed() -> MachineBrake {
    let (brake, _) = on_bit_0();
    let opened_by = Opener::Drive;
    MachineBrake { opened_by, ..brake }
}

impl Lift {
    fn start(servo: Servo, drive: DriveConfig) -> Result<Self, NetworkError> {
        let (line, seen) = watched(servo);
        let wire = line.wire();
        Self::on(wire, line, seen, drive)
    }

    fn on(
        wire: Wire,
        line: Line,
        seen: Arc<Mutex<Seen>>,
        drive: DriveConfig,
    ) -> Result<Self, NetworkError> {
        let rig = Rig::start(Network::builder().link(wire).drive(0, drive))?;
        Ok(Self { line, rig, seen })
    }

    fn with((brake, declared): (MachineBrake, OutputBrake)) -> Self {
        let drive = masked(axis().brake(declared), 0x0001_0001);
        Self::start(servo(brake), drive).unwrap()
    }

    fn managed() -> Self {
        let lift = axis().vertical().brake(Brake::DriveManaged);
        Self::start(servo(managed()), drive(lift)).unwrap()
    }

    fn axis(&self) -> Axis {
        self.rig.net().axis("lift").unwrap()
    }

    fn enables(&mut self) {
        let axis = self.axis();
        self.rig.until(axis.enable()).unwrap();
        assert!(!self.is_braked(), "it may be moved from here on");
    }

    /// How long this takes.
    fn takes<T>(&mut self, future: impl Future<Output = T>) -> (Duration, T) {
        let begin = self.rig.bus.now();
        let result = self.rig.until(future);
        (self.rig.bus.now() - begin, result)
    }

    fn is_braked(&self) -> bool {
        self.line.segment().axis(0, 0).unwrap().is_braked()
    }

    fn state(&self) -> servocrab_sim::ds402::State {
        self.line.segment().axis(0, 0).unwrap().state()
    }

    fn disturb(&self, disturb: impl FnOnce(&mut Disturbances)) {
        let mut segment = self.line.segment();
        disturb(segment.axis_mut(0, 0).unwrap().disturbances());
    }

    fn faults(&self) {
        let mut segment = self.line.segment();
        segment.axis_mut(0, 0).unwrap().inject_fault(0x2310);
    }

    /// Begins to lift the load. What is returned keeps the mode.
    fn sets_off(&mut self) -> (ProfilePosition, Move) {
        let axis = self.axis();
        let moving = self.rig.until(async {
            let pp = axis.profile_position().await.unwrap();
            let set_point = SetPoint::new()
                .velocity(20_000)
                .acceleration(100_000)
                .deceleration(100_000);
            let lifted = pp.move_rel(1_000_000, set_point).await.unwrap();
            (pp, lifted)
        });
        self.rig.run_for(500 * MS);
        moving
    }

    fn is_held(&self, way: &str) {
        let seen = self.seen.lock().unwrap();
        assert!(seen.fallen <= WINDOW, "{way}: {seen:?}");
        assert!(!seen.grinds, "{way}: its brake was closed while it moved");
    }
}

fn failure(error: AxisError) -> Failure {
    match error.kind {
        AxisErrorKind::Failed(failure) => failure,
        kind => panic!("{kind:?}"),
    }
}

// A brake on an output.

#[test]
fn an_enable_is_done_when_the_brake_is_open_and_not_before() {
    for (brake, declared) in [on_bit_0(), on_bit_16()] {
        let by_feedback = declared.feedback(DigitalInput::Bit(17));
        for (declared, least, most) in [
            (declared, RELEASE, RELEASE + 30 * MS),
            (by_feedback, OPENS_IN, OPENS_IN + 30 * MS),
        ] {
            let mut lift = Lift::with((brake, declared));
            lift.rig.run_for(300 * MS);
            assert!(lift.is_braked());
            let axis = lift.axis();
            let mut enabled = pin!(axis.enable());
            let mut context = Context::from_waker(Waker::noop());
            assert!(enabled.as_mut().poll(&mut context).is_pending());
            while axis.status().state != State::OperationEnabled {
                lift.rig.run_for(MS);
            }
            let (took, result) = lift.takes(enabled);
            result.unwrap();
            assert!((least..=most).contains(&took), "{took:?} for {least:?}");
            assert!(!lift.is_braked());
            let _moving = lift.sets_off();
            lift.is_held("enable");
            lift.rig.shutdown();
        }
    }
}

#[test]
fn a_brake_that_stays_closed_fails_the_enable_where_its_feedback_shows_it_and_is_closed_again() {
    let (brake, declared) = on_bit_0();
    let mut lift = Lift::with((brake, declared.feedback(DigitalInput::Bit(17))));
    lift.disturb(|disturbances| disturbances.brake_sticks = true);
    let axis = lift.axis();
    let (took, result) = lift.takes(axis.enable());
    assert_eq!(failure(result.unwrap_err()), Failure::BrakeNotReleased);
    assert!(took < RELEASE + 100 * MS, "{took:?}");
    lift.rig.run_for(Duration::from_secs(1));
    assert!(!lift.state().is_powered());
    assert_eq!(
        lift.line.segment().axis(0, 0).unwrap().get(0x60FE, 1),
        Some(1)
    );
    lift.is_held("stuck");
    // It can be enabled once it opens.
    lift.disturb(|disturbances| disturbances.brake_sticks = false);
    lift.enables();
}

/// Its wire is broken: it shows a closed brake, and the brake is open.
#[test]
fn a_feedback_that_never_showed_the_brake_open_does_not_end_the_wait_for_its_closing() {
    let (brake, declared) = on_bit_0();
    let mut lift = Lift::with((brake, declared.feedback(DigitalInput::Bit(20))));
    let axis = lift.axis();
    let failed = lift.rig.until(axis.enable()).unwrap_err();
    assert_eq!(failure(failed), Failure::BrakeNotReleased);
    lift.rig.run_for(Duration::from_secs(1));
    assert!(!lift.state().is_powered() && lift.is_braked());
    lift.is_held("broken wire");
    assert!(!lift.seen.lock().unwrap().dropped);
}

/// As by an emergency stop that takes the power some time after it has asked for the stop.
#[test]
fn a_drive_that_loses_its_power_in_a_stop_has_its_brake_closed_at_once() {
    for moves in [false, true] {
        let mut lift = Lift::with(on_bit_0());
        lift.enables();
        let _moving = moves.then(|| lift.sets_off());
        lift.axis().stop_handle().quick_stop();
        lift.rig.run_for(20 * MS);
        lift.line
            .segment()
            .axis_mut(0, 0)
            .unwrap()
            .set_inhibited(true);
        lift.rig.run_for(CLOSES_IN + 10 * MS);
        assert!(lift.is_braked());
    }
}

/// As by an input of the drive for it: nobody has asked for that stop.
#[test]
fn a_brake_waits_for_the_end_of_a_quick_stop_of_the_drives_own() {
    let (brake, declared) = on_bit_0();
    let (line, seen) = watched(servo(brake));
    let stops = Arc::new(AtomicBool::new(false));
    let by_itself = Arc::clone(&stops);
    let wire = line.spoiled_wire(move |frame| {
        if by_itself.load(Relaxed) {
            // Bit 2 of the controlword, at the beginning of the outputs (LRW).
            for datagram in datagrams(frame) {
                datagram[10] &= if datagram[0] == 12 { !0x04 } else { 0xFF };
            }
        }
    });
    let drive = masked(axis().brake(declared), 1);
    let mut lift = Lift::on(wire, line, seen, drive).unwrap();
    lift.enables();
    let _moving = lift.sets_off();
    stops.store(true, Relaxed);
    lift.rig.run_for(5 * MS);
    stops.store(false, Relaxed);
    assert_eq!(lift.axis().status().state, State::QuickStopActive);
    assert!(!lift.is_braked());
    lift.rig.run_for(Duration::from_secs(2));
    assert!(lift.is_braked());
    lift.is_held("a quick stop of the drive's own");
}

/// Nobody can move it before.
#[test]
fn a_move_is_refused_while_the_brake_opens() {
    let mut lift = Lift::with(on_bit_0());
    let axis = lift.axis();
    let pp = lift.rig.until(axis.profile_position()).unwrap();
    let mut enabled = pin!(axis.enable());
    let mut context = Context::from_waker(Waker::noop());
    assert!(enabled.as_mut().poll(&mut context).is_pending());
    lift.rig.run_for(200 * MS);
    assert_eq!(axis.status().state, State::OperationEnabled);
    let refused = lift.rig.until(pp.move_rel(1_000, SetPoint::new()));
    assert!(matches!(
        failure(refused.err().unwrap()),
        Failure::NotEnabled { .. }
    ));
    lift.rig.until(enabled).unwrap();
}

/// Each way down that the host leads: the drive carries the load until its brake is closed.
#[test]
fn a_load_is_on_its_brake_before_its_drive_loses_its_power() {
    for (way, brake) in [("bit 0", on_bit_0()), ("bit 16", on_bit_16())] {
        for moves in [false, true] {
            let begins = || {
                let mut lift = Lift::with(brake);
                lift.enables();
                let moving = moves.then(|| lift.sets_off());
                (lift, moving)
            };
            let (mut lift, _moving) = begins();
            let axis = lift.axis();
            lift.rig.until(axis.disable()).unwrap();
            assert!(lift.is_braked() && !lift.state().is_powered());
            lift.rig.run_for(500 * MS);
            lift.is_held(way);
            // And up again.
            lift.enables();
            lift.is_held(way);

            let (mut lift, _moving) = begins();
            let axis = lift.axis();
            let state = lift.rig.until(axis.quick_stop()).unwrap();
            assert_eq!(state, State::QuickStopActive);
            lift.rig.run_for(SET + 20 * MS);
            assert!(lift.is_braked());
            lift.rig.until(axis.disable()).unwrap();
            lift.rig.run_for(500 * MS);
            lift.is_held(way);

            let (mut lift, _moving) = begins();
            let axis = lift.axis();
            lift.rig.until(axis.stop()).unwrap();
            lift.rig.until(axis.enable()).unwrap();
            lift.is_held(way);

            let (mut lift, moving) = begins();
            // A handle that is dropped stops its axis.
            drop(moving);
            lift.rig.run_for(Duration::from_secs(1));
            lift.is_held(way);

            let (lift, _moving) = begins();
            let Lift { line, rig, seen } = lift;
            rig.shutdown();
            let seen = seen.lock().unwrap();
            assert!(seen.fallen <= WINDOW && !seen.dropped, "{way}: {seen:?}");
            assert!(line.segment().axis(0, 0).unwrap().is_braked());
        }
    }
}

#[test]
fn feedback_ends_the_wait_for_a_brake_that_closes() {
    let (brake, declared) = on_bit_0();
    let slow = OutputBrake::new(DigitalOutput::SetBrake, RELEASE, Duration::from_secs(2));
    let mut took = Vec::new();
    for declared in [declared, slow.feedback(DigitalInput::Bit(17)), slow] {
        let mut lift = Lift::with((brake, declared));
        lift.enables();
        lift.rig.run_for(500 * MS);
        let axis = lift.axis();
        let (time, result) = lift.takes(axis.disable());
        result.unwrap();
        lift.rig.run_for(500 * MS);
        lift.is_held("feedback");
        took.push(time);
    }
    assert!(took[1] < took[0] + 20 * MS, "{took:?}");
    assert!(took[2] > Duration::from_secs(2), "{took:?}");
}

/// A brake delays no stop: bit 2 is low in the next frame, while it opens, too.
#[test]
fn a_quick_stop_is_in_the_next_frame_whatever_the_brake_does() {
    for opens in [false, true] {
        let mut lift = Lift::with(on_bit_0());
        let axis = lift.axis();
        let mut context = Context::from_waker(Waker::noop());
        let mut enabled = pin!(axis.enable());
        if opens {
            assert!(enabled.as_mut().poll(&mut context).is_pending());
            lift.rig.run_for(150 * MS);
            assert_eq!(axis.status().state, State::OperationEnabled);
        } else {
            lift.rig.until(enabled.as_mut()).unwrap();
        }
        let _moving = (!opens).then(|| lift.sets_off());
        axis.stop_handle().quick_stop();
        assert!(lift.rig.bus.turn());
        let outputs = lift.line.segment().last_outputs(0).to_vec();
        let word = u16::from_le_bytes([outputs[0], outputs[1]]);
        assert_eq!(word & 0x0006, 0x0002, "{word:04X}");
        lift.rig.run_for(Duration::from_secs(1));
        assert!(lift.is_braked());
        lift.is_held("quick stop");
    }
}

/// The drive cuts its power at once, and the host closes the brake when it hears of it. So far the load falls.
#[test]
fn after_a_fault_the_host_closes_the_brake_as_soon_as_it_sees_it() {
    for moves in [false, true] {
        let mut lift = Lift::with(on_bit_0());
        lift.enables();
        let _moving = moves.then(|| lift.sets_off());
        lift.faults();
        while lift.state() != servocrab_sim::ds402::State::Fault {
            lift.rig.run_for(MS);
        }
        lift.rig.run_for(CLOSES_IN + 10 * MS);
        assert!(lift.is_braked());
        let fallen = lift.seen.lock().unwrap().fallen;
        assert!((10_000..60_000).contains(&fallen), "{fallen}");
        lift.rig.run_for(SET);
        // Of one that moved nobody knows where it would have stood.
        assert_eq!(lift.axis().status().slipped, !moves);
        let axis = lift.axis();
        lift.rig.until(axis.reset_fault()).unwrap();
        lift.enables();
        assert!(!axis.status().slipped);
    }
}

/// Its own reaction sets the output: less than the brake's time passes.
#[test]
fn where_the_drive_sets_the_output_itself_a_vertical_axis_may_have_its_brake_there() {
    let (brake, declared) = on_bit_0();
    let refused = Lift::start(servo(brake), masked(axis().vertical().brake(declared), 1));
    let text = refused.map(drop).unwrap_err().to_string();
    assert!(text.contains("set_by_drive"), "{text}");
    let opened_by = Opener::Output {
        bit: 0,
        level: false,
        closed_by_drive: true,
    };
    let brake = MachineBrake { opened_by, ..brake };
    let declared = axis().vertical().brake(declared.set_by_drive());
    let mut lift = Lift::start(servo(brake), masked(declared, 1)).unwrap();
    lift.enables();
    // Nobody sends anything any more: its watchdog expires, and quick stop holds it until its brake has closed.
    let end = lift.rig.bus.now() + Duration::from_secs(2);
    lift.line.segment().advance(end);
    assert!(lift.is_braked());
    lift.is_held("killed");
}

/// The drive stops the axis by 6007h, holds it by 605Ah, and the brake stays open until somebody closes it.
#[test]
fn after_a_loss_the_drive_holds_the_load_until_the_way_back_has_closed_the_brake() {
    for moves in [false, true] {
        let mut lift = Lift::with(on_bit_0());
        lift.enables();
        let _moving = moves.then(|| lift.sets_off());
        lift.line.segment().unplug(0);
        lift.rig.run_for(Duration::from_secs(1));
        lift.is_held("lost");
        assert!(!lift.is_braked());
        lift.line.segment().plug();
        lift.rig.run_for(100 * MS);
        lift.rig.recover(0).unwrap();
        let axis = lift.axis();
        lift.rig.run_for(SET + 50 * MS);
        assert!(lift.is_braked());
        lift.rig.until(axis.disable()).unwrap();
        lift.rig.run_for(500 * MS);
        lift.is_held("led back");
    }
}

#[test]
fn an_axis_whose_brake_does_not_hold_it_is_said_to_have_slipped() {
    let mut lift = Lift::with(on_bit_0());
    let events = lift.rig.net().events();
    lift.enables();
    lift.disturb(|disturbances| disturbances.brake_sticks = true);
    let axis = lift.axis();
    let result = lift.rig.until(axis.disable());
    let Failure::AxisSlipped { from, to } = failure(result.unwrap_err()) else {
        panic!("it has slipped");
    };
    assert!(from.abs() < 50 && to < from - 10, "{from} to {to}");
    lift.rig.run_for(100 * MS);
    assert!(axis.status().slipped);
    let event = events.try_next();
    assert!(
        matches!(&event, Some(NetworkEvent::AxisIncident(of)) if of.incident == Some(AxisIncident::Slipped)),
        "{event:?}"
    );
}

/// An axis that cannot be stopped loses its power at the deadline, whatever its brake does, and the brake closes then.
#[test]
fn the_deadline_of_a_stop_stays_where_a_brake_is_open() {
    let (brake, declared) = on_bit_0();
    let standstill = Duration::from_secs(1);
    let deadlines = Deadlines {
        standstill,
        ..Deadlines::default()
    };
    let lift = axis().brake(declared).deadlines(deadlines);
    let mut lift = Lift::start(servo(brake), masked(lift, 1)).unwrap();
    lift.enables();
    let _moving = lift.sets_off();
    lift.disturb(|disturbances| {
        disturbances.deaf_to_quick_stop = true;
        disturbances.deaf_to_halt = true;
    });
    let axis = lift.axis();
    let (took, result) = lift.takes(axis.disable());
    assert!(result.is_err());
    assert!(took < standstill + SET, "{took:?}");
    lift.rig.run_for(CLOSES_IN + 200 * MS);
    assert!(!lift.state().is_powered());
    assert!(lift.is_braked());
}

#[test]
fn a_brake_that_could_not_be_set_in_time_is_refused_when_the_axis_attaches() {
    let refused = |servo: Servo, drive: DriveConfig| {
        let Err(NetworkError::Drive { error, .. }) = Lift::start(servo, drive).map(drop) else {
            panic!("it has started");
        };
        *error
    };
    let (brake, declared) = on_bit_0();
    for option in [1, 2, 3, 4] {
        let servo = servo(brake).change(move |drive| drive.quick_stop_option = option);
        let error = refused(servo, masked(axis().brake(declared), 1));
        assert!(
            matches!(error, DriveFault::BrakeNeedsPower { option: is, .. } if is == option),
            "{error}"
        );
    }
    let error = refused(servo(brake), masked(axis().brake(declared), 0xFFFE));
    assert!(
        matches!(
            error,
            DriveFault::BrakeMasked {
                mask: 0xFFFE,
                bit: 1,
                ..
            }
        ),
        "{error}"
    );
    let (brake, declared) = on_bit_16();
    let opens = StartUpWrite::new(obj::DIGITAL_OUTPUTS, 0x0001_0001);
    let drive = masked(axis().brake(declared), 0x0001_0000).start_up(opens);
    let DriveFault::StartUp(error) = refused(servo(brake), drive) else {
        panic!("it would open the brake");
    };
    assert_eq!(error.fault, WriteFault::Brake);
}

// Inputs and outputs by name, beside the brake.

#[test]
fn the_axis_keeps_the_output_of_its_brake_to_itself_and_others_are_set_beside_it() {
    let mut lift = Lift::with(on_bit_16());
    lift.rig.run_for(20 * MS);
    let axis = lift.axis();
    let refused = axis.digital_output(DigitalOutput::Bit(16)).unwrap_err();
    assert!(matches!(refused.kind, AxisErrorKind::OwnedByAxis { .. }));
    let valve = axis.digital_output(DigitalOutput::Bit(20)).unwrap();
    assert_eq!(valve.get(), None);
    valve.set(true);
    lift.rig.run_for(5 * MS);
    let shown = |lift: &Lift| lift.line.segment().axis(0, 0).unwrap().get(0x60FE, 1);
    assert_eq!(
        shown(&lift),
        Some(0x0010_0001),
        "bit 0 stays as it goes out"
    );
    lift.enables();
    assert_eq!(shown(&lift), Some(0x0011_0001));
    // The whole object may be set, and the brake stays the axis'.
    axis.output(obj::DIGITAL_OUTPUTS).unwrap().set(0);
    lift.rig.run_for(5 * MS);
    assert_eq!(shown(&lift), Some(0x0001_0000));
    assert_eq!(valve.get(), Some(false));
    lift.is_held("set beside");
    assert!(matches!(
        axis.digital_output(DigitalOutput::Bit(32))
            .unwrap_err()
            .kind,
        AxisErrorKind::NoBit
    ));
}

#[test]
fn a_digital_input_is_read_by_its_name_and_says_when_it_is_stale() {
    let mut lift = Lift::start(
        Servo::generic(),
        drive(axis().map_input(obj::DIGITAL_INPUTS)),
    )
    .unwrap();
    let axis = lift.axis();
    let inputs = [
        (DigitalInput::NegativeLimitSwitch, 0),
        (DigitalInput::PositiveLimitSwitch, 1),
        (DigitalInput::HomeSwitch, 2),
        (DigitalInput::Interlock, 3),
        (DigitalInput::Bit(16), 16),
        (DigitalInput::Bit(31), 31),
    ];
    let bits = inputs.map(|(input, _)| axis.digital_input(input).unwrap());
    for (_, number) in inputs {
        let mut segment = lift.line.segment();
        segment
            .axis_mut(0, 0)
            .unwrap()
            .set_digital_inputs(1 << number);
        drop(segment);
        lift.rig.run_for(5 * MS);
        for ((_, other), bit) in inputs.iter().zip(&bits) {
            assert_eq!(bit.get(), Ok(*other == number));
        }
    }
    lift.line.segment().unplug(0);
    lift.rig.run_for(5 * MS);
    assert!(bits[5].get().is_err());
    assert!(bits[5].last().unwrap().value);
    assert!(axis.digital_input(DigitalInput::Bit(99)).is_err());
}

// A brake that the drive manages.

/// By any command, fault, loss, kill or recovery. What a drive without its supply does is the brake's alone.
#[test]
fn a_vertical_axis_with_a_drive_managed_brake_never_falls_further_than_its_window() {
    type Way = (&'static str, fn(&mut Lift));
    let ways: [Way; 15] = [
        ("disable", |lift| {
            let axis = lift.axis();
            lift.rig.until(axis.disable()).unwrap();
        }),
        ("stop", |lift| {
            let axis = lift.axis();
            lift.rig.until(axis.stop()).unwrap();
        }),
        ("quick stop", |lift| {
            let axis = lift.axis();
            lift.rig.until(axis.quick_stop()).unwrap();
        }),
        ("halt, then disable", |lift| {
            let axis = lift.axis();
            lift.rig.until(axis.halt()).unwrap();
            lift.rig.until(axis.disable()).unwrap();
        }),
        ("stop handle", |lift| lift.axis().stop_handle().stop()),
        ("liveness", |lift| {
            let liveness = lift.rig.net().liveness(50 * MS);
            lift.rig.run_for(300 * MS);
            drop(liveness);
        }),
        ("dropped handles", |_| {}),
        ("fault", |lift| {
            lift.faults();
            lift.rig.run_for(500 * MS);
            let axis = lift.axis();
            lift.rig.until(axis.reset_fault()).unwrap();
        }),
        ("lasting fault", |lift| {
            let mut segment = lift.line.segment();
            segment.axis_mut(0, 0).unwrap().inject_lasting_fault(0x2310);
            drop(segment);
            lift.rig.run_for(500 * MS);
        }),
        ("ignored quick stop", |lift| {
            let axis = lift.axis();
            lift.rig.until(axis.halt()).unwrap();
            lift.disturb(|disturbances| disturbances.deaf_to_quick_stop = true);
            let _ = lift.rig.until(axis.disable());
        }),
        ("lost frames", |lift| {
            lift.line.segment().unplug(0);
            lift.rig.run_for(Duration::from_secs(1));
            lift.line.segment().plug();
            lift.rig.run_for(100 * MS);
            lift.rig.recover(0).unwrap();
        }),
        ("left OP", |lift| {
            let mut segment = lift.line.segment();
            segment.device_mut(0).unwrap().fall_to_safe_op(0x001B);
            drop(segment);
            lift.rig.run_for(500 * MS);
            lift.rig.recover(0).unwrap();
        }),
        ("without power, and brought up", |lift| {
            let line = lift.line.clone();
            lift.rig.loses_power(&line, 0);
            lift.rig.recover(0).unwrap();
        }),
        ("killed", |lift| {
            // Nobody sends a frame any more.
            let later = lift.rig.bus.now() + Duration::from_secs(2);
            lift.line.segment().advance(later);
        }),
        ("shut down", |lift| {
            let net = lift.rig.net.take().unwrap();
            lift.rig.until(net.shutdown()).unwrap();
        }),
    ];
    for (way, leads) in ways {
        for moves in [false, true] {
            let mut lift = Lift::managed();
            lift.enables();
            let moving = moves.then(|| lift.sets_off());
            if way == "dropped handles" {
                drop(moving);
            } else {
                leads(&mut lift);
            }
            if lift.rig.net.is_some() && way != "killed" {
                lift.rig.run_for(Duration::from_secs(1));
            }
            let later = lift.rig.bus.now() + Duration::from_secs(1);
            lift.line.segment().advance(later);
            let name = format!("{way}, {}", if moves { "moving" } else { "standing" });
            lift.is_held(&name);
            let is_slipped = lift.rig.net.is_some() && lift.axis().status().slipped;
            assert!(!is_slipped, "{name}");
        }
    }
}
