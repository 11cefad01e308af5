//! The drive's own memory: storing its parameters for the next power-up (1010h) and its maker's defaults (1011h).

use std::time::Duration;

use super::guard::{Enabled, Guard, GuardFault};
use crate::coe::{AbortCode, DriveError, DriveId, Object, ReadWrite, SdoError, SdoHandle};

/// 1010h:01, store all parameters (CiA 301).
const STORE: Object<u32, ReadWrite> = Object::new(0x1010, 1, "store all parameters");
/// 1011h:01, restore all default parameters (CiA 301).
const DEFAULTS: Object<u32, ReadWrite> = Object::new(0x1011, 1, "restore all default parameters");
/// What 1010h takes, so that nothing is stored by mistake.
const SAVE: u32 = u32::from_le_bytes(*b"save");
/// What 1011h takes.
const LOAD: u32 = u32::from_le_bytes(*b"load");
/// Drives answer when the memory is written, which takes some of them seconds.
const PATIENCE: Duration = Duration::from_secs(30);

/// What a drive says of 1010h:01 or 1011h:01.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemorySupport {
    /// Bit 0: it stores, or loads the defaults, on command.
    pub on_command: bool,
    /// Bit 1 of 1010h: it stores by itself.
    pub by_itself: bool,
}

/// Why a drive's memory was not written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{drive}: {fault}")]
pub struct MemoryError {
    /// The drive.
    pub drive: DriveId,
    /// What went wrong.
    #[source]
    pub fault: MemoryFault,
}

/// Why a drive's memory was not written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MemoryFault {
    /// An axis of the drive is enabled.
    #[error(transparent)]
    Enabled(Enabled),
    /// It has no such object.
    #[error("it has no object {object}: its parameters are kept in another way, see its manual")]
    NotThere {
        /// 1010h:01 or 1011h:01.
        object: crate::coe::ObjectAddress,
    },
    /// It has the object, but says that it does nothing on command.
    #[error("its {object} says that it takes no command{}", if *.by_itself { ": it stores by itself" } else { "" })]
    NotOnCommand {
        /// 1010h:01 or 1011h:01.
        object: crate::coe::ObjectAddress,
        /// It stores by itself.
        by_itself: bool,
    },
    /// The transfer failed; the drive's own reason is in it if it refused.
    #[error(transparent)]
    Sdo(SdoError),
}

/// What the drive says of storing its parameters (1010h:01); nothing if it has no such object.
///
/// # Errors
/// [`DriveError`] as of [`SdoHandle::read`].
pub async fn store_support(sdo: &SdoHandle) -> Result<Option<MemorySupport>, DriveError> {
    support(sdo, STORE).await
}

/// What the drive says of loading its maker's defaults (1011h:01); nothing if it has no such object.
///
/// # Errors
/// [`DriveError`] as of [`SdoHandle::read`].
pub async fn defaults_support(sdo: &SdoHandle) -> Result<Option<MemorySupport>, DriveError> {
    support(sdo, DEFAULTS).await
}

/// Has the drive store its present parameters for its next power-up ("save" to 1010h:01). It takes up to 30 s.
///
/// # Errors
/// [`MemoryError`]; after `Timeout` and `Link` the parameters may have been stored.
pub async fn store(sdo: &SdoHandle) -> Result<(), MemoryError> {
    command(sdo, STORE, SAVE).await
}

/// Has the drive go back to its maker's defaults ("load" to 1011h:01). They are in force after its next power-up or reset
/// (CiA 301); until then it goes on with what it has. It takes up to 30 s.
///
/// # Errors
/// [`MemoryError`]; after `Timeout` and `Link` the command may have taken effect.
pub async fn load_defaults(sdo: &SdoHandle) -> Result<(), MemoryError> {
    command(sdo, DEFAULTS, LOAD).await
}

async fn support(
    sdo: &SdoHandle,
    object: Object<u32, ReadWrite>,
) -> Result<Option<MemorySupport>, DriveError> {
    match sdo.read(object).await {
        Ok(bits) => Ok(Some(MemorySupport {
            on_command: bits & 1 != 0,
            by_itself: bits & 2 != 0 && object.index() == STORE.index(),
        })),
        Err(DriveError {
            error: SdoError::Aborted { code, .. },
            ..
        }) if code == AbortCode::NO_OBJECT || code == AbortCode::NO_SUBINDEX => Ok(None),
        Err(error) => Err(error),
    }
}

async fn command(
    sdo: &SdoHandle,
    object: Object<u32, ReadWrite>,
    signature: u32,
) -> Result<(), MemoryError> {
    let failed = |fault| MemoryError {
        drive: sdo.drive().clone(),
        fault,
    };
    let address = object.address();
    let support = support(sdo, object)
        .await
        .map_err(|error| failed(MemoryFault::Sdo(error.error)))?
        .ok_or_else(|| failed(MemoryFault::NotThere { object: address }))?;
    if !support.on_command {
        return Err(failed(MemoryFault::NotOnCommand {
            object: address,
            by_itself: support.by_itself,
        }));
    }
    Guard::of(sdo).await.map_err(|fault| {
        failed(match fault {
            GuardFault::Enabled(enabled) => MemoryFault::Enabled(enabled),
            GuardFault::Sdo(error) => MemoryFault::Sdo(error),
        })
    })?;
    sdo.clone()
        .with_timeout(PATIENCE)
        .write(object, signature)
        .await
        .map_err(|error| failed(MemoryFault::Sdo(error.error)))
}
