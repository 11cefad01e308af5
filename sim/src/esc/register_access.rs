//! Registers that are more than stored bytes: what a write to one sets off, and which are computed when they are read.

use core::ops::Range;
use core::time::Duration;

use super::clock::nanoseconds;
use super::registers as reg;
use super::registers::{CHANNELS, WriteRule};
use super::sync_manager::SyncManager;
use super::{ControlLoop, Esc, sync_manager_register};
use crate::description::ClockWidth;

impl Esc {
    /// A write into the register area, byte by byte by each register's rule, then what the write sets off.
    pub(super) fn write_registers(&mut self, at: usize, bytes: &[u8], now: Duration) {
        let range = at..at + bytes.len();
        let enabled: [bool; CHANNELS] =
            core::array::from_fn(|index| self.sync_manager(index).enabled);
        let was_on = self.sync_unit().is_on;
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
            self.sii_command(control.unwrap_or(0), now);
        }
        if touches(reg::DC_RECEIVE_TIMES, 4) {
            let times = self.clock.receive_times(self.place, now);
            for (port, time) in (0u16..).zip(times) {
                self.set_bytes(reg::DC_RECEIVE_TIMES + 4 * port, &time.to_le_bytes());
            }
            let local = self.clock.local(self.place.at_port_0(now));
            self.set_clock_value(reg::DC_RECEIVE_TIME_UNIT, local);
        }
        if touches(reg::SYNC_ACTIVATION, 1) {
            self.activate_sync(was_on, now);
        }
        if touches(reg::DC_SPEED_COUNTER, 2) {
            self.clock.reset_filters(self.place.at_port_0(now));
        }
        if touches(reg::DC_SYSTEM_TIME, 4)
            && let Some(offset) = usize::from(reg::DC_SYSTEM_TIME).checked_sub(at)
            && let Some(received) = crate::frame::read_u32(bytes, offset)
        {
            // The register compares the low halves, the received one plus the delay to the reference.
            let received = received.wrapping_add(self.double_word(reg::DC_DELAY));
            let local = self.system_time(now) as u32;
            let [difference_depth, speed_depth] = self.word(reg::DC_FILTER).to_le_bytes();
            let settings = ControlLoop {
                start: self.word(reg::DC_SPEED_COUNTER),
                difference_depth,
                speed_depth,
            };
            let difference = local.wrapping_sub(received).cast_signed();
            self.clock
                .follow(difference, self.place.at_port_0(now), settings);
        }
    }

    fn write_register(&mut self, address: u16, byte: u8, enabled: &[bool; CHANNELS]) {
        if address == reg::SII_OWNER {
            self.write_sii_owner(byte);
            return;
        }
        if address == reg::LOOP_CONTROL {
            self.write_loop_control(byte);
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
        let start_and_cycles = reg::SYNC0_START..reg::SYNC0_CYCLE + 8;
        if start_and_cycles.contains(&address) && self.sync_unit().is_on {
            return;
        }
        match reg::write_rule(address) {
            WriteRule::Plain => self.set_byte(address, byte),
            WriteRule::Clear => self.set_byte(address, 0),
            WriteRule::Ignored => {}
        }
    }

    /// Brings registers up to date that are computed, as far as the range shows them.
    pub(super) fn refresh(&mut self, start: usize, end: usize, now: Duration) {
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
        if shows(0x0502..0x0504) {
            self.refresh_sii(now);
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
            // What the MainDevice reads is of when the frame passed the reference clock (data sheet, section I, table 30).
            let delay = self.double_word(reg::DC_DELAY);
            let time = self.system_time(now).wrapping_sub(delay.into());
            self.set_clock_value(reg::DC_SYSTEM_TIME, time);
        }
        if shows(0x092C..0x0930) {
            let mean = self.clock.mean_difference();
            self.set_bytes(reg::DC_DIFFERENCE, &mean.to_le_bytes());
        }
        if shows(0x0932..0x0934) {
            let shown = self.clock.speed_difference();
            self.set_bytes(reg::DC_SPEED_DIFFERENCE, &shown.to_le_bytes());
        }
        if shows(0x0990..0x0998) {
            self.refresh_next_pulse(now);
        }
    }

    /// AL event request and ECAT event request: mailboxes with a message in bits 8 and up, AL control in bit 0.
    pub(super) fn refresh_events(&mut self) {
        let mut messages: u16 = 0;
        for (index, sm) in self.sync_managers.iter().enumerate() {
            messages |= u16::from(sm.full) << (8 + index.min(7));
        }
        self.set_word(reg::ECAT_EVENT, messages);
        self.set_word(reg::AL_EVENT, messages | u16::from(self.al_control_written));
    }

    /// The local copy of the system time as a frame that left the MainDevice at `now` passes port 0.
    pub(super) fn system_time(&self, now: Duration) -> u64 {
        self.system_time_at(self.place.at_port_0(now))
    }

    /// The local copy of the system time at this time of the simulation.
    pub(crate) fn copy_of_system_time(&self, now: Duration) -> u64 {
        self.system_time_at(nanoseconds(now))
    }

    /// The local copy of the system time at a time of the simulation.
    pub(super) fn system_time_at(&self, at: u64) -> u64 {
        self.clock
            .local(at)
            .wrapping_add(self.quad_word(reg::DC_OFFSET))
    }

    /// A register with a time: of a clock of 32 bits it has the lower half alone.
    pub(super) fn set_clock_value(&mut self, address: u16, time: u64) {
        let [a, b, c, d, ..] = time.to_le_bytes();
        if self.clock_width == Some(ClockWidth::Bits32) {
            self.set_bytes(address, &[a, b, c, d]);
        } else {
            self.set_bytes(address, &time.to_le_bytes());
        }
    }
}
