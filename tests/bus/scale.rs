//! Lines of 1 to 256 axes: process data in several frames, each axis with bytes of its own, each drive with a working counter that
//! is judged with those of its own frame alone.

use std::{
    collections::BTreeMap,
    future::Future,
    sync::{
        Arc, Mutex,
        atomic::{AtomicUsize, Ordering::Relaxed},
    },
    task::{Context, Waker},
    time::Duration,
};

use servocrab::{
    AxisConfig, DriveConfig, Network, Outcome, Referencing, SetPoint,
    bus::{DistributedClock, NetworkBuilder},
    drives,
    link::{Fate, Wire},
};
use servocrab_sim::{Device, Segment, personality};

use crate::{
    cable::Cable,
    rig::{Line, Rig, TAG, TAG_BYTES, is_cyclic},
    sdo::all,
};

/// Process data of the default mappings: 19 bytes of outputs and 11 of inputs for each axis.
const BYTES_OF_AN_AXIS: usize = 30;
/// More than this and the tag, the AL status, four mailbox states and a reference time no longer fit beside the LRW.
const MOST_IN_A_FRAME: usize = 1388;
const MS: Duration = Duration::from_millis(1);

/// How many axes each drive of a line has.
type Drives = Vec<usize>;

/// `drives` times a drive of two axes.
fn of_two(drives: usize) -> Drives {
    vec![2; drives]
}

/// A drive of two axes and two of one, in turn.
fn mixed(axes: usize) -> Drives {
    let mut left = axes;
    let mut drives = Vec::new();
    for most in [2, 1, 1].into_iter().cycle() {
        if left == 0 {
            break;
        }
        drives.push(most.min(left));
        left -= most.min(left);
    }
    drives
}

fn line(drives: &Drives) -> Line {
    let device = |axes: &usize| -> Device {
        if *axes == 2 {
            personality::akd2g()
        } else {
            personality::generic()
        }
    };
    Line::new(
        drives
            .iter()
            .map(device)
            .fold(Segment::new(), Segment::with),
    )
}

fn network(wire: Wire, drives: &Drives, clock: bool) -> NetworkBuilder {
    // One more for each axis of the line.
    let mut number = 0;
    let mut name = || {
        number += 1;
        format!("{}", number - 1)
    };
    let mut builder = Network::builder().link(wire);
    for (position, axes) in (0..).zip(drives) {
        let description = if *axes == 2 {
            drives::akd2g()
        } else {
            drives::generic()
        };
        let config = (0..*axes).fold(DriveConfig::new(description), |config, _| {
            let name = name();
            config.axis(AxisConfig::new(&name).referencing(Referencing::UnreferencedMovesAllowed))
        });
        let config = if clock {
            config.dc(DistributedClock::new(0x0300))
        } else {
            config
        };
        builder = builder.drive(position, config);
    }
    builder
}

/// What happens to one frame of a cycle.
const NOTHING: usize = 0;
const LOST_ONCE: usize = 1;
const MISCOUNTED: usize = 2;

/// What is seen of the cycles' frames, and done to them.
#[derive(Default)]
struct Watch {
    /// The lengths of a cycle's frames, by their place in it.
    lengths: Mutex<BTreeMap<u8, usize>>,
    done: AtomicUsize,
    to: AtomicUsize,
}

impl Watch {
    fn fate(&self, frame: &[u8]) -> Fate {
        let place = frame[TAG + 1];
        self.lengths.lock().unwrap().insert(place, frame.len());
        if self.to.load(Relaxed) != usize::from(place) {
            return Fate::Deliver;
        }
        match self.done.load(Relaxed) {
            LOST_ONCE => {
                self.done.store(NOTHING, Relaxed);
                Fate::LoseRequest
            }
            // The high byte of its first working counter.
            MISCOUNTED => {
                let length = u16::from_le_bytes([frame[38], frame[39]]) & 0x07FF;
                Fate::Corrupt(TAG + TAG_BYTES + 10 + usize::from(length) + 1)
            }
            _ => Fate::Deliver,
        }
    }

    /// From the next cycle on.
    fn disturb(&self, what: usize, frame: usize) {
        self.to.store(frame, Relaxed);
        self.done.store(what, Relaxed);
    }

    fn lengths(&self) -> Vec<usize> {
        self.lengths.lock().unwrap().values().copied().collect()
    }
}

/// A line in OP.
struct Scale {
    drives: Drives,
    line: Line,
    rig: Rig,
    watch: Arc<Watch>,
}

impl Scale {
    fn start(drives: Drives) -> Self {
        Self::with(drives, false)
    }

    fn with(drives: Drives, clock: bool) -> Self {
        let line = line(&drives);
        let watch = Arc::new(Watch::default());
        let looks = Arc::clone(&watch);
        let wire = line.wire_with(move |_, frame| {
            if is_cyclic(frame) {
                looks.fate(frame)
            } else {
                Fate::Deliver
            }
        });
        let mut rig = Rig::start(network(wire, &drives, clock)).unwrap();
        rig.run_for(2 * MS);
        Self {
            drives,
            line,
            rig,
            watch,
        }
    }

    /// The frame in which each axis has its bytes, counted out by hand.
    fn frames(&self) -> Vec<usize> {
        let (mut frame, mut used) = (0, 0);
        let mut frames = Vec::new();
        for axes in &self.drives {
            let bytes = axes * BYTES_OF_AN_AXIS;
            if used + bytes > MOST_IN_A_FRAME {
                (frame, used) = (frame + 1, 0);
            }
            used += bytes;
            frames.extend(vec![frame; *axes]);
        }
        frames
    }

    /// Enables these axes, gives each a target of its own, all at once, and says where they arrived.
    fn move_each(&mut self, axes: &[usize], target: fn(usize) -> i32) -> Vec<Outcome> {
        let moves = axes.iter().map(|number| {
            let axis = self.rig.net().axis(&number.to_string()).unwrap();
            let target = target(*number);
            async move {
                axis.enable().await.unwrap();
                let mode = axis.profile_position().await.unwrap();
                let motion = mode.move_abs(target, FAST).await.unwrap();
                motion.done().await.unwrap()
            }
        });
        let moves = all(moves.collect());
        self.rig.until(moves)
    }

    /// The targets that each axis of the line has executed.
    fn executed(&self) -> Vec<Vec<i32>> {
        let segment = self.line.segment();
        let axes = segment.devices().iter().flat_map(Device::axes);
        axes.map(|axis| axis.ledger().iter().map(|line| line.value).collect())
            .collect()
    }

    fn axes(&self) -> usize {
        self.drives.iter().sum()
    }
}

/// Over in some 20 ms.
const FAST: SetPoint = SetPoint::new()
    .velocity(1_000_000)
    .acceleration(100_000_000)
    .deceleration(100_000_000);

/// A target that no other axis has.
fn own_target(axis: usize) -> i32 {
    1_000 + 7 * axis as i32
}

/// Brings the line up and moves these axes, all at once.
fn each_axis_gets_its_own(drives: Drives, moved: impl Fn(usize) -> bool, frames: usize) {
    let mut scale = Scale::start(drives);
    assert_eq!(scale.watch.lengths().len(), frames);
    let axes: Vec<_> = (0..scale.axes()).filter(|axis| moved(*axis)).collect();
    let outcomes = scale.move_each(&axes, own_target);
    for (axis, outcome) in axes.iter().zip(outcomes) {
        let position = outcome.position();
        assert!(
            (position - own_target(*axis)).abs() < 20,
            "{axis}: {position}"
        );
    }
    let expected = (0..scale.axes()).map(|axis| {
        if moved(axis) {
            vec![own_target(axis)]
        } else {
            Vec::new()
        }
    });
    assert_eq!(scale.executed(), expected.collect::<Vec<_>>());
    let statistics = scale.rig.net().statistics();
    let wrong = (statistics.lost, statistics.late, statistics.foreign);
    assert_eq!(wrong, (0, 0, 0), "{statistics:?}");
    scale.rig.shutdown();
}

#[test]
fn each_of_1_and_8_and_64_axes_executes_its_own_target_once() {
    each_axis_gets_its_own(mixed(1), |_| true, 1);
    each_axis_gets_its_own(mixed(8), |_| true, 1);
    each_axis_gets_its_own(mixed(64), |_| true, 2);
}

#[test]
fn of_128_axes_on_drives_of_one_and_two_each_executes_its_own_target_once() {
    each_axis_gets_its_own(mixed(128), |_| true, 3);
}

#[test]
fn of_256_axes_on_128_drives_each_executes_its_own_target_once() {
    each_axis_gets_its_own(of_two(128), |axis| axis % 5 != 4, 6);
}

#[test]
fn a_lost_frame_of_several_blinds_its_own_drives_alone() {
    let mut scale = Scale::start(mixed(128));
    let frames = scale.frames();
    for lost in 0..=frames[127] {
        let before = scale.rig.net().statistics();
        scale.watch.disturb(LOST_ONCE, lost);
        while scale.rig.net().statistics().lost == before.lost {
            assert!(scale.rig.bus.turn());
        }
        let blind: Vec<_> = (0..128)
            .filter(|axis| {
                let axis = scale.rig.net().axis(&axis.to_string()).unwrap();
                axis.status().age != 0
            })
            .collect();
        let in_it: Vec<_> = (0..128).filter(|axis| frames[*axis] == lost).collect();
        assert_eq!(blind, in_it, "frame {lost}");
        let after = scale.rig.net().statistics();
        assert_eq!(after.wrong_working_counters, before.wrong_working_counters);
        scale.rig.run_for(5 * MS);
    }
    scale.rig.shutdown();
}

#[test]
fn a_wrong_working_counter_holds_the_handshakes_of_its_own_datagram_alone() {
    let mut scale = Scale::start(mixed(128));
    let frames = scale.frames();
    let others = [0, 64];
    let held = 127;
    assert!(others.iter().all(|axis| frames[*axis] != frames[held]));
    // Enabled, and in Profile Position.
    scale.move_each(&[0, 64, 127], |_| 100);
    let motion = |axis: usize| {
        let axis = scale.rig.net().axis(&axis.to_string()).unwrap();
        async move {
            axis.enable().await.unwrap();
            let mode = axis.profile_position().await.unwrap();
            mode.move_abs(own_target(127), FAST).await.map(drop)
        }
    };
    let before = scale.rig.net().statistics();
    let (others, mut held) = (all(others.map(motion).into()), Box::pin(motion(held)));
    scale.watch.disturb(MISCOUNTED, frames[127]);
    scale.rig.until(others).into_iter().for_each(Result::unwrap);
    let mut context = Context::from_waker(Waker::noop());
    assert!(held.as_mut().poll(&mut context).is_pending());
    let after = scale.rig.net().statistics();
    // One in each cycle, of the one datagram.
    let cycles = after.cycles - before.cycles;
    let wrong = after.wrong_working_counters - before.wrong_working_counters;
    assert!(
        wrong > 2 && cycles.abs_diff(wrong) <= 1,
        "{wrong} in {cycles}"
    );
    scale.watch.disturb(NOTHING, 0);
    scale.rig.until(held).unwrap();
    scale.rig.run_for(50 * MS);
    let executed = scale.executed();
    for axis in [0, 64, 127] {
        assert_eq!(executed[axis], [100, own_target(127)], "{axis}");
    }
    scale.rig.shutdown();
}

#[test]
fn the_cycles_frames_are_as_long_as_the_page_says() {
    for clock in [false, true] {
        for drives in [vec![1; 1], vec![1; 8], of_two(4), vec![1; 47], of_two(64)] {
            let cable = Cable {
                drives: drives.len(),
                bytes: drives[0] * BYTES_OF_AN_AXIS,
                clock,
                metres: 0,
            };
            let scale = Scale::with(drives, clock);
            assert_eq!(scale.watch.lengths(), cable.frames(), "{cable:?}");
            scale.rig.shutdown();
        }
    }
}

/// A row of the page for drives of `in_a_drive` axes, with distributed clocks and two metres of cable to each drive.
fn row(axes: usize, in_a_drive: usize) -> String {
    let drives = axes.div_ceil(in_a_drive);
    let cable = Cable {
        drives,
        bytes: in_a_drive * BYTES_OF_AN_AXIS,
        clock: true,
        metres: 2 * drives,
    };
    let frames = cable.frames();
    let bytes: usize = frames.iter().sum();
    let micros = cable.nanoseconds() as f64 / 1e3;
    // The library waits for its frames for three quarters of a cycle.
    let cycle = micros * 4.0 / 3.0;
    format!(
        "| {axes} | {drives} | {} | {bytes} | {micros:.0} | {cycle:.0} |",
        frames.len()
    )
}

#[test]
fn the_pages_table_is_what_the_formula_gives() {
    let page = include_str!("../../docs/scaling.md");
    let (_, table) = page.split_once("| axes | devices |").unwrap();
    let rows = table
        .lines()
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    let mut count = 0;
    for line in rows {
        let mut numbers = line.split('|').skip(1).map(|cell| cell.trim().parse());
        let mut number = || numbers.next().unwrap().unwrap();
        let (axes, devices): (usize, usize) = (number(), number());
        assert_eq!(line, row(axes, axes / devices));
        count += 1;
    }
    assert_eq!(count, 11);
}
