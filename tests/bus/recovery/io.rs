//! Devices that are no drives.

use std::time::Duration;

use servocrab::{
    IoOutput, Network,
    bus::{Expected, IoConfig, NetworkBuilder, Recovered},
};
use servocrab_sim::{AlState, Segment, personality};

use super::{MS, unhomed};
use crate::rig::{Line, Rig};

const VALVES: usize = 2;

/// A drive, eight inputs, eight outputs, and another drive behind them.
fn line() -> (Line, NetworkBuilder) {
    let line = Line::new(
        Segment::new()
            .with(personality::akd2g())
            .with(personality::digital_inputs())
            .with(personality::digital_outputs())
            .with(personality::akd2g()),
    );
    let buttons = IoConfig::new("buttons", Expected::new(0, 0x4449_3038));
    let valves = IoConfig::new("valves", Expected::new(0, 0x444F_3038));
    let builder = Network::builder()
        .link(line.wire())
        .drive(0, unhomed(servocrab::drives::akd2g(), &["x"]))
        .io(1, buttons)
        .io(2, valves)
        .drive(3, unhomed(servocrab::drives::akd2g(), &["y"]));
    (line, builder)
}

/// The line in OP with the first of its valves open, and that valve and the second one.
fn first_valve_open() -> (Line, Rig, IoOutput<bool>, IoOutput<bool>) {
    let (line, builder) = line();
    let mut rig = Rig::start(builder).unwrap();
    let (first, second) = {
        let valves = rig.net().io("valves").unwrap();
        let output = |name| valves.output::<bool>(name).unwrap();
        (output("Channel 1.Output"), output("Channel 2.Output"))
    };
    first.set(true);
    rig.run_for(5 * MS);
    assert_eq!(outputs(&line), 1);
    (line, rig, first, second)
}

fn outputs(line: &Line) -> u8 {
    let segment = line.segment();
    let outputs = segment.device(VALVES).unwrap().outputs();
    // None before its first cycle in OP.
    outputs.first().copied().unwrap_or(0)
}

/// That no output is on for this long.
fn stays_off(line: &Line, rig: &mut Rig, time: Duration) {
    let end = rig.bus.now() + time;
    while rig.bus.now() < end {
        assert!(rig.bus.turn());
        assert_eq!(outputs(line), 0);
    }
}

#[test]
fn outputs_of_a_device_that_fell_are_0_when_it_is_back_until_they_are_set_again() {
    let (line, mut rig, first, second) = first_valve_open();
    let mut segment = line.segment();
    segment.device_mut(VALVES).unwrap().fall_to_safe_op(0x001B);
    drop(segment);
    rig.run_for(50 * MS);
    // What is set while it is out of OP is as old as the rest.
    second.set(true);
    rig.run_for(50 * MS);
    let recovered = rig.recover(2).unwrap();
    assert!(
        matches!(recovered, Recovered::FromSafeOp { .. }),
        "{recovered}"
    );
    assert_eq!((first.get(), second.get()), (None, None));
    stays_off(&line, &mut rig, 100 * MS);
    assert!(rig.net().io("valves").unwrap().status().operational);
    second.set(true);
    rig.run_for(5 * MS);
    assert_eq!(outputs(&line), 2);
    rig.shutdown();
}

#[test]
fn devices_that_were_without_power_are_brought_up_one_by_one_and_nothing_is_switched_on_by_it() {
    let (line, mut rig, valve, _) = first_valve_open();
    let button = {
        let buttons = rig.net().io("buttons").unwrap();
        buttons.input::<bool>("Channel 3.Input").unwrap()
    };
    for position in [1, VALVES] {
        let mut segment = line.segment();
        segment.device_mut(position).unwrap().power_off();
    }
    rig.run_for(300 * MS);
    let now = rig.bus.now();
    for position in [1, VALVES] {
        let mut segment = line.segment();
        segment.device_mut(position).unwrap().power_on(now);
    }
    rig.run_for(50 * MS);
    assert!(button.get().is_err(), "nothing has come of it");
    let before = rig.net().drive_statistics()[0].clone();
    for position in [1, 2] {
        let recovered = rig.recover(position).unwrap();
        let anew = Recovered::BroughtUp {
            position,
            from: None,
        };
        assert_eq!(recovered, anew);
        stays_off(&line, &mut rig, 50 * MS);
    }
    let recovered = rig.recover(3).unwrap();
    assert!(
        matches!(recovered, Recovered::FromSafeOp { .. }),
        "{recovered}"
    );
    assert_eq!(
        rig.net().drive_statistics()[0],
        before,
        "of the first drive"
    );
    let mut segment = line.segment();
    segment.device_mut(1).unwrap().set_inputs(&[0b0000_0100]);
    drop(segment);
    valve.set(true);
    rig.run_for(5 * MS);
    assert_eq!(button.get(), Ok(true));
    assert_eq!(outputs(&line), 1);
    let states = line
        .segment()
        .devices()
        .iter()
        .map(servocrab_sim::Device::al_state)
        .collect::<Vec<_>>();
    assert_eq!(states, [AlState::Op; 4]);
    rig.shutdown();
}
