//! What a device checks before it goes one AL state up.

use super::Device;
use crate::al::{Checks, code};
use crate::description::{Direction, SyncManagerUse};
use crate::drive::Drive;

/// The checks of the AL state machine against a device's description and mapping.
pub(super) struct CheckedBy<'a>(pub(super) &'a Device);

impl CheckedBy<'_> {
    /// Process-data sync manager: as long as what is mapped, and its three buffers clear of all other sync managers.
    fn process_data_sync_manager(
        &self,
        purpose: SyncManagerUse,
        direction: Direction,
        code: u16,
    ) -> Result<(), u16> {
        let length = self.0.process_data_bytes(direction);
        let Some(index) = self.0.sync_manager(purpose) else {
            return if length == 0 { Ok(()) } else { Err(code) };
        };
        let settings = self.0.esc.sync_manager(index);
        if length == 0 {
            return if settings.enabled && settings.length > 0 {
                Err(code)
            } else {
                Ok(())
            };
        }
        let fits = settings.enabled
            && usize::from(settings.length) == length
            && !settings.is_mailbox()
            && settings.master_writes() == (direction == Direction::Outputs)
            && self.0.esc.is_clear_of_others(index);
        if fits { Ok(()) } else { Err(code) }
    }
}

impl CheckedBy<'_> {
    /// The SYNC unit: off, or in one of the modes that the device describes, with a cycle that it can follow.
    fn synchronisation(&self) -> Result<(), u16> {
        let unit = self.0.esc.sync_unit();
        let wants_sync0 = self.0.drive.as_ref().is_some_and(Drive::wants_sync0);
        if !unit.is_on && !unit.sync0 && !unit.sync1 {
            return if wants_sync0 || self.0.description().clock_demand.is_some() {
                Err(code::INVALID_SYNC)
            } else {
                Ok(())
            };
        }
        // AssignActivate has the bits of 0981h in its upper byte.
        let activation =
            u16::from(unit.is_on) | u16::from(unit.sync0) << 1 | u16::from(unit.sync1) << 2;
        let modes = &self.0.description().clock_modes;
        if !modes
            .iter()
            .any(|mode| mode.assign_activate >> 8 == activation)
        {
            return Err(code::INVALID_SYNC);
        }
        let step = self.0.description().sync0_step_ns.max(1);
        match unit.cycle_ns {
            // Assumed: no drive follows a single pulse.
            0 => Err(code::INVALID_SYNC_CYCLE),
            cycle if cycle % step != 0 => Err(code::UNSUPPORTED_SYNC0_CYCLE),
            _ => Ok(()),
        }
    }

    /// The watchdog: triggered and with a time, or neither, where the device looks at that.
    fn watchdog(&self) -> Result<(), u16> {
        let Some(outputs) = self.0.sync_manager(SyncManagerUse::Outputs) else {
            return Ok(());
        };
        let esc = &self.0.esc;
        let agrees = esc.sync_manager(outputs).triggers_watchdog() == esc.watchdog_has_time();
        let has_outputs = self.0.process_data_bytes(Direction::Outputs) > 0;
        if agrees || !has_outputs || !self.0.description().checks_watchdog {
            Ok(())
        } else {
            Err(code::INVALID_WATCHDOG)
        }
    }

    fn outputs_are_valid(&self) -> bool {
        let Some(index) = self.0.sync_manager(SyncManagerUse::Outputs) else {
            return true;
        };
        if self.0.process_data_bytes(Direction::Outputs) == 0 {
            return true;
        }
        let in_time = !self.0.esc.watchdog_is_armed(index) || self.0.esc.watchdog_is_running();
        self.0.completed_outputs() != self.0.outputs_before && in_time
    }
}

impl Checks for CheckedBy<'_> {
    fn mailbox(&self) -> Result<(), u16> {
        if self.0.description().emulates_eeprom && !self.0.esc.sii_is_with_the_device() {
            return Err(code::EEPROM_ERROR);
        }
        let Some(mailbox) = self.0.description().mailbox else {
            return Ok(());
        };
        let shorter = self.0.description().takes_shorter_mailboxes;
        let check = |purpose, (start, length): (u16, u16), master_writes| {
            self.0
                .sync_manager(purpose)
                .map(|index| self.0.esc.sync_manager(index))
                .is_some_and(|settings| {
                    settings.enabled
                        && settings.is_mailbox()
                        && settings.master_writes() == master_writes
                        && settings.start == start
                        && (settings.length == length || shorter && settings.length < length)
                })
        };
        let fits = check(SyncManagerUse::MailboxOut, mailbox.out, true)
            && check(SyncManagerUse::MailboxIn, mailbox.input, false);
        if fits {
            Ok(())
        } else {
            Err(code::INVALID_MAILBOX)
        }
    }

    fn process_data(&self) -> Result<(), u16> {
        self.process_data_sync_manager(
            SyncManagerUse::Outputs,
            Direction::Outputs,
            code::INVALID_OUTPUTS,
        )?;
        self.process_data_sync_manager(
            SyncManagerUse::Inputs,
            Direction::Inputs,
            code::INVALID_INPUTS,
        )?;
        self.synchronisation()?;
        self.watchdog()
    }

    fn ready_for_op(&self) -> Result<(), u16> {
        if !self.outputs_are_valid() {
            return Err(code::NO_VALID_OUTPUTS);
        }
        self.synchronisation()?;
        if self.0.esc.sync_unit().is_on && !self.0.esc.sync0_runs() {
            return Err(code::NO_SYNC);
        }
        let demand = self.0.description().clock_demand;
        if demand.is_some_and(|demand| !self.0.synchronisation.has_locked(demand)) {
            return Err(code::PLL);
        }
        Ok(())
    }
}
