//! The AL state machine (ETG.1000.6): requests, refusals with their reason, acknowledgement of errors.

use std::{fmt, time::Duration};

use ethercrab::AlStatusCode;

use super::registers::{RegisterError, Registers};

pub(super) const AL_CONTROL: u16 = 0x0120;
/// Written there: INIT, with any error acknowledged.
pub(super) const RESET: [u8; 2] = [0x11, 0];
const AL_STATUS: u16 = 0x0130;
const ERROR: u8 = 0x10;
const STATE: u8 = 0x0F;
/// Pauses between two looks at the AL status: a fourth of the time that the change takes already, within these bounds.
const SHORTEST_PAUSE: Duration = Duration::from_micros(100);
const LONGEST_PAUSE: Duration = Duration::from_millis(2);

/// A state of a SubDevice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum AlState {
    /// Nothing but registers.
    Init,
    /// Mailbox.
    PreOp,
    /// Firmware update.
    Bootstrap,
    /// Mailbox and inputs.
    SafeOp,
    /// Mailbox, inputs and outputs.
    Op,
    /// Any other number.
    Other(u8),
}

impl AlState {
    pub(super) const fn from_bits(bits: u8) -> Self {
        match bits & STATE {
            1 => Self::Init,
            2 => Self::PreOp,
            3 => Self::Bootstrap,
            4 => Self::SafeOp,
            8 => Self::Op,
            other => Self::Other(other),
        }
    }

    pub(super) const fn bits(self) -> u8 {
        match self {
            Self::Init => 1,
            Self::PreOp => 2,
            Self::Bootstrap => 3,
            Self::SafeOp => 4,
            Self::Op => 8,
            Self::Other(other) => other,
        }
    }
}

impl fmt::Display for AlState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Init => f.write_str("INIT"),
            Self::PreOp => f.write_str("PREOP"),
            Self::Bootstrap => f.write_str("BOOT"),
            Self::SafeOp => f.write_str("SAFEOP"),
            Self::Op => f.write_str("OP"),
            Self::Other(n) => write!(f, "state {n}"),
        }
    }
}

/// The AL status of a SubDevice: its state, and why it is not in another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AlStatus {
    /// The state it is in.
    pub state: AlState,
    /// The AL status code, where the SubDevice indicates an error.
    pub error: Option<u16>,
}

impl fmt::Display for AlStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.error {
            None => write!(f, "{}", self.state),
            Some(code) => {
                // The text begins with the code in another notation.
                let text = AlStatusCode::from(code).to_string();
                let meaning = text.split_once(": ").map_or(text.as_str(), |parts| parts.1);
                write!(
                    f,
                    "{} with AL status code {code:04X}h ({meaning})",
                    self.state
                )
            }
        }
    }
}

/// Why a SubDevice did not change its state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AlError {
    /// It refused, or fell back.
    #[error("it refused and is in {0}")]
    Refused(AlStatus),
    /// It neither changed nor refused.
    #[error("nothing happened within {after:?}: it is in {status}")]
    Timeout {
        /// How long it was given.
        after: Duration,
        /// What it shows.
        status: AlStatus,
    },
    /// Its registers could not be reached.
    #[error(transparent)]
    Register(#[from] RegisterError),
}

/// Reads the AL status.
pub(super) async fn status(registers: &Registers, station: u16) -> Result<AlStatus, RegisterError> {
    registers.read(station, AL_STATUS).await.map(from_registers)
}

/// Reads the AL status of the SubDevice at this place in the line.
pub(super) async fn status_at(
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
pub(super) async fn request(
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
pub(super) async fn climb(
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
pub(super) async fn reach(
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
pub(super) async fn lower(
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
pub(super) async fn acknowledge(
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
