//! Reading objects that a drive need not have.

use super::{Axis, AxisError, AxisErrorKind, ParameterAccess};
use crate::coe::{AbortCode, AxisOffset, Number, Object, Readable, SdoError, Transfer};
use std::sync::Arc;

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

impl Axis {
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
