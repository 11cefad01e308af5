//! What is fixed to the machine that the axis moves: switches, index pulse, ends of travel, its weight and its brake, and where it
//! stands at power-up. All in encoder counts from a zero of the machine's own, which no homing shifts.

use core::time::Duration;

/// The negative limit switch, as bit of the digital inputs (60FDh).
pub(super) const NEGATIVE_LIMIT: u32 = 1 << 0;
/// The positive limit switch.
pub(super) const POSITIVE_LIMIT: u32 = 1 << 1;
/// The home switch.
pub(super) const HOME_SWITCH: u32 = 1 << 2;

/// The machine around an axis. The default is one without switches, index pulse and ends.
///
/// ```
/// use servocrab_sim::ds402::{Axis, Behaviour, Machine};
///
/// // Axis at 700, home switch between 0 and 50.
/// let machine = Machine { start: 700, home_switch: Some((0, 50)), ..Machine::default() };
/// let axis = Axis::new(Behaviour { machine, ..Behaviour::generic() });
/// assert_eq!((axis.position(), axis.mechanical_position()), (0, 700));
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Machine {
    /// Where the axis stands at power-up.
    pub start: i64,
    /// The negative limit switch is active here and at every position below (bit 0 of 60FDh).
    pub negative_limit: Option<i64>,
    /// The positive limit switch is active here and at every position above (bit 1 of 60FDh).
    pub positive_limit: Option<i64>,
    /// The home switch is active from the first to the second position, both included (bit 2 of 60FDh); `i64::MIN` and
    /// `i64::MAX` let it reach to the end.
    pub home_switch: Option<(i64, i64)>,
    /// Counts from one index pulse to the next; 0 for an encoder without.
    pub index_period: u32,
    /// Where one of the index pulses is.
    pub index_at: i64,
    /// What the inputs of touch probes 1 and 2 meet.
    pub probes: [Option<Mark>; 2],
    /// Hard ends of travel: the shaft gets no further.
    pub ends: Option<(i64, i64)>,
    /// Counts/s² by which the axis falls, toward smaller positions, where neither the drive nor a brake holds it; 0 for one that does
    /// not hang.
    pub gravity: u32,
    /// A holding brake.
    pub brake: Option<MachineBrake>,
    /// The encoder knows its position at power-up. Such an axis is referenced from the start, at first in the machine's
    /// own coordinates, and stays so when power is lost.
    pub absolute_encoder: bool,
}

/// A holding brake. A spring closes it: it is closed without power.
///
/// ```
/// use core::time::Duration;
/// use servocrab_sim::ds402::{Machine, MachineBrake, Opener};
///
/// let brake = MachineBrake { opens_in: Duration::from_millis(40), ..MachineBrake::new(Duration::from_millis(80)) };
/// let lift = Machine { gravity: 9_806_650, brake: Some(brake), ..Machine::default() };
/// assert!(matches!(brake.opened_by, Opener::Output { bit: 0, .. }));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MachineBrake {
    /// From the signal to open until it is open.
    pub opens_in: Duration,
    /// From the end of that signal until it holds.
    pub closes_in: Duration,
    /// Who opens it.
    pub opened_by: Opener,
    /// The bit of 60FDh that is 1 while it is open.
    pub feedback: Option<u8>,
}

/// Who opens a holding brake.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Opener {
    /// An output of the drive: this bit of 60FEh:1, where it has this level and the mask 60FEh:2 enables it.
    Output {
        /// The bit's number.
        bit: u8,
        /// The level that opens it.
        level: bool,
        /// The drive closes it in a fault, and while its process data are lost.
        closed_by_drive: bool,
    },
    /// The drive, before it shows Operation enabled. When it controls the axis no more it carries the load until the brake has had its time to
    /// close, as long as it has its supply.
    Drive,
}

impl MachineBrake {
    /// One that opens at once and takes so long to close, opened by the drive's physical output 0 (60FEh:1, "set brake").
    pub const fn new(closes_in: Duration) -> MachineBrake {
        MachineBrake {
            opens_in: Duration::ZERO,
            closes_in,
            opened_by: Opener::Output {
                bit: 0,
                level: false,
                closed_by_drive: false,
            },
            feedback: None,
        }
    }
}

/// Something that a touch probe meets on its way, a part or a printed mark: its input is active from the first to the last position, both
/// included.
///
/// ```
/// use servocrab_sim::ds402::{Machine, Mark};
///
/// // A mark of 50 counts on each turn of a table that has 3600.
/// let machine = Machine { probes: [Some(Mark::new(100, 149).every(3_600)), None], ..Machine::default() };
/// assert_eq!(machine.probes[0].unwrap().every, 3_600);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mark {
    /// The first position; `i64::MIN` lets it reach to the end.
    pub first: i64,
    /// The last position; `i64::MAX` lets it reach to the end.
    pub last: i64,
    /// Counts from one such mark to the next; 0 for one alone.
    pub every: u32,
}

impl Mark {
    /// One mark.
    pub const fn new(first: i64, last: i64) -> Mark {
        Mark {
            first,
            last,
            every: 0,
        }
    }

    /// The same mark again and again.
    #[must_use]
    pub const fn every(mut self, counts: u32) -> Mark {
        self.every = counts;
        self
    }

    /// Whether it is at this position.
    pub(super) fn contains(&self, position: f64) -> bool {
        let past = position - self.first as f64;
        let past = match self.every {
            0 => past,
            every => past.rem_euclid(every.into()),
        };
        (0.0..=self.last as f64 - self.first as f64).contains(&past)
    }

    /// The edges on the way from one position to another, with what the input is behind each.
    pub(super) fn edges(&self, from: f64, to: f64) -> Vec<(f64, bool)> {
        let (first, last) = (self.first as f64, self.last as f64);
        // The input changes when the shaft gets to a count.
        let ends = if from < to {
            [(first, true), (last + 1.0, false)]
        } else {
            [(last, true), (first - 1.0, false)]
        };
        let is_passed = |at: f64| from < at && at <= to || to <= at && at < from;
        let mut edges = Vec::new();
        for (at, active) in ends {
            if self.every == 0 {
                edges.extend(is_passed(at).then_some((at, active)));
                continue;
            }
            let every = f64::from(self.every);
            let mut at = at + ((from.min(to) - at) / every).floor() * every;
            while at <= from.max(to) && edges.len() < MOST_EDGES {
                edges.extend(is_passed(at).then_some((at, active)));
                at += every;
            }
        }
        edges
    }
}

/// More edges of one mark in a cycle are none: no input is as fast.
const MOST_EDGES: usize = 64;

impl Machine {
    /// The switches that are active at a position, as bits 0 to 2 of 60FDh.
    pub(super) fn switches(&self, position: i64) -> u32 {
        let bits = [
            (
                NEGATIVE_LIMIT,
                self.negative_limit.is_some_and(|at| position <= at),
            ),
            (
                POSITIVE_LIMIT,
                self.positive_limit.is_some_and(|at| position >= at),
            ),
            (
                HOME_SWITCH,
                self.home_switch
                    .is_some_and(|(from, to)| (from..=to).contains(&position)),
            ),
        ];
        bits.into_iter()
            .filter(|&(_, active)| active)
            .fold(0, |all, (bit, _)| all | bit)
    }

    /// The first position in the direction of travel (`up`: toward larger positions) at which a switch has changed.
    pub(super) fn edge(&self, switch: u32, up: bool, to_active: bool) -> Option<i64> {
        let (from, to) = match switch {
            NEGATIVE_LIMIT => (i64::MIN, self.negative_limit?),
            POSITIVE_LIMIT => (self.positive_limit?, i64::MAX),
            _ => self.home_switch?,
        };
        Some(match (up, to_active) {
            (true, true) => from,
            (true, false) => to.saturating_add(1),
            (false, true) => to,
            (false, false) => from.saturating_sub(1),
        })
    }

    /// The first index pulse at `from` or beyond it in the direction of travel.
    pub(super) fn index_from(&self, from: i64, up: bool) -> Option<i64> {
        let period = i64::from(self.index_period);
        if period == 0 {
            return None;
        }
        let past = from.saturating_sub(self.index_at).rem_euclid(period);
        Some(match (past, up) {
            (0, _) => from,
            (_, true) => from.saturating_add(period - past),
            (_, false) => from.saturating_sub(past),
        })
    }

    /// The position that the shaft gets to when it is driven to `position`.
    pub(super) fn within_ends(&self, position: i64) -> i64 {
        match self.ends {
            Some((low, high)) if low <= high => position.clamp(low, high),
            _ => position,
        }
    }
}
