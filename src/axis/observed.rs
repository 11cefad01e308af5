//! What the cycles bring: inputs or none, what they show, whether the axis stands, and when its drive counts as lost.
//!
//! Here alone a statusword becomes evidence: D1 and D2 of docs/fault-model.md are applied, so that no other file looks at a bit that may
//! be wrong.

use core::time::Duration;

use crate::{
    ds402::{Mode, Sample, State, Statusword},
    profile_position::{Bounds, Evidence, LastSeen, ShownBit, Standstill},
    timer::{Due, Elapsed, nanoseconds},
};

use super::{CoreConfig, Inputs, Loss, snapshot::SnapshotChange};

/// What was seen of an axis.
#[derive(Debug, Clone, Hash)]
pub(super) struct Observed {
    /// The last sample.
    pub sample: Option<Sample>,
    /// The position before it.
    before: i32,
    rest: Option<i32>,
    pub standstill: Standstill,
    reached: ShownBit,
    acknowledge: ShownBit,
    error: ShownBit,
    pub link: Link,
    /// 6061h where it is read by SDO.
    noted_mode: Mode,
    /// Before the last one samples were missing for so long that an axis that settles may have left and come back.
    blind: bool,
    timing: Aside<CycleTiming>,
    last_seen: Aside<LastSeen>,
}

/// What tells no two states apart: of two cores that differ in this alone, each does what the other does.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Aside<T>(pub T);

impl<T> core::hash::Hash for Aside<T> {
    fn hash<H: core::hash::Hasher>(&self, _: &mut H) {}
}

/// When the cycles with inputs came. Those that were left out since the last one that was noted had inputs, too.
#[derive(Debug, Clone, Copy, Default)]
struct CycleTiming {
    at: u64,
    number: u64,
    /// From one to the next.
    spacing: u64,
    /// When the last one before those without inputs came.
    answered: u64,
}

impl CycleTiming {
    /// The first cycle without inputs.
    const fn begin_to_miss(&mut self, now: u64, number: u64) {
        let is_next = number.wrapping_sub(self.number) == 1;
        self.answered = if is_next {
            self.at
        } else {
            now.saturating_sub(self.spacing)
        };
    }

    /// A cycle with inputs: how long after the last one it came, and whether the host has stood still meanwhile.
    const fn note(&mut self, now: u64, number: u64) -> (Elapsed, bool) {
        let elapsed = now.saturating_sub(self.at);
        let cycles = number.wrapping_sub(self.number);
        let expected = self.spacing.saturating_mul(cycles);
        let stalled = expected > 0 && elapsed > expected.saturating_mul(2);
        if cycles == 1 {
            self.spacing = elapsed;
        }
        (self.at, self.number) = (now, number);
        (Elapsed(elapsed), stalled)
    }
}

/// Whether the drive answers, and takes its outputs.
#[derive(Debug, Clone, Hash)]
pub(super) struct Link {
    pub answered: bool,
    /// Whether the outputs sent last are known to have been delivered.
    pub delivered: bool,
    pub lost: bool,
    /// Its drive is on its way into OP: until it is there, outputs that it does not take are no loss.
    pub awaits_op: bool,
    /// Cycles since the drive answered, and since its outputs were delivered: no more than it takes to be lost.
    stale: u32,
    undelivered: u32,
    /// Cycles since the drive answered.
    pub age: Aside<u32>,
}

/// What a cycle comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum News {
    /// The drive has not answered, or shows what it showed before.
    None,
    /// Another position, and nothing else.
    Position,
    /// Anything else.
    Shown,
    /// The drive counts as lost from now on.
    Lost,
    /// It counted as lost, and does not answer any more.
    Silent,
}

impl Observed {
    pub fn new() -> Self {
        Self {
            sample: None,
            before: 0,
            rest: None,
            standstill: Standstill::default(),
            reached: ShownBit::default(),
            acknowledge: ShownBit::default(),
            error: ShownBit::default(),
            link: Link::new(),
            noted_mode: Mode::None,
            blind: false,
            timing: Aside(CycleTiming::default()),
            last_seen: Aside(LastSeen::default()),
        }
    }

    pub fn state(&self) -> State {
        self.sample
            .map_or(State::NotReadyToSwitchOn, |sample| sample.state())
    }

    pub fn mode(&self) -> Mode {
        self.sample.map_or(Mode::None, |sample| sample.mode)
    }

    pub fn statusword(&self) -> Statusword {
        self.sample
            .map_or(Statusword::empty(), |sample| sample.statusword)
    }

    #[inline]
    pub fn position(&self) -> i32 {
        self.sample.map_or(0, |sample| sample.position)
    }

    pub fn last_seen(&self) -> &LastSeen {
        &self.last_seen.0
    }

    /// Takes in what the cycle with this number has brought.
    #[inline]
    pub fn take_in(
        &mut self,
        now: u64,
        number: u64,
        inputs: &Inputs<'_>,
        config: &CoreConfig,
        bounds: &Bounds,
    ) -> News {
        let (bytes, delivered) = match *inputs {
            Inputs::Fresh(bytes) => (Some(bytes), true),
            Inputs::Answered(bytes) => (Some(bytes), false),
            Inputs::Stale => (None, false),
        };
        let sample = bytes
            .and_then(|bytes| config.fields.sample(bytes, self.noted_mode))
            // A statusword of no state is no answer.
            .filter(|sample| sample.state() != State::Unknown);
        let was_stale = self.link.stale > 0;
        let was_whole = !was_stale && self.link.delivered;
        let is_whole = sample.is_some() && delivered;
        let lost = if was_whole && is_whole && !self.link.lost {
            None
        } else {
            self.link.note(sample.is_some(), delivered, &config.loss)
        };
        let Some(sample) = sample else {
            if !was_stale {
                self.timing.0.begin_to_miss(now, number);
            }
            return lost.unwrap_or(News::None);
        };
        let (elapsed, stalled) = self.timing.0.note(now, number);
        let blind = (was_stale || stalled) && {
            let missing = if was_stale {
                now.saturating_sub(self.timing.0.answered)
            } else {
                elapsed.0
            };
            missing > nanoseconds(bounds.settle) / 8 * 3
        };
        let news = self.take_sample(sample, elapsed, blind, config, bounds);
        let was_blind = core::mem::replace(&mut self.blind, blind);
        match lost {
            Some(lost) => lost,
            None if blind || was_blind || !(was_whole && is_whole) => News::Shown,
            None => news,
        }
    }

    #[inline(always)]
    fn take_sample(
        &mut self,
        sample: Sample,
        elapsed: Elapsed,
        blind: bool,
        config: &CoreConfig,
        bounds: &Bounds,
    ) -> News {
        let rest = self
            .standstill
            .update(sample.position, elapsed, blind, bounds);
        let before = self.sample.replace(sample);
        self.before = before.map_or(sample.position, |before| before.position);
        let stays = before.is_some_and(|before| {
            before.statusword == sample.statusword
                && before.mode == sample.mode
                && before.error_code == sample.error_code
        });
        if !(stays && self.bits_are_sure()) {
            self.show_bits(sample.statusword, elapsed, config);
        } else if rest == self.rest {
            let moved = before.is_none_or(|before| {
                before.position != sample.position || before.velocity != sample.velocity
            });
            return if moved { News::Position } else { News::None };
        }
        self.rest = rest;
        News::Shown
    }

    /// Whether none of them is due. It costs less than to ask when.
    const fn bits_are_sure(&self) -> bool {
        let bits = [self.reached, self.acknowledge, self.error];
        bits[0].bit().is_sure() && bits[1].bit().is_sure() && bits[2].bit().is_sure()
    }

    fn show_bits(&mut self, word: Statusword, elapsed: Elapsed, config: &CoreConfig) {
        let seen = config.traits.surely_seen();
        for (bit, of) in [
            (&mut self.reached, Statusword::TARGET_REACHED),
            (&mut self.acknowledge, Statusword::SET_POINT_ACKNOWLEDGE),
            (&mut self.error, Statusword::HOMING_ERROR),
        ] {
            bit.update(word.contains(of), elapsed, seen);
        }
    }

    fn bits_due(&self) -> Due {
        self.reached
            .due()
            .sooner(self.acknowledge.due())
            .sooner(self.error.due())
    }

    /// What the last cycle with inputs shows.
    pub fn evidence(&self) -> Evidence {
        Evidence {
            position: self.position(),
            before: self.before,
            rest: self.rest,
            blind: self.blind,
            reached: self.reached.bit(),
            acknowledge: self.acknowledge.bit(),
            error: self.error.bit(),
        }
    }

    /// Whether the axis stood in the last cycle with inputs. Without any it is not known to stand.
    pub const fn stands(&self) -> bool {
        self.standstill.is_standing()
    }

    /// Rest counts from now on: the axis may set off, or is told to stop.
    pub const fn count_rest_anew(&mut self) {
        self.standstill.begin_anew();
        self.rest = None;
    }

    /// Nothing has been seen of the drive as it is now.
    #[cfg(feature = "std")]
    pub fn forget_drive(&mut self) {
        self.sample = None;
        self.standstill = Standstill::default();
        self.rest = None;
        self.noted_mode = Mode::None;
    }

    /// Somebody waits for the axis to stand, or nobody does: what was seen of it is for errors.
    pub fn note_unrest(&mut self, now: Duration, waits: bool, bounds: &Bounds) {
        match &self.sample {
            Some(sample) if waits => self.last_seen.0.update(now, sample.position, bounds),
            _ => self.last_seen = Aside(LastSeen::default()),
        }
    }

    /// Says what 6061h shows, where it is not mapped and was read by SDO.
    pub fn note_mode(&mut self, mode: Mode, is_mapped: bool) {
        self.noted_mode = mode;
        if let Some(sample) = &mut self.sample
            && !is_mapped
        {
            sample.mode = mode;
        }
    }

    /// When inputs came last, of a drive that does not answer.
    pub const fn answered_at(&self) -> u64 {
        self.timing.0.answered
    }

    /// When it has something to do without another word of the drive.
    pub fn due(&self) -> Due {
        self.bits_due()
            .sooner(self.standstill.due())
            .sooner(Due::next_if(self.link.stale > 0 || !self.link.delivered))
    }
}

impl Link {
    const fn new() -> Self {
        Self {
            answered: false,
            delivered: false,
            lost: false,
            awaits_op: false,
            stale: 0,
            undelivered: 0,
            age: Aside(0),
        }
    }

    /// Takes in whether the drive has answered, and its outputs were delivered.
    fn note(&mut self, answered: bool, delivered: bool, loss: &Loss) -> Option<News> {
        let count = |cycles: u32, stays: bool, bound: u32| {
            if stays {
                0
            } else {
                cycles.saturating_add(1).min(bound.saturating_add(1))
            }
        };
        self.answered = answered;
        self.delivered = answered && delivered;
        self.stale = count(self.stale, answered, loss.stale_cycles);
        self.undelivered = count(self.undelivered, self.delivered, loss.undelivered_cycles);
        self.age = Aside(if answered {
            0
        } else {
            self.age.0.saturating_add(1)
        });
        if self.delivered {
            self.lost = false;
        }
        let is_silent = self.stale == loss.stale_cycles;
        let is_lost = self.stale >= loss.stale_cycles
            || (self.undelivered >= loss.undelivered_cycles && !self.awaits_op);
        match (self.lost, is_lost, is_silent) {
            (false, true, _) => {
                self.lost = true;
                Some(News::Lost)
            }
            (true, _, true) => Some(News::Silent),
            _ => None,
        }
    }

    /// Its drive is in SAFEOP and on its way into OP, or has come there.
    #[cfg(feature = "std")]
    pub const fn await_op(&mut self, awaits_op: bool) {
        self.awaits_op = awaits_op;
        if self.undelivered > 0 {
            self.undelivered = 1;
        }
    }

    /// Whether the last cycle had inputs of the drive, and the outputs before them were delivered.
    pub const fn is_whole(&self) -> bool {
        self.answered && self.delivered
    }
}

impl News {
    /// What a port is to be told of it.
    pub const fn change(self, answered: bool) -> SnapshotChange {
        match self {
            Self::None if answered => SnapshotChange::Nothing,
            Self::None => SnapshotChange::Silence,
            Self::Position => SnapshotChange::Motion,
            Self::Shown | Self::Lost | Self::Silent => SnapshotChange::Anything,
        }
    }
}
