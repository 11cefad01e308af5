//! What a recorder shows of every cycle, against the black box and the simulated devices.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use servocrab::{
    AxisConfig, DriveConfig, Network, NetworkError, SetPoint,
    bus::{Capture, Expected, IoConfig, RecordedCycles, Signal, Trigger, TriggerCondition},
    coe::obj,
    drives,
    link::Fate,
    units::{Mm, Ratio, Scale},
};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig, akd2g, is_cyclic, turn_until};

const MS: Duration = Duration::from_millis(1);

fn line() -> Line {
    Line::new(
        Segment::new()
            .with(personality::akd2g())
            .with(personality::digital_inputs()),
    )
}

fn start(line: &Line) -> Rig {
    let buttons = IoConfig::new("buttons", Expected::new(0, 0x4449_3038));
    let builder = Network::builder().link(line.wire());
    Rig::start(builder.drive(0, akd2g()).io(1, buttons)).unwrap()
}

fn run(rig: &mut Rig, cycles: u32) {
    let until = rig.bus.now() + MS * cycles;
    while rig.bus.now() < until {
        assert!(rig.bus.turn());
    }
}

fn signals<const N: usize>(texts: [&str; N]) -> [Signal; N] {
    texts.map(|text| text.parse().unwrap())
}

fn numbers(read: &RecordedCycles) -> Vec<u64> {
    read.cycles.iter().map(|cycle| cycle.number).collect()
}

#[test]
fn every_cycle_is_shown_once_as_the_black_box_has_it() {
    let line = line();
    let mut rig = start(&line);
    let axis = rig.net().axis("x").unwrap();
    rig.until(axis.enable()).unwrap();
    let wanted = signals(["x.position", "x.controlword", "x.target", "x.state"]);
    let mut recorder = rig.net().recorder(wanted).unwrap();
    let mode = rig.until(axis.profile_position()).unwrap();
    let fast = SetPoint::new()
        .velocity(100_000)
        .acceleration(1_000_000)
        .deceleration(1_000_000);
    let _motion = rig.until(mode.move_abs(5_000, fast)).unwrap();
    let mut cycles = Vec::new();
    for _ in 0..20 {
        run(&mut rig, 17);
        let read = recorder.read().unwrap();
        assert_eq!(read.lost, 0);
        cycles.extend(read.cycles);
    }
    let net = rig.net.take().unwrap();
    let black_box = turn_until(&mut rig.bus, net.black_box("x")).unwrap();
    for pair in cycles.windows(2) {
        assert_eq!(pair[1].number, pair[0].number + 1);
    }
    let mut compared = 0;
    for recorded in &black_box.cycles {
        let Some(shown) = cycles.iter().find(|cycle| cycle.number == recorded.number) else {
            continue;
        };
        let inputs = recorded.inputs.unwrap();
        assert_eq!(shown.time, recorded.time);
        let expected = [
            f64::from(inputs.position),
            f64::from(recorded.controlword.bits()),
            f64::from(recorded.target),
            4.0,
        ];
        assert_eq!(shown.values, expected.map(Some));
        compared += 1;
    }
    assert!(compared > 300, "{compared}");
    assert!(cycles.iter().any(|cycle| cycle.values[0] > Some(2_000.0)));
    rig.net = Some(net);
    rig.shutdown();
}

#[test]
fn cycles_that_were_overwritten_before_they_were_read_are_counted() {
    let line = line();
    let mut rig = start(&line);
    let mut recorder = rig.net().recorder(signals(["x.position"])).unwrap();
    run(&mut rig, 10);
    let first = recorder.read().unwrap();
    run(&mut rig, 3_000);
    let late = recorder.read().unwrap();
    let (before, next) = (numbers(&first), numbers(&late));
    let missing = next[0] - before[before.len() - 1] - 1;
    assert!((2_000..3_000).contains(&missing), "{missing}");
    assert_eq!(late.lost, missing);
    run(&mut rig, 10);
    let then = recorder.read().unwrap();
    assert_eq!((then.lost, then.cycles.len()), (0, 10));
    assert_eq!(recorder.read(), Some(RecordedCycles::default()));
    rig.shutdown();
}

#[test]
fn what_did_not_come_back_has_no_value_and_what_was_sent_has_one() {
    let line = line();
    let mut cyclic = 0;
    let wire = line.wire_with(move |_, frame| {
        cyclic += u32::from(is_cyclic(frame));
        if is_cyclic(frame) && cyclic > 100 && cyclic % 5 == 0 {
            Fate::LoseAnswer
        } else {
            Fate::Deliver
        }
    });
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    run(&mut rig, 150);
    let wanted = signals(["y.statusword", "y.controlword", "lateness"]);
    let mut recorder = rig.net().recorder(wanted).unwrap();
    run(&mut rig, 100);
    let read = recorder.read().unwrap();
    let silent = read.cycles.iter().filter(|cycle| cycle.values[0].is_none());
    assert_eq!(silent.count(), 20);
    let sent =
        |cycle: &servocrab::bus::RecordedValues| cycle.values[1..].iter().all(Option::is_some);
    assert!(read.cycles.iter().all(sent));
    rig.shutdown();
}

#[test]
fn values_are_in_the_unit_of_the_axis_and_those_of_a_device_are_not() {
    let line = line();
    let scale = Scale::counts_per_unit(Ratio::new(1_000, 1).unwrap());
    let drive = DriveConfig::new(drives::akd2g()).axis(AxisConfig::new("x").unit::<Mm>(scale));
    let builder = Network::builder().link(line.wire()).drive(0, drive);
    let mut rig = Rig::start(builder).unwrap();
    let wanted = [
        Signal::axis("x", obj::POSITION_ACTUAL),
        Signal::device(0, obj::POSITION_ACTUAL),
        Signal::axis("x", obj::VELOCITY_ACTUAL),
    ];
    let mut recorder = rig.net().recorder(wanted).unwrap();
    let units: Vec<_> = recorder
        .signals()
        .iter()
        .map(|signal| &*signal.unit)
        .collect();
    assert_eq!(units, ["mm", "counts", "mm/s"]);
    line.segment().axis_mut(0, 0).unwrap().place(-2_500);
    run(&mut rig, 300);
    let read = recorder.read().unwrap();
    let last = &read.cycles.last().unwrap().values;
    let (mm, counts) = (last[0].unwrap(), last[1].unwrap());
    assert!(counts < -2_000.0, "{counts}");
    assert!((mm * 1_000.0 - counts).abs() < 1e-6, "{mm} {counts}");
    rig.shutdown();
}

#[test]
fn inputs_of_other_devices_are_shown_by_name_and_by_object() {
    let line = line();
    let mut rig = start(&line);
    let wanted = signals(["buttons.Channel 3.Input", "buttons.6000h:01", "6020h:01@1"]);
    let mut recorder = rig.net().recorder(wanted).unwrap();
    run(&mut rig, 5);
    line.segment()
        .device_mut(1)
        .unwrap()
        .set_inputs(&[0b0000_0100]);
    run(&mut rig, 5);
    let read = recorder.read().unwrap();
    let first = &read.cycles.first().unwrap().values;
    let last = &read.cycles.last().unwrap().values;
    assert_eq!(*first, [Some(0.0), Some(0.0), Some(0.0)]);
    assert_eq!(*last, [Some(1.0), Some(0.0), Some(1.0)]);
    rig.shutdown();
}

#[test]
fn a_trigger_on_a_fault_keeps_the_cycles_before_and_after_it() {
    let line = line();
    let mut rig = start(&line);
    let axis = rig.net().axis("x").unwrap();
    rig.until(axis.enable()).unwrap();
    let trigger: Trigger = "x.state == Fault".parse().unwrap();
    let mut recorder = rig.net().recorder([trigger.signal.clone()]).unwrap();
    let mut capture = Capture::new(0, trigger.condition, 50, 20);
    run(&mut rig, 200);
    assert_eq!(capture.take_in(recorder.read().unwrap()), None);
    line.segment().axis_mut(0, 0).unwrap().inject_fault(0x8611);
    let mut captured = None;
    for _ in 0..100 {
        run(&mut rig, 10);
        captured = captured.or(capture.take_in(recorder.read().unwrap()));
    }
    let captured = captured.unwrap();
    assert_eq!(captured.cycles.len(), 50 + 1 + 20);
    let in_fault = |cycle: &&servocrab::bus::RecordedValues| cycle.values[0] == Some(7.0);
    assert_eq!(captured.cycles.iter().filter(in_fault).count(), 21);
    assert_eq!(captured.lost, 0);
    rig.shutdown();
}

#[test]
fn a_trigger_waits_until_its_condition_begins_to_hold() {
    let read = |numbers: std::ops::Range<u64>, value: f64| RecordedCycles {
        cycles: numbers
            .map(|number| servocrab::bus::RecordedValues {
                number,
                time: MS * number as u32,
                values: vec![Some(value)],
            })
            .collect(),
        lost: 0,
    };
    let mut capture = Capture::new(0, TriggerCondition::Above(5.0), 2, 1);
    assert_eq!(
        capture.take_in(read(1..10, 9.0)),
        None,
        "it held from the first cycle on"
    );
    assert_eq!(capture.take_in(read(10..20, 0.0)), None);
    let captured = capture.take_in(read(20..25, 9.0)).unwrap();
    assert_eq!(numbers(&captured), [18, 19, 20, 21]);
    // And again, with what was kept since.
    assert_eq!(capture.take_in(read(25..30, 0.0)), None);
    let captured = capture.take_in(read(30..32, 9.0)).unwrap();
    assert_eq!(numbers(&captured), [28, 29, 30, 31]);
}

#[test]
fn what_cannot_be_recorded_is_refused_by_name() {
    let line = line();
    let rig = start(&line);
    let refused = |text: &str| {
        let recorder = rig.net().recorder([text.parse().unwrap()]);
        let Err(NetworkError::Declaration(text)) = recorder else {
            panic!("{text} was taken: {recorder:?}");
        };
        text
    };
    assert_eq!(
        refused("z.position"),
        "no axis is named `z`; declared: `x`, `y`"
    );
    assert_eq!(
        refused("x.6085h"),
        "`x.6085h:00` cannot be recorded: it is not in the process data; map it, or read it by SDO"
    );
    assert_eq!(
        refused("6041h@7"),
        "no device at position 7 of the line was declared"
    );
    assert_eq!(
        refused("buttons.Channel 9.Input"),
        "`buttons.Channel 9.Input` cannot be recorded: it is not in the process data; map it, or read it by SDO"
    );
    assert_eq!(
        refused("levers.Channel 1.Input"),
        "no io is named `levers`; declared: `buttons`"
    );
    let text = refused("x.positon");
    assert!(
        text.starts_with("axis `x` has no signal `positon`: it has state, "),
        "{text}"
    );
    assert!(
        text.ends_with("velocity, or an object such as 6077h"),
        "{text}"
    );
    rig.shutdown();
}

#[test]
fn after_the_end_the_last_cycles_are_read_and_then_nothing() {
    let line = line();
    let mut rig = start(&line);
    let mut recorder = rig.net().recorder(signals(["x.position"])).unwrap();
    run(&mut rig, 20);
    rig.shutdown();
    let rest = recorder.read().unwrap();
    assert!(rest.cycles.len() >= 20, "{}", rest.cycles.len());
    assert_eq!(recorder.read(), None);
    assert_eq!(recorder.read(), None);
}

#[test]
fn readers_on_other_threads_never_see_a_cycle_that_is_half_written() {
    let line = line();
    let mut rig = start(&line);
    let over = Arc::new(AtomicBool::new(false));
    let readers: Vec<_> = (0..3)
        .map(|_| {
            let wanted = signals(["x.statusword", "y.statusword"]);
            let mut recorder = rig.net().recorder(wanted).unwrap();
            let over = Arc::clone(&over);
            thread::spawn(move || {
                let (mut seen, mut last) = (0_u64, 0);
                while !over.load(Ordering::Relaxed) {
                    let read = recorder.read().unwrap();
                    for cycle in &read.cycles {
                        assert!(cycle.number > last);
                        last = cycle.number;
                        // Both axes do the same.
                        assert_eq!(cycle.values[0], cycle.values[1]);
                    }
                    seen += read.cycles.len() as u64 + read.lost;
                }
                seen
            })
        })
        .collect();
    let before = rig.net().statistics().cycles;
    run(&mut rig, 20_000);
    over.store(true, Ordering::Relaxed);
    let cycles = rig.net().statistics().cycles - before;
    for reader in readers {
        let seen = reader.join().unwrap();
        assert!(seen <= cycles + 1, "{seen} of {cycles}");
    }
    rig.shutdown();
}

#[test]
fn signals_and_triggers_are_read_as_they_are_shown() {
    for text in [
        "x.position",
        "x.state",
        "y.60F2h:00",
        "6077h:00@12",
        "valves.Channel 1.Output",
        "lateness",
    ] {
        let signal: Signal = text.parse().unwrap();
        assert_eq!(signal.to_string(), text);
    }
    for text in ["", "position", "x.", ".position", "6077h@", "6077@1", "x@1"] {
        assert!(text.parse::<Signal>().is_err(), "{text}");
    }
    let condition = |text: &str| text.parse::<Trigger>().map(|trigger| trigger.condition);
    assert_eq!(
        condition("x.velocity>-2.5"),
        Ok(TriggerCondition::Above(-2.5))
    );
    assert_eq!(
        condition("x.position < 0"),
        Ok(TriggerCondition::Below(0.0))
    );
    assert_eq!(
        condition("x.statusword & 2000h"),
        Ok(TriggerCondition::AnyBit(0x2000))
    );
    assert_eq!(
        condition("x.state==Fault"),
        Ok(TriggerCondition::Equal(7.0))
    );
    for text in [
        "x.position",
        "x.position > far",
        "x.state == Broken",
        "x.velocity > NaN",
    ] {
        assert!(condition(text).is_err(), "{text}");
    }
}
