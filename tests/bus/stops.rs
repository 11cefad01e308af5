//! Stops, as they are seen in the frames: each is in the next process-data frame that is sent after it was asked for.

use std::{
    future::Future,
    pin::{Pin, pin},
    sync::{Arc, Mutex},
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    Axis, Move, Network, ProfilePosition, SetPoint, StopRequest, coe::obj, drives, ds402::State,
    link::Fate, pdo_map::Direction,
};
use servocrab_sim::{Segment, ds402, personality};

use crate::rig::{Line, Rig, TAG, TAG_BYTES, akd2g, is_cyclic, unhomed};

const MS: Duration = Duration::from_millis(1);
/// First data byte of a frame's first datagram behind the tag.
const DATA: usize = TAG + TAG_BYTES + 10;

const BIT_4: u16 = 0x0010;
const HALT: u16 = 0x0100;
/// Bit 2, which is low for a quick stop.
const NO_QUICK_STOP: u16 = 0x0004;

/// The controlwords of both axes in every process-data frame.
type Words = Arc<Mutex<Vec<[u16; 2]>>>;

struct Watched {
    rig: Rig,
    words: Words,
    axes: [Axis; 2],
}

impl Watched {
    fn new() -> Self {
        let layout = drives::akd2g().default_mapping().unwrap().layout();
        let places: Vec<usize> = layout
            .objects(Direction::Outputs)
            .filter(|(object, _)| {
                object.index & 0x07FF == obj::CONTROLWORD.address().index & 0x07FF
            })
            .map(|(_, place)| place.byte)
            .collect();
        let words = Words::default();
        let seen = Arc::clone(&words);
        let line = Line::new(Segment::new().with(personality::akd2g()));
        let wire = line.wire_with(move |_, frame| {
            if is_cyclic(frame) {
                let word = |at: usize| {
                    u16::from_le_bytes([frame[DATA + places[at]], frame[DATA + places[at] + 1]])
                };
                seen.lock().unwrap().push([word(0), word(1)]);
            }
            Fate::Deliver
        });
        let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
        let axes = [rig.net().axis("x").unwrap(), rig.net().axis("y").unwrap()];
        for axis in &axes {
            rig.until(axis.enable()).unwrap();
        }
        Self { rig, words, axes }
    }

    fn mode(&mut self, axis: usize) -> ProfilePosition {
        let axis = self.axes[axis].clone();
        self.rig.until(axis.profile_position()).unwrap()
    }

    /// Both axes on their way.
    fn moving() -> (Self, Vec<(ProfilePosition, Move)>) {
        let mut watched = Self::new();
        let moves = (0..2).map(|axis| {
            let pp = watched.mode(axis);
            let moved = watched.rig.until(pp.move_abs(900_000, slow())).unwrap();
            (pp, moved)
        });
        let moves = moves.collect();
        watched.rig.run_for(100 * MS);
        (watched, moves)
    }

    /// The words of the next frame.
    fn next(&mut self) -> [u16; 2] {
        let before = self.count();
        while self.count() == before {
            assert!(self.rig.bus.turn());
        }
        self.words.lock().unwrap()[before]
    }

    fn count(&self) -> usize {
        self.words.lock().unwrap().len()
    }
}

fn slow() -> SetPoint {
    SetPoint::new()
        .velocity(10_000)
        .acceleration(100_000)
        .deceleration(100_000)
}

fn poll<T>(future: &mut Pin<&mut impl Future<Output = T>>) -> Poll<T> {
    future
        .as_mut()
        .poll(&mut Context::from_waker(Waker::noop()))
}

#[test]
fn every_kind_of_stop_is_in_the_next_frame() {
    let (mut watched, _moves) = Watched::moving();
    watched.axes[0].stop_handle().halt();
    assert_eq!(watched.next().map(|word| word & HALT), [HALT, 0]);

    let (mut watched, _moves) = Watched::moving();
    watched.axes[1].stop_handle().stop();
    assert_eq!(watched.next().map(|word| word & HALT), [0, HALT]);

    let (mut watched, _moves) = Watched::moving();
    watched.axes[0].stop_handle().quick_stop();
    assert_eq!(
        watched.next().map(|word| word & NO_QUICK_STOP),
        [0, NO_QUICK_STOP]
    );

    let (mut watched, _moves) = Watched::moving();
    watched
        .rig
        .net()
        .stop_handle()
        .stop_all(StopRequest::QUICK_STOP);
    assert_eq!(watched.next().map(|word| word & NO_QUICK_STOP), [0, 0]);

    let (mut watched, _moves) = Watched::moving();
    let axis = watched.axes[0].clone();
    let mut stop = pin!(axis.quick_stop());
    assert!(poll(&mut stop).is_pending());
    assert_eq!(
        watched.next().map(|word| word & NO_QUICK_STOP),
        [0, NO_QUICK_STOP]
    );

    let (mut watched, _moves) = Watched::moving();
    let axis = watched.axes[0].clone();
    let mut stop = pin!(axis.disable());
    assert!(poll(&mut stop).is_pending());
    assert_eq!(watched.next().map(|word| word & HALT), [HALT, 0]);
}

#[test]
fn a_stop_of_all_that_is_awaited_ends_when_all_stand_or_names_those_that_do_not() {
    let second = Duration::from_secs(1);
    let positions = |watched: &Watched| watched.axes.each_ref().map(|axis| axis.status().position);
    for stop in [
        StopRequest::STOP,
        StopRequest::QUICK_STOP,
        StopRequest::HALT,
    ] {
        let (mut watched, moves) = Watched::moving();
        let stopped = watched.rig.net().stop_all_and_wait(stop, 5 * second);
        // It waits for nobody to look at it.
        let before = watched.words.lock().unwrap().last().copied();
        assert_ne!(Some(watched.next()), before, "{stop:?}");
        watched.rig.until(stopped).unwrap();
        let rest = positions(&watched);
        watched.rig.run_for(200 * MS);
        for (now, rest) in positions(&watched).into_iter().zip(rest) {
            assert!(now.abs_diff(rest) <= 20, "{stop:?}: {rest}, then {now}");
        }
        drop(moves);
        for axis in watched.axes.clone() {
            watched.rig.until(axis.enable()).unwrap();
        }
    }
    let (mut watched, _moves) = Watched::moving();
    let stopped = watched
        .rig
        .net()
        .stop_all_and_wait(StopRequest::STOP, 2 * MS);
    let error = watched.rig.until(stopped).unwrap_err();
    let text = error.to_string();
    assert_eq!(error.axes.len(), 2, "{text}");
    assert!(
        text.starts_with("not every axis was seen to stand: "),
        "{text}"
    );
    assert!(text.contains("axis x") && text.contains("axis y"), "{text}");
}

#[test]
fn a_liveness_that_runs_out_halts_all_axes_in_the_next_frame() {
    let (mut watched, _moves) = Watched::moving();
    let live = watched.rig.net().liveness(20 * MS).unwrap();
    live.feed();
    let first = watched.rig.bus.now();
    loop {
        let words = watched.next().map(|word| word & HALT);
        let age = watched.rig.bus.now() - first;
        if words == [HALT; 2] {
            assert!(age > 20 * MS && age <= 23 * MS, "{age:?}");
            break;
        }
        assert_eq!(words, [0; 2]);
        assert!(age <= 23 * MS, "{age:?}");
    }
}

#[test]
fn a_stop_overtakes_a_full_queue() {
    let (mut watched, moves) = Watched::moving();
    let pp = &moves[0].0;
    let mut queued: Vec<_> = (0..100).map(|n| Box::pin(pp.move_abs(n, slow()))).collect();
    let full = queued
        .iter_mut()
        .map(|task| poll(&mut task.as_mut()).is_ready())
        .filter(|refused| *refused)
        .count();
    assert!(full > 0);
    let axis = watched.axes[0].clone();
    let mut stop = pin!(axis.quick_stop());
    assert!(poll(&mut stop).is_pending(), "it has a place of its own");
    assert_eq!(watched.next()[0] & (NO_QUICK_STOP | BIT_4), 0);
}

#[test]
fn a_stop_is_not_held_up_by_a_mailbox_at_work() {
    let (mut watched, _moves) = Watched::moving();
    let sdo = watched.rig.net().sdo(0).unwrap();
    let mut reads: Vec<_> = (0..10)
        .map(|_| Box::pin(sdo.read_bytes(0x1018, 2)))
        .collect();
    for read in &mut reads {
        assert!(poll(&mut read.as_mut()).is_pending());
    }
    for _ in 0..5 {
        assert!(watched.rig.bus.turn());
    }
    watched.axes[0].stop_handle().quick_stop();
    assert_eq!(watched.next()[0] & NO_QUICK_STOP, 0);
}

#[test]
fn a_stop_of_one_axis_withdraws_a_group_that_is_about_to_start_whenever_it_comes() {
    let mut seen = [false; 2];
    for turns in 0..60 {
        let mut watched = Watched::new();
        let modes = [watched.mode(0), watched.mode(1)];
        let requests = modes.each_ref().map(|pp| pp.abs(1_000, slow()));
        let mut together = pin!(servocrab::start_together(requests));
        assert!(poll(&mut together).is_pending());
        for _ in 0..turns {
            assert!(watched.rig.bus.turn());
        }
        let from = watched.count();
        watched.axes[1].stop_handle().quick_stop();
        let word = watched.next();
        assert_eq!(word[1] & NO_QUICK_STOP, 0, "in the next frame");
        let risen =
            |words: &[[u16; 2]]| [0, 1].map(|axis| words.iter().any(|w| w[axis] & BIT_4 != 0));
        let before = risen(&watched.words.lock().unwrap()[..from]);
        watched.rig.run_for(20 * MS);
        let after = risen(&watched.words.lock().unwrap());
        assert_eq!(after[0], after[1], "all or none");
        assert_eq!(before, after, "nothing rises once the stop was asked for");
        seen[usize::from(after[0])] = true;
    }
    assert_eq!(
        seen, [true; 2],
        "stops before and after the rise were tried"
    );
}

#[test]
fn a_stop_while_the_network_ends_is_in_the_next_frame() {
    let (mut watched, _moves) = Watched::moving();
    let net = watched.rig.net.take().unwrap();
    let mut over = pin!(net.shutdown());
    assert!(poll(&mut over).is_pending());
    // The end halts first; the quick stop need not wait for the standstill.
    while watched.next()[0] & HALT == 0 {}
    watched.axes[0].stop_handle().quick_stop();
    assert_eq!(
        watched.next().map(|word| word & NO_QUICK_STOP),
        [0, NO_QUICK_STOP]
    );
    watched.rig.bus.run();
    assert!(poll(&mut over).is_ready());
}

#[test]
fn an_axis_that_a_network_finds_moving_is_stopped_before_it_is_switched_off() {
    // Where in a cycle OP is asked for differs.
    for period in [MS, 2 * MS, 5 * MS, 10 * MS] {
        finds_it_moving(period);
    }
}

fn finds_it_moving(period: Duration) {
    let line = Line::new(Segment::new().with(personality::generic()));
    let config = || unhomed(drives::generic(), &["z"]);
    let mut killed = Rig::start(Network::builder().link(line.wire()).drive(0, config())).unwrap();
    let motion = killed.starts_a_long_move("z");
    let mut segment = line.segment();
    let drive = segment.axis_mut(0, 0).unwrap();
    // Somebody has told it to do nothing when it loses its connection; its quick stop takes half a second.
    drive.set(0x6007, 0, 0).unwrap();
    drive.set(0x6085, 0, 20_000).unwrap();
    drop(segment);
    let begin = killed.bus.now();
    // The program ends without a word.
    drop(killed.bus);
    drop((motion, killed.net));

    let words = Arc::new(Mutex::new(Vec::new()));
    let (seen, watched) = (Arc::clone(&words), line.clone());
    let wire = line.wire_from(begin).with_plan(move |_, _| {
        let segment = watched.segment();
        let drive = segment.axis(0, 0).unwrap();
        // No faster than what the drive itself takes for a standstill.
        let standstill = f64::from(drive.plant().standstill_velocity);
        let stands = drive.velocity().abs() <= standstill;
        seen.lock().unwrap().push((drive.state(), stands));
        Fate::Deliver
    });
    let builder = Network::builder().link(wire).cycle(period);
    let mut rig = Rig::start(builder.drive(0, config())).unwrap();
    rig.run_for(1_000 * MS);
    assert_eq!(
        rig.net().axis("z").unwrap().status().state,
        State::SwitchOnDisabled
    );
    let words = words.lock().unwrap();
    let stops = |&(state, _): &(_, bool)| state == ds402::State::QuickStopActive;
    assert!(words.iter().any(stops), "it was stopped");
    let coasting = words.iter().find(|(state, stands)| {
        !stands
            && !matches!(
                state,
                ds402::State::OperationEnabled | ds402::State::QuickStopActive
            )
    });
    assert_eq!(coasting, None);
}
