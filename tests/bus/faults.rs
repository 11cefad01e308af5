//! Frames that are lost, late, changed or cut; drives that fall silent or leave OP.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use servocrab::{
    Network, NetworkError, SetPoint,
    axis::Liveness,
    bus::{AlState as State, DriveFault, NetworkEvent},
    link::{Fate, Wire},
};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig, TAG, TAG_BYTES, akd2g, datagrams, is_cyclic, unhomed};

const MS: Duration = Duration::from_millis(1);

fn one_drive() -> Line {
    Line::new(Segment::new().with(personality::akd2g()))
}

/// One move of axis `x`, which is enabled for it.
fn move_x(rig: &mut Rig, target: i32) -> i32 {
    rig.moved("x", target).position()
}

#[test]
fn lost_frames_end_neither_bring_up_nor_move() {
    let line = one_drive();
    let wire = line.wire_with(|number, _| match number % 20 {
        7 => Fate::LoseRequest,
        13 => Fate::LoseAnswer,
        _ => Fate::Deliver,
    });
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    assert!((move_x(&mut rig, 5_000) - 5_000).abs() < 20);
    let statistics = rig.net().statistics();
    assert!(statistics.lost > 10, "{statistics:?}");
    assert_eq!(line.segment().axis(0, 0).unwrap().ledger().len(), 1);
    rig.shutdown();
}

#[test]
fn late_frames_are_counted_and_used_for_nothing() {
    let line = one_drive();
    let wire = line.wire_with(|number, frame| {
        if is_cyclic(frame) && number % 10 == 0 {
            Fate::Delay(5 * MS / 2)
        } else {
            Fate::Deliver
        }
    });
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    assert!((move_x(&mut rig, 5_000) - 5_000).abs() < 20);
    let statistics = rig.net().statistics();
    assert!(statistics.late > 5, "{statistics:?}");
    assert!(
        statistics.lost.abs_diff(statistics.late) <= 1,
        "{statistics:?}"
    );
    rig.shutdown();
}

#[test]
fn doubled_cut_changed_and_foreign_frames_are_counted_and_end_nothing() {
    let line = one_drive();
    let wire = line.wire_with(|number, _| match number % 40 {
        5 => Fate::Double,
        12 => Fate::Cut(TAG + TAG_BYTES),
        19 => Fate::Corrupt(TAG + TAG_BYTES),
        // The EtherType: whose frame that is cannot be told.
        26 => Fate::Corrupt(12),
        33 => Fate::Cut(3),
        _ => Fate::Deliver,
    });
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    assert!((move_x(&mut rig, 5_000) - 5_000).abs() < 20);
    let statistics = rig.net().statistics();
    assert!(statistics.late > 5, "{statistics:?}");
    assert!(statistics.damaged > 5, "{statistics:?}");
    assert!(statistics.foreign > 5, "{statistics:?}");
    rig.shutdown();
}

#[test]
fn a_drive_that_falls_silent_does_not_blind_the_others() {
    let line = Line::new(
        Segment::new()
            .with(personality::akd2g())
            .with(personality::akd2g()),
    );
    let second = unhomed(servocrab::drives::akd2g(), &["z"]);
    let builder = Network::builder()
        .link(line.wire())
        .drive(0, akd2g())
        .drive(1, second);
    let mut rig = Rig::start(builder).unwrap();
    let events = rig.net().events();
    line.segment().unplug(1);
    rig.run_for(45 * MS);
    assert_eq!(
        events.try_next(),
        None,
        "half of the watchdog's time is not over"
    );
    rig.run_for(20 * MS);
    assert!(matches!(events.try_next(), Some(NetworkEvent::Lost(drive)) if drive.position == 1));
    let (x, z) = (rig.net().axis("x").unwrap(), rig.net().axis("z").unwrap());
    assert!(z.status().lost);
    assert!(!x.status().lost);
    assert!((move_x(&mut rig, 5_000) - 5_000).abs() < 20);
    assert!(
        matches!(events.try_next(), Some(NetworkEvent::AxisIncident(of)) if of.axis.axis == "z"),
        "what the lost axis did last"
    );
    assert_eq!(events.try_next(), None, "the first drive is well");
    rig.shutdown();
}

#[test]
fn a_lost_drive_that_comes_back_fallen_says_so_and_does_not_hold_up_the_others() {
    let line = Line::new(
        Segment::new()
            .with(personality::akd2g())
            .with(personality::akd2g()),
    );
    // As many drives do out of OP, it closes its outputs.
    let (segment, closed) = (Arc::clone(&line.0), Arc::new(AtomicBool::new(false)));
    let closes = Arc::clone(&closed);
    let wire = Wire::in_virtual_time(MS / 200, move |frame: &mut [u8], now| {
        let way = segment.lock().unwrap().process(frame, now);
        for datagram in datagrams(frame) {
            if let [12, .., low, _] = datagram
                && closes.load(Ordering::Relaxed)
            {
                *low = low.saturating_sub(2);
            }
        }
        way
    });
    let second = servocrab::DriveConfig::new(servocrab::drives::akd2g()).axis("z");
    let builder = Network::builder()
        .link(wire)
        .drive(0, akd2g())
        .drive(1, second);
    let mut rig = Rig::start(builder).unwrap();
    let events = rig.net().events();
    line.segment().unplug(1);
    rig.run_for(300 * MS);
    closed.store(true, Ordering::Relaxed);
    line.segment().plug();
    rig.run_for(100 * MS);
    let told: Vec<_> = std::iter::from_fn(|| events.try_next()).collect();
    assert!(
        matches!(
            &told[..],
            [
                NetworkEvent::Lost(_),
                NetworkEvent::AxisIncident(_),
                NetworkEvent::Back(_),
                NetworkEvent::LeftOp { status, .. }
            ] if (status.state, status.error) == (State::SafeOp, Some(0x001B))
        ),
        "{told:?}"
    );
    let before = rig.net().drive_statistics()[0].undelivered_cycles;
    assert!((move_x(&mut rig, 5_000) - 5_000).abs() < 20);
    let undelivered = rig.net().drive_statistics()[0].undelivered_cycles - before;
    assert_eq!(undelivered, 0);
    rig.shutdown();
}

#[test]
fn the_longest_cycle_starts_with_the_default_watchdog() {
    let line = one_drive();
    let builder = Network::builder().link(line.wire()).drive(0, akd2g());
    Rig::start(builder.cycle(1000 * MS)).unwrap().shutdown();
}

#[test]
fn a_new_liveness_takes_the_place_of_the_old_one() {
    let line = one_drive();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let _moving = rig.starts_a_long_move("x");
    let mut rules: Vec<Liveness> = (0..40)
        .map(|_| rig.net().liveness(50 * MS).unwrap())
        .collect();
    let last = rules.pop().unwrap();
    // Nobody feeds the others, and then they are dropped.
    for n in 0..10 {
        last.feed();
        rig.run_for(20 * MS);
        if n == 5 {
            rules.clear();
        }
    }
    assert!(!rig.net().axis("x").unwrap().status().halted);
    drop(last);
    rig.run_for(2 * MS);
    assert!(rig.net().axis("x").unwrap().status().halted);
    rig.shutdown();
}

/// Expired, by time or because it was dropped: what would set the axis going is refused, what stops it works, and there is a way back.
#[test]
fn an_expired_liveness_lets_nothing_start_and_everything_stop_until_it_is_over() {
    for (dropped, ended_anew) in [(false, false), (true, true), (false, true)] {
        let line = one_drive();
        let builder = Network::builder().link(line.wire()).drive(0, akd2g());
        let mut rig = Rig::start(builder).unwrap();
        let (pp, moved) = rig.starts_a_long_move("x");
        let (x, y) = (rig.net().axis("x").unwrap(), rig.net().axis("y").unwrap());
        let mut live = Some(rig.net().liveness(50 * MS).unwrap());
        rig.run_for(20 * MS);
        assert!(!x.status().halted);
        if dropped {
            live = None;
        }
        rig.run_for(500 * MS);
        assert!(x.status().halted && x.status().velocity.abs() < 1_000);
        let expired = |result: Result<(), servocrab::AxisError>| {
            let failure = result.unwrap_err().failure();
            assert_eq!(failure, Some(servocrab::Failure::LivenessExpired));
        };
        expired(rig.until(x.resume()));
        expired(rig.until(y.enable()));
        expired(rig.until(async { pp.move_abs(0, SetPoint::new()).await.map(drop) }));
        rig.until(x.halt()).unwrap();
        rig.until(x.stop()).unwrap();
        assert!(rig.until(moved.done()).is_err());
        expired(rig.until(x.enable()));
        line.segment().axis_mut(0, 1).unwrap().inject_fault(0x7500);
        rig.run_for(300 * MS);
        rig.until(y.reset_fault()).unwrap();
        rig.until(x.quick_stop()).unwrap();
        rig.until(x.disable()).unwrap();
        expired(rig.until(x.enable()));
        match live.take().filter(|_| !ended_anew) {
            Some(live) => {
                live.feed();
                rig.until(x.enable()).unwrap();
                live.end();
            }
            None => rig.net().liveness(50 * MS).unwrap().end(),
        }
        rig.run_for(200 * MS);
        rig.until(async {
            x.enable().await.unwrap();
            y.enable().await.unwrap();
            let moved = pp.move_rel(100, SetPoint::new()).await.unwrap();
            moved.done().await.unwrap();
        });
        rig.shutdown();
    }
}

#[test]
fn an_axis_that_has_halted_for_liveness_goes_on_by_resume_once_it_is_fed() {
    let line = one_drive();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let (_pp, moved) = rig.starts_a_long_move("x");
    let x = rig.net().axis("x").unwrap();
    let live = rig.net().liveness(50 * MS).unwrap();
    rig.run_for(500 * MS);
    live.feed();
    rig.run_for(20 * MS);
    assert!(
        x.status().halted && x.status().velocity.abs() < 1_000,
        "fed is not resumed"
    );
    live.feed();
    rig.until(x.resume()).unwrap();
    live.end();
    rig.until(moved.done_through_halt()).unwrap();
    rig.shutdown();
}

#[test]
fn frames_that_come_back_later_than_the_cycle_are_named_with_their_time() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let slow = line.wire_with(|_, frame| {
        if is_cyclic(frame) {
            Fate::Delay(Duration::from_micros(3_200))
        } else {
            Fate::Deliver
        }
    });
    let error = Rig::start(Network::builder().link(slow).drive(0, akd2g())).err();
    let NetworkError::Drive { error, .. } = error.unwrap() else {
        panic!("the drive has no exchange");
    };
    let text = error.to_string();
    let DriveFault::LateFrames { away, cycle } = *error else {
        panic!("{text}");
    };
    assert_eq!(cycle, Duration::from_millis(1));
    let exact = Duration::from_micros(3_210);
    assert!(away.abs_diff(exact) < cycle, "{away:?}");
    assert!(text.contains("1ms"), "{text}");
}
