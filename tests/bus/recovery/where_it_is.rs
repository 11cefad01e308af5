//! Devices that have lost their station address, in lines of which others are missing, or have changed.

use servocrab::{
    AxisConfig, DriveConfig, Network, NetworkError, Referencing,
    bus::{DevicePlace, LineVerdict, Recovered},
    drives,
};
use servocrab_sim::{AlState, Device, Segment, personality, personality::Servo};

use super::{MIDDLE, MS, Yard, unhomed};
use crate::rig::{Line, Rig};

/// A coupler with a branch of two drives, `a` and `b`, and drive `c` behind it.
fn started(drives: [Device; 3]) -> (Line, Rig) {
    let mut segment = Segment::new().with(personality::coupler());
    let [a, b, c] = drives;
    segment.push(c);
    assert_eq!(segment.attach(0, 3, a), Some(1));
    assert_eq!(segment.attach(1, 1, b), Some(2));
    let line = Line::new(segment);
    let drive = |axis| unhomed(drives::akd2g(), &[axis]);
    let builder = Network::builder()
        .link(line.wire())
        .drive(1, drive("a"))
        .drive(2, drive("b"))
        .drive(3, drive("c"));
    let rig = Rig::start(builder).unwrap();
    (line, rig)
}

fn serial(number: u32) -> Device {
    Servo::akd2g().serial(number).build()
}

fn off(line: &Line, rig: &mut Rig, positions: &[usize]) {
    for position in positions {
        let mut segment = line.segment();
        segment.device_mut(*position).unwrap().power_off();
    }
    rig.run_for(300 * MS);
}

fn on(line: &Line, rig: &mut Rig, positions: &[usize]) {
    let now = rig.bus.now();
    for position in positions {
        let mut segment = line.segment();
        segment.device_mut(*position).unwrap().power_on(now);
    }
    rig.run_for(50 * MS);
}

/// The verdict of the table that the error shows.
fn verdict(error: NetworkError) -> LineVerdict {
    let text = error.to_string();
    match error {
        NetworkError::WrongLine(table) => table.0[0].verdict.clone(),
        _ => panic!("{text}"),
    }
}

#[test]
fn behind_others_that_are_missing_it_is_found_where_it_is_now() {
    let (line, mut rig) = started([serial(1), serial(2), serial(3)]);
    off(&line, &mut rig, &[1, 2, 3]);
    on(&line, &mut rig, &[3]);
    let expected = Recovered::BroughtUp {
        position: 1,
        from: None,
    };
    assert_eq!(rig.recover(3).unwrap(), expected);
    assert_eq!(verdict(rig.recover(1).unwrap_err()), LineVerdict::Missing);
    on(&line, &mut rig, &[1, 2]);
    for position in [2, 1] {
        let expected = Recovered::BroughtUp {
            position,
            from: None,
        };
        assert_eq!(rig.recover(position).unwrap(), expected);
    }
    for (position, axis) in [(1, "a"), (2, "b"), (3, "c")] {
        rig.moved(axis, 100 * position as i32);
        let segment = line.segment();
        let ledger = segment.axis(position, 0).unwrap().ledger();
        assert_eq!(ledger.len(), 1, "each has its own address and its own data");
        assert_eq!(ledger[0].value, 100 * position as i32);
    }
    rig.shutdown();
}

#[test]
fn one_that_may_be_either_of_two_that_are_alike_is_not_taken_for_one_of_them() {
    let (line, mut rig) = started([serial(0), serial(0), serial(0)]);
    off(&line, &mut rig, &[1, 2, 3]);
    on(&line, &mut rig, &[3]);
    let unclear = verdict(rig.recover(3).unwrap_err());
    assert!(
        matches!(unclear, LineVerdict::NotUnique { .. }),
        "{unclear}"
    );
    assert_eq!(line.segment().devices()[3].al_state(), AlState::Init);
    // All together are told apart by their order.
    on(&line, &mut rig, &[1, 2]);
    for position in [3, 1, 2] {
        assert!(rig.recover(position).is_ok());
    }
    rig.moved("c", 1_000);
    assert_eq!(line.segment().axis(3, 0).unwrap().ledger().len(), 1);
    rig.shutdown();
}

#[test]
fn another_device_in_its_place_is_named_and_left_alone() {
    for other in [serial(7), personality::generic(), personality::coupler()] {
        let (line, mut rig) = started([serial(1), serial(2), serial(3)]);
        off(&line, &mut rig, &[3]);
        *line.segment().device_mut(3).unwrap() = other;
        rig.run_for(50 * MS);
        let error = rig.recover(3).unwrap_err();
        let text = error.to_string();
        assert!(text.contains("serial 00000003h"), "{text}");
        assert_eq!(verdict(error), LineVerdict::Different, "{text}");
        assert_eq!(line.segment().devices()[3].al_state(), AlState::Init);
        rig.moved("a", 1_000);
        rig.shutdown();
    }
}

#[test]
fn two_that_are_led_back_at_the_same_time_each_get_what_is_theirs() {
    let (line, mut rig) = started([serial(1), serial(2), serial(3)]);
    off(&line, &mut rig, &[1, 2, 3]);
    on(&line, &mut rig, &[1, 2, 3]);
    let net = rig.net.take().unwrap();
    let all = rig.until(async {
        let both = smol::future::zip(net.recover(3), net.recover(1));
        // And one of them asked for twice.
        smol::future::zip(both, smol::future::zip(net.recover(2), net.recover(3))).await
    });
    rig.net = Some(net);
    let ((three, one), (two, again)) = all;
    for (recovered, position) in [(one, 1), (two, 2), (three, 3)] {
        let expected = Recovered::BroughtUp {
            position,
            from: None,
        };
        assert_eq!(recovered.unwrap(), expected);
    }
    assert_eq!(again.unwrap(), Recovered::WasInOp, "by then");
    for (position, axis) in [(1, "a"), (2, "b"), (3, "c")] {
        rig.moved(axis, 1_000);
        let segment = line.segment();
        assert_eq!(segment.axis(position, 0).unwrap().ledger().len(), 1);
    }
    rig.shutdown();
}

/// It comes from another machine with its power on, and has kept the address and the process data that it had there.
#[test]
fn another_device_with_the_same_address_is_not_led_back_in_its_place() {
    let homed = |number| {
        let drive = DriveConfig::new(drives::akd2g())
            .axis(AxisConfig::new("z").referencing(Referencing::ByHoming));
        let mut yard = Yard::new(serial(number), drive);
        let z = yard.is_homed_here("z", 700);
        yard.falls(0x001B);
        (yard, z)
    };
    let (mut here, z) = homed(1);
    let (there, _) = homed(2);
    {
        let (mut here, mut there) = (here.line.segment(), there.line.segment());
        std::mem::swap(
            here.device_mut(MIDDLE).unwrap(),
            there.device_mut(MIDDLE).unwrap(),
        );
    }
    here.rig.run_for(20 * MS);
    let recovered = here.recover(1);
    assert!(!z.status().referenced, "{recovered:?}");
    let verdict = verdict(recovered.unwrap_err());
    assert_eq!(verdict, LineVerdict::Different);
    assert_eq!(here.state(MIDDLE), AlState::Init);
    drop((z, there));
    here.ends();
}

/// Two drives that nothing tells apart but their alias, each declared by its own.
#[test]
fn a_drive_that_was_declared_by_its_alias_is_not_led_back_in_the_place_of_another() {
    let drive = |alias| Servo::akd2g().alias(alias).build();
    let started = |aliases: [u16; 2]| {
        let [first, second] = aliases.map(drive);
        let line = Line::new(Segment::new().with(first).with(second));
        let [x, y] = aliases.map(DevicePlace::Alias);
        let builder = Network::builder()
            .link(line.wire())
            .drive(x, unhomed(drives::akd2g(), &["x"]))
            .drive(y, unhomed(drives::akd2g(), &["y"]));
        let rig = Rig::start(builder).unwrap();
        (line, rig)
    };
    let is_named = |error: NetworkError| {
        let text = error.to_string();
        assert_eq!(verdict(error), LineVerdict::Different, "{text}");
        assert!(text.contains("alias 5: "), "{text}");
        assert!(text.contains(", alias 6)"), "{text}");
    };
    let exchanged = |line: &Line, with: &mut Device| {
        let mut segment = line.segment();
        std::mem::swap(segment.device_mut(0).unwrap(), with);
    };
    // Plugged in the other way round, without power.
    let (line, mut rig) = started([5, 6]);
    off(&line, &mut rig, &[0, 1]);
    let mut at_hand = personality::coupler();
    exchanged(&line, &mut at_hand);
    std::mem::swap(line.segment().device_mut(1).unwrap(), &mut at_hand);
    exchanged(&line, &mut at_hand);
    on(&line, &mut rig, &[0, 1]);
    is_named(rig.recover(0).unwrap_err());
    assert!(rig.net().axis("x").unwrap().status().lost);
    rig.shutdown();
    // From another machine, with its power on: it has kept its station address.
    let ((line, mut rig), (other, elsewhere)) = (started([5, 7]), started([6, 8]));
    for line in [&line, &other] {
        let mut segment = line.segment();
        segment.device_mut(0).unwrap().fall_to_safe_op(0x001B);
    }
    rig.run_for(100 * MS);
    exchanged(&line, other.segment().device_mut(0).unwrap());
    rig.run_for(20 * MS);
    is_named(rig.recover(0).unwrap_err());
    rig.run_for(20 * MS);
    assert!(rig.net().axis("x").unwrap().status().lost);
    rig.shutdown();
    drop(elsewhere);
}
