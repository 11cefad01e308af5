//! Reading and writing of SubDevice registers and memory by acyclic futures, each with a deadline.

use std::{cell::RefCell, rc::Rc, time::Duration};

use ethercrab::{Command, MainDevice, error::Error};

use crate::bus::{
    error::RegisterError,
    requests::{
        acyclic::{GIVEN_UP_AFTER, is_lost},
        executor::Time,
        sync_managers::{Area, AreaDirection},
    },
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
    pub(in crate::bus) fn new(main: &'static MainDevice<'static>, time: Rc<Time>) -> Self {
        Self {
            main,
            time,
            areas: Rc::default(),
        }
    }

    /// Notes how an area of a station's process data is set up.
    pub(in crate::bus) fn note_area(&self, station: u16, area: Area, direction: AreaDirection) {
        let mut areas = self.areas.borrow_mut();
        areas.retain(|(at, before, _)| *at != station || before.number() != area.number());
        areas.push((station, area, direction));
    }

    /// How those of this station were set up last.
    pub(in crate::bus) fn areas(&self, station: u16) -> Vec<(Area, AreaDirection)> {
        let areas = self.areas.borrow();
        let of_station = areas.iter().filter(|(at, ..)| *at == station);
        of_station
            .map(|(_, area, direction)| (*area, *direction))
            .collect()
    }

    pub(in crate::bus) fn time(&self) -> &Rc<Time> {
        &self.time
    }

    pub(in crate::bus) fn main(&self) -> &'static MainDevice<'static> {
        self.main
    }

    /// How many SubDevices answer a broadcast.
    pub(in crate::bus) async fn count(&self) -> Result<u16, RegisterError> {
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
    pub(in crate::bus) async fn read<const N: usize>(
        &self,
        station: u16,
        register: u16,
    ) -> Result<[u8; N], RegisterError> {
        let mut bytes = [0; N];
        self.read_into(station, register, &mut bytes).await?;
        Ok(bytes)
    }

    /// Reads as many bytes as `buffer` has from `register` on.
    pub(in crate::bus) async fn read_into(
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
    pub(in crate::bus) async fn write(
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
    pub(in crate::bus) async fn broadcast(
        &self,
        register: u16,
        bytes: &[u8],
    ) -> Result<(), RegisterError> {
        self.ask(|| async move {
            Command::bwr(register)
                .ignore_wkc()
                .send_receive_slice(self.main, bytes)
                .await
                .map(|_| ())
        })
        .await
    }

    /// Has one SubDevice's register read and given to all others (FRMW), four bytes of it.
    pub(in crate::bus) async fn distribute(
        &self,
        station: u16,
        register: u16,
    ) -> Result<(), RegisterError> {
        self.ask(|| async move {
            Command::frmw(station, register)
                .ignore_wkc()
                .receive_slice(self.main, 4)
                .await
                .map(|_| ())
        })
        .await
    }

    /// Writes to the SubDevice at this place in the line, whatever its station address.
    pub(in crate::bus) async fn write_at(
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
    pub(in crate::bus) async fn read_at<const N: usize>(
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
            Some(Err(error)) => Err(RegisterError::Refused(error)),
        }
    }
}
