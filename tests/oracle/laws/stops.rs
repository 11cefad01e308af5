//! The laws of stops and of the brake. They hold whatever the drive does.

use crate::habits::{Habit, Habits};
use crate::scenario::{Kind, Scenario};
use crate::words::{HALT, State};

impl Scenario {
    /// Whether a stop that is asked for now has something to stop: all that the core can know of.
    pub fn must_stop(&self) -> bool {
        let snapshot = self.host.snapshot();
        self.sent.is_enable_operation()
            && snapshot.controlword.bits() & 0xF == 0xF
            && self.sample.is_enabled()
            && self.drive.state == State::Enabled
            && (snapshot.has_set_point
                || (self.drive.mode == 1 && self.drive.demand_velocity != 0.0 && self.is_moving()))
    }

    /// It was asked for, and something was to stop.
    pub fn judge_stop(&mut self, kind: Kind) -> Result<(), ()> {
        let word = self.host.outputs().word;
        if word & HALT != 0 || word & 0x04 == 0 {
            return Ok(());
        }
        let what = format!("{kind:?} was asked for, and the next word is {word:04X}h");
        self.broken("a stop is in the next frame", what)
    }

    /// A moving axis keeps its brake.
    pub fn judge_brake(&mut self) -> Result<(), ()> {
        // Bit 8 is the first part of a stop.
        if self.sent.is_enable_operation() && self.sent.word & HALT == 0 {
            self.watch.stopping_since = None;
            return Ok(());
        }
        let since = *self.watch.stopping_since.get_or_insert(self.cycle);
        let powered = matches!(self.drive.state, State::Enabled | State::QuickStop);
        if !self.sent.leads_down() || !powered || !self.stops_while_moving() {
            return Ok(());
        }
        let blind = self.cycle - self.watch.blind <= self.watch.answer;
        let deaf = Habits::of(&[Habit::QuickStopIgnored, Habit::LocalControl]);
        let deaf = self.habits.any(deaf);
        if blind || deaf || self.cycle - since >= self.watch.standstill {
            return Ok(());
        }
        let what = format!(
            "{:04X}h is sent {} cycles after the stop began, at {:.0} counts/s",
            self.sent.word,
            self.cycle - since,
            self.drive.velocity
        );
        self.broken("a moving axis keeps its brake", what)
    }

    /// A stop that is not obeyed goes from bit 8 to quick stop, and from that to Disable voltage.
    pub fn judge_escalation(&mut self) -> Result<(), ()> {
        let (sent, cycle) = (self.sent, self.cycle);
        let watch = &mut self.watch;
        let halts = sent.word & HALT != 0 && sent.is_enable_operation();
        watch.halting_since = halts.then(|| watch.halting_since.unwrap_or(cycle));
        watch.quick_since = sent
            .is_quick_stop()
            .then(|| watch.quick_since.unwrap_or(cycle));
        // Inputs have to come for the settle time, or the core does not know that the axis moves.
        let steady = (2 * watch.settle) as u64 + 40;
        if cycle - watch.blind <= steady || !self.sample.is_enabled() {
            return Ok(());
        }
        let asked = watch.stop_asked;
        let overdue = |since: u64| cycle - since.max(asked) > watch.stop_limit + steady;
        let gives_up = watch.halting_since.filter(|since| asked >= *since);
        let halts = gives_up.is_some_and(overdue);
        let quick = watch.quick_since.is_some_and(overdue);
        if (halts || quick) && self.drive.state == State::Enabled && self.is_moving() {
            let what = format!(
                "{:04X}h is still sent at {:.0} counts/s",
                sent.word, self.drive.velocity
            );
            return self.broken("a stop that is not obeyed escalates", what);
        }
        Ok(())
    }

    /// Whether the axis moved in every settle time that the core can have looked at.
    pub fn stops_while_moving(&self) -> bool {
        let late = self.watch.answer as usize + 8 * self.slow as usize;
        let late = late.min(self.watch.trail.len().saturating_sub(self.watch.settle));
        self.is_moving() && (0..=late).all(|ago| !self.stood(ago))
    }
}
