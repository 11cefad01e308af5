//! A device of a line that was brought up, as far as its way back needs to know it.

use std::{cell::Cell, rc::Rc, sync::Arc};

use smol::lock::Mutex;

use super::super::{
    NetworkError,
    bring_up::{self, Ready},
    dc::Clocks,
    discovery::Found,
    drive_setup::{Failed, Job},
    io::ReadyIo,
    packing::Member,
};
use crate::{
    coe::{DriveId, MailSignal, SdoHandle},
    parameters::StartUpList,
    pdo_map::Layout,
};

/// A device of the exchange.
pub(in crate::bus) struct Device {
    pub(super) found: Found,
    /// Who it is, for notes.
    pub(super) id: Arc<DriveId>,
    /// What is written to it on its way into OP.
    pub(super) lists: Option<(SdoHandle, Vec<StartUpList>)>,
    /// Whether it follows SYNC0.
    pub(super) synchronised: bool,
    /// Whether all other clocks follow its own.
    pub(super) is_reference: bool,
    pub(super) set_up: SetUp,
    /// Held by whoever leads it back.
    pub(super) in_work: Mutex<()>,
    /// How far it is.
    pub(super) stage: Cell<Stage>,
}

/// How a device is set up, and what came of it at the start.
pub(super) enum SetUp {
    Drive(Box<(Job, Layout, Member)>),
    Io(Box<ReadyIo>),
}

/// How far a device is on its way back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stage {
    /// Not on its way.
    None,
    /// Being led from SAFEOP into OP.
    LedBack,
    /// Being set up anew, or left half-way there: it must be set up anew the next time.
    Anew,
}

/// The devices of a line that was brought up.
pub(in crate::bus) fn devices(ready: Ready) -> Vec<Device> {
    let reference = ready.reference();
    let device = |found: Found, lists, synchronised, set_up| Device {
        id: Arc::new(found.id.clone()),
        is_reference: reference.as_ref() == Some(&found.id),
        found,
        lists,
        synchronised,
        set_up,
        in_work: Mutex::new(()),
        stage: Cell::new(Stage::None),
    };
    let drives = ready.drives.into_iter();
    let drives = drives.map(|drive| {
        let member = bring_up::member(&drive);
        let lists = (drive.sdo, drive.start_up);
        let set_up = SetUp::Drive(Box::new((drive.again, drive.layout, member)));
        device(
            drive.found,
            Some(lists),
            drive.sync0_after.is_some(),
            set_up,
        )
    });
    let ios = ready.ios.into_iter().map(|io| {
        let sdo = io.mailbox.as_ref().map(|mailbox| mailbox.sdo.clone());
        let lists = sdo.map(|sdo| (sdo, io.start_up.clone()));
        device(io.found.clone(), lists, false, SetUp::Io(Box::new(io)))
    });
    drives.chain(ios).collect()
}

impl Device {
    /// The line's clocks, if its own follows the reference.
    pub(super) fn clocks(&self) -> Option<&Rc<Clocks>> {
        match &self.set_up {
            SetUp::Drive(set_up) if self.synchronised => set_up.0.clocks.as_ref(),
            SetUp::Drive(_) | SetUp::Io(_) => None,
        }
    }

    /// What its mailbox client is told by, if it has one.
    pub(super) fn mail(&self) -> Option<&MailSignal> {
        let mailbox = match &self.set_up {
            SetUp::Drive(set_up) => set_up.0.mailbox.as_ref(),
            SetUp::Io(io) => io.mailbox.as_ref(),
        };
        mailbox.map(|mailbox| &mailbox.signal)
    }

    /// The error of a step, with the device.
    pub(super) fn fault(&self, (step, error): Failed) -> NetworkError {
        self.found.clone().fault(step, error)
    }
}
