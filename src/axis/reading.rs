//! Reading objects that a drive need not have.

use std::sync::Arc;

use super::{Axis, AxisError, AxisErrorKind, Command, ParameterAccess};
use crate::{
    coe::{AbortCode, AxisOffset, Number, Object, Readable, SdoError, Transfer, obj},
    profile_position::{Limits, PositionRange},
};

/// Reads an object of an axis; none where the drive does not have it.
pub(crate) async fn read_if_there<T: Number, A: Readable>(
    parameters: &dyn ParameterAccess,
    offset: AxisOffset,
    object: Object<T, A>,
) -> Result<Option<T>, SdoError> {
    let address = object.offset(offset).address();
    match parameters.read(address).await {
        Ok(bytes) => T::decode(&bytes)
            .map(Some)
            .ok_or_else(|| SdoError::WrongSize {
                transfer: Transfer::read(address),
                expected: usize::from(T::BITS / 8),
                got: bytes.len(),
            }),
        Err(error) => match error.abort_code() {
            Some(AbortCode::NO_OBJECT | AbortCode::NO_SUBINDEX) => Ok(None),
            _ => Err(error),
        },
    }
}

impl Limits {
    /// Reads 607Bh, 607Ch, 607Dh and 607Fh of an axis; what the drive does not have is no limit.
    ///
    /// # Errors
    /// When an object that the drive has could not be read.
    pub async fn read(
        parameters: &dyn ParameterAccess,
        offset: AxisOffset,
    ) -> Result<Self, SdoError> {
        let range = async |min, max| {
            let min = read_if_there(parameters, offset, min).await?;
            let max = read_if_there(parameters, offset, max).await?;
            Ok(min.zip(max).map(|(min, max)| PositionRange { min, max }))
        };
        let home_offset = read_if_there(parameters, offset, obj::HOME_OFFSET).await?;
        Ok(Self {
            software: range(obj::SOFTWARE_LIMIT_MIN, obj::SOFTWARE_LIMIT_MAX).await?,
            home_offset: home_offset.unwrap_or(0),
            position_range: range(obj::POSITION_RANGE_MIN, obj::POSITION_RANGE_MAX).await?,
            max_velocity: read_if_there(parameters, offset, obj::MAX_PROFILE_VELOCITY).await?,
        })
    }
}

impl Axis {
    /// Reads the limits 607Bh, 607Ch, 607Dh and 607Fh of this axis again, and checks moves against them from now on. It is for
    /// programs that have changed one of them since the axis attached. It replaces what was set with
    /// [`AxisConfig::limits`](super::AxisConfig::limits) or `DriveConfig::limits`.
    ///
    /// # Errors
    /// [`AxisErrorKind::Sdo`] if an object could not be read, or when the bus is lost: the limits stay as they were then.
    pub async fn read_limits(&self) -> Result<Limits, AxisError> {
        let shared = &self.handles.shared;
        let setup = &shared.setup;
        let read = Limits::read(&*setup.parameters, setup.offset).await;
        let limits = read.map_err(|error| shared.error(AxisErrorKind::Sdo(Arc::new(error))))?;
        self.run(Command::SetLimits(limits)).await?;
        Ok(limits)
    }

    /// Reads an object of this axis; none where the drive does not have it.
    pub(crate) async fn read_if_there<T: Number, A: Readable>(
        &self,
        object: Object<T, A>,
    ) -> Result<Option<T>, AxisError> {
        let shared = &self.handles.shared;
        let setup = &shared.setup;
        let read = read_if_there(&*setup.parameters, setup.offset, object).await;
        read.map_err(|error| shared.error(AxisErrorKind::Sdo(Arc::new(error))))
    }
}
