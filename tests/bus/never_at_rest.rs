//! An axis that never stands as the library sees it: its encoder is noisy, or its load swings it to and fro. Each way out ends without
//! power all the same, when the deadline for standstill has passed since the stop began, and says why.

use std::{
    f64::consts::TAU,
    future::Future,
    pin::{Pin, pin},
    sync::{Arc, Mutex},
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    Axis, AxisError, Failure, Move, Network, NetworkError, ProfilePosition, SetPoint,
    axis::{Deadlines, WaitingFor},
    drives,
    link::Wire,
    pdo_map::Direction,
};
use servocrab_sim::{Segment, ds402, personality};

use crate::rig::{Line, Rig, TAG, TAG_BYTES, datagrams, is_cyclic, unhomed};

const MS: Duration = Duration::from_millis(1);
/// `Deadlines::standstill`. The ramp of each stop here takes a quarter of a second.
const DEADLINE: Duration = Duration::from_secs(2);
/// From what is asked for to its frame, and from a deadline to the word that answers it.
const FEW_CYCLES: Duration = Duration::from_millis(6);
/// First data byte of a frame's first datagram behind the tag.
const DATA: usize = TAG + TAG_BYTES + 10;

/// What 6064h shows beside the shaft. The position window has 10 counts.
#[derive(Debug, Clone, Copy)]
enum Unrest {
    /// Up to 20 counts more or less, anew in each cycle.
    Noise,
    /// 30 counts to and fro, eight times a second: at no turn it stays within the window for the settle time.
    Swing,
}

impl Unrest {
    fn counts(self, now: Duration) -> i32 {
        match self {
            Self::Noise => {
                let cycle = (now.as_micros() / 1_000) as u32;
                let mixed = cycle.wrapping_mul(2_654_435_761) >> 16;
                (mixed % 41) as i32 - 20
            }
            Self::Swing => (30.0 * (TAU * 8.0 * now.as_secs_f64()).sin()).round() as i32,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Before {
    AtRest,
    InMotion,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    Disable,
    Stop,
    QuickStop,
    Shutdown,
    HandleDropped,
}

/// A frame with process data: when it was sent, the word, and the drive's state before it.
type Sent = (Duration, u16, ds402::State);

struct Bench {
    rig: Rig,
    line: Line,
    sent: Arc<Mutex<Vec<Sent>>>,
    unrest: Arc<Mutex<Option<Unrest>>>,
    /// Keeps the mode, and the set-point that is under way or halted.
    motion: Option<(ProfilePosition, Move)>,
}

impl Bench {
    fn new(option: i64, unrest: Unrest, before: Before, way: Way) -> Self {
        let line = Line::ideal(Segment::new().with(personality::generic()));
        {
            let mut segment = line.segment();
            let drive = segment.axis_mut(0, 0).unwrap();
            drive.set(0x605A, 0, option).unwrap();
            drive.set(0x6085, 0, 200_000).unwrap();
        }
        let (sent, shown) = <(Arc<Mutex<Vec<Sent>>>, Arc<Mutex<Option<Unrest>>>)>::default();
        let deadlines = Deadlines {
            standstill: DEADLINE,
            ..Deadlines::default()
        };
        let config =
            unhomed(drives::generic(), &["x"]).change_axis("x", |axis| axis.deadlines(deadlines));
        let network = Network::builder().drive(0, config);
        let network = network.link(wire(&line, &sent, &shown));
        let mut bench = Self {
            rig: Rig::start(network).unwrap(),
            line,
            sent,
            unrest: shown,
            motion: None,
        };
        let axis = bench.axis();
        bench.rig.until(axis.enable()).unwrap();
        // A handle that is dropped stops nothing where there is no set-point: it gets one that is halted.
        if before == Before::InMotion || way == Way::HandleDropped {
            let set_point = SetPoint::new()
                .velocity(50_000)
                .acceleration(200_000)
                .deceleration(200_000);
            bench.motion = Some(bench.rig.until(async {
                let mode = axis.profile_position().await.unwrap();
                let motion = mode.move_abs(10_000_000, set_point).await.unwrap();
                (mode, motion)
            }));
            bench.rig.run_for(500 * MS);
            if before == Before::AtRest {
                bench.rig.until(axis.halt()).unwrap();
            }
        }
        *bench.unrest.lock().unwrap() = Some(unrest);
        bench.rig.run_for(300 * MS);
        assert_eq!(bench.velocity() > 0.0, before == Before::InMotion);
        bench
    }

    fn axis(&self) -> Axis {
        self.rig.net().axis("x").unwrap()
    }

    fn velocity(&self) -> f64 {
        self.line.segment().axis(0, 0).unwrap().velocity()
    }

    /// Takes this way out, and runs on until well after the deadline. What a caller gets, as text.
    fn leaves(&mut self, way: Way) -> Option<String> {
        let axis = self.axis();
        let until = self.rig.bus.now() + DEADLINE + DEADLINE / 2;
        let told = match way {
            Way::Disable => Some(failed(self.rig.until(axis.disable()))),
            Way::Stop => Some(failed(self.rig.until(axis.stop()))),
            Way::QuickStop => Some(failed(self.rig.until(axis.quick_stop()))),
            Way::HandleDropped => {
                drop((axis, self.motion.take()));
                None
            }
            Way::Shutdown => {
                let net = self.rig.net.take().unwrap();
                let mut over = pin!(net.shutdown());
                assert!(poll(&mut over).is_pending());
                while self.rig.bus.turn() {}
                let Poll::Ready(Err(error)) = poll(&mut over) else {
                    panic!("it says that the axis stands");
                };
                assert!(matches!(error, NetworkError::StillMoving(_)), "{error}");
                return Some(error.to_string());
            }
        };
        while self.rig.bus.now() < until {
            assert!(self.rig.bus.turn());
        }
        told
    }
}

/// A wire that notes what reaches the drive, and adds the unrest to 6064h of each answer.
fn wire(line: &Line, sent: &Arc<Mutex<Vec<Sent>>>, unrest: &Arc<Mutex<Option<Unrest>>>) -> Wire {
    let layout = drives::generic().default_mapping().unwrap().layout();
    let byte = |direction, index| layout.find(direction, index, 0).unwrap().byte;
    let controlword = DATA + byte(Direction::Outputs, 0x6040);
    let position = DATA + layout.output_bytes() + byte(Direction::Inputs, 0x6064);
    let (segment, sent, unrest) = (line.clone(), Arc::clone(sent), Arc::clone(unrest));
    Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        let mut segment = segment.segment();
        // LRW.
        let is_cyclic = is_cyclic(frame) && datagrams(frame)[1][0] == 12;
        if is_cyclic {
            let word = u16::from_le_bytes([frame[controlword], frame[controlword + 1]]);
            let state = segment.axis(0, 0).unwrap().state();
            sent.lock().unwrap().push((now, word, state));
        }
        let answers = segment.process(frame, now);
        if is_cyclic && let Some(unrest) = *unrest.lock().unwrap() {
            let shown = frame[position..].first_chunk_mut::<4>().unwrap();
            let more = i32::from_le_bytes(*shown) + unrest.counts(now);
            *shown = more.to_le_bytes();
        }
        answers
    })
}

/// The text of a failure that says that the axis was not seen to stand.
fn failed<T: std::fmt::Debug>(result: Result<T, AxisError>) -> String {
    let error = result.unwrap_err();
    let Some(Failure::Timeout { waiting_for, .. }) = error.failure() else {
        panic!("{error}");
    };
    assert!(matches!(waiting_for, WaitingFor::Standstill(_)), "{error}");
    error.to_string()
}

fn poll<T>(future: &mut Pin<&mut impl Future<Output = T>>) -> Poll<T> {
    future
        .as_mut()
        .poll(&mut Context::from_waker(Waker::noop()))
}

/// Whether a drive with power keeps it, and a brake, by this word.
fn keeps_power(word: u16) -> bool {
    matches!(word & 0x8F, 0x0F | 0x0B)
}

fn way_out(way: Way) {
    for option in [1, 2, 5, 6] {
        for unrest in [Unrest::Noise, Unrest::Swing] {
            for before in [Before::AtRest, Before::InMotion] {
                let case = format!("605Ah = {option}, {unrest:?}, {before:?}, {way:?}");
                let mut bench = Bench::new(option, unrest, before, way);
                let asked = bench.rig.bus.now();
                let told = bench.leaves(way);
                let sent = bench.sent.lock().unwrap();
                let after = |time: Duration| sent.iter().filter(move |(at, ..)| *at >= time);
                let (off, word, _) = after(asked)
                    .find(|(_, word, _)| !keeps_power(*word))
                    .unwrap_or_else(|| panic!("{case}: it keeps its power"));
                let took = *off - asked;
                assert!(took >= DEADLINE, "{case}: {word:04X}h after {took:?}");
                assert!(took <= DEADLINE + FEW_CYCLES, "{case}: {took:?}");
                for (at, word, state) in after(*off + FEW_CYCLES) {
                    let has_power = matches!(
                        state,
                        ds402::State::SwitchedOn
                            | ds402::State::OperationEnabled
                            | ds402::State::QuickStopActive
                    );
                    assert!(
                        *word == 0 && !has_power,
                        "{case}: {word:04X}h, {state:?} at {at:?}"
                    );
                }
                if let Some(told) = told {
                    assert!(told.contains("stand"), "{case}: {told}");
                }
            }
        }
    }
}

#[test]
fn a_disable_takes_the_power_of_an_axis_that_never_stands() {
    way_out(Way::Disable);
}

#[test]
fn a_stop_takes_the_power_of_an_axis_that_never_stands() {
    way_out(Way::Stop);
}

#[test]
fn a_quick_stop_takes_the_power_of_an_axis_that_never_stands() {
    way_out(Way::QuickStop);
}

#[test]
fn a_shutdown_takes_the_power_of_an_axis_that_never_stands() {
    way_out(Way::Shutdown);
}

#[test]
fn a_dropped_handle_takes_the_power_of_an_axis_that_never_stands() {
    way_out(Way::HandleDropped);
}
