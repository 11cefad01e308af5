//! Which devices are there and in OP, as cycles and AL states show it: what is told of it, and what the exchange is to know.

use std::sync::Arc;

use crate::{
    bus::{
        cycle::{Cycle, exchange::DriveData},
        error::{AlState, AlStatus, RegisterError},
        log::{DriveChange, LogRecord},
        requests::{Context, al},
        watch::Control,
    },
    coe::DriveId,
};

/// What the last cycle showed; `None` when there are no cycles any more.
pub(in crate::bus) fn look(
    context: &Context,
    control: &Control,
    drives: &[Arc<DriveId>],
    lost: &mut [bool],
) -> Option<(Option<(u8, u16)>, bool)> {
    let mut cycle = context.cycle.borrow_mut();
    let cycle = cycle.as_mut()?;
    let states = drives.iter().zip(cycle.exchange.drives.iter()).zip(lost);
    for ((drive, data), lost) in states {
        if data.lost != *lost {
            *lost = data.lost;
            let change = if data.lost {
                DriveChange::Lost
            } else {
                DriveChange::Back
            };
            report(context, control, drive, change);
        }
    }
    Some((cycle.last.al_status, cycle.last.wrong))
}

/// Notes and tells what happened to a drive.
fn report(context: &Context, control: &Control, drive: &Arc<DriveId>, change: DriveChange) {
    let note = LogRecord::Drive(Arc::clone(drive), change);
    context.log.record(context.time.now(), note);
    control.report(change.of(drive));
}

/// Waits for all of these, whose requests share frames: many devices that do not answer take no longer than one.
pub(in crate::bus) async fn at_once<F>(
    context: &Context,
    futures: impl Iterator<Item = F>,
) -> Vec<F::Output>
where
    F: Future<Output: 'static> + 'static,
{
    let tasks: Vec<_> = futures.filter_map(|future| context.spawn(future)).collect();
    let mut results = Vec::with_capacity(tasks.len());
    for task in tasks {
        results.push(task.await);
    }
    results
}

/// Looks whether a device has left OP, or is back in it, and takes in at once what was seen: a moment later it may be led back.
pub(in crate::bus) async fn read_state(
    context: Context,
    control: Arc<Control>,
    place: usize,
    station: u16,
    id: Arc<DriveId>,
) {
    match al::status(&context.registers, station).await {
        Ok(status) => note_state(&context, &control, place, &id, status),
        // It is reported as lost by its process data. Of one without inputs a working counter of 0 may be that of outputs
        // closed since it left OP: but not where nobody is there.
        Err(RegisterError::NotAnswered) => {
            let mut cycle = context.cycle.borrow_mut();
            if let Some(data) = data_of(&mut cycle, place)
                && data.inputs.is_empty()
            {
                data.fallen = false;
            }
        }
        Err(_) => {}
    }
}

/// The share of the exchange that the device at this place has; `None` when there are no cycles any more.
pub(in crate::bus) fn data_of(cycle: &mut Option<Cycle>, place: usize) -> Option<&mut DriveData> {
    cycle.as_mut()?.exchange.drives.get_mut(place)
}

/// Takes in what AL state a device was seen in, and reports it if it has left OP or is back.
pub(in crate::bus) fn note_state(
    context: &Context,
    control: &Control,
    place: usize,
    device: &Arc<DriveId>,
    status: AlStatus,
) {
    let mut cycle = context.cycle.borrow_mut();
    let Some(data) = data_of(&mut cycle, place).filter(|data| !data.away) else {
        return;
    };
    let in_op = status.state == AlState::Op && status.error.is_none();
    // One that was lost is not operational, and may come back fallen.
    if data.operational == in_op && data.fallen != in_op {
        return;
    }
    data.operational = in_op;
    data.fallen = !in_op;
    let change = if in_op {
        DriveChange::InOp
    } else {
        DriveChange::LeftOp(status)
    };
    report(context, control, device, change);
}
