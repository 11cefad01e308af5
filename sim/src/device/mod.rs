//! One SubDevice: its ESC, and the processor behind it with AL state machine, mailbox and process data.

mod checks;
mod dictionary;
mod habits;
mod post;
mod synchronisation;

use core::time::Duration;

use crate::al::{AlMachine, AlState, Checks, code};
use crate::coe::{Server, emergency_payload};
use crate::description::{Description, Direction, SyncManagerUse};
use crate::drive::{Drive, DriveBlueprint};
use crate::ds402::Axis;
use crate::esc::{Esc, Place};
use crate::mailbox::{MailError, Mailbox};
use crate::sii;
use checks::CheckedBy;
pub use dictionary::{ListedEntry, ListedObject};
pub use habits::Habits;
use habits::Practice;
use post::SyncManagers;
use synchronisation::Synchronisation;

/// How long a request for OP waits for outputs before it is refused. Assumed: real firmware waits, some longer.
const OUTPUTS_PATIENCE: Duration = Duration::from_millis(200);

/// What a device is made of; after a power failure it is made again from the same.
#[derive(Clone, Debug)]
pub struct Blueprint {
    /// What it says about itself.
    pub description: Description,
    /// The drive behind it, when it is one.
    pub drive: Option<DriveBlueprint>,
    /// Time between two cycles of its processor.
    pub cycle: Duration,
}

/// One SubDevice.
///
/// ```
/// use servocrab_sim::{Segment, personality};
/// let mut segment = Segment::new();
/// segment.push(personality::coupler());
/// segment.push(personality::akd2g());
/// assert_eq!(segment.len(), 2);
/// ```
#[derive(Clone, Debug)]
pub struct Device {
    blueprint: Blueprint,
    powered: bool,
    frozen: bool,
    esc: Esc,
    al: AlMachine,
    mailbox: Mailbox,
    server: Server,
    drive: Option<Drive>,
    plain_inputs: Vec<u8>,
    outputs: Vec<u8>,
    /// Output buffers completed when SAFEOP was entered.
    outputs_before: u32,
    synchronisation: Synchronisation,
    /// The clock's begin in nanoseconds, and by how many parts per billion its crystal is too fast.
    crystal: (u64, i32),
    next_cycle: Duration,
    practice: Practice,
}

impl Device {
    /// A device that has just been switched on.
    #[must_use]
    pub fn new(blueprint: Blueprint) -> Self {
        let description = &blueprint.description;
        // Any start will do for a free-running clock, as long as no two kinds of devices have the same.
        let clock_start = u64::from(description.identity.product) * 1_000;
        let esc = Esc::new(
            sii::image(description),
            description.sii_reads_eight_bytes,
            description.supports_lrw,
            description.clock,
            clock_start,
        );
        let drive = blueprint
            .drive
            .as_ref()
            .map(|drive| Drive::new(drive, description));
        let mut device = Self {
            powered: true,
            frozen: false,
            esc,
            al: AlMachine::new(),
            mailbox: Mailbox::default(),
            server: Server::new(description.mailbox),
            drive,
            plain_inputs: vec![0; description.process_data_bytes(Direction::Inputs)],
            outputs: Vec::new(),
            outputs_before: 0,
            synchronisation: Synchronisation::default(),
            crystal: (clock_start, 0),
            next_cycle: Duration::ZERO,
            practice: Practice::default(),
            blueprint,
        };
        device
            .esc
            .set_al_status(device.al.status(), device.al.code());
        device
    }

    /// What the device says about itself.
    #[must_use]
    pub fn description(&self) -> &Description {
        &self.blueprint.description
    }

    /// AL state.
    #[must_use]
    pub fn al_state(&self) -> AlState {
        self.al.state()
    }

    /// AL status code (register 0134h); zero without error.
    #[must_use]
    pub fn al_status_code(&self) -> u16 {
        self.al.code()
    }

    /// The axes, none when it is no drive.
    #[must_use]
    pub fn axes(&self) -> &[Axis] {
        self.drive.as_ref().map_or(&[], Drive::axes)
    }

    /// An axis, counted from zero.
    #[must_use]
    pub fn axis(&self, axis: usize) -> Option<&Axis> {
        self.axes().get(axis)
    }

    /// An axis to be changed, counted from zero.
    pub fn axis_mut(&mut self, axis: usize) -> Option<&mut Axis> {
        self.drive.as_mut()?.axes_mut().get_mut(axis)
    }

    /// The outputs that the device used in its last cycle in OP. Those of a device that is no drive fall to 0 when it leaves
    /// OP, as the terminals of a digital output do.
    #[must_use]
    pub fn outputs(&self) -> &[u8] {
        &self.outputs
    }

    /// The last whole buffer of outputs that arrived, used or not.
    #[must_use]
    pub fn last_outputs(&self) -> &[u8] {
        self.sync_manager(SyncManagerUse::Outputs)
            .map_or(&[], |index| self.esc.buffer(index))
    }

    /// Sets the inputs of a device without CoE, as its terminals would; as many bytes as it has count.
    pub fn set_inputs(&mut self, bytes: &[u8]) {
        self.plain_inputs
            .iter_mut()
            .zip(bytes)
            .for_each(|(input, byte)| *input = *byte);
    }

    /// Sends an emergency (code, error register, the maker's five bytes) ahead of every queued reply, at once when the
    /// mailbox is free. Without a mailbox, or in INIT, nothing is sent.
    pub fn inject_emergency(&mut self, code: u16, register: u8, data: [u8; 5], now: Duration) {
        if let Some(drive) = &mut self.drive {
            drive.record_error(code);
        }
        if self.mailbox_is_running() {
            self.mailbox
                .push_emergency(emergency_payload(code, register, data));
            self.poll_mailbox(now);
        }
    }

    /// Number of mails that wait behind the one in the sync manager.
    #[must_use]
    pub fn queued_mails(&self) -> usize {
        self.mailbox.queued()
    }

    /// Sets the time that the device takes to answer a mail.
    pub fn set_mailbox_delay(&mut self, delay: Duration) {
        self.mailbox.delay = delay;
    }

    /// Sets the time that the EEPROM takes for a command of its interface (0502h).
    pub fn set_sii_delay(&mut self, delay: Duration) {
        self.esc.sii_delay = delay;
    }

    /// Gives the distributed clock another time at power-up, in nanoseconds, and a crystal that is too fast by so many
    /// parts per million; with -1 000 000 it stands still. Later than before the first frame the clock jumps, and forgets
    /// the speed that it has learned.
    pub fn set_clock(&mut self, start_ns: u64, drift_ppm: f64) {
        self.crystal = (start_ns, (drift_ppm * 1_000.0) as i32);
        self.esc.set_clock(self.crystal.0, self.crystal.1);
    }

    /// The distributed clock's copy of the system time at this time of the simulation, in nanoseconds.
    #[must_use]
    pub fn system_time(&self, now: Duration) -> u64 {
        self.esc.copy_of_system_time(now)
    }

    /// Pulses of SYNC0 since SAFEOP that came without outputs in time, where the drive insists on them.
    #[must_use]
    pub fn sync_mistakes(&self) -> u64 {
        self.synchronisation.mistakes()
    }

    /// How many commands the EEPROM has had since power-up.
    #[must_use]
    pub fn sii_accesses(&self) -> u64 {
        self.esc.sii_accesses
    }

    /// How many mails the device has taken since power-up.
    #[must_use]
    pub fn mails_taken(&self) -> u64 {
        self.esc.mails_taken
    }

    /// Makes the device fall to SAFEOP, or stay below it, with an error, as after a fault of its own.
    pub fn fall_to_safe_op(&mut self, al_status_code: u16) {
        self.fall_to(AlState::SafeOp, al_status_code);
    }

    /// Stops or restarts the processor behind the ESC. While it stands, registers, memory and the last process data still
    /// answer, but no mail, no AL request and no axis is served.
    pub fn freeze(&mut self, frozen: bool) {
        self.frozen = frozen;
    }

    /// Whether it has power.
    #[must_use]
    pub fn is_powered(&self) -> bool {
        self.powered
    }

    /// Switches the power off: the device forgets everything but what is in its EEPROM, and no frame passes it.
    pub fn power_off(&mut self) {
        self.powered = false;
    }

    /// Switches the power on: the device starts in INIT, its axes stand where they stopped and count from there, or from
    /// where their absolute encoders say.
    pub fn power_on(&mut self, now: Duration) {
        if !self.powered {
            let delay = self.mailbox.delay;
            let sii_delay = self.esc.sii_delay;
            let (place, crystal) = (self.esc.place(), self.crystal);
            let axes: Vec<Axis> = self.axes().iter().map(Axis::restarted).collect();
            *self = Self::new(self.blueprint.clone());
            if let Some(drive) = &mut self.drive {
                for (axis, restarted) in drive.axes_mut().iter_mut().zip(axes) {
                    *axis = restarted;
                }
            }
            self.mailbox.delay = delay;
            self.esc.sii_delay = sii_delay;
            self.esc.set_place(place);
            self.crystal = crystal;
            self.esc.set_clock(crystal.0, crystal.1);
            self.next_cycle = now;
        }
    }

    pub(crate) fn set_place(&mut self, place: Place) {
        self.esc.set_place(place);
    }

    pub(crate) fn esc(&mut self) -> &mut Esc {
        &mut self.esc
    }

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
        if let Some(control) = self.esc.take_al_control() {
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

    fn cycle(&mut self, now: Duration) {
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
        while let Some(emergency) = self.drive.as_mut().and_then(Drive::take_emergency) {
            if self.mailbox_is_running() {
                let payload = emergency_payload(emergency.code, emergency.register, emergency.data);
                self.mailbox.push_emergency(payload);
            }
        }
        self.publish_inputs();
        self.poll_mailbox(now);
    }

    /// Follows a change of the AL state with what belongs to it.
    fn after_al(&mut self, before: AlState) {
        let state = self.al.state();
        self.esc.set_al_status(self.al.status(), self.al.code());
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

    fn mailbox_is_running(&self) -> bool {
        self.description().mailbox.is_some() && self.al.state() != AlState::Init
    }

    fn poll_mailbox(&mut self, now: Duration) {
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
        let mut post = SyncManagers { esc, out, input };
        mailbox.poll(&mut post, now, |payload| {
            let drive = drive.as_mut().ok_or(MailError::UnsupportedProtocol)?;
            let replies = match practice.refuse(payload) {
                Some(refusal) => vec![refusal],
                None => server.serve(payload, &mut drive.sdo(is_preop))?,
            };
            Ok(practice.surround(replies))
        });
    }

    fn sync_manager(&self, purpose: SyncManagerUse) -> Option<usize> {
        self.blueprint.description.sync_manager_for(purpose)
    }

    fn completed_outputs(&self) -> u32 {
        self.sync_manager(SyncManagerUse::Outputs)
            .map_or(0, |index| self.esc.completed_buffers(index))
    }

    fn process_data_bytes(&self, direction: Direction) -> usize {
        let plain = || self.description().process_data_bytes(direction);
        self.drive
            .as_ref()
            .map_or_else(plain, |drive| drive.bytes(direction))
    }
}
