//! Devices that are no drives: what a program reads of them and what reaches their outputs.

use std::{
    future::Future,
    pin::pin,
    task::{Context, Waker},
    time::Duration,
};

use servocrab::{
    Network, NetworkError, SetPoint,
    axis::{Sampled, Stale},
    bus::{
        AlState as State, BringUpStep, DevicePlace, DriveFault, Expected, Io, IoConfig,
        IoErrorKind, NetworkBuilder, NetworkEvent,
    },
    coe::obj,
    pdo_map::Direction,
};
use servocrab_sim::{AlState, Device, Segment, personality};

use crate::rig::{Line, Rig, akd2g, datagrams, is_write_to};

const CYCLE: Duration = Duration::from_millis(1);

fn buttons() -> IoConfig {
    IoConfig::new("buttons", Expected::new(0, 0x4449_3038))
}

fn valves() -> IoConfig {
    IoConfig::new("valves", Expected::new(0, 0x444F_3038))
}

/// A coupler, a drive, eight inputs, eight outputs.
fn line() -> Line {
    Line::new(
        Segment::new()
            .with(personality::coupler())
            .with(personality::akd2g())
            .with(personality::digital_inputs())
            .with(personality::digital_outputs()),
    )
}

fn network(line: &Line) -> NetworkBuilder {
    Network::builder()
        .link(line.wire())
        .drive(1, akd2g())
        .io(2, buttons())
        .io(3, valves())
}

fn io(rig: &Rig, name: &str) -> Io {
    rig.net().io(name).unwrap()
}

#[test]
fn inputs_of_a_device_that_was_set_to_init_are_old() {
    let line = line();
    let mut rig = Rig::start(network(&line)).unwrap();
    let first = io(&rig, "buttons").input::<bool>((0x6000, 1)).unwrap();
    rig.run_for(5 * CYCLE);
    assert_eq!(first.get(), Ok(false));
    line.segment()
        .device_mut(2)
        .unwrap()
        .fall_to(AlState::Init, 0);
    rig.run_for(250 * CYCLE);
    assert!(
        first.get().is_err_and(|old| old.age.is_some()),
        "{:?}",
        first.get()
    );
    let status = io(&rig, "buttons").status();
    assert!(!status.operational, "{status:?}");
    rig.shutdown();
}

#[test]
fn single_bits_are_read_and_written_by_name_and_by_index() {
    let line = line();
    let mut rig = Rig::start(network(&line)).unwrap();
    let states: Vec<_> = line
        .segment()
        .devices()
        .iter()
        .map(Device::al_state)
        .collect();
    assert_eq!(
        states,
        [AlState::PreOp, AlState::Op, AlState::Op, AlState::Op]
    );
    let at_once = io(&rig, "valves").status();
    assert!(at_once.operational && at_once.delivered, "{at_once:?}");
    let third = io(&rig, "buttons")
        .input::<bool>("Channel 3.Input")
        .unwrap();
    let fourth = io(&rig, "buttons").input::<bool>((0x6030, 1)).unwrap();
    let first = io(&rig, "valves")
        .output::<bool>("Channel 1.Output")
        .unwrap();
    let eighth = io(&rig, "valves").output::<bool>((0x7070, 1)).unwrap();
    assert_eq!((first.get(), eighth.get()), (None, None));
    rig.run_for(5 * CYCLE);
    assert_eq!(
        line.segment().device(3).unwrap().outputs(),
        [0],
        "until it is set"
    );
    assert_eq!((third.get(), fourth.get()), (Ok(false), Ok(false)));

    line.segment()
        .device_mut(2)
        .unwrap()
        .set_inputs(&[0b0000_0100]);
    eighth.set(true);
    rig.run_for(3 * CYCLE);
    assert_eq!((third.get(), fourth.get()), (Ok(true), Ok(false)));
    assert_eq!(line.segment().device(3).unwrap().outputs(), [0b1000_0000]);
    first.set(true);
    eighth.set(false);
    rig.run_for(3 * CYCLE);
    assert_eq!(line.segment().device(3).unwrap().outputs(), [0b0000_0001]);
    assert_eq!(eighth.get(), Some(false));
    let status = io(&rig, "valves").status();
    assert!(status.operational && status.delivered && !status.lost);
    assert_eq!(rig.net().statistics().wrong_working_counters, 0);
    rig.shutdown();
    assert_eq!(
        line.segment().device(3).unwrap().last_outputs(),
        [0],
        "at the end"
    );
    assert!(third.get().is_err() && first.get() == Some(true));
}

#[test]
fn no_inputs_are_taken_for_the_pattern_that_marks_silence() {
    let line = line();
    let mut rig = Rig::start(network(&line)).unwrap();
    let inputs = ["Channel 1.Input", "Channel 2.Input"];
    let inputs = inputs.map(|name| io(&rig, "buttons").input::<bool>(name).unwrap());
    for value in [0x55, 0xAA, 0x55, 0xFF, 0x00, 0xAA] {
        // The pattern alternates: they become so in a cycle of each kind, the third and the fourteenth.
        for cycles in [3, 4] {
            line.segment().device_mut(2).unwrap().set_inputs(&[0x0F]);
            rig.run_for(cycles * CYCLE);
            line.segment().device_mut(2).unwrap().set_inputs(&[value]);
            for cycle in 0..7 {
                rig.run_for(CYCLE);
                let age = inputs[0].last().map(|sampled| sampled.age);
                assert_eq!(age, Some(0), "{value:02X}h");
                if cycle >= 2 {
                    let seen = [inputs[0].get(), inputs[1].get()];
                    let bits = [Ok(value & 1 != 0), Ok(value & 2 != 0)];
                    assert_eq!(seen, bits, "{value:02X}h");
                }
            }
        }
    }
    assert_eq!(rig.net().statistics().wrong_working_counters, 0);
    rig.shutdown();
}

#[test]
fn inputs_that_do_not_come_any_more_are_stale_and_the_drive_goes_on() {
    let line = line();
    let mut rig = Rig::start(network(&line)).unwrap();
    let input = io(&rig, "buttons")
        .input::<bool>("Channel 1.Input")
        .unwrap();
    line.segment().device_mut(2).unwrap().set_inputs(&[1]);
    rig.run_for(5 * CYCLE);
    assert_eq!(
        input.last(),
        Some(Sampled {
            value: true,
            age: 0
        })
    );

    // Behind the drive.
    line.segment().unplug(2);
    rig.run_for(10 * CYCLE);
    let Err(Stale { age: Some(age) }) = input.get() else {
        panic!("{:?}", input.get());
    };
    assert!((9..=11).contains(&age), "{age}");
    assert_eq!(
        input.last().map(|last| last.value),
        Some(true),
        "the one before"
    );
    rig.run_for(200 * CYCLE);
    for name in ["buttons", "valves"] {
        let status = io(&rig, name).status();
        assert!(
            status.lost && !status.operational && !status.delivered,
            "{name}"
        );
    }
    let events = rig.net().events();
    let mut lost = Vec::new();
    while let Some(event) = events.try_next() {
        if let NetworkEvent::Lost(id) = event {
            lost.push(id.position);
        }
    }
    assert_eq!(lost, [2, 3]);
    // Nothing is expected of them, so that what the drive is told counts as delivered.
    let axis = rig.net().axis("x").unwrap();
    rig.until(axis.enable()).unwrap();

    line.segment().plug();
    rig.run_for(5 * CYCLE);
    assert_eq!(input.get(), Ok(true));
    rig.shutdown();
}

#[test]
fn the_devices_own_watchdog_ends_the_outputs_when_the_program_dies() {
    let line = line();
    let mut rig = Rig::start(network(&line)).unwrap();
    let valve = io(&rig, "valves")
        .output::<bool>("Channel 5.Output")
        .unwrap();
    valve.set(true);
    rig.run_for(5 * CYCLE);
    assert_eq!(line.segment().device(3).unwrap().outputs(), [0b0001_0000]);
    // Nobody turns the loop any more.
    let died = rig.bus.now();
    line.segment().advance(died + Duration::from_millis(90));
    assert_eq!(line.segment().device(3).unwrap().outputs(), [0b0001_0000]);
    line.segment().advance(died + Duration::from_millis(110));
    let segment = line.segment();
    let device = segment.device(3).unwrap();
    assert_eq!(device.outputs(), [0]);
    assert_eq!(
        (device.al_state(), device.al_status_code()),
        (AlState::SafeOp, 0x001B)
    );
}

#[test]
fn a_watchdog_that_cannot_be_armed_keeps_outputs_from_being_used() {
    let line = line();
    // The device takes the write to 0420h, but as zero.
    let spoiled = || {
        line.spoiled_wire(|frame| {
            for datagram in datagrams(frame) {
                if is_write_to(datagram, 0x0420) {
                    datagram[10..12].fill(0);
                }
            }
        })
    };
    let error = Rig::start(Network::builder().link(spoiled()).io(3, valves()))
        .err()
        .unwrap();
    let NetworkError::Drive { drive, step, error } = &error else {
        panic!("{error}");
    };
    assert_eq!((drive.position, *step), (3, BringUpStep::Watchdog));
    assert!(
        matches!(**error, DriveFault::OutputsUnwatched { .. }),
        "{error}"
    );
    // Whoever does without says so.
    let without = Network::builder()
        .link(spoiled())
        .io(3, valves())
        .without_watchdog("of the test");
    Rig::start(without).unwrap().shutdown();
}

#[test]
fn outputs_stay_until_the_axes_stand() {
    let line = line();
    let mut rig = Rig::start(network(&line)).unwrap();
    let brake = io(&rig, "valves")
        .output::<bool>("Channel 1.Output")
        .unwrap();
    brake.set(true);
    let axis = rig.net().axis("x").unwrap();
    rig.until(axis.enable()).unwrap();
    let mode = rig.until(axis.profile_position()).unwrap();
    let set_point = SetPoint::new()
        .velocity(500_000)
        .acceleration(500_000)
        .deceleration(500_000);
    let motion = rig.until(mode.move_abs(100_000_000, set_point)).unwrap();
    rig.run_for(1500 * CYCLE);
    let moving = |line: &Line| line.segment().axis(1, 0).unwrap().velocity().abs() > 0.0;
    assert!(moving(&line));

    let net = rig.net.take().unwrap();
    let mut over = pin!(net.shutdown());
    let _ = over.as_mut().poll(&mut Context::from_waker(Waker::noop()));
    let mut moved = 0;
    while line.segment().device(3).unwrap().outputs() == [1] {
        moved += u32::from(moving(&line));
        assert!(rig.bus.turn());
    }
    assert!(moved > 0, "the axis was stopped first");
    assert!(!moving(&line));
    drop(motion);
    rig.bus.run();
}

#[test]
fn what_a_device_with_coe_has_assigned_is_read_from_it() {
    // A drive that nobody moves, of which a program looks at the statusword.
    let line = Line::new(Segment::new().with(personality::generic()));
    let config = IoConfig::new("other", Expected::any());
    let mut rig = Rig::start(Network::builder().link(line.wire()).io(0, config)).unwrap();
    let other = io(&rig, "other");
    let inputs: Vec<_> = other
        .points()
        .iter()
        .filter(|point| point.direction == Direction::Inputs)
        .map(|point| (point.object.index, point.place.byte, point.place.bits))
        .collect();
    assert_eq!(
        inputs,
        [
            (0x6041, 0, 16),
            (0x6061, 2, 8),
            (0x6064, 3, 32),
            (0x606C, 7, 32)
        ]
    );
    let statusword = other.input::<u16>((0x6041, 0)).unwrap();
    let acceleration = other.output::<u32>((0x6083, 0)).unwrap();
    acceleration.set(0x0102_0304);
    rig.run_for(5 * CYCLE);
    assert_eq!(statusword.get().unwrap() & 0x4F, 0x40, "switch on disabled");
    let sdo = rig.net().sdo(0).unwrap();
    assert_eq!(
        rig.until(sdo.read(obj::PROFILE_ACCELERATION)).unwrap(),
        0x0102_0304
    );
    assert_eq!(rig.net().statistics().wrong_working_counters, 0);
    rig.shutdown();
}

#[test]
fn a_word_is_read_and_written_as_a_whole_and_a_network_needs_no_drive() {
    let line = Line::new(Segment::new().with(personality::io_terminal()));
    let config = IoConfig::new("io", Expected::new(0, 0x494F_3136));
    let place = DevicePlace::Identity {
        vendor: 0,
        product: 0x494F_3136,
        serial: None,
    };
    let mut rig = Rig::start(Network::builder().link(line.wire()).io(place, config)).unwrap();
    let terminal = io(&rig, "io");
    let input = terminal.input::<i16>("Inputs").unwrap();
    let wide = terminal.input::<u32>("Inputs").unwrap();
    terminal.output::<u16>("Outputs").unwrap().set(0xBEEF);
    line.segment()
        .device_mut(0)
        .unwrap()
        .set_inputs(&(-2i16).to_le_bytes());
    rig.run_for(3 * CYCLE);
    assert_eq!((input.get(), wide.get()), (Ok(-2), Ok(0xFFFE)));
    assert_eq!(line.segment().device(0).unwrap().outputs(), [0xEF, 0xBE]);
    rig.shutdown();
}

#[test]
fn what_is_not_there_or_of_another_length_is_refused_with_what_there_is() {
    let line = line();
    let rig = Rig::start(network(&line)).unwrap();
    let error = io(&rig, "buttons")
        .input::<bool>("Channel 9.Input")
        .unwrap_err();
    let IoErrorKind::NoPoint { there, .. } = &*error.kind else {
        panic!("{error}");
    };
    assert_eq!(
        (there.len(), there[7].name.as_str()),
        (8, "Channel 8.Input")
    );
    let error = io(&rig, "valves").output::<u8>((0x7000, 1)).unwrap_err();
    assert_eq!(
        error.to_string(),
        "io `valves`, drive 3 \"8 digital outputs\" (vendor 00000000h, product 444F3038h, revision 00000001h, serial \
         00000000h): `Channel 1.Output` 7000h:01 (1 bit) does not have the 8 of the type"
    );
    let error = io(&rig, "valves").input::<bool>((0x7000, 1)).unwrap_err();
    assert!(
        error
            .to_string()
            .ends_with("7000h:01 is not among its inputs: there are none"),
        "{error}"
    );
    assert!(matches!(
        rig.net().io("pumps"),
        Err(NetworkError::Declaration(_))
    ));
    rig.shutdown();

    let coupler = IoConfig::new("coupler", Expected::any());
    let error = Rig::start(Network::builder().link(line.wire()).io(0, coupler))
        .err()
        .unwrap();
    let NetworkError::Drive { error, step, .. } = &error else {
        panic!("{error}");
    };
    assert_eq!(*step, BringUpStep::Mapping);
    assert!(matches!(**error, DriveFault::NoProcessData));
    assert_ne!(BringUpStep::State(State::Op), *step);
}
