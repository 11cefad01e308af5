//! One SubDevice: its ESC, and the processor behind it with AL state machine, mailbox and process data.

mod checks;
mod dictionary;
mod habits;
mod post;
mod processor;
mod synchronisation;

use core::time::Duration;

use crate::al::{AlMachine, AlState};
use crate::coe::{Server, emergency_payload};
use crate::description::{Description, Direction, SyncManagerUse};
use crate::drive::{Drive, DriveBlueprint};
use crate::ds402::{Axis, Plant};
pub use crate::esc::EepromReload;
use crate::esc::{Esc, Place};
use crate::mailbox::Mailbox;
use crate::sii;
use crate::topology::Port;
pub use dictionary::{ListedEntry, ListedObject};
pub use habits::Habits;
use habits::Practice;
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
    /// It was switched on, and its neighbours have not noticed yet.
    fresh: bool,
    frozen: bool,
    esc: Esc,
    al: AlMachine,
    mailbox: Mailbox,
    server: Server,
    drive: Option<Drive>,
    plain_inputs: Vec<u8>,
    outputs: Vec<u8>,
    /// Where an identification is shown at all times, and which.
    identification_word: Option<(u16, u16)>,
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
        let eeprom = sii::image(&blueprint.description);
        Self::with_eeprom(blueprint, eeprom, None)
    }

    /// One with this in its EEPROM. Where that is no valid image, the processor runs only if it serves the EEPROM itself.
    fn with_eeprom(blueprint: Blueprint, eeprom: Vec<u8>, identification: Option<u16>) -> Self {
        let description = &blueprint.description;
        // Any start will do for a free-running clock, as long as no two kinds of devices have the same.
        let clock_start = u64::from(description.identity.product) * 1_000;
        let esc = Esc::new(
            eeprom,
            description.sii_reads_eight_bytes,
            description.emulates_eeprom,
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
            fresh: true,
            frozen: false,
            esc,
            al: AlMachine::new(identification),
            mailbox: Mailbox::serving(description.mailbox.map_or(0, |mailbox| mailbox.protocols)),
            server: Server::new(description.mailbox),
            drive,
            plain_inputs: vec![0; description.process_data_bytes(Direction::Inputs)],
            outputs: Vec::new(),
            identification_word: None,
            outputs_before: 0,
            synchronisation: Synchronisation::default(),
            crystal: (clock_start, 0),
            next_cycle: Duration::ZERO,
            practice: Practice::default(),
            blueprint,
        };
        let (status, code) = device.al.registers();
        device.esc.set_al_status(status, code);
        device.freeze(!device.esc.is_sii_loaded() && !device.description().emulates_eeprom);
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

    /// Hangs a plant on every axis; each has a seed of its own, one more than the axis before.
    pub fn set_plant(&mut self, plant: Plant) {
        let axes = self.drive.iter_mut().flat_map(Drive::axes_mut);
        for (number, axis) in (0..).zip(axes) {
            axis.set_plant(plant.with_seed(plant.seed.wrapping_add(number)));
        }
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
            drive.record_error(code, register, now);
        }
        if self.mailbox_is_running() {
            self.mailbox
                .push_emergency(emergency_payload(code, register, data));
            self.poll_mailbox(now);
        }
    }

    /// Number of messages that wait behind the one in the sync manager.
    #[must_use]
    pub fn queued_messages(&self) -> usize {
        self.mailbox.queued()
    }

    /// Sets the time that the device takes to answer a message.
    pub fn set_mailbox_delay(&mut self, delay: Duration) {
        self.mailbox.delay = delay;
    }

    /// Sets the time that the EEPROM takes for a command of its interface (0502h).
    pub fn set_sii_delay(&mut self, delay: Duration) {
        self.esc.sii_delay = delay;
    }

    /// Sets how much longer the EEPROM takes for a word that is written. Meanwhile it acknowledges no other command; where the processor
    /// serves it, it stays busy. Without power before the end the word is erased (FFFFh).
    pub fn set_sii_write_delay(&mut self, delay: Duration) {
        self.esc.sii_write_delay = delay;
    }

    /// Sets what a reload of the EEPROM does.
    pub fn set_eeprom_reload(&mut self, reload: EepromReload) {
        self.esc.sii_reload = reload;
    }

    /// What is in its EEPROM.
    #[must_use]
    pub fn eeprom(&self) -> &[u8] {
        self.esc.sii()
    }

    /// Writes a station alias into its EEPROM, with the checksum, as if it had been there at power-up: 0012h shows it at once.
    pub fn set_alias(&mut self, alias: u16) {
        self.blueprint.description.alias = alias;
        self.esc.set_alias(alias);
    }

    /// Sets what its ID selector shows: its explicit device identification (ETG.1020). While AL control bit 5 asks for it and there is
    /// no error, AL status bit 5 is set and 0134h has it. Without this a device ignores the bit. It is looked at when AL control is
    /// written, and outlives a loss of power.
    ///
    /// ```
    /// use core::time::Duration;
    /// use servocrab_sim::{Segment, personality};
    ///
    /// let mut segment = Segment::new().with(personality::akd2g().with_identification(7));
    /// // A BWR of AL control: INIT, and who it is; a BRD of AL status to the AL status code.
    /// let mut frame = vec![0xFF; 12];
    /// frame.extend([0x88, 0xA4, 32, 0x10]);
    /// frame.extend([8, 0, 0, 0, 0x20, 0x01, 2, 0x80, 0, 0, 0x21, 0, 0, 0]);
    /// frame.extend([7, 0, 0, 0, 0x30, 0x01, 6, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    /// assert!(segment.process(&mut frame, Duration::ZERO));
    /// assert_eq!(frame[40..46], [0x21, 0, 0, 0, 7, 0]);
    /// ```
    pub fn set_identification(&mut self, id: u16) {
        self.al.identify(id);
    }

    /// The device with this explicit device identification, as [`Device::set_identification`] sets it.
    #[must_use]
    pub fn with_identification(mut self, id: u16) -> Self {
        self.set_identification(id);
        self
    }

    /// Has a word of registers or memory show an identification at all times, as the `IdentificationAdo` of an ESI file says
    /// (ETG.2000). It outlives a loss of power.
    pub fn set_identification_word(&mut self, address: u16, id: u16) {
        self.identification_word = Some((address, id));
        self.esc.show_word(address, id);
    }

    /// Its processor has access to the EEPROM (0501h, bit 0), and keeps it until it is taken by force (0500h, bit 1).
    pub fn hold_eeprom(&mut self) {
        self.esc.hold_sii();
    }

    /// Gives the distributed clock another time at power-up, in nanoseconds, and a crystal that is too fast by so many
    /// parts per million; with -1 000 000 it stands still. Later than before the first frame the clock jumps, and forgets
    /// the speed that it has learned.
    pub fn set_clock(&mut self, start_ns: u64, drift_ppm: f64) {
        self.crystal = (start_ns, (drift_ppm * 1_000.0) as i32);
        self.esc.set_clock(self.crystal.0, self.crystal.1);
    }

    /// Gives the crystal of the distributed clock another error, as [`Device::set_clock`] does, from the same time at power-up.
    pub fn set_drift(&mut self, drift_ppm: f64) {
        self.set_clock(self.crystal.0, drift_ppm);
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

    /// How many messages the device has taken since power-up.
    #[must_use]
    pub fn messages_taken(&self) -> u64 {
        self.esc.messages_taken
    }

    /// Makes the device fall to SAFEOP, or stay below it, with an error, as after a fault of its own.
    pub fn fall_to_safe_op(&mut self, al_status_code: u16) {
        self.fall_to(AlState::SafeOp, al_status_code);
    }

    /// Stops or restarts the processor behind the ESC. While it stands, registers, memory and the last process data still
    /// answer, but no message, no AL request and no axis is served.
    pub fn freeze(&mut self, frozen: bool) {
        self.frozen = frozen;
        self.esc.set_processor_runs(!frozen);
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
            let (sii_delay, sii_write_delay) = (self.esc.sii_delay, self.esc.sii_write_delay);
            let sii_reload = self.esc.sii_reload;
            let (crystal, identification_word) = (self.crystal, self.identification_word);
            let axes: Vec<Axis> = self.axes().iter().map(Axis::restarted).collect();
            *self = Self::with_eeprom(
                self.blueprint.clone(),
                self.esc.sii().to_vec(),
                self.al.identification(),
            );
            if let Some(drive) = &mut self.drive {
                for (axis, restarted) in drive.axes_mut().iter_mut().zip(axes) {
                    *axis = restarted;
                }
            }
            self.mailbox.delay = delay;
            (self.esc.sii_delay, self.esc.sii_write_delay) = (sii_delay, sii_write_delay);
            self.esc.sii_reload = sii_reload;
            self.crystal = crystal;
            self.esc.set_clock(crystal.0, crystal.1);
            if let Some((address, id)) = identification_word {
                self.set_identification_word(address, id);
            }
            self.next_cycle = now;
        }
    }

    pub(crate) fn port(&self, port: usize) -> Port {
        match (self.esc.port_is_open(port), self.esc.has_link(port)) {
            (false, _) => Port::Closed,
            (true, true) => Port::Open,
            (true, false) => Port::OpenWithoutLink,
        }
    }

    pub(crate) fn set_links(&mut self, links: [bool; 4]) {
        if self.powered {
            self.esc.set_links(links);
        }
    }

    /// Whether it was switched on since this was last asked.
    pub(crate) fn take_fresh(&mut self) -> bool {
        core::mem::take(&mut self.fresh)
    }

    pub(crate) fn set_place(&mut self, place: Place) {
        self.esc.set_place(place);
    }

    pub(crate) fn esc(&mut self) -> &mut Esc {
        &mut self.esc
    }
}
