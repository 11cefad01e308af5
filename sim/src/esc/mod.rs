//! The EtherCAT SubDevice controller: registers, memory, sync managers, FMMUs, SII interface, watchdog and clock.
//! This file is the MainDevice's side: physical and logical access. The processor's side is in `processor`.

mod clock;
mod fmmu;
mod memory;
mod port_errors;
mod ports;
mod processor;
mod register_access;
pub(crate) mod registers;
mod sii_access;
mod sync;
pub(crate) mod sync_manager;
mod watchdog;

use core::ops::Range;
use core::time::Duration;

use crate::description::ClockWidth;

pub(crate) use clock::Place;
use clock::{Clock, ControlLoop};
use fmmu::Fmmu;
use ports::Ports;
use registers as reg;
use registers::{CHANNELS, RAM_END, RAM_START};
pub use sii_access::EepromReload;
use sii_access::WrittenWord;
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
    emulates_sii: bool,
    /// How long the EEPROM takes for a command, until when it is at work, and how many it has had.
    pub(crate) sii_delay: Duration,
    sii_busy_until: Option<Duration>,
    /// How much longer it takes for a word that is written, which is this one.
    pub(crate) sii_write_delay: Duration,
    sii_written: Option<WrittenWord>,
    pub(crate) sii_reload: EepromReload,
    /// Whether words 0 to 6 were loaded at power-up; bits 11 and 12 of 0502h.
    sii_loaded: bool,
    sii_load_status: u16,
    pub(crate) sii_accesses: u64,
    /// Messages that the device has taken.
    pub(crate) messages_taken: u64,
    clock: Clock,
    watchdog: Watchdog,
    place: Place,
    ports: Ports,
    clock_width: Option<ClockWidth>,
    /// System time of SYNC0's next pulse, while the SYNC unit is on and has not missed it; and whether one has come.
    next_pulse: Option<u64>,
    has_pulsed: bool,
    /// System time at which a buffer of outputs was complete last.
    outputs_at: Option<u64>,
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
        emulates_sii: bool,
        supports_lrw: bool,
        clock_width: Option<ClockWidth>,
        clock_start: u64,
    ) -> Self {
        let mut esc = Self {
            memory: vec![0; SPACE],
            sync_managers: Default::default(),
            sii,
            sii_reads_eight_bytes,
            emulates_sii,
            sii_delay: Duration::ZERO,
            sii_busy_until: None,
            sii_write_delay: Duration::ZERO,
            sii_written: None,
            sii_reload: EepromReload::default(),
            sii_loaded: false,
            sii_load_status: 0,
            sii_accesses: 0,
            messages_taken: 0,
            clock: Clock::new(clock_start),
            watchdog: Watchdog::default(),
            place: Place::default(),
            ports: Ports::default(),
            clock_width,
            next_pulse: None,
            has_pulsed: false,
            outputs_at: None,
            al_control_written: false,
            sync_managers_written: false,
        };
        // Frames that are no EtherCAT are destroyed; ports automatic; RX FIFO 7; no alias addressing.
        esc.set_bytes(reg::DL_CONTROL, &[0x01, 0x00, 0x07, 0x00]);
        // Type 11h, revision 0, build 2: what an ET1100 reports.
        esc.set_word(reg::TYPE, 0x0011);
        esc.set_word(reg::TYPE + 2, 0x0002);
        esc.set_word(
            reg::FMMU_COUNT,
            u16::from_le_bytes([CHANNELS as u8, CHANNELS as u8]),
        );
        // 0006h: KiB of memory; 0007h: ports 0 and 1 are MII, the others are not there.
        esc.set_byte(0x0006, ((RAM_END - RAM_START) / 1024) as u8);
        esc.set_byte(reg::PORT_KINDS, 0x0F);
        // Bit 2: there are distributed clocks; bit 3: of 64 bits; bit 9: LRW is not supported.
        let clock = match clock_width {
            None => 0,
            Some(ClockWidth::Bits32) => 0x0004,
            Some(ClockWidth::Bits64) => 0x000C,
        };
        esc.set_word(reg::FEATURES, clock | if supports_lrw { 0 } else { 0x0200 });
        esc.set_word(reg::WATCHDOG_DIVIDER, 0x09C2);
        esc.set_word(reg::WATCHDOG_PDI, 0x03E8);
        esc.set_word(reg::WATCHDOG_PROCESS_DATA, 0x03E8);
        // Speed counter and filter depths of the clock's control loop, as an ET1100 has them after a reset.
        esc.set_word(reg::DC_SPEED_COUNTER, 0x1000);
        esc.set_word(reg::DC_FILTER, 0x0C04);
        esc.power_up_sii();
        esc.set_processor_runs(true);
        esc.show_ports();
        esc
    }

    /// Tells the ESC where in the line it is.
    pub(crate) fn set_place(&mut self, place: Place) {
        self.place = place;
    }

    /// The device's processor serves its watchdog, or has stopped to do so (DL status, bit 1).
    pub(crate) fn set_processor_runs(&mut self, runs: bool) {
        let status = self.word(reg::DL_STATUS) & !0x0002;
        self.set_word(reg::DL_STATUS, status | u16::from(runs) << 1);
    }

    fn processor_runs(&self) -> bool {
        self.word(reg::DL_STATUS) & 0x0002 != 0
    }

    /// Gives the local clock another begin and a crystal that is this much too fast, in parts per billion.
    pub(crate) fn set_clock(&mut self, start: u64, drift: i32) {
        self.clock = Clock::new(start);
        self.clock.set_drift(drift, 0);
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

    /// Settings of a sync manager.
    pub(crate) fn sync_manager(&self, index: usize) -> Settings {
        let at = usize::from(reg::SYNC_MANAGER) + 8 * index;
        Settings::from_registers(self.memory.get(at..at + 8).unwrap_or(&[]))
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
            let clock = usize::from(reg::DC_RECEIVE_TIMES)..usize::from(reg::DC_END);
            return match self.clock_width {
                Some(_) => (Owner::Registers, end.min(RAM_START)),
                None if clock.contains(&at) => (Owner::Nobody, end.min(clock.end)),
                None if at < clock.start => (Owner::Registers, end.min(clock.start)),
                None => (Owner::Registers, end.min(RAM_START)),
            };
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
        if !settings.is_mailbox() {
            self.outputs_at = Some(self.system_time(now));
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
}

/// Address of the registers of a sync manager.
fn sync_manager_register(index: usize) -> u16 {
    reg::SYNC_MANAGER + 8 * index.min(CHANNELS - 1) as u16
}
