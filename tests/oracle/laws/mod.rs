//! The laws. Those of the words (`words`) and of stops (`stops`) hold whatever the drive does, and so does that every future ends
//! (`waits`). The others, of what is said of set-points (`outcomes`), hold within the model.

mod outcomes;
mod stops;
mod waits;
mod words;

use core::time::Duration;
use std::collections::VecDeque;

use servocrab::StopRequest;
use servocrab::profile_position::{BufferSignal, RelativeBase};

use crate::cable::Told;
use crate::making::Made;
use crate::scenario::{Kind, Scenario};

/// What the laws keep in mind.
#[derive(Default)]
pub struct Watch {
    window: f64,
    /// Cycles of the settle time.
    pub settle: usize,
    pub halt_coasts: bool,
    /// The core knows what distances count from, and where bit 12 shows room.
    base_is_known: bool,
    room_is_shown: bool,
    /// After so many cycles the drive has surely seen a word, and after so many more its answer is here.
    seen: u64,
    answer: u64,
    /// Cycles that commands with deadlines may take, a stop, a set-point that nothing is in the way of, its beginning, and its acknowledge.
    limit: u64,
    stop_limit: u64,
    send_limit: u64,
    begin_limit: u64,
    acknowledge: u64,

    /// The last positions of the axis, newest last, and whether inputs came in that cycle.
    trail: VecDeque<(f64, bool)>,
    /// The last cycle without inputs.
    blind: u64,
    /// Since which cycle the words lead down or stop.
    stopping_since: Option<u64>,
    resume_asked: bool,
    /// When somebody asked last for a stop that gives up the set-point.
    stop_asked: u64,
    /// Since when bit 8 has been sent, and quick stop.
    halting_since: Option<u64>,
    quick_since: Option<u64>,
    /// What was asked for since the last frame.
    asked: Asked,
    /// Cycles after which an axis may lose its brake.
    standstill: u64,
    /// Whether the last sample showed Operation enabled, in Profile Position.
    drives: bool,
    /// When bit 4 is known to have been delivered low first, and whether bit 12 was high then.
    low: Option<(Duration, bool)>,
    /// It is open whether the drive holds a set-point: none goes out before a stop.
    needs_stop: bool,
    stale_cycles: u32,
    undelivered_cycles: u32,
    lost: bool,
    /// The axis has had nothing to do since then.
    at_rest_since: u64,
    /// When something was in the way of the next set-point last, and when that or a bit 12 that is high.
    hindered: u64,
    blocked: u64,
    ledger_seen: usize,
}

#[derive(Debug, Clone, Copy, Default)]
struct Asked {
    stop: bool,
    halt: bool,
    resume: bool,
}

impl Watch {
    pub fn new(made: &Made) -> Self {
        let (config, period) = (&made.config, made.period);
        let (tolerances, deadlines) = (&config.tolerances, &config.deadlines);
        let cycles = |time: Duration| (time.as_micros() / period.as_micros()) as u64;
        let settle = tolerances.settle.as_micros().div_ceil(period.as_micros()) as usize;
        let longest = deadlines.enable
            + deadlines.disable
            + 2 * deadlines.acknowledge
            + 3 * deadlines.standstill
            + deadlines.mode
            + 3 * (deadlines.fault_reset + Duration::from_millis(100))
            + 2 * tolerances.settle;
        let seen = cycles(config.traits.surely_seen());
        Self {
            window: f64::from(tolerances.position),
            settle,
            halt_coasts: config.stop_options.halt == Some(0),
            base_is_known: config.traits.relative_base != RelativeBase::Undocumented,
            room_is_shown: config.traits.buffer_signal == BufferSignal::Acknowledge,
            seen,
            answer: 2 * seen + 2 * made.slow + 1,
            limit: cycles(longest + Duration::from_secs(1)),
            standstill: cycles(deadlines.standstill),
            stop_limit: cycles(deadlines.standstill + 2 * tolerances.settle) + 20,
            send_limit: cycles(deadlines.acknowledge + deadlines.begin + 2 * tolerances.settle)
                + 20,
            begin_limit: cycles(
                2 * deadlines.begin + deadlines.acknowledge + 4 * tolerances.settle,
            ) + 200,
            acknowledge: cycles(deadlines.acknowledge),
            ..Self::default()
        }
    }
}

impl Scenario {
    /// Somebody is about to ask for this.
    pub fn note_asked(&mut self, kind: Kind) {
        let watch = &mut self.watch;
        watch.asked.stop |= kind.stops();
        watch.asked.halt |= kind.stops() && kind != Kind::QuickStop;
        watch.asked.resume |= kind == Kind::Resume;
        watch.resume_asked |= kind == Kind::Resume || kind == Kind::Hold;
        if kind.stops() && kind != Kind::Halt && kind != Kind::Hold {
            watch.stop_asked = self.cycle;
        }
    }

    pub fn note_lane(&mut self, lane: StopRequest) {
        let watch = &mut self.watch;
        watch.asked.stop = true;
        watch.asked.halt |= lane.intersects(StopRequest::HALT | StopRequest::STOP);
        if lane.intersects(StopRequest::STOP | StopRequest::QUICK_STOP) {
            watch.stop_asked = self.cycle;
        }
    }

    /// The laws of a cycle of the host.
    pub fn judge_step(&mut self) -> Result<(), ()> {
        if let Some(differs) = self.host.differs.take() {
            return self.broken("both ways to step come to the same", differs);
        }
        if self.is_inside() {
            self.judge_loss()?;
        }
        if self.told != Told::Stale && !self.sample.is_enabled() {
            self.watch.needs_stop = false;
        }
        if self.ran.is_multiple_of(128) {
            self.judge_waits()?;
        }
        Ok(())
    }

    /// The laws of what the drive has done in a cycle.
    pub fn judge_drive(&mut self, seen: bool) -> Result<(), ()> {
        let watch = &mut self.watch;
        if !seen {
            watch.blind = self.cycle;
        }
        if watch.trail.len() >= 2 * watch.settle + watch.answer as usize + 32 {
            watch.trail.pop_front();
        }
        watch.trail.push_back((self.drive.position, seen));
        self.match_ledger()?;
        self.note_rest(seen);
        self.judge_set_point()?;
        self.note_hindrance(seen);
        Ok(())
    }

    /// Whether the axis truly moves: faster than what standstill permits, and by more than that.
    pub fn is_moving(&self) -> bool {
        let settle = self.watch.settle as f64 * self.period.as_secs_f64();
        self.drive.velocity.abs() * settle >= self.watch.window / 2.0 && !self.stood(0)
    }

    /// Whether the axis, `ago` cycles before now, had stayed where it was for the settle time.
    fn stood(&self, ago: usize) -> bool {
        let watch = &self.watch;
        self.stayed(watch.settle, 2.5 * watch.window, ago)
    }

    /// Whether the axis has stayed where it is for so long that nobody can miss it.
    pub fn surely_stood(&self) -> bool {
        let watch = &self.watch;
        let cycles = 2 * watch.settle + watch.answer as usize;
        watch.trail.len() > cycles && self.stayed(cycles, watch.window / 2.0, 1)
    }

    /// Whether in so many cycles up to `ago` cycles before now it has stayed within this, and what 6064h adds to that.
    fn stayed(&self, cycles: usize, within: f64, ago: usize) -> bool {
        let trail = &self.watch.trail;
        let end = trail.len().saturating_sub(ago);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut unseen = 0;
        for &(position, seen) in trail.range(end.saturating_sub(cycles)..end) {
            unseen = if seen { 0 } else { unseen + 1 };
            // 6064h is what was seen. Where nothing was for longer than that, what was before it says nothing.
            if seen || unseen > self.watch.settle * 3 / 8 {
                low = low.min(position);
                high = high.max(position);
            }
        }
        high - low <= within + 2.0 * f64::from(self.drive.making.dither) + 4.0
    }
}
