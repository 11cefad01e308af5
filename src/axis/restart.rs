//! An axis whose drive is recovered after it has left OP or was without power: it begins again, disabled.

use core::time::Duration;

use crate::{
    ds402::{Controlword, Mode, State},
    homing::Procedure,
    profile_position::{Sequencer, Standstill},
    profile_velocity::Jogging,
};

use super::{AxisConfig, AxisCore, brake::Brake, power::Power, stopping::Stopping};

/// What is known of the drive of an axis that begins again.
#[derive(Debug)]
pub(crate) enum Again {
    /// Nothing yet: its outputs must be harmless, whatever comes.
    Unknown,
    /// It has kept its power, and with it what it knows.
    Kept,
    /// It was without power, or was set back: this is what it holds now.
    Anew(Box<AxisConfig>),
}

impl AxisCore {
    /// Begins again as if it had just been made, for a drive that does not act on its outputs now. Everything that is pending ends
    /// as lost. No enable, set-point or velocity is left in the outputs. The axis counts as lost until its drive takes outputs
    /// again.
    pub(crate) fn restart(&mut self, now: Duration, again: Again, outputs: &mut [u8]) {
        if !self.lost {
            self.lose(now);
        }
        // Of a drive that answers, those who wait for a stop have waited on. What it shows from now on is of another beginning.
        self.fail_commands(self.failure_of_loss());
        match again {
            Again::Unknown => {}
            Again::Kept => self.homed = self.homed_before_loss,
            Again::Anew(config) => self.attach(*config),
        }
        // Where it may still be moving, switching off would let it coast.
        let may_move = matches!(
            self.state(),
            State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive
        );
        self.power = if may_move { Power::Holding } else { Power::Off };
        self.sequencer = Sequencer::new(self.config.defaults);
        if let Some(sample) = self.sample {
            self.sequencer.follow_position(sample.position);
        }
        self.homing = Procedure::new(self.config.deadlines.standstill);
        self.jogging = Jogging::new();
        self.stopping = Stopping::default();
        self.halted = false;
        self.halt_delivered = None;
        self.mode_change = None;
        self.set_manufacturer_bits(Controlword::empty());
        self.sent = Controlword::empty();
        self.sent_velocity = 0;
        self.quiet_since = None;
        self.write_outputs(outputs);
    }

    /// The drive's power was off: what it knew before is gone, its position among it.
    pub(crate) const fn forget(&mut self) {
        self.homed = false;
        self.homed_before_loss = false;
    }

    /// What the drive holds now, of which nothing has been seen yet.
    fn attach(&mut self, config: AxisConfig) {
        self.forget();
        (self.config, self.bounds) = config.with_bounds();
        self.sample = None;
        self.standstill = Standstill::default();
        self.brake = Brake::default();
        self.limit_tells = false;
        self.noted_mode = Mode::None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::axis::{AxisFields, Command, CommandId, Event, Inputs};

    const QUICK_STOP: u16 = 0x0B;

    /// An axis that was enabled, and whose drive has shown this statusword last.
    fn enabled_then(statusword: u16) -> (AxisCore, [u8; 6], Duration) {
        let mut core = AxisCore::new(AxisConfig::new(AxisFields::at(0, 0)));
        let (mut outputs, mut now) = ([0; 6], Duration::ZERO);
        core.submit(now, CommandId(1), Command::Enable, &mut outputs);
        for word in [
            0x0250, 0x0250, 0x0250, 0x0231, 0x0233, 0x0237, 0x0237, 0x0237, statusword,
        ] {
            now += Duration::from_millis(1);
            let [low, high] = u16::to_le_bytes(word);
            core.step(now, Inputs::Fresh(&[low, high, 0, 0, 0, 0]), &mut outputs);
        }
        (core, outputs, now)
    }

    #[test]
    fn an_axis_that_may_still_be_moving_is_not_switched_off() {
        // Operation enabled, Quick stop active, Fault reaction active.
        for statusword in [0x0237, 0x0217, 0x023F] {
            let (mut core, mut outputs, now) = enabled_then(statusword);
            for again in [Again::Unknown, Again::Kept] {
                core.restart(now, again, &mut outputs);
                assert_eq!(
                    u16::from_le_bytes([outputs[0], outputs[1]]),
                    QUICK_STOP,
                    "{statusword:04X}"
                );
            }
        }
    }

    #[test]
    fn who_waits_for_a_stop_of_a_drive_that_answers_is_not_forgotten() {
        let (mut core, mut outputs, mut now) = enabled_then(0x0237);
        for cycle in 1..=core.config.loss.undelivered_cycles {
            now += Duration::from_millis(1);
            let position = (cycle as i32 * 100).to_le_bytes();
            let moving = [
                0x37,
                0x02,
                position[0],
                position[1],
                position[2],
                position[3],
            ];
            core.step(now, Inputs::Answered(&moving), &mut outputs);
        }
        assert!(core.is_lost());
        core.submit(now, CommandId(2), Command::Stop, &mut outputs);
        while core.poll_event().is_some() {}
        core.restart(now, Again::Kept, &mut outputs);
        let (id, event) = core.poll_event().expect("the stop has an end");
        assert_eq!(id, CommandId(2));
        assert!(matches!(event, Event::Done(Err(_))), "{event:?}");
    }

    #[test]
    fn a_drive_that_is_lost_in_its_fault_reaction_gets_a_quick_stop() {
        let (mut core, mut outputs, now) = enabled_then(0x023F);
        assert_eq!(outputs[0], 0x0B, "its reaction ignores that");
        for _ in 0..core.config.loss.stale_cycles {
            core.step(now, Inputs::Stale, &mut outputs);
        }
        assert!(core.is_lost());
        assert_eq!(u16::from_le_bytes([outputs[0], outputs[1]]), QUICK_STOP);
        // Fault: the reaction is over, and the axis stands.
        for cycle in 1..=110 {
            let now = now + Duration::from_millis(cycle);
            core.step(now, Inputs::Fresh(&[0x38, 0x02, 0, 0, 0, 0]), &mut outputs);
        }
        assert_eq!(u16::from_le_bytes([outputs[0], outputs[1]]), 0);
    }
}
