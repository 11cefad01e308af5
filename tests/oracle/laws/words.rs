//! The laws of the words that are sent. They hold whatever the drive does.

use servocrab::{
    BufferMode,
    profile_position::{MoveCommand, Reference},
};

use crate::cable::Told;
use crate::scenario::{Kind, Scenario};
use crate::words::{ACKNOWLEDGE, HALT, NEW_SET_POINT, START_BITS};

impl Scenario {
    /// The laws of the word that is about to be sent.
    pub fn judge_word(&mut self) -> Result<(), ()> {
        if self.is_at_ease() {
            return Ok(());
        }
        let rises = self.sent.word & !self.sent_before.word;
        if rises & NEW_SET_POINT != 0 {
            self.judge_rise()?;
        } else {
            self.judge_kept_set_point()?;
        }
        self.judge_bits(rises)?;
        self.judge_orders()?;
        self.judge_brake()?;
        self.judge_escalation()?;
        self.watch.asked = Default::default();
        Ok(())
    }

    /// Whether the same goes out as before, on an axis that is enabled and that nobody asks for anything: no law can be broken by it.
    fn is_at_ease(&self) -> bool {
        let (sent, watch) = (&self.sent, &self.watch);
        self.sent_before == *sent
            && sent.is_enable_operation()
            && sent.word & (HALT | NEW_SET_POINT) == 0
            && (sent.mode != 8 && sent.target_velocity == 0)
            && !(watch.asked.stop || watch.asked.halt || watch.asked.resume)
            && watch.low.is_some()
            && watch.halting_since.is_none()
            && watch.stopping_since.is_none()
            && watch.quick_since.is_none()
    }

    fn bad_word(&mut self, law: &'static str) -> Result<(), ()> {
        let what = format!(
            "{:04X}h, then {:?}; {:?} was seen",
            self.sent_before.word, self.sent, self.sample
        );
        self.broken(law, what)
    }

    /// Bit 4 rises.
    fn judge_rise(&mut self) -> Result<(), ()> {
        let (sent, seen) = (self.sent, self.sample);
        if self.expired {
            return self.bad_word("nothing starts while the liveness is expired");
        }
        if self.told != Told::Fresh {
            return self.bad_word("bit 4 rises on fresh inputs");
        }
        if !seen.is_enabled()
            || seen.mode != sent.mode
            || sent.word & 0x018F & !self.halt_beside(sent.word) != 0x000F
        {
            return self.bad_word("bit 4 rises in Operation enabled, in its mode");
        }
        if self.watch.asked.stop {
            return self.bad_word("bit 4 does not rise beside a stop");
        }
        match sent.mode {
            1 => self.judge_set_point_sent(),
            6 if self.is_pending(Kind::Home) => Ok(()),
            _ => self.bad_word("nothing moves that nobody asked for"),
        }
    }

    /// Bit 8, where it may be high beside bit 4: the set-point replaces what its drive keeps.
    const fn halt_beside(&self, word: u16) -> u16 {
        let replaces = word & 0x0020 != 0;
        if self.config.traits.acknowledges_while_halted && replaces {
            HALT
        } else {
            0
        }
    }

    /// The command that stops the axis and holds it, and waits for the drive to take its set-point.
    fn pending_hold(&self) -> Option<u32> {
        let mut pending = self.pending.iter().rev().copied();
        pending.find(|id| self.issued[*id as usize].kind == Kind::Hold)
    }

    /// A set-point goes out.
    fn judge_set_point_sent(&mut self) -> Result<(), ()> {
        let sent = self.sent;
        let replaces = sent.bit(5) && !sent.bit(6) && !self.drive.making.passes_by_bit_5;
        if self.sample.word & ACKNOWLEDGE != 0 && !replaces {
            return self.bad_word("bit 4 rises after an acknowledged low");
        }
        let seen = self.watch.low.is_some_and(|(since, acknowledge)| {
            let fell = acknowledge && self.sample.word & ACKNOWLEDGE == 0;
            fell || self.now - since >= self.config.traits.surely_seen()
        });
        if !seen {
            return self.bad_word("bit 4 is low until the drive has seen that");
        }
        if self.watch.needs_stop && self.is_inside() {
            return self.bad_word("after an open end no set-point goes out before a stop");
        }
        if sent.bit(8)
            && let Some(id) = self.pending_hold()
            && !self.issued[id as usize].sent
        {
            return self.judge_hold_sent(id);
        }
        let name = sent.velocity.wrapping_sub(self.program.speed) as usize;
        let bits = |a_move: &MoveCommand| self.start_bits(a_move);
        let issued = self.issued.get(name);
        let is_own = issued.is_some_and(|issued| {
            let a_move = issued.a_move.filter(|_| !issued.sent && !issued.done);
            a_move.is_some_and(|a_move| {
                let parameters = a_move.set_point.parameters;
                a_move.target == sent.target
                    && sent.word & START_BITS == bits(&a_move)
                    && Some(sent.acceleration) == parameters.acceleration
                    && Some(sent.deceleration) == parameters.deceleration
                    && sent.end_velocity == parameters.end_velocity.unwrap_or(0)
            })
        });
        if !is_own {
            return self.bad_word("a set-point is sent once, as it was asked for");
        }
        self.issued[name].sent = true;
        Ok(())
    }

    /// Bits 5, 6 and 9 of a move.
    pub fn start_bits(&self, a_move: &MoveCommand) -> u16 {
        let start = match a_move.set_point.buffer_mode {
            BufferMode::Aborting => 0x0020,
            BufferMode::Buffered => 0,
            BufferMode::Blending if self.drive.making.passes_by_bit_5 => 0x0020,
            BufferMode::Blending => 0x0200,
        };
        match a_move.reference {
            Reference::Absolute => start,
            Reference::Relative => start | 0x0040,
        }
    }

    /// Bit 4 does not rise.
    fn judge_kept_set_point(&mut self) -> Result<(), ()> {
        let (sent, before) = (self.sent, self.sent_before);
        // While a fault stops the axis no word of ours counts.
        if !sent.starts() || !before.starts() || self.sample.is_fault() {
            return Ok(());
        }
        let of = |outputs: crate::words::Outputs| {
            let ramps = (outputs.acceleration, outputs.deceleration);
            (
                outputs.word & START_BITS,
                outputs.target,
                outputs.velocity,
                ramps,
            )
        };
        if of(sent) == of(before) {
            return Ok(());
        }
        self.bad_word("a set-point stays as it is under a high bit 4")
    }

    /// The set-point of a hold leads to where the axis stands.
    fn judge_hold_sent(&mut self, id: u32) -> Result<(), ()> {
        let target = f64::from(self.sent.target) + self.drive.zero();
        let away = self.drive.apart(target, self.drive.position);
        let stops = self.sent.end_velocity == 0;
        let hold = &mut self.issued[id as usize];
        if hold.sent || !stops || away > self.drive.no_way() {
            return self.bad_word("a hold leads to where the axis stands, and is sent once");
        }
        hold.sent = true;
        Ok(())
    }

    /// Notes when the answer to a low bit 4 came.
    pub fn note_low(&mut self) {
        let drives = self.sample.is_enabled() && self.sample.mode == 1;
        let begins = !core::mem::replace(&mut self.watch.drives, drives) && drives;
        let delivered = self.told == Told::Fresh && !self.sent.bit(4);
        let high = self.sample.word & ACKNOWLEDGE != 0;
        match &mut self.watch.low {
            low @ None if delivered => *low = Some((self.now, high)),
            // Where the mode begins with bit 12 high, the drive has seen the low by the words before.
            Some((_, acknowledge)) if begins => *acknowledge |= high,
            _ => {}
        }
    }

    /// No bit outlives what set it.
    fn judge_bits(&mut self, rises: u16) -> Result<(), ()> {
        const LAW: &str = "no bit outlives what set it";
        let (word, before) = (self.sent.word, self.sent_before.word);
        if self.sent.bit(4) {
            self.watch.low = None;
        }
        let starts = !self.sent.bit(4) && word & START_BITS != 0;
        if word & 0xFC00 != 0 || (starts && !self.config.traits.start_bits_first) {
            return self.bad_word(LAW);
        }
        if self.sent.bit(7) && (word != 0x0080 || !self.is_pending(Kind::Reset)) {
            return self.bad_word(LAW);
        }
        if word & HALT != 0 && self.watch.halt_coasts {
            return self.bad_word("bit 8 is not sent where the axis would coast");
        }
        // A homing that does not end is halted by the core itself.
        let halts = self.watch.asked.halt || self.expired || self.sent.mode == 6;
        if rises & HALT != 0 && !halts {
            return self.bad_word(LAW);
        }
        let drives = word & 0x8F == 0x0F;
        if drives && before & 0x18F == 0x10F && word & HALT == 0 {
            // What is over for all that shows may have its last counts before it.
            let holds = self.drive.holds();
            let holds = holds.is_some_and(|gap| gap > self.drive.no_way());
            if !self.watch.resume_asked && self.sample.is_enabled() && holds {
                return self.bad_word("bit 8 falls by a resume");
            }
            self.watch.resume_asked = false;
        }
        Ok(())
    }

    /// Nothing moves that nobody asked for.
    fn judge_orders(&mut self) -> Result<(), ()> {
        const LAW: &str = "nothing moves that nobody asked for";
        let (sent, before) = (self.sent, self.sent_before);
        let enables = sent.is_enable_operation() && !before.is_enable_operation();
        if enables && !self.is_pending(Kind::Enable) {
            return self.bad_word(LAW);
        }
        if sent.target_velocity != 0 && !self.is_pending(Kind::Jog) {
            return self.bad_word(LAW);
        }
        // In this mode the drive goes at once to where 607Ah leads.
        let follows = sent.mode == 8 && self.drive.mode == 8 && sent.is_enable_operation();
        let target = f64::from(sent.target) + self.drive.zero();
        let away = self.drive.apart(target, self.drive.position);
        if follows && away > self.drive.no_way() {
            return self.bad_word(LAW);
        }
        Ok(())
    }

    fn is_pending(&self, kind: Kind) -> bool {
        let mut kinds = self.pending.iter().map(|id| self.issued[*id as usize].kind);
        kinds.any(|pending| pending == kind)
    }
}
