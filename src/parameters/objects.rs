//! Which objects of a drive are parameters, as it says itself.

use super::set::{ParameterObject, is_parameter, read};
use super::value::known_name;
use crate::coe::information::ObjectCode;
use crate::coe::{DriveError, ObjectDictionary, SdoError, SdoHandle, obj};

impl ParameterObject {
    /// The parameters of a drive: those entries of its object dictionary that can be read and written. For a drive without
    /// SDO information these are those of the standard that the library [knows](Self::known), for as many axes as have a
    /// statusword.
    ///
    /// # Errors
    /// [`DriveError`] if the drive does not answer or breaks the protocol.
    pub async fn of(sdo: &SdoHandle) -> Result<Vec<Self>, DriveError> {
        match sdo.dictionary().await {
            Ok(dictionary) => Ok(Self::of_dictionary(&dictionary)),
            Err(DriveError {
                error: SdoError::NotSupported { .. },
                ..
            }) => {
                let mut axes = 1;
                while axes < 8
                    && read(sdo, obj::STATUSWORD.axis(axes + 1).address())
                        .await?
                        .is_ok()
                {
                    axes += 1;
                }
                Ok(Self::known(axes))
            }
            Err(error) => Err(error),
        }
    }

    /// The parameters in a drive's object dictionary.
    #[must_use]
    pub fn of_dictionary(dictionary: &ObjectDictionary) -> Vec<Self> {
        let mut all = Vec::new();
        for object in &dictionary.objects {
            for entry in &object.entries {
                let address = entry.address;
                if !entry.access.readable() || !entry.access.writable() || !is_parameter(address) {
                    continue;
                }
                let name = match (known_name(address), object.description.code) {
                    (Some(known), _) => known.into(),
                    (None, ObjectCode::Array | ObjectCode::Record) => {
                        format!("{}: {}", object.description.name, entry.name)
                    }
                    (None, _) => object.description.name.clone(),
                };
                all.push(Self {
                    object: address,
                    kind: entry.data_type.into(),
                    name,
                });
            }
        }
        all
    }
}
