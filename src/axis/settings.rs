//! What a drive held, when its axis attached, of how it stops and of when it calls its axis standing.

use core::sync::atomic::{AtomicU32, Ordering};

use crate::ds402::{QuickStopOption, StopOptions, VelocityWindows};

use super::AxisConfig;

/// What the drive of an axis held, when the axis attached, of how it stops and of when it calls the axis standing:
/// [`Axis::drive_settings`](super::Axis::drive_settings).
///
/// ```
/// # use std::time::Duration;
/// use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
/// # smol::block_on(async {
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::generic());
/// # let link = Wire::new(move |frame: &mut [u8], now: Duration| segment.process(frame, now));
/// let drive = DriveConfig::new(drives::generic()).axis("x");
/// let net = Network::builder().link(link).drive(0, drive).start().await?;
/// let held = net.axis("x")?.drive_settings();
/// // 605Dh: bit 8 stops the axis by the ramp of its set-point.
/// assert_eq!(held.stop_options.halt, Some(1));
/// // 606Fh.
/// assert!(held.velocity_windows.threshold.is_some());
/// # net.shutdown().await?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// # }).unwrap();
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DriveSettings {
    /// Quick stop option code 605Ah, or 2 where the drive has no such object: where a quick stop ends.
    pub quick_stop: QuickStopOption,
    /// Option codes of the other stops, 605Bh to 605Eh.
    pub stop_options: StopOptions,
    /// Windows and times of the velocity, 606Dh to 6070h.
    pub velocity_windows: VelocityWindows,
}

impl DriveSettings {
    pub(super) const fn of(config: &AxisConfig) -> Self {
        Self {
            quick_stop: config.quick_stop,
            stop_options: config.stop_options,
            velocity_windows: config.velocity_windows,
        }
    }
}

/// Set in the word of an object that the drive has; its 16 bits are the lower ones.
const IS_THERE: u32 = 1 << 16;

/// Settings that the bus thread writes when a drive is attached, and handles read: neither waits for the other.
#[derive(Debug)]
pub(super) struct SettingsCell([AtomicU32; 9]);

impl SettingsCell {
    pub(super) fn new(settings: DriveSettings) -> Self {
        let cell = Self(Default::default());
        cell.set(settings);
        cell
    }

    pub(super) fn set(&self, settings: DriveSettings) {
        let DriveSettings {
            quick_stop,
            stop_options: stops,
            velocity_windows: windows,
        } = settings;
        let codes = [
            Some(quick_stop.0),
            stops.shutdown,
            stops.disable_operation,
            stops.halt,
            stops.fault_reaction,
        ];
        let windows = [
            windows.window,
            windows.window_ms,
            windows.threshold,
            windows.threshold_ms,
        ];
        let codes = codes.map(|code| code.map(i16::cast_unsigned));
        for (cell, value) in self.0.iter().zip(codes.into_iter().chain(windows)) {
            let word = value.map_or(0, |value| IS_THERE | u32::from(value));
            cell.store(word, Ordering::Release);
        }
    }

    pub(super) fn get(&self) -> DriveSettings {
        let values = self.0.each_ref().map(|cell| {
            let word = cell.load(Ordering::Acquire);
            // The lower half.
            (word & IS_THERE != 0).then_some(word as u16)
        });
        let [
            quick_stop,
            shutdown,
            disable_operation,
            halt,
            fault_reaction,
            window,
            window_ms,
            threshold,
            threshold_ms,
        ] = values;
        let code = |value: Option<u16>| value.map(u16::cast_signed);
        DriveSettings {
            quick_stop: QuickStopOption(code(quick_stop).unwrap_or_default()),
            stop_options: StopOptions {
                shutdown: code(shutdown),
                disable_operation: code(disable_operation),
                halt: code(halt),
                fault_reaction: code(fault_reaction),
            },
            velocity_windows: VelocityWindows {
                window,
                window_ms,
                threshold,
                threshold_ms,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_setting_comes_out_as_it_went_in_whatever_the_drive_has() {
        let all = DriveSettings {
            quick_stop: QuickStopOption(-6),
            stop_options: StopOptions {
                shutdown: Some(1),
                disable_operation: Some(-1),
                halt: Some(0),
                fault_reaction: Some(i16::MIN),
            },
            velocity_windows: VelocityWindows {
                window: Some(1),
                window_ms: Some(0),
                threshold: Some(u16::MAX),
                threshold_ms: Some(40_000),
            },
        };
        let cell = SettingsCell::new(all);
        assert_eq!(cell.get(), all);
        let none = DriveSettings {
            quick_stop: QuickStopOption(0),
            stop_options: StopOptions::default(),
            velocity_windows: VelocityWindows::default(),
        };
        cell.set(none);
        assert_eq!(cell.get(), none);
    }
}
