//! The EtherCAT SubDevice controller: registers, memory, sync managers, FMMUs, SII interface, watchdog and clock.
//! Seen from two sides: `read`, `write` and the logical access are the MainDevice's, the rest is the processor's.

mod clock;
mod fmmu;
pub(crate) mod registers;
mod sii_access;
pub(crate) mod sync_manager;
mod watchdog;

use core::ops::Range;
use core::time::Duration;

pub(crate) use clock::Place;
use clock::{Clock, difference};
use fmmu::Fmmu;
use registers as reg;
use registers::{CHANNELS, RAM_END, RAM_START, WriteRule};
use sync_manager::{Access, Settings, SyncManager};
use watchdog::Watchdog;

/// Size of the address space.
const SPACE: usize = 0x1_0000;

/// One ESC.
#[derive(Clone, Debug)]
pub(crate) struct Esc {
    memory: Vec<u8>,
    sync_managers: [SyncManager; CHANNELS],
    sii: Vec<u8>,
    sii_reads_eight_bytes: bool,
    clock: Clock,
    watchdog: Watchdog,
    place: Place,
    al_control_written: bool,
    sync_managers_written: bool,
}

/// Who answers for an address.
#[derive(Clone, Copy, Debug)]
enum Owner {
    Registers,
    Memory,
    SyncManager(usize, Settings),
    Nobody,
}

impl Esc {
    /// An ESC after power-up.
    pub(crate) fn new(
        sii: Vec<u8>,
        sii_reads_eight_bytes: bool,
        supports_lrw: bool,
        clock_start: u64,
    ) -> Self {
        let mut esc = Self {
            memory: vec![0; SPACE],
            sync_managers: Default::default(),
            sii,
            sii_reads_eight_bytes,
            clock: Clock::new(clock_start),
            watchdog: Watchdog::default(),
            place: Place::default(),
            al_control_written: false,
            sync_managers_written: false,
        };
        // Type 11h, revision 0, build 2: what an ET1100 reports.
        esc.set_word(reg::TYPE, 0x0011);
        esc.set_word(reg::TYPE + 2, 0x0002);
        esc.set_word(
            reg::FMMU_COUNT,
            u16::from_le_bytes([CHANNELS as u8, CHANNELS as u8]),
        );
        // 0006h: KiB of memory; 0007h: ports 0 and 1 are MII, the others are not there.
        esc.set_word(
            0x0006,
            u16::from_le_bytes([((RAM_END - RAM_START) / 1024) as u8, 0x0F]),
        );
        // Bits 2 and 3: distributed clocks with 64 bits; bit 9: LRW is not supported.
        esc.set_word(
            reg::FEATURES,
            0x000C | if supports_lrw { 0 } else { 0x0200 },
        );
        esc.set_word(reg::WATCHDOG_DIVIDER, 0x09C2);
        esc.set_word(reg::WATCHDOG_PDI, 0x03E8);
        esc.set_word(reg::WATCHDOG_PROCESS_DATA, 0x03E8);
        esc.set_word(reg::SII_CONTROL, esc.sii_idle_status());
        esc.load_configuration();
        esc
    }

    /// Tells the ESC where in the line it is; the port status follows from that.
    pub(crate) fn set_place(&mut self, place: Place) {
        self.place = place;
        // Bit 0: SII loaded; link at port 0 (bit 4), communication there (bit 9); ports 2 and 3 closed (bits 12, 14).
        let port1 = if place.behind > 0 { 0x0820 } else { 0x0400 };
        self.set_word(reg::DL_STATUS, 0x5211 | port1);
    }

    /// Whether a datagram with this station address means this device: configured address, or alias when 0100h bit 24
    /// allows it.
    pub(crate) fn has_address(&self, address: u16) -> bool {
        let alias_active = self.byte(reg::DL_CONTROL + 3) & 0x01 != 0;
        self.word(reg::STATION_ADDRESS) == address
            || (alias_active && self.word(reg::STATION_ALIAS) == address)
    }

    /// Whether LRW datagrams are executed.
    pub(crate) fn supports_lrw(&self) -> bool {
        self.word(reg::FEATURES) & 0x0200 == 0
    }

    /// A read by the MainDevice: fills what is readable; `true` when at least one byte was.
    pub(crate) fn read(&mut self, address: usize, data: &mut [u8], now: Duration) -> bool {
        let end = address + data.len();
        self.refresh(address, end, now);
        let mut done = false;
        let mut at = address;
        while at < end {
            let (owner, until) = self.region(at, end);
            let readable = match owner {
                Owner::Registers | Owner::Memory => true,
                Owner::SyncManager(index, settings) => {
                    self.pass(index, settings, at..until, false).is_some()
                }
                Owner::Nobody => false,
            };
            if readable
                && let (Some(target), Some(source)) = (
                    data.get_mut(at - address..until - address),
                    self.memory.get(at..until),
                )
            {
                target.copy_from_slice(source);
                done = true;
            }
            at = until;
        }
        done
    }

    /// A write by the MainDevice; with a mask only the bits that are set in it. `true` when the access was accepted.
    pub(crate) fn write(
        &mut self,
        address: usize,
        data: &[u8],
        mask: Option<&[u8]>,
        now: Duration,
    ) -> bool {
        let end = address + data.len();
        let mut done = false;
        let mut at = address;
        while at < end {
            let (owner, until) = self.region(at, end);
            let piece = data.get(at - address..until - address).unwrap_or(&[]);
            let piece_mask = mask.and_then(|mask| mask.get(at - address..until - address));
            match owner {
                Owner::Registers => {
                    self.write_registers(at, piece, now);
                    done = true;
                }
                Owner::Memory => {
                    self.copy_in(at, piece, piece_mask);
                    done = true;
                }
                Owner::SyncManager(index, settings) => {
                    if let Some(last) = self.pass(index, settings, at..until, true) {
                        self.copy_in(at, piece, piece_mask);
                        if last {
                            self.completed(index, settings, now);
                        }
                        done = true;
                    }
                }
                Owner::Nobody => {}
            }
            at = until;
        }
        done
    }

    /// A logical read: replaces the mapped bits; `true` when at least one FMMU served.
    pub(crate) fn logical_read(&mut self, logical: u32, data: &mut [u8], now: Duration) -> bool {
        let mut done = false;
        for fmmu in self.fmmus().filter(|fmmu| fmmu.reads).collect::<Vec<_>>() {
            let Some(mapped) = fmmu.mapped(logical, data.len()) else {
                continue;
            };
            let (first, count) = mapped.memory_bytes();
            let mut bytes = vec![0; count];
            if self.read(first, &mut bytes, now) {
                mapped.scatter(&bytes, data);
                done = true;
            }
        }
        done
    }

    /// A logical write; `true` when at least one FMMU served.
    pub(crate) fn logical_write(&mut self, logical: u32, data: &[u8], now: Duration) -> bool {
        let mut done = false;
        for fmmu in self.fmmus().filter(|fmmu| fmmu.writes).collect::<Vec<_>>() {
            let Some(mapped) = fmmu.mapped(logical, data.len()) else {
                continue;
            };
            let (first, _) = mapped.memory_bytes();
            let (bytes, mask) = mapped.gather(data);
            done |= self.write(first, &bytes, Some(&mask), now);
        }
        done
    }

    /// Interrupt bits of a datagram: 0210h as far as 0200h lets them through.
    pub(crate) fn interrupt(&mut self) -> u16 {
        self.refresh_events();
        self.word(reg::ECAT_EVENT_MASK) & self.word(reg::ECAT_EVENT)
    }

    /// The newest AL control that the MainDevice wrote, once.
    pub(crate) fn take_al_control(&mut self) -> Option<u16> {
        core::mem::take(&mut self.al_control_written).then(|| self.word(reg::AL_CONTROL))
    }

    /// Whether the MainDevice wrote to the sync managers' registers since this was last asked.
    pub(crate) fn take_sync_manager_change(&mut self) -> bool {
        core::mem::take(&mut self.sync_managers_written)
    }

    /// Publishes AL status and status code.
    pub(crate) fn set_al_status(&mut self, status: u16, code: u16) {
        self.set_word(reg::AL_STATUS, status);
        self.set_word(reg::AL_STATUS_CODE, code);
    }

    /// Settings of a sync manager.
    pub(crate) fn sync_manager(&self, index: usize) -> Settings {
        let at = usize::from(reg::SYNC_MANAGER) + 8 * index;
        Settings::from_registers(self.memory.get(at..at + 8).unwrap_or(&[]))
    }

    /// How many buffers the MainDevice has completed in a sync manager since that was enabled.
    pub(crate) fn completed_buffers(&self, index: usize) -> u32 {
        self.sync_managers.get(index).map_or(0, |sm| sm.completed)
    }

    /// The newest whole buffer of an output sync manager.
    pub(crate) fn buffer(&self, index: usize) -> &[u8] {
        self.sync_managers.get(index).map_or(&[], |sm| &sm.buffer)
    }

    /// The processor writes a whole input buffer.
    pub(crate) fn set_buffer(&mut self, index: usize, bytes: &[u8]) {
        if let Some(sm) = self.sync_managers.get_mut(index) {
            bytes.clone_into(&mut sm.buffer);
        }
    }

    /// The processor takes the mail that the MainDevice wrote.
    pub(crate) fn take_mail(&mut self, index: usize) -> Option<Vec<u8>> {
        let settings = self.sync_manager(index);
        let sm = self.sync_managers.get_mut(index)?;
        if !(settings.enabled && sm.full) {
            return None;
        }
        sm.full = false;
        let start = usize::from(settings.start);
        self.memory
            .get(start..start + usize::from(settings.length))
            .map(<[u8]>::to_vec)
    }

    /// The processor puts a mail; `false` when the mailbox is off, still full or too small for it.
    pub(crate) fn put_mail(&mut self, index: usize, mail: &[u8]) -> bool {
        if !self.mail_fits(index, mail.len()) {
            return false;
        }
        let settings = self.sync_manager(index);
        let start = usize::from(settings.start);
        let Some(target) = self
            .memory
            .get_mut(start..start + usize::from(settings.length))
        else {
            return false;
        };
        target.fill(0);
        target
            .iter_mut()
            .zip(mail)
            .for_each(|(target, byte)| *target = *byte);
        if let Some(sm) = self.sync_managers.get_mut(index) {
            sm.full = true;
        }
        true
    }

    /// Whether a mail of this length could be put now.
    fn mail_fits(&self, index: usize, length: usize) -> bool {
        let settings = self.sync_manager(index);
        settings.enabled && !self.mail_waits(index) && length <= usize::from(settings.length)
    }

    /// Whether a mail lies in the mailbox.
    pub(crate) fn mail_waits(&self, index: usize) -> bool {
        self.sync_managers.get(index).is_some_and(|sm| sm.full)
    }

    /// The processor takes back a mail that was not read.
    pub(crate) fn withdraw_mail(&mut self, index: usize) {
        if let Some(sm) = self.sync_managers.get_mut(index) {
            sm.full = false;
        }
    }

    /// Whether a sync manager's memory, all buffers of it, is inside the RAM and no other enabled one's.
    pub(crate) fn is_clear_of_others(&self, index: usize) -> bool {
        let own = self.sync_manager(index).occupied();
        let overlaps = |other: usize| {
            let settings = self.sync_manager(other);
            let range = settings.occupied();
            other != index && settings.enabled && range.start < own.end && own.start < range.end
        };
        own.start >= RAM_START && own.end <= RAM_END && !(0..CHANNELS).any(overlaps)
    }

    /// Whether the MainDevice has toggled the repeat request of this mailbox and the processor has not answered it.
    pub(crate) fn repeat_is_requested(&self, index: usize) -> bool {
        let acknowledged = self.byte(sync_manager_register(index) + 7) & 0x02 != 0;
        self.sync_manager(index).repeat_request != acknowledged
    }

    /// The processor answers a repeat request by copying its toggle.
    pub(crate) fn acknowledge_repeat(&mut self, index: usize) {
        let ack = if self.sync_manager(index).repeat_request {
            0x02
        } else {
            0
        };
        let at = sync_manager_register(index) + 7;
        self.set_byte(at, self.byte(at) & !0x02 | ack);
    }

    /// Whether outputs come in time, as far as the watchdog can tell (0440h bit 0).
    pub(crate) fn watchdog_is_running(&self) -> bool {
        self.watchdog.is_running()
    }

    /// Whether the process-data watchdog watches at all: time not zero and the sync manager triggers it.
    pub(crate) fn watchdog_is_armed(&self, outputs: usize) -> bool {
        self.watchdog_timeout().is_some() && self.sync_manager(outputs).triggers_watchdog()
    }

    /// When the watchdog expires if nothing comes.
    pub(crate) fn watchdog_deadline(&self) -> Option<Duration> {
        self.watchdog.deadline(self.watchdog_timeout())
    }

    /// Looks at the watchdog; `true` at the moment of expiry, which is also counted.
    pub(crate) fn check_watchdog(&mut self, now: Duration) -> bool {
        let expired = self.watchdog.check(self.watchdog_timeout(), now);
        if expired {
            let count = self.byte(reg::WATCHDOG_COUNTER).saturating_add(1);
            self.set_byte(reg::WATCHDOG_COUNTER, count);
        }
        expired
    }

    fn watchdog_timeout(&self) -> Option<Duration> {
        watchdog::timeout(
            self.word(reg::WATCHDOG_DIVIDER),
            self.word(reg::WATCHDOG_PROCESS_DATA),
        )
    }

    fn fmmus(&self) -> impl Iterator<Item = Fmmu> + '_ {
        let start = usize::from(reg::FMMU);
        let all = self.memory.get(start..start + 16 * CHANNELS).unwrap_or(&[]);
        all.chunks(16).filter_map(Fmmu::from_registers)
    }

    /// Who owns the address, and up to where (at most `end`) the same holds.
    fn region(&self, at: usize, end: usize) -> (Owner, usize) {
        if at < RAM_START {
            return (Owner::Registers, end.min(RAM_START));
        }
        if at >= RAM_END {
            return (Owner::Nobody, end);
        }
        let mut until = end.min(RAM_END);
        for index in 0..CHANNELS {
            let settings = self.sync_manager(index);
            let start = usize::from(settings.start);
            let behind = start + usize::from(settings.length);
            if !settings.enabled || behind <= at || start < RAM_START {
                continue;
            }
            if start <= at {
                return (Owner::SyncManager(index, settings), until.min(behind));
            }
            until = until.min(start);
        }
        (Owner::Memory, until)
    }

    /// Asks a sync manager for an access; `None` when refused, else whether it includes the last byte.
    fn pass(
        &mut self,
        index: usize,
        settings: Settings,
        range: Range<usize>,
        write: bool,
    ) -> Option<bool> {
        let offset = range.start - usize::from(settings.start);
        let sm = self.sync_managers.get_mut(index)?;
        let Access::Passes { first, last } = sm.access(settings, write, offset, range.len()) else {
            return None;
        };
        if first && !write && !settings.is_mailbox() {
            // The MainDevice begins to read: from here on it sees the newest buffer, up to its last byte.
            let start = usize::from(settings.start);
            let length = usize::from(settings.length);
            let buffer = core::mem::take(&mut sm.buffer);
            if let Some(target) = self.memory.get_mut(start..start + length) {
                target
                    .iter_mut()
                    .zip(&buffer)
                    .for_each(|(target, byte)| *target = *byte);
            }
            if let Some(sm) = self.sync_managers.get_mut(index) {
                sm.buffer = buffer;
            }
        }
        Some(last)
    }

    /// A buffer was written to its last byte.
    fn completed(&mut self, index: usize, settings: Settings, now: Duration) {
        if settings.triggers_watchdog() {
            self.watchdog.trigger(now);
        }
        let start = usize::from(settings.start);
        let Some(sm) = self.sync_managers.get_mut(index) else {
            return;
        };
        sm.completed = sm.completed.wrapping_add(1);
        if !settings.is_mailbox()
            && let Some(bytes) = self.memory.get(start..start + usize::from(settings.length))
        {
            bytes.clone_into(&mut sm.buffer);
        }
    }

    fn copy_in(&mut self, at: usize, bytes: &[u8], mask: Option<&[u8]>) {
        let Some(target) = self.memory.get_mut(at..at + bytes.len()) else {
            return;
        };
        for (offset, (target, byte)) in target.iter_mut().zip(bytes).enumerate() {
            let mask = mask.map_or(0xFF, |mask| mask.get(offset).copied().unwrap_or(0));
            *target = *target & !mask | byte & mask;
        }
    }

    /// A write into the register area, byte by byte by each register's rule, then what the write sets off.
    fn write_registers(&mut self, at: usize, bytes: &[u8], now: Duration) {
        let range = at..at + bytes.len();
        let enabled: [bool; CHANNELS] =
            core::array::from_fn(|index| self.sync_manager(index).enabled);
        for (address, byte) in range.clone().zip(bytes) {
            // The register area ends at 1000h.
            self.write_register(address as u16, *byte, &enabled);
        }
        let touches = |register: u16, length: usize| {
            let register = usize::from(register);
            range.start < register + length && register < range.end
        };
        self.sync_managers_written |= touches(reg::SYNC_MANAGER, 8 * CHANNELS);
        for index in 0..CHANNELS {
            if touches(sync_manager_register(index), 8) && !self.sync_manager(index).enabled {
                self.sync_managers[index] = SyncManager::default();
            }
        }
        if touches(reg::AL_CONTROL, 2) {
            self.al_control_written = true;
        }
        if touches(reg::SII_CONTROL, 2) {
            let offset = usize::from(reg::SII_CONTROL).checked_sub(at);
            let control = offset.and_then(|offset| crate::frame::read_u16(bytes, offset));
            self.sii_command(control.unwrap_or(0));
        }
        if touches(reg::DC_RECEIVE_TIMES, 4) {
            let times = self.clock.receive_times(self.place, now);
            for (port, time) in (0u16..).zip(times) {
                self.set_bytes(reg::DC_RECEIVE_TIMES + 4 * port, &time.to_le_bytes());
            }
            self.set_bytes(
                reg::DC_RECEIVE_TIME_UNIT,
                &self.clock.local(self.place, now).to_le_bytes(),
            );
        }
        if touches(reg::DC_SYSTEM_TIME, 4)
            && let Some(offset) = usize::from(reg::DC_SYSTEM_TIME).checked_sub(at)
            && let Some(received) = crate::frame::read_u32(bytes, offset)
        {
            // The register compares the low halves, the received one plus the delay to the reference.
            let received = received.wrapping_add(self.double_word(reg::DC_DELAY));
            let value = difference(self.system_time(now) as u32, received);
            self.set_bytes(reg::DC_DIFFERENCE, &value.to_le_bytes());
        }
    }

    fn write_register(&mut self, address: u16, byte: u8, enabled: &[bool; CHANNELS]) {
        if address == reg::SII_OWNER {
            self.write_sii_owner(byte);
            return;
        }
        let sync_managers = reg::SYNC_MANAGER..reg::SYNC_MANAGER + 8 * CHANNELS as u16;
        if sync_managers.contains(&address) {
            let index = usize::from((address - reg::SYNC_MANAGER) / 8);
            let configurable = enabled.get(index) == Some(&false);
            match (address - reg::SYNC_MANAGER) % 8 {
                // Start, length and control are locked while it is enabled.
                0..=4 if configurable => self.set_byte(address, byte),
                6 => self.set_byte(address, byte),
                _ => {}
            }
            return;
        }
        match reg::write_rule(address) {
            WriteRule::Plain => self.set_byte(address, byte),
            WriteRule::Clear => self.set_byte(address, 0),
            WriteRule::Ignored => {}
        }
    }

    /// Brings registers up to date that are computed, as far as the range shows them.
    fn refresh(&mut self, start: usize, end: usize, now: Duration) {
        let shows = |range: Range<usize>| start < range.end && range.start < end;
        if shows(0x0210..0x0224) {
            self.refresh_events();
        }
        if shows(0x0440..0x0441) {
            self.set_byte(
                reg::WATCHDOG_STATUS,
                u8::from(self.watchdog_timeout().is_none() || self.watchdog_is_running()),
            );
        }
        if shows(0x0800..0x0840) {
            for index in 0..CHANNELS {
                let settings = self.sync_manager(index);
                let status = self.sync_managers[index].status(settings);
                self.set_byte(
                    sync_manager_register(index) + 5,
                    if settings.enabled { status } else { 0 },
                );
            }
        }
        if shows(0x0910..0x0918) {
            self.set_bytes(reg::DC_SYSTEM_TIME, &self.system_time(now).to_le_bytes());
        }
    }

    /// AL event request and ECAT event request: mailboxes with a mail in bits 8 and up, AL control in bit 0.
    fn refresh_events(&mut self) {
        let mut mails: u16 = 0;
        for (index, sm) in self.sync_managers.iter().enumerate() {
            mails |= u16::from(sm.full) << (8 + index.min(7));
        }
        self.set_word(reg::ECAT_EVENT, mails);
        self.set_word(reg::AL_EVENT, mails | u16::from(self.al_control_written));
    }

    fn system_time(&self, now: Duration) -> u64 {
        let low = u64::from(self.double_word(reg::DC_OFFSET));
        let high = u64::from(self.double_word(reg::DC_OFFSET + 4));
        self.clock
            .local(self.place, now)
            .wrapping_add(high << 32 | low)
    }

    fn byte(&self, address: u16) -> u8 {
        self.memory[usize::from(address)]
    }

    fn word(&self, address: u16) -> u16 {
        crate::frame::read_u16(&self.memory, usize::from(address)).unwrap_or(0)
    }

    fn double_word(&self, address: u16) -> u32 {
        crate::frame::read_u32(&self.memory, usize::from(address)).unwrap_or(0)
    }

    fn set_byte(&mut self, address: u16, value: u8) {
        self.memory[usize::from(address)] = value;
    }

    fn set_word(&mut self, address: u16, value: u16) {
        self.set_bytes(address, &value.to_le_bytes());
    }

    fn set_bytes(&mut self, address: u16, bytes: &[u8]) {
        self.copy_in(usize::from(address), bytes, None);
    }
}

/// Address of the registers of a sync manager.
fn sync_manager_register(index: usize) -> u16 {
    reg::SYNC_MANAGER + 8 * index.min(CHANNELS - 1) as u16
}
