//! A datagram whose working counter stays wrong although its devices answer: who shares it, and what the registers of each show.

use std::{fmt, sync::Arc};

use super::{
    AlState, AlStatus, RegisterError, al,
    control::{Control, NetworkEvent},
    log::Note,
    reactor::Context,
    registers::Registers,
    sync_managers::{Area, AreaDirection},
    whereabouts::at_once,
};
use crate::{coe::DriveId, profile_position::WorkingCounter};

/// A datagram of the process data whose working counter stays wrong, and what the registers of its devices show.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Miscounted {
    /// Which datagram, what it was to count and what it counts.
    pub counter: WorkingCounter,
    /// All devices that share it.
    pub devices: Vec<DeviceFinding>,
}

/// What the registers of a device show.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeviceFinding {
    /// The device.
    pub device: DriveId,
    /// What is not as it was set; nothing where all is.
    pub findings: Vec<Finding>,
}

/// What is not as it was set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finding {
    /// Its registers cannot be read.
    Register(RegisterError),
    /// It is not in OP, or has an error.
    State(AlStatus),
    /// This sync manager of its process data is off, or is set to something else.
    SyncManager(u8),
    /// This FMMU of its process data is off, or is set to something else.
    Fmmu(u8),
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Register(error) => write!(f, "its registers cannot be read: {error}"),
            Self::State(status) => write!(f, "it is in {status}"),
            Self::SyncManager(number) => {
                write!(f, "sync manager {number} is off or not as it was set")
            }
            Self::Fmmu(number) => write!(f, "FMMU {number} is off or not as it was set"),
        }
    }
}

impl Miscounted {
    /// The first device that shows something, or the first of all.
    pub(super) fn suspect(&self) -> &DriveId {
        let shows = self.devices.iter().find(|one| !one.findings.is_empty());
        // There are no datagrams without devices.
        let first = shows.or(self.devices.first());
        first.map_or(&NOBODY, |one| &one.device)
    }
}

static NOBODY: DriveId = DriveId {
    position: 0,
    name: String::new(),
    identity: crate::sii::Identity {
        vendor: 0,
        product: 0,
        revision: 0,
        serial: 0,
    },
};

impl fmt::Display for Miscounted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, shared by ", self.counter)?;
        for (place, one) in self.devices.iter().enumerate() {
            let before = if place == 0 { "" } else { ", " };
            write!(f, "{before}{}", one.device)?;
        }
        let mut nothing = true;
        for one in &self.devices {
            for finding in &one.findings {
                nothing = false;
                write!(f, "; {}: {finding}", one.device)?;
            }
        }
        if nothing {
            f.write_str(
                "; the registers of none show why: replace one after the other, or change the place of each in the line",
            )?;
        }
        Ok(())
    }
}

/// Looks for such datagrams, and reports each once.
pub(super) struct MiscountWatch {
    known: Vec<WorkingCounter>,
}

impl MiscountWatch {
    pub(super) const fn new() -> Self {
        Self { known: Vec::new() }
    }

    /// Has what is new looked into, beside the cycles.
    pub(super) fn look(
        &mut self,
        context: &Context,
        control: &Arc<Control>,
        devices: &[(u16, Arc<DriveId>)],
    ) {
        let mut cycle = context.cycle.borrow_mut();
        let Some(cycle) = cycle.as_mut() else { return };
        let all = || cycle.exchange.miscounted();
        let known = &mut self.known;
        known.retain(|known| all().any(|(counter, ..)| counter.datagram == known.datagram));
        for (counter, lasts, places) in all() {
            if !lasts || known.iter().any(|known| known.datagram == counter.datagram) {
                continue;
            }
            known.push(counter);
            let sharing = places.filter_map(|place| devices.get(place).cloned());
            let looking = report(
                context.clone(),
                Arc::clone(control),
                counter,
                sharing.collect(),
            );
            if let Some(task) = context.spawn(looking) {
                task.detach();
            }
        }
    }
}

async fn report(
    context: Context,
    control: Arc<Control>,
    counter: WorkingCounter,
    sharing: Vec<(u16, Arc<DriveId>)>,
) {
    let looks = sharing.iter().map(|(station, _)| {
        let (registers, station) = (context.registers.clone(), *station);
        async move { find(&registers, station).await }
    });
    let findings = at_once(&context, looks).await;
    let devices = sharing.iter().zip(findings);
    let devices = devices.map(|((_, id), findings)| DeviceFinding {
        device: DriveId::clone(id),
        findings,
    });
    let miscounted = Arc::new(Miscounted {
        counter,
        devices: devices.collect(),
    });
    let note = Note::Miscounted(Arc::clone(&miscounted));
    context.log.note(context.time.now(), note);
    control.report(NetworkEvent::Miscounted(miscounted));
}

/// What of a device is not as it was set.
async fn find(registers: &Registers, station: u16) -> Vec<Finding> {
    let mut findings = Vec::new();
    match al::status(registers, station).await {
        Ok(status) if status.state == AlState::Op && status.error.is_none() => {}
        Ok(status) => findings.push(Finding::State(status)),
        Err(error) => return vec![Finding::Register(error)],
    }
    for (area, direction) in registers.areas(station) {
        match compare(registers, station, &area, direction).await {
            Ok(found) => findings.extend(found),
            Err(error) => {
                findings.push(Finding::Register(error));
                break;
            }
        }
    }
    findings
}

async fn compare(
    registers: &Registers,
    station: u16,
    area: &Area,
    direction: AreaDirection,
) -> Result<Vec<Finding>, RegisterError> {
    let mut findings = Vec::new();
    if !area.is_managed(registers, station, direction).await? {
        findings.push(Finding::SyncManager(area.number()));
    }
    if !area.is_mapped(registers, station, direction).await? {
        findings.push(Finding::Fmmu(area.fmmu()));
    }
    Ok(findings)
}
