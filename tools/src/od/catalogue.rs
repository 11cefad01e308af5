//! The objects of a drive as it describes them, or as the library knows them.

use servocrab::coe::{
    AnyObject, AxisOffset, DriveError, ObjectAddress, SdoError, SdoHandle, TypeCode,
    information::{EntryDescription, ObjectDescription},
    obj,
};

use crate::output::Failure;

/// An entry of an object.
#[derive(Debug, Clone)]
pub(crate) struct Item {
    pub(crate) address: ObjectAddress,
    pub(crate) name: String,
    pub(crate) data_type: TypeCode,
    pub(crate) bits: u16,
    pub(crate) access: String,
}

impl Item {
    /// Whether the name or the address has this text in it, whatever its case.
    pub(crate) fn has(&self, text: &str) -> bool {
        let text = text.to_lowercase();
        let address = self.address.to_string().to_lowercase();
        self.name.to_lowercase().contains(&text) || address.contains(&text)
    }

    /// The object with this address: as the drive describes it, or the library, or else as nothing but bytes.
    async fn at(sdo: &SdoHandle, address: ObjectAddress) -> Result<Self, DriveError> {
        match sdo.describe_object(address.index).await {
            Ok(object) => {
                let entry = sdo.describe_entry(address.index, address.subindex).await?;
                Ok(Self::of(&object, &entry))
            }
            Err(error) if is_not_supported(&error) => {
                let axes = (1..=8).map(AxisOffset::of_axis);
                let mut known = axes.flat_map(|axis| {
                    let all = obj::all().into_iter();
                    all.map(move |object| object.offset(axis))
                });
                Ok(match known.find(|object| object.address() == address) {
                    Some(object) => Self::known(&object, u16::from(object.bits())),
                    None => Self {
                        address,
                        name: String::new(),
                        data_type: TypeCode(0),
                        bits: 0,
                        access: "unknown".into(),
                    },
                })
            }
            Err(error) => Err(error),
        }
    }

    fn known(object: &AnyObject, bits: u16) -> Self {
        Self {
            address: object.address(),
            name: object.name.into(),
            data_type: object.data_type.into(),
            bits,
            access: if object.writable { "rw" } else { "ro" }.into(),
        }
    }

    fn of(object: &ObjectDescription, entry: &EntryDescription) -> Self {
        Self {
            address: entry.address,
            name: object.name_with(entry),
            data_type: entry.data_type,
            bits: entry.bits,
            access: entry.access.to_string(),
        }
    }
}

/// What there is to choose from.
pub(crate) struct Catalogue {
    items: Vec<Item>,
    /// Why the drive could not be asked.
    reason: Option<DriveError>,
}

impl Catalogue {
    pub(crate) async fn of(sdo: &SdoHandle) -> Result<Self, DriveError> {
        match sdo.dictionary().await {
            Ok(dictionary) => {
                let entries = dictionary.objects.iter().flat_map(|object| {
                    object
                        .entries
                        .iter()
                        .map(|entry| Item::of(&object.description, entry))
                });
                Ok(Self {
                    items: entries.collect(),
                    reason: None,
                })
            }
            Err(error) if is_not_supported(&error) => Ok(Self {
                items: known(sdo).await?,
                reason: Some(error),
            }),
            Err(error) => Err(error),
        }
    }

    pub(crate) fn items(&self) -> &[Item] {
        &self.items
    }

    pub(crate) const fn reason(&self) -> Option<&DriveError> {
        self.reason.as_ref()
    }

    /// The one object with this name.
    fn named(&self, object: &str) -> Result<&Item, String> {
        let named = |item: &&Item| item.name.eq_ignore_ascii_case(object);
        let found: Vec<_> = self.items.iter().filter(named).collect();
        match found.as_slice() {
            [one] => Ok(one),
            [] => Err(format!(
                "no object is named `{object}`: `servocrab od find` helps to find it"
            )),
            several => {
                let addresses: Vec<_> = several
                    .iter()
                    .map(|item| item.address.to_string())
                    .collect();
                Err(format!(
                    "`{object}` is the name of {}: give the address",
                    addresses.join(", ")
                ))
            }
        }
    }
}

/// The objects with these addresses or names. All of the drive's are asked for only where a name is among them: that can
/// take seconds.
pub(crate) async fn find(sdo: &SdoHandle, objects: &[String]) -> Result<Vec<Item>, Failure> {
    let mut catalogue = None;
    let mut items = Vec::new();
    for object in objects {
        if let Ok(address) = object.parse() {
            items.push(Item::at(sdo, address).await?);
            continue;
        }
        if catalogue.is_none() {
            catalogue = Some(Catalogue::of(sdo).await?);
        }
        let named = catalogue.as_ref().map(|all| all.named(object));
        items.extend(named.transpose()?.cloned());
    }
    Ok(items)
}

fn is_not_supported(error: &DriveError) -> bool {
    matches!(error.error, SdoError::NotSupported { .. })
}

/// Those of the library's objects that the drive has, for each of its axes.
async fn known(sdo: &SdoHandle) -> Result<Vec<Item>, DriveError> {
    let mut items: Vec<Item> = Vec::new();
    for axis in 1..=8 {
        let mut of_axis = 0;
        for object in obj::all() {
            let moved = object.offset(AxisOffset::of_axis(axis));
            if axis > 1 && moved.index == object.index {
                continue;
            }
            let bytes = match sdo.read_bytes(moved.index, moved.subindex).await {
                Ok(bytes) => bytes,
                Err(DriveError {
                    error: SdoError::Aborted { .. },
                    ..
                }) => continue,
                Err(error) => return Err(error),
            };
            of_axis += 1;
            items.push(Item::known(&moved, (8 * bytes.len()) as u16));
        }
        if of_axis == 0 {
            break;
        }
    }
    items.sort_by_key(|item| item.address);
    Ok(items)
}
