//! That no axis of a drive is enabled, as the drive itself says.

use crate::coe::{AbortCode, SdoError, SdoHandle, obj};
use crate::ds402::{State, Statusword};

/// An axis that is enabled, so that the drive's parameters are left alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("axis {axis} of the drive is in {state}: disable it first")]
pub struct Enabled {
    /// The axis, from 1.
    pub axis: u8,
    /// The state that its statusword shows.
    pub state: State,
}

/// Why the axes are not known to be disabled.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum GuardFault {
    Enabled(Enabled),
    Sdo(SdoError),
}

/// The axes of a drive.
pub(super) struct Guard {
    axes: u8,
}

impl Guard {
    /// Finds the axes of a drive, by their statuswords, and checks them.
    pub(super) async fn of(sdo: &SdoHandle) -> Result<Self, GuardFault> {
        for axis in 1..=8 {
            match check(sdo, axis).await {
                Err(GuardFault::Sdo(SdoError::Aborted { code, .. }))
                    if axis > 1 || code == AbortCode::NO_OBJECT =>
                {
                    return Ok(Self { axes: axis - 1 });
                }
                other => other?,
            }
        }
        Ok(Self { axes: 8 })
    }

    /// Checks them again.
    pub(super) async fn check(&self, sdo: &SdoHandle) -> Result<(), GuardFault> {
        for axis in 1..=self.axes {
            check(sdo, axis).await?;
        }
        Ok(())
    }
}

async fn check(sdo: &SdoHandle, axis: u8) -> Result<(), GuardFault> {
    let word = sdo
        .read(obj::STATUSWORD.axis(axis))
        .await
        .map_err(|error| GuardFault::Sdo(error.error))?;
    let state = Statusword::from_bits_retain(word).state();
    match state {
        State::NotReadyToSwitchOn
        | State::SwitchOnDisabled
        | State::ReadyToSwitchOn
        | State::SwitchedOn
        | State::Fault => Ok(()),
        // Stopping axes move; a statusword of no state says nothing.
        State::OperationEnabled
        | State::QuickStopActive
        | State::FaultReactionActive
        | State::Unknown => Err(GuardFault::Enabled(Enabled { axis, state })),
    }
}
