//! What the processor behind the ESC does by itself, and when something was written to it.

use core::time::Duration;

use super::checks::CheckedBy;
use super::post::SyncManagers;
use super::{Device, OUTPUTS_PATIENCE};
use crate::al::{AlState, Checks, code};
use crate::coe::{Server, emergency_payload};
use crate::description::{Direction, SyncManagerUse};
use crate::drive::Drive;
use crate::ds402::Emergency;
use crate::mailbox::MailError;

impl Device {
    /// When the device does something by itself next: a cycle, a pulse of SYNC0 or the end of the watchdog's patience.
    pub(crate) fn next_event(&self) -> Option<Duration> {
        let watchdog = self.esc.watchdog_deadline().unwrap_or(Duration::MAX);
        let pulse = self.esc.pulse_at().unwrap_or(Duration::MAX);
        self.powered
            .then(|| self.next_cycle.min(watchdog).min(pulse))
    }

    /// Begins cycles at a time, when it has none yet.
    pub(crate) fn start_at(&mut self, now: Duration) {
        self.next_cycle = now;
    }

    /// Does what is due at `now`; `true` when that was a cycle.
    pub(crate) fn run(&mut self, now: Duration) -> bool {
        if self.esc.check_watchdog(now) && !self.frozen {
            self.watchdog_expired();
        }
        if let Some(pulse) = self.esc.take_pulse(now) {
            self.pulse(pulse, now);
        }
        if self.next_cycle > now {
            return false;
        }
        let period = self.period();
        self.next_cycle = now.saturating_add(self.synchronisation.cycle(period));
        if !self.frozen {
            self.cycle(now);
        }
        !self.frozen
    }

    fn period(&self) -> Duration {
        self.blueprint.cycle.max(Duration::from_micros(1))
    }

    /// SYNC0: the drive looks whether outputs came in time, and its processor goes along with the pulses.
    fn pulse(&mut self, pulse: u64, now: Duration) {
        let before = self.al.state();
        if before < AlState::SafeOp {
            return;
        }
        let unit = self.esc.sync_unit();
        let period = self.period();
        if self.synchronisation.follow(unit.cycle_ns, period) {
            self.next_cycle = now;
        }
        let Some(demand) = self.description().clock_demand.filter(|_| !self.frozen) else {
            return;
        };
        let limit = self.drive.as_ref().map_or(0, Drive::sync_error_limit);
        let outputs_at = self.esc.outputs_at();
        let verdict = self
            .synchronisation
            .judge(demand, pulse, unit.cycle_ns, outputs_at);
        if let Some(code) = verdict.filter(|_| before == AlState::Op)
            && self.synchronisation.exceeds(limit)
        {
            self.lose_synchronisation(code);
        }
    }

    /// Falls to SAFEOP because of SYNC0, with the drive's own fault where it has one.
    fn lose_synchronisation(&mut self, code: u16) {
        let before = self.al.state();
        self.al.fall(AlState::SafeOp, code);
        self.after_al(before);
        let demand = self.description().clock_demand;
        if let (Some(fault), Some(drive)) =
            (demand.and_then(|demand| demand.fault), &mut self.drive)
        {
            drive
                .axes_mut()
                .iter_mut()
                .for_each(|axis| axis.raise_fault(fault));
        }
    }

    /// Reacts to what a datagram did to the ESC.
    pub(crate) fn after_datagram(&mut self, now: Duration) {
        if self.frozen {
            return;
        }
        self.look_at_al_control(now);
        if self.synchronisation.is_on() && !self.esc.sync0_runs() {
            // The processor notices in its own cycle.
            self.next_cycle = self.next_cycle.min(now.saturating_add(self.period()));
        }
        if self.esc.take_sync_manager_change() && self.al.state() >= AlState::SafeOp {
            let before = self.al.state();
            if let Err(code) = CheckedBy(self).process_data() {
                self.al.fall(AlState::PreOp, code);
                self.after_al(before);
            }
        }
        self.poll_mailbox(now);
    }

    fn look_at_al_control(&mut self, now: Duration) {
        let written = self.esc.take_al_control();
        if let Some(control) = self.practice.al_control(written, now) {
            let before = self.al.state();
            let mut al = self.al.clone();
            match self.practice.habits.falls {
                Some((asked, to, code)) if control & 0x0F == u16::from(asked as u8) => {
                    al.fall(to, code);
                }
                _ => al.request(control, &CheckedBy(self), now, OUTPUTS_PATIENCE),
            }
            self.al = al;
            self.after_al(before);
        }
    }

    fn cycle(&mut self, now: Duration) {
        self.look_at_al_control(now);
        let before = self.al.state();
        let mut al = self.al.clone();
        al.poll(&CheckedBy(self), now);
        self.al = al;
        self.after_al(before);
        let runs = self.esc.sync0_runs() && !self.synchronisation.is_overdue();
        if self.al.state() == AlState::Op && self.synchronisation.is_on() && !runs {
            self.lose_synchronisation(code::SYNC_LOST);
        }
        if self.al.state() == AlState::Op {
            self.outputs = self.last_outputs().to_vec();
            if let Some(drive) = &mut self.drive {
                drive.write_outputs(&self.outputs);
            }
        }
        if let Some(drive) = &mut self.drive {
            drive.cycle(now);
        }
        while let Some(emergency) = self.take_emergency(now) {
            if self.mailbox_is_running() {
                let payload = emergency_payload(emergency.code, emergency.register, emergency.data);
                self.mailbox.push_emergency(payload);
            }
        }
        self.publish_inputs();
        self.poll_mailbox(now);
    }

    fn take_emergency(&mut self, now: Duration) -> Option<Emergency> {
        self.drive.as_mut()?.take_emergency(now)
    }

    /// Follows a change of the AL state with what belongs to it.
    pub(super) fn after_al(&mut self, before: AlState) {
        let state = self.al.state();
        let (status, code) = self.al.registers();
        self.esc.set_al_status(status, code);
        if state == before {
            return;
        }
        if self.drive.is_none() && state != AlState::Op {
            self.outputs.fill(0);
        }
        if let Some(drive) = &mut self.drive
            && (state == AlState::Op) != (before == AlState::Op)
        {
            drive.set_connected(state == AlState::Op);
        }
        let unit = self.esc.sync_unit();
        if state <= AlState::SafeOp {
            self.synchronisation.leave();
        }
        if state == AlState::Op && unit.is_on {
            self.synchronisation.enter();
        }
        if let Some(drive) = &mut self.drive {
            drive.set_sync0((state >= AlState::SafeOp && unit.is_on).then_some(unit.cycle_ns));
        }
        if state == AlState::SafeOp {
            // Outputs from before do not count for the next way to OP.
            self.outputs_before = self.completed_outputs();
            self.publish_inputs();
        }
        if state == AlState::Init {
            self.mailbox.reset();
            self.server = Server::new(self.description().mailbox);
        }
    }

    fn watchdog_expired(&mut self) {
        let armed = self
            .sync_manager(SyncManagerUse::Outputs)
            .is_some_and(|index| self.esc.watchdog_is_armed(index));
        if self.al.state() == AlState::Op && armed {
            self.al.fall(AlState::SafeOp, code::WATCHDOG);
            self.after_al(AlState::Op);
        }
    }

    fn publish_inputs(&mut self) {
        if self.al.state() >= AlState::SafeOp
            && let Some(index) = self.sync_manager(SyncManagerUse::Inputs)
        {
            let inputs = self
                .drive
                .as_ref()
                .map_or_else(|| self.plain_inputs.clone(), Drive::read_inputs);
            self.esc.set_buffer(index, &inputs);
        }
    }

    pub(super) fn mailbox_is_running(&self) -> bool {
        self.description().mailbox.is_some() && self.al.state() != AlState::Init
    }

    pub(super) fn poll_mailbox(&mut self, now: Duration) {
        if !self.mailbox_is_running() {
            return;
        }
        let (Some(out), Some(input)) = (
            self.sync_manager(SyncManagerUse::MailboxOut),
            self.sync_manager(SyncManagerUse::MailboxIn),
        ) else {
            return;
        };
        let is_preop = self.al.state() == AlState::PreOp;
        let Self {
            esc,
            mailbox,
            server,
            drive,
            practice,
            ..
        } = self;
        server.fit(esc.sync_manager(input).length);
        let mut post = SyncManagers { esc, out, input };
        mailbox.poll(&mut post, now, |payload| {
            let drive = drive.as_mut().ok_or(MailError::UnsupportedProtocol)?;
            let replies = match practice.refuse(payload) {
                Some(refusal) => vec![refusal],
                None => {
                    let by_mailbox = practice.habits.refuses_information_by_mailbox;
                    server.serve(payload, &mut drive.sdo(is_preop), by_mailbox)?
                }
            };
            Ok(practice.surround(replies))
        });
    }

    pub(super) fn sync_manager(&self, purpose: SyncManagerUse) -> Option<usize> {
        self.blueprint.description.sync_manager_for(purpose)
    }

    pub(super) fn completed_outputs(&self) -> u32 {
        self.sync_manager(SyncManagerUse::Outputs)
            .map_or(0, |index| self.esc.completed_buffers(index))
    }

    pub(super) fn process_data_bytes(&self, direction: Direction) -> usize {
        let plain = || self.description().process_data_bytes(direction);
        self.drive
            .as_ref()
            .map_or_else(plain, |drive| drive.bytes(direction))
    }
}
