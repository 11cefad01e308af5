//! Which devices are on the line: from power-on to PREOP, all SubDevices at once, and where a device is that was without power.
//!
//! It owns the station addresses. It calls `requests`, and must not configure a device: that is `device`.

pub(super) mod find;

use std::{rc::Rc, time::Duration};

use crate::{
    bus::{
        error::{AlError, AlState, BringUpStep, NetworkError, RegisterError},
        requests::{Context, al, eeprom, registers::Registers, sync_managers},
    },
    coe::DriveId,
    sii::{Identity, Sii},
};

/// The station address of the first SubDevice; the others follow.
pub(in crate::bus) const FIRST_STATION: u16 = 0x1000;
/// The most SubDevices of a line: the stations 1000h to 1FFFh. A working counter that says more is wrong, and would cost
/// memory and minutes for each SubDevice that is not there.
const MOST_SUB_DEVICES: u16 = 0x1000;
pub(in crate::bus) const STATION_ADDRESS: u16 = 0x0010;
/// How long a SubDevice may take into INIT, and into PREOP (ETG.1020, default timeouts).
const INIT_LIMIT: Duration = Duration::from_secs(5);
const PRE_OP_LIMIT: Duration = Duration::from_secs(3);

/// What every SubDevice is set back to in INIT: register, and how many zeros. In pieces of one FMMU or sync manager, since
/// some ESCs have less of them and refuse a write beyond. Besides: event mask, EEPROM to the master, and of the distributed
/// clock the cyclic unit, system time offset, delay, start and cycle times.
const ZEROS: [(u16, usize); 8] = [
    (EVENT_MASK, 2),
    (eeprom::CONFIGURATION, 1),
    (0x0981, 1),
    (0x0920, 8),
    (0x0928, 4),
    (0x0990, 8),
    (0x09A0, 4),
    (0x09A4, 4),
];
/// Of each, an ESC has at most 16.
const MOST: u16 = 16;
const EVENT_MASK: u16 = 0x0200;

/// A SubDevice of the line, in PREOP.
#[derive(Debug, Clone)]
pub(in crate::bus) struct Found {
    pub(in crate::bus) station: u16,
    pub(in crate::bus) id: DriveId,
    pub(in crate::bus) sii: Rc<Sii>,
}

/// Finds all SubDevices and brings them into PREOP.
pub(in crate::bus) async fn discover(context: &Context) -> Result<Vec<Found>, NetworkError> {
    let count = count(&context.registers).await?;
    discover_each(context, count).await?.into_iter().collect()
}

/// How many SubDevices there are: at least one, and not more than have an address.
pub(in crate::bus) async fn count(registers: &Registers) -> Result<u16, NetworkError> {
    match registers.count().await {
        Ok(0) | Err(RegisterError::NotAnswered) => Err(NetworkError::NoSubDevice),
        Ok(count) if count > MOST_SUB_DEVICES => Err(NetworkError::TooManySubDevices {
            most: MOST_SUB_DEVICES,
            got: count,
        }),
        Ok(count) => Ok(count),
        Err(RegisterError::NoFrame) => Err(NetworkError::NoAnswer),
        Err(error) => Err(NetworkError::Line(error)),
    }
}

/// Brings `count` SubDevices into PREOP, each as far as it comes.
pub(in crate::bus) async fn discover_each(
    context: &Context,
    count: u16,
) -> Result<Vec<Result<Found, NetworkError>>, NetworkError> {
    let registers = &context.registers;
    reset(context).await?;
    // All addresses before anything else: a SubDevice that kept one from before must not answer to another's.
    let stations = (0..count).map(|position| (position, FIRST_STATION.wrapping_add(position)));
    let addresses = stations.clone().map(|(position, station)| {
        let registers = registers.clone();
        async move {
            let station = station.to_le_bytes();
            registers
                .write_at(position, STATION_ADDRESS, &station)
                .await
        }
    });
    all(context, addresses).await?;
    let tasks: Option<Vec<_>> = stations
        .map(|(position, station)| {
            context.spawn(find(context.registers.clone(), position, station))
        })
        .collect();
    let mut line = Vec::new();
    for task in tasks.ok_or_else(loop_is_gone)? {
        line.push(task.await);
    }
    Ok(line)
}

/// Brings all SubDevices into INIT, whatever they were doing, with nothing configured.
async fn reset(context: &Context) -> Result<(), NetworkError> {
    let registers = &context.registers;
    registers
        .broadcast(al::AL_CONTROL, &al::RESET)
        .await
        .map_err(NetworkError::Line)?;
    let zeros = zeros().map(|(register, zeros)| {
        let registers = registers.clone();
        async move {
            let bytes = [0; 16];
            let bytes = bytes.get(..zeros).unwrap_or(&bytes);
            registers.broadcast(register, bytes).await
        }
    });
    all(context, zeros).await
}

/// Sets one SubDevice back into INIT, with nothing configured.
pub(in crate::bus) async fn set_back(registers: &Registers, station: u16) -> Result<(), AlError> {
    registers.write(station, al::AL_CONTROL, &al::RESET).await?;
    al::reach(registers, station, AlState::Init, INIT_LIMIT).await?;
    for (register, zeros) in zeros() {
        let bytes = [0; 16];
        let bytes = bytes.get(..zeros).unwrap_or(&bytes);
        match registers.write(station, register, bytes).await {
            // It has no such register.
            Ok(()) | Err(RegisterError::NotAnswered) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// All registers that are set back, each with its length.
fn zeros() -> impl Iterator<Item = (u16, usize)> {
    let fmmus = (0..MOST).map(|fmmu| (sync_managers::FMMU + 16 * fmmu, 16));
    let managers = (0..MOST).map(|manager| (sync_managers::SYNC_MANAGER + 8 * manager, 8));
    fmmus.chain(managers).chain(ZEROS)
}

/// Waits for all of these, which are under way at the same time.
async fn all<F>(context: &Context, accesses: impl Iterator<Item = F>) -> Result<(), NetworkError>
where
    F: Future<Output = Result<(), RegisterError>> + 'static,
{
    let tasks: Option<Vec<_>> = accesses.map(|access| context.spawn(access)).collect();
    for task in tasks.ok_or_else(loop_is_gone)? {
        task.await.map_err(NetworkError::Line)?;
    }
    Ok(())
}

pub(in crate::bus) fn loop_is_gone() -> NetworkError {
    NetworkError::Thread("the bus loop is gone".into())
}

/// One SubDevice from INIT to PREOP.
pub(in crate::bus) async fn find(
    registers: Registers,
    position: u16,
    station: u16,
) -> Result<Found, NetworkError> {
    let mut id = DriveId {
        position,
        name: String::new(),
        identity: Identity::default(),
    };
    let fault = |id: &DriveId, step, error| NetworkError::Drive {
        drive: id.clone(),
        step,
        error: Box::new(error),
    };
    al::reach(&registers, station, AlState::Init, INIT_LIMIT)
        .await
        .map_err(|error| fault(&id, BringUpStep::State(AlState::Init), error.into()))?;
    let (sii, name) = eeprom::read(&registers, station)
        .await
        .map_err(|error| fault(&id, BringUpStep::Sii, error.into()))?;
    id.identity = sii.identity;
    id.name = name;
    let in_pre_op = async {
        sync_managers::set_mailbox(&registers, station, &sii).await?;
        al::request(&registers, station, AlState::PreOp, PRE_OP_LIMIT).await
    };
    in_pre_op
        .await
        .map_err(|error| fault(&id, BringUpStep::State(AlState::PreOp), error.into()))?;
    Ok(Found {
        station,
        id,
        sii: Rc::new(sii),
    })
}
