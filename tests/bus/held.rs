//! What a drive holds of its stops and of its velocity: read when the axis attaches, shown with the axis, and obeyed.

use std::{
    future::Future,
    pin::pin,
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    Axis, DriveConfig, Failure, Move, Network, NetworkError, ProfilePosition,
    axis::Unsupported,
    bus::DriveFault,
    coe::obj,
    drives::{self, DriveDescription},
    ds402::{FollowingErrorWindow, State, StopOptions, VelocityWindows},
};
use servocrab_sim::{Segment, ds402, personality::Servo};

use crate::rig::{Line, Rig, unhomed};

const MS: Duration = Duration::from_millis(1);

/// The simulated device, and the library's description of it.
type Drive = (fn() -> Servo, fn() -> DriveDescription);

/// Drives that have all these objects.
const DRIVES: [Drive; 3] = [
    (Servo::akd2g, drives::akd2g),
    (Servo::sigma7, drives::sigma7),
    (Servo::generic, drives::generic),
];

/// Bit 8.
const HALT: u16 = 0x0100;

/// A drive that holds these values, and how the program wants it.
fn line((servo, description): Drive, held: &[(u16, i64)]) -> (Line, DriveConfig) {
    let mut segment = Segment::new().with(servo().build());
    for (index, value) in held {
        let axis = segment.axis_mut(0, 0).unwrap();
        axis.set(*index, 0, *value).unwrap();
    }
    let drive = unhomed(description(), &["x"])
        .change_axis("x", |axis| axis.map_output(obj::TARGET_VELOCITY));
    let drive = if held.iter().any(|(index, _)| *index == 0x6065) {
        drive.change_axis("x", |axis| axis.following_error_warning(4_000.0))
    } else {
        drive
    };
    (Line::new(segment), drive)
}

fn start((line, drive): (Line, DriveConfig)) -> (Line, Rig, Axis) {
    let rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
    let axis = rig.net().axis("x").unwrap();
    (line, rig, axis)
}

/// On its way, and what keeps it so.
fn moving(drive: Drive, held: &[(u16, i64)]) -> (Line, Rig, Axis, (ProfilePosition, Move)) {
    let (line, mut rig, axis) = start(line(drive, held));
    let kept = rig.starts_a_long_move("x");
    rig.run_for(600 * MS);
    assert!(line.segment().axis(0, 0).unwrap().velocity() > 5_000.0);
    (line, rig, axis, kept)
}

/// Turns the loop until the future is ready, and looks at the drive after each cycle.
fn watched<T>(
    line: &Line,
    rig: &mut Rig,
    future: impl Future<Output = T>,
    mut look: impl FnMut(&ds402::Axis),
) -> T {
    let mut future = pin!(future);
    loop {
        let mut context = Context::from_waker(Waker::noop());
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
        assert!(rig.bus.turn());
        look(line.segment().axis(0, 0).unwrap());
    }
}

#[test]
fn what_the_drive_holds_is_shown_with_the_axis() {
    for drive in DRIVES {
        let held = [
            (0x605A, 6),
            (0x605B, 1),
            (0x605C, 0),
            (0x605D, 2),
            (0x605E, 1),
            (0x6065, 5_000),
            (0x6066, 15),
            (0x606D, 11),
            (0x606E, 12),
            (0x606F, 65_535),
            (0x6070, 14),
        ];
        let (_line, rig, axis) = start(line(drive, &held));
        let shown = axis.drive_settings();
        assert_eq!(shown.quick_stop.0, 6);
        let stops = StopOptions {
            shutdown: Some(1),
            disable_operation: Some(0),
            halt: Some(2),
            fault_reaction: Some(1),
        };
        assert_eq!(shown.stop_options, stops);
        let windows = VelocityWindows {
            window: Some(11),
            window_ms: Some(12),
            threshold: Some(65_535),
            threshold_ms: Some(14),
        };
        assert_eq!(shown.velocity_windows, windows);
        let lag = FollowingErrorWindow {
            window: Some(5_000),
            time_out_ms: Some(15),
        };
        assert_eq!(shown.following_error_window, lag);
        rig.shutdown();
    }
}

#[test]
fn a_drive_without_the_objects_attaches_and_shows_none() {
    let without = |servo: Servo| {
        servo.change(|drive| {
            drive.without = &[
                0x605B, 0x605C, 0x605D, 0x605E, 0x606D, 0x606E, 0x606F, 0x6070,
            ];
        })
    };
    let segment = Segment::new().with(without(Servo::generic()).build());
    let line = Line::new(segment);
    let (line, mut rig, axis) = start((line, unhomed(drives::generic(), &["x"])));
    let shown = axis.drive_settings();
    assert_eq!(shown.stop_options, StopOptions::default());
    assert_eq!(shown.velocity_windows, VelocityWindows::default());
    rig.moves_each(&line, &["x"]);
    rig.shutdown();
}

#[test]
fn a_drive_that_would_coast_at_quick_stop_attaches_only_where_that_is_accepted() {
    for drive in DRIVES {
        let (held, config) = line(drive, &[(0x605A, 0)]);
        let refused = Rig::start(Network::builder().link(held.wire()).drive(0, config));
        let Err(NetworkError::Drive { error, .. }) = refused.map(drop) else {
            panic!("it has attached");
        };
        assert!(
            matches!(&*error, DriveFault::QuickStopCoasts { axis } if axis == "x"),
            "{error}"
        );
        assert!(error.to_string().contains("605Ah"), "{error}");
        let (held, config) = line(drive, &[(0x605A, 0)]);
        let (_line, rig, axis) = start((
            held,
            config.change_axis("x", servocrab::AxisConfig::coast_at_quick_stop),
        ));
        assert_eq!(axis.drive_settings().quick_stop.0, 0);
        rig.shutdown();
    }
}

#[test]
fn where_605dh_is_0_bit_8_is_never_sent_and_a_stop_brakes() {
    for drive in DRIVES {
        let (line, mut rig, axis, _kept) = moving(drive, &[(0x605D, 0)]);
        let refused = rig.until(axis.halt()).unwrap_err();
        assert_eq!(
            refused.failure(),
            Some(Failure::Unsupported(Unsupported::Halt))
        );
        rig.run_for(10 * MS);
        assert_eq!(axis.status().state, State::OperationEnabled);
        let mut braked = false;
        watched(&line, &mut rig, axis.stop(), |drive| {
            assert_eq!(drive.controlword() & HALT, 0);
            braked |= drive.state() == ds402::State::QuickStopActive && !drive.stands();
        })
        .unwrap();
        assert!(braked && line.segment().axis(0, 0).unwrap().stands());
        rig.shutdown();
    }
}

#[test]
fn whatever_605bh_and_605ch_say_the_power_goes_when_the_axis_stands() {
    for drive in DRIVES {
        for held in [[(0x605B, 0), (0x605C, 0)], [(0x605B, 1), (0x605C, 1)]] {
            let (line, mut rig, axis, _kept) = moving(drive, &held);
            watched(&line, &mut rig, axis.disable(), |drive| {
                let powered = matches!(
                    drive.state(),
                    ds402::State::OperationEnabled | ds402::State::QuickStopActive
                );
                let slow = drive.velocity().abs() < f64::from(drive.plant().standstill_velocity);
                assert!(powered || slow, "{held:?}: {}", drive.velocity());
            })
            .unwrap();
            rig.shutdown();
        }
    }
}

#[test]
fn a_stop_in_a_fault_reaction_of_any_605eh_ends_when_the_axis_stands() {
    for drive in DRIVES {
        for option in 0..=2 {
            let (line, mut rig, axis, _kept) = moving(drive, &[(0x605E, option)]);
            line.segment().axis_mut(0, 0).unwrap().inject_fault(0x8611);
            rig.run_for(2 * MS);
            rig.until(axis.stop()).unwrap();
            assert!(line.segment().axis(0, 0).unwrap().stands(), "{option}");
            rig.until(axis.reset_fault()).unwrap();
            rig.shutdown();
        }
    }
}
