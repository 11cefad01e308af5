//! ESI files: what a maker says of its devices in XML (`EtherCATInfo`, ETG.2000), with the feature `esi`.
//!
//! From an [`EsiDevice`] comes a drive of a network in one call: [`DriveConfig::from_esi`](crate::DriveConfig::from_esi). It consists of a
//! [`DriveDescription`](crate::drives::DriveDescription) ([`EsiDevice::description`]) and a start-up list of its `InitCmd`s
//! ([`EsiDevice::start_up_list`]). [`EsiDevice::compare`] gives
//! a table of what a drive has otherwise.
//!
//! Files are not trusted: at most [`MOST_BYTES`], a bounded number of elements, no document type definition (and so no entities),
//! no recursion. Of the slots of a modular device
//! those are read whose module is the default or has to be there. Reading one takes at most 64 KiB, 128 bytes of memory for each of its bytes, and 1
//! KiB for each entry of its dictionaries. They have at most 262 144 entries.

mod compare;
mod describe;
mod device;
mod xml;

pub use compare::{EsiDifference, EsiDifferences};
pub use describe::{EsiDriveError, NoAxis};
pub use device::{
    EsiClockMode, EsiDevice, EsiEntry, EsiInitCommand, EsiPdo, EsiSlot, EsiSyncManager,
    EsiTransition, InitCommandFault, RefusedInitCommand,
};
pub use xml::{EsiError, EsiFault, MOST_BYTES};

use std::path::Path;

/// An ESI file.
///
/// ```
/// use servocrab::esi::Esi;
/// let text = r##"<EtherCATInfo>
///   <Vendor><Id>#x0000006A</Id><Name>Example</Name></Vendor>
///   <Descriptions><Devices><Device>
///     <Type ProductCode="#x44530402" RevisionNo="1">Drive</Type><Name>Servo drive</Name>
///     <RxPdo Sm="2"><Index>#x1600</Index>
///       <Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
///       <Entry><Index>#x607A</Index><SubIndex>0</SubIndex><BitLen>32</BitLen></Entry></RxPdo>
///     <TxPdo Sm="3"><Index>#x1A00</Index>
///       <Entry><Index>#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
///       <Entry><Index>#x6064</Index><SubIndex>0</SubIndex><BitLen>32</BitLen></Entry></TxPdo>
///   </Device></Devices></Descriptions>
/// </EtherCATInfo>"##;
/// let esi = Esi::from_bytes("drive.xml", text.as_bytes())?;
/// assert_eq!(esi.devices[0].description()?.product, Some(0x4453_0402));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Esi {
    /// The maker's number.
    pub vendor: u32,
    /// The maker's name.
    pub vendor_name: String,
    /// The devices, in the file's order.
    pub devices: Vec<EsiDevice>,
    /// The devices that cannot be described, such as one whose PDOs have other indices than those of CoE.
    pub skipped: Vec<SkippedDevice>,
    /// What is not as ETG.2000 has it and was read all the same: the first number as `0xF3F`, if there is one.
    pub warnings: Vec<EsiError>,
}

/// A device of a file that cannot be described.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name} cannot be described: {error}")]
#[non_exhaustive]
pub struct SkippedDevice {
    /// The name, or the type where it has none.
    pub name: String,
    /// The product code, where that can be read.
    pub product: Option<u32>,
    /// Why not.
    pub error: EsiError,
}

/// A file that describes no device of a product.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the file describes no device with product code {product:08X}h{}",
    .skipped.as_ref().map(|skipped| format!(": {skipped}")).unwrap_or_default()
)]
#[non_exhaustive]
pub struct NoSuchDevice {
    /// The product code.
    pub product: u32,
    /// The device of this product that cannot be described, if there is one.
    pub skipped: Option<Box<SkippedDevice>>,
}

impl Esi {
    /// Reads a file. A device that cannot be described is left out of [`devices`](Self::devices), and named in
    /// [`skipped`](Self::skipped).
    ///
    /// # Errors
    /// [`EsiError`] with the file, and line and element where they apply: it cannot be read, is too large, is no XML, is no ESI
    /// file, or none of its devices can be described.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, EsiError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        let bytes = xml::read(path).map_err(|fault| EsiError::of_file(&name, fault))?;
        Self::from_bytes(&name, &bytes)
    }

    /// Reads the content of a file; `name` is for messages. UTF-8, or ISO 8859-1 where the file says so.
    ///
    /// # Errors
    /// As [`Esi::load`], but for what concerns the reading of the file.
    pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Self, EsiError> {
        let text = xml::decode(bytes).map_err(|fault| EsiError::of_file(name, fault))?;
        let document = xml::parse(name, &text)?;
        let source = xml::Source::new(name);
        let mut esi = Self::of(&xml::Element::root(&source, &document))?;
        esi.warnings.extend(source.into_c_number());
        Ok(esi)
    }

    fn of(root: &xml::Element<'_>) -> Result<Self, EsiError> {
        if root.name() != "EtherCATInfo" {
            return Err(root.error(EsiFault::NoEsi));
        }
        let vendor = root.need("Vendor")?;
        let modules = device::Modules::read(root);
        let mut esi = Self {
            vendor: vendor.need("Id")?.number()?,
            vendor_name: vendor.text_of("Name"),
            devices: Vec::new(),
            skipped: Vec::new(),
            warnings: Vec::new(),
        };
        let mut room = device::MOST_ENTRIES;
        for device in root
            .children("Descriptions")
            .flat_map(|descriptions| descriptions.children("Devices"))
            .flat_map(|devices| devices.children("Device"))
        {
            match EsiDevice::read(esi.vendor, &device, &modules, &mut room) {
                Ok(device) => esi.devices.push(device),
                Err(error) => esi.skipped.push(SkippedDevice::of(&device, error)),
            }
        }
        match esi.skipped.first() {
            Some(skipped) if esi.devices.is_empty() => Err(skipped.error.clone()),
            _ => Ok(esi),
        }
    }

    /// The device with this product code, of the highest revision not above `revision`, or else the lowest above.
    ///
    /// # Errors
    /// [`NoSuchDevice`], with the reason where the file has one that cannot be described.
    pub fn device(&self, product: u32, revision: u32) -> Result<&EsiDevice, NoSuchDevice> {
        let same = || {
            self.devices
                .iter()
                .filter(|device| device.product == product)
        };
        let not_above = same().filter(|device| device.revision <= revision);
        not_above
            .max_by_key(|device| device.revision)
            .or_else(|| same().min_by_key(|device| device.revision))
            .ok_or_else(|| {
                let is_it = |skipped: &&SkippedDevice| skipped.product == Some(product);
                let skipped = self.skipped.iter().find(is_it).cloned().map(Box::new);
                NoSuchDevice { product, skipped }
            })
    }
}

impl SkippedDevice {
    fn of(device: &xml::Element<'_>, error: EsiError) -> Self {
        let kind = device.child("Type");
        let name = match device.text_of("Name") {
            name if name.is_empty() => device.text_of("Type"),
            name => name,
        };
        let product = kind.and_then(|kind| kind.attribute_number("ProductCode").ok()?);
        Self {
            name: name.chars().take(128).collect(),
            product,
            error,
        }
    }
}

#[cfg(test)]
mod tests;
