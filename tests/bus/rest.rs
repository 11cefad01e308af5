//! Axes at rest, which the bus thread passes over: nothing of it is to be seen.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use servocrab::{Axis, Network, axis::Snapshot, ds402::State, link::Fate};
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
