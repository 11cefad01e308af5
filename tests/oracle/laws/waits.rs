//! Every future ends, and what nothing is in the way of goes out. Without inputs nothing advances.

use core::time::Duration;

use servocrab::ds402;
use servocrab::ds402::Mode;

use crate::cable::Told;
use crate::habits::{Habit, Habits};
use crate::scenario::{Kind, Scenario};
use crate::words::{ACKNOWLEDGE, HALT};

impl Scenario {
    /// When the drive has had something to do last.
    pub fn note_rest(&mut self, seen: bool) {
        let drive = &self.drive;
        // The time in which something has to begin begins anew after a halt.
        let halted = self.sent.word & HALT != 0;
        if drive.demand_velocity != 0.0 || drive.holds().is_some() || !seen || halted {
            self.watch.at_rest_since = self.cycle;
        }
        if halted {
            // Of what the axis passes while it halts the core claims nothing.
            for id in &self.pending {
                self.issued[*id as usize].halted = true;
            }
        }
    }

    /// Notes whether something is in the way of the next set-point: as long as nothing is, it has to go out.
    pub fn note_hindrance(&mut self, seen: bool) {
        let waits = |id: &u32| {
            let issued = &self.issued[*id as usize];
            issued.kind == Kind::Move && !issued.sent
        };
        let ready = || {
            let snapshot = self.host.snapshot();
            snapshot.state == ds402::State::OperationEnabled
                && snapshot.mode == Mode::ProfilePosition
                && !snapshot.halted
        };
        let free = !self.pending.is_empty()
            && self.drive.is_free()
            && seen
            && self.told == Told::Fresh
            && self.pending.iter().all(waits)
            && ready();
        if !free {
            self.watch.hindered = self.cycle;
        }
        if !free || self.sample.word & ACKNOWLEDGE != 0 {
            self.watch.blocked = self.cycle;
        }
    }

    /// Every future ends.
    pub fn judge_waits(&mut self) -> Result<(), ()> {
        const ENDS: &str = "every future ends";
        if let Some(&id) = self.pending.first()
            && !self.gated.contains(&id)
            && self.is_inside()
        {
            let issued = self.issued[id as usize];
            let waited = self.cycle - self.watch.hindered.max(issued.since);
            if issued.kind == Kind::Move && waited > self.watch.send_limit {
                let what = format!("{id} waits, and for {waited} cycles the axis was ready for it");
                return self.broken("what nothing is in the way of goes out, or ends", what);
            }
        }
        // A stop that its drive does not obey has deadlines of its own, and may be asked for again.
        let stops = if self.sent.is_enable_operation() {
            0
        } else {
            3 * self.watch.stop_limit
        };
        for at in 0..self.pending.len() {
            let id = self.pending[at];
            let issued = self.issued[id as usize];
            let waited = self.ran - issued.ran;
            if !issued.kind.is_endless() && waited > self.watch.limit {
                let what = format!("{id} {:?} has waited for {waited} cycles", issued.kind);
                return self.broken(ENDS, what);
            }
            let rest = self.watch.at_rest_since.max(issued.since);
            let rest = self.cycle.saturating_sub(rest);
            let patience = match issued.kind {
                Kind::Move if issued.accepted => self.watch.begin_limit + stops,
                Kind::Home => 3_000_000 / self.period.as_micros() as u64,
                _ => u64::MAX,
            };
            if rest > patience && !self.host.snapshot().halted && self.is_inside() {
                let what = format!(
                    "{id} {:?} waits, and the drive has had nothing to do for {rest} cycles",
                    issued.kind
                );
                return self.broken(ENDS, what);
            }
        }
        Ok(())
    }

    /// Where inputs came all the time, and the drive changes its state on command alone, none takes longer than its deadlines.
    pub fn judge_time(&mut self, id: u32) -> Result<(), ()> {
        const OWN: Habits = Habits::of(&[
            Habit::FaultReactionLeft,
            Habit::FaultResetsItself,
            Habit::Fault,
            Habit::FaultCoasts,
            Habit::OwnQuickStop,
            Habit::OwnSwitchOff,
            Habit::OwnDisable,
            Habit::OwnEnable,
        ]);
        let issued = self.issued[id as usize];
        let deadlines = &self.config.deadlines;
        let answer = 2 * self.config.traits.surely_seen();
        let (standstill, disable) = (deadlines.standstill, deadlines.disable);
        let most = match issued.kind {
            Kind::Enable => deadlines.enable,
            Kind::Reset => {
                3 * (deadlines.fault_reset.max(answer) + Duration::from_millis(100)) + standstill
            }
            // Behind one that was taken back it waits for that first.
            Kind::Mode => 2 * deadlines.mode,
            Kind::Resume => Duration::ZERO,
            Kind::Halt | Kind::QuickStop => standstill + disable,
            Kind::Hold => standstill + deadlines.acknowledge + 2 * deadlines.begin,
            Kind::Stop | Kind::Release | Kind::Disable => 2 * standstill + disable,
            Kind::Move | Kind::Home | Kind::Jog => return Ok(()),
        };
        let took = (self.cycle - issued.since) as u32 * self.period;
        let most = most + 60 * self.period + Duration::from_millis(10);
        let own = self.habits.any(OWN) || !self.is_inside();
        if own || self.watch.blind >= issued.since || took <= most {
            return Ok(());
        }
        let what = format!("{id} {:?} took {took:?}, and {most:?} is most", issued.kind);
        self.broken("no command takes longer than its deadlines", what)
    }

    /// Inputs that do not arrive change nothing, until there have been none for so long that the drive counts as lost.
    pub fn judge_loss(&mut self) -> Result<(), ()> {
        let watch = &mut self.watch;
        let count = |none: bool, so_far: u32| if none { so_far + 1 } else { 0 };
        watch.stale_cycles = count(self.told == Told::Stale, watch.stale_cycles);
        watch.undelivered_cycles = count(self.told != Told::Fresh, watch.undelivered_cycles);
        let loss = self.config.loss;
        let was = watch.lost;
        if self.told == Told::Fresh && !was {
            return Ok(());
        }
        watch.lost = (was && self.told != Told::Fresh)
            || watch.stale_cycles >= loss.stale_cycles
            || watch.undelivered_cycles >= loss.undelivered_cycles;
        let lost = watch.lost;
        if lost != self.host.snapshot().lost {
            let what = format!(
                "after {} cycles without inputs and {} without a delivery the drive counts as lost: {}",
                self.watch.stale_cycles, self.watch.undelivered_cycles, !lost
            );
            return self.broken("a silent drive is lost in time", what);
        }
        let next = self.host.outputs();
        if self.told == Told::Stale && lost == was && next != self.sent && self.ran > 1 {
            let what = format!("without inputs {:?} became {next:?}", self.sent);
            return self.broken("stale inputs advance nothing", what);
        }
        Ok(())
    }
}
