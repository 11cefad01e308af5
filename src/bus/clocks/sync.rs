//! SYNC0 of a drive: its synchronisation types in CoE, and the registers of its SYNC unit (ESC data sheet, section I, 9.2).

use std::{rc::Rc, time::Duration};

use crate::{
    bus::{
        clocks::{
            DistributedClock,
            measure::{Clocks, write_time},
            topology::Width,
        },
        cycle::{
            reference_clock::{LOCK_CYCLES, Phase, SYSTEM_TIME, bound},
            statistics::ClockStatistics,
        },
        error::{BringUpStep, DriveFault, NetworkError, ReferenceClock, RegisterError},
        event::ClockEvent,
        line::Found,
        log::LogRecord,
        requests::{Context, registers::Registers},
    },
    coe::{AbortCode, DriveError, Object, ReadWrite, SdoHandle, obj},
};

/// Register 0980h: control of the SYNC unit; 0981h: activation.
const SYNC_CONTROL: u16 = 0x0980;
const ACTIVATION: u16 = 0x0981;
const START: u16 = 0x0990;
/// Register 09A0h, followed by 09A4h for SYNC1.
const CYCLES: u16 = 0x09A0;
/// Register 092Ch: bits 0 to 30 are how far the clock is from the reference.
pub(in crate::bus) const DIFFERENCE: u16 = 0x092C;
/// How far ahead the first pulse is set: longer than a few frames can be on their way.
const AHEAD: Duration = Duration::from_millis(100);
/// How often the start is set anew when it had passed before the unit was on.
const TRIES: usize = 3;
/// 1C32h:1 and 1C33h:1, synchronous with SYNC0 (ETG.1020).
const WITH_SYNC0: u16 = 2;

/// Sets the synchronisation types of a drive that has them, and reads them back. In PREOP.
pub(in crate::bus) async fn set_types(
    sdo: &SdoHandle,
    clock: &DistributedClock,
    period: Duration,
) -> Result<(), DriveFault> {
    let (cycle, _) = clock.cycles(period);
    for (kind, time) in [
        (obj::OUTPUT_SYNC_TYPE, obj::OUTPUT_CYCLE_TIME),
        (obj::INPUT_SYNC_TYPE, obj::INPUT_CYCLE_TIME),
    ] {
        match keeps(sdo, kind, WITH_SYNC0).await? {
            None => continue,
            Some(Kept { value, refused }) if value != WITH_SYNC0 => {
                if !refused {
                    return Err(DriveFault::SyncType {
                        index: kind.index(),
                        value,
                    });
                }
                // Many drives take it from the SYNC unit alone.
                tracing::warn!(drive = %sdo.drive(), object = %kind, value, "not to be set to SYNC0");
            }
            Some(_) => {}
        }
        // Where it can be set at all; else the drive takes it from 09A0h.
        if let Some(Kept {
            value,
            refused: false,
        }) = keeps(sdo, time, cycle).await?
            && value != cycle
        {
            let (index, expected) = (time.index(), cycle);
            return Err(DriveFault::SyncCycle {
                index,
                expected,
                value,
            });
        }
    }
    Ok(())
}

/// What an object holds after something was written to it.
struct Kept<T> {
    value: T,
    refused: bool,
}

/// Writes and reads back; nothing if the drive has no such object.
async fn keeps<T: crate::coe::Number>(
    sdo: &SdoHandle,
    object: Object<T, ReadWrite>,
    value: T,
) -> Result<Option<Kept<T>>, DriveFault> {
    let aborted = |error: &DriveError| error.error.abort_code();
    let refused = match sdo.write(object, value).await {
        Ok(()) => false,
        Err(error) => match aborted(&error) {
            Some(AbortCode::NO_OBJECT | AbortCode::NO_SUBINDEX) => return Ok(None),
            Some(_) => true,
            None => return Err(error.error.into()),
        },
    };
    match sdo.read(object).await {
        Ok(value) => Ok(Some(Kept { value, refused })),
        Err(error) if aborted(&error).is_some() => Ok(None),
        Err(error) => Err(error.error.into()),
    }
}

/// How long after that a drive has had as many pulses as at the start of a network, where all wait for the lock.
pub(in crate::bus) fn settling(period: Duration) -> Duration {
    AHEAD + period * LOCK_CYCLES
}

/// Switches SYNC0 on, with its first pulse ahead. The clocks must have been set.
pub(in crate::bus) async fn start(
    registers: &Registers,
    station: u16,
    position: u16,
    clocks: Option<&Rc<Clocks>>,
    clock: &DistributedClock,
    period: Duration,
) -> Result<(), DriveFault> {
    let clocks = clocks.ok_or(DriveFault::NoClock)?;
    let width = clocks.width(position).ok_or(DriveFault::NoClock)?;
    clocks.are_taught(registers.time()).await?;
    if clocks.stands() {
        return Err(DriveFault::ReferenceStands(clocks.reference.clone()));
    }
    let (sync0, sync1) = clock.cycles(period);
    let [control, activation] = clock.assign_activate.to_le_bytes();
    let ahead = u64::try_from(AHEAD.as_nanos()).unwrap_or(u64::MAX);
    for _ in 0..TRIES {
        registers.write(station, ACTIVATION, &[0]).await?;
        let (now, _) = clocks.now(registers).await?;
        let first = clock.first_pulse(now.saturating_add(ahead), period);
        write_time(registers, station, START, first, width).await?;
        registers
            .write(station, CYCLES, &sync0.to_le_bytes())
            .await?;
        registers
            .write(station, CYCLES + 4, &sync1.to_le_bytes())
            .await?;
        registers
            .write(station, SYNC_CONTROL, &[control, activation])
            .await?;
        let [got] = registers.read(station, ACTIVATION).await?;
        if got != activation {
            return Err(DriveFault::SyncUnit {
                expected: activation,
                got,
            });
        }
        // A pulse that was to come in the past does not come for hundreds of years.
        if is_ahead(first, system_time(registers, station, width).await?, width) {
            tracing::debug!(station, first, sync0, sync1, "SYNC0 is on");
            return Ok(());
        }
    }
    Err(DriveFault::Sync0Passed)
}

async fn system_time(
    registers: &Registers,
    station: u16,
    width: Width,
) -> Result<u64, RegisterError> {
    Ok(match width {
        Width::Bits32 => u32::from_le_bytes(registers.read(station, SYSTEM_TIME).await?).into(),
        Width::Bits64 => u64::from_le_bytes(registers.read(station, SYSTEM_TIME).await?),
    })
}

/// Whether a time is still to come on a clock that shows `now`.
fn is_ahead(time: u64, now: u64, width: Width) -> bool {
    match width {
        Width::Bits32 => (time as u32).wrapping_sub(now as u32).cast_signed() > 0,
        Width::Bits64 => time > now,
    }
}

// The way into the lock: cycles that begin in step with the reference clock, and OP only when they stay there.

/// How long the lock may take, beside as many cycles as it needs.
const LOCK_LIMIT: Duration = Duration::from_secs(2);
const LOCK_LIMIT_CYCLES: u32 = 500;

/// When the first cycle is to begin, and its phase.
pub(in crate::bus) async fn first_cycle(
    context: &Context,
    clocks: &Clocks,
    period: Duration,
) -> Result<(Duration, Phase), NetworkError> {
    let now = clocks.now(&context.registers).await;
    let (time, at) = now.map_err(NetworkError::Line)?;
    let (phase, later) = Phase::starting_at(time, period);
    context.counters.clock.begin(bound(period));
    Ok((at + later, phase))
}

/// Waits until the cycles are in step, and until these drives' clocks are.
pub(in crate::bus) async fn wait_for_lock(
    context: &Context,
    drives: impl Iterator<Item = &Found>,
    period: Duration,
) -> Result<(), NetworkError> {
    let started = context.time.now();
    let limit = LOCK_LIMIT + period * LOCK_LIMIT_CYCLES;
    let is_over = || context.time.now().saturating_sub(started) > limit;
    loop {
        context.time.sleep(period).await;
        let Some(seen) = context.counters.clock.read() else {
            return Ok(());
        };
        if seen.locked {
            let note = LogRecord::InStep {
                phase_error_ns: seen.phase_error_ns,
            };
            context.log.record(context.time.now(), note);
            break;
        }
        // From a jump there is no way back.
        if is_over() || seen.reference == ReferenceClock::Jumped {
            return Err(NetworkError::NotLocked {
                reference: seen.reference,
                phase_error_ns: seen.phase_error_ns,
                bound: seen.bound,
                after: context.time.now().saturating_sub(started),
            });
        }
    }
    for found in drives {
        while let Err(apart) = is_in_step(context, found, period).await {
            if is_over() {
                return Err(found.clone().fault(BringUpStep::Clock, apart));
            }
            context.time.sleep(period).await;
        }
    }
    Ok(())
}

async fn is_in_step(context: &Context, found: &Found, period: Duration) -> Result<(), DriveFault> {
    let shown = context.registers.read(found.station, DIFFERENCE).await?;
    // Bit 31 is the sign.
    let apart = Duration::from_nanos((u32::from_le_bytes(shown) & 0x7FFF_FFFF).into());
    let bound = bound(period);
    if apart > bound {
        return Err(DriveFault::ClockApart { apart, bound });
    }
    Ok(())
}

/// Tells what happens between the cycles and the reference clock once they were in step.
#[derive(Debug)]
pub(in crate::bus) struct LockWatch {
    seen: (bool, ReferenceClock),
}

impl LockWatch {
    pub(in crate::bus) const fn new() -> Self {
        Self {
            seen: (true, ReferenceClock::Heard),
        }
    }

    /// What has happened since the look before.
    pub(in crate::bus) fn look(&mut self, clock: Option<ClockStatistics>) -> Option<ClockEvent> {
        use ReferenceClock::{Heard, Jumped, Silent};
        let ClockStatistics {
            phase_error_ns,
            locked,
            reference,
            ..
        } = clock?;
        let now = (locked, reference);
        let before = core::mem::replace(&mut self.seen, now);
        match (before, now) {
            _ if before == now => None,
            ((_, old), (_, new)) if old != new && new != Heard => Some(match new {
                Jumped => ClockEvent::Jumped {
                    by_ns: phase_error_ns,
                },
                _ => ClockEvent::Silent,
            }),
            (_, (true, Heard)) => Some(ClockEvent::InStep),
            ((true, _), (false, Heard)) => Some(ClockEvent::OutOfStep { phase_error_ns }),
            (_, (_, Heard | Silent | Jumped)) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_of_32_bits_begins_again_and_its_times_are_still_ahead() {
        assert!(is_ahead(0x1_0000_0005, 0xFFFF_FFF0, Width::Bits32));
        assert!(!is_ahead(0xFFFF_FFF0, 5, Width::Bits32));
        assert!(is_ahead(6, 5, Width::Bits64));
        assert!(!is_ahead(5, 5, Width::Bits64));
    }
}

#[cfg(test)]
mod lock_tests {
    use super::*;

    #[test]
    fn each_change_is_told_once() {
        use ReferenceClock::{Heard, Jumped, Silent};
        let mut watch = LockWatch::new();
        let mut look = |locked, reference| {
            watch.look(Some(ClockStatistics {
                phase_error_ns: 7,
                locked,
                reference,
                ..ClockStatistics::default()
            }))
        };
        let out = Some(ClockEvent::OutOfStep { phase_error_ns: 7 });
        assert_eq!(look(true, Heard), None);
        assert_eq!(look(false, Heard), out);
        assert_eq!(look(false, Heard), None);
        assert_eq!(look(true, Heard), Some(ClockEvent::InStep));
        assert_eq!(look(true, Silent), Some(ClockEvent::Silent));
        assert_eq!(look(false, Silent), None);
        assert_eq!(look(false, Heard), None);
        assert_eq!(look(true, Heard), Some(ClockEvent::InStep));
        assert_eq!(look(false, Jumped), Some(ClockEvent::Jumped { by_ns: 7 }));
        assert_eq!(look(false, Jumped), None);
    }
}
