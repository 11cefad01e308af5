//! The laws of what is said of set-points. Within the model none of it is wrong.

use servocrab::ds402;
use servocrab::{Failure, axis::Completion};

use crate::cable::Told;
use crate::drive::{Ack, Base, End, Latch};
use crate::outcome::{Class, leaves_open, name};
use crate::scenario::{Issued, Kind, Scenario};
use crate::words::{HALT, START_BITS};

/// What is said of a command.
type Said = Result<Completion, Failure>;

const TAKEN: &str = "latched = accepted + unknown";

impl Scenario {
    /// Each set-point that the drive has taken belongs to one move.
    pub fn match_ledger(&mut self) -> Result<(), ()> {
        if let Some(velocity) = self.drive.overrun.take()
            && self.is_inside()
        {
            let name = velocity.wrapping_sub(self.program.speed);
            let what = format!("that of {name} came while the drive held two");
            return self.broken("no set-point goes behind others into a full buffer", what);
        }
        while let Some(latch) = self.drive.ledger.get(self.watch.ledger_seen).copied() {
            let index = self.watch.ledger_seen;
            self.watch.ledger_seen += 1;
            // Its base is known where the axis is known to stand, or behind another, unless it is blended in and counts from where the axis is.
            let stood = self.surely_stood() && !self.issued.iter().any(Issued::is_open_move);
            let behind = latch.behind && !(latch.blend && self.drive.making.base == Base::Actual);
            self.drive.ledger[index].known &= stood || !latch.relative || behind;
            let name = latch.out.velocity.wrapping_sub(self.program.speed);
            self.say(|scenario| {
                let (demand, mode) = (scenario.drive.demand, scenario.sent.mode);
                let (goal, limit) = (latch.goal, latch.limit);
                format!("drive takes {index}, the move {name}, to {goal:.0} ({limit:?}) from {demand:.0} in mode {mode}")
            });
            let bits = |issued: &Issued| issued.a_move.map(|a_move| self.start_bits(&a_move));
            let own = self.issued.get(name as usize).filter(|issued| {
                issued.latch.is_none()
                    && issued.sent
                    && !issued.unsent
                    && bits(issued) == Some(latch.out.word & START_BITS)
                    && issued.a_move.map(|a_move| a_move.target) == Some(latch.out.target)
            });
            let takes = |hold: &Issued| {
                let waits = hold.kind == Kind::Hold && hold.sent && hold.latch.is_none();
                waits && latch.out.word & START_BITS == 0x20
            };
            let mut pending = self.pending.iter().map(|id| *id as usize);
            let hold = pending.find(|id| takes(&self.issued[*id]));
            // A fault that is shown while the set-point of the last one is on its way ends that one, and the drive may take it when it is
            // back from the fault.
            let last = self
                .issued
                .iter()
                .rposition(|issued| issued.kind == Kind::Hold);
            let ended = last.filter(|id| {
                let hold = &self.issued[*id];
                let failed = hold.done && !hold.good && !hold.unsent;
                takes(hold) && failed && latch.out.word & HALT != 0
            });
            if let Some(hold) = hold {
                self.issued[hold].latch = Some(index);
            } else if own.is_some() {
                self.issued[name as usize].latch = Some(index);
            } else if let Some(hold) = ended {
                self.issued[hold].latch = Some(index);
            } else if self.is_inside() {
                let what =
                    format!("the drive has taken {latch:?}, which nobody asked for, or twice");
                return self.broken(TAKEN, what);
            }
        }
        Ok(())
    }

    /// A set-point that the drive holds is known.
    pub fn judge_set_point(&mut self) -> Result<(), ()> {
        let drive = &self.drive;
        let Some(gap) = drive.holds().filter(|gap| *gap > drive.no_way()) else {
            return Ok(());
        };
        // The 0 of a jog is on its way.
        let next = self.host.outputs().target_velocity;
        let jog_ends = drive.mode == 3 && (self.sent.target_velocity == 0 || next == 0);
        let snapshot = self.host.snapshot();
        let drives = snapshot.controlword.bits() & 0x8F == 0x0F && self.sent.is_enable_operation();
        let obeys = drive.out.word & 0x0F == 0x0F;
        if !drives || !obeys || jog_ends || snapshot.has_set_point || !self.is_inside() {
            return Ok(());
        }
        let what = format!(
            "its demand is {gap:.0} counts from the end ({}), and the core knows of none",
            drive.phase()
        );
        self.broken("the drive holds a set-point: the core has one", what)
    }

    pub fn judge_accepted(&mut self, id: u32) -> Result<(), ()> {
        // One without a way is over in the drive as soon as it was taken.
        self.watch.at_rest_since = self.cycle;
        let issued = &mut self.issued[id as usize];
        issued.accepted = true;
        issued.acknowledged = self.cycle;
        let issued = *issued;
        if !self.is_inside() {
            return Ok(());
        }
        if issued.kind == Kind::Home && issued.homings.0 == self.drive.homings.0 {
            let what = format!(
                "{id} is accepted, and the drive has begun no homing since it was asked for"
            );
            return self.broken("Accepted: the homing has begun", what);
        }
        if issued.kind == Kind::Move && issued.latch.is_none() {
            let what = format!("{id} is accepted, and the drive has not taken it");
            return self.broken(TAKEN, what);
        }
        Ok(())
    }

    pub fn judge_done(&mut self, id: u32, said: &Said) -> Result<(), ()> {
        let issued = self.issued[id as usize];
        let kind = issued.kind;
        let how = match said {
            Ok(Completion::Reached { .. }) => "Reached",
            Ok(Completion::Passed { .. }) => "Passed",
            Ok(_) => "Done",
            Err(failure) => name(failure.class()),
        };
        self.lived.tally.seen.insert((kind, how));
        self.judge_phase(id, said)?;
        self.judge_time(id)?;
        if kind == Kind::Move {
            return self.judge_move(id, said);
        }
        if kind == Kind::Resume && said.is_ok() && self.host.outputs().word & HALT != 0 {
            let what = format!("{id} is done, and bit 8 is high");
            return self.broken("a resume is done when bit 8 was sent low", what);
        }
        if !self.is_inside() {
            return Ok(());
        }
        if matches!(said, Ok(Completion::Homed { .. })) && self.drive.homings.1 == issued.homings.1
        {
            let what = format!(
                "{id} is {said:?}, and the drive has ended no homing since it was asked for"
            );
            return self.broken("Homed: the drive has homed", what);
        }
        // A move that was asked for since may have been taken already.
        let mut since = self.issued.iter().skip(id as usize + 1);
        let goes_on = since.any(|later| later.kind == Kind::Move && later.sent);
        if kind == Kind::Hold && said.is_ok() && !goes_on {
            return self.judge_stopped(id, issued, said);
        }
        let Ok(Completion::Stopped { state }) = *said else {
            return Ok(());
        };
        let shows_power = matches!(
            state,
            ds402::State::SwitchedOn
                | ds402::State::OperationEnabled
                | ds402::State::QuickStopActive
        );
        if kind == Kind::Disable && shows_power {
            let what = format!("{id} is done in {state:?}");
            return self.broken("a disable ends without power", what);
        }
        self.judge_stopped(id, issued, said)
    }

    /// A stop is done.
    fn judge_stopped(&mut self, id: u32, issued: Issued, said: &Said) -> Result<(), ()> {
        let (kind, drive) = (issued.kind, &self.drive);
        let halts_nothing = kind == Kind::Halt && !self.sample.is_enabled();
        // One without power that coasts stops by nothing that is asked for.
        let coasts = !issued.powered && !drive.state.is_powered();
        if kind.stops() && !halts_nothing && !coasts && self.stops_while_moving() {
            let (velocity, state) = (drive.velocity, drive.state);
            let what = format!("{id} {kind:?} is {said:?} at {velocity:.0} counts/s, in {state:?}");
            return self.broken("a stop ends at standstill", what);
        }
        // A jog ends by its 0, which is in the next frame.
        let jog_ends = drive.mode == 3 && self.host.outputs().target_velocity == 0;
        let gap = drive.holds().filter(|gap| *gap > drive.no_way());
        if let Some(gap) = gap
            && kind.stops()
            && kind != Kind::Halt
            && !jog_ends
            && self.sent.is_enable_operation()
        {
            let what =
                format!("{id} {kind:?} is {said:?}, and the drive is {gap:.0} counts from its end");
            return self.broken("after a stop the set-point is gone", what);
        }
        Ok(())
    }

    /// Without inputs nothing ends but by a loss, or what is done when it was sent.
    fn judge_phase(&mut self, id: u32, said: &Said) -> Result<(), ()> {
        let issued = self.issued[id as usize];
        let stale = self.stepping == Some(Told::Stale);
        let lost = said.is_err() && self.host.snapshot().lost;
        let sent = matches!(
            issued.kind,
            Kind::Resume | Kind::Halt | Kind::Hold | Kind::Jog
        );
        let arrived = matches!(
            said,
            Ok(Completion::Reached { .. } | Completion::Passed { .. })
        );
        let halted = self.sent.word & HALT != 0;
        let asked = self.stepping.is_none();
        if (stale && !lost && !sent) || (arrived && (asked || halted)) {
            let what = format!("{id} {:?} is {said:?}, of {:?}", issued.kind, self.stepping);
            return self.broken("stale inputs advance nothing", what);
        }
        Ok(())
    }

    fn judge_move(&mut self, id: u32, said: &Said) -> Result<(), ()> {
        let issued = self.issued[id as usize];
        let failure = said.err();
        let how = failure.map(|failure| failure.class());
        if failure.is_some_and(|failure| leaves_open(&failure)) {
            self.watch.needs_stop = true;
        }
        let latch = issued.latch.map(|index| self.drive.ledger[index]);
        if latch.is_some() {
            let ends = &mut self.lived.tally.ends;
            match how {
                None => ends.arrived += 1,
                Some(Class::Unknown) => ends.unknown += 1,
                Some(_) => ends.ended += 1,
            }
        }
        let wrong = self.wrong(issued, said, latch);
        if !self.is_inside() {
            if let Some(law) = wrong {
                self.lived.tally.ends.wrong += 1;
                self.say(|_| format!("WRONG {law}: {id} is {said:?}: {latch:?}"));
            }
            return Ok(());
        }
        if let Some(law) = wrong {
            return self.broken(law, format!("{id} is {said:?}: {latch:?}"));
        }
        if (issued.unsent && latch.is_some()) || (said.is_ok() && !issued.accepted) {
            let what = format!(
                "{id} is {said:?}, accepted {}, and the drive has: {latch:?}",
                issued.accepted
            );
            return self.broken(TAKEN, what);
        }
        if self.sound && how == Some(Class::Unknown) && self.must_be_known(issued) {
            let what = format!("{id} is {said:?}: {latch:?}");
            return self.broken("of a drive without habits everything is known", what);
        }
        let ready = self.cycle - self.watch.blocked.max(issued.since).min(self.cycle);
        if how == Some(Class::Late) && ready > self.watch.acknowledge / 2 + self.watch.seen {
            let what =
                format!("{id} is {said:?}, and for {ready} cycles the axis was ready for it");
            return self.broken("what nothing is in the way of goes out, or ends", what);
        }
        Ok(())
    }

    /// The law that an outcome of a move breaks, by the drive's ledger.
    fn wrong(&self, issued: Issued, said: &Said, latch: Option<Latch>) -> Option<&'static str> {
        let arrived = said.is_ok();
        let Some(latch) = latch else {
            return arrived.then_some("Reached: the drive has taken it");
        };
        let was_there = latch.nearest <= self.drive.no_way();
        if let Err(failure) = said {
            let missed = failure.class() == Class::Missed;
            let superseded = matches!(failure, Failure::Superseded) && issued.accepted;
            let limited = latch.limit.is_some() && latch.arrived.is_some();
            // A drive that forgets it, or whose shaft is blocked, has ended it elsewhere as well.
            let ended = latch.end.is_some() || latch.arrived.is_some();
            let elsewhere = limited || (!self.is_inside() && ended && !was_there);
            return if missed && !elsewhere {
                Some("MissedTarget: the drive has limited it")
            } else if superseded && latch.end.is_none() {
                Some("Superseded: another took its place")
            } else {
                None
            };
        }
        // Where a distance leads that counts from nobody knows where the drive alone says.
        let index = issued.latch.unwrap_or_default();
        let known = !latch.relative
            || (latch.known && self.watch.base_is_known && self.base_was_reached(index, &latch));
        let is_right = match latch.arrived {
            Some(_) => {
                was_there || !known || self.is_limited_at_once(&latch) || self.goes_round(&latch)
            }
            None => self.drive.is_still(index) || self.drive.is_there_soon(index),
        };
        (!is_right).then_some("Reached: that set-point has ended there")
    }

    /// Whether the way of the shaft leads past its end on a modulo axis, before it comes there for good.
    fn goes_round(&self, latch: &Latch) -> bool {
        let turn = self.drive.making.turn;
        turn.is_some_and(|(_, length)| latch.way + latch.lag >= length as f64)
    }

    /// Whether the end of the one that it was taken behind was seen. A drive that limits that one may lead this one on from there.
    fn base_was_reached(&self, index: usize, latch: &Latch) -> bool {
        let before = index.checked_sub(1).filter(|_| latch.behind);
        before.is_none_or(|before| {
            let issued = self.issued.iter();
            issued
                .rev()
                .find(|issued| issued.latch == Some(before))
                .is_none_or(|issued| issued.good)
        })
    }

    /// Whether the drive limits it within the window of where it began: that looks like one that has not begun (S5).
    fn is_limited_at_once(&self, latch: &Latch) -> bool {
        let way = |limit: f64| latch.way - self.drive.apart(latch.goal, limit);
        latch
            .limit
            .is_some_and(|limit| way(limit) <= self.watch.window + 1.0)
    }

    /// Whether a sound drive leaves no doubt about this one: it shows room, or its end and those beside it are far apart.
    fn must_be_known(&self, issued: Issued) -> bool {
        let Some(index) = issued.latch else {
            return true;
        };
        let ledger = &self.drive.ledger;
        let latch = &ledger[index];
        // Of what the axis passes while it halts the core claims nothing. Nor does an end show to which it comes before bit 10 is surely its own.
        let seen = issued.acknowledged + self.watch.answer;
        // Nor one to which it comes while the move before may still settle, or before its way has shown that it is the active one (A2).
        let settle = self.watch.settle as u64;
        let second_half = if self.watch.room_is_shown {
            settle
        } else {
            3 * settle
        };
        let is_short = |at: u64| {
            let began = latch.began.unwrap_or(at);
            index > 0
                && ledger[index - 1].end.is_some()
                && at - began <= second_half + self.watch.answer
        };
        // Nor one that was passed while the next one was on its way: beyond it bit 10 is high.
        let is_overtaken = |at: u64| {
            let next = ledger.get(index + 1);
            latch.out.end_velocity != 0
                && next.is_some_and(|next| next.taken <= at + self.watch.answer)
        };
        let short = latch.way <= 3.0 * self.watch.window.max(self.in_a_tick(latch));
        if latch.relative
            || issued.halted
            || latch
                .arrived
                .is_some_and(|at| at <= seen || is_short(at) || is_overtaken(at))
            || (latch.out.end_velocity != 0 && short)
        {
            return false;
        }
        if self.watch.room_is_shown && self.drive.making.ack == Ack::Buffer {
            return true;
        }
        let far = |other: &Latch| {
            let known = !other.relative || (other.known && self.watch.base_is_known);
            known && self.drive.apart(other.goal, latch.goal) > 4.0 * self.watch.window
        };
        let before = index.checked_sub(1).map(|before| &ledger[before]);
        let before = before.filter(|before| before.end.is_none_or(|(at, _)| at >= latch.taken));
        let after = ledger.get(index + 1);
        // The axis cannot turn round on its way to the first of two.
        let straight = |first: &Latch, second: &Latch| !first.in_motion || second.blend;
        before.is_none_or(|before| far(before) && straight(before, latch))
            && after.is_none_or(|after| far(after) && straight(latch, after))
            && latch.end.is_none_or(|(_, end)| end != End::Dropped)
    }

    fn in_a_tick(&self, latch: &Latch) -> f64 {
        f64::from(latch.out.velocity) * self.drive.making.tick
    }
}
