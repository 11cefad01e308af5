//! Reading and writing of SubDevice registers and memory by acyclic futures, each with a deadline.

use std::{cell::RefCell, rc::Rc, time::Duration};

use ethercrab::{Command, MainDevice, error::Error};

use super::{
    acyclic::{GIVEN_UP_AFTER, is_lost},
    executor::Time,
    sync_managers::{Area, AreaDirection},
};
use crate::{
    bus::error::{AlError, AlState, AlStatus, RegisterError},
    coe::LinkRefusal,
    esc,
};

/// How long to wait for a free frame slot of ethercrab's.
const SLOT_RETRY: Duration = Duration::from_millis(1);

/// Access to the registers of all SubDevices, from futures on the bus thread.
#[derive(Clone)]
pub(in crate::bus) struct Registers {
    main: &'static MainDevice<'static>,
    time: Rc<Time>,
    /// How the process data of each station were set up.
    areas: Rc<RefCell<Vec<(u16, Area, AreaDirection)>>>,
}

impl Registers {
    pub fn new(main: &'static MainDevice<'static>, time: Rc<Time>) -> Self {
        Self {
            main,
            time,
            areas: Rc::default(),
        }
    }

    /// Notes how an area of a station's process data is set up.
    pub fn note_area(&self, station: u16, area: Area, direction: AreaDirection) {
        let mut areas = self.areas.borrow_mut();
        areas.retain(|(at, before, _)| *at != station || before.number() != area.number());
        areas.push((station, area, direction));
    }

    /// How those of this station were set up last.
    pub fn areas(&self, station: u16) -> Vec<(Area, AreaDirection)> {
        let areas = self.areas.borrow();
        let of_station = areas.iter().filter(|(at, ..)| *at == station);
        of_station
            .map(|(_, area, direction)| (*area, *direction))
            .collect()
    }

    pub fn time(&self) -> &Rc<Time> {
        &self.time
    }

    pub fn main(&self) -> &'static MainDevice<'static> {
        self.main
    }

    /// How many SubDevices answer a broadcast.
    pub async fn count(&self) -> Result<u16, RegisterError> {
        // The working counter is not public on an answer, but it is in the error about it.
        let request = || async {
            match Command::brd(0)
                .with_wkc(0)
                .receive_slice(self.main, 1)
                .await
            {
                Ok(_) => Ok(0),
                Err(Error::WorkingCounter { received, .. }) => Ok(received),
                Err(error) => Err(error),
            }
        };
        self.ask(request).await
    }

    /// Reads `N` bytes from `register` on.
    pub async fn read<const N: usize>(
        &self,
        station: u16,
        register: u16,
    ) -> Result<[u8; N], RegisterError> {
        let mut bytes = [0; N];
        self.read_into(station, register, &mut bytes).await?;
        Ok(bytes)
    }

    /// Reads as many bytes as `buffer` has from `register` on.
    pub async fn read_into(
        &self,
        station: u16,
        register: u16,
        buffer: &mut [u8],
    ) -> Result<(), RegisterError> {
        let length = u16::try_from(buffer.len()).unwrap_or(u16::MAX);
        let mut buffer = core::cell::RefCell::new(buffer);
        let shared = &buffer;
        self.ask(|| async move {
            let answer = Command::fprd(station, register)
                .receive_slice(self.main, length)
                .await?;
            // The bytes lie in a slot that is already free: they are copied before anything else is polled.
            for (to, from) in shared.borrow_mut().iter_mut().zip(answer.iter()) {
                *to = *from;
            }
            Ok(())
        })
        .await?;
        buffer.get_mut();
        Ok(())
    }

    /// Writes `bytes` from `register` on.
    pub async fn write(
        &self,
        station: u16,
        register: u16,
        bytes: &[u8],
    ) -> Result<(), RegisterError> {
        self.ask(|| async move {
            Command::fpwr(station, register)
                .send_receive_slice(self.main, bytes)
                .await
                .map(|_| ())
        })
        .await
    }

    /// Writes to all SubDevices, and to none where there is none with this register.
    pub async fn broadcast(&self, register: u16, bytes: &[u8]) -> Result<(), RegisterError> {
        self.ask(|| async move {
            Command::bwr(register)
                .ignore_wkc()
                .send_receive_slice(self.main, bytes)
                .await
                .map(|_| ())
        })
        .await
    }

    /// Has one SubDevice's register read and given to all others (FRMW), four bytes of it: these, or the zeros that were sent, where no
    /// SubDevice has this station address.
    pub async fn distribute(&self, station: u16, register: u16) -> Result<[u8; 4], RegisterError> {
        self.ask(|| async move {
            let answer = Command::frmw(station, register)
                .ignore_wkc()
                .receive_slice(self.main, 4)
                .await?;
            let mut read = [0; 4];
            for (to, from) in read.iter_mut().zip(answer.iter()) {
                *to = *from;
            }
            Ok(read)
        })
        .await
    }

    /// Writes to the SubDevice at this place in the line, whatever its station address.
    pub async fn write_at(
        &self,
        position: u16,
        register: u16,
        bytes: &[u8],
    ) -> Result<(), RegisterError> {
        self.ask(|| async move {
            Command::apwr(position, register)
                .send_receive_slice(self.main, bytes)
                .await
                .map(|_| ())
        })
        .await
    }

    /// Reads from the SubDevice at this place in the line, whatever its station address.
    pub async fn read_at<const N: usize>(
        &self,
        position: u16,
        register: u16,
    ) -> Result<[u8; N], RegisterError> {
        let bytes = core::cell::Cell::new([0; N]);
        let shared = &bytes;
        self.ask(|| async move {
            let answer = Command::aprd(position, register)
                .receive_slice(self.main, N as u16)
                .await?;
            let mut read = [0; N];
            for (to, from) in read.iter_mut().zip(answer.iter()) {
                *to = *from;
            }
            shared.set(read);
            Ok(())
        })
        .await?;
        Ok(bytes.get())
    }

    async fn ask<T, F>(&self, request: impl Fn() -> F) -> Result<T, RegisterError>
    where
        F: Future<Output = Result<T, Error>>,
    {
        let patience = GIVEN_UP_AFTER;
        let attempt = async {
            loop {
                match request().await {
                    // All slots are in flight.
                    Err(Error::Pdu(ethercrab::error::PduError::SwapState)) => {
                        self.time.sleep(SLOT_RETRY).await;
                    }
                    other => return other,
                }
            }
        };
        match self.time.within(patience, attempt).await {
            None => Err(RegisterError::NoFrame),
            Some(Ok(value)) => Ok(value),
            Some(Err(Error::WorkingCounter { received: 0, .. })) => Err(RegisterError::NotAnswered),
            Some(Err(error)) if is_lost(&error) => Err(RegisterError::NoFrame),
            Some(Err(error)) => Err(RegisterError::Refused(LinkRefusal::new(error))),
        }
    }
}

// The AL state machine (ETG.1000.6): requests, refusals with their reason, acknowledgement of errors.

impl Registers {
    /// Asks for the explicit device identification (ETG.1020): none of a device that has none, or shows an error.
    pub async fn identification(&self, station: u16) -> Result<Option<u16>, RegisterError> {
        let [before, ..]: [u8; 6] = self.read(station, esc::AL_STATUS).await?;
        let state = AlState::from_bits(before).bits();
        self.write(station, esc::AL_CONTROL, &[state | IDENTIFICATION, 0])
            .await?;
        let time = self.time();
        let until = time.now().saturating_add(IDENTIFICATION_LIMIT);
        let id = loop {
            let [status, _, _, _, c0, c1] = self.read(station, esc::AL_STATUS).await?;
            if status & (IDENTIFICATION | ERROR) == IDENTIFICATION {
                break Some(u16::from_le_bytes([c0, c1]));
            }
            if time.now() >= until {
                break None;
            }
            time.sleep(LONGEST_PAUSE).await;
        };
        self.write(station, esc::AL_CONTROL, &[state, 0]).await?;
        Ok(id)
    }
}

/// Written there: INIT, with any error acknowledged.
pub(in crate::bus) const RESET: [u8; 2] = [0x11, 0];
const ERROR: u8 = 0x10;
/// Of AL control: the identification is asked for; of AL status: it stands in 0134h (ETG.1020).
const IDENTIFICATION: u8 = 0x20;
/// How long that may take. Assumed: a device's processor looks at AL control at least ten times a second.
const IDENTIFICATION_LIMIT: Duration = Duration::from_millis(100);
/// How long a SubDevice may show an error that was acknowledged (ETG.1020, default timeout of a step back to SAFEOP).
const ACKNOWLEDGE_LIMIT: Duration = Duration::from_millis(200);
/// Pauses between two looks at the AL status: a fourth of the time that the change takes already, within these bounds.
const SHORTEST_PAUSE: Duration = Duration::from_micros(100);
const LONGEST_PAUSE: Duration = Duration::from_millis(2);

/// Reads the AL status.
pub(in crate::bus) async fn status(
    registers: &Registers,
    station: u16,
) -> Result<AlStatus, RegisterError> {
    registers
        .read(station, esc::AL_STATUS)
        .await
        .map(from_registers)
}

/// Reads the AL status of the SubDevice at this place in the line.
pub(in crate::bus) async fn status_at(
    registers: &Registers,
    position: u16,
) -> Result<AlStatus, RegisterError> {
    registers
        .read_at(position, esc::AL_STATUS)
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

/// Looks at the AL status until it is as it should be, or the time is over; what it was last.
async fn settled(
    registers: &Registers,
    station: u16,
    limit: Duration,
    is_settled: impl Fn(AlStatus) -> bool,
) -> Result<AlStatus, RegisterError> {
    let time = registers.time();
    let started = time.now();
    loop {
        let seen = status(registers, station).await?;
        let waited = time.now().saturating_sub(started);
        if is_settled(seen) || waited >= limit {
            return Ok(seen);
        }
        time.sleep((waited / 4).clamp(SHORTEST_PAUSE, LONGEST_PAUSE))
            .await;
    }
}

/// Asks for a state, and waits until the SubDevice is there or refuses.
async fn ask(
    registers: &Registers,
    station: u16,
    state: AlState,
    limit: Duration,
) -> Result<(), AlError> {
    registers
        .write(station, esc::AL_CONTROL, &[state.bits(), 0])
        .await?;
    let is_over = |seen: AlStatus| seen.error.is_some() || seen.state == state;
    let seen = settled(registers, station, limit, is_over).await?;
    if seen.error.is_some() {
        acknowledge(registers, station, seen.state).await?;
        return Err(AlError::Refused(seen));
    }
    if seen.state == state {
        return Ok(());
    }
    Err(AlError::Timeout {
        after: limit,
        status: seen,
    })
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

/// Takes the error indication away, and waits until it is gone. The SubDevice's processor may look milliseconds later: it sees what was
/// written last, and shows the old error until then.
async fn acknowledge(
    registers: &Registers,
    station: u16,
    state: AlState,
) -> Result<(), RegisterError> {
    registers
        .write(station, esc::AL_CONTROL, &[state.bits() | ERROR, 0])
        .await?;
    let is_gone = |seen: AlStatus| seen.error.is_none();
    settled(registers, station, ACKNOWLEDGE_LIMIT, is_gone).await?;
    Ok(())
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
