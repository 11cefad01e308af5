//! When frames leave: cycles on time, acyclic frames between them, whichever way the thread waits.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use servocrab::{
    Network,
    bus::WaitStrategy,
    link::{Link, Wire},
};
use servocrab_sim::{Segment, personality};

use crate::{
    otherwise::Otherwise,
    rig::{Rig, akd2g, is_cyclic},
};

const PERIOD: Duration = Duration::from_micros(250);
/// How long each frame is away.
const AWAY: Duration = Duration::from_micros(40);

/// A frame as it left.
#[derive(Debug, Clone, Copy)]
struct Sent {
    at: Duration,
    cyclic: bool,
}

/// What left, and a network on a wire that notes it. Of process data `answered` says by the time whether it comes back.
fn rig(
    wait_strategy: WaitStrategy,
    answered: impl Fn(Duration) -> bool + Send + 'static,
) -> (Arc<Mutex<Vec<Sent>>>, Rig) {
    rig_with(PERIOD, wait_strategy, answered)
}

fn rig_with(
    period: Duration,
    wait_strategy: WaitStrategy,
    answered: impl Fn(Duration) -> bool + Send + 'static,
) -> (Arc<Mutex<Vec<Sent>>>, Rig) {
    let frames = Arc::new(Mutex::new(Vec::new()));
    let note = Arc::clone(&frames);
    let mut segment = Segment::new().with(personality::akd2g());
    let wire = Wire::in_virtual_time(AWAY, move |frame: &mut [u8], at| {
        let cyclic = is_cyclic(frame);
        note.lock().unwrap().push(Sent { at, cyclic });
        segment.process(frame, at) && (!cyclic || answered(at))
    });
    // Waiting for a time ends too late, as it does where other threads run.
    let link = Otherwise::new(wire).waits(|wire, until| wire.wait(until + OVERSLEPT));
    let builder = Network::builder()
        .link(link)
        .cycle(period)
        .wait_strategy(wait_strategy)
        .drive(0, akd2g());
    (frames, Rig::start(builder).unwrap())
}

/// How much too long a thread sleeps here at the most.
const OVERSLEPT: Duration = Duration::from_micros(7);

const ALL: [WaitStrategy; 3] = [
    WaitStrategy::Block,
    WaitStrategy::Spin,
    WaitStrategy::SpinThenBlock {
        spin: Duration::from_micros(20),
    },
];

#[test]
fn acyclic_frames_are_back_before_the_next_cycle_starts() {
    for wait_strategy in ALL {
        let (frames, mut rig) = rig(wait_strategy, |_| true);
        let before = rig.net().statistics();
        frames.lock().unwrap().clear();
        let sdo = rig.net().sdo(0).unwrap();
        let text = vec![b'a'; 4000];
        rig.until(async {
            sdo.write_bytes(0x5F00, 0, text.clone()).await.unwrap();
            assert_eq!(sdo.read_bytes(0x5F00, 0).await.unwrap(), text);
        });
        let frames = frames.lock().unwrap().clone();
        let acyclic = frames.iter().filter(|frame| !frame.cyclic).count();
        assert!(acyclic > 10, "{wait_strategy:?}: {acyclic} acyclic frames");
        for (place, frame) in frames.iter().enumerate().filter(|(_, frame)| !frame.cyclic) {
            let next = frames.iter().skip(place).find(|frame| frame.cyclic);
            if let Some(next) = next {
                assert!(
                    frame.at + AWAY <= next.at,
                    "{wait_strategy:?}: an acyclic frame left at {:?}, the next cycle at {:?}",
                    frame.at,
                    next.at
                );
            }
        }
        let after = rig.net().statistics();
        assert_eq!(after.acyclic_in_cycle, before.acyclic_in_cycle);
        assert_eq!(
            (after.lost, after.late_cycles),
            (before.lost, before.late_cycles)
        );
    }
}

#[test]
fn cycles_start_on_the_same_grid_for_ever() {
    for wait_strategy in ALL {
        let (frames, mut rig) = rig(wait_strategy, |_| true);
        frames.lock().unwrap().clear();
        rig.run_for(Duration::from_millis(200));
        let frames = frames.lock().unwrap();
        let starts: Vec<_> = frames.iter().filter(|f| f.cyclic).map(|f| f.at).collect();
        let first = starts[0];
        for (at, cycle) in starts.iter().zip(0..) {
            let late = at.saturating_sub(first + PERIOD * cycle);
            assert!(*at + OVERSLEPT >= first + PERIOD * cycle);
            assert!(
                late <= OVERSLEPT,
                "{wait_strategy:?}: cycle {cycle} was {late:?} late"
            );
        }
    }
}

#[test]
fn what_does_not_come_back_is_waited_for_until_the_receive_deadline_and_no_longer() {
    for wait_strategy in ALL {
        let silence = Arc::new(Mutex::new(None));
        let since = Arc::clone(&silence);
        let (frames, mut rig) = rig(wait_strategy, move |at| {
            since.lock().unwrap().is_none_or(|since| at < since)
        });
        let (from, before) = (rig.bus.now(), rig.net().statistics());
        *silence.lock().unwrap() = Some(from);
        frames.lock().unwrap().clear();
        rig.run_for(PERIOD * 8);
        let frames = frames.lock().unwrap();
        let starts: Vec<_> = frames.iter().filter(|f| f.cyclic).map(|f| f.at).collect();
        assert!(starts.len() >= 8, "{wait_strategy:?}: {starts:?}");
        for pair in starts.windows(2) {
            let apart = pair[1] - pair[0];
            let error = apart.abs_diff(PERIOD);
            assert!(error <= 2 * OVERSLEPT, "{wait_strategy:?}: {apart:?} apart");
        }
        let lost = rig.net().statistics().lost - before.lost;
        assert!(
            (7..=9).contains(&lost),
            "{wait_strategy:?}: {lost} frames lost"
        );
    }
}

#[test]
fn requests_have_their_time_between_cycles_that_are_all_lost() {
    for wait_strategy in ALL {
        let silence = Arc::new(Mutex::new(None));
        let since = Arc::clone(&silence);
        // Long enough for every frame in the quarter that is left of it.
        let (_, mut rig) = rig_with(4 * PERIOD, wait_strategy, move |at| {
            since.lock().unwrap().is_none_or(|since| at < since)
        });
        *silence.lock().unwrap() = Some(rig.bus.now());
        // The gap behind the last complete one is over.
        rig.run_for(8 * PERIOD);
        let sdo = rig.net().sdo(0).unwrap();
        let vendor = rig.until(async { sdo.read_bytes(0x1018, 1).await.unwrap() });
        assert_eq!(vendor.len(), 4, "{wait_strategy:?}");
    }
}

#[test]
fn a_frame_that_comes_after_its_cycle_is_late_and_the_next_cycle_has_its_own() {
    for wait_strategy in ALL {
        // Each frame of process data is away for longer than a cycle, from a moment on.
        let line = crate::rig::Line::new(Segment::new().with(personality::akd2g()));
        let slow = Arc::new(Mutex::new(false));
        let is_slow = Arc::clone(&slow);
        let wire = line.wire_with(move |_, frame| {
            if *is_slow.lock().unwrap() && is_cyclic(frame) {
                servocrab::link::Fate::Delay(PERIOD + PERIOD / 10)
            } else {
                servocrab::link::Fate::Deliver
            }
        });
        let builder = Network::builder()
            .link(wire)
            .cycle(PERIOD)
            .wait_strategy(wait_strategy)
            .drive(0, akd2g());
        let mut rig = Rig::start(builder).unwrap();
        let before = rig.net().statistics();
        *slow.lock().unwrap() = true;
        rig.run_for(PERIOD * 6);
        let after = rig.net().statistics();
        let (late, lost) = (after.late - before.late, after.lost - before.lost);
        assert!((4..=6).contains(&late), "{wait_strategy:?}: {late} late");
        assert!((5..=7).contains(&lost), "{wait_strategy:?}: {lost} lost");
        let x = rig.net().axis("x").unwrap();
        assert!(
            !x.status().answered,
            "{wait_strategy:?}: nothing of a late frame is used"
        );
    }
}
