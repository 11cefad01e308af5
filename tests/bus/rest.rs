//! Axes at rest, which the bus thread passes over: nothing of it is to be seen.

use std::{
    pin::pin,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Wake, Waker},
    time::Duration,
};

use servocrab::{
    axis::{Axis, Snapshot},
    bus::Network,
    ds402::State,
    link::Fate,
    profile_position::SetPoint,
};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig, akd2g, is_cyclic};

const MS: Duration = Duration::from_millis(1);

/// Two axes that have stood enabled for a thousand cycles, and how many cycles were sent.
struct Resting {
    line: Line,
    rig: Rig,
    axes: [Axis; 2],
    sent: Arc<AtomicU64>,
}

impl Resting {
    fn new() -> Self {
        // No count of it changes at rest.
        let line = Line::ideal(Segment::new().with(personality::akd2g()));
        let sent = Arc::new(AtomicU64::new(0));
        let counter = Arc::clone(&sent);
        let wire = line.wire_with(move |_, frame| {
            counter.fetch_add(is_cyclic(frame).into(), Ordering::Relaxed);
            Fate::Deliver
        });
        let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
        let axes = ["x", "y"].map(|name| rig.net().axis(name).unwrap());
        for axis in &axes {
            rig.until(axis.enable()).unwrap();
        }
        rig.run_for(1_000 * MS);
        let mut resting = Self {
            line,
            rig,
            axes,
            sent,
        };
        resting.cycle();
        resting
    }

    fn status(&self) -> [Snapshot; 2] {
        self.axes.each_ref().map(Axis::status)
    }

    /// Up to the next sending: the answer to the one before is in then.
    fn cycle(&mut self) {
        let before = self.sent.load(Ordering::Relaxed);
        while self.sent.load(Ordering::Relaxed) == before {
            assert!(self.rig.bus.turn());
        }
    }
}

#[test]
fn each_cycle_shows_in_the_status_of_an_axis_at_rest_and_nothing_else_changes() {
    let mut resting = Resting::new();
    let before = resting.status();
    for cycles in 1..=50 {
        resting.cycle();
        for (before, now) in before.into_iter().zip(resting.status()) {
            let mut expected = before;
            expected.cycle += cycles;
            assert_eq!(now, expected);
        }
    }
    assert!(before[0].cycle > 1_000);
    assert_eq!(before[0].cycle, before[1].cycle);
    resting.rig.shutdown();
}

#[test]
fn what_happens_to_an_axis_at_rest_shows_in_that_cycle_and_leaves_the_other_one_at_rest() {
    let mut resting = Resting::new();
    let before = resting.status();
    resting
        .line
        .segment()
        .axis_mut(0, 1)
        .unwrap()
        .inject_fault(0x7500);
    // The drive takes the fault in with its next cycle, and the frame that passes it then brings it.
    for cycles in 1..=3 {
        resting.cycle();
        let [x, y] = resting.status();
        assert_eq!([x.cycle, y.cycle], [before[0].cycle + cycles; 2]);
    }
    assert_ne!(resting.status()[1].state, State::OperationEnabled);
    resting.rig.run_for(100 * MS);
    let [x, y] = resting.status();
    assert_eq!((x.state, y.state), (State::OperationEnabled, State::Fault));
    assert_eq!(x.cycle, y.cycle);
    resting.rig.shutdown();
}

#[test]
fn an_axis_whose_drive_is_silent_after_a_rest_ages_with_every_cycle() {
    let mut resting = Resting::new();
    let before = resting.status()[0];
    resting.line.segment().unplug(0);
    for cycles in 1..=5 {
        resting.cycle();
        let now = resting.status()[0];
        assert_eq!(now.cycle, before.cycle + cycles);
        // The answer to the frame that was on its way had come already.
        assert_eq!(now.age, u32::try_from(cycles).unwrap() - 1);
    }
    resting.line.segment().plug();
    for _ in 0..2 {
        resting.cycle();
    }
    let now = resting.status()[0];
    assert_eq!((now.age, now.answered), (0, true));
    assert_eq!(now.cycle, before.cycle + 7);
}

/// Reads the status of an axis while it is woken.
struct Reads {
    axis: Axis,
    seen: Mutex<Vec<Snapshot>>,
}

impl Wake for Reads {
    fn wake(self: Arc<Self>) {
        self.seen.lock().unwrap().push(self.axis.status());
    }
}

#[test]
fn whoever_is_woken_by_the_end_of_a_move_reads_the_cycle_that_it_ended_in() {
    let mut resting = Resting::new();
    let axis = resting.axes[0].clone();
    let (mode, motion) = resting.rig.until(async {
        let mode = axis.profile_position().await.unwrap();
        let motion = mode.move_abs(1_000, SetPoint::new()).await.unwrap();
        (mode, motion)
    });
    let reads = Arc::new(Reads {
        axis: axis.clone(),
        seen: Mutex::default(),
    });
    let waker = Waker::from(Arc::clone(&reads));
    let mut context = Context::from_waker(&waker);
    let mut done = pin!(motion.done());
    while done.as_mut().poll(&mut context).is_pending() {
        resting.cycle();
        for seen in reads.seen.lock().unwrap().drain(..) {
            assert_eq!(seen.cycle, axis.status().cycle);
            assert_eq!(seen.position, axis.status().position);
        }
    }
    assert_eq!(axis.status().position, 1_000);
    drop(mode);
}
