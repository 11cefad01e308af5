//! Recoveries that do not come to their end: given up, overtaken by the end of the network, refused mail by mail, on a bad line.

use std::{
    pin::pin,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{Network, bus::Recovered, coe::obj, drives, link::Fate};
use servocrab_sim::{Abort, AlState, Habits, personality};

use super::{MIDDLE, MS, Yard, unhomed};

/// What becomes of a way back after so many polls.
#[derive(Debug, Clone, Copy, PartialEq)]
enum After {
    Dropped,
    Kept,
}

/// The way back of the middle drive after `falls`, dropped or kept after each `step`-th number of polls until it is over; how many it takes.
fn give_up(falls: fn(&mut Yard), fate: After, step: usize) -> usize {
    let mut polls = 0;
    loop {
        let mut yard = Yard::new(personality::akd2g(), unhomed(drives::akd2g(), &["z", "w"]));
        let (mode, motion) = yard.start("z");
        falls(&mut yard);
        yard.nothing_may_happen();
        let net = yard.rig.net.take().unwrap();
        let what = format!("{fate:?} after {polls} polls");
        let mut done = false;
        {
            let mut recovery = pin!(net.recover(1));
            let mut context = Context::from_waker(Waker::noop());
            for poll in 1..=polls {
                done = recovery.as_mut().poll(&mut context).is_ready();
                if done {
                    break;
                }
                // Nothing has come since it was polled last.
                if poll < polls {
                    assert!(yard.rig.bus.turn());
                }
            }
            if fate == After::Kept && polls > 0 && !done {
                yard.rig.run_for(MS * 1_000);
                assert_eq!(yard.state(MIDDLE), AlState::Op, "{what}");
                // It holds nobody up.
                let again = yard.rig.until(net.recover(1));
                assert!(matches!(again, Ok(Recovered::WasInOp)), "{what}: {again:?}");
                let ready = recovery.as_mut().poll(&mut context);
                assert!(matches!(ready, Poll::Ready(Ok(_))), "{what}: {ready:?}");
            }
        }
        yard.rig.net = Some(net);
        yard.nothing_has_happened();
        if fate == After::Dropped || polls == 0 {
            if !done {
                assert_ne!(yard.state(MIDDLE), AlState::Op, "{what}");
                assert!(yard.axis("z").status().lost, "{what}");
            }
            yard.nothing_may_happen();
            let recovered = yard.recover(1);
            assert!(recovered.is_ok(), "{what}: {recovered:?}");
            yard.nothing_has_happened();
        }
        drop((mode, motion));
        yard.works_again("z");
        yard.works_again("w");
        yard.ends();
        if done {
            return polls;
        }
        polls += step;
    }
}

fn has_fallen(yard: &mut Yard) {
    yard.falls(0x001B);
}

fn was_without_power(yard: &mut Yard) {
    yard.loses_power(300 * MS);
}

#[test]
fn a_way_back_from_safe_op_is_dropped_and_kept_after_many_a_poll() {
    for fate in [After::Dropped, After::Kept] {
        // All of its polls take a minute, and come to the same.
        let polls = give_up(has_fallen, fate, 7);
        assert!(polls > 20, "{polls}");
    }
}

#[test]
fn a_way_back_from_init_is_dropped_and_kept_after_many_a_poll() {
    for fate in [After::Dropped, After::Kept] {
        // All of its polls take a minute, and come to the same.
        let polls = give_up(was_without_power, fate, 23);
        assert!(polls > 200, "{polls}");
    }
}

#[test]
fn the_end_of_the_network_is_not_held_up_and_whoever_waits_is_told() {
    let mut overtaken = 0;
    for after in [0, 1, 2, 3, 5, 8, 13] {
        let mut yard = Yard::new(personality::akd2g(), unhomed(drives::akd2g(), &["z", "w"]));
        yard.loses_power(300 * MS);
        yard.nothing_may_happen();
        let net = yard.rig.net.take().unwrap();
        let mut context = Context::from_waker(Waker::noop());
        let mut recovery = Box::pin(async {
            let recovered = net.recover(1).await;
            (recovered, net)
        });
        let end = yard.rig.bus.now() + after * MS;
        while yard.rig.bus.now() < end {
            if recovery.as_mut().poll(&mut context).is_ready() {
                break;
            }
            assert!(yard.rig.bus.turn());
        }
        overtaken += u32::from(yard.rig.bus.now() >= end);
        // The network goes with the future that holds it.
        drop(recovery);
        yard.rig.bus.run();
        assert_eq!(yard.watched.seen(), Vec::<String>::new());
        let segment = yard.line.segment();
        assert!(
            segment
                .devices()
                .iter()
                .all(|device| device.al_state() == AlState::Init)
        );
    }
    assert!(overtaken > 3, "{overtaken}");
}

#[test]
fn each_message_on_the_way_may_be_refused_and_the_next_attempt_gets_through() {
    // Another mapping than the drive has at power-up.
    let drive = unhomed(drives::generic(), &["z"])
        .change_axis("z", |axis| axis.map_output(obj::QUICK_STOP_DECELERATION))
        .change_axis("z", |axis| axis.map_input(obj::FOLLOWING_ERROR_ACTUAL));
    let mut yard = Yard::new(personality::generic(), drive);
    yard.loses_power(150 * MS);
    yard.recover(1).unwrap();
    // Since it has its power again.
    let messages = yard.line.segment().device(MIDDLE).unwrap().messages_taken();
    let mut refused = 0;
    for number in (0..messages).step_by(2) {
        yard.loses_power(150 * MS);
        {
            let mut segment = yard.line.segment();
            let device = segment.device_mut(MIDDLE).unwrap();
            device.set_habits(Habits {
                refuses: Some((number, Abort::State)),
                ..Habits::default()
            });
        }
        yard.nothing_may_happen();
        let result = yard.recover(1);
        yard.nothing_has_happened();
        if let Err(error) = result {
            refused += 1;
            let text = error.to_string();
            assert!(text.contains("08000022h"), "{text}");
            assert_eq!(yard.state(MIDDLE), AlState::Init, "{text}");
            assert!(yard.axis("z").status().lost);
            yard.nothing_may_happen();
            assert!(matches!(yard.recover(1), Ok(Recovered::BroughtUp { .. })));
            yard.nothing_has_happened();
        }
    }
    assert!(refused > 10, "{refused}");
    yard.works_again("z");
    yard.ends();
}

#[test]
fn bursts_of_lost_frames_end_no_recovery() {
    for every in [7, 11, 23] {
        let bad = Arc::new(AtomicBool::new(false));
        let is_bad = Arc::clone(&bad);
        let mut yard = Yard::with(
            personality::akd2g(),
            unhomed(drives::akd2g(), &["z", "w"]),
            move |line| {
                // Three in a row are lost, one way or the other.
                let wire = line.wire_with(move |number, _| {
                    match (is_bad.load(Ordering::Relaxed), number % (3 * every)) {
                        (true, 0 | 1) => Fate::LoseRequest,
                        (true, 2) => Fate::LoseAnswer,
                        _ => Fate::Deliver,
                    }
                });
                Network::builder().link(wire)
            },
        );
        yard.loses_power(300 * MS);
        yard.watched.arm();
        bad.store(true, Ordering::Relaxed);
        for position in [1, 2] {
            let recovered = yard.recover(position);
            assert!(recovered.is_ok(), "{recovered:?}");
        }
        bad.store(false, Ordering::Relaxed);
        yard.rig.run_for(Duration::from_millis(50));
        assert_eq!(yard.watched.seen(), Vec::<String>::new());
        yard.watched.disarm();
        yard.works_again("z");
        yard.works_again("w");
        yard.ends();
    }
}

#[test]
fn a_recovery_of_a_network_that_has_ended_says_so() {
    let mut yard = Yard::new(personality::generic(), unhomed(drives::generic(), &["z"]));
    yard.loses_power(150 * MS);
    let net = yard.rig.net.take().unwrap();
    let mut recovery = pin!(net.recover(1));
    let mut context = Context::from_waker(Waker::noop());
    assert!(recovery.as_mut().poll(&mut context).is_pending());
    drop(yard.rig.bus);
    let Poll::Ready(Err(error)) = recovery.as_mut().poll(&mut context) else {
        panic!("it still waits");
    };
    assert!(error.to_string().contains("ended"), "{error}");
}
