//! Frames that are lost, late, changed or cut; drives that fall silent or leave OP.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use servocrab::{
    axis::{Liveness, StopRequest},
    bus::{AlState as State, DriveFault, Network, NetworkError, NetworkEvent},
    ds402,
    link::{Fate, Wire},
    profile_position::SetPoint,
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
fn a_late_answer_of_an_acyclic_request_is_not_taken_for_a_later_ones() {
    // Each late frame has been sent again meanwhile: two answers come for one request.
    let line = one_drive();
    let wire = line.wire_with(|number, frame| {
        if !is_cyclic(frame) && number % 50 == 0 {
            Fate::Delay(30 * MS)
        } else {
            Fate::Deliver
        }
    });
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    let sdo = rig.net().sdo(0).unwrap();
    for _ in 0..200 {
        assert_eq!(
            rig.until(sdo.read_bytes(0x1018, 2)).unwrap(),
            0x414B_4432u32.to_le_bytes()
        );
    }
    assert!(rig.net().statistics().late > 5);
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

/// A drive whose registers answer, and whose process data do not: its FMMUs are gone.
#[test]
fn a_lost_drive_in_op_is_not_reported_as_back_in_op() {
    let line = one_drive();
    let is_broken = Arc::new(AtomicBool::new(false));
    let (segment, broken) = (Arc::clone(&line.0), Arc::clone(&is_broken));
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        let mut asked = frame.to_vec();
        let answers = segment.lock().unwrap().process(frame, now);
        for (got, asked) in datagrams(frame).into_iter().zip(datagrams(&mut asked)) {
            let is_logical = (10..=12).contains(&got[0]);
            if is_logical && broken.load(Ordering::Relaxed) {
                got.copy_from_slice(asked);
            }
        }
        answers
    });
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    let events = rig.net().events();
    is_broken.store(true, Ordering::Relaxed);
    rig.run_for(2_000 * MS);
    let told: Vec<_> = std::iter::from_fn(|| events.try_next()).collect();
    assert!(matches!(told[..], [NetworkEvent::Lost(_), ..]), "{told:?}");
    let is_in_op = |event: &NetworkEvent| matches!(event, NetworkEvent::InOp(_));
    assert!(!told.iter().any(is_in_op), "{told:?}");
    is_broken.store(false, Ordering::Relaxed);
    rig.run_for(100 * MS);
    let told: Vec<_> = std::iter::from_fn(|| events.try_next()).collect();
    assert!(
        matches!(told[..], [NetworkEvent::Back(_), NetworkEvent::InOp(_)]),
        "{told:?}"
    );
}

#[test]
fn a_drive_that_leaves_op_is_named_with_its_al_status_code() {
    // An axis whose inputs stay the same.
    let line = Line::ideal(Segment::new().with(personality::akd2g()));
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let events = rig.net().events();
    rig.run_for(20 * MS);
    assert_eq!(events.try_next(), None);
    line.segment()
        .device_mut(0)
        .unwrap()
        .fall_to_safe_op(0x001B);
    rig.run_for(220 * MS);
    let Some(NetworkEvent::LeftOp { drive, status }) = events.try_next() else {
        panic!("nothing was reported");
    };
    assert_eq!(drive.position, 0);
    assert_eq!((status.state, status.error), (State::SafeOp, Some(0x001B)));
    assert!(
        rig.net().axis("x").unwrap().status().lost,
        "a drive that ignores its outputs counts as lost"
    );
    rig.shutdown();
}

#[test]
fn a_drive_that_leaves_op_at_once_is_not_taken_for_one_in_op() {
    let line = one_drive();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    line.segment()
        .device_mut(0)
        .unwrap()
        .fall_to_safe_op(0x001B);
    rig.run_for(30 * MS);
    assert!(matches!(
        rig.net().events().try_next(),
        Some(NetworkEvent::LeftOp { .. })
    ));
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
    let second = servocrab::bus::DriveConfig::new(servocrab::drives::akd2g()).axis("z");
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
fn moves_that_start_together_are_latched_in_one_drive_cycle() {
    let line = one_drive();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let (x, y) = (rig.net().axis("x").unwrap(), rig.net().axis("y").unwrap());
    rig.until(x.enable()).unwrap();
    rig.until(y.enable()).unwrap();
    let xs = rig.until(x.profile_position()).unwrap();
    let ys = rig.until(y.profile_position()).unwrap();
    let set_point = SetPoint::new()
        .velocity(10_000)
        .acceleration(100_000)
        .deceleration(100_000);
    let requests = [xs.abs(1_000, set_point), ys.abs(-500, set_point)];
    let net = rig.net.take().unwrap();
    let moves = rig
        .until(servocrab::axis::start_together(requests))
        .unwrap();
    assert_eq!(moves.len(), 2);
    for motion in &moves {
        rig.until(motion.done()).unwrap();
    }
    let latched = |axis| line.segment().axis(0, axis).unwrap().ledger()[0].latched_at;
    assert_eq!(latched(0), latched(1));
    rig.net = Some(net);
    rig.shutdown();
}

#[test]
fn a_stop_of_all_axes_halts_a_move() {
    let line = one_drive();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let mut moving = start_long_move(&mut rig);
    rig.net().stop_handle().stop_all(StopRequest::HALT);
    rig.run_for(500 * MS);
    let status = rig.net().axis("x").unwrap().status();
    assert!(status.halted && status.velocity.abs() < 1_000, "{status:?}");
    assert!(moving.take().is_some());
    rig.shutdown();
}

#[test]
fn a_program_that_no_longer_feeds_its_liveness_halts_every_axis() {
    let line = one_drive();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let _moving = start_long_move(&mut rig);
    let live: Liveness = rig.net().liveness(50 * MS).unwrap();
    for _ in 0..10 {
        live.feed();
        rig.run_for(20 * MS);
    }
    assert!(!rig.net().axis("x").unwrap().status().halted);
    rig.run_for(400 * MS);
    let status = rig.net().axis("x").unwrap().status();
    assert!(status.halted && status.velocity.abs() < 1_000, "{status:?}");
    rig.shutdown();
}

#[test]
fn a_new_liveness_takes_the_place_of_the_old_one() {
    let line = one_drive();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let _moving = start_long_move(&mut rig);
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
        let expired = |result: Result<(), servocrab::axis::AxisError>| {
            let failure = result.unwrap_err().failure();
            assert_eq!(failure, Some(servocrab::axis::Failure::LivenessExpired));
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
fn the_end_of_the_network_stops_a_moving_axis_before_it_leaves_op() {
    let line = one_drive();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let moving = start_long_move(&mut rig);
    rig.shutdown();
    drop(moving);
    let segment = line.segment();
    let axis = segment.axis(0, 0).unwrap();
    assert!(axis.stands());
    assert!(!axis.position().eq(&0), "it had moved");
}

/// Axis `x` on a way that takes a minute. What is returned keeps the mode.
fn start_long_move(rig: &mut Rig) -> Option<impl Sized + use<>> {
    let started = rig.starts_a_long_move("x");
    rig.run_for(300 * MS);
    let axis = rig.net().axis("x").unwrap();
    let status = axis.status();
    assert_eq!(status.state, ds402::State::OperationEnabled);
    assert!((status.velocity - 10_000).abs() < 1_000, "{status:?}");
    Some((started, axis))
}

#[test]
fn an_answer_is_never_taken_for_that_of_a_lost_request_with_the_same_index() {
    // ethercrab's 256 indices go round many times while one of many concurrent requests is lost and sent again.
    for nth in [41, 61, 131, 257, 811] {
        let mut segment = Segment::new();
        for _ in 0..12 {
            segment = segment.with(personality::akd2g());
        }
        let line = Line::new(segment);
        let wire = line.wire_with(move |number, frame| {
            if !is_cyclic(frame) && number % nth == 5 {
                Fate::LoseAnswer
            } else {
                Fate::Deliver
            }
        });
        let mut builder = Network::builder().link(wire);
        for position in 0..12 {
            let drive = servocrab::bus::DriveConfig::new(servocrab::drives::akd2g());
            builder = builder.drive(position, drive.axis(format!("axis {position}")));
        }
        let rig = match Rig::start(builder) {
            Ok(rig) => rig,
            Err(error) => panic!("one of {nth} frames was lost: {error}"),
        };
        rig.shutdown();
    }
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

#[test]
fn a_frame_that_comes_late_in_a_running_network_is_counted_with_its_time() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let mut cyclic = 0;
    let wire = line.wire_with(move |_, frame| {
        cyclic += u32::from(is_cyclic(frame));
        if is_cyclic(frame) && cyclic == 200 {
            Fate::Delay(Duration::from_micros(2_400))
        } else {
            Fate::Deliver
        }
    });
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    rig.run_for(Duration::from_millis(400));
    let latest = rig.net().statistics().latest.unwrap();
    let exact = Duration::from_micros(2_410);
    // It is taken when the thread looks next.
    assert!(
        latest >= exact && latest < exact + Duration::from_millis(1),
        "{latest:?}"
    );
    rig.shutdown();
}
