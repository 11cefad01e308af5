//! The way into the lock: cycles that begin in step with the reference clock, and OP only when they stay there.

use std::time::Duration;

use super::{
    measure::Clocks,
    phase::{Phase, bound},
    sync::DIFFERENCE,
};
use crate::bus::{
    BringUpStep, ClockEvent, ClockStatistics, DriveFault, NetworkError, ReferenceClock,
    discovery::Found, log::Note, reactor::Context,
};

/// How long the lock may take, beside as many cycles as it needs.
const LIMIT: Duration = Duration::from_secs(2);
const CYCLES: u32 = 500;

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
    let limit = LIMIT + period * CYCLES;
    let is_over = || context.time.now().saturating_sub(started) > limit;
    loop {
        context.time.sleep(period).await;
        let Some(seen) = context.counters.clock.read() else {
            return Ok(());
        };
        if seen.locked {
            let note = Note::InStep {
                phase_error_ns: seen.phase_error_ns,
            };
            context.log.note(context.time.now(), note);
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
