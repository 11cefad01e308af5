//! The line from power-on to PREOP, by ethercrab's `init` under a deadline of ours.

use std::time::Duration;

use super::{AlState, NetworkError, al, reactor::Context, registers::RegisterError};
use crate::{coe::DriveId, sii::Identity};

/// The most SubDevices in a line (a power of two; ethercrab keeps them in a fixed array).
const LONGEST_LINE: usize = 128;
/// The first station address that ethercrab gives.
const FIRST_STATION: u16 = 0x1000;
/// How long discovery may take, and how much more for each SubDevice: its firmware's way to PREOP takes up to 3 s
/// (ETG.1020, default PREOP timeout).
const LIMIT: Duration = Duration::from_secs(5);
const LIMIT_PER_SUBDEVICE: Duration = Duration::from_secs(3);

/// A SubDevice of the line, in PREOP.
#[derive(Debug, Clone)]
pub(super) struct Found {
    pub(super) station: u16,
    pub(super) id: DriveId,
}

/// Finds all SubDevices and brings them into PREOP.
pub(super) async fn discover(context: &Context) -> Result<Vec<Found>, NetworkError> {
    let registers = &context.registers;
    let count = match registers.count().await {
        Ok(0) => return Err(NetworkError::NoSubDevice),
        Ok(count) => count,
        Err(RegisterError::NotAnswered) => return Err(NetworkError::NoSubDevice),
        Err(RegisterError::NoFrame) => return Err(NetworkError::NoAnswer),
        Err(RegisterError::Refused(error)) => {
            return Err(NetworkError::Discovery {
                count: 0,
                reason: error.to_string(),
                stragglers: Vec::new(),
            });
        }
    };
    let time = context.time.clone();
    // Distributed clocks are not used: their start time does not matter.
    let init = Box::pin(registers.main().init_single_group::<LONGEST_LINE, 1>(|| 0));
    let limit = LIMIT + LIMIT_PER_SUBDEVICE * u32::from(count);
    let reason = match time.within(limit, init).await {
        Some(Ok(group)) => {
            let found = group.iter(registers.main()).enumerate().map(|(n, device)| {
                let identity = device.identity();
                Found {
                    station: device.configured_address(),
                    id: DriveId {
                        position: u16::try_from(n).unwrap_or(u16::MAX),
                        name: device.name().to_owned(),
                        identity: Identity {
                            vendor: identity.vendor_id,
                            product: identity.product_id,
                            revision: identity.revision,
                            serial: identity.serial,
                        },
                    },
                }
            });
            return Ok(found.collect());
        }
        Some(Err(error)) => error.to_string(),
        None => format!("not done within {limit:?}"),
    };
    let mut stragglers = Vec::new();
    for position in 0..count {
        let station = FIRST_STATION.wrapping_add(position);
        if let Ok(status) = al::status(registers, station).await
            && status.state != AlState::PreOp
        {
            stragglers.push((position, status));
        }
    }
    Err(NetworkError::Discovery {
        count,
        reason,
        stragglers,
    })
}
