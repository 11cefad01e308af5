//! From power-on to OP, and each way in which that is refused.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use servocrab::{
    AxisConfig, DriveConfig, Failure, Network, NetworkError, Outcome, SetPoint,
    axis::Loss,
    bus::{BringUpStep, DriveFault, NetworkBuilder},
    coe::{Mappable, Object, ReadWrite, obj},
    drives,
    link::Wire,
    profile_position::{Limits, PositionRange},
};
use servocrab_sim::{AlState, Direction, Segment, personality};

use crate::rig::{Line, Rig, akd2g, datagrams, is_write_to, unhomed};

#[test]
fn both_axes_of_an_akd2g_come_up_and_move() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    assert_eq!(line.segment().devices()[0].al_state(), AlState::Op);
    for (number, name) in ["x", "y"].into_iter().enumerate() {
        let moved = rig.moved(name, 10_000);
        assert!(matches!(moved, Outcome::Reached { position } if (position - 10_000).abs() < 20));
        let segment = line.segment();
        let executed = segment.axis(0, number).unwrap().ledger();
        assert_eq!(executed.len(), 1, "one set-point was executed");
        assert_eq!(executed[0].value, 10_000);
    }
    rig.shutdown();
    assert_eq!(line.segment().devices()[0].al_state(), AlState::Init);
}

#[test]
fn a_coupler_and_a_terminal_in_the_line_are_left_in_preop() {
    let line = Line::new(
        Segment::new()
            .with(personality::coupler())
            .with(personality::io_terminal())
            .with(personality::akd2g()),
    );
    let rig = Rig::start(Network::builder().link(line.wire()).drive(2, akd2g())).unwrap();
    let states: Vec<_> = line
        .segment()
        .devices()
        .iter()
        .map(servocrab_sim::Device::al_state)
        .collect();
    assert_eq!(states, [AlState::PreOp, AlState::PreOp, AlState::Op]);
    rig.shutdown();
}

#[test]
fn a_drive_without_lrw_exchanges_by_lrd_and_lwr() {
    let drive = personality::Servo::akd2g().without_lrw().build();
    let line = Line::new(Segment::new().with(drive).with(personality::akd2g()));
    let second = unhomed(drives::akd2g(), &["z"]);
    let builder = Network::builder()
        .link(line.wire())
        .drive(0, akd2g())
        .drive(1, second);
    let mut rig = Rig::start(builder).unwrap();
    for name in ["y", "z"] {
        let axis = rig.net().axis(name).unwrap();
        rig.until(axis.enable()).unwrap();
    }
    assert_eq!(rig.net().statistics().wrong_working_counters, 0);
    rig.shutdown();
}

#[test]
fn an_object_that_was_mapped_beside_the_others_is_read_through_its_field() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let drive = akd2g().change_axis("y", |axis| axis.map_input(obj::FOLLOWING_ERROR_ACTUAL));
    let rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
    let axis = rig.net().axis("y").unwrap();
    let field = axis.input(obj::FOLLOWING_ERROR_ACTUAL).unwrap();
    assert_eq!(field.get(), Ok(0));
    assert_eq!(axis.status().following_error, Some(0));
    assert_eq!(rig.net().axis("x").unwrap().status().following_error, None);
    assert!(
        rig.net()
            .axis("x")
            .unwrap()
            .input(obj::FOLLOWING_ERROR_ACTUAL)
            .is_err()
    );
    rig.shutdown();
}

#[test]
fn pitfall_37_process_data_are_what_coe_says_and_not_what_the_sii_says() {
    // As on a real AKD the SII assigns other PDOs than the object dictionary at power-up; the program's are a third.
    let drive = personality::Servo::generic()
        .assigned_at_power_up(&[0x1601, 0x1A01])
        .build();
    let by_sii = drive.description().process_data_bytes(Direction::Outputs);
    let line = Line::new(Segment::new().with(drive));
    let config = DriveConfig::new(drives::generic()).axis(
        AxisConfig::new("x")
            .referencing(servocrab::Referencing::UnreferencedMovesAllowed)
            .map_output(obj::QUICK_STOP_DECELERATION)
            .map_input(obj::FOLLOWING_ERROR_ACTUAL),
    );
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, config)).unwrap();
    let moved = rig.moved("x", 10_000);
    assert!(matches!(moved, Outcome::Reached { .. }), "{moved:?}");
    assert_eq!((by_sii, line.segment().last_outputs(0).len()), (19, 23));
}

#[test]
fn a_working_counter_beyond_what_a_line_can_have_is_believed_by_nobody() {
    for got in [0x1001_u16, 0xFFFF] {
        let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame, _| {
            frame[6] |= 2;
            // Behind the tag and the one byte of the BRD that counts.
            frame[43..45].copy_from_slice(&got.to_le_bytes());
            true
        });
        let error = refused(Network::builder().link(wire).drive(0, akd2g()));
        let NetworkError::TooManySubDevices { most, got: told } = error else {
            panic!("{error}")
        };
        assert_eq!((most, told), (0x1000, got));
    }
}

#[test]
fn a_refused_mapping_names_the_entry_and_the_abort_code() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let unknown: Object<u32, ReadWrite> =
        Object::new(0x2FFE, 7, "nothing").mappable(Mappable::INPUTS);
    let drive = akd2g().change_axis("x", |axis| axis.map_input(unknown));
    let error = refused(Network::builder().link(line.wire()).drive(0, drive));
    let text = error.to_string();
    for part in ["2FFEh:07", "1A00h:05", "h)"] {
        assert!(text.contains(part), "{part} is not in: {text}");
    }
    let (BringUpStep::Mapping, DriveFault::MappingRefused { step, error }) = fault(error) else {
        panic!("another fault: {text}");
    };
    assert_eq!((step.object.index, step.object.subindex), (0x1A00, 5));
    assert!(error.abort_code().is_some(), "{text}");
}

#[test]
fn a_watchdog_that_cannot_be_armed_is_refused_unless_opted_out_in_words() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    // The drive takes the write to 0420h, but as zero.
    let spoiled = || {
        line.spoiled_wire(|frame| {
            for datagram in datagrams(frame) {
                if is_write_to(datagram, 0x0420) {
                    datagram[10] = 0;
                    datagram[11] = 0;
                }
            }
        })
    };
    let error = refused(Network::builder().link(spoiled()).drive(0, akd2g()));
    assert!(error.to_string().contains("without_watchdog"), "{error}");
    assert!(matches!(
        fault(error),
        (BringUpStep::Watchdog, DriveFault::WatchdogUnarmed { expected: 1000, got }) if got.ticks == 0
    ));
    let builder = Network::builder()
        .link(spoiled())
        .without_watchdog("nothing is mounted on the motors")
        .drive(0, akd2g());
    Rig::start(builder).unwrap().shutdown();
}

/// The second network's clock begins at zero again: for the drive, its EEPROM is busy with what the first one asked for.
#[test]
fn an_eeprom_that_is_busy_from_before_is_waited_for() {
    let mut device = personality::akd2g();
    device.set_sii_delay(Duration::from_micros(100));
    let line = Line::new(Segment::new().with(device));
    for _ in 0..2 {
        let builder = Network::builder().link(line.wire()).drive(0, akd2g());
        Rig::start(builder).unwrap().shutdown();
    }
}

#[test]
fn the_watchdog_is_armed_and_an_axis_stops_when_the_process_data_stop() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let sdo = rig.net().sdo(0).unwrap();
    for index in [0x6007, 0x6807] {
        assert_eq!(
            rig.until(sdo.read_bytes(index, 0)).unwrap(),
            [3, 0],
            "{index:04X}h"
        );
    }
    let now = rig.bus.now();
    line.segment().advance(now + Duration::from_millis(95));
    assert_eq!(line.segment().devices()[0].al_state(), AlState::Op);
    line.segment().advance(now + Duration::from_millis(105));
    let segment = line.segment();
    assert_eq!(segment.devices()[0].al_state(), AlState::SafeOp);
    assert_eq!(segment.devices()[0].al_status_code(), 0x001B);
}

#[test]
fn a_drive_that_left_op_by_its_watchdog_is_named_as_that_by_every_command_of_its_axes() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    rig.moved("x", 1_000);
    let (mode, motion) = rig.starts_a_long_move("y");
    // No frame for longer than the watchdog's time.
    line.segment().unplug(0);
    rig.run_for(Duration::from_millis(150));
    line.segment().plug();
    rig.run_for(Duration::from_secs(1));
    let by_watchdog = |error: servocrab::AxisError| {
        let text = error.to_string();
        assert!(
            matches!(error.failure(), Some(Failure::LeftOp { code: 0x001B, .. })),
            "{text}"
        );
        assert!(text.contains("001Bh"), "{text}");
        assert!(
            text.contains("its process-data watchdog has expired"),
            "{text}"
        );
    };
    // That ended when nothing answered any more.
    assert!(rig.until(motion.done()).is_err());
    let axis = rig.net().axis("x").unwrap();
    by_watchdog(rig.until(axis.enable()).unwrap_err());
    by_watchdog(rig.until(axis.reset_fault()).unwrap_err());
    by_watchdog(rig.until(mode.move_abs(0, SetPoint::new())).unwrap_err());
    let net = rig.net.take().unwrap();
    rig.until(net.recover(0)).unwrap();
    rig.net = Some(net);
    rig.moved("x", 2_000);
    rig.shutdown();
}

#[test]
fn a_watchdog_that_is_not_longer_than_a_cycle_is_refused_before_anything_is_sent() {
    let frames = Arc::new(Mutex::new(0));
    for (cycle, watchdog, is_right) in [
        (1_000, 1_000, false),
        (1_000, 500, false),
        (2_000, 2_100, true),
    ] {
        let line = Line::new(Segment::new().with(personality::akd2g()));
        let counted = Arc::clone(&frames);
        let wire = line.spoiled_wire(move |_| *counted.lock().unwrap() += 1);
        let builder = Network::builder().link(wire).drive(0, akd2g());
        let builder = builder
            .cycle(Duration::from_micros(cycle))
            .watchdog(Duration::from_micros(watchdog));
        if is_right {
            Rig::start(builder).unwrap().shutdown();
            continue;
        }
        let error = refused(builder);
        assert!(matches!(error, NetworkError::Setting(_)), "{error}");
        assert!(error.to_string().contains("at least 1.1ms"), "{error}");
        assert_eq!(*frames.lock().unwrap(), 0);
    }
}

#[test]
fn mistakes_of_the_declaration_are_named_before_anything_is_sent() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let text = |builder: NetworkBuilder| refused(builder).to_string();
    let net = || Network::builder().link(line.wire());
    assert!(text(net()).contains("no drive"));
    assert!(text(net().drive(0, akd2g()).drive(1, akd2g())).contains("two axes are named `x`"));
    assert!(text(net().drive(0, akd2g().axis("z"))).contains("3 axes were named"));
    let unnamed = akd2g().change_axis("z", |axis| axis.map_input(obj::DIGITAL_INPUTS));
    assert!(text(net().drive(0, unnamed)).contains("`z` is no axis"));
    assert!(text(net().cycle(Duration::ZERO).drive(0, akd2g())).contains("cycle"));
    for (software, position_range) in [
        (Some((1_000, -1_000)), None),
        (Some((0, 0)), None),
        (None, Some((1_000, -1_000))),
    ] {
        let range = |(min, max)| PositionRange { min, max };
        let limits = Limits {
            software: software.map(range),
            position_range: position_range.map(range),
            ..Limits::trust_drive()
        };
        let reversed = akd2g().change_axis("y", |axis| axis.limits(limits));
        assert!(
            text(net().drive(0, reversed)).contains("axis `y`"),
            "{limits:?}"
        );
    }
    for (stale_cycles, undelivered_cycles) in [(0, 10), (20, 10), (u32::MAX, u32::MAX)] {
        let loss = Loss {
            stale_cycles,
            undelivered_cycles,
        };
        assert!(
            text(net().drive(0, akd2g().change_axis("x", |axis| axis.loss(loss))))
                .contains("silent drive"),
            "{loss:?}"
        );
    }
    assert!(text(Network::builder().drive(0, akd2g())).contains("no link"));
    assert_eq!(line.segment().devices()[0].al_state(), AlState::Init);
}

fn refused(builder: NetworkBuilder) -> NetworkError {
    match Rig::start(builder) {
        Ok(_) => panic!("it was started"),
        Err(error) => error,
    }
}

fn fault(error: NetworkError) -> (BringUpStep, DriveFault) {
    match error {
        NetworkError::Drive { step, error, .. } => (step, *error),
        other => panic!("no fault of a drive: {other}"),
    }
}

#[test]
fn a_bring_up_tells_each_step_of_each_drive_once_and_in_order() {
    /// Position, step, steps done, steps in all.
    type Told = (u16, String, usize, usize);
    let segment = Segment::new()
        .with(personality::akd2g())
        .with(personality::coupler())
        .with(personality::generic());
    let line = Line::new(segment);
    let told: Arc<Mutex<Vec<Told>>> = Arc::default();
    let heard = Arc::clone(&told);
    let builder = Network::builder()
        .link(line.wire())
        .drive(0, akd2g())
        .drive(2, DriveConfig::new(drives::generic()).axis("z"))
        .on_progress(move |at| {
            let step = at.step.to_string();
            let place = (at.drive.position, step, at.done, at.total);
            heard.lock().unwrap().push(place);
        });
    Rig::start(builder).unwrap().shutdown();
    let told = told.lock().unwrap();
    let counted: Vec<_> = told
        .iter()
        .map(|&(.., done, total)| (done, total))
        .collect();
    assert_eq!(counted, (1..=14).map(|done| (done, 14)).collect::<Vec<_>>());
    let steps = |position| -> Vec<&str> {
        let of_drive = told.iter().filter(|(of, ..)| *of == position);
        of_drive.map(|(_, step, ..)| step.as_str()).collect()
    };
    assert_eq!(steps(0), steps(2));
    assert_eq!(steps(0)[0], "checking its identity");
    assert_eq!(
        steps(0)[4..],
        [
            "bringing it into SAFEOP",
            "reading its parameters",
            "bringing it into OP"
        ]
    );
}
