//! A datagram whose working counter stays wrong although its devices answer: who shares it, and what the registers of each show.

use std::sync::Arc;

use crate::{
    bus::{
        error::{AlState, RegisterError},
        event::{DeviceFinding, Finding, Miscounted, NetworkEvent},
        log::LogRecord,
        requests::{
            Context, al,
            registers::Registers,
            sync_managers::{Area, AreaDirection},
        },
        watch::{Control, al_monitor::at_once},
    },
    coe::DriveId,
    profile_position::WorkingCounter,
};

/// Looks for such datagrams, and reports each once.
pub(in crate::bus) struct MiscountWatch {
    known: Vec<WorkingCounter>,
}

impl MiscountWatch {
    pub(in crate::bus) const fn new() -> Self {
        Self { known: Vec::new() }
    }

    /// Has what is new looked into, beside the cycles.
    pub(in crate::bus) fn look(
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
    let note = LogRecord::Miscounted(Arc::clone(&miscounted));
    context.log.record(context.time.now(), note);
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
