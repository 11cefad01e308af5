//! The AL state machine (ETG.1000.6): requests, refusals with their reason, acknowledgement of errors.

use std::time::Duration;

use crate::bus::{
    error::{AlError, AlState, AlStatus, RegisterError},
    requests::registers::Registers,
};

pub(in crate::bus) const AL_CONTROL: u16 = 0x0120;
/// Written there: INIT, with any error acknowledged.
pub(in crate::bus) const RESET: [u8; 2] = [0x11, 0];
const AL_STATUS: u16 = 0x0130;
const ERROR: u8 = 0x10;
/// Pauses between two looks at the AL status: a fourth of the time that the change takes already, within these bounds.
const SHORTEST_PAUSE: Duration = Duration::from_micros(100);
const LONGEST_PAUSE: Duration = Duration::from_millis(2);

/// Reads the AL status.
pub(in crate::bus) async fn status(
    registers: &Registers,
    station: u16,
) -> Result<AlStatus, RegisterError> {
    registers.read(station, AL_STATUS).await.map(from_registers)
}

/// Reads the AL status of the SubDevice at this place in the line.
pub(in crate::bus) async fn status_at(
    registers: &Registers,
    position: u16,
) -> Result<AlStatus, RegisterError> {
    registers
        .read_at(position, AL_STATUS)
        .await
        .map(from_registers)
}

fn from_registers([status, _, _, _, c0, c1]: [u8; 6]) -> AlStatus {
    AlStatus {
        state: AlState::from_bits(status),
        error: (status & ERROR != 0).then_some(u16::from_le_bytes([c0, c1])),
    }
}

/// Brings a SubDevice into `state`, which must be one step up, or any below. An old error is acknowledged before.
pub(in crate::bus) async fn request(
    registers: &Registers,
    station: u16,
    state: AlState,
    limit: Duration,
) -> Result<(), AlError> {
    let before = status(registers, station).await?;
    if before.error.is_some() {
        acknowledge(registers, station, before.state).await?;
    }
    ask(registers, station, state, limit).await
}

/// Asks for a state, and waits until the SubDevice is there or refuses.
async fn ask(
    registers: &Registers,
    station: u16,
    state: AlState,
    limit: Duration,
) -> Result<(), AlError> {
    registers
        .write(station, AL_CONTROL, &[state.bits(), 0])
        .await?;
    let time = registers.time();
    let started = time.now();
    loop {
        let seen = status(registers, station).await?;
        if seen.error.is_some() {
            acknowledge(registers, station, seen.state).await?;
            return Err(AlError::Refused(seen));
        }
        if seen.state == state {
            return Ok(());
        }
        let waited = time.now().saturating_sub(started);
        if waited >= limit {
            return Err(AlError::Timeout {
                after: limit,
                status: seen,
            });
        }
        time.sleep((waited / 4).clamp(SHORTEST_PAUSE, LONGEST_PAUSE))
            .await;
    }
}

/// Brings a SubDevice that should be in `from` without error one step up into `to`. One that has left `from` meanwhile, or shows an
/// error, is quoted with its own reason, and not asked.
pub(in crate::bus) async fn climb(
    registers: &Registers,
    station: u16,
    from: AlState,
    to: AlState,
    limit: Duration,
) -> Result<(), AlError> {
    let seen = status(registers, station).await?;
    if seen.error.is_some() {
        acknowledge(registers, station, seen.state).await?;
    }
    if (seen.state, seen.error) != (from, None) {
        return Err(AlError::Refused(seen));
    }
    ask(registers, station, to, limit).await
}

/// Waits for a state that was asked for by a broadcast; a SubDevice that has not taken it is asked again.
pub(in crate::bus) async fn reach(
    registers: &Registers,
    station: u16,
    state: AlState,
    limit: Duration,
) -> Result<(), AlError> {
    let there = AlStatus { state, error: None };
    if status(registers, station).await? == there {
        return Ok(());
    }
    request(registers, station, state, limit).await
}

/// Brings a SubDevice down into `state`; one that is there, or lower, stays where it is.
pub(in crate::bus) async fn lower(
    registers: &Registers,
    station: u16,
    state: AlState,
    limit: Duration,
) -> Result<(), AlError> {
    if status(registers, station).await?.state.bits() <= state.bits() {
        return Ok(());
    }
    request(registers, station, state, limit).await
}

/// Takes the error indication away.
pub(in crate::bus) async fn acknowledge(
    registers: &Registers,
    station: u16,
    state: AlState,
) -> Result<(), RegisterError> {
    registers
        .write(station, AL_CONTROL, &[state.bits() | ERROR, 0])
        .await
}

#[cfg(test)]
mod tests {
    use super::{AlState, AlStatus};

    #[test]
    fn a_status_says_its_code_as_number_and_in_words() {
        let status = AlStatus {
            state: AlState::SafeOp,
            error: Some(0x001B),
        };
        let text = status.to_string();
        assert!(
            text.starts_with("SAFEOP with AL status code 001Bh ("),
            "{text}"
        );
        assert!(text.to_lowercase().contains("watchdog"), "{text}");
    }
}
